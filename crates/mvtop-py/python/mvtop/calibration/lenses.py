"""Lenses as rig files have them, with derivatives for the adjustment.

Pixels and coefficients are OpenCV's. A lens is a row of numbers: fx, fy, cx, cy, then its
coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mvtop._printable import refused

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mvtop._mvtop import Camera

FOCAL = 4
"""How many numbers come before the coefficients: fx, fy, cx, cy."""


@dataclass(frozen=True)
class Kind:
    """A lens model with a number of coefficients."""

    name: str
    """As it is typed."""
    model: str
    """As a rig file names it: "pinhole" or "fisheye"."""
    coefficients: int

    @property
    def size(self) -> int:
        """Numbers of a lens of this kind."""
        return FOCAL + self.coefficients


KINDS = {
    kind.name: kind
    for kind in (
        Kind("pinhole", "pinhole", 5),
        Kind("pinhole8", "pinhole", 8),
        Kind("pinhole4", "pinhole", 4),
        Kind("ideal", "pinhole", 0),
        Kind("pinhole12", "pinhole", 12),
        Kind("fisheye", "fisheye", 4),
    )
}


def given(camera: Camera) -> tuple[Kind, NDArray[np.float64]]:
    """The kind and the numbers of a camera's lens.

    Raises ValueError for one that boards cannot be adjusted with.
    """
    used = int(np.flatnonzero(np.r_[1.0, camera.distortion])[-1])
    fitting = [k for k in KINDS.values() if k.model == camera.model and k.coefficients >= used]
    if camera.K[0, 1] or not fitting:
        what = "skew" if camera.K[0, 1] else f"{used} coefficients"
        raise refused(
            f"camera `{camera.id}`: {what} of a {camera.model} lens is more than boards are "
            f"adjusted "
            "with; expected no skew, and 12 coefficients at most"
        )
    kind = min(fitting, key=lambda k: k.coefficients)
    rest = np.zeros(max(0, kind.coefficients - len(camera.distortion)))
    distortion = np.r_[camera.distortion, rest][: kind.coefficients]
    return kind, np.r_[camera.K[[0, 1, 0, 1], [0, 1, 2, 2]], distortion]


def project(
    kind: Kind, lens: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Pixels of points, with derivatives.

    - lens: (kind.size,)
    - points: (N, 3), camera frame, any unit
    - returns: (N, 2) px; (N, 2, 3) their derivatives by the points; (N, 2, kind.size) by the lens
    """
    ideal, ideal_by_point = _flat(kind, points)
    bent, by_ideal, by_coefficient = _bend(kind, lens[FOCAL:], ideal)
    focal = lens[:2]
    by_lens = np.zeros((len(points), 2, kind.size))
    by_lens[:, 0, 0], by_lens[:, 1, 1] = bent[:, 0], bent[:, 1]
    by_lens[:, 0, 2] = by_lens[:, 1, 3] = 1.0
    by_lens[:, :, FOCAL:] = focal[None, :, None] * by_coefficient
    by_point = focal[None, :, None] * (by_ideal @ ideal_by_point)
    return bent * focal + lens[2:4], by_point, by_lens


def unbend(
    kind: Kind, lens: NDArray[np.float64], pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Where lines of sight meet the plane z = 1, by Newton's steps.

    - pixels: (N, 2)
    - returns: (N, 2); NaN for what has no such point
    """
    target = (pixels - lens[2:4]) / lens[:2]
    if kind.model == "fisheye":
        bent = np.hypot(target[:, 0], target[:, 1])
        angle = bent.copy()
        powers = np.arange(3, 3 + 2 * kind.coefficients, 2)
        for _ in range(20):
            high = angle[:, None] ** (powers - 1)
            value = angle * (1 + high @ lens[FOCAL:]) - bent
            angle = np.clip(angle - value / (1 + high @ (powers * lens[FOCAL:])), 0.0, np.pi)
        with np.errstate(invalid="ignore", divide="ignore"):
            scale = np.where(bent > 1e-12, np.tan(angle) / bent, 1.0)
        return np.where((angle < 0.49 * np.pi)[:, None], target * scale[:, None], np.nan)
    ideal = target.copy()
    for _ in range(20):
        bent, by_ideal, _ = _bend(kind, lens[FOCAL:], ideal)
        step = np.linalg.solve(by_ideal, (target - bent)[..., None])[..., 0]
        ideal = ideal + np.clip(step, -0.5, 0.5)
    bent = _bend(kind, lens[FOCAL:], ideal)[0]
    good = np.abs(bent - target).max(axis=1) < 1e-6
    return np.where(good[:, None], ideal, np.nan)


def _flat(
    kind: Kind, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What is bent: x/z, y/z of a pinhole; of a fisheye, the direction by its angle."""
    x, y, z = points.T
    by_point = np.zeros((len(points), 2, 3))
    if kind.model == "pinhole":
        # A point behind the camera would come from the other side; the adjustment only has to get
        # away.
        z = np.where(np.abs(z) < 1e-9, 1e-9, z)
        ideal = np.stack([x / z, y / z], axis=1)
        by_point[:, 0, 0] = by_point[:, 1, 1] = 1 / z
        by_point[:, :, 2] = -ideal / z[:, None]
        return ideal, by_point
    radius = np.hypot(x, y)
    square = np.maximum(radius**2 + z**2, 1e-300)
    angle = np.arctan2(radius, z)
    near = radius < 1e-9 * np.sqrt(square)
    safe = np.where(near, 1.0, radius)
    scale = np.where(near, 1 / np.sqrt(square), angle / safe)
    # Derivatives of angle/radius by radius and z.
    by_radius = np.where(near, 0.0, (z / square - angle / safe) / safe)
    by_z = np.where(near, -1 / square, -1 / square)
    unit_x, unit_y = np.where(near, 0.0, x / safe), np.where(near, 0.0, y / safe)
    by_point[:, 0, 0] = scale + x * by_radius * unit_x
    by_point[:, 0, 1] = x * by_radius * unit_y
    by_point[:, 1, 0] = y * by_radius * unit_x
    by_point[:, 1, 1] = scale + y * by_radius * unit_y
    by_point[:, 0, 2], by_point[:, 1, 2] = x * by_z, y * by_z
    return np.stack([x * scale, y * scale], axis=1), by_point


def _bend(
    kind: Kind, k: NDArray[np.float64], ideal: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Distortion: (N, 2), its derivatives (N, 2, 2) by `ideal`, (N, 2, n) by the coefficients."""
    x, y = ideal.T
    square = x**2 + y**2
    outer = ideal[:, :, None] * ideal[:, None, :]
    eye = np.eye(2)[None]
    by_k = np.zeros((len(ideal), 2, kind.coefficients))
    if kind.coefficients == 0:
        return ideal, np.broadcast_to(eye, (len(ideal), 2, 2)), by_k
    if kind.model == "fisheye":
        powers = np.stack([square ** (i + 1) for i in range(4)], axis=1)
        scale = 1 + powers @ k
        slope = np.stack([(i + 1) * square**i for i in range(4)], axis=1) @ k  # by square
        by_k[:] = ideal[:, :, None] * powers[:, None, :]
        by_ideal = scale[:, None, None] * eye + 2 * slope[:, None, None] * outer
        return ideal * scale[:, None], by_ideal, by_k
    full = np.zeros(12)
    full[: len(k)] = k
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = full
    top = 1 + square * (k1 + square * (k2 + square * k3))
    bottom = 1 + square * (k4 + square * (k5 + square * k6))
    scale = top / bottom
    top_slope = k1 + square * (2 * k2 + 3 * square * k3)
    bottom_slope = k4 + square * (2 * k5 + 3 * square * k6)
    slope = (top_slope - scale * bottom_slope) / bottom
    bent = ideal * scale[:, None]
    bent[:, 0] += 2 * p1 * x * y + p2 * (square + 2 * x**2) + s1 * square + s2 * square**2
    bent[:, 1] += p1 * (square + 2 * y**2) + 2 * p2 * x * y + s3 * square + s4 * square**2
    by_ideal = scale[:, None, None] * eye + 2 * slope[:, None, None] * outer
    prism_x, prism_y = 2 * (s1 + 2 * s2 * square), 2 * (s3 + 2 * s4 * square)
    by_ideal[:, 0, 0] += 2 * p1 * y + 6 * p2 * x + prism_x * x
    by_ideal[:, 0, 1] += 2 * p1 * x + 2 * p2 * y + prism_x * y
    by_ideal[:, 1, 0] += 2 * p1 * x + 2 * p2 * y + prism_y * x
    by_ideal[:, 1, 1] += 6 * p1 * y + 2 * p2 * x + prism_y * y
    everything = np.zeros((len(ideal), 2, 12))
    for i, power in ((0, 1), (1, 2), (4, 3)):
        everything[:, :, i] = ideal * (square**power / bottom)[:, None]
    for i, power in ((5, 1), (6, 2), (7, 3)):
        everything[:, :, i] = -ideal * (scale * square**power / bottom)[:, None]
    everything[:, 0, 2], everything[:, 1, 2] = 2 * x * y, square + 2 * y**2
    everything[:, 0, 3], everything[:, 1, 3] = square + 2 * x**2, 2 * x * y
    everything[:, 0, 8], everything[:, 0, 9] = square, square**2
    everything[:, 1, 10], everything[:, 1, 11] = square, square**2
    by_k[:] = everything[:, :, : kind.coefficients]
    return bent, by_ideal, by_k
