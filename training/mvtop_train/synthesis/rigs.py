"""Rigs to train for where no rig is given: any that a user might have."""

import numpy as np

from ..data.rig import Camera
from .scenes import rotation_of

CAMERAS = (3, 4)
FOCAL = (0.8, 1.9)  # of the image's width
DISTANCE = (3.0, 9.0)  # of the parts' diameter


def random_rig(rng: np.random.Generator, diameter: float, width: int) -> list[Camera]:
    """Cameras of one kind that look at about one place, from within a cap of up to 75 degrees."""
    height = round(width * 0.75)
    focal, distance = np.exp(rng.uniform(*np.log(FOCAL))), np.exp(rng.uniform(*np.log(DISTANCE)))
    spread = np.deg2rad(rng.uniform(12, 75))
    cameras = []
    for n in range(rng.integers(CAMERAS[0], CAMERAS[1] + 1)):
        f = focal * width * rng.uniform(0.97, 1.03)
        k = np.array([[f, 0, width / 2 - 0.5], [0, f, height / 2 - 0.5], [0, 0, 1.0]])
        k[:2, 2] += rng.normal(0, 0.01 * width, 2)
        # From the place that all look at: away by the distance, turned about it, rolled a little.
        tilt, around = spread * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
        axis = np.array([np.cos(around), np.sin(around), 0])
        roll = rng.normal(0, 0.25) if rng.random() < 0.8 else rng.uniform(-np.pi, np.pi)
        pose = np.eye(4)
        pose[:3, :3] = _turn([0, 0, 1], roll) @ _turn(axis, tilt)
        away = distance * diameter * focal * rng.uniform(0.8, 1.25)
        pose[:3, 3] = [*rng.normal(0, 0.08, 2) * away / focal, away]
        cameras.append(Camera(f"cam{n}", width, height, k, pose, False))
    return cameras


def _turn(axis, angle: float) -> np.ndarray:
    return rotation_of(np.array([np.cos(angle / 2), *np.sin(angle / 2) * np.asarray(axis)]))
