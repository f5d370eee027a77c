"""What predictions are made from: images of a rig's cameras, and boxes that are given."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any, Protocol

from mvtop._mvtop import Rig
from mvtop._printable import refused

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    class AsArray(Protocol):
        """What NumPy makes an array of: PyTorch's tensors, images of Pillow's."""

        def __array__(self, dtype: Any = ..., /) -> NDArray[Any]: ...

    class AsInterface(Protocol):
        """The same by the older protocol."""

        @property
        def __array_interface__(self) -> dict[str, Any]: ...

    Image = NDArray[np.uint8] | AsArray | AsInterface | str | os.PathLike[str]
    Images = Sequence[Image] | NDArray[np.uint8] | Mapping[str, Image]
    Boxes = str | os.PathLike[str] | Iterable[Mapping[str, Any]]


_TEXTS = (str, bytes, bytearray, memoryview)
_GAMMA = 1 / 2.2  # exponent of samples that are taken as they are
_SAME_GAMMA = 0.05  # exponents that differ by this share are the same


def refuse_no_rig(rig: object) -> None:
    if not isinstance(rig, Rig):
        raise refused(f"rig: expected a mvtop.Rig, got {type(rig).__name__}; see mvtop.Rig.load")


def groups_of(images: object) -> list[Any] | None:
    """The groups, where a list of groups is given; None for one group of images."""
    if not isinstance(images, (list, tuple)) or not images:
        return None
    first = images[0]
    several = isinstance(first, (Mapping, list, tuple)) or getattr(first, "ndim", 0) == 4
    return list(images) if several else None


def images_by_camera(images: Images, rig: Rig, where: str = "images") -> list[tuple[int, Any]]:
    """Index of the camera, and the path or array of its image.

    - where: what the images are, for errors
    """
    ids = [camera.id for camera in rig.cameras]
    known = ", ".join(ids)
    if isinstance(images, Mapping):
        for camera in images:
            if camera not in ids:
                raise refused(f"{where}: no camera `{camera}` in the rig, expected one of: {known}")
        return [
            (ids.index(camera), _readable(image, camera, where)) for camera, image in images.items()
        ]
    no_list = isinstance(images, (str, bytes, os.PathLike, Set))  # a set has no order
    if no_list or not hasattr(images, "__len__"):
        raise refused(
            f"{where}: expected a list of arrays or paths, or a dict by camera id, "
            f"got {type(images).__name__}"
        )
    if len(images) != len(ids):
        raise refused(
            f"{where}: expected {len(ids)}, one for each camera of the rig ({known}), got "
            f"{len(images)}; to use some of the cameras, give a dict by camera id"
        )
    found = _by_name(list(images), ids, where)
    return [(camera, _readable(image, ids[camera], where)) for camera, image in found]


def _readable(image: Any, camera: str, where: str) -> Any:
    """A path or NumPy's array as it is, and an array of what else NumPy makes one of."""
    import numpy as np

    if isinstance(image, (str, bytes, os.PathLike, np.ndarray)):
        return image
    name = f"{where}: image of camera `{camera}`"
    if type(image).__module__.partition(".")[0] == "PIL":
        image = _of_pillow(image, name)
    if not (hasattr(image, "__array__") or hasattr(image, "__array_interface__")):
        return image
    try:
        array = np.asarray(image)
    except Exception as cause:  # of any kind: a tensor on a GPU raises TypeError
        raise refused(f"{name}: expected what NumPy makes an array of, got: {cause}") from None
    if array.ndim == 3 and array.shape[0] == 3 and array.shape[2] != 3:
        raise refused(
            f"{name}: expected an RGB array of uint8 and shape (H, W, 3), got channels first, "
            f"{array.shape}; give `tensor.permute(1, 2, 0)`"
        )
    return array


def _of_pillow(image: Any, name: str) -> Any:
    """As files are read: grey spread over three channels, without alpha, by the gamma that a PNG
    file states, refused where rotated."""
    if image.mode in ("I", "F") or image.mode.startswith("I;"):
        raise refused(
            f"{name}: expected 8 bits, got an image of Pillow's mode {image.mode}; scale it to 8 "
            "bits, or give the path of the file"
        )
    if (turn := image.getexif().get(0x0112, 1)) not in (0, 1):
        raise refused(
            f"{name}: is marked as rotated or mirrored (EXIF orientation {turn}); give it upright, "
            "as calibrated, without the mark"
        )
    colors = image.convert("RGB")
    exponent = _correction(image.info)
    return colors if exponent is None else colors.point(_gamma_table(exponent) * 3)


def _correction(info: Mapping[Any, Any]) -> float | None:
    """The exponent that turns samples, 0 to 1, into the usual ones, by what Pillow read beside
    them; None where they are these, or where a profile counts."""
    stated = info.get("gamma")
    if not stated or info.get("icc_profile") is not None or "srgb" in info:
        return None
    exponent = _GAMMA / float(stated)
    return exponent if abs(exponent - 1) > _SAME_GAMMA else None


def _gamma_table(exponent: float) -> list[int]:
    """Of each sample of 8 bits, by way of 16 bits as files are read."""
    return [(round(65535 * (sample / 255) ** exponent) + 128) // 257 for sample in range(256)]


def _by_name(images: list[Any], ids: list[str], where: str) -> list[tuple[int, Any]]:
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
            raise refused(
                f"{where}: expected files that are named after cameras ({', '.join(ids)}), as "
                f"`{example}` is, got {what}; {fix}"
            )
        camera = ids.index(stem)
        if camera in found:
            raise refused(
                f"{where}: expected one file that is named after camera `{stem}`, got "
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
        raise refused(
            'boxes: expected [{"class": name, "boxes": {camera: [x0, y0, x1, y1]}}], got what '
            f"gives {type(cause).__name__}: {cause}"
        ) from None


def boxes_of_groups(boxes: Any, count: int) -> list[Any]:
    """The boxes of each group of images."""
    if boxes is None:
        return [None] * count
    if isinstance(boxes, (list, tuple)) and len(boxes) == count:
        if all(one is None or isinstance(one, (str, os.PathLike, list, tuple)) for one in boxes):
            return list(boxes)
    raise refused(
        f"boxes: expected a list of {count}, the boxes of each group of images or None, got "
        f"{type(boxes).__name__}"
        + (f" of {len(boxes)}" if isinstance(boxes, (list, tuple)) else "")
    )


def _box(box: Sequence[float]) -> list[float]:
    # Characters of texts would be taken for numbers; sets have no order, mappings no numbers.
    if isinstance(box, (*_TEXTS, Set, Mapping)):
        raise TypeError(f"{box!r} is no box")
    x0, y0, x1, y1 = box
    if any(isinstance(x, _TEXTS) for x in (x0, y0, x1, y1)):
        raise TypeError(f"{box!r} is no box of numbers")
    return [float(x) for x in (x0, y0, x1, y1)]
