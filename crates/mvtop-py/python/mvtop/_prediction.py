from __future__ import annotations

import copy
import json
import operator
import warnings as python_warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast, overload

import numpy as np

from mvtop import _report
from mvtop._error import Error, MvtopWarning
from mvtop._mvtop import BOP_RESULTS_HEADER, bop_results_line
from mvtop._objects import (
    Grasp,
    NearMiss,
    ObjectPose,
    PredictionWarning,
    RigConsistency,
    object_classes,
)
from mvtop._printable import printable, refused

if TYPE_CHECKING:
    import pandas
    import rerun
    from numpy.typing import NDArray

    from mvtop._mvtop import NativeEstimator, NativePrediction, Rig

    Several = slice | Sequence[bool] | Sequence[int] | NDArray[np.bool_] | NDArray[np.integer[Any]]


@dataclass(frozen=True, eq=False)
class Source:
    """What pictures of a prediction are drawn from."""

    estimator: NativeEstimator
    prediction: NativePrediction
    images: list[tuple[int, Any]]


@dataclass(frozen=True, eq=False)
class Prediction:
    """The objects that were found, and their poses.

    A container of `ObjectPose`: `len(prediction)`, `for found in prediction`, `prediction[0]`;
    a slice, a boolean mask or a list of indices gives a prediction of these objects alone.

    It refers to the images that it was made from, for pictures; pickled, it goes without them.

    Examples
    --------
    >>> sure = prediction[prediction.confidence > 0.9]
    >>> sure.poses.shape
    (2, 4, 4)
    """

    reference: str
    """Id of the reference camera."""
    objects: list[ObjectPose]
    """Best score first, or in the order of given boxes; empty where nothing was detected."""
    rig_consistency: RigConsistency | None
    """How well the rig fits what was found; None where no object is seen by two cameras."""
    timings_ms: dict[str, float]
    """Wall time of each stage and their total, milliseconds."""
    model: str
    """Folder of the model bundle that answered."""
    provider: str
    """What executed the network."""
    warnings: list[PredictionWarning]
    """What makes the poses doubtful; empty where nothing does. Each is a `MvtopWarning` too."""
    frame: str | None
    """Name of the frame of `ObjectPose.frame_from_obj`; None where none was asked for."""
    left_out: dict[str, int] | None
    """How many objects were found but not asked for, by what left them out: `classes`, `region`,
    `polygons` or `most`; None where all were asked for."""
    why: list[NearMiss] | None
    """What came nearest of each class without an object; None where `Request.why` did not ask."""
    rig: Rig
    _class_names: frozenset[str] = field(repr=False)
    _source: Source | None = field(repr=False)

    @classmethod
    def of(cls, rig: Rig, source: Source) -> Prediction:
        """What the core answered about images of this rig."""
        names = frozenset(name for name, _, _ in source.estimator.classes())
        values: Any = source.prediction.values()
        return cls(**_report.fields(values), rig=rig, _class_names=names, _source=source)

    def warn(self, stacklevel: int, where: str = "") -> Prediction:
        """Says its warnings in Python's way too; `stacklevel` as of `warnings.warn`, of here."""
        for warning in self.warnings:
            text = printable(f"{where}{warning.message}")
            python_warnings.warn(text, MvtopWarning, stacklevel=stacklevel + 1)
        return self

    def __len__(self) -> int:
        return len(self.objects)

    def __iter__(self) -> Iterator[ObjectPose]:
        return iter(self.objects)

    @overload
    def __getitem__(self, which: int) -> ObjectPose: ...
    @overload
    def __getitem__(self, which: Several) -> Prediction: ...
    def __getitem__(self, which: int | Several) -> ObjectPose | Prediction:
        if isinstance(which, slice):
            return self._only(range(len(self))[which])
        if hasattr(which, "__index__") and np.ndim(which) == 0:
            at = operator.index(cast(int, which))
            if not -len(self) <= at < len(self):
                raise IndexError(f"objects: expected an index of {len(self)} objects, got {at}")
            return self.objects[at]
        return self._only(self._indices(which))

    def _indices(self, which: Any) -> list[int]:
        """Of a boolean mask or of indices, which may count from the end."""
        array = np.asarray(which)
        if array.ndim == 1 and array.dtype == bool:
            if len(array) != len(self):
                raise IndexError(
                    f"objects: expected a mask of {len(self)}, one each, got {len(array)}"
                )
            return [int(at) for at in np.flatnonzero(array)]
        if array.shape == (0,):
            return []
        if array.ndim != 1 or array.dtype.kind not in "iu":
            raise TypeError(
                "objects: expected an index, a slice, a boolean mask or a list of indices, got "
                f"{type(which).__name__}"
            )
        if not (wrong := array[(array < -len(self)) | (array >= len(self))]).size == 0:
            raise IndexError(f"objects: expected indices of {len(self)} objects, got {wrong[0]}")
        return [int(at) % len(self) for at in array]

    def _only(self, indices: Sequence[int]) -> Prediction:
        """Of these objects; warnings of others are left out."""
        places = {index: place for place, index in reversed(list(enumerate(indices)))}
        of_these = [w for w in self.warnings if w.object is None or w.object in places]
        source = self._source
        if source is not None:
            source = replace(source, prediction=source.prediction.only(list(indices)))
        return replace(
            self,
            objects=[_with_places(self.objects[index], places) for index in indices],
            warnings=[
                w if w.object is None else replace(w, object=places[w.object]) for w in of_these
            ],
            _source=source,
        )

    def filter(
        self,
        *,
        min_confidence: float | None = None,
        class_name: str | Collection[str] | None = None,
    ) -> Prediction:
        """The same of some objects alone.

        Parameters
        ----------
        min_confidence
            Least `confidence`, 0 to 1.
        class_name
            Name of a class, or several.

        Returns
        -------
        Prediction
            Of the objects that meet all that is asked, in the same order.

        Raises
        ------
        ValueError
            Where the model knows no such class, or is not calibrated and so gives no confidence.
        """
        keep = np.ones(len(self), bool)
        if min_confidence is not None:
            if not 0 <= min_confidence <= 1:
                raise refused(f"min_confidence: expected 0 to 1, got {min_confidence}")
            if any(found.confidence is None for found in self.objects):
                raise ValueError(
                    "min_confidence: expected objects with a confidence, got none, as the model "
                    "is not calibrated; choose by `score`, or calibrate the model"
                )
            keep &= self.confidence >= min_confidence
        if class_name is not None:
            names = {class_name} if isinstance(class_name, str) else set(class_name)
            if unknown := sorted(names - self._class_names):
                known = ", ".join(sorted(self._class_names))
                raise refused(
                    f"class_name: no class `{unknown[0]}` in the model, expected one of: {known}"
                )
            keep &= np.array([found.class_name in names for found in self.objects], bool)
        return self[keep]

    @property
    def poses(self) -> NDArray[np.float64]:
        """(N, 4, 4), object frame to reference camera frame, metres: `ref_from_obj` of each."""
        return np.array([found.ref_from_obj for found in self.objects]).reshape(-1, 4, 4)

    @property
    def class_id(self) -> NDArray[np.int64]:
        """(N,), number of each object's class in the model."""
        return np.array([found.class_id for found in self.objects], np.int64)

    @property
    def class_name(self) -> NDArray[np.str_]:
        """(N,), name of each object's class in the model."""
        return np.array([found.class_name for found in self.objects], np.str_)

    @property
    def score(self) -> NDArray[np.float64]:
        """(N,), the detector's score of each object, 0 to 1; 1 for given boxes."""
        return np.array([found.score for found in self.objects], np.float64)

    @property
    def confidence(self) -> NDArray[np.float64]:
        """(N,), probability that each pose is within the bounds that the model states; NaN of a
        model that was not calibrated."""
        known = (found.confidence for found in self.objects)
        return np.array([np.nan if one is None else one for one in known], np.float64)

    def to_dict(self) -> dict[str, Any]:
        """What `mvtop-cli infer --json` prints (docs/reference/json.md), as Python's types."""
        # A copy, so that nothing of this prediction changes with it.
        return copy.deepcopy(_report.document(self))

    def to_json(self) -> str:
        """The same as JSON."""
        return json.dumps(_report.document(self), ensure_ascii=False, separators=(",", ":"))

    def to_pandas(self) -> pandas.DataFrame:
        """A table with one row for each object.

        Returns
        -------
        pandas.DataFrame
            `class_name`, `class_id`, `score`, `confidence`; of the pose in the reference camera's
            frame `x_m`, `y_m`, `z_m` (metres) and the unit quaternion `qw`, `qx`, `qy`, `qz`;
            `sigma_rot_deg` (degrees) and `sigma_t_m` (metres).

        Raises
        ------
        mvtop.Error
            Where the package pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise Error("to_pandas needs the package pandas; `pip install pandas`") from None
        quaternions = np.array([found.quat_wxyz for found in self.objects]).reshape(-1, 4)
        columns: dict[str, Any] = {
            "class_name": self.class_name.astype(object),
            "class_id": self.class_id,
            "score": self.score,
            "confidence": self.confidence,
        }
        columns |= {f"{axis}_m": self.poses[:, i, 3] for i, axis in enumerate("xyz")}
        columns |= {f"q{axis}": quaternions[:, i] for i, axis in enumerate("wxyz")}
        columns["sigma_rot_deg"] = [found.sigma.rot_deg for found in self.objects]
        columns["sigma_t_m"] = [found.sigma.t_m for found in self.objects]
        return pandas.DataFrame(columns)

    def to_bop_csv(
        self, scene_id: int, im_id: int | Mapping[str, int], *, header: bool = True
    ) -> str:
        """Lines of a BOP results file: one for each object and image; translations in millimetres.

        Parameters
        ----------
        scene_id
            Number of the scene.
        im_id
            Number of the reference camera's image, or of each camera's by its id.
        header
            Whether the line with the columns' names comes first.

        Raises
        ------
        ValueError
            Where a camera gave no image.
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
                    raise refused(
                        f"im_id: camera `{camera}` gave no image, expected one of: {known}"
                    )
                seconds = self.timings_ms["total"] / 1e3
                rows.append(
                    bop_results_line(scene_id, image, found.class_id, found.score, pose, seconds)
                )
        return (BOP_RESULTS_HEADER if header else "") + "".join(rows)

    def overlay(self, *, edges: bool = False) -> dict[str, NDArray[np.uint8]]:
        """Pictures of the images with outlines, axes and labels of the objects drawn in.

        Without a mesh, an object's points and box take the place of its outline.

        Arrays that were changed since the prediction are drawn as they are now.

        Parameters
        ----------
        edges
            Only the edges of the objects' meshes instead, green where the image shows them, else
            red.

        Returns
        -------
        dict
            By camera id, RGB arrays of uint8 and shape (H, W, 3).

        Raises
        ------
        ValueError
            For edges where the bundle has no mesh, and where this prediction was pickled.
        """
        source = self._drawn_from()
        pictures = source.estimator.draw(source.prediction, source.images, edges)
        return self._by_camera(source, pictures)

    def to_rerun(
        self, recording: rerun.RecordingStream | None = None, *, path: str = "mvtop"
    ) -> None:
        """Logs cameras, images, lines of sight and objects to Rerun.

        Needs `pip install mvtop[viz]`. Start a recording first, for example with `rerun.init`.

        Parameters
        ----------
        recording
            Where to; the active one by default.
        path
            The entity below which all is logged.
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
        return printable(f"Prediction({found}; reference {self.reference}; {took})")


def _with_places(found: ObjectPose, places: Mapping[int, int]) -> ObjectPose:
    """The object whose grasps know the others by their new indices."""
    if found.grasps is None:
        return found

    def moved(grasp: Grasp) -> Grasp:
        touched = grasp.collides_with
        if touched is None:
            return grasp
        return replace(grasp, collides_with=[places[one] for one in touched if one in places])

    return replace(found, grasps=[moved(grasp) for grasp in found.grasps])
