"""Bundle adjustment: cameras, lenses and boards at once, by SciPy's `least_squares`.

Frames: `world` is the frame that the fixed camera stands still in; every board has a frame of its
own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop.calibration import _need, rigid
from mvtop.calibration.lenses import Kind, project

if TYPE_CHECKING:
    from numpy.typing import NDArray

POSE = 6
"""Numbers of a pose: a turn (rotation vector, radians) that follows, and a place (metres)."""
DAMPING = 1e-10
"""Of the preconditioner, as a share of each number's own curvature."""
MAX_STEPS = 40
"""Of one round."""
ROUNDS = 8
"""Greatest number of times that corners are weighed anew."""
DONE = 1e-4
"""Rounds end where the weighted sum of squares falls by less than this share."""
FIRST_STEP = 1e3
"""Length of the first step that is tried, in px of all corners together."""


@dataclass(frozen=True, eq=False)
class View:
    """What one camera sees of one board."""

    camera: int
    board: int
    points: NDArray[np.float64]
    """(N, 3), board frame, metres."""
    pixels: NDArray[np.float64]
    """(N, 2), px."""


@dataclass(eq=False)
class Bundle:
    """Cameras and boards as they are believed to be."""

    kinds: list[Kind]
    lenses: list[NDArray[np.float64]]
    """(kind.size,) of each camera."""
    cam_from_world: list[NDArray[np.float64]]
    world_from_board: list[NDArray[np.float64]]
    views: list[View]
    free_lens: list[bool]
    """Whether a camera's lens is adjusted."""
    fixed_camera: int | None = 0
    """The camera that stands still; None for all of them."""
    free_numbers: NDArray[np.bool_] | None = None
    """(n,), which numbers of free lenses are adjusted, by their place; all by default."""
    columns: list[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]] = field(
        default_factory=list
    )
    width: int = 0

    def residuals(self, view: View) -> NDArray[np.float64]:
        """(N, 2) px: projections less detections, at the bundle as it is."""
        cam_from_board = self.cam_from_world[view.camera] @ self.world_from_board[view.board]
        points = rigid.apply(cam_from_board, view.points)
        return project(self.kinds[view.camera], self.lenses[view.camera], points)[0] - view.pixels


@dataclass(frozen=True, eq=False)
class Adjusted:
    """What an adjustment knows of its result."""

    sigma: float
    """Robust standard deviation of a coordinate of a corner, px."""
    covariance: NDArray[np.float64]
    """(n, n), of all numbers that were adjusted."""
    columns: list[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]]
    """Of each view: where its lens, its camera's pose and its board's pose are in there."""
    cost: float


def adjust(bundle: Bundle, *, robust_px: float, covariance: bool = False) -> Adjusted:
    """Moves all that is free in `bundle`, in place, until projections fit.

    - robust_px: beyond it a residual counts by its length alone (Huber), px
    - covariance: whether it is computed; else it is empty
    """
    bundle.width, bundle.columns = _columns(bundle)
    if bundle.width:
        cost = np.inf
        for _ in range(ROUNDS):
            residuals = _residuals(bundle)
            spread = 1.4826 * float(np.median(np.abs(residuals)))
            limit = max(robust_px, 3 * spread)
            weights = _weights(residuals, limit)
            before = float(np.sum(weights * residuals**2))
            if before > (1 - DONE) * cost and limit == robust_px:
                break
            cost = _least_squares(bundle, weights)
    return _summarised(bundle, robust_px, covariance)


def _least_squares(bundle: Bundle, weights: NDArray[np.float64]) -> float:
    """Moves the bundle to the least weighted sum of squares, which it returns."""
    optimize = _need.optimize()
    from scipy.linalg import cholesky, solve_triangular
    from scipy.sparse.linalg import LinearOperator

    start = _snapshot(bundle)
    roots = np.sqrt(weights)
    normal, scale = _normal(_linear(bundle)[1], weights)
    # In numbers that are transformed by this factor the problem is nearly a sphere, so that the
    # inner solver needs a few steps.
    lower = cholesky(normal + DAMPING * np.eye(len(normal)), lower=True)
    # The first trust region is as wide as the start is long.
    origin = np.full(bundle.width, FIRST_STEP / np.sqrt(bundle.width))

    def linear(y: NDArray[np.float64]) -> NDArray[np.float64]:
        x: NDArray[np.float64] = scale * solve_triangular(lower, y, lower=True, trans="T")
        return x

    def residual(y: NDArray[np.float64]) -> NDArray[np.float64]:
        _place(bundle, start, linear(y - origin))
        return roots * _residuals(bundle)

    def jacobian(y: NDArray[np.float64]) -> Any:
        x = linear(y - origin)
        _place(bundle, start, x)
        matrix = _linear(bundle, x)[1].multiply(roots[:, None]).tocsr()
        return LinearOperator(
            matrix.shape,
            matvec=lambda v: matrix @ linear(np.ravel(v)),
            rmatvec=lambda u: solve_triangular(lower, scale * (matrix.T @ np.ravel(u)), lower=True),
            dtype=np.float64,
        )

    found = optimize.least_squares(
        residual,
        origin,
        jac=jacobian,
        method="trf",
        max_nfev=MAX_STEPS,
        ftol=1e-8,
        xtol=1e-12,
        gtol=1e-10,
    )
    _place(bundle, start, linear(found.x - origin))
    return 2 * float(found.cost)


def _summarised(bundle: Bundle, robust_px: float, covariance: bool) -> Adjusted:
    residuals = _residuals(bundle)
    sigma = 1.4826 * float(np.median(np.abs(residuals))) if len(residuals) else 0.0
    matrix = np.zeros((0, 0))
    if covariance and bundle.width:
        matrix = _covariance(bundle, robust_px)
    weights = _weights(residuals, robust_px)
    cost = float(np.sum(weights * residuals**2))
    return Adjusted(sigma, matrix, bundle.columns, cost)


def _columns(
    bundle: Bundle,
) -> tuple[int, list[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]]]:
    """The place of every number among those that are adjusted; -1 for what is not."""
    width = 0
    lenses, cameras, boards = {}, {}, {}
    for camera in sorted({view.camera for view in bundle.views}):
        places = np.full(bundle.kinds[camera].size, -1, np.intp)
        if bundle.free_lens[camera]:
            free = np.ones(len(places), bool)
            if bundle.free_numbers is not None:
                free = bundle.free_numbers[: len(places)]
            places[free] = width + np.arange(free.sum())
            width += int(free.sum())
        lenses[camera] = places
        places = np.full(POSE, -1, np.intp)
        if bundle.fixed_camera is not None and camera != bundle.fixed_camera:
            places[:] = width + np.arange(POSE)
            width += POSE
        cameras[camera] = places
    for board in sorted({view.board for view in bundle.views}):
        boards[board] = width + np.arange(POSE)
        width += POSE
    places_of = [(lenses[v.camera], cameras[v.camera], boards[v.board]) for v in bundle.views]
    return width, places_of


def _snapshot(bundle: Bundle) -> tuple[list[Any], list[Any], list[Any]]:
    return (
        [lens.copy() for lens in bundle.lenses],
        list(bundle.cam_from_world),
        list(bundle.world_from_board),
    )


def _place(
    bundle: Bundle, start: tuple[list[Any], list[Any], list[Any]], x: NDArray[np.float64]
) -> None:
    """The bundle at `start`, moved by `x`."""
    lenses, cameras, boards = start
    done: set[tuple[str, int]] = set()
    for view, (lens, camera, board) in zip(bundle.views, bundle.columns, strict=True):
        if ("camera", view.camera) not in done:
            done.add(("camera", view.camera))
            free = lens >= 0
            bundle.lenses[view.camera] = lenses[view.camera].copy()
            bundle.lenses[view.camera][free] += x[lens[free]]
            if camera[0] >= 0:
                moved = _moved(cameras[view.camera], x[camera])
                bundle.cam_from_world[view.camera] = moved
        if ("board", view.board) not in done:
            done.add(("board", view.board))
            bundle.world_from_board[view.board] = _moved(boards[view.board], x[board])


def _moved(transform: NDArray[np.float64], by: NDArray[np.float64]) -> NDArray[np.float64]:
    turned = rigid.exponential(by[:3]) @ transform[:3, :3]
    return rigid.rigid(turned, transform[:3, 3] + by[3:])


def _residuals(bundle: Bundle) -> NDArray[np.float64]:
    return np.concatenate([bundle.residuals(view).ravel() for view in bundle.views])


def _linear(
    bundle: Bundle, x: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], Any]:
    """Residuals (2N,) and their derivatives (2N, n), sparse.

    - x: how far the bundle was moved since the start of this adjustment; not at all by default
    """
    from scipy.sparse import csr_matrix

    values, indices, lengths, residuals = [], [], [], []
    for view, (lens_at, camera_at, board_at) in zip(bundle.views, bundle.columns, strict=True):
        cam_from_world = bundle.cam_from_world[view.camera]
        world_from_board = bundle.world_from_board[view.board]
        turned = view.points @ world_from_board[:3, :3].T
        in_world = turned + world_from_board[:3, 3]
        camera_turned = in_world @ cam_from_world[:3, :3].T
        in_camera = camera_turned + cam_from_world[:3, 3]
        kind = bundle.kinds[view.camera]
        pixels, by_point, by_lens = project(kind, bundle.lenses[view.camera], in_camera)
        parts, places = [], []
        free = lens_at >= 0
        if free.any():
            parts.append(by_lens[:, :, free])
            places.append(lens_at[free])
        if camera_at[0] >= 0:
            turn = -rigid.hat(camera_turned)
            if x is not None:
                turn = turn @ rigid.left_jacobian(x[camera_at[:3]])
            parts += [by_point @ turn, by_point]
            places.append(camera_at)
        turn = -rigid.hat(turned)
        if x is not None:
            turn = turn @ rigid.left_jacobian(x[board_at[:3]])
        by_world = by_point @ cam_from_world[:3, :3]
        parts += [by_world @ turn, by_world]
        places.append(board_at)
        block = np.concatenate(parts, axis=2).reshape(2 * len(pixels), -1)
        at = np.concatenate(places)
        values.append(block.ravel())
        indices.append(np.tile(at, len(block)))
        lengths.append(np.full(len(block), len(at)))
        residuals.append((pixels - view.pixels).ravel())
    pointers = np.concatenate([[0], np.cumsum(np.concatenate(lengths))])
    shape = (len(pointers) - 1, bundle.width)
    matrix = csr_matrix((np.concatenate(values), np.concatenate(indices), pointers), shape=shape)
    return np.concatenate(residuals), matrix


def _weights(residuals: NDArray[np.float64], robust_px: float) -> NDArray[np.float64]:
    """Huber's weights of squares."""
    weights: NDArray[np.float64] = np.minimum(
        1.0, robust_px / np.maximum(np.abs(residuals), 1e-300)
    )
    return weights


def _normal(
    matrix: Any, weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The normal matrix in numbers that each have a curvature of 1, and their scale."""
    normal = (matrix.T @ matrix.multiply(weights[:, None])).toarray()
    scale = 1 / np.sqrt(np.maximum(np.diagonal(normal), 1e-30))
    return scale[:, None] * normal * scale[None, :], scale


def _covariance(bundle: Bundle, robust_px: float) -> NDArray[np.float64]:
    """(n, n): the greater, in each variance, of two estimates.

    One takes all corners for independent; the other only views, as corners of one view err together
    (a board that is not flat, blur). Numbers that are not determined get huge variances.
    """
    residuals, matrix = _linear(bundle)
    weights = _weights(residuals, robust_px)
    normal, scale = _normal(matrix, weights)
    inverse = np.linalg.inv(normal + 1e-13 * np.eye(len(normal)))
    freedom = max(len(residuals) - len(normal), 1)
    plain = inverse * float(np.sum(weights * residuals**2) / freedom)
    scores, at = [], 0
    weighted = weights * residuals
    for view in bundle.views:
        rows = slice(at, at + 2 * len(view.points))
        at = rows.stop
        scores.append(scale * (matrix[rows].T @ weighted[rows]))
    stacked = np.array(scores)
    count = len(stacked)
    middle = stacked.T @ stacked * (count / max(count - 1, 1))
    clustered = inverse @ middle @ inverse
    grow = np.sqrt(np.maximum(np.diagonal(clustered) / np.diagonal(plain), 1.0))
    grown: NDArray[np.float64] = plain * grow[:, None] * grow[None, :] * np.outer(scale, scale)
    return grown
