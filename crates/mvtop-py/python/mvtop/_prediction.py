from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop._mvtop import BOP_RESULTS_HEADER, bop_results_line
from mvtop._objects import (
    CameraPose,
    Hypothesis,
    ObjectPose,
    PredictionWarning,
    Refinement,
    RigConsistency,
    Sigma,
    Undetermined,
    object_classes,
)

if TYPE_CHECKING:
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
    rig_consistency: RigConsistency | None
    """How well the rig fits what was found; None where no object is seen by two cameras."""
    timings_ms: dict[str, float]
    """Wall time of each stage and their total, milliseconds."""
    provider: str
    """What executed the network."""
    warnings: list[PredictionWarning]
    """What makes the poses doubtful; empty where nothing does."""
    rig: Rig
    _json: str = field(repr=False)
    _source: Source | None = field(repr=False)

    @classmethod
    def of(cls, rig: Rig, source: Source) -> Prediction:
        """What the core answered about images of this rig."""
        text = source.prediction.to_json()
        report = json.loads(text)
        fit = report["rig_consistency"]
        return cls(
            reference=report["reference"],
            objects=[_object(found) for found in report["objects"]],
            rig_consistency=None if fit is None else RigConsistency(**fit),
            timings_ms=report["timings_ms"],
            provider=report["provider"],
            warnings=[PredictionWarning(**warning) for warning in report["warnings"]],
            rig=rig,
            _json=text,
            _source=source,
        )

    def to_json(self) -> str:
        """What `mvtop-cli infer --json` prints (docs/reference/json.md)."""
        return self._json

    def to_dict(self) -> dict[str, Any]:
        """The same as Python's types."""
        report: dict[str, Any] = json.loads(self._json)
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

    def overlay(self, *, edges: bool = False) -> dict[str, NDArray[np.uint8]]:
        """Pictures by camera id: the images with points, axes and boxes of the objects drawn in.

        Arrays that were changed since the prediction are drawn as they are now.

        - edges: only the edges of the objects' meshes instead, green where the image shows them,
          else red

        Raises ValueError for edges where the bundle has no mesh.
        """
        source = self._drawn_from()
        pictures = source.estimator.draw(source.prediction, source.images, edges)
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

    def __copy__(self) -> Prediction:
        return replace(self)

    def __deepcopy__(self, memo: dict[int, Any]) -> Prediction:
        fields = copy.deepcopy(self.__getstate__(), memo)
        # Of the same images, which nothing changes.
        return replace(self, **{**fields, "_source": self._source})

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_source": None}

    def __repr__(self) -> str:
        found = ", ".join(f"{o.class_name} {o.score:.2f}" for o in self.objects) or "no objects"
        took = f"{self.timings_ms['total']:.0f} ms on {self.provider}"
        return f"Prediction({found}; reference {self.reference}; {took})"


def _object(found: dict[str, Any]) -> ObjectPose:
    def camera(seen: dict[str, Any]) -> CameraPose:
        box = None if seen["box"] is None else np.array(seen["box"])
        return CameraPose(seen["id"], np.array(seen["T_cam_obj"]), box)

    def undetermined(symmetry: dict[str, Any]) -> Undetermined:
        axis = symmetry["axis"]
        rows = None if axis is None else np.array([axis["direction"], axis["point"]])
        return Undetermined(symmetry["poses"], rows)

    def hypothesis(one: dict[str, Any]) -> Hypothesis:
        place = np.array(one["T_world_obj"])
        return Hypothesis(place, Sigma(**one["sigma"]), one["probability"])

    def refinement(one: dict[str, Any]) -> Refinement:
        return Refinement(**one | {"initial_sigma": Sigma(**one["initial_sigma"])})

    return ObjectPose(
        class_name=found["class"],
        class_id=found["class_id"],
        score=found["score"],
        ref_from_obj=np.array(found["T_ref_obj"]),
        world_from_obj=np.array(found["T_world_obj"]),
        quat_wxyz=np.array(found["q_wxyz"]),
        sigma=Sigma(**found["sigma"]),
        coordinate_inliers=found["coordinate_inliers"],
        refinement=None if found["refinement"] is None else refinement(found["refinement"]),
        confidence=found["confidence"],
        evidence=found["evidence"],
        hypotheses=[hypothesis(one) for one in found["hypotheses"]],
        next_view=found["next_view"],
        symmetry=None if found["symmetry"] is None else undetermined(found["symmetry"]),
        cameras={seen["id"]: camera(seen) for seen in found["cameras"]},
    )
