"""Cameras of a rig file (docs/reference/rig-file.md), to render through; mvtop checks it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import asking_mvtop


@dataclass(frozen=True)
class Camera:
    """A pinhole: what is left of the camera when its images are undistorted."""

    id: str
    width: int
    height: int
    k: np.ndarray  # [3, 3], px
    cam_from_rig: np.ndarray  # [4, 4], m
    distorted: bool

    def at_width(self, width: int) -> "Camera":
        """The same camera with images at most `width` px wide."""
        scale = min(1.0, width / self.width)
        size = round(self.width * scale), round(self.height * scale)
        k = self.k.copy()
        for axis, (new, old) in enumerate(zip(size, (self.width, self.height), strict=True)):
            k[axis, axis] *= new / old
            k[axis, 2] = (k[axis, 2] + 0.5) * new / old - 0.5
        return Camera(self.id, *size, k, self.cam_from_rig, self.distorted)


def load(path: Path) -> list[Camera]:
    """All cameras; one sentence on what is wrong with the file otherwise."""
    with asking_mvtop("see docs/reference/rig-file.md"):
        import mvtop

        rig = mvtop.Rig.load(path)
    return [_straight(camera) for camera in rig.cameras]


def _straight(camera) -> Camera:
    k = camera.K.copy()
    bent = camera.model != "pinhole" or bool(camera.distortion.any()) or k[0, 1] != 0
    k[0, 1] = 0
    return Camera(camera.id, *camera.size, k, np.linalg.inv(camera.world_from_cam), bent)
