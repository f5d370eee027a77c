"""Close-ups: what a box shows, through a virtual camera of its own. Counterpart of
`mvtop-core/src/closeup.rs`.

The camera looks at the middle of the box, turned as little as possible, and has the focal length
at which the box's longer side fills `FILL` of the picture. So the pose network sees every object
in the same size and place, at the image's own resolution, without the lens's distortion; in
training, cameras are pinholes.
"""

from dataclasses import dataclass

import numpy as np

from . import bop, boxes
from .views import VirtualCamera

FILL = 0.6  # what the longer side of the box takes of the picture; the rest shows what is around
MAX_TAPS = 8  # samples along each axis of a pixel, against aliasing
# What a detector gets wrong, as standard deviations in box sizes.
SIDE_JITTER, SCALE_JITTER, SHIFT_JITTER = 0.02, 0.04, 0.04


def roll_by(angle: float) -> np.ndarray:
    """Rotation [3, 3] about the viewing direction, rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def turn_to(direction: np.ndarray) -> np.ndarray:
    """The smallest rotation [3, 3] that takes the unit vector `direction` to the z axis."""
    x, y, z = direction
    skew = np.array([[0, 0, -x], [0, 0, -y], [x, y, 0]])  # of direction x z
    return np.eye(3) + skew + skew @ skew / (1 + z)


def camera_of(k: np.ndarray, box: np.ndarray, size: int) -> VirtualCamera:
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
    return VirtualCamera(new_k, turn, size, bounds, min(max(taps, 1), MAX_TAPS))


def jittered(box: np.ndarray, rng: np.random.Generator, strength: float) -> np.ndarray:
    """A box [4] as a detector might give it: shifted, scaled, each side off by a little."""
    width, height = size = box[2:] - box[:2]
    middle = (box[:2] + box[2:]) / 2 + rng.normal(0, SHIFT_JITTER * strength, 2) * size
    half = size / 2 * (1 + rng.normal(0, SCALE_JITTER * strength))
    sides = rng.normal(0, SIDE_JITTER * strength, 4) * np.array([width, height, width, height])
    return np.concatenate([middle - half, middle + half]) + sides


def cut_box(bounds: np.ndarray, image: bop.Image, shape, rolled: np.ndarray) -> np.ndarray:
    """The box [4] of what an image (`shape`: height, width) shows of the object, as detectors give
    it, in the camera after a turn [3, 3]; px. Of what is beside the image, the whole box."""
    (turn, shift), end = (image.cam_from_obj[:3, :3], image.cam_from_obj[:3, 3]), shape[1::-1]
    seen = boxes.pixels(image.k, bounds @ turn.T + shift)
    cut = seen.clip(-0.5, np.array(end) - 0.5)
    if np.ptp(cut, axis=0).min() >= 1:
        seen = cut
    rays = np.concatenate([seen, np.ones((len(seen), 1))], 1) @ np.linalg.inv(image.k).T
    return boxes.around(boxes.pixels(image.k, rays @ rolled.T))


@dataclass(frozen=True)
class CloseUps:
    """Chooses the close-up, `size` px a side, of what a detector might make of the true box.

    Augmented, the real camera is rolled first: rigs hold theirs any way up.
    """

    size: int

    def __call__(self, image: bop.Image, shape, bounds, rng, augment: bool) -> VirtualCamera:
        roll, strength = 0.0, 0.5
        if augment:
            roll = rng.uniform(-np.pi, np.pi) if rng.random() < 0.3 else rng.normal(0, 0.3)
            strength = rng.uniform(0, 1.2)
        rolled = roll_by(roll)
        box = cut_box(bounds, image, shape, rolled)
        camera = camera_of(image.k, jittered(box, rng, strength), self.size)
        turn = camera.view_from_cam @ rolled
        return VirtualCamera(camera.k, turn, self.size, camera.box, camera.taps)
