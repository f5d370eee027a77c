from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mvtop._mvtop import BOP_RESULTS_HEADER, bop_results_line
from mvtop._objects import CameraPose, ObjectPose, Sigma, object_classes

if TYPE_CHECKING:
    import numpy as np
    import rerun
    from numpy.typing import NDArray

    from mvtop._mvtop import NativeEstimator, NativePrediction, Rig


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
    _source: Source | None = field(repr=False)
    _json: str | None = field(default=None, repr=False)

    @classmethod
    def of(cls, rig: Rig, source: Source) -> Prediction:
        """What the core answered about images of this rig."""
        native = source.prediction
        return cls(
            reference=native.reference,
            objects=[_object(**found) for found in native.objects()],
            timings_ms=dict(native.timings_ms),
            provider=native.provider,
            rig=rig,
            _source=source,
        )

    def to_json(self) -> str:
        """What `mvtop-cli infer --json` prints (docs/output.md)."""
        return self._source.prediction.to_json() if self._source else self._json or ""

    def to_dict(self) -> dict[str, Any]:
        """The same as Python's types."""
        report: dict[str, Any] = json.loads(self.to_json())
        return report

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
                seconds = self.timings_ms["total"] / 1e3
                rows.append(
                    bop_results_line(scene_id, image, found.class_id, found.score, pose, seconds)
                )
        return (BOP_RESULTS_HEADER if header else "") + "".join(rows)

    def overlay(self) -> dict[str, NDArray[np.uint8]]:
        """Pictures by camera id: the images with points, axes and boxes of the objects drawn in.

        Arrays that were changed since the prediction are drawn as they are now.
        """
        source = self._drawn_from()
        pictures = source.estimator.draw(source.prediction, source.images)
        return self._by_camera(source, pictures)

    def to_rerun(
        self, recording: rerun.RecordingStream | None = None, *, path: str = "mvtop"
    ) -> None:
        """Logs cameras, images, lines of sight and objects to Rerun, below the entity `path`.

        Needs `pip install mvtop[viz]`. Start a recording first, for example with `rerun.init`.

        - recording: where to; the active one by default
        """
        from mvtop import _viewer

        source = self._drawn_from()
        images = self._by_camera(source, source.estimator.images(self.rig, source.images))
        classes = {known.name: known for known in object_classes(source.estimator)}
        _viewer.log(self.rig, images, self.objects, classes, recording, path)

    def _drawn_from(self) -> Source:
        if self._source is None:
            raise ValueError(
                "this prediction was pickled, so it has no images to draw onto; predict in this "
                "process"
            )
        return self._source

    def _by_camera(
        self, source: Source, pictures: list[NDArray[np.uint8]]
    ) -> dict[str, NDArray[np.uint8]]:
        cameras = self.rig.cameras
        given = zip(source.images, pictures, strict=True)
        return {cameras[index].id: picture for (index, _), picture in given}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_source": None, "_json": self.to_json()}

    def __repr__(self) -> str:
        found = ", ".join(f"{o.class_name} {o.score:.2f}" for o in self.objects) or "no objects"
        took = f"{self.timings_ms['total']:.0f} ms on {self.provider}"
        return f"Prediction({found}; reference {self.reference}; {took})"


def _object(
    *,
    sigma: tuple[float, float],
    cameras: list[tuple[str, NDArray[np.float64], NDArray[np.float64] | None]],
    **numbers: Any,
) -> ObjectPose:
    seen = {camera: CameraPose(camera, pose, box) for camera, pose, box in cameras}
    return ObjectPose(**numbers, sigma=Sigma(*sigma), cameras=seen)
