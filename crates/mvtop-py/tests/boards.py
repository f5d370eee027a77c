"""Images of boards with exact truth: a small renderer through any of mvtop's lenses."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

import mvtop
from mvtop.calibration import Board
from mvtop.calibration.printing import texture

needs_calibrate = pytest.mark.skipif(
    not (find_spec("cv2") and find_spec("scipy")),
    reason="the extra mvtop[calibrate] is not installed",
)
PAPER, BACKGROUND = 235, 90
FINE = 3
"""Rays per pixel and axis."""

HEAD = {"format": "mvtop-board", "version": 1, "unit": "mm"}
CHARUCO = HEAD | {
    "kind": "charuco",
    "columns": 9,
    "rows": 7,
    "square": 50,
    "marker": 38,
    "dictionary": "4X4_100",
}
CHESSBOARD = HEAD | {"kind": "chessboard", "columns": 9, "rows": 6, "square": 50}
APRILGRID = HEAD | {"kind": "aprilgrid", "columns": 5, "rows": 4, "tag": 60, "gap": 18}
TAGS = HEAD | {
    "kind": "tags",
    "dictionary": "tag36h11",
    "tags": [
        {"id": 3 * i, "center": [90 * (i % 4), 100 * (i // 4)], "size": 60} for i in range(12)
    ],
}


def look_at(center, target, roll_deg=0.0):
    """world_from_cam (4, 4) of a camera at `center` that looks at `target`, world y down."""
    z = np.subtract(target, center)
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    turn = np.radians(roll_deg)
    roll = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1) @ roll, center
    return pose


def board_at(board: Board, center, tilt_deg=(0.0, 0.0, 0.0)):
    """world_from_board (4, 4): the middle of the board at `center`, turned about x, y, z in
    turn."""
    pose = np.eye(4)
    for axis, turn in enumerate(np.radians(tilt_deg)):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        one = np.eye(3)
        one[a, a] = one[b, b] = np.cos(turn)
        one[a, b], one[b, a] = -np.sin(turn), np.sin(turn)
        pose[:3, :3] = one @ pose[:3, :3]
    middle = board.points.mean(axis=0)
    pose[:3, 3] = np.asarray(center, float) - pose[:3, :3] @ middle
    return pose


class Renderer:
    """Renders one board; the print's pixels are area samples of exact edges."""

    def __init__(self, board: Board, *, pixels_per_m: float = 6000.0):
        import cv2

        self._cv2 = cv2
        self.scale = pixels_per_m
        self.margin = 0.012
        self.image, self.origin = texture(board, pixels_per_m, self.margin)

    def render(self, camera: mvtop.Camera, world_from_board, *, hide=None, noise=1.5, seed=0):
        """(H, W) uint8 as the camera sees it.

        - hide: box x0, y0, x1, y1 in px that something covers
        """
        cv2 = self._cv2
        width, height = camera.size
        # Where lines of sight meet the board is smooth: it is computed at pixels, and interpolated.
        grid = np.stack(np.meshgrid(np.arange(-1.0, width + 1), np.arange(-1.0, height + 1)), -1)
        board_from_cam = np.linalg.inv(world_from_board) @ camera.world_from_cam
        directions = camera.unproject(grid) @ board_from_cam[:3, :3].T
        origin = board_from_cam[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = -origin[2] / directions[..., 2]
            hits = origin[:2] + along[..., None] * directions[..., :2]
        hits = np.where((along > 0)[..., None] & np.isfinite(hits), hits, -1e3)
        at = np.float32(np.clip(hits * self.scale + self.origin - 0.5, -1e4, 3e4))
        size = ((width + 2) * FINE, (height + 2) * FINE)
        at = cv2.resize(at, size, interpolation=cv2.INTER_LINEAR)
        shown = cv2.remap(self.image, at, None, cv2.INTER_LINEAR, borderValue=BACKGROUND)
        shown = cv2.resize(
            shown.astype(np.float32), (width + 2, height + 2), interpolation=cv2.INTER_AREA
        )
        image = shown[1:-1, 1:-1]
        image = self._cv2.GaussianBlur(image, (0, 0), 0.7)
        if hide is not None:
            x0, y0, x1, y1 = hide
            image[y0:y1, x0:x1] = 120
        image += np.random.default_rng(seed).normal(size=image.shape) * noise
        return np.clip(np.round(image), 0, 255).astype(np.uint8)


def rig_of_three():
    """Cameras a metre from the origin: pinhole of 5 and of 8 coefficients, and a fisheye that is
    nearer."""
    return [
        mvtop.Camera(
            [[700, 0, 322], [0, 702, 238], [0, 0, 1]],
            (640, 480),
            distortion=[-0.2, 0.08, 0.001, -0.0005, -0.01],
            id="left",
            world_from_cam=look_at([-0.4, -0.2, -0.9], [0, 0, 0]),
        ),
        mvtop.Camera(
            [[690, 0, 318], [0, 690, 243], [0, 0, 1]],
            (640, 480),
            distortion=[0.1, -0.2, 0.001, 0.0005, 0.1],
            id="right",
            world_from_cam=look_at([0.45, -0.1, -0.85], [0, 0, 0], 5),
        ),
        mvtop.Camera(
            [[300, 0, 320], [0, 301, 238], [0, 0, 1]],
            (640, 480),
            model="fisheye",
            distortion=[0.02, -0.01, 0.003, -0.001],
            id="top",
            world_from_cam=look_at([0.05, -0.3, -0.45], [0, 0, 0], -10),
        ),
    ]
