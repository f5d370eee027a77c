"""The rig and the robot: `hand_from_ref` of cameras on the hand, `base_from_ref` of cameras that
stand.

Frames: `base` the robot's base, `hand` its flange or tool, `ref` the rig's reference camera,
`board`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mvtop._printable import refused
from mvtop.calibration import _need, rigid
from mvtop.calibration.robot_poses import DIRECTIONS, RobotPoses

if TYPE_CHECKING:
    from numpy.typing import NDArray

EYES = ("hand", "base")
"""Cameras move with the hand and the board stands; or cameras stand and the hand moves the
board."""
LEAST_POSES = 4
LEAST_TURN_DEG = 5.0
"""Turns of the hand that fix nothing, between any two poses."""
CLEARER = 2.0
"""How many times better the best reading must fit than the next one."""
FAR_BETTER = 3.0
"""The stated reading is refused where another one fits so many times better: noise, which both
share, does not do that."""
FITS_DEG, FITS_SHARE = 3.0, 0.05
"""A reading fits whose median residuals are at most these: a turn, and a shift as a share of the
board's distance. Worn robots stay below; poses of other exposures are tens of degrees off."""
BAD, ROUNDS = 4.5, 4
"""Poses whose residual is beyond this many robust standard deviations are left out, one a round."""
LEAST_DEG, LEAST_MM = 0.05, 0.3
"""Residuals up to these are no fault of a pose."""


@dataclass(frozen=True)
class PoseResidual:
    """How far the board is from where all poses together have it."""

    exposure: str
    turn_deg: float
    shift_mm: float
    used: bool
    """False of a pose that does not fit, and was left out."""


@dataclass(frozen=True, eq=False)
class HandEye:
    """How cameras and robot stand to each other."""

    eye: str
    """"hand" or "base"."""
    rotation: str
    """The reading of the robot's poses that is consistent: of the rotation, direction and unit."""
    direction: str
    unit: str
    world_from_ref: NDArray[np.float64]
    """(4, 4): hand_from_ref, or base_from_ref."""
    board_pose: NDArray[np.float64]
    """(4, 4): base_from_board, or hand_from_board."""
    residuals: list[PoseResidual]
    turn_sd_deg: float
    """Standard deviations of `world_from_ref`, in the worst direction."""
    shift_sd_mm: float
    next_best: str
    """What the next best reading would be, and how far it is off; "" where there is none."""
    found: bool
    """Whether any part of the reading was found rather than said."""

    def reading(self) -> str:
        """The reading in words."""
        where = {"hand": "cameras on the hand", "base": "cameras that stand"}[self.eye]
        return f"{where}; rotations are {self.rotation}, poses {self.direction}, in {self.unit}"


def solve(
    ref_from_board: dict[str, NDArray[np.float64]],
    poses: RobotPoses,
    *,
    eye: str | None = None,
    rotation: str | None = None,
    direction: str | None = None,
    unit: str | None = None,
) -> HandEye:
    """The place of the rig on the robot.

    - ref_from_board: (4, 4) by exposure, of those that show the board
    - poses: by the same exposures
    - eye, rotation, direction, unit: what is known; of eye and direction one must be, the rest is
      found by which reading fits

    Raises ValueError where poses do not fix it, no reading fits, several fit alike, or one that
    contradicts what is known fits far better.
    """
    if eye is not None and eye not in EYES:
        raise refused(f"eye: expected {' or '.join(EYES)}, got {eye!r}")
    left = poses.readings(rotation, direction, unit)
    allowed = {_Reading(*names) for names in product([eye] if eye else EYES, *left)}
    common = [name for name in ref_from_board if name in poses.numbers]
    if len(common) < LEAST_POSES:
        raise refused(
            f"{len(common)} exposures have both a board and a robot pose, expected "
            f"{LEAST_POSES} or more; "
            f"exposures: {_some(list(ref_from_board))}; poses: {_some(list(poses.numbers))}; "
            f"fix: name "
            "poses after exposures"
        )
    if not eye and not (direction or poses.direction):
        # Cameras that stand and poses in one direction look as cameras on the hand and the other
        # direction.
        raise ValueError(
            "images alone do not tell cameras on the hand from cameras that stand; fix: say "
            "--eye hand or "
            "--eye base, by which the direction of the poses is found, or --direction, by which "
            "the eye is"
        )
    boards = [ref_from_board[name] for name in common]
    said = (eye, rotation or poses.rotation, direction or poses.direction, unit or poses.unit)
    tried = _tried(poses, common, boards)
    tried.sort(key=lambda t: (not t.fits, t.size, t.reading not in allowed))
    own = [t for t in tried if t.reading in allowed]
    _check_fits(own[0] if own else None, tried, said, poses)
    best, other = own[0], ""
    if len(own) > 1:
        other = f"{own[1].reading}: {own[1].size / best.size:.0f} times as far off"
        if own[1].fits and own[1].size < CLEARER * best.size:
            raise refused(
                f"two readings of the robot's poses fit alike, {best.reading} and "
                f"{own[1].reading}; fix: say which with --eye, --rotation, --direction or --unit, "
                f"or add poses that are turned more"
            )
    reading, fit = best.reading, best.fit
    world, board, used, sd = fit.world_from_ref, fit.board, fit.used, fit.sd
    of_poses = [
        PoseResidual(name, float(turn), float(shift), bool(ok))
        for name, (turn, shift), ok in zip(common, fit.off, used, strict=True)
    ]
    return HandEye(*reading, world, board, of_poses, *sd, other, not all(said))


@dataclass(eq=False)
class _Fit:
    world_from_ref: NDArray[np.float64]
    board: NDArray[np.float64]
    off: NDArray[np.float64]
    """(N, 2), degrees and mm."""
    used: NDArray[np.bool_]
    sd: tuple[float, float]


class _Reading(NamedTuple):
    eye: str
    rotation: str
    direction: str
    unit: str

    def __str__(self) -> str:
        return ", ".join(self)


@dataclass(frozen=True, eq=False)
class _Trial:
    reading: _Reading
    fit: _Fit
    distance: float
    """Of the board from the rig, median, metres."""

    @property
    def off(self) -> tuple[float, float]:
        """Median of residuals, degrees and mm."""
        turn, shift = np.median(self.fit.off, axis=0)
        return float(turn), float(shift)

    @property
    def size(self) -> float:
        """One number for how far the fit is off: a turn, radians, and a shift as a share of the
        distance. What is no fault of a pose counts as that."""
        turn, shift = np.maximum(self.off, [LEAST_DEG, LEAST_MM])
        return float(np.radians(turn) + 1e-3 * shift / self.distance)

    @property
    def fits(self) -> bool:
        turn, shift = self.off
        return turn <= FITS_DEG and shift <= self.most_mm

    @property
    def most_mm(self) -> float:
        return 1e3 * FITS_SHARE * self.distance

    def __str__(self) -> str:
        turn, shift = self.off
        return f"{turn:.3f} degrees and {shift:.2f} mm"


_ALIKE = tuple(
    (("hand", direction), ("base", other)) for direction, other in (DIRECTIONS, DIRECTIONS[::-1])
)
"""Eyes and directions by which poses say the same: as they are written, and inverted."""


def _tried(
    poses: RobotPoses, names: Sequence[str], boards: Sequence[NDArray[np.float64]]
) -> list[_Trial]:
    """All readings that the numbers allow, whatever is said of them; none where turns fix
    nothing."""
    distance = float(np.median([np.linalg.norm(board[:3, 3]) for board in boards]))
    numbers = replace(poses, rotation=None, direction=None, unit=None)
    rotations, _, units = numbers.readings()
    tried = []
    for rotation, unit in product(rotations, units):
        read = numbers.read(rotation, DIRECTIONS[0], unit)
        written = [read[name] for name in names]
        inverted = [rigid.inverse(pose) for pose in written]
        for moving, alike in zip((written, inverted), _ALIKE, strict=True):
            if (fit := _fit(moving, boards)) is not None:
                readings = [_Reading(eye, rotation, way, unit) for eye, way in alike]
                tried += [_Trial(reading, fit, distance) for reading in readings]
    return tried


def _check_fits(
    best: _Trial | None,
    tried: Sequence[_Trial],
    said: Sequence[str | None],
    poses: RobotPoses,
) -> None:
    """Refuses the stated reading where another one fits far better, or none fits.

    - best: of the stated readings; None where the hand rotates too little by these
    - tried: all readings, the best first
    """
    right = [t for t in tried if t.fits and t.fit is tried[0].fit]
    if right and (best is None or not best.fits or FAR_BETTER * right[0].size < best.size):
        changes = [_changes(t.reading, said, poses) for t in right]
        least = min(map(len, changes))
        fix = ", or ".join(" and ".join(change) for change in changes if len(change) == least)
        got = "one by which the hand hardly turns"
        if best is not None:
            got = f"{best.reading}, which is off by {best}"
        raise refused(
            f"reading of the robot's poses: expected {right[0].reading}, which fits to "
            f"{right[0]} in the median, got {got}; fix: {fix}"
        )
    if best is None:
        raise refused(
            f"the hand hardly turns between poses, expected turns of {LEAST_TURN_DEG:g} degrees "
            f"or more about two axes; fix: add poses with the hand tilted in several directions"
        )
    if not best.fits:
        raise refused(
            f"no reading of the robot's poses fits: expected at most {FITS_DEG:g} degrees and "
            f"{best.most_mm:.0f} mm in the median, got {tried[0]} by the best, "
            f"{tried[0].reading}; fix: give poses of the same exposures, by one clock, with a "
            f"board that does not move"
        )


def _changes(reading: _Reading, said: Sequence[str | None], poses: RobotPoses) -> list[str]:
    """What must be said otherwise for a reading."""
    of_file = (None, poses.rotation, poses.direction, poses.unit)
    return [
        f"{what} {value} in the poses' file" if stated else f"--{what} {value}"
        for what, value, known, stated in zip(reading._fields, reading, said, of_file, strict=True)
        if known and known != value
    ]


def _fit(
    moving: Sequence[NDArray[np.float64]], boards: Sequence[NDArray[np.float64]]
) -> _Fit | None:
    """Least squares over all poses that fit. None where turns fix nothing.

    base_from_hand · hand_from_ref · ref_from_board = base_from_board, the same for all; of
    cameras that stand, hand_from_base in place of base_from_hand, and base_from_ref in place of
    hand_from_ref.

    - moving: base_from_hand, or hand_from_base
    """
    used = np.ones(len(moving), bool)
    start = _closed_form(moving, boards)
    if start is None:
        return None
    world, fixed = start
    cov = np.zeros((12, 12))
    for _ in range(ROUNDS):
        chosen = [int(i) for i in np.flatnonzero(used)]
        world, fixed, cov = _least_squares(
            world, fixed, [moving[i] for i in chosen], [boards[i] for i in chosen]
        )
        off = _off(world, fixed, moving, boards)
        sigma = 1.4826 * np.median(off[used], axis=0)
        limit = np.maximum(BAD * sigma / 1.5, [LEAST_DEG, LEAST_MM])
        excess = (off / limit).max(axis=1)
        excess[~used] = 0
        if excess.max() <= 1 or used.sum() <= LEAST_POSES:
            break
        used[int(np.argmax(excess))] = False
    turn_sd = float(np.degrees(np.sqrt(np.linalg.eigvalsh(cov[:3, :3])[-1])))
    shift_sd = float(1e3 * np.sqrt(np.linalg.eigvalsh(cov[3:6, 3:6])[-1]))
    return _Fit(world, fixed, _off(world, fixed, moving, boards), used, (turn_sd, shift_sd))


def _closed_form(
    moving: Sequence[NDArray[np.float64]], boards: Sequence[NDArray[np.float64]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """X and Y of A_i X B_i = Y: rotations by relative turns (Park and Martin), then places."""
    pairs = [(i, j) for i in range(len(moving)) for j in range(i)]
    correlation = np.zeros((3, 3))
    turns = []
    for i, j in pairs:
        a = rigid.logarithm(moving[j][:3, :3].T @ moving[i][:3, :3])
        b = rigid.logarithm(boards[j][:3, :3] @ boards[i][:3, :3].T)
        correlation += np.outer(a, b)
        turns.append(a)
    spread = np.linalg.svd(np.array(turns), compute_uv=False) / np.sqrt(len(pairs))
    if np.degrees(spread[1]) < LEAST_TURN_DEG / 2:
        return None
    u, _, v = np.linalg.svd(correlation)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    rows, right = [], []
    for i, j in pairs:
        a = rigid.inverse(moving[j]) @ moving[i]
        b = boards[j] @ rigid.inverse(boards[i])
        rows.append(a[:3, :3] - np.eye(3))
        right.append(rotation @ b[:3, 3] - a[:3, 3])
    place = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    world = rigid.rigid(rotation, place)
    fixed = rigid.mean([m @ world @ b for m, b in zip(moving, boards, strict=True)])
    return world, fixed


def _differences(
    world: NDArray[np.float64],
    fixed: NDArray[np.float64],
    moving: Sequence[NDArray[np.float64]],
    boards: Sequence[NDArray[np.float64]],
) -> NDArray[np.float64]:
    """(N, 6): turn in radians and shift in metres of the board from where all have it, its own
    frame."""
    back = rigid.inverse(fixed)
    found = []
    for hand, board in zip(moving, boards, strict=True):
        difference = back @ hand @ world @ board
        found.append(np.r_[rigid.logarithm(difference[:3, :3]), difference[:3, 3]])
    return np.array(found)


def _off(*of: Any) -> NDArray[np.float64]:
    found = _differences(*of)
    turn = np.degrees(np.linalg.norm(found[:, :3], axis=1))
    return np.stack([turn, 1e3 * np.linalg.norm(found[:, 3:], axis=1)], axis=1)


def _least_squares(
    world: NDArray[np.float64],
    fixed: NDArray[np.float64],
    moving: Sequence[NDArray[np.float64]],
    boards: Sequence[NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """X, Y and the covariance (12, 12) of their turns and shifts, robust."""
    at = _differences(world, fixed, moving, boards)
    spread = np.maximum(1.4826 * np.median(np.abs(at).reshape(-1, 2, 3), axis=(0, 2)), [1e-7, 1e-7])
    weights = np.repeat(1 / spread, 3)

    def moved(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        scaled = x * np.tile(np.repeat(spread, 3), 2)
        one, two = scaled[:6], scaled[6:]
        return (
            rigid.rigid(rigid.exponential(one[:3]) @ world[:3, :3], world[:3, 3] + one[3:]),
            rigid.rigid(rigid.exponential(two[:3]) @ fixed[:3, :3], fixed[:3, 3] + two[3:]),
        )

    def residual(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return (_differences(*moved(x), moving, boards) * weights).ravel()

    found = _need.optimize().least_squares(residual, np.zeros(12), loss="soft_l1", f_scale=2.0)
    scale = np.tile(np.repeat(spread, 3), 2)
    freedom = max(len(found.fun) - 12, 1)
    variance = 2 * found.cost / freedom
    normal = found.jac.T @ found.jac
    covariance = np.linalg.pinv(normal) * variance * np.outer(scale, scale)
    return (*moved(found.x), covariance)


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
