"""From what cameras see of a board to a bundle that is adjusted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from mvtop._printable import refused
from mvtop.calibration import initial, rigid
from mvtop.calibration.adjust import Adjusted, Bundle, View, adjust
from mvtop.calibration.lenses import Kind
from mvtop.calibration.observe import Observations

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROBUST_PX = 1.0
"""Beyond it a corner counts by its length alone, in the last adjustment at three standard
deviations."""
SIGMAS = 3.0
LEAST_ROBUST_PX = 0.1


@dataclass(eq=False)
class Problem:
    """Cameras and exposures by number, with their names."""

    told: Observations
    cameras: list[str]
    exposures: list[str]
    kinds: list[Kind]
    lenses: list[NDArray[np.float64]]
    free: list[bool]
    views: dict[tuple[int, int], View] = field(default_factory=dict)
    """By camera and exposure."""
    poses: dict[tuple[int, int], NDArray[np.float64]] = field(default_factory=dict)
    """cam_from_board by the view alone."""
    own_px: dict[tuple[int, int], float] = field(default_factory=dict)
    """Root mean square of residuals at that pose, px."""

    def name(self, key: tuple[int, int]) -> str:
        """How a view is called."""
        return f"exposure `{self.exposures[key[1]]}` of `{self.cameras[key[0]]}`"


def pose_views(
    told: Observations, kinds: Mapping[str, Kind], given: Mapping[str, NDArray[np.float64]]
) -> Problem:
    """Guesses every lens that is not given, and places the board before each camera by itself.

    Raises ValueError where no lens explains a camera's images.
    """
    exposures = sorted({key for by in told.found.values() for key in by})
    number = {key: i for i, key in enumerate(exposures)}
    cameras = told.cameras
    problem = Problem(told, cameras, exposures, [kinds[c] for c in cameras], [], [])
    for index, camera in enumerate(cameras):
        views = {}
        for key, detection in told.found[camera].items():
            points = told.board.points[detection.numbers]
            views[number[key]] = View(index, number[key], points, detection.pixels)
        problem.free.append(camera not in given)
        if camera in given:
            problem.lenses.append(given[camera].copy())
        else:
            try:
                found, _ = initial.lens(kinds[camera], told.sizes[camera], list(views.values()))
            except ValueError as error:
                raise refused(
                    f"camera `{camera}`: {error}; expected `{kinds[camera].name}`, fix: --lens "
                    f"fisheye "
                    "for wide lenses, and boards that are tilted and near"
                ) from None
            problem.lenses.append(found)
        for exposure, view in views.items():
            posed = initial.board_pose(problem.kinds[index], problem.lenses[index], view)
            if posed is None:
                continue
            problem.views[index, exposure] = view
            problem.poses[index, exposure], problem.own_px[index, exposure] = posed
    return problem


def turns(problem: Problem) -> list[NDArray[np.float64]]:
    """board_from_board, turns after which the board looks the same; the identity first."""
    board = problem.told.board
    found = [np.eye(4)]
    center = board.points.mean(axis=0)
    for order in board.alike:
        # The turn that brings points to where those of the other order are.
        u, _, v = np.linalg.svd((board.points - center).T @ (board.points[order] - center))
        turn = v.T @ np.diag([1, 1, np.linalg.det(v.T @ u.T)]) @ u.T
        found.append(rigid.rigid(turn, center - turn @ center))
    return found


def links(problem: Problem) -> list[initial.Link]:
    """Of each two cameras that both see the board in some exposure."""
    alike = turns(problem)
    found = []
    for a, b in combinations(range(len(problem.cameras)), 2):
        both = [e for (camera, e) in problem.poses if camera == a and (b, e) in problem.poses]
        if both:
            poses = [(problem.poses[a, e], problem.poses[b, e]) for e in both]
            found.append(initial.link(a, b, poses, alike))
    return found


def assemble(problem: Problem, placed: Sequence[NDArray[np.float64]], root: int) -> Bundle:
    """The bundle of all views, boards placed by the camera that sees each best.

    - placed: cam_from_world of each camera
    """
    alike = turns(problem)
    boards = []
    for exposure in range(len(problem.exposures)):
        seen = [c for (c, e) in problem.views if e == exposure]
        if not seen:
            boards.append(np.eye(4))
            continue
        best = max(seen, key=lambda c: len(problem.views[c, exposure].pixels))
        world_from_board = rigid.inverse(placed[best]) @ problem.poses[best, exposure]
        boards.append(world_from_board)
        for camera in seen:
            key = (camera, exposure)
            here = rigid.inverse(placed[camera]) @ problem.poses[key]
            off = [
                rigid.angle_deg((rigid.inverse(here @ t) @ world_from_board)[:3, :3]) for t in alike
            ]
            if turn := int(np.argmin(off)):
                _renumber(problem, key, problem.told.board.alike[turn - 1], alike[turn])
    views = [problem.views[key] for key in sorted(problem.views)]
    lenses = [lens.copy() for lens in problem.lenses]
    return Bundle(problem.kinds, lenses, list(placed), boards, views, problem.free, root)


def _renumber(
    problem: Problem,
    key: tuple[int, int],
    order: NDArray[np.intp],
    turn: NDArray[np.float64],
) -> None:
    """Takes a view of a board that looks the same after a turn for the other way round."""
    view = problem.views[key]
    detection = problem.told.found[problem.cameras[key[0]]][problem.exposures[key[1]]]
    points = problem.told.board.points[order[detection.numbers]]
    problem.views[key] = View(view.camera, view.board, points, view.pixels)
    problem.poses[key] = problem.poses[key] @ turn


def settle(bundle: Bundle, *, covariance: bool = False) -> Adjusted:
    """Adjusts twice, the second time with a robust limit from the first one's residuals."""
    first = adjust(bundle, robust_px=ROBUST_PX)
    limit = max(LEAST_ROBUST_PX, min(SIGMAS * first.sigma, ROBUST_PX))
    return adjust(bundle, robust_px=limit, covariance=covariance)


def view_px(bundle: Bundle) -> list[float]:
    """Root mean square of residuals of each view, px."""
    return [
        float(np.sqrt(np.mean(np.sum(bundle.residuals(view) ** 2, axis=1))))
        for view in bundle.views
    ]


def board_alone(
    bundle: Bundle, views: Sequence[View], start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], list[float]]:
    """world_from_board by some views of it, cameras as they are, and their residuals, px."""
    moved = [View(view.camera, 0, view.points, view.pixels) for view in views]
    free = [False] * len(bundle.kinds)
    small = Bundle(
        bundle.kinds, bundle.lenses, bundle.cam_from_world, [start.copy()], moved, free, None
    )
    adjust(small, robust_px=ROBUST_PX)
    return small.world_from_board[0], view_px(small)
