"""6-DoF poses of known objects from any number of calibrated RGB cameras.

Transforms are named by their frames: `a_from_b` is a 4x4 matrix that maps coordinates in frame b
into frame a. Units: metres, pixels, radians; others where a name ends in `_deg` or `_mm`. Camera
axes and lenses are OpenCV's: x right, y down, z forward; integer pixel coordinates are centers.
"""

from mvtop._mvtop import (
    BOP_RESULTS_HEADER,
    Camera,
    RefinedRig,
    Rig,
    RigCheck,
    RigCorrection,
    Tracks,
    __version__,
    box_rays,
    camera_rays,
    deformable_sampling,
    deformable_sampling_backward,
    deformable_sampling_forward,
    encode_rays,
    rotation_from_6d,
    set_num_threads,
)

TYPE_CHECKING = False  # type checkers know the name; importing it takes longer than all the rest
if TYPE_CHECKING:
    from mvtop import bop, calibration, metrics, uncertainty
    from mvtop._error import Error, MvtopWarning
    from mvtop._estimator import Estimator
    from mvtop._objects import (
        CameraPose,
        Grasp,
        Hypothesis,
        NearMiss,
        ObjectClass,
        ObjectPose,
        PredictionWarning,
        Refinement,
        RigConsistency,
        Sigma,
        Undetermined,
    )
    from mvtop._prediction import Prediction
    from mvtop._request import Plane, Prior, Request
    from mvtop._shipped import example
    from mvtop._tracker import Tracker
    from mvtop.calibration import Calibration, calibrate

__all__ = [
    "BOP_RESULTS_HEADER",
    "Calibration",
    "Camera",
    "CameraPose",
    "Error",
    "Estimator",
    "Grasp",
    "Hypothesis",
    "MvtopWarning",
    "NearMiss",
    "ObjectClass",
    "ObjectPose",
    "Plane",
    "Prediction",
    "PredictionWarning",
    "Prior",
    "RefinedRig",
    "Refinement",
    "Request",
    "Rig",
    "RigCheck",
    "RigConsistency",
    "RigCorrection",
    "Sigma",
    "Tracker",
    "Tracks",
    "Undetermined",
    "__version__",
    "bop",
    "box_rays",
    "calibrate",
    "calibration",
    "camera_rays",
    "deformable_sampling",
    "deformable_sampling_backward",
    "deformable_sampling_forward",
    "encode_rays",
    "example",
    "metrics",
    "rotation_from_6d",
    "set_num_threads",
    "uncertainty",
]

# Loaded when first asked for, so that `import mvtop` takes no time.
_HOMES = {
    "Calibration": "mvtop.calibration",
    "Error": "mvtop._error",
    "MvtopWarning": "mvtop._error",
    "Estimator": "mvtop._estimator",
    "ObjectClass": "mvtop._objects",
    "CameraPose": "mvtop._objects",
    "Grasp": "mvtop._objects",
    "Hypothesis": "mvtop._objects",
    "NearMiss": "mvtop._objects",
    "ObjectPose": "mvtop._objects",
    "Plane": "mvtop._request",
    "Prior": "mvtop._request",
    "Prediction": "mvtop._prediction",
    "Tracker": "mvtop._tracker",
    "PredictionWarning": "mvtop._objects",
    "Refinement": "mvtop._objects",
    "Request": "mvtop._request",
    "RigConsistency": "mvtop._objects",
    "Sigma": "mvtop._objects",
    "Undetermined": "mvtop._objects",
    "calibrate": "mvtop.calibration",
    "example": "mvtop._shipped",
}


def __getattr__(name: str) -> object:
    import importlib

    if name in ("bop", "calibration", "metrics", "uncertainty"):
        return importlib.import_module(f"mvtop.{name}")
    if name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'mvtop' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
