"""Rotations and rigid transforms as arrays: `a_from_b` is a 4x4 matrix, metres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

SMALL_ANGLE = 1e-7
"""Below it, radians, series are used in place of quotients."""


def hat(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) to (..., 3, 3): the matrix of the cross product."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*vectors.shape[:-1], 3, 3)


def exponential(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) rotation vector, radians, to (3, 3)."""
    angle = float(np.linalg.norm(vector))
    cross = hat(vector)
    if angle < SMALL_ANGLE:
        first, second = 1.0, 0.5
    else:
        first, second = np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2
    turned: NDArray[np.float64] = np.eye(3) + first * cross + second * cross @ cross
    return turned


def left_jacobian(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3): how a turn by `vector` changes with it, as a turn that follows."""
    angle = float(np.linalg.norm(vector))
    cross = hat(vector)
    if angle < SMALL_ANGLE:
        first, second = 1 / 2, 1 / 6
    else:
        first = (1 - np.cos(angle)) / angle**2
        second = (angle - np.sin(angle)) / angle**3
    changed: NDArray[np.float64] = np.eye(3) + first * cross + second * cross @ cross
    return changed


def logarithm(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) to (3,), radians, of length pi at most."""
    w, x, y, z = quaternion(rotation)
    vector: NDArray[np.float64] = np.array([x, y, z])
    length = float(np.linalg.norm(vector))
    if length < SMALL_ANGLE:
        return 2 * vector
    scaled: NDArray[np.float64] = vector * (2 * np.arctan2(length, w) / length)
    return scaled


def quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) to w, x, y, z with w >= 0."""
    r = rotation
    symmetric = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)],
        ]
    )
    x, y, z, w = np.linalg.eigh(symmetric / 3)[1][:, -1]
    q = np.array([w, x, y, z])
    return -q if w < 0 else q


def from_quaternion(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """w, x, y, z of any length above 0 to (3, 3)."""
    w, x, y, z = q / np.linalg.norm(q)
    cross = hat(np.array([x, y, z]))
    turned: NDArray[np.float64] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    return turned


def rigid(rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) of (3, 3) and (3,)."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, translation
    return transform


def inverse(transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """b_from_a of a_from_b."""
    turned = transform[:3, :3].T
    return rigid(turned, -turned @ transform[:3, 3])


def apply(transform: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3) points of b in a."""
    return points @ transform[:3, :3].T + transform[:3, 3]


def angle_deg(rotation: NDArray[np.float64]) -> float:
    """The angle of a turn (3, 3), degrees."""
    return float(np.degrees(np.linalg.norm(logarithm(rotation))))


def mean_rotation(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3, 3) to the rotation nearest their mean."""
    u, _, v = np.linalg.svd(rotations.mean(axis=0))
    mean: NDArray[np.float64] = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    return mean


def mean(transforms: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The mean of (4, 4) transforms that are near each other."""
    stack = np.array(transforms)
    return rigid(mean_rotation(stack[:, :3, :3]), stack[:, :3, 3].mean(axis=0))
