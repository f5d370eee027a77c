"""The numbers of one pose of a robot, checked: rounding is accepted, mistakes are refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop._printable import refused

if TYPE_CHECKING:
    from numpy.typing import NDArray

TOLERANCE = 1e-3
"""How far a rotation may be from exact, as in rig files."""
LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_COUNTS = {"matrix": 9, "quaternion": 4}
_ANGLES = 3


def numbers(name: str, value: Any, *counts: int) -> NDArray[np.float64]:
    """Finite numbers, flat, as many as one of `counts`."""
    try:
        found = np.array(value, float).ravel()
    except (TypeError, ValueError):
        raise refused(f"pose `{name}`: expected numbers, got {value!r:.60}") from None
    if found.size not in counts:
        *most, last = map(str, counts)
        expected = f"{', '.join(most)} or {last}" if most else last
        raise refused(f"pose `{name}`: expected {expected} numbers, got {found.size}")
    if not np.isfinite(found).all():
        raise refused(f"pose `{name}`: expected finite numbers, got {value!r:.60}")
    return found


def pose(name: str, form: str, place: Any, turn: Any) -> NDArray[np.float64]:
    """Place and rotation in a row, of a form that `robot_poses.FORMS` names."""
    shift, turned = numbers(name, place, 3), numbers(name, turn, _COUNTS.get(form, _ANGLES))
    if form == "matrix":
        _check_rotation(name, turned.reshape(3, 3))
    if form == "quaternion" and abs((norm := np.linalg.norm(turned)) - 1) > TOLERANCE:
        raise refused(f"pose `{name}`: expected a quaternion of length 1, got {norm:.4f}")
    return np.concatenate([shift, turned])


def flat(name: str, value: Any) -> tuple[str, NDArray[np.float64]]:
    """The form and the row of numbers without names: a 4x4 matrix, or a place and a rotation."""
    found = numbers(name, value, 16, 7, 6)
    if found.size != 16:
        form = "quaternion" if found.size == 7 else "angles"
        return form, pose(name, form, found[:3], found[3:])
    matrix = found.reshape(4, 4)
    if not np.allclose(matrix[3], LAST_ROW, rtol=0, atol=1e-9):
        transposed = np.allclose(matrix[:, 3], LAST_ROW, rtol=0, atol=1e-9)
        fix = "transpose it, as it is written in columns" if transposed else "give a rigid pose"
        raise refused(
            f"pose `{name}`: expected a matrix with the last row [0, 0, 0, 1], got "
            f"{'a transposed one, ' if transposed else ''}{matrix[3].tolist()}; fix: {fix}"
        )
    return "matrix", pose(name, "matrix", matrix[:3, 3], matrix[:3, :3])


def _check_rotation(name: str, matrix: NDArray[np.float64]) -> None:
    determinant = float(np.linalg.det(matrix))
    off = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    if off <= TOLERANCE and abs(determinant - 1) <= TOLERANCE:
        return
    if off <= TOLERANCE and determinant < 0:
        got, fix = "a mirrored one", "use right-handed axes"
    else:
        got, fix = f"columns off by {off:.1e}", "take out scale and shear, and give all digits"
    raise refused(
        f"pose `{name}`: expected a rotation, orthonormal with determinant 1 within {TOLERANCE:g}, "
        f"got {got}, determinant {determinant:.4f}; fix: {fix}"
    )
