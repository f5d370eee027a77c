"""Kinds of wrong calibrations and images, and which of them can be told of a group."""

import itertools
import math
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from . import shots
from .shots import Lie, Shot, Shots, of_all, of_last, placed, relative

ORDERS = 6  # wrong orders of images that are told of a group, at most
TRUE = "none"
DEFAULT = (TRUE, "gross", "fine")

# By kind and name. Wrong orders and foreign images depend on the group: `tellings`.
ORDER, REPEATED, REPEATED_LAST = "wrong order of images", "first image for all", "first for last"
FOREIGN = "last image of another scene"
LIES: dict[str, dict[str, Lie]] = {
    TRUE: {"none": lambda shots, rng: shots},
    "gross": {
        "last image mirrored": of_last(shots.mirrored),
        "last image upside down": of_last(shots.upside_down),
        "red and blue exchanged": of_all(shots.red_as_blue),
        "last camera rolled by 90 degrees": shots.rolled(90),
        "direction of poses swapped": placed(np.linalg.inv),
        "OpenGL axes": placed(shots.opengl),
        "rotations transposed": placed(shots.transposed),
        "order of quaternions": placed(shots.quaternion_misread),
    },
    "fine": {
        "translations 1 % too long": shots.scaled(1.01),
        "translations 2 % too long": shots.scaled(1.02),
        "translations 5 % too long": shots.scaled(1.05),
        "translations 2 % too short": shots.scaled(0.98),
        "translations 5 % too short": shots.scaled(0.95),
        "last camera turned by 1 degree": shots.turned(1),
        "last camera turned by 2 degrees": shots.turned(2),
        "last camera moved by 10 mm": shots.moved(0.01),
        "last camera moved by 20 mm": shots.moved(0.02),
        "focal lengths 3 % too long": of_all(shots.focal(1.03)),
        "last focal length 3 % too long": of_last(lambda s, rng: shots.focal(1.03)(s)),
        "last principal point off by 10 px": shots.principal_point(10),
    },
    "more": {  # further changes
        "last camera turned by 5 degrees": shots.turned(5),
        "last camera moved by 50 mm": shots.moved(0.05),
        "last camera rolled by 10 degrees": shots.rolled(10),
        "translations 10 % too long": shots.scaled(1.1),
        "translations 1000 times too long": shots.scaled(1000),
        "translations 1000 times too short": shots.scaled(1e-3),
        "direction swapped, first camera as world": relative(np.linalg.inv),
        "rotations transposed, first camera as world": relative(shots.transposed),
        "order of quaternions, first camera as world": relative(shots.quaternion_misread),
        "focal lengths 1.1 times too long": of_all(shots.focal(1.1)),
        "focal lengths 1.5 times too long": of_all(shots.focal(1.5)),
        "last focal length 1.1 times too long": of_last(lambda s, rng: shots.focal(1.1)(s)),
        "last principal point off by 30 px": shots.principal_point(30),
        "images of half the size": of_all(shots.halved),
        "equidistant read as pinhole": shots.fisheye_read_as("pinhole", ()),
        "equidistant read as radtan": shots.fisheye_read_as(
            "pinhole", (0.05, -0.02, 0.01, -0.005)
        ),
    },
}  # fmt: skip


@dataclass(frozen=True)
class Telling:
    """A lie about one group."""

    kind: str
    name: str
    change: Lie
    variant: str = ""  # of lies that are told of a group several times


def generator(seed: int, *names: str) -> np.random.Generator:
    """Of its own for each, so that neither limit nor order of groups changes what another draws."""
    return np.random.default_rng([seed, zlib.crc32("\0".join(names).encode())])


def orders(views: int, rng: np.random.Generator) -> list[tuple[int, ...]]:
    """The wrong orders of images; of more than three so many at random."""
    right = tuple(range(views))
    if math.factorial(views) - 1 <= ORDERS:
        return [order for order in itertools.permutations(right) if order != right]
    found: dict[tuple[int, ...], None] = {}
    while len(found) < ORDERS:
        order = tuple(rng.permutation(views).tolist())
        if order != right:
            found[order] = None
    return list(found)


def tellings(
    true: Shots,
    kinds: Iterable[str],
    rng: np.random.Generator,
    foreign: Callable[[], Shot] | None,
) -> list[Telling]:
    """The lies that can be told of a group.

    - rng: draws orders
    - foreign: gives the last camera of another scene; None: there is no other
    """
    views, found = len(true), []
    for kind in kinds:
        if kind == "gross":
            for order in orders(views, rng):
                name = " ".join(map(str, order))
                found.append(Telling(kind, ORDER, shots.ordered(order), name))
            found.append(Telling(kind, REPEATED, shots.ordered((0,) * views)))
            if views > 2:  # of two that is the same
                last = (*range(views - 1), 0)
                found.append(Telling(kind, REPEATED_LAST, shots.ordered(last)))
            if foreign is not None:
                change = of_last(lambda s, rng: replace(s, image=foreign().image, taken_by=None))
                found.append(Telling(kind, FOREIGN, change))
        ideal = all(shot.model == "pinhole" and not shot.distortion for shot in true)
        for name, lie in LIES[kind].items():
            if ideal or not name.startswith("equidistant"):
                found.append(Telling(kind, name, lie))
    return found
