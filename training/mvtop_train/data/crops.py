"""Random views of a scene through exact virtual cameras: the crops that a network learns from.

Every view is a crop at the network's scale, scaled and rolled at random: for a pinhole this is
another pinhole at the same place, so poses and lines of sight stay exact.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from . import bop
from .color import photometric

COORDINATE_STRIDE = 4


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


def virtual_camera(
    image: bop.Image, size: int, rng: np.random.Generator, aug: Augmentation, augment: bool
):
    """A crop as a new camera: (crop_from_image [2, 3] in px, k [3, 3], new_from_old [3, 3])."""
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
    cos, sin = np.cos(roll), np.sin(roll)
    turn = np.array([[cos, -sin], [sin, cos]])
    # The camera is turned, not the picture: with fx unlike fy these differ.
    focal = np.diag([image.k[0, 0], image.k[1, 1]])
    crop_from_image = np.zeros((2, 3))
    crop_from_image[:, :2] = zoom * focal @ turn @ np.linalg.inv(focal)
    crop_from_image[:, 2] = target - crop_from_image[:, :2] @ center
    k = np.eye(3)
    k[:2, :2] = zoom * focal
    k[:2, 2] = crop_from_image[:, :2] @ image.k[:2, 2] + crop_from_image[:, 2]
    new_from_old = np.eye(3)
    new_from_old[:2, :2] = turn
    return crop_from_image, k, new_from_old


def warp(rgb: np.ndarray, crop_from_image: np.ndarray, size: int) -> np.ndarray:
    grey = (127, 127, 127)  # never seen: `inputs.to_views` sets what is off the image to 0
    return cv2.warpAffine(
        rgb, crop_from_image, (size, size), flags=cv2.INTER_LINEAR, borderValue=grey
    )


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


def make_negative(scenes, size: int, rng, aug: Augmentation) -> dict | None:
    """A crop without the object, for the detector alone; None where 20 images have no room."""
    for _ in range(20):
        scene = scenes[rng.integers(len(scenes))]
        image = scene[rng.integers(len(scene))]
        rgb = bop.read_rgb(image.path)
        a = negative_camera(image, rgb.shape[:2], size, rng, aug)
        if a is not None:
            crop = photometric(warp(rgb, a, size), rng)
            return {
                "image": crop,
                "image_from_crop": cv2.invertAffineTransform(a),
                "image_size": np.array(rgb.shape[1::-1]),
            }
    return None


def make_view(image: bop.Image, size: int, rng, aug: Augmentation, augment: bool = True):
    """One view as a dict of arrays; see `network.views.Views` and `collate`."""
    rgb = bop.read_rgb(image.path)
    a, k, turn = virtual_camera(image, size, rng, aug, augment)
    crop = warp(rgb, a, size)
    if augment:
        crop = photometric(crop, rng)
    new_from_old = np.eye(4)
    new_from_old[:3, :3] = turn
    return {
        "image": crop,
        "k": k,
        "cam_from_world": new_from_old @ image.cam_from_world,
        "cam_from_obj": new_from_old @ image.cam_from_obj,
        "coords": coordinates(image, a, size),
        "image_from_crop": cv2.invertAffineTransform(a),
        "image_size": np.array(rgb.shape[1::-1]),
        "box_noise": rng.normal(0, 1, 4).clip(-2.5, 2.5),
    }


def coordinates(image: bop.Image, crop_from_image: np.ndarray, size: int) -> np.ndarray:
    """Coded object coordinates [cells, cells, 3], one per COORDINATE_STRIDE px, at the center of
    its block; 0 off the object, and everywhere if the data set has none."""
    cells = size // COORDINATE_STRIDE
    if image.coords_path is None:
        return np.zeros((cells, cells, 3), np.uint8)
    code = bop.read_rgb(image.coords_path)
    shift = crop_from_image.copy()
    if image.visible_box is not None:
        shift[:, 2] += shift[:, :2] @ image.visible_box[:2]
    s = 1 / COORDINATE_STRIDE
    shift[:, 2] = (shift[:, 2] + 0.5) * s - 0.5
    shift[:, :2] *= s
    return cv2.warpAffine(code, shift, (cells, cells), flags=cv2.INTER_NEAREST)
