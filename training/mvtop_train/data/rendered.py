"""A view as a renderer gives it, before it is a file; `bop.write_scene` writes it."""

from dataclasses import dataclass

import numpy as np

from . import mvball
from .boxes import amodal_boxes
from .objects import Object


@dataclass
class Seen:
    """One object in a view."""

    obj: Object
    world_from_obj: np.ndarray  # [4, 4], m
    mask: np.ndarray  # [H, W] bool, its visible part
    full_pixels: int  # of its outline if nothing hid it or cut it off
    shows: str | None = None  # of MV-ball: the one hemisphere in sight, "green" or "red"
    bump_pixels: int = 0  # of that hemisphere


@dataclass
class View:
    """One kept camera and what it sees."""

    k: np.ndarray  # [3, 3], px
    cam_from_world: np.ndarray  # [4, 4], m
    seen: list[Seen]
    rgb: np.ndarray | None = None  # [H, W, 3] uint8
    depth: np.ndarray | None = None  # [H, W], m
    other: np.ndarray | None = None  # [H, W] bool, what stands before the background besides

    def cam_from_obj(self, seen: Seen) -> np.ndarray:
        return self.cam_from_world @ seen.world_from_obj


def amodal_box(view: View, seen: Seen) -> np.ndarray:
    """Extent [x0, y0, x1, y1] of the whole object's projection, clipped to the image, px."""
    height, width = seen.mask.shape
    box = amodal_boxes(seen.obj.bounds, view.k, view.cam_from_obj(seen))
    return box.clip(-0.5, [width - 0.5, height - 0.5] * 2)


def object_coordinates(view: View, seen: Seen) -> np.ndarray:
    """Object-frame position of each visible object pixel [H, W, 3] in metres, NaN elsewhere."""
    v, u = np.nonzero(seen.mask)
    z = view.depth[v, u]
    rays = np.stack([u, v, np.ones_like(u)], 1) @ np.linalg.inv(view.k).T
    obj_from_cam = np.linalg.inv(view.cam_from_obj(seen))
    points = (rays * z[:, None]) @ obj_from_cam[:3, :3].T + obj_from_cam[:3, 3]
    on_object = np.ones(len(points), bool)
    if seen.shows:
        # MV-ball's depth is that of the antialiased image: on outlines such points are off it.
        radius = np.linalg.norm(points, axis=1)
        on_object = np.abs(radius - mvball.BALL_RADIUS) < mvball.BUMP_RADIUS
    coords = np.full((*seen.mask.shape, 3), np.nan)
    coords[v[on_object], u[on_object]] = points[on_object]
    return coords
