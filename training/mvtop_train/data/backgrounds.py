"""Pictures of anything, to put behind and before what was rendered."""

import functools
import hashlib
from pathlib import Path

import cv2
import numpy as np

from .. import files
from ..errors import UserError

SIDE = 960  # px, of what is kept of a picture: some hundred fit into memory
BYTES = 1 << 28  # of a picture's file at most
ENDINGS = {".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff"}


def pictures(folder: Path | str) -> list[Path]:
    """The pictures of a folder and those below it, in the order of their names."""
    found = sorted(p for p in Path(folder).rglob("*") if p.suffix.lower() in ENDINGS)
    if not found:
        raise UserError(
            f"backgrounds {folder}: expected a folder of pictures ({', '.join(sorted(ENDINGS))}), "
            "got none; fix: photographs of your empty cell are best"
        )
    for path in found:
        if not files.is_bounded(path, BYTES):
            raise UserError(
                f"backgrounds {path}: expected a file of {BYTES >> 20} MiB at most, got a larger "
                "one, or a folder, pipe or device; fix: remove it"
            )
    return found


def fingerprint(folder: Path | str) -> bytes:
    """What tells pictures apart that have the same names: all that is in them."""
    digest = hashlib.sha256()
    for path in pictures(folder):
        digest.update(f"{path.relative_to(folder)} {path.stat().st_size}\n".encode())
        digest.update(path.read_bytes())
    return digest.digest()


def cut(paths: list[Path], rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """A random piece [height, width, 3] uint8 of one of the pictures, mirrored half of the time."""
    picture = _read(paths[rng.integers(len(paths))])
    h, w = picture.shape[:2]
    share = rng.uniform(0.25, 1.0) * min(h / height, w / width)
    size = max(int(height * share), 1), max(int(width * share), 1)
    y, x = (rng.integers(0, have - wanted + 1) for have, wanted in zip((h, w), size, strict=True))
    piece = picture[y : y + size[0], x : x + size[1]]
    if rng.random() < 0.5:
        piece = piece[:, ::-1]
    way = cv2.INTER_AREA if share > 1 else cv2.INTER_LINEAR
    return cv2.resize(np.ascontiguousarray(piece), (width, height), interpolation=way)


@functools.lru_cache(256)
def _read(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    if picture is None:
        raise UserError(
            f"{path}: expected a picture, got a file that does not load; fix: remove it"
        )
    shrink = min(1.0, SIDE / max(picture.shape[:2]))
    return cv2.resize(picture, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
