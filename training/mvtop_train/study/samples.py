"""Folders of samples (`synthesis/samples.py`), and the object in one that a prediction is of."""

import json
from pathlib import Path

import numpy as np

from ..errors import UserError


def folders(samples: Path) -> list[Path]:
    """Those of the samples, in order; at least one."""
    found = sorted(path.parent for path in samples.glob("*/rig.json"))
    if not found:
        raise UserError(
            f"{samples}: expected folders with rig.json and images, got none; "
            "fix: mvtop-train samples"
        )
    return found


def true_pose(sample: Path) -> np.ndarray:
    """world_from_obj [4, 4] of its first object."""
    truth = json.loads((sample / "truth.json").read_text())["objects"][0]
    return np.array(truth["T_world_obj"])


def nearest_to(prediction, world_from_obj: np.ndarray):
    """The object that is nearest to where one truly is; None where nothing is found."""

    def away(one) -> float:
        return np.linalg.norm(one.world_from_obj[:3, 3] - world_from_obj[:3, 3])

    return min(prediction.objects, key=away, default=None)
