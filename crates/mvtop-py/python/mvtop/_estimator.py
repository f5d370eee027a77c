from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

from mvtop import _runtime, _shipped
from mvtop._inputs import (
    boxes_by_camera,
    boxes_of_groups,
    groups_of,
    images_by_camera,
    refuse_no_rig,
)
from mvtop._mvtop import NativeEstimator, Rig, RigCheck, Tracks
from mvtop._objects import ObjectClass, object_classes
from mvtop._prediction import Prediction, Source
from mvtop._printable import refused
from mvtop._request import json_of

if TYPE_CHECKING:
    from mvtop._inputs import Boxes, Images
    from mvtop._request import Request

    Groups = list[Images] | tuple[Images, ...]


class Estimator:
    """A loaded network, ready for any number of predictions with any rigs.

    Threads may share it: its network runs one call after the other, refinement of one caller beside
    it. It can be pickled, and used in a forked process: both load the network anew.
    """

    _path: str
    _options: dict[str, Any]
    _native: NativeEstimator

    def __init__(self, *_: object, **__: object) -> None:
        raise TypeError("Estimator: expected Estimator.load(path), got a call of the class itself")

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str] | None = None,
        *,
        provider: str = "cpu",
        threads: int = 0,
        ort_lib: str | os.PathLike[str] | None = None,
        inference: Mapping[str, Any] | None = None,
    ) -> Estimator:
        """Loads a model.

        Parameters
        ----------
        path
            "mvball", the model that the wheel carries, which knows the ball of `mvtop.example()`;
            or the path of a model bundle, a folder with `model.json`. By default $MVTOP_MODEL, else
            "mvball". A folder of that name is "./mvball".
        provider
            What executes the network: "cpu", "cuda", "tensorrt", "openvino", "openvino-bf16",
            "coreml" or "xnnpack", if the installed onnxruntime has it.
        threads
            Inside one operation of the network; 0 for one per physical core.
        ort_lib
            ONNX Runtime's library; by default $ORT_DYLIB_PATH, else the one of the installed
            package `onnxruntime`. One process can use only one.
        inference
            Settings that replace the bundle's, by dotted path, as {"search.settled": 0.8}
            (docs/reference/inference.md).

        Returns
        -------
        Estimator

        Raises
        ------
        OSError
            Where a file cannot be read.
        mvtop.Error
            Where the bundle, the library or the provider cannot be used.

        Examples
        --------
        >>> estimator = mvtop.Estimator.load("mvball")
        """
        self = cls.__new__(cls)
        named = path or os.environ.get("MVTOP_MODEL") or _shipped.NAME
        self._path = os.path.abspath(_shipped.model() if named == _shipped.NAME else named)
        self._options = {
            "provider": provider, "threads": threads, "ort_lib": ort_lib,
            "inference": dict(inference or {}),
        }  # fmt: skip
        self._native = self._load()
        return self

    def _load(self) -> NativeEstimator:
        library = self._options["ort_lib"] or _runtime.library()
        settings = self._options["inference"].items()
        return NativeEstimator(
            self._path, library, self._options["provider"], self._options["threads"],
            {key: json.dumps(value) for key, value in settings},
        )  # fmt: skip

    def _here(self) -> NativeEstimator:
        """The network in this process: its threads do not survive a fork."""
        native = self._native
        if not native.is_of_this_process():
            self._native = native = self._load()
        return native

    @property
    def classes(self) -> list[ObjectClass]:
        """The objects that the network knows."""
        return object_classes(self._native)

    # A list of texts is one group of paths, though a text is a list of texts to type checkers.
    @overload
    def predict(  # type: ignore[overload-overlap]
        self,
        images: Images,
        rig: Rig,
        *,
        reference: str | None = None,
        boxes: Boxes | None = None,
        min_views: int | None = None,
        refine: bool | None = None,
        request: Request | None = None,
        tracks: Tracks | None = None,
    ) -> Prediction: ...
    @overload
    def predict(
        self,
        images: Groups,
        rig: Rig,
        *,
        reference: str | None = None,
        boxes: Sequence[Boxes | None] | None = None,
        min_views: int | None = None,
        refine: bool | None = None,
        request: Request | None = None,
        tracks: Tracks | None = None,
    ) -> list[Prediction]: ...
    def predict(
        self,
        images: Images | Groups,
        rig: Rig,
        *,
        reference: str | None = None,
        boxes: Boxes | Sequence[Boxes | None] | None = None,
        min_views: int | None = None,
        refine: bool | None = None,
        request: Request | None = None,
        tracks: Tracks | None = None,
    ) -> Prediction | list[Prediction]:
        """Finds the objects that the network knows, and their poses.

        Warnings of the prediction are `mvtop.MvtopWarning` too. Ctrl-C ends it.

        Parameters
        ----------
        images
            RGB images of uint8 and shape (H, W, 3): NumPy's arrays, what has the array protocol, as
            PyTorch's tensors, images of Pillow's, or paths of PNG, JPEG, TIFF or BMP files. One for
            each camera in the rig's order, or a dict by camera id for some of them; of paths that
            are named after cameras (left.png), the names tell. OpenCV reads BGR: give
            `image[..., ::-1]`. A list of such groups, each of one moment, gives a list.
        rig
            The cameras that took the images.
        reference
            Id of the camera in whose frame poses are given; the rig's by default.
        boxes
            To use instead of detecting: [{"class": name, "boxes": {camera: [x0, y0, x1, y1]}}] in
            px, of 100 objects at most, or the path of a JSON file with {"objects": that list}. Of
            several groups, a list with one for each.
        min_views
            Leaves out objects that are detected in fewer images, 1 by default; 2 spares nearly all
            false ones, and costs those that only one image shows.
        refine
            Whether poses are refined on the images; by default those of classes with a mesh are,
            True refuses a bundle without any.
        request
            Which objects are wanted, and in which frame; the arguments above replace what it says.
        tracks
            What numbers the objects over time (`track_id`), also of groups, one after the other.

        Returns
        -------
        Prediction
            A container of `ObjectPose`; of a list of groups, a list of one for each.

        Raises
        ------
        ValueError
            Where images, reference, boxes, min_views or request do not fit the rig or the network.
        """
        refuse_no_rig(rig)
        options = (json_of(request), reference, min_views, refine, tracks)
        groups = groups_of(images)
        if groups is None:
            given: Any = images
            one: Any = boxes
            return self._one(images_by_camera(given, rig), rig, one, *options).warn(2)
        found = []
        all_boxes = boxes_of_groups(boxes, len(groups))
        for number, (group, of_group) in enumerate(zip(groups, all_boxes, strict=True)):
            where = f"group {number}: "
            given = images_by_camera(group, rig, f"{where}images")
            found.append(self._one(given, rig, of_group, *options).warn(2, where))
        return found

    def _one(
        self,
        images: list[tuple[int, Any]],
        rig: Rig,
        boxes: Boxes | None,
        request: str | None,
        reference: str | None,
        min_views: int | None,
        refine: bool | None,
        tracks: Tracks | None,
    ) -> Prediction:
        native = self._here()
        given = boxes_by_camera(boxes)
        prediction = native.predict(
            rig, images, request, reference, given, min_views, refine, tracks
        )
        return Prediction.of(rig, Source(native, prediction, images))

    def check_rig(
        self,
        sets: Iterable[Images],
        rig: Rig,
        *,
        turn_sd_deg: float = 1.0,
        shift_sd_m: float = 0.01,
    ) -> RigCheck:
        """Compares where a rig's cameras stand with what images of known objects show.

        Parameters
        ----------
        sets
            Of images, each as for `predict`, of one moment; the cameras stand still over all,
            objects need not.
        rig
            The cameras that took the images.
        turn_sd_deg, shift_sd_m
            How far each camera is expected to be off: standard deviations of a turn about each
            axis, degrees, and of a move along each, metres.

        Returns
        -------
        RigCheck
            What is off, if anything, by how much, and the rig as the images show it:
            `RigCheck.problem`, `RigCheck.corrections()`, `RigCheck.refined()`.

        Raises
        ------
        ValueError
            Where images do not fit the rig, for a rig of one camera, a bundle whose classes have no
            meshes, where no two images show one of its objects, and where the images contradict the
            rig altogether: then it says which direction or axes would fit.
        """
        refuse_no_rig(rig)
        for name, sd in (("turn_sd_deg", turn_sd_deg), ("shift_sd_m", shift_sd_m)):
            if not 0.0 < sd < float("inf"):
                raise refused(f"{name}: expected a number above 0, got {sd}")
        given = [images_by_camera(images, rig) for images in sets]
        return self._here().check_rig(rig, given, turn_sd_deg, shift_sd_m)

    def __repr__(self) -> str:
        return f"Estimator({self._path!r}, provider={self._options['provider']!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self._path, self._options)


def _unpickled(path: str, options: dict[str, Any]) -> Estimator:
    return Estimator.load(path, **options)
