"""Close-ups: what a box shows, through a virtual camera of its own. Counterpart of
`mvtop-core/src/closeup.rs`.

The camera stands where the real one does, looks at the middle of the box, turned as little as
possible, and has the focal length at which the box's longer side fills `FILL` of the picture. So
the pose network sees every object in the same size and place, at the image's own resolution,
without the lens's distortion; in training, cameras are pinholes.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch

from ..network.rays import cell_centers
from . import bop, boxes
from .color import photometric

FILL = 0.6  # what the longer side of the box takes of the picture; the rest shows what is around
MAX_TAPS = 8  # samples along each axis of a pixel, against aliasing
# What a detector gets wrong, as standard deviations in box sizes.
SIDE_JITTER, SCALE_JITTER, SHIFT_JITTER = 0.02, 0.04, 0.04


@dataclass
class CloseUp:
    """A virtual pinhole camera. k [3, 3] px, close_from_cam [3, 3], box [4] in its picture, px."""

    k: np.ndarray
    close_from_cam: np.ndarray
    box: np.ndarray
    taps: int


def turn_to(direction: np.ndarray) -> np.ndarray:
    """The smallest rotation [3, 3] that takes the unit vector `direction` to the z axis."""
    x, y, z = direction
    skew = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])  # of direction x z
    return np.eye(3) + skew + skew @ skew / (1 + z)


def camera_of(k: np.ndarray, box: np.ndarray, size: int) -> CloseUp:
    """The close-up of `size` px a side of `box` [4] in an image of the pinhole `k` [3, 3]."""
    x0, y0, x1, y1 = box
    xc, yc = (x0 + x1) / 2, (y0 + y1) / 2
    pixels = np.array([[xc, yc], [x0, yc], [x1, yc], [xc, y0], [xc, y1]])
    rays = np.concatenate([pixels, np.ones((5, 1))], 1) @ np.linalg.inv(k).T
    turn = turn_to(rays[0] / np.linalg.norm(rays[0]))
    sides = rays[1:] @ turn.T
    left, right, top, bottom = sides[:, :2] / sides[:, 2:]
    reach = max(-left[0], right[0], -top[1], bottom[1])
    focal, middle = FILL * size / 2 / reach, (size - 1) / 2
    bounds = np.array([left[0], top[1], right[0], bottom[1]]) * focal + middle
    new_k = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    taps = int(np.ceil(max(x1 - x0, y1 - y0) / (FILL * size)))
    return CloseUp(new_k, turn, bounds, min(max(taps, 1), MAX_TAPS))


def take(rgb: np.ndarray, k: np.ndarray, close: CloseUp, size: int):
    """(picture [size, size, 3] uint8, on_image [size, size] bool) of a close-up.

    A pixel is the mean of `taps` x `taps` bilinear samples of `rgb`; `on_image` says whether its
    center lies on `rgb`.
    """
    close_from_image = close.k @ close.close_from_cam @ np.linalg.inv(k)
    n = close.taps
    finer = np.array([[n, 0, (n - 1) / 2], [0, n, (n - 1) / 2], [0, 0, 1]])
    picture = cv2.warpPerspective(
        rgb, finer @ close_from_image, (size * n, size * n), borderMode=cv2.BORDER_REPLICATE
    )
    if n > 1:
        picture = cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA)
    pixels = np.stack([*np.meshgrid(np.arange(size), np.arange(size)), np.ones((size, size))], -1)
    return picture, on_image(pixels, close_from_image, rgb.shape)


def on_image(pixels: np.ndarray, close_from_image: np.ndarray, shape) -> np.ndarray:
    """Whether pixels [..., 3] (u, v, 1) of a close-up lie on the image of `shape` (h, w, ...)."""
    source = pixels @ np.linalg.inv(close_from_image).T
    uv = source[..., :2] / source[..., 2:]
    end = np.array([shape[1], shape[0]]) - 0.5
    return ((uv >= -0.5) & (uv <= end)).all(-1) & (source[..., 2] > 0)


def jittered(box: np.ndarray, rng: np.random.Generator, strength: float) -> np.ndarray:
    """A box [4] as a detector might give it: shifted, scaled, each side off by a little."""
    width, height = size = box[2:] - box[:2]
    middle = (box[:2] + box[2:]) / 2 + rng.normal(0, SHIFT_JITTER * strength, 2) * size
    half = size / 2 * (1 + rng.normal(0, SCALE_JITTER * strength))
    sides = rng.normal(0, SIDE_JITTER * strength, 4) * np.array([width, height, width, height])
    return np.concatenate([middle - half, middle + half]) + sides


def make_view(image: bop.Image, config, bounds, rng: np.random.Generator, augment: bool) -> dict:
    """A close-up of `image` as a dict of arrays; see `collate`.

    Augmented, the real camera is rolled first (rigs hold theirs any way up), and the colors are.

    bounds  [n, 3] metres, the object's outermost points
    """
    rgb, size = bop.read_rgb(image.path), config.closeup
    roll, strength = 0.0, 0.5
    if augment:
        roll = rng.uniform(-np.pi, np.pi) if rng.random() < 0.3 else rng.normal(0, 0.3)
        strength = rng.uniform(0, 1.2)
    cos, sin = np.cos(roll), np.sin(roll)
    rolled = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    box = boxes.amodal_boxes(bounds)(image.k, _turned(rolled, image.cam_from_obj))
    close = camera_of(image.k, jittered(box, rng, strength), size)
    close.close_from_cam = close.close_from_cam @ rolled
    picture, seen = take(rgb, image.k, close, size)
    close_from_image = close.k @ close.close_from_cam @ np.linalg.inv(image.k)
    cells = cell_centers(config.decoder_shapes(), config.pose_strides).numpy()
    cells = np.concatenate([cells, np.ones((len(cells), 1))], 1)
    return {
        "image": photometric(picture, rng) if augment else picture,
        "on_image": seen,
        "inside": on_image(cells, close_from_image, rgb.shape),
        "k": close.k,
        "cam_from_world": _turned(close.close_from_cam, image.cam_from_world),
        "cam_from_obj": _turned(close.close_from_cam, image.cam_from_obj),
        "box": close.box,
    }


def _turned(rotation: np.ndarray, pose: np.ndarray) -> np.ndarray:
    out = pose.copy()
    out[:3] = rotation @ pose[:3]
    return out


def collate(views: dict) -> dict[str, torch.Tensor]:
    """Arrays [B, V, ...] of close-ups, by the names of `make_view`, as a batch.

    k, ref_from_cam, cam_from_obj, boxes_in, inside, and what there is of images with on_image, or
    features instead of them (`bank.py`).
    """
    cam_from_world = views["cam_from_world"]
    numbers = {
        "k": views["k"],
        "ref_from_cam": cam_from_world[:, :1] @ np.linalg.inv(cam_from_world),
        "cam_from_obj": views["cam_from_obj"],
        "boxes_in": views["box"],
        "inside": views["inside"],
    }
    batch = {name: torch.from_numpy(x.astype(np.float32)) for name, x in numbers.items()}
    for name, array in (("images", "image"), ("on_image", "on_image"), ("features", "features")):
        if array in views:
            batch[name] = torch.from_numpy(views[array])
    return batch


def collate_items(items: list[list[dict]]) -> dict[str, torch.Tensor]:
    """Scenes x views of `make_view` dicts as a batch."""
    return collate(
        {n: np.stack([[view[n] for view in views] for views in items]) for n in items[0][0]}
    )
