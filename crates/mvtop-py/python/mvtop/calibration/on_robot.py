"""Rigs in the robot's frames: hand-eye from images, and one camera at several poses of the
robot."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop._mvtop import Camera, Rig
from mvtop._printable import refused
from mvtop.calibration import hand_eye, images, initial, observe, rigid, robot_poses
from mvtop.calibration.adjust import Bundle, View
from mvtop.calibration.boards import Board
from mvtop.calibration.hand_eye import HandEye
from mvtop.calibration.lenses import given
from mvtop.calibration.robot_poses import RobotPoses
from mvtop.calibration.solve import board_alone

if TYPE_CHECKING:
    from numpy.typing import NDArray

MISFIT_PX = 3.0
"""Boards that the rig's cameras see further beside where it has them are left out."""


@dataclass(frozen=True, eq=False)
class RobotRig:
    """A rig whose world is the robot's base, or its hand."""

    rig: Rig
    result: HandEye
    ref_from_board: dict[str, NDArray[np.float64]]
    """(4, 4), by exposure, metres."""
    warnings: list[str]


def calibrate_hand_eye(
    rig: Rig | str | os.PathLike[str],
    source: Mapping[str, Any] | str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    board: Board | str | os.PathLike[str],
    poses: RobotPoses | str | os.PathLike[str],
    *,
    eye: str | None = None,
    rotation: str | None = None,
    direction: str | None = None,
    unit: str | None = None,
    layout: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RobotRig:
    """Where a rig stands on the robot, by images of a board at several poses of the robot.

    - rig: whose lenses and places of cameras are kept
    - source: images by camera and exposure, as of `mvtop.calibrate`; exposures are named as poses
      are
    - poses: of the robot's hand, a file (CSV, JSON, ROS) or what one says
    - eye: "hand" where cameras move with it, "base" where they stand
    - rotation, direction, unit: how poses are read; found by which reading is consistent where
      they are not said, where the eye is (or the eye, where the direction is)
    - returns: the rig with the hand ("hand") or the base ("base") as its world

    Raises ValueError or OSError, one sentence, for what is refused.
    """
    rig = rig if isinstance(rig, Rig) else Rig.load(Path(rig))
    board = board if isinstance(board, Board) else Board.load(board)
    poses = poses if isinstance(poses, RobotPoses) else robot_poses.load(Path(poses))
    if isinstance(source, Mapping):
        sources = images.of_mapping(source)
    else:
        sources = images.find(images.folders(source), layout=layout).images
    sources = _of_rig(rig, sources)
    told = observe.observe(sources, board, progress=progress)
    where, warnings = board_poses(rig, told)
    result = hand_eye.solve(
        where, poses, eye=eye, rotation=rotation, direction=direction, unit=unit
    )
    reference = next(c for c in rig.cameras if c.id == rig.reference)
    ref_from_world = rigid.inverse(reference.world_from_cam)
    moved = [
        _placed(camera, result.world_from_ref @ ref_from_world @ camera.world_from_cam)
        for camera in rig.cameras
    ]
    return RobotRig(Rig(moved, rig.reference), result, where, warnings)


def _of_rig(rig: Rig, sources: images.Sources) -> images.Sources:
    """Images of the rig's cameras; those of one camera whatever they are called."""
    ids = [camera.id for camera in rig.cameras]
    if len(ids) == 1 and len(sources) == 1:
        return {ids[0]: next(iter(sources.values()))}
    if unknown := sorted(set(sources) - set(ids)):
        raise refused(f"images of `{unknown[0]}`: the rig's cameras are {', '.join(ids)}")
    return sources


def board_poses(
    rig: Rig, told: observe.Observations
) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """ref_from_board of each exposure, by all cameras that see it, and warnings."""
    cameras = {camera.id: camera for camera in rig.cameras}
    names = told.cameras
    reference = cameras[rig.reference]
    kinds, lenses, places = [], [], []
    for name in names:
        camera = cameras[name]
        if camera.size != told.sizes[name]:
            raise refused(
                f"camera `{name}`: its images are {told.sizes[name][0]}x{told.sizes[name][1]}, "
                f"the rig "
                f"has {camera.size[0]}x{camera.size[1]}"
            )
        kind, lens = given(camera)
        kinds.append(kind)
        lenses.append(lens)
        places.append(rigid.inverse(camera.world_from_cam) @ reference.world_from_cam)
    found, warnings = {}, []
    for exposure in told.exposures:
        views, start = [], None
        for index, name in enumerate(names):
            if exposure not in told.found[name]:
                continue
            detection = told.found[name][exposure]
            view = View(index, 0, told.board.points[detection.numbers], detection.pixels)
            posed = initial.board_pose(kinds[index], lenses[index], view)
            if posed is None:
                continue
            views.append(view)
            if start is None:
                start = rigid.inverse(places[index]) @ posed[0]
        if start is None:
            continue
        bundle = Bundle(kinds, lenses, places, [start], views, [False] * len(kinds), None)
        pose, px = board_alone(bundle, views, start)
        if max(px) > MISFIT_PX:
            warnings.append(
                f"exposure `{exposure}`: the board is {max(px):.1f} px beside where the rig has "
                f"it; left out"
            )
            continue
        found[exposure] = pose
    return found, warnings


def _placed(camera: Camera, world_from_cam: NDArray[np.float64], name: str | None = None) -> Camera:
    pose = world_from_cam.copy()
    pose[:3, :3] = rigid.mean_rotation(pose[None, :3, :3])
    return Camera(
        camera.K,
        camera.size,
        distortion=camera.distortion,
        model=camera.model,
        world_from_cam=pose,
        id=name or camera.id,
        max_angle_deg=camera.max_angle_deg,
    )


def at_poses(rig: Rig, poses: RobotPoses, *, rotation: str, direction: str, unit: str) -> Rig:
    """A rig on the hand, moved to several poses, as one rig of as many times its cameras.

    - rig: with the hand as its world
    - poses: of the hand; rotation, direction, unit: how they are read
    - returns: world the robot's base; cameras are named after poses where the rig has one, else
      CAMERA.POSE
    """
    made = []
    for name, base_from_hand in poses.read(rotation, direction, unit).items():
        clean = re.sub(r"[^A-Za-z0-9_.\-]", "_", name)
        for camera in rig.cameras:
            label = clean if len(rig.cameras) == 1 else f"{camera.id}.{clean}"
            made.append(_placed(camera, base_from_hand @ camera.world_from_cam, label))
    return Rig(made)
