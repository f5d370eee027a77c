"""What a model makes of a group: which true objects it finds, how far off, and false positives."""

import numpy as np
import torch

from ..network import symmetry
from ..network.config import ObjectClass
from .groups import Group, Truth

WITHIN_DEG, WITHIN_M = 5.0, 0.005  # of the true pose, of one that is right
DIGITS = 6  # of numbers in results


def errors(truth: np.ndarray, pose: np.ndarray, obj: ObjectClass) -> tuple[float, float]:
    """Degrees and metres between two poses [4, 4], but for the object's symmetries."""
    alike = symmetry.of((obj,))
    single = [torch.tensor(x).float() for x in (pose[:3, :3], pose[:3, 3], truth)]
    turn = symmetry.nearest(*single, torch.tensor(0), alike).double().numpy()
    truth = truth @ turn
    # By the chord, as the cosine of a small angle tells little: |R - S|_F = sqrt(8) sin(angle / 2).
    chord = np.linalg.norm(truth[:3, :3] - pose[:3, :3]) / np.sqrt(8)
    angle = 2 * np.rad2deg(np.arcsin(min(chord, 1.0)))
    return float(angle), float(np.linalg.norm(truth[:3, 3] - pose[:3, 3]))


def matches(truth: tuple[Truth, ...], found: list) -> list[int | None]:
    """By true object the estimate that is matched with it, as `mvtop-cli eval` does: of its class,
    within its diameter, one to one, nearest origins first.

    - found: estimates with `class_name` and `world_from_obj` [4, 4], m
    """
    pairs = []
    for t, there in enumerate(truth):
        for p, one in enumerate(found):
            if one.class_name == there.known.name:
                away = np.linalg.norm(one.world_from_obj[:3, 3] - there.world_from_obj[:3, 3])
                if away <= there.known.diameter_m:
                    pairs.append((away, t, p))
    matched: list[int | None] = [None] * len(truth)
    for _, t, p in sorted(pairs):
        if matched[t] is None and p not in matched:
            matched[t] = p
    return matched


def outcome(group: Group, prediction) -> dict:
    """What came of a group, for results.

    - prediction: mvtop.Prediction, or what it failed with
    """
    failed = isinstance(prediction, Exception)
    found = [] if failed else [one for one in prediction.objects if one.class_name in group.asked]
    matched = matches(group.truth, found)
    pairs = zip(group.truth, matched, strict=True)
    extra = [one for p, one in enumerate(found) if p not in matched]
    return {
        "group": group.name,
        "scene": group.scene,
        "images": list(group.images),
        "objects": [
            _object(there, None if p is None else found[p]) for there, p in pairs if there.counts
        ],
        "false_positives": [
            {"class": one.class_name, "confidence": _rounded(one.confidence)} for one in extra
        ],
        "timings_ms": {} if failed else {k: _rounded(v) for k, v in prediction.timings_ms.items()},
        "warnings": [] if failed else sorted({one.code for one in prediction.warnings}),
        "error": str(prediction) if failed else None,
    }


def _object(there: Truth, one) -> dict:
    """A true object, and the estimate of it, if there is one."""
    about = {
        "class": there.known.name,
        "visibility": {camera: _rounded(share) for camera, share in there.visibility.items()},
        "found": one is not None,
        "right": False,
    }
    if one is None:
        return about
    rot_deg, t_m = errors(there.world_from_obj, one.world_from_obj, there.known)
    return about | {
        "right": rot_deg <= WITHIN_DEG and t_m <= WITHIN_M,
        "rot_err_deg": _rounded(rot_deg),
        "t_err_mm": _rounded(1e3 * t_m),
        "confidence": _rounded(one.confidence),
        "sigma_rot_deg": _rounded(one.sigma.rot_deg),
        "sigma_t_mm": _rounded(1e3 * one.sigma.t_m),
    }


def _rounded(x: float | None) -> float | None:
    return None if x is None else float(f"{x:.{DIGITS}g}")
