"""The rig and the robot: `hand_from_ref` of cameras on the hand, `base_from_ref` of cameras that
stand.

Frames: `base` the robot's base, `hand` its flange or tool, `ref` the rig's reference camera,
`board`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop.calibration import _need, rigid
from mvtop.calibration.robot_poses import RobotPoses

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

    Raises ValueError where poses do not fix it, several readings fit alike, or what is known
    contradicts the poses.
    """
    if eye is not None and eye not in EYES:
        raise ValueError(f"eye: expected {' or '.join(EYES)}, got {eye!r}")
    readings = poses.readings(rotation, direction, unit)
    common = [name for name in ref_from_board if name in poses.numbers]
    if len(common) < LEAST_POSES:
        raise ValueError(
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
    tried = []
    for reading in product([eye] if eye else EYES, *readings):
        read = poses.read(*reading[1:])
        hands = [read[name] for name in common]
        if (fit := _fit(reading[0], hands, boards)) is not None:
            tried.append((_size(fit, boards), reading, fit))
    if not tried:
        raise ValueError(
            f"the hand hardly turns between poses, expected turns of {LEAST_TURN_DEG:g} degrees "
            f"or more "
            "about two axes; fix: add poses with the hand tilted in several directions"
        )
    tried.sort(key=lambda t: t[0])
    size, reading, fit = tried[0]
    other = ""
    if len(tried) > 1:
        other = f"{', '.join(tried[1][1])}: {tried[1][0] / max(size, 1e-12):.0f} times as far off"
        if tried[1][0] < CLEARER * size:
            raise ValueError(
                f"two readings of the robot's poses fit alike, {', '.join(reading)} and "
                f"{', '.join(tried[1][1])}; fix: say which with --eye, --rotation, --direction "
                f"or --unit, or "
                "add poses that are turned more"
            )
    world, board, used, sd = fit.world_from_ref, fit.board, fit.used, fit.sd
    of_poses = [
        PoseResidual(name, float(turn), float(shift), bool(ok))
        for name, (turn, shift), ok in zip(common, fit.off, used, strict=True)
    ]
    return HandEye(reading[0], *reading[1:], world, board, of_poses, *sd, other, not all(said))


@dataclass(eq=False)
class _Fit:
    world_from_ref: NDArray[np.float64]
    board: NDArray[np.float64]
    off: NDArray[np.float64]
    """(N, 2), degrees and mm."""
    used: NDArray[np.bool_]
    sd: tuple[float, float]


def _size(fit: _Fit, boards: Sequence[NDArray[np.float64]]) -> float:
    """One number for how far a fit is off: shifts as a share of the board's distance, and turns,
    radians."""
    distance = float(np.median([np.linalg.norm(board[:3, 3]) for board in boards]))
    turn, shift = np.median(fit.off, axis=0)
    return float(np.radians(turn) + 1e-3 * shift / distance)


def _fit(
    eye: str, hands: Sequence[NDArray[np.float64]], boards: Sequence[NDArray[np.float64]]
) -> _Fit | None:
    """Least squares over all poses that fit. None where turns fix nothing.

    base_from_hand · hand_from_ref · ref_from_board = base_from_board, the same for all; of
    cameras that stand, hand_from_base in place of base_from_hand, and base_from_ref in place of
    hand_from_ref.
    """
    moving = list(hands) if eye == "hand" else [rigid.inverse(hand) for hand in hands]
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
