"""Views that do not fit, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mvtop.calibration import rigid
from mvtop.calibration.adjust import Bundle, View
from mvtop.calibration.solve import Problem, board_alone, view_px

FACTOR, LEAST_PX = 4.0, 0.5
"""A view is an outlier beyond this many times the median view's residual, and beyond these px."""


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


def find(bundle: Bundle, problem: Problem) -> list[tuple[View, Outlier]]:
    """The views that speak against most others."""
    px = view_px(bundle)
    limit = max(FACTOR * float(np.median(px)), LEAST_PX)
    found = []
    for board in sorted({v.board for v, off in zip(bundle.views, px, strict=True) if off > limit}):
        views = [view for view in bundle.views if view.board == board]
        found += _of_board(bundle, problem, views, limit)
    return found


def _of_board(
    bundle: Bundle, problem: Problem, views: list[View], limit: float
) -> list[tuple[View, Outlier]]:
    start = bundle.world_from_board[views[0].board]
    out: list[tuple[View, Outlier]] = []
    inside = list(views)
    alone = {}
    for view in views:
        own = rigid.inverse(bundle.cam_from_world[view.camera]) @ _pose(problem, view)
        alone[view.camera], own_px = board_alone(bundle, [view], own)
        if own_px[0] > limit:
            inside.remove(view)
            why = "corners do not lie as on the board: blur, a reflection, or a board that is bent"
            out.append((view, _outlier(problem, view, own_px[0], why)))
    while len(inside) > 1:
        pose, px = board_alone(bundle, inside, start)
        if max(px) <= limit:
            return out
        trials = []
        for i in range(len(inside)):
            rest = inside[:i] + inside[i + 1 :]
            _, others = board_alone(bundle, rest, pose)
            trials.append((max(others), i))
        if len(inside) == 2:
            for view, off in zip(inside, px, strict=True):
                other = inside[1 - inside.index(view)]
                why = _moved(alone[view.camera], alone[other.camera], bundle, problem, view)
                name = problem.cameras[other.camera]
                out.append((view, _outlier(problem, view, off, f"{why} `{name}` sees it; {_WHY}")))
            return out
        worst = inside.pop(min(trials)[1])
        pose, _ = board_alone(bundle, inside, start)
        off = float(np.sqrt(np.mean(np.sum(_off(bundle, worst, pose) ** 2, axis=1))))
        why = _moved(alone[worst.camera], pose, bundle, problem, worst)
        out.append(
            (worst, _outlier(problem, worst, off, f"{why} the other cameras see it; {_WHY}"))
        )
    return out


_WHY = "the board moved between the images, or they are of different moments"


def _pose(problem: Problem, view: View) -> np.ndarray:
    return problem.poses[view.camera, view.board]


def _off(bundle: Bundle, view: View, world_from_board: np.ndarray) -> np.ndarray:
    kept = bundle.world_from_board[view.board]
    bundle.world_from_board[view.board] = world_from_board
    off = bundle.residuals(view)
    bundle.world_from_board[view.board] = kept
    return off


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
