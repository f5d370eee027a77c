"""The fixed test sets: where they lie, which model they ask for, and how they are made."""

import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from .. import children
from ..data import bop
from ..network.config import ObjectClass
from . import groups

SHARED = Path("../shared/data")
MESHES = SHARED / "ycbv/models"
BACKGROUNDS = Path("data/backgrounds")
YCBV4 = {2: "cracker_box", 4: "soup_can", 5: "mustard_bottle", 9: "potted_meat_can"}
# Classes of the models that sets ask for.
CLASSES = {
    "mvball": {"mvball"},
    "ycbv4": set(YCBV4.values()),
    "parts": {"hex_nut", "pipe_tee", "stepped_shaft", "angle_bracket"},
}
SEEDS, PAIRS = (0, 1, 2), 100  # of the ball's pairs, of each seed


@dataclass(frozen=True)
class TestSet:
    """A test set. Paths are relative to the project's root."""

    __test__ = False  # no tests, whatever pytest takes it for

    name: str
    model: str  # mvball, ycbv4 or parts
    views: int
    folders: tuple[Path, ...]  # of samples; in BOP's layout, the one data set
    bop: bool = False
    disjoint: bool = False  # groups share no image
    parts: int | None = None  # samples in each folder, or scenes, at most
    # Makes so many parts where there are fewer, or says why it cannot.
    make: Callable[[Path, int], str | None] | None = None
    usual: bool = True  # run where no set is named

    def missing(self, limit: int | None) -> str | None:
        """Why it cannot be run, in a sentence; what can be made is made first.

        - limit: groups of the set, at most
        """
        wanted = limit
        for folder in self.folders:
            if wanted is not None and wanted <= 0:
                break
            if self.make is not None:
                parts = self.parts if wanted is None else min(self.parts, wanted)
                if self._count(folder) < parts and (why := self.make(folder, parts)):
                    return why
                wanted = None if wanted is None else wanted - parts
            if not self._count(folder):
                return f"{folder}: no such test set"
        return None

    def _count(self, folder: Path) -> int:
        if self.bop:
            return len(bop.whole_scenes(folder / "test"))
        return len([folder] if (folder / "rig.json").exists() else [*folder.glob("*/truth.json")])

    def planned(self, classes: dict[str, ObjectClass], limit: int | None) -> list[groups.Planned]:
        """Its groups, at most so many.

        - classes: those that the model knows, by name
        """
        if self.bop:
            (root,) = self.folders
            known = groups.classes_in(root, classes.values())
            found = groups.of_bop(
                root, self.views, known, disjoint=self.disjoint, scenes=self.parts
            )
        else:
            found = []
            for folder in self.folders:
                if limit is not None and len(found) >= limit:
                    break
                prefix = f"{folder.name}/" if len(self.folders) > 1 else ""
                found += groups.of_samples(folder, classes, self.parts, prefix)
        return found[:limit]


def _command(module: str, *arguments) -> str | None:
    """Runs a command of the training; why it failed, in a sentence."""
    done = subprocess.run(children.python("-m", f"mvtop_train.{module}", *arguments), check=False)
    return f"mvtop_train.{module} failed, see above" if done.returncode else None


def _pairs(seed: int) -> Path:
    return Path(f"out/eval/hard-seed{seed}-views2-{PAIRS}")


def _balls(folder: Path, count: int) -> str | None:
    """Renders hard pairs of the ball, by the seed in the folder's name."""
    seed = next(seed for seed in SEEDS if _pairs(seed) == folder)
    return _command(
        "synthesis.samples", "--out", folder, "--split", "hard", "--seed", seed,
        "--count", count, "--views", 2,
    )  # fmt: skip


def _ycbv4(folder: Path, scenes: int) -> str | None:
    """Renders scenes of the four YCB objects, as in docs/models/ycbv4.md."""
    meshes = {number: MESHES / f"obj_{number:06d}.obj" for number in YCBV4}
    for path in (*meshes.values(), BACKGROUNDS):
        if not path.exists():
            return f"{folder}: no such test set, and {path}, of which it is made, is not there"
    named = []
    for number, name in YCBV4.items():
        named += ["--mesh", meshes[number], "--name", name, "--id", number]
    return _command(
        "generate", "--out", folder, "--split", "test", "--scenes", scenes,
        "--mesh-unit", "mm", *named, "--backgrounds", BACKGROUNDS,
    )  # fmt: skip


def fixed() -> dict[str, TestSet]:
    """All sets by name, in the order in which they are run."""
    balls = tuple(map(_pairs, SEEDS))
    path, photos = SHARED / "photoreal", SHARED / "photos"
    rendered = {"bop": True, "disjoint": True, "parts": 60}
    example = {"usual": False}
    sets = [
        TestSet("ball", "mvball", 2, balls, parts=PAIRS, make=_balls),
        *(TestSet(f"parts-{n}", "parts", n, (Path("data/parts"),), **rendered) for n in (4, 2)),
        *(
            TestSet(f"ycbv4-{n}", "ycbv4", n, (Path("data/ycbv4"),), make=_ycbv4, **rendered)
            for n in (3, 2)
        ),
        TestSet("path-ball", "mvball", 2, (path / "mvball",)),
        *(TestSet(f"path-ycb-{n}", "ycbv4", n, (path / "ycb",), bop=True) for n in (3, 2)),
        *(TestSet(f"path-parts-{n}", "parts", n, (path / "parts",), bop=True) for n in (4, 2)),
        *(TestSet(f"photos-{n}", "ycbv4", n, (photos,), bop=True) for n in (2, 3, 4, 6)),
        TestSet("scene59-3", "ycbv4", 3, (SHARED / "ycbv",), bop=True),
        TestSet("ball-short", "mvball", 2, balls[:1], parts=25, make=_balls, **example),
        TestSet("example-mvball", "mvball", 2, (Path("examples/mvball"),), **example),
        TestSet("example-ycbv4", "ycbv4", 3, (Path("examples/ycbv4"),), **example),
    ]
    return {one.name: one for one in sets}


def single_views() -> dict[str, TestSet]:
    """The same by name, with all their images one by one: those of one data set once.

    Samples stay groups, as each image is in one of them.
    """
    found: dict[str, TestSet] = {}
    for one in fixed().values():
        name = one.name.removesuffix(f"-{one.views}")
        found.setdefault(name, replace(one, name=name, views=1 if one.bop else one.views))
    return found
