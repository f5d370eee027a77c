"""Views as small canonical cameras, and their backbone features, computed once.

For comparing methods on two cores: every view becomes a virtual camera that looks at the middle
of its box with one focal length, so that also a method that is told nothing of the lens is well
posed; and the backbone is frozen, as in the paper, so that its features are computed only once
and a comparison trains nothing but transformer and heads.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from tqdm import tqdm

from ..data import bop, mvball
from ..data.boxes import amodal_boxes
from ..data.color import photometric

SIZE, FOCAL = 160, 496.0  # px: a ball of 0.12 m at 0.5 to 1 m is 60 to 119 px wide
K = np.array([[FOCAL, 0, SIZE / 2 - 0.5], [0, FOCAL, SIZE / 2 - 0.5], [0, 0, 1]])
BATCH = 64  # views through the backbone at once
BOXES_OF = amodal_boxes(mvball.bounding_points())


def look_at(direction: np.ndarray, roll: float) -> np.ndarray:
    """Rotation [3, 3] of the camera that has `direction` [3] on its axis, then rolled (rad)."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    upright = np.stack([x, np.cross(z, x), z])  # rows: new axes in the old frame
    cos, sin = np.cos(roll), np.sin(roll)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ upright


def canonical_view(image: bop.Image, rng: np.random.Generator, augment: bool, jitter=0.02):
    """(crop [SIZE, SIZE, 3] uint8, new_from_old [4, 4]) of one image.

    `jitter`: of the box that is looked at, in box sizes.
    """
    size = image.box[2:] - image.box[:2]
    center = (image.box[:2] + image.box[2:]) / 2 + rng.normal(0, jitter, 2) * size
    direction = np.linalg.inv(image.k) @ [*center, 1.0]
    roll = rng.uniform(-np.pi, np.pi) if augment else 0.0
    turn = look_at(direction, roll)
    new_from_old = np.eye(4)
    new_from_old[:3, :3] = turn
    homography = K @ turn @ np.linalg.inv(image.k)
    crop = cv2.warpPerspective(
        bop.read_rgb(image.path), homography, (SIZE, SIZE), borderValue=(127, 127, 127)
    )
    return (photometric(crop, rng) if augment else crop), new_from_old


@dataclass
class Cached:
    """Canonical views of a split. N views, S scenes.

    features [N, cells, C] float16; cam_from_world, cam_from_obj [N, 4, 4] m; shows [N];
    scenes: view numbers of each scene
    """

    features: torch.Tensor
    cam_from_world: np.ndarray
    cam_from_obj: np.ndarray
    shows: np.ndarray
    scenes: list[np.ndarray]

    def boxes(self, numbers: np.ndarray, rng: np.random.Generator, jitter=0.02) -> np.ndarray:
        """Jittered amodal boxes [..., 4] of views `numbers` [...], px."""
        boxes = BOXES_OF(K, self.cam_from_obj[numbers])
        extent = np.concatenate([boxes[..., 2:] - boxes[..., :2]] * 2, -1)
        return boxes + rng.normal(0, 1, boxes.shape).clip(-2.5, 2.5) * jitter * extent


@torch.no_grad()
def compute(scenes, model, levels: tuple[int, ...], copies: int, augment: bool, seed=0) -> Cached:
    """Backbone features of every image of `scenes`, each seen `copies` times."""
    config, features = model.config, []
    mean, std = np.array(config.mean, np.float32), np.array(config.std, np.float32)
    rng = np.random.default_rng(seed)
    images = [(number, image) for number, scene in enumerate(scenes) for image in scene] * copies
    turns = []
    for start in tqdm(range(0, len(images), BATCH), unit="batch", desc="features"):
        crops = []
        for _, image in images[start : start + BATCH]:
            crop, turn = canonical_view(image, rng, augment)
            crops.append((crop.astype(np.float32) / 255 - mean) / std)
            turns.append(turn)
        batch = torch.from_numpy(np.stack(crops)).permute(0, 3, 1, 2)
        batch = batch.contiguous(memory_format=torch.channels_last)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            maps = model.features.backbone(batch)
        tokens = [maps[level].flatten(2).transpose(1, 2) for level in levels]
        features.append(torch.cat(tokens, 1).half())
    scene_of = np.array([number for number, _ in images])
    turns = np.stack(turns)
    return Cached(
        torch.cat(features),
        turns @ np.stack([image.cam_from_world for _, image in images]),
        turns @ np.stack([image.cam_from_obj for _, image in images]),
        np.array([image.shows for _, image in images]),
        [np.flatnonzero(scene_of == number) for number in range(len(scenes))],
    )


def load_or_compute(path: Path, *args, **options) -> Cached:
    """`compute`, kept in a file."""
    if path.exists():
        return Cached(**torch.load(path, weights_only=False))
    cached = compute(*args, **options)
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(vars(cached), path)
    return cached
