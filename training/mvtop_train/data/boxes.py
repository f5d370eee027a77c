"""Amodal boxes: the extent of the whole object's projection, seen or not."""

import numpy as np


def amodal_boxes(points: np.ndarray):
    """A function (k, cam_from_obj) -> boxes [..., 4] that project `points` [n, 3], metres."""

    def boxes_of(k, cam_from_obj):
        in_cam = points @ cam_from_obj[..., :3, :3].swapaxes(-1, -2)
        pixels = (in_cam + cam_from_obj[..., None, :3, 3]) @ k.swapaxes(-1, -2)
        pixels = pixels[..., :2] / pixels[..., 2:]
        return np.concatenate([pixels.min(-2), pixels.max(-2)], -1)

    return boxes_of
