"""A view as a renderer gives it, before it is a file; `bop.write_scene` writes it."""

from dataclasses import dataclass

import numpy as np

from . import mvball


@dataclass
class View:
    """One kept camera and what it sees."""

    k: np.ndarray  # [3, 3], px
    cam_from_world: np.ndarray  # [4, 4], m
    world_from_obj: np.ndarray  # [4, 4], m
    shows: str | None  # of MV-ball: the one hemisphere in sight, "green" or "red"
    bump_pixels: int  # of that hemisphere
    mask: np.ndarray  # [H, W] bool, visible part of the object
    full_pixels: int  # of the object's outline if nothing hid it or cut it off
    rgb: np.ndarray | None = None  # [H, W, 3] uint8
    depth: np.ndarray | None = None  # [H, W], m

    @property
    def cam_from_obj(self) -> np.ndarray:
        return self.cam_from_world @ self.world_from_obj


def amodal_box(view: View, points: np.ndarray) -> np.ndarray:
    """Extent [x0, y0, x1, y1] of the whole object's projection, clipped to the image, px."""
    in_cam = points @ view.cam_from_obj[:3, :3].T + view.cam_from_obj[:3, 3]
    pixels = in_cam @ view.k.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    height, width = view.mask.shape
    low = np.maximum(pixels.min(0), -0.5)
    high = np.minimum(pixels.max(0), [width - 0.5, height - 0.5])
    return np.concatenate([low, high])


def object_coordinates(view: View) -> np.ndarray:
    """Object-frame position of each visible object pixel [H, W, 3] in metres, NaN elsewhere."""
    v, u = np.nonzero(view.mask)
    z = view.depth[v, u]
    rays = np.stack([u, v, np.ones_like(u)], 1) @ np.linalg.inv(view.k).T
    obj_from_cam = np.linalg.inv(view.cam_from_obj)
    points = (rays * z[:, None]) @ obj_from_cam[:3, :3].T + obj_from_cam[:3, 3]
    on_object = np.ones(len(points), bool)
    if view.shows:
        # MV-ball's depth is that of the antialiased image: on outlines such points are off it.
        radius = np.linalg.norm(points, axis=1)
        on_object = np.abs(radius - mvball.BALL_RADIUS) < mvball.BUMP_RADIUS
    coords = np.full((*view.mask.shape, 3), np.nan)
    coords[v[on_object], u[on_object]] = points[on_object]
    return coords
