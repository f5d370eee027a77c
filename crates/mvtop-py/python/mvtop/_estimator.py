from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any

from mvtop import _runtime, _shipped
from mvtop._mvtop import NativeEstimator, Rig, RigCheck
from mvtop._objects import ObjectClass, object_classes
from mvtop._prediction import Prediction, Source

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Image = NDArray[np.uint8] | str | os.PathLike[str]
    Images = Sequence[Image] | NDArray[np.uint8] | Mapping[str, Image]
    Boxes = str | os.PathLike[str] | Iterable[Mapping[str, Any]]


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
        """Loads a model bundle, a folder with `model.json`.

        - path: of the folder; by default $MVTOP_MODEL, else the one that the wheel carries, which
          knows the ball of `mvtop.example()`
        - provider: what executes the network: "cpu", "cuda", "tensorrt", "openvino",
          "openvino-bf16", "coreml" or "xnnpack", if the installed onnxruntime has it
        - threads: inside one operation of the network; 0 for one per physical core
        - ort_lib: ONNX Runtime's library; by default $ORT_DYLIB_PATH, else the one of the installed
          package `onnxruntime`. One process can use only one.
        - inference: settings that replace the bundle's, by dotted path, as {"search.settled": 0.8}
          (docs/reference/inference.md)

        Raises OSError where a file cannot be read, mvtop.Error where the bundle, the library or the
        provider cannot be used.
        """
        self = cls.__new__(cls)
        self._path = os.path.abspath(path or os.environ.get("MVTOP_MODEL") or _shipped.model())
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

    def predict(
        self,
        images: Images,
        rig: Rig,
        *,
        reference: str | None = None,
        boxes: Boxes | None = None,
        min_views: int = 1,
        refine: bool | None = None,
    ) -> Prediction:
        """Finds the objects that the network knows, and their poses.

        - images: RGB arrays of uint8 and shape (H, W, 3), or paths of PNG, JPEG, TIFF or BMP
          files: one for each camera in the rig's order, or a dict by camera id for some of them;
          of paths that are named after cameras (left.png), the names tell
        - reference: id of the camera in whose frame poses are given; the rig's by default
        - boxes: to use instead of detecting: [{"class": name, "boxes": {camera: [x0, y0, x1, y1]}}]
          in px, or the path of a JSON file with {"objects": that list}

        - min_views: leaves out objects that are detected in fewer images; 2 spares nearly all false
          ones, and costs those that only one image shows
        - refine: whether poses are refined on the images; by default those of classes with a mesh
          are, True refuses a bundle without any

        Raises ValueError where images, reference, boxes or min_views do not fit the rig or the
        network.
        """
        refuse_no_rig(rig)
        given = images_by_camera(images, rig)
        native = self._here()
        prediction = native.predict(
            rig, given, reference, boxes_by_camera(boxes), min_views, refine
        )
        return Prediction.of(rig, Source(native, prediction, given))

    def check_rig(
        self,
        sets: Iterable[Images],
        rig: Rig,
        *,
        turn_sd_deg: float = 1.0,
        shift_sd_m: float = 0.01,
    ) -> RigCheck:
        """Compares where a rig's cameras stand with what images of known objects show.

        - sets: of images, each as for `predict`, of one moment; the cameras stand still over all,
          objects need not
        - turn_sd_deg, shift_sd_m: how far each camera is expected to be off: standard deviations of
          a turn about each axis, degrees, and of a move along each, metres
        - returns: what is off, if anything, by how much, and the rig as the images show it:
          `RigCheck.problem`, `RigCheck.corrections()`, `RigCheck.refined()`

        Raises ValueError where images do not fit the rig, for a rig of one camera, a bundle whose
        classes have no meshes, where no two images show one of its objects, and where the images
        contradict the rig altogether: then it says which direction or axes would fit.
        """
        refuse_no_rig(rig)
        for name, sd in (("turn_sd_deg", turn_sd_deg), ("shift_sd_m", shift_sd_m)):
            if not 0.0 < sd < float("inf"):
                raise ValueError(f"{name}: expected a number above 0, got {sd}")
        given = [images_by_camera(images, rig) for images in sets]
        return self._here().check_rig(rig, given, turn_sd_deg, shift_sd_m)

    def __repr__(self) -> str:
        return f"Estimator({self._path!r}, provider={self._options['provider']!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (self._path, self._options)


def _unpickled(path: str, options: dict[str, Any]) -> Estimator:
    return Estimator.load(path, **options)


def refuse_no_rig(rig: object) -> None:
    if not isinstance(rig, Rig):
        raise ValueError(f"rig: expected a mvtop.Rig, got {type(rig).__name__}; see mvtop.Rig.load")


def images_by_camera(images: Images, rig: Rig) -> list[tuple[int, Any]]:
    ids = [camera.id for camera in rig.cameras]
    known = ", ".join(ids)
    if isinstance(images, Mapping):
        for camera in images:
            if camera not in ids:
                raise ValueError(
                    f"images: no camera `{camera}` in the rig, expected one of: {known}"
                )
        return [(ids.index(camera), image) for camera, image in images.items()]
    no_list = isinstance(images, (str, bytes, os.PathLike, Set))  # a set has no order
    if no_list or not hasattr(images, "__len__"):
        raise ValueError(
            "images: expected a list of arrays or paths, or a dict by camera id, "
            f"got {type(images).__name__}"
        )
    if len(images) != len(ids):
        raise ValueError(
            f"images: expected {len(ids)}, one for each camera of the rig ({known}), got "
            f"{len(images)}; to use some of the cameras, give a dict by camera id"
        )
    return _by_name(list(images), ids)


def _by_name(images: list[Any], ids: list[str]) -> list[tuple[int, Any]]:
    """Files that are named after cameras are of these, whatever their order; where no name is a
    camera's id, the order tells."""
    paths = [os.fspath(one) if isinstance(one, (str, os.PathLike)) else None for one in images]
    stems = [
        None if path is None else os.path.splitext(os.path.basename(path))[0] for path in paths
    ]
    example = next((path for path, stem in zip(paths, stems, strict=True) if stem in ids), None)
    if example is None:
        return list(enumerate(images))
    fix = "give a dict by camera id"
    found: dict[int, Any] = {}
    for image, stem in zip(images, stems, strict=True):
        if stem not in ids:
            what = "an array" if stem is None else f"`{image}`"
            raise ValueError(
                f"images: expected files that are named after cameras ({', '.join(ids)}), as "
                f"`{example}` is, got {what}; {fix}"
            )
        camera = ids.index(stem)
        if camera in found:
            raise ValueError(
                f"images: expected one file that is named after camera `{stem}`, got "
                f"`{found[camera]}` and `{image}`; {fix}"
            )
        found[camera] = image
    return sorted(found.items(), key=lambda pair: pair[0])


def boxes_by_camera(boxes: Boxes | None) -> list[Any] | None:
    """The name of each object and its boxes by camera id."""
    if boxes is None:
        return None
    given: Any = boxes
    try:
        if isinstance(boxes, (str, os.PathLike)):
            with open(boxes, encoding="utf-8") as file:
                given = json.load(file)["objects"]
        return [
            (
                str(known["class"]),
                {str(camera): _box(box) for camera, box in known["boxes"].items()},
            )
            for known in given
        ]
    except (KeyError, TypeError, AttributeError, ValueError) as cause:
        raise ValueError(
            'boxes: expected [{"class": name, "boxes": {camera: [x0, y0, x1, y1]}}], got what '
            f"gives {type(cause).__name__}: {cause}"
        ) from None


def _box(box: Sequence[float]) -> list[float]:
    if isinstance(box, (str, bytes)):
        raise TypeError(f"{box!r} is no box")
    x0, y0, x1, y1 = box
    return [float(x) for x in (x0, y0, x1, y1)]
