"""Cameras and pictures of virtual ones, in float64 by OpenCV's formulas: what Rust's must equal.

Slow and plain. The training has its own close-ups (`data/closeup.py`), of pinholes and in whole
numbers; here a camera has any lens, and a picture is as exact as its image.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from ..data.closeup import FILL, MAX_TAPS

SMOOTH = 4  # px of an image per pixel of a picture, from which on it is halved
SMALLER = 5  # times that an image is halved at most
UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-15)  # OpenCV stops early


@dataclass(frozen=True)
class Camera:
    """Frames and pixels as in docs/reference/rig-file.md."""

    id: str
    width: int
    height: int
    k: np.ndarray  # [3, 3], px
    world_from_cam: np.ndarray  # [4, 4], m
    params: tuple[float, ...] = ()  # OpenCV's distortion coefficients
    fisheye: bool = False
    max_angle_deg: float = 180.0  # from the optical axis; beyond it nothing is imaged

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels [..., 2] of points [..., 3] of the camera's frame; NaN beyond the lens."""
        project = cv2.fisheye.projectPoints if self.fisheye else cv2.projectPoints
        flat, none = np.ascontiguousarray(points).reshape(-1, 1, 3), np.zeros((3, 1))
        pixels, _ = project(flat, none, none, self.k, np.array(self.params))
        pixels = pixels.reshape(*points.shape[:-1], 2)
        return np.where(self._reaches(points)[..., None], pixels, np.nan)

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """Unit rays [..., 3] through pixels [..., 2]; NaN beyond the lens."""
        undistort = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        flat = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
        xy = undistort(flat, self.k, np.array(self.params), criteria=UNTIL)
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], -1).reshape(*pixels.shape[:-1], 3)
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.where(self._reaches(rays)[..., None], rays, np.nan)

    def _reaches(self, rays: np.ndarray) -> np.ndarray:
        angle = np.arctan2(np.linalg.norm(rays[..., :2], axis=-1), rays[..., 2])
        return angle <= np.deg2rad(self.max_angle_deg)

    def shows(self, pixels: np.ndarray) -> np.ndarray:
        """Whether pixels [..., 2] lie on the image [...]."""
        return ((pixels >= -0.5) & (pixels <= [self.width - 0.5, self.height - 0.5])).all(-1)


def load_rig(path: Path) -> list[Camera]:
    """The cameras of a rig file."""
    import mvtop  # loads its compiled part

    return [
        Camera(
            camera.id, *camera.size, camera.K, camera.world_from_cam,
            tuple(camera.distortion), camera.model == "fisheye", camera.max_angle_deg or 180.0,
        )
        for camera in mvtop.Rig.load(path).cameras
    ]  # fmt: skip


def rays_of_box(camera: Camera, box) -> np.ndarray:
    """Unit rays [5, 3] of a box: its middle, and its left, right, upper and lower side's."""
    x0, y0, x1, y1 = box
    xc, yc = (x0 + x1) / 2, (y0 + y1) / 2
    return camera.unproject(np.array([[xc, yc], [x0, yc], [x1, yc], [xc, y0], [xc, y1]]))


def closeup_of(real: Camera, box, size: int) -> tuple[Camera, np.ndarray, float]:
    """The virtual camera of a box [4] px, the box in its picture, and px of the image per pixel."""
    rays = rays_of_box(real, box)
    axis = np.cross(rays[0], [0, 0, 1])
    angle = np.arctan2(np.linalg.norm(axis), rays[0, 2])
    turn, _ = cv2.Rodrigues(axis / max(np.linalg.norm(axis), 1e-300) * angle)
    sides = rays[1:] @ turn.T
    bounds = (sides / sides[:, 2:])[[0, 2, 1, 3], [0, 1, 0, 1]]  # x0 y0 x1 y1, one unit ahead
    focal, middle = FILL * size / 2 / np.abs(bounds).max(), (size - 1) / 2
    k = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    pose = real.world_from_cam.copy()
    pose[:3, :3] = pose[:3, :3] @ turn.T
    step = max(box[2] - box[0], box[3] - box[1]) / (FILL * size)
    return Camera(real.id, size, size, k, pose), bounds * focal + middle, step


def seen_by(real: Camera, virtual: Camera, pixels: np.ndarray) -> np.ndarray:
    """Pixels [..., 2] of `real` at which it sees what `virtual`, at the same place, has at its."""
    real_from_virtual = real.world_from_cam[:3, :3].T @ virtual.world_from_cam[:3, :3]
    return real.project(virtual.unproject(pixels) @ real_from_virtual.T)


def half(rgb: np.ndarray) -> np.ndarray:
    """An image [H, W, 3] at half its size, of rounded means, without an odd last column or row."""
    height, width = (length // 2 for length in rgb.shape[:2])
    fours = rgb[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3).astype(np.uint16)
    return ((fours.sum((1, 3)) + 2) // 4).astype(np.uint8)


def picture_of(virtual: Camera, real: Camera, rgb: np.ndarray, step: float):
    """What `virtual` would have taken, of what `real` took (`rgb` [H, W, 3], uint8).

    A pixel is the mean of some bilinear samples; beyond the image its edge goes on. The image is
    halved while a pixel shows `SMOOTH` px of it or more (`step` at first).

    returns  [height, width, 3], as `rgb`; [height, width], whether a pixel's center lies on it
    """
    pixels = np.stack(np.meshgrid(np.arange(virtual.width), np.arange(virtual.height)), -1)
    scale = 1.0
    while step * scale >= SMOOTH and scale > 0.5**SMALLER and min(rgb.shape[:2]) >= 2:
        rgb, scale = half(rgb), scale / 2
    taps = int(np.clip(np.ceil(step * scale), 1, MAX_TAPS))
    source = torch.from_numpy(np.ascontiguousarray(rgb)).double().movedim(-1, 0)[None]
    last = np.array([rgb.shape[1] - 1, rgb.shape[0] - 1])
    offsets, total = (np.arange(taps) + 0.5) / taps - 0.5, 0
    for offset in np.stack(np.meshgrid(offsets, offsets), -1).reshape(-1, 2):
        places = (seen_by(real, virtual, pixels + offset) + 0.5) * scale - 0.5
        grid = torch.from_numpy(places / last * 2 - 1)[None]
        total = total + torch.nn.functional.grid_sample(
            source, grid, padding_mode="border", align_corners=True
        )
    on_image = real.shows(seen_by(real, virtual, pixels))
    return (total[0] / taps**2).movedim(0, -1).numpy(), on_image
