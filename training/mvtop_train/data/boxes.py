"""Amodal boxes: the extent of the whole object's projection, seen or not."""

import numpy as np


def amodal_boxes(points: np.ndarray, k: np.ndarray, cam_from_obj: np.ndarray) -> np.ndarray:
    """Boxes [..., 4] px of an object in cameras.

    points        [n, 3] the object's outermost, metres
    k             [..., 3, 3] px
    cam_from_obj  [..., 4, 4] metres
    """
    in_cam = points @ cam_from_obj[..., :3, :3].swapaxes(-1, -2)
    return around(pixels(k, in_cam + cam_from_obj[..., None, :3, 3]))


def pixels(k: np.ndarray, in_cam: np.ndarray) -> np.ndarray:
    """Where cameras `k` [..., 3, 3] image points [..., n, 3]: [..., n, 2] px."""
    seen = in_cam @ k.swapaxes(-1, -2)
    return seen[..., :2] / seen[..., 2:]


def around(pixels: np.ndarray) -> np.ndarray:
    """Boxes [..., 4] around pixels [..., n, 2]."""
    return np.concatenate([pixels.min(-2), pixels.max(-2)], -1)
