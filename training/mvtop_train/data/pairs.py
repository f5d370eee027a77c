"""The pairs of a split: which image is looked at together with which, the reference first.

`pairs.json` beside the scenes: {"pairs": [[scene, image, image], ...]}, in the order of scenes and
images. Every image that has a partner is the reference of exactly one pair. Of MV-ball the partner
shows the other hemisphere (paper, section 3), so that a pair determines the pose and neither image
does; of other objects it is the scene's next image.
"""

from pathlib import Path

from ..errors import UserError
from ..files import read_json
from . import bop

FILE = "pairs.json"


def of_scene(shows: dict[int, str | None]) -> list[tuple[int, int]]:
    """Pairs of image numbers. shows  image number -> hemisphere, or None"""
    numbers = sorted(shows)
    pairs = []
    for number in numbers:
        if shows[number] in ("green", "red"):
            same = [n for n in numbers if shows[n] == shows[number]]
            others = [n for n in numbers if shows[n] not in (shows[number], None)]
            place = same.index(number)
        else:
            others, place = [n for n in numbers if n != number], numbers.index(number)
        if others:
            pairs.append((number, others[place % len(others)]))
    return pairs


def write(folder: Path) -> tuple[int, int, int]:
    """Write the pairs of the scenes that a split has so far; how many (scenes, images, pairs)."""
    found = {
        int(path.name): {image.number: _shows(image) for image in bop.read_images(path)}
        for path in bop.whole_scenes(folder)
    }
    pairs = [[scene, *pair] for scene, shows in found.items() for pair in of_scene(shows)]
    bop.write_json(folder / FILE, {"pairs": pairs})
    return len(found), sum(map(len, found.values())), len(pairs)


def _shows(image: bop.Image) -> str | None:
    """The hemisphere, of images of one ball."""
    return image.shows if len(image.instances) == 1 else None


def read(folder: Path) -> list[tuple[int, int, int]]:
    """(scene, reference image, other image) of a split."""
    path = folder / FILE
    if not path.exists():
        raise UserError(f"{path}: no such file; fix: mvtop-train generate writes it at its end")
    fix = "mvtop-train generate writes it anew"
    try:
        return [(int(a), int(b), int(c)) for a, b, c in read_json(path, fix)["pairs"]]
    except (KeyError, TypeError, ValueError) as error:
        expected = '{"pairs": [[scene, image, image], ...]}'
        raise UserError(
            f"{path}: expected {expected}, got what gives {error!r}; fix: {fix}"
        ) from None
