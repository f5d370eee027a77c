"""First guesses: lenses, boards before single cameras, and how cameras stand to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mvtop.calibration import _need, rigid
from mvtop.calibration.adjust import Bundle, View, adjust
from mvtop.calibration.lenses import FOCAL, Kind, project, unbend

if TYPE_CHECKING:
    from numpy.typing import NDArray

FOCAL_GUESSES = {
    "pinhole": (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 6.0, 9.0),
    "fisheye": (0.2, 0.25, 0.3, 0.36, 0.43, 0.52, 0.62, 0.75, 0.9, 1.2),
}
"""In longer sides of the image."""
GUESS_VIEWS = 12
"""Views that a focal length is guessed by."""
GOOD_PX = 0.7
"""A lens that leaves residuals below this, median, is taken without trying further focal
lengths."""
AGREE_DEG, AGREE_SHARE = 4.0, 0.08
"""How far two exposures' opinions of how two cameras stand may be apart, degrees and as a share
of the distance of the board."""


def board_pose(
    kind: Kind, lens: NDArray[np.float64], view: View
) -> tuple[NDArray[np.float64], float] | None:
    """cam_from_board by one view, and the root mean square of its residuals, px.

    None where the corners fix none.
    """
    cv2 = _need.opencv()
    flat = unbend(kind, lens, view.pixels)
    good = np.isfinite(flat).all(axis=1) & (np.abs(flat).max(axis=1) < 20)
    if good.sum() < 4:
        return None
    points, seen = view.points[good], flat[good]
    poses = _planar(points, seen) if np.ptp(points[:, 2]) < 1e-9 else []
    if not poses and len(points) >= 6:
        ok, turn, place = cv2.solvePnP(points, seen, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
        poses = [rigid.rigid(cv2.Rodrigues(turn)[0], place.ravel())] if ok else []
    best = None
    for pose in poses:
        in_camera = rigid.apply(pose, view.points)
        if in_camera[:, 2].min() <= 0 and kind.model == "pinhole":
            continue
        off = project(kind, lens, in_camera)[0] - view.pixels
        rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        if np.isfinite(rms) and (best is None or rms < best[1]):
            best = pose, rms
    return best


def _planar(points: NDArray[np.float64], seen: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    opencv = _need.opencv()
    try:
        count, turns, places, _ = opencv.solvePnPGeneric(
            points, seen, np.eye(3), None, flags=opencv.SOLVEPNP_IPPE
        )
    except opencv.error:
        return []
    poses = []
    for turn, place in zip(turns[:count], places[:count], strict=True):
        ok_turn, ok_place = opencv.solvePnPRefineLM(
            points, seen, np.eye(3), None, turn.copy(), place.copy()
        )
        poses.append(rigid.rigid(opencv.Rodrigues(ok_turn)[0], ok_place.ravel()))
    return poses


def lens(
    kind: Kind, size: tuple[int, int], views: Sequence[View]
) -> tuple[NDArray[np.float64], float]:
    """A camera's lens by its own views, and the root mean square of residuals, px.

    - size: width and height of its images, px
    - views: whose `camera` and `board` are not looked at

    Raises ValueError where no focal length explains them.
    """
    width, height = size
    some = _spread(views)
    tried = []
    for share in FOCAL_GUESSES[kind.model]:
        guess = np.zeros(kind.size)
        guess[:FOCAL] = [share * max(size)] * 2 + [(width - 1) / 2, (height - 1) / 2]
        posed = [(view, pose) for view in some if (pose := board_pose(kind, guess, view))]
        if len(posed) < max(1, len(some) // 2):
            continue
        tried.append((float(np.median([rms for _, (_, rms) in posed])), share, guess))
    best = None
    for _, _, guess in sorted(tried, key=lambda t: t[:2])[:3]:
        found = _adjusted(kind, guess, views)
        if found is None:
            continue
        if best is None or found[1] < best[1]:
            best = found
        if best[1] < GOOD_PX:
            break
    if best is None:
        raise ValueError("no focal length explains what its images show of the board")
    return best


def _spread(views: Sequence[View]) -> list[View]:
    """The views with most corners, at most `GUESS_VIEWS`."""
    order = sorted(views, key=lambda view: -len(view.pixels))
    return order[:GUESS_VIEWS]


def _adjusted(
    kind: Kind, guess: NDArray[np.float64], views: Sequence[View]
) -> tuple[NDArray[np.float64], float] | None:
    """The lens that is reached from a guess: first its focal length, then all of it."""
    poses = [board_pose(kind, guess, view) for view in views]
    kept = [(v, p[0]) for v, p in zip(views, poses, strict=True) if p is not None]
    if not kept:
        return None
    moved = [View(0, i, view.points, view.pixels) for i, (view, _) in enumerate(kept)]
    bundle = Bundle(
        [kind], [guess.copy()], [np.eye(4)], [pose for _, pose in kept], moved, [True], None
    )
    stages = [2, FOCAL, FOCAL + min(2, kind.coefficients), kind.size]
    told = None
    try:
        for numbers in dict.fromkeys(stages):
            bundle.free_numbers = np.arange(kind.size) < numbers
            told = adjust(bundle, robust_px=2.0)
    except np.linalg.LinAlgError:
        return None
    if told is None or not np.isfinite(told.cost) or bundle.lenses[0][:2].min() <= 0:
        return None
    off = np.concatenate([bundle.residuals(view) for view in moved])
    return bundle.lenses[0], float(np.sqrt(np.median(np.sum(off**2, axis=1))))


@dataclass(frozen=True, eq=False)
class Link:
    """How two cameras stand, by the exposures that both see the board in."""

    first: int
    second: int
    first_from_second: NDArray[np.float64]
    agreeing: int
    """Exposures that say so."""
    of: int
    """Exposures that both see the board in."""


def link(
    first: int,
    second: int,
    poses: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
    turns: Sequence[NDArray[np.float64]],
) -> Link:
    """What most exposures agree on.

    - poses: cam_from_board of both cameras, of each exposure
    - turns: board_from_board, turns after which the board looks the same, the identity among them
    """
    told = []
    for exposure, (a, b) in enumerate(poses):
        for turn in turns:
            told.append((exposure, a @ turn @ rigid.inverse(b), float(np.linalg.norm(b[:3, 3]))))
    best: list[NDArray[np.float64]] = []
    for _, candidate, distance in told:
        near: dict[int, tuple[float, NDArray[np.float64]]] = {}
        for exposure, other, _ in told:
            difference = rigid.inverse(candidate) @ other
            angle = rigid.angle_deg(difference[:3, :3])
            shift = float(np.linalg.norm(difference[:3, 3])) / distance
            if angle < AGREE_DEG and shift < AGREE_SHARE:
                cost = angle / AGREE_DEG + shift / AGREE_SHARE
                if exposure not in near or cost < near[exposure][0]:
                    near[exposure] = (cost, other)
        if len(near) > len(best):
            best = [other for _, other in near.values()]
    return Link(first, second, rigid.mean(best), len(best), len(poses))


def spanning(count: int, root: int, links: Sequence[Link]) -> list[NDArray[np.float64] | None]:
    """cam_from_world of each camera, the world being the root's frame; None for what is not linked.

    Links on which most exposures agree are used first.
    """
    placed: list[NDArray[np.float64] | None] = [None] * count
    placed[root] = np.eye(4)
    order = sorted(links, key=lambda link: -link.agreeing)
    while True:
        for found in order:
            a, b = placed[found.first], placed[found.second]
            if a is not None and b is None:
                placed[found.second] = rigid.inverse(found.first_from_second) @ a
                break
            if b is not None and a is None:
                placed[found.first] = found.first_from_second @ b
                break
        else:
            return placed
