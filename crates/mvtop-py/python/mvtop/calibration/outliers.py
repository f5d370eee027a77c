"""Views that do not fit, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mvtop._printable import refused
from mvtop.calibration import initial, rigid, solve
from mvtop.calibration.adjust import Bundle, View
from mvtop.calibration.solve import Problem, board_alone, view_px

FACTOR, LEAST_PX = 4.0, 0.5
"""A view is an outlier beyond this many times the median view's residual, and beyond these px."""
WORST = 0.5
"""Boards that are off by this share of the worst one's px are left out with it. Others may seem
off as the worst one bent the lens."""
ROUNDS = 8
"""Greatest number of times that views are judged: by halves, 60 px come down to `LEAST_PX`."""


@dataclass(frozen=True)
class Outlier:
    """A view that was left out."""

    camera: str
    exposure: str
    px: float
    """Root mean square of its residuals among the others, px."""
    why: str

    def __str__(self) -> str:
        return f"exposure `{self.exposure}` of `{self.camera}`, {self.px:.1f} px off: {self.why}"


def leave_out(bundle: Bundle, problem: Problem) -> list[Outlier]:
    """Takes the views that do not fit out of an adjusted bundle, and adjusts it anew.

    The worst go first. Views that fit without them come back.

    Raises ValueError where a camera has no view that fits.
    """
    every, out = bundle.views, dict[View, Outlier]()
    for _ in range(ROUNDS):
        found = _judged(bundle, problem, every)
        inside = set(bundle.views)
        worst = {found[view].px for view in inside & found.keys()}
        limit = WORST * max(worst, default=0.0)
        boards = {view.board for view in inside & found.keys() if found[view].px >= limit}
        out = {v: why for v, why in found.items() if v not in inside or v.board in boards}
        kept = [view for view in every if view not in out]
        if set(kept) == inside:
            break
        for camera, name in enumerate(problem.cameras):
            if all(view.camera != camera for view in kept):
                why = next(why for view, why in out.items() if view.camera == camera)
                raise refused(f"camera `{name}`: all its views speak against the others; {why}")
        bundle.views = kept
        solve.settle(bundle)
    return list(out.values())


def _judged(bundle: Bundle, problem: Problem, every: list[View]) -> dict[View, Outlier]:
    """Those of all views that do not fit lenses and cameras as they are in the bundle."""
    px = dict(zip(bundle.views, view_px(bundle), strict=True))
    limit = max(FACTOR * float(np.median(list(px.values()))), LEAST_PX)
    found: dict[View, Outlier] = {}
    for board in sorted({view.board for view in every if px.get(view, np.inf) > limit}):
        views = [view for view in every if view.board == board]
        found |= _of_board(bundle, problem, views, limit)
    return found


def _of_board(
    bundle: Bundle, problem: Problem, views: list[View], limit: float
) -> dict[View, Outlier]:
    """Those of a board's views that do not fit; the others place the board."""
    out: dict[View, Outlier] = {}
    inside = list(views)
    alone = {}
    for view in views:
        own = rigid.inverse(bundle.cam_from_world[view.camera]) @ _pose(bundle, problem, view)
        alone[view], own_px = board_alone(bundle, [view], own)
        if own_px[0] > limit:
            inside.remove(view)
            why = "corners do not lie as on the board: blur, a reflection, or a board that is bent"
            out[view] = _outlier(problem, view, own_px[0], why)
    starts = [bundle.world_from_board[views[0].board], *(alone[view] for view in inside)]
    while inside:
        start = min(starts, key=lambda pose: sum(_px(bundle, view, pose) for view in inside))
        pose, px = board_alone(bundle, inside, start)
        if max(px) <= limit:
            bundle.world_from_board[views[0].board] = pose
            break
        if len(inside) == 2:
            for view, other in (inside, inside[::-1]):
                why = _moved(alone[view], alone[other], bundle, problem, view)
                off = _px(bundle, view, alone[other])
                why = f"{why} `{problem.cameras[other.camera]}` sees it; {_WHY}"
                out[view] = _outlier(problem, view, off, why)
            break
        rests = [[other for other in inside if other is not view] for view in inside]
        trials = [max(board_alone(bundle, rest, pose)[1]) for rest in rests]
        worst = inside.pop(int(np.argmin(trials)))
        pose, _ = board_alone(bundle, inside, start)
        why = f"{_moved(alone[worst], pose, bundle, problem, worst)} the other cameras see it; "
        out[worst] = _outlier(problem, worst, _px(bundle, worst, pose), why + _WHY)
    return out


_WHY = "the board moved between the images, one is turned, or they are of different moments"


def _pose(bundle: Bundle, problem: Problem, view: View) -> np.ndarray:
    """cam_from_board by the view alone, by the lens as it is."""
    camera = view.camera
    posed = initial.board_pose(bundle.kinds[camera], bundle.lenses[camera], view)
    return problem.poses[camera, view.board] if posed is None else posed[0]


def _px(bundle: Bundle, view: View, world_from_board: np.ndarray) -> float:
    """Root mean square of a view's residuals where its board is there, px."""
    kept = bundle.world_from_board[view.board]
    bundle.world_from_board[view.board] = world_from_board
    off = bundle.residuals(view)
    bundle.world_from_board[view.board] = kept
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _moved(
    own: np.ndarray, others: np.ndarray, bundle: Bundle, problem: Problem, view: View
) -> str:
    """How far a camera's own pose of the board is from that of others."""
    center = problem.told.board.points.mean(axis=0)[None]
    shift = float(np.linalg.norm(rigid.apply(own, center) - rigid.apply(others, center)))
    turn = rigid.angle_deg((rigid.inverse(own) @ others)[:3, :3])
    return f"it shows the board {1e3 * shift:.1f} mm and {turn:.1f} degrees from where"


def _outlier(problem: Problem, view: View, px: float, why: str) -> Outlier:
    return Outlier(problem.cameras[view.camera], problem.exposures[view.board], px, why)
