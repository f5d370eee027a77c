"""Crops at the network's scale, scaled, rolled and shifted at random: what a detector learns from,
and with it the backbone."""

from dataclasses import dataclass

import numpy as np

from . import bop
from .boxes import amodal_boxes
from .closeup import roll_by
from .color import photometric
from .views import VirtualCamera, warp


@dataclass
class Augmentation:
    """Ranges of the random virtual cameras and of the photometric changes.

    `scale` is that of inference, network px per image px; sizes vary around it.
    """

    scale: float
    diameter_px: tuple[float, float] = (57, 156)  # of the object in the image, times `scale`
    zoom: tuple[float, float] = (0.56, 1.25)  # crop px per image px, times `scale`
    jitter: float = 0.02  # of the box size, each of position and size
    negative_zoom: tuple[float, float] = (0.75, 1.6)  # of crops without the object, as `zoom`


def noisy(box: np.ndarray, rng: np.random.Generator, jitter: float) -> np.ndarray:
    """A box [4] with each side off by a little; `jitter`: standard deviation in box sizes."""
    extent = np.concatenate([box[2:] - box[:2]] * 2)
    return box + rng.normal(0, 1, 4).clip(-2.5, 2.5) * jitter * extent


@dataclass(frozen=True)
class Crops:
    """Chooses a crop, `size` px a side, in which the object is somewhere."""

    size: int
    aug: Augmentation

    def __call__(self, image: bop.Image, shape, bounds, rng, augment: bool) -> VirtualCamera:
        size, aug = self.size, self.aug
        center = (image.box[:2] + image.box[2:]) / 2
        diameter = (image.box[2:] - image.box[:2]).max()
        if not augment:
            zoom, roll, target = aug.scale, 0.0, size / 2 + rng.uniform(-0.05, 0.05, 2) * size
        else:
            wanted = np.exp(rng.uniform(*np.log(aug.diameter_px)))
            zoom = aug.scale * np.clip(wanted / diameter, *aug.zoom)
            roll = rng.uniform(-np.pi, np.pi) if rng.random() < 0.3 else rng.normal(0, 0.4)
            room = max(size / 2 - 0.42 * diameter * zoom, 4)
            target = size / 2 + rng.uniform(-room, room, 2)
        # The camera is turned, not the picture: with fx unlike fy these differ.
        turn = roll_by(roll)
        k = np.diag([zoom * image.k[0, 0], zoom * image.k[1, 1], 1.0])
        ray = turn @ np.linalg.inv(image.k) @ [*center, 1.0]
        k[:2, 2] = target - (k @ ray)[:2] / ray[2]
        turned = np.eye(4)
        turned[:3, :3] = turn
        box = amodal_boxes(bounds, k, turned @ image.cam_from_obj)
        return VirtualCamera(k, turn, size, noisy(box, rng, aug.jitter))


def negative_camera(image: bop.Image, shape, size: int, rng, aug: Augmentation, tries: int = 30):
    """crop_from_image [2, 3] of a random crop that does not touch the object's box.

    At least a third of it lies on the image (`shape`: height, width). None where there is no room.
    """
    extent = np.array(shape[::-1])
    x0, y0, x1, y1 = image.box
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    grid = (np.stack(np.meshgrid(*[np.arange(8)] * 2), -1).reshape(-1, 2) + 0.5) * size / 8 - 0.5
    for _ in range(tries):
        zoom = aug.scale * np.exp(rng.uniform(*np.log(aug.negative_zoom)))
        roll = rng.normal(0, 0.4)
        cos, sin = np.cos(roll), np.sin(roll)
        a = np.zeros((2, 3))
        a[:, :2] = zoom * np.array([[cos, -sin], [sin, cos]])
        a[:, 2] = (size - 1) / 2 - a[:, :2] @ rng.uniform(-0.5, extent - 0.5)
        box = corners @ a[:, :2].T + a[:, 2]
        apart = (box.max(0) < -0.5).any() or (box.min(0) > size - 0.5).any()
        source = (grid - a[:, 2]) @ np.linalg.inv(a[:, :2]).T
        inside = ((source >= -0.5) & (source <= extent - 0.5)).all(1).mean()
        if apart and inside >= 1 / 3:
            return a
    return None


def make_negative(scenes, crops: Crops, rng) -> dict | None:
    """image and on_image (as of views) of a crop without the object, for the detector alone;
    None where 20 images have no room."""
    for _ in range(20):
        scene = scenes[rng.integers(len(scenes))]
        image = scene[rng.integers(len(scene))]
        rgb = bop.read_rgb(image.path)
        a = negative_camera(image, rgb.shape[:2], crops.size, rng, crops.aug)
        if a is not None:
            picture, on_image = warp(rgb, np.vstack([a, [0, 0, 1]]), (crops.size, crops.size))
            return {"search_image": photometric(picture, rng), "search_on_image": on_image}
    return None
