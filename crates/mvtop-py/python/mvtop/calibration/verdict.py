"""How good a calibration is: on exposures held out, by coverage, and by the print's scale."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mvtop.calibration import rigid
from mvtop.calibration.adjust import Bundle, View
from mvtop.calibration.solve import Problem, board_alone, settle

if TYPE_CHECKING:
    from numpy.typing import NDArray

FOLDS = 4
"""Every exposure is held out once, a quarter of them at a time."""
LEAST_EXPOSURES = 6
"""With fewer, none is held out."""
CELLS = (8, 6)
"""Of the image, for what boards covered."""
COVERED = 0.6
DEPTH_RATIO = 1.25
TILT_DEG = 15.0


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Boards of exposures that took no part: where one camera sees them, against what the rest
    says.

    With one camera the halves of the board are compared instead.
    """

    camera: str
    exposure: str
    turn_deg: float
    across_mm: float
    """Across the camera's line of sight."""
    along_mm: float
    """Along it: what one camera alone knows least."""
    distance_m: float
    px: float
    """Root mean square of the residuals at the others' pose, px."""


@dataclass(frozen=True)
class Coverage:
    """What a camera saw of its image and of the depth."""

    camera: str
    views: int
    image: float
    """Share of the image's cells with a corner of a board in them."""
    missing: str
    """Where there was none, in words; "" where little is missing."""
    nearest_m: float
    farthest_m: float
    tilt_deg: float
    """Greatest angle between two boards."""
    greatest_angle_deg: float
    """Of a corner, from the optical axis."""

    def advice(self) -> list[str]:
        """Sentences; none where all is well."""
        told = []
        if self.image < COVERED and self.missing:
            told.append(
                f"camera `{self.camera}`: boards covered {self.image:.0%} of the image; show "
                f"some at "
                f"{self.missing}"
            )
        if self.farthest_m < DEPTH_RATIO * self.nearest_m:
            told.append(
                f"camera `{self.camera}`: all boards were {self.nearest_m:.2f} to "
                f"{self.farthest_m:.2f} m away; show some nearer and farther"
            )
        return told


def coverage(bundle: Bundle, problem: Problem) -> list[Coverage]:
    """Of each camera, by the views in the bundle."""
    told = []
    for index, camera in enumerate(problem.cameras):
        views = [view for view in bundle.views if view.camera == index]
        width, height = problem.told.sizes[camera]
        cells = np.zeros(CELLS[::-1], bool)
        distances, normals, widest = [], [], 0.0
        for view in views:
            at = (view.pixels + 0.5) / [width, height] * CELLS
            column, row = np.clip(at.astype(int), 0, np.array(CELLS) - 1).T
            cells[row, column] = True
            cam_from_board = bundle.cam_from_world[index] @ bundle.world_from_board[view.board]
            points = rigid.apply(cam_from_board, view.points)
            distances.append(float(np.linalg.norm(points.mean(axis=0))))
            normals.append(cam_from_board[:3, 2])
            radius = np.hypot(points[:, 0], points[:, 1])
            widest = max(widest, float(np.degrees(np.arctan2(radius, points[:, 2])).max()))
        directions = np.array(normals)
        tilt = float(np.degrees(np.arccos(np.clip((directions @ directions.T).min(), -1, 1))))
        told.append(
            Coverage(
                camera,
                len(views),
                float(cells.mean()),
                _missing(cells),
                min(distances),
                max(distances),
                tilt,
                widest,
            )
        )
    return told


def _missing(cells: NDArray[np.bool_]) -> str:
    """The parts of a 3x3 image that have the fewest covered cells, in words."""
    rows, columns = (
        np.array_split(np.arange(cells.shape[0]), 3),
        np.array_split(np.arange(cells.shape[1]), 3),
    )
    names = [
        ["the top left", "the top", "the top right"],
        ["the left", "the middle", "the right"],
        ["the bottom left", "the bottom", "the bottom right"],
    ]
    bare = [
        names[i][j]
        for i, r in enumerate(rows)
        for j, c in enumerate(columns)
        if cells[np.ix_(r, c)].mean() < 0.34
    ]
    return ", ".join(bare[:-1]) + (" and " if bare[:-1] else "") + bare[-1] if bare else ""


def held_out(bundle: Bundle, problem: Problem) -> list[HeldOut]:
    """Errors on exposures that took no part, each of them held out once; none of few exposures."""
    boards = sorted({view.board for view in bundle.views})
    if len(boards) < LEAST_EXPOSURES:
        return []
    folds = min(FOLDS, len(boards))
    told = []
    for fold in range(folds):
        out = set(boards[fold::folds])
        kept = [view for view in bundle.views if view.board not in out]
        if not _fixed(bundle, kept):
            continue
        trial = copy(bundle)
        trial.lenses = [lens.copy() for lens in bundle.lenses]
        trial.cam_from_world = list(bundle.cam_from_world)
        trial.world_from_board = list(bundle.world_from_board)
        trial.views = kept
        settle(trial)
        for board in sorted(out):
            views = [view for view in bundle.views if view.board == board]
            told += _compare(trial, problem, views)
    return told


def _fixed(bundle: Bundle, views: list[View]) -> bool:
    """Whether enough is left to determine all cameras, linked as before."""
    cameras = {view.camera for view in bundle.views}
    if any(sum(v.camera == c for v in views) < 3 for c in cameras):
        return False
    group = {min(cameras)}
    by_board: dict[int, set[int]] = {}
    for view in views:
        by_board.setdefault(view.board, set()).add(view.camera)
    while True:
        more = {c for members in by_board.values() if members & group for c in members} - group
        if not more:
            return group == cameras
        group |= more


def _compare(trial: Bundle, problem: Problem, views: list[View]) -> list[HeldOut]:
    start = trial.world_from_board[views[0].board]
    told = []
    for view in views:
        rest = [other for other in views if other is not view]
        mine = view
        if len(problem.cameras) == 1:
            pair = _halves(view)
            if pair is None:
                continue
            mine, rest = pair[0], [pair[1]]
        if not rest:
            continue
        theirs, _ = board_alone(trial, rest, start)
        own, _ = board_alone(trial, [mine], start)
        center = problem.told.board.points.mean(axis=0)[None]
        in_camera = [
            rigid.apply(trial.cam_from_world[view.camera] @ pose, center)[0]
            for pose in (own, theirs)
        ]
        distance = float(np.linalg.norm(in_camera[1]))
        sight = in_camera[1] / distance
        shift = in_camera[0] - in_camera[1]
        along = float(shift @ sight)
        across = float(np.linalg.norm(shift - along * sight))
        turn = rigid.angle_deg((rigid.inverse(own) @ theirs)[:3, :3])
        trial.world_from_board[view.board] = theirs
        off = trial.residuals(mine)
        trial.world_from_board[view.board] = start
        px = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        names = problem.cameras[view.camera], problem.exposures[view.board]
        told.append(HeldOut(*names, turn, 1e3 * across, 1e3 * abs(along), distance, px))
    return told


def _halves(view: View) -> tuple[View, View] | None:
    """The left and the right half of what is seen of a board; None where a half is too small."""
    axis = int(np.argmax(np.ptp(view.points, axis=0)))
    left = view.points[:, axis] <= np.median(view.points[:, axis])
    if min(left.sum(), (~left).sum()) < 6:
        return None
    halves = [
        View(view.camera, view.board, view.points[side], view.pixels[side])
        for side in (left, ~left)
    ]
    widths = [np.linalg.svd(h.points - h.points.mean(axis=0), compute_uv=False) for h in halves]
    if any(w[1] < 0.1 * w[0] for w in widths):
        return None
    return halves[0], halves[1]
