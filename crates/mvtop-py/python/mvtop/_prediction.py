from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import rerun
    from numpy.typing import NDArray

    from mvtop._mvtop import NativeEstimator, NativePrediction, Rig

_BOP_HEADER = "scene_id,im_id,obj_id,score,R,t,time\n"


@dataclass(frozen=True)
class Sigma:
    """The error that the network expects of its own pose."""

    rot_deg: float
    """Expected angle between the true and the predicted rotation, degrees."""
    t_m: float
    """Standard deviation of the translation, metres."""


@dataclass(frozen=True, eq=False)
class CameraPose:
    """One object as one camera sees it."""

    id: str
    cam_from_obj: NDArray[np.float64]
    """(4, 4), object frame to this camera's frame, metres."""
    box: NDArray[np.float64] | None
    """x0, y0, x1, y1, px; None where the object was not detected."""


@dataclass(frozen=True, eq=False)
class ObjectPose:
    """One object."""

    class_name: str
    class_id: int
    score: float
    """0 to 1; 1 for given boxes."""
    ref_from_obj: NDArray[np.float64]
    """(4, 4), object frame to the reference camera's frame, metres."""
    world_from_obj: NDArray[np.float64]
    """(4, 4), object frame to the rig's world frame, metres."""
    quat_wxyz: NDArray[np.float64]
    """Rotation of `ref_from_obj` as a unit quaternion, w >= 0."""
    sigma: Sigma
    cameras: dict[str, CameraPose]
    """Every camera that gave an image, in the rig's order, by id."""

    @property
    def quat_xyzw(self) -> NDArray[np.float64]:
        """The same quaternion in the order of SciPy and ROS."""
        return self.quat_wxyz[[1, 2, 3, 0]]

    @property
    def cam_from_obj(self) -> dict[str, NDArray[np.float64]]:
        """By camera id: (4, 4), object frame to the camera's frame, metres."""
        return {camera: seen.cam_from_obj for camera, seen in self.cameras.items()}

    @property
    def boxes(self) -> dict[str, NDArray[np.float64]]:
        """By camera id: x0, y0, x1, y1, px, in the cameras that detected the object."""
        return {camera: seen.box for camera, seen in self.cameras.items() if seen.box is not None}


@dataclass(frozen=True, eq=False)
class Source:
    """What pictures of a prediction are drawn from."""

    estimator: NativeEstimator
    prediction: NativePrediction
    images: list[tuple[int, Any]]


@dataclass(frozen=True, eq=False)
class Prediction:
    """Poses of all objects.

    It refers to the images that it was made from, for pictures; pickled, it goes without them.
    """

    reference: str
    """Id of the reference camera."""
    objects: list[ObjectPose]
    """Best score first, or in the order of given boxes; empty where nothing was detected."""
    timings_ms: dict[str, float]
    """Wall time of each stage and their total, milliseconds."""
    provider: str
    """What executed the network."""
    rig: Rig
    _report: dict[str, Any] = field(repr=False)
    _source: Source | None = field(repr=False)

    @classmethod
    def from_report(
        cls, report: dict[str, Any], rig: Rig, source: Source | None = None
    ) -> Prediction:
        """A prediction from what `to_dict` gives and `mvtop-cli infer --json` prints."""
        return cls(
            reference=report["reference"],
            objects=[_object(found) for found in report["objects"]],
            timings_ms=dict(report["timings_ms"]),
            provider=report["provider"],
            rig=rig,
            _report=report,
            _source=source,
        )

    def to_dict(self) -> dict[str, Any]:
        """The content of `mvtop-cli infer --json` (docs/output.md)."""
        return copy.deepcopy(self._report)

    def to_bop_csv(
        self, scene_id: int, im_id: int | Mapping[str, int], *, header: bool = True
    ) -> str:
        """Lines of a BOP results file: one for each object and image; translations in millimetres.

        - im_id: number of the reference camera's image, or of each camera's by its id
        """
        if not isinstance(im_id, Mapping):
            im_id = {self.reference: im_id}
        rows = []
        for camera, image in im_id.items():
            for found in self.objects:
                if camera == self.reference:
                    pose = found.ref_from_obj
                elif camera in found.cameras:
                    pose = found.cameras[camera].cam_from_obj
                else:
                    known = ", ".join(found.cameras)
                    raise ValueError(
                        f"im_id: camera `{camera}` gave no image, expected one of: {known}"
                    )
                rotation = " ".join(repr(float(x)) for x in pose[:3, :3].ravel())
                translation = " ".join(repr(float(x)) for x in pose[:3, 3] * 1e3)
                rows.append(
                    f"{scene_id},{image},{found.class_id},{found.score!r},{rotation},"
                    f"{translation},{self.timings_ms['total'] / 1e3!r}\n"
                )
        return (_BOP_HEADER if header else "") + "".join(rows)

    def overlay(self) -> dict[str, NDArray[np.uint8]]:
        """Pictures by camera id: the images with points, axes and boxes of the objects drawn in.

        Arrays that were changed since the prediction are drawn as they are now.
        """
        source = self._drawn_from()
        pictures = source.estimator.draw(source.prediction, self.rig, source.images)
        ids = [camera.id for camera in self.rig.cameras]
        return {ids[i]: drawn for (i, _), drawn in zip(source.images, pictures, strict=True)}

    def to_rerun(
        self, recording: rerun.RecordingStream | None = None, *, path: str = "mvtop"
    ) -> None:
        """Logs cameras, images, lines of sight and objects to Rerun, below the entity `path`.

        Needs `pip install mvtop[viz]`. Start a recording first, for example with `rerun.init`.

        - recording: where to; the active one by default
        """
        from mvtop import _viewer

        _viewer.log(self, self._drawn_from(), recording, path)

    def _drawn_from(self) -> Source:
        if self._source is None:
            raise ValueError(
                "this prediction was pickled or read, so it has no images to draw onto; predict "
                "in this process"
            )
        return self._source

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_source": None}


def _object(found: dict[str, Any]) -> ObjectPose:
    import numpy as np

    def seen(camera: dict[str, Any]) -> CameraPose:
        box = camera["box"]
        return CameraPose(
            id=camera["id"],
            cam_from_obj=np.array(camera["T_cam_obj"]),
            box=None if box is None else np.array(box),
        )

    return ObjectPose(
        class_name=found["class"],
        class_id=found["class_id"],
        score=found["score"],
        ref_from_obj=np.array(found["T_ref_obj"]),
        world_from_obj=np.array(found["T_world_obj"]),
        quat_wxyz=np.array(found["q_wxyz"]),
        sigma=Sigma(found["sigma"]["rot_deg"], found["sigma"]["t_m"]),
        cameras={camera["id"]: seen(camera) for camera in found["cameras"]},
    )
