"""6-DoF poses of known objects from any number of calibrated RGB cameras.

Transforms are named by their frames: `a_from_b` is a 4x4 matrix that maps coordinates in frame b
into frame a. Units: metres, pixels, radians; others where a name ends in `_deg` or `_mm`. Camera
axes and lenses are OpenCV's: x right, y down, z forward; integer pixel coordinates are centres.
"""

from mvtop import metrics
from mvtop._error import Error
from mvtop._estimator import Estimator, ObjectClass
from mvtop._mvtop import (
    Camera,
    Rig,
    box_rays,
    camera_rays,
    deformable_sampling,
    encode_rays,
    rotation_from_6d,
)
from mvtop._prediction import CameraPose, ObjectPose, Prediction, Sigma

__all__ = [
    "Camera",
    "CameraPose",
    "Error",
    "Estimator",
    "ObjectClass",
    "ObjectPose",
    "Prediction",
    "Rig",
    "Sigma",
    "box_rays",
    "camera_rays",
    "deformable_sampling",
    "encode_rays",
    "metrics",
    "rotation_from_6d",
]
