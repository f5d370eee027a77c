"""Which image is of which camera and which exposure.

An exposure is one moment, or one place of the board that does not move while all cameras look.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mvtop._printable import printable, refused
from mvtop.calibration import _need

if TYPE_CHECKING:
    from numpy.typing import NDArray

ENDINGS = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp"}
_NUMBERED = re.compile(r"^(.*?)[_\-. ]?(\d+)$")
_NOT_COLOR = re.compile(r"^(depth|mask|mask_visib|normal|nocs)(_|$)")
_COLOR = re.compile(r"^(rgb|gray|grey)_(.+)$")

Source = Path | Any
"""A path, or an image: (H, W) or (H, W, 3), uint8."""
Sources = dict[str, dict[str, Source]]
"""By camera, then by exposure."""


@dataclass(frozen=True)
class Found:
    """Images, and how their names were taken."""

    images: Sources
    note: str


def find(folders: Sequence[str | os.PathLike[str]], *, layout: str | None = None) -> Found:
    """Images below folders.

    - layout: "exposure/camera", "camera/exposure" or "flat"; recognised by default

    Raises FileNotFoundError where there is no folder, ValueError where no images or no names are
    found.
    """
    images: Sources = {}
    notes: list[str] = []
    several = len(folders) > 1
    roots = [Path(folder) for folder in folders]
    for root in roots:
        if not root.is_dir():
            raise FileNotFoundError(f"{root}: expected a folder with images, got none")
    flat = [_files(root) for root in roots]
    below = [{p.name: _files(p) for p in _folders(root)} for root in roots]
    if several and layout in (None, "camera/exposure") and all(flat) and not any(map(any, below)):
        stems = [{p.stem for p in files} for files in flat]
        if layout or any(a & b for i, a in enumerate(stems) for b in stems[i + 1 :]):
            _check_names([root.resolve().name for root in roots])
            for root, files in zip(roots, flat, strict=True):
                images[_clean(root.resolve().name)] = {p.stem: p for p in files}
            return Found(images, "each folder was taken for a camera, each name for an exposure")
    for root, files, folders_below in zip(roots, flat, below, strict=True):
        prefix = f"{root.resolve().name}/" if several else ""
        held = {name: paths for name, paths in folders_below.items() if paths}
        taken = layout or ("flat" if files and not held else _recognise(held))
        for camera, exposure, path in _named(root, taken, files, held):
            by_exposure = images.setdefault(_clean(camera), {})
            if (key := prefix + exposure) in by_exposure:
                raise refused(
                    f"camera `{camera}`, exposure `{key}`: two images, {by_exposure[key]} and "
                    f"{path}; "
                    "expected one"
                )
            by_exposure[key] = path
        notes.append(_NOTES[taken])
    if not images:
        raise refused(
            f"{roots[0]}: expected images as EXPOSURE/CAMERA.png, CAMERA/EXPOSURE.png or "
            "CAMERA_NUMBER.png, got none"
        )
    return Found(images, "; ".join(dict.fromkeys(notes)))


_NOTES = {
    "exposure/camera": "folders were taken for exposures, names of images for cameras",
    "camera/exposure": "folders were taken for cameras, names of images for exposures",
    "flat": "names were taken for CAMERA and the number of an exposure",
}


def _named(
    root: Path, layout: str, files: list[Path], held: Mapping[str, list[Path]]
) -> Iterable[tuple[str, str, Path]]:
    if layout == "flat":
        for path in files:
            match = _NUMBERED.match(path.stem)
            if match is None:
                raise refused(
                    f"{path}: expected a name that ends in the number of its exposure, as "
                    f"left_01.png; "
                    "fix: sort images into a folder for each camera"
                )
            yield match[1] or root.resolve().name, match[2], path
        return
    if layout not in _NOTES:
        raise refused(f"layout: expected one of {', '.join(_NOTES)}, got {layout!r}")
    for folder, paths in held.items():
        for path in paths:
            if layout == "exposure/camera":
                yield path.stem, folder, path
            else:
                yield folder, path.stem, path


def _recognise(held: Mapping[str, list[Path]]) -> str:
    """Which of folders and names are cameras: those without numbers alone, else the fewer."""
    if any(_COLOR.match(name) for name in held):
        return "camera/exposure"
    stems = {p.stem for paths in held.values() for p in paths}
    numbered_folders = all(name.isdigit() for name in held)
    numbered_stems = all(stem.isdigit() for stem in stems)
    if numbered_folders != numbered_stems:
        return "exposure/camera" if numbered_folders else "camera/exposure"
    return "exposure/camera" if len(stems) < len(held) else "camera/exposure"


def _files(folder: Path) -> list[Path]:
    return sorted(
        p for p in folder.iterdir() if p.suffix.lower() in ENDINGS and not p.name.startswith(".")
    )


def _folders(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_dir() and not _NOT_COLOR.match(p.name))


def _clean(name: str) -> str:
    """A camera's id: letters, digits, `_`, `-` and `.`; of BOP's folders, what follows `rgb_`."""
    match = _COLOR.match(name)
    return re.sub(r"[^A-Za-z0-9_.\-]", "_", match[2] if match else name)


def _check_names(names: list[str]) -> None:
    if len(set(names)) != len(names):
        raise refused(f"folders: expected one for each camera, got {', '.join(names)}")


def folders(
    source: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
) -> list[str | os.PathLike[str]]:
    """One folder, or several, as a list."""
    return [source] if isinstance(source, (str, os.PathLike)) else list(source)


def of_mapping(images: Mapping[str, Any]) -> Sources:
    """Images by camera: a mapping by exposure, or a list whose places are exposures (None: none).

    Raises ValueError for anything else.
    """
    found: Sources = {}
    for camera, of in images.items():
        if isinstance(of, Mapping):
            found[camera] = {str(key): image for key, image in of.items() if image is not None}
        elif isinstance(of, (list, tuple)):
            found[camera] = {f"{i:03}": image for i, image in enumerate(of) if image is not None}
        else:
            raise refused(
                f"images, camera `{camera}`: expected a list or a mapping by exposure, got "
                f"{type(of).__name__}"
            )
    return found


def grey(source: Source, name: str) -> NDArray[np.uint8]:
    """(H, W) uint8, as the file's pixels lie: a turn that its header asks for is not made.

    Raises OSError where a file cannot be read, ValueError for an array of another kind.
    """
    cv2 = _need.opencv()
    if isinstance(source, (str, os.PathLike)):
        try:
            data = np.fromfile(source, np.uint8)
        except OSError as cause:
            raise OSError(printable(f"cannot read {source}: {cause.strerror}")) from None
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(data, flags) if len(data) else None
        if image is None:
            raise OSError(printable(f"cannot read {source}: expected an image"))
    else:
        image = np.asarray(source)
        if image.ndim == 3 and image.shape[2] == 3:
            image = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
            raise refused(
                f"{name}: expected an image of uint8, (H, W) or (H, W, 3), got {image.dtype} "
                f"{image.shape}"
            )
    if image.dtype == np.uint16:
        image = (image // max(1, (int(image.max()) + 255) // 255)).astype(np.uint8)
    grey: NDArray[np.uint8] = np.ascontiguousarray(image)
    return grey
