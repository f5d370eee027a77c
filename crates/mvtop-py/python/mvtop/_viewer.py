"""Rigs and predictions in the Rerun viewer."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from mvtop._error import Error

try:
    import rerun as rr
except ImportError:
    raise Error("to_rerun needs the package rerun-sdk; `pip install mvtop[viz]`") from None

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from mvtop._mvtop import Camera, Rig
    from mvtop._objects import ObjectClass, ObjectPose

    Write = Callable[..., None]

_AXES = np.eye(3)
_AXIS_COLORS = [[255, 40, 40], [40, 220, 40], [60, 110, 255]]
_SIGHT_COLOR = [0, 229, 255]
_DISTANCE_COLOR = [150, 150, 150]
# Of a lone camera's axes, metres; of several, a share of the least distance between two.
_AXIS_M, _AXIS_SHARE = 0.1, 0.25


def log_rig(rig: Rig, recording: rr.RecordingStream | None, path: str) -> None:
    """Where cameras stand and look, and how far they are apart."""

    def write(entity: str, *components: rr.AsComponents) -> None:
        rr.log(f"{path}/{entity}", *components, recording=recording)

    centers = [camera.world_from_cam[:3, 3] for camera in rig.cameras]
    pairs = list(combinations(centers, 2))
    distances = [float(np.linalg.norm(a - b)) for a, b in pairs]
    axis = _AXIS_SHARE * min((d for d in distances if d > 0), default=_AXIS_M / _AXIS_SHARE)
    for camera in rig.cameras:
        entity = _log_camera(write, camera, reach=2 * axis)
        arrows = rr.Arrows3D(vectors=axis * _AXES, colors=_AXIS_COLORS, labels=[camera.id, "", ""])
        write(f"{entity}/axes", arrows)
    labels = [f"{distance:.3f} m" for distance in distances]
    write("distances", rr.LineStrips3D(pairs, colors=_DISTANCE_COLOR, labels=labels))


def _log_camera(write: Write, camera: Camera, reach: float | None = None) -> str:
    """Its pose and its frustum, of depth `reach` (m); returns the entity."""
    entity, pose = f"cameras/{camera.id}", camera.world_from_cam
    write(entity, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    # Rerun draws all lenses as pinholes.
    pinhole = rr.Pinhole(
        image_from_camera=camera.K, resolution=camera.size, image_plane_distance=reach
    )
    write(f"{entity}/image", pinhole)
    return entity


def log(
    rig: Rig,
    images: dict[str, NDArray[np.uint8]],
    objects: list[ObjectPose],
    classes: dict[str, ObjectClass],
    recording: rr.RecordingStream | None,
    path: str,
) -> None:
    """Cameras with the images that they gave, by id, and objects, each of a known class."""

    def write(entity: str, *components: rr.AsComponents) -> None:
        rr.log(f"{path}/{entity}", *components, recording=recording)

    for camera in rig.cameras:
        if camera.id not in images:
            continue
        entity = _log_camera(write, camera)
        write(f"{entity}/image/rgb", rr.Image(images[camera.id]))
        boxes = [found.boxes[camera.id] for found in objects if camera.id in found.boxes]
        write(
            f"{entity}/image/boxes",
            rr.Boxes2D(array=np.reshape(boxes, (-1, 4)), array_format=rr.Box2DFormat.XYXY),
        )
    for number, found in enumerate(objects):
        entity = f"objects/{number}_{found.class_name}"
        pose, known = found.world_from_obj, classes[found.class_name]
        write(entity, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        write(f"{entity}/points", rr.Points3D(known.points, radii=0.01 * known.diameter_m))
        arrows = rr.Arrows3D(vectors=0.65 * known.diameter_m * _AXES, colors=_AXIS_COLORS)
        write(f"{entity}/axes", arrows)
        # Of the true lens.
        sights = [line for c in rig.cameras if (line := line_of_sight(c, found)) is not None]
        write(f"sights/{number}_{found.class_name}", rr.LineStrips3D(sights, colors=_SIGHT_COLOR))


def line_of_sight(camera: Camera, found: ObjectPose) -> NDArray[np.float64] | None:
    """From a camera through the center of its box to beside the object.

    Returns (2, 3), world frame, metres; None where the camera did not detect the object.
    """
    if camera.id not in found.boxes:
        return None
    x0, y0, x1, y1 = found.boxes[camera.id]
    direction = camera.unproject([(x0 + x1) / 2, (y0 + y1) / 2])
    if np.isnan(direction).any():
        return None
    pose = camera.world_from_cam
    center = pose[:3, 3]
    reach = np.linalg.norm(found.world_from_obj[:3, 3] - center)
    return np.stack([center, center + reach * pose[:3, :3] @ direction])
