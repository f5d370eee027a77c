"""Random rotations and poses."""

import numpy as np


def turn(rng, *shape):
    """Random rotations, from QR of random matrices."""
    q, r = np.linalg.qr(rng.normal(size=(*shape, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=-2, axis2=-1))[..., None, :]
    q[..., 0] *= np.linalg.det(q)[..., None]
    return q


def pose(rng, *shape):
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., :3, :3] = turn(rng, *shape)
    matrix[..., :3, 3] = rng.normal(size=(*shape, 3))
    matrix[..., 3, 3] = 1
    return matrix
