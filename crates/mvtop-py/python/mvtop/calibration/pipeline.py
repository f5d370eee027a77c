"""`mvtop.calibrate`: images of a board in, a rig and a verdict on it out."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop._mvtop import Rig
from mvtop._printable import refused
from mvtop.calibration import (
    _need,
    images,
    initial,
    lenses,
    linked,
    observe,
    outliers,
    rigid,
    rigs,
    solve,
    verdict,
)
from mvtop.calibration.adjust import Adjusted, Bundle, adjust
from mvtop.calibration.boards import Board
from mvtop.calibration.lenses import KINDS, Kind
from mvtop.calibration.outliers import Outlier
from mvtop.calibration.scale import Scale, scale_of
from mvtop.calibration.solve import Problem
from mvtop.calibration.verdict import Coverage, HeldOut

if TYPE_CHECKING:
    from numpy.typing import NDArray

FOCAL_SD, FOCAL_DOUBT = 0.05, 0.01
"""A focal length is refused, and warned of, where its standard deviation is a greater share of
it."""
LEAST_TILT_DEG = 3.0
"""Between any two boards, where a lens is calibrated."""
PARALLEL_DEG = 12.0
"""Boards whose greatest angle is less are called parallel."""


@dataclass(frozen=True)
class CameraReport:
    """What a calibration knows of one camera. Standard deviations are against the reference
    camera."""

    camera: str
    views: int
    corners: int
    px: float
    """Root mean square of its residuals, px."""
    turn_sd_deg: float
    """Of its direction, about the worst axis, degrees; 0 of the reference."""
    shift_sd_mm: float
    """Of its place, in the worst direction, mm."""
    point_sd_mm: float
    """Of a point at the middle of the boards as this camera sees it, in the worst direction, mm."""
    focal_sd_px: float
    """Of fx; 0 where the lens was given."""
    center_sd_px: float
    """Of the principal point, in the worst direction."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A rig, and how good it is."""

    rig: Rig
    board: Board
    """As it was used: scaled where a measured length says so."""
    cameras: list[CameraReport]
    coverage: list[Coverage]
    outliers: list[Outlier]
    held_out: list[HeldOut]
    scale: Scale | None
    """Whether the print's size fits, where a length was measured."""
    warnings: list[str]
    world_from_board: dict[str, NDArray[np.float64]]
    """(4, 4), where the board was, by exposure; world as of the rig, metres."""
    observations: observe.Observations
    residuals: dict[tuple[str, str], NDArray[np.float64]]
    """(N, 2) px, projections less detections, by camera and exposure."""
    note: str
    """How names of files were taken; "" of arrays."""

    def text(self) -> str:
        """The verdict in words."""
        from mvtop.calibration.report import text

        return text(self)

    def to_dict(self) -> dict[str, Any]:
        """The verdict for programs, without images."""
        from mvtop.calibration.report import to_dict

        return to_dict(self)

    def page(self) -> str:
        """The verdict as an HTML page that holds its pictures."""
        from mvtop.calibration.page import page

        return page(self)

    def __repr__(self) -> str:
        return f"Calibration({len(self.cameras)} cameras, {len(self.world_from_board)} exposures)"


def calibrate(
    source: Mapping[str, Any] | str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    board: Board | str | os.PathLike[str] | Mapping[str, Any],
    *,
    lens: str | Mapping[str, str] = "pinhole",
    intrinsics: Rig | str | os.PathLike[str] | None = None,
    cameras: Iterable[str] | None = None,
    reference: str | None = None,
    world: str | None = None,
    layout: str | None = None,
    measured: float | None = None,
    hold_out: bool = True,
    trust_unit: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Calibration:
    """A rig from images of a board.

    - source: a folder or several, with EXPOSURE/CAMERA.png, CAMERA/EXPOSURE.png,
      CAMERA_NUMBER.png or a BOP scene; or images (paths or uint8 arrays, grey or RGB) by camera,
      each a mapping by exposure or a list with None for what is missing
    - board: a `Board`, a board file, or what one says
    - lens: "pinhole" (5 coefficients), "pinhole8", "pinhole4", "pinhole12", "ideal" or "fisheye";
      also by camera
    - intrinsics: a rig whose cameras' lenses are kept; of others, of its names, they are calibrated
    - cameras: ids of those that are wanted; all by default
    - reference: id of the reference camera, the first by default
    - world: the exposure whose board is the world frame; the reference camera's frame by default
    - layout: "exposure/camera", "camera/exposure" or "flat"; recognised by default
    - measured: a side of the print as measured, metres: its length replaces that of the board file
    - hold_out: whether exposures are held out for the verdict, which takes most of the time
    - trust_unit: as of Rig
    - progress: called with the numbers of images that are done, and of all

    Raises ValueError or OSError, one sentence, for what is refused; ModuleNotFoundError without
    the extra.
    """
    _need.opencv(), _need.optimize()
    board = _board(board)
    note = ""
    if isinstance(source, Mapping):
        sources = images.of_mapping(source)
    else:
        found = images.find(images.folders(source), layout=layout)
        sources, note = found.images, found.note
    sources = _wanted(sources, cameras)
    scale = None
    if measured is not None:
        scale = scale_of(board, measured)
        board = board.scaled(scale.factor)
    told = observe.observe(sources, board, progress=progress)
    kinds, given = _lenses(told, lens, intrinsics)
    observe.check_counts(told, given)
    problem = solve.pose_views(told, kinds, given)
    root = _number(told.cameras, reference) if reference else 0
    found_links = solve.links(problem)
    placed = initial.spanning(len(told.cameras), root, found_links)
    linked.check(problem, placed, root)
    bundle = solve.assemble(problem, [p for p in placed if p is not None], root)
    adjust(bundle, robust_px=solve.ROBUST_PX)
    left_out = outliers.leave_out(bundle, problem)
    adjusted = solve.settle(bundle, covariance=True)
    covered = verdict.coverage(bundle, problem)
    reports = [_report(bundle, problem, adjusted, i) for i in range(len(problem.cameras))]
    doubts = _check_focal(bundle, reports, covered)
    held = verdict.held_out(bundle, problem) if hold_out else []
    world_from_root = _world(problem, bundle, world)
    # Of lenses that are given, what boards covered does not matter.
    calibrated = [cover for cover, free in zip(covered, bundle.free_lens, strict=True) if free]
    warnings = doubts + [sentence for cover in calibrated for sentence in cover.advice()]
    warnings += _link_warnings(problem, found_links)
    rig, folded = rigs.make(problem, bundle, world_from_root, covered, root, trust_unit)
    boards = sorted({view.board for view in bundle.views})
    where = {problem.exposures[b]: world_from_root @ bundle.world_from_board[b] for b in boards}
    names = [(problem.cameras[v.camera], problem.exposures[v.board]) for v in bundle.views]
    residuals = {n: bundle.residuals(v) for n, v in zip(names, bundle.views, strict=True)}
    return Calibration(
        rig,
        board,
        reports,
        covered,
        left_out,
        held,
        scale,
        warnings + folded,
        where,
        told,
        residuals,
        note,
    )


def _board(board: Board | str | os.PathLike[str] | Mapping[str, Any]) -> Board:
    if isinstance(board, Board):
        return board
    if isinstance(board, Mapping):
        return Board.from_dict(dict(board))
    return Board.load(board)


def _number(cameras: Sequence[str], name: str) -> int:
    if name not in cameras:
        raise refused(f"no camera `{name}`; expected one of {', '.join(cameras)}")
    return list(cameras).index(name)


def _wanted(sources: images.Sources, cameras: Iterable[str] | None) -> images.Sources:
    if cameras is None:
        return dict(sorted(sources.items()))
    names = list(cameras)
    for name in names:
        _number(sorted(sources), name)
    return {name: sources[name] for name in names}


def _lenses(
    told: observe.Observations,
    lens: str | Mapping[str, str],
    intrinsics: Rig | str | os.PathLike[str] | None,
) -> tuple[dict[str, Kind], dict[str, NDArray[np.float64]]]:
    """The kind of each camera's lens, and the lenses that are given."""
    kinds = {}
    by_camera = dict.fromkeys(told.cameras, lens) if isinstance(lens, str) else dict(lens)
    for camera, name in by_camera.items():
        _number(told.cameras, camera)
        if name not in KINDS:
            raise refused(f"lens: expected one of {', '.join(KINDS)}, got {name!r}")
        kinds[camera] = KINDS[name]
    of_others = getattr(lens, "of_all", "pinhole")
    if of_others not in KINDS:
        raise refused(f"lens: expected one of {', '.join(KINDS)}, got {of_others!r}")
    for camera in told.cameras:
        kinds.setdefault(camera, KINDS[of_others])
    given = {}
    if intrinsics is not None:
        rig = intrinsics if isinstance(intrinsics, Rig) else Rig.load(Path(intrinsics))
        for own in rig.cameras:
            if own.id not in told.cameras:
                continue
            width, height = told.sizes[own.id]
            if own.size != (width, height):
                swapped = own.size == (height, width)
                fix = "width and height are swapped" if swapped else "use images of that size"
                raise refused(
                    f"camera `{own.id}`: its images are {width}x{height}, its intrinsics of "
                    f"{own.size[0]}x{own.size[1]}; {fix}"
                )
            kinds[own.id], given[own.id] = lenses.given(own)
        if not given:
            raise refused(
                f"intrinsics: none is of {', '.join(told.cameras)}, but of "
                f"{', '.join(camera.id for camera in rig.cameras)}; fix: name images' cameras alike"
            )
    return kinds, given


def _report(bundle: Bundle, problem: Problem, adjusted: Adjusted, camera: int) -> CameraReport:
    views = [
        (v, at) for v, at in zip(bundle.views, adjusted.columns, strict=True) if v.camera == camera
    ]
    off = np.concatenate([bundle.residuals(view) for view, _ in views])
    lens_at, pose_at, _ = views[0][1]
    covariance = adjusted.covariance

    def worst(matrix: NDArray[np.float64]) -> float:
        return float(np.sqrt(max(np.linalg.eigvalsh(matrix)[-1], 0.0)))

    focal = center = turn = shift = point = 0.0
    if lens_at[0] >= 0:
        focal = float(np.sqrt(covariance[lens_at[0], lens_at[0]]))
        center = worst(covariance[np.ix_(lens_at[2:4], lens_at[2:4])])
    if pose_at[0] >= 0:
        pose = covariance[np.ix_(pose_at, pose_at)]
        turn = float(np.degrees(worst(pose[:3, :3])))
        cam_from_world = bundle.cam_from_world[camera]
        middle = problem.told.board.points.mean(axis=0)[None]
        where = [rigid.apply(bundle.world_from_board[view.board], middle)[0] for view, _ in views]
        # A point moves in the camera's frame by its turn and its shift; the center by these two
        # as well.
        at = np.mean(where, axis=0) @ cam_from_world[:3, :3].T
        by = np.hstack([-rigid.hat(at), np.eye(3)])
        point = 1e3 * worst(by @ pose @ by.T)
        by = np.hstack([rigid.hat(cam_from_world[:3, 3]), np.eye(3)])
        shift = 1e3 * worst(by @ pose @ by.T)
    px = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    name = problem.cameras[camera]
    return CameraReport(name, len(views), len(off), px, turn, shift, point, focal, center)


def _check_focal(
    bundle: Bundle, reports: Sequence[CameraReport], covered: Sequence[Coverage]
) -> list[str]:
    """Refuses focal lengths that the boards do not determine, and warns of those that they hardly
    do."""
    told = []
    for camera, (report, cover) in enumerate(zip(reports, covered, strict=True)):
        if not bundle.free_lens[camera]:
            continue
        focal = float(bundle.lenses[camera][0])
        if focal > 0 and report.focal_sd_px <= FOCAL_SD * focal and cover.tilt_deg > LEAST_TILT_DEG:
            if report.focal_sd_px > FOCAL_DOUBT * focal:
                told.append(
                    f"camera `{report.camera}`: its focal length of {focal:.0f} px is known to "
                    f"{report.focal_sd_px:.0f} px alone (standard deviation); show the board "
                    f"larger "
                    "and more tilted"
                )
            continue
        why = f"boards are within {cover.tilt_deg:.0f} degrees of parallel"
        if cover.tilt_deg > PARALLEL_DEG:
            why = f"{report.views} views do not fix it"
        raise refused(
            f"camera `{report.camera}`: the focal length is not determined ({focal:.0f} px, "
            f"standard "
            f"deviation {min(report.focal_sd_px, 1e6):.0f}): {why}; fix: tilt the board by 20 "
            f"to 40 "
            "degrees in several directions, or give --intrinsics"
        )
    return told


def _world(problem: Problem, bundle: Bundle, world: str | None) -> NDArray[np.float64]:
    """world_from_root."""
    if world is None:
        return np.eye(4)
    seen = [problem.exposures[b] for b in sorted({view.board for view in bundle.views})]
    if world not in seen:
        raise refused(
            f"world: no exposure `{world}` in which the board is seen; expected one of "
            f"{', '.join(seen[:12])}{', ...' if len(seen) > 12 else ''}"
        )
    return rigid.inverse(bundle.world_from_board[problem.exposures.index(world)])


def _link_warnings(problem: Problem, links: Sequence[initial.Link]) -> list[str]:
    """Of links by one exposure alone, where nothing else holds a camera."""
    told = []
    for camera, name in enumerate(problem.cameras):
        own = [found for found in links if camera in (found.first, found.second)]
        if own and len(problem.cameras) > 1 and max(found.agreeing for found in own) < 2:
            told.append(
                f"camera `{name}` is placed by one exposure alone, whose error nothing shows; "
                f"add some"
            )
    return told
