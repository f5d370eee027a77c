"""A rig from images of a board: lenses and places of all cameras by one bundle adjustment.

Needs `pip install 'mvtop[calibrate]'` (OpenCV, SciPy). Frames: `world` is the reference camera's
frame unless another is asked for; `board` has its origin at the top left corner of the pattern, x
right, y down on the print, z into the sheet. Units: metres, pixels.
"""

from mvtop.calibration.boards import Board
from mvtop.calibration.hand_eye import HandEye, PoseResidual
from mvtop.calibration.on_robot import RobotRig, at_poses, calibrate_hand_eye
from mvtop.calibration.outliers import Outlier
from mvtop.calibration.pipeline import Calibration, CameraReport, calibrate
from mvtop.calibration.robot_poses import RobotPoses
from mvtop.calibration.verdict import Coverage, HeldOut

__all__ = [
    "Board",
    "Calibration",
    "CameraReport",
    "Coverage",
    "HandEye",
    "HeldOut",
    "Outlier",
    "PoseResidual",
    "RobotPoses",
    "RobotRig",
    "at_poses",
    "calibrate",
    "calibrate_hand_eye",
]
