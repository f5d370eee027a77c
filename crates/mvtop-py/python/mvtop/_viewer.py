"""Predictions in the Rerun viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mvtop._error import Error

try:
    import rerun as rr
except ImportError:
    raise Error("to_rerun needs the package rerun-sdk; `pip install mvtop[viz]`") from None

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mvtop._mvtop import Camera
    from mvtop._prediction import ObjectPose, Prediction, Source

_AXES = np.eye(3)
_AXIS_COLORS = [[255, 40, 40], [40, 220, 40], [60, 110, 255]]
_SIGHT_COLOR = [0, 229, 255]


def log(
    prediction: Prediction, source: Source, recording: rr.RecordingStream | None, path: str
) -> None:
    def write(entity: str, *components: rr.AsComponents) -> None:
        rr.log(f"{path}/{entity}", *components, recording=recording)

    cameras = prediction.rig.cameras
    for (index, _), picture in zip(
        source.images, source.estimator.images(prediction.rig, source.images), strict=True
    ):
        camera = cameras[index]
        pose = camera.world_from_cam
        write(f"cameras/{camera.id}", rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        # Rerun draws all lenses as pinholes; lines of sight, below, are those of the true lens.
        pinhole = rr.Pinhole(image_from_camera=camera.K, resolution=camera.size)
        write(f"cameras/{camera.id}/image", pinhole)
        write(f"cameras/{camera.id}/image/rgb", rr.Image(picture))
        boxes = [found.boxes[camera.id] for found in prediction.objects if camera.id in found.boxes]
        write(
            f"cameras/{camera.id}/image/boxes",
            rr.Boxes2D(array=np.reshape(boxes, (-1, 4)), array_format=rr.Box2DFormat.XYXY),
        )
    classes = {name: i for i, (name, _, _) in enumerate(source.estimator.classes())}
    for number, found in enumerate(prediction.objects):
        entity = f"objects/{number}_{found.class_name}"
        pose = found.world_from_obj
        _, _, diameter = source.estimator.classes()[classes[found.class_name]]
        points = source.estimator.points(classes[found.class_name])
        write(entity, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        write(f"{entity}/points", rr.Points3D(points, radii=0.01 * diameter))
        arrows = rr.Arrows3D(vectors=0.65 * diameter * _AXES, colors=_AXIS_COLORS)
        write(f"{entity}/axes", arrows)
        sights = [line for c in cameras if (line := line_of_sight(c, found)) is not None]
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
