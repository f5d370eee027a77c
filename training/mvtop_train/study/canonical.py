"""Canonical views: what comparisons of methods look at.

Every view is a small virtual camera that looks at the middle of its box with one focal length, so
that also a method that is told nothing of the lens is well posed.
"""

from dataclasses import dataclass

import numpy as np
from torch import nn

from ..data import bop
from ..data.boxes import amodal_boxes
from ..data.closeup import roll_by
from ..data.crops import noisy
from ..data.views import VirtualCamera

SIZE, FOCAL = 160, 496.0  # px: a ball of 0.12 m at 0.5 to 1 m is 60 to 119 px wide
K = np.array([[FOCAL, 0, SIZE / 2 - 0.5], [0, FOCAL, SIZE / 2 - 0.5], [0, 0, 1]])


def look_at(direction: np.ndarray) -> np.ndarray:
    """Rotation [3, 3] of the upright camera that has `direction` [3] on its axis."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])  # rows: new axes in the old frame


class Maps(nn.Module):
    """Some of a backbone's, for a bank."""

    def __init__(self, backbone: nn.Module, strides: tuple[int, ...], wanted: tuple[int, ...]):
        super().__init__()
        self.backbone, self.used = backbone, [strides.index(stride) for stride in wanted]

    def cache(self, images) -> list:
        maps = self.backbone(images)
        return [maps[i] for i in self.used]


@dataclass(frozen=True)
class Canonical:
    """Chooses the canonical view of an image; augmented, it is rolled.

    `jitter`: standard deviations, in box sizes, of where it looks and of the box's sides.
    """

    jitter: float = 0.02

    def __call__(self, image: bop.Image, shape, bounds, rng, augment: bool) -> VirtualCamera:
        extent = image.box[2:] - image.box[:2]
        center = (image.box[:2] + image.box[2:]) / 2 + rng.normal(0, self.jitter, 2) * extent
        roll = rng.uniform(-np.pi, np.pi) if augment else 0.0
        turned = np.eye(4)
        turned[:3, :3] = roll_by(roll) @ look_at(np.linalg.inv(image.k) @ [*center, 1.0])
        box = amodal_boxes(bounds, K, turned @ image.cam_from_obj)
        return VirtualCamera(K, turned[:3, :3], SIZE, noisy(box, rng, self.jitter))
