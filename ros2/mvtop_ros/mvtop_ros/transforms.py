"""Between 4x4 matrices and messages: `a_from_b` maps coordinates in frame b into frame a."""

import numpy as np
from geometry_msgs.msg import Pose, Transform


def rotation_of(quat_xyzw):
    """The matrix (3, 3) of a quaternion, which need not be of length 1."""
    q = np.asarray(quat_xyzw, np.float64)
    length = np.linalg.norm(q)
    if not np.isfinite(length) or not 0.5 < length < 2:
        raise ValueError(f"rotation: expected a unit quaternion, got {q.tolist()} as x, y, z, w")
    x, y, z, w = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation):
    """The unit quaternion x, y, z, w of a matrix (3, 3), w >= 0."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, np.float64)
    # The row of 4 q q^T whose diagonal is greatest is the most exact one.
    square = np.array(
        [
            [1 + a - e - i, b + d, c + g, h - f],
            [b + d, 1 - a + e - i, f + h, c - g],
            [c + g, f + h, 1 - a - e + i, d - b],
            [h - f, c - g, d - b, 1 + a + e + i],
        ]
    )
    q = square[np.argmax(np.diag(square))]
    q = q / np.linalg.norm(q)
    return -q if q[3] < 0 else q


def matrix(translation, quaternion, metres=1.0):
    """The matrix (4, 4) of a message's parts.

    - metres: per unit of the translation
    """
    pose = np.eye(4)
    pose[:3, :3] = rotation_of([quaternion.x, quaternion.y, quaternion.z, quaternion.w])
    pose[:3, 3] = np.array([translation.x, translation.y, translation.z]) * metres
    if not np.isfinite(pose).all():
        raise ValueError(f"translation: expected finite numbers, got {pose[:3, 3].tolist()}")
    return pose


def of_pose(message, metres=1.0):
    """The matrix of a `Pose`."""
    return matrix(message.position, message.orientation, metres)


def of_transform(message):
    """The matrix of a `Transform`."""
    return matrix(message.translation, message.rotation)


def to_pose(a_from_b, metres=1.0):
    """A `Pose`; its unit has as many metres."""
    message = Pose()
    _fill(message.position, message.orientation, a_from_b, metres)
    return message


def to_transform(a_from_b):
    """A `Transform`."""
    message = Transform()
    _fill(message.translation, message.rotation, a_from_b, 1.0)
    return message


def _fill(translation, quaternion, a_from_b, metres):
    translation.x, translation.y, translation.z = (float(x) / metres for x in a_from_b[:3, 3])
    x, y, z, w = quaternion_of(a_from_b[:3, :3])
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = map(float, (x, y, z, w))
