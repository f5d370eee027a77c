"""What a split of a data set is made of: its random stream, its size, what it was made from."""

import json
from dataclasses import dataclass
from pathlib import Path

from ..data import mvball
from ..errors import UserError

# Splits draw from different random streams: no test scene can be a training scene.
# Control splits show both hemispheres in every view: there, one view determines the pose.
SPLITS = {"train": 0, "easy": 1, "hard": 2, "control": 3, "control_test": 4, "test": 5}
# Visible pixels of the hemisphere, paper.
MIN_PIXELS = {"train": 10, "easy": 300, "hard": 10, "control": 10, "control_test": 10, "test": 10}
PAPER_IMAGES = {"train": 112_042, "easy": 3_853, "hard": 3_458}


@dataclass(frozen=True)
class PartFile:
    """A user's own part."""

    mesh: str
    unit: str
    id: int
    name: str
    symmetries: tuple[tuple, tuple] = ((), ())  # discrete and continuous, see `ObjectClass`
    diameter_m: float | None = None  # by the file that tells of its symmetries


@dataclass(frozen=True)
class Recipe:
    """All that decides what a split looks like; kept beside its scenes."""

    seed: int
    split: str
    size: tuple[int, int]  # of MV-ball's images, px; of a rig's: the largest width, and 0
    name: str = mvball.NAME
    parts: tuple[PartFile, ...] = ()
    most: int = 1  # of each part in a scene
    rigs: tuple[str, ...] = ()  # none: any rig
    backgrounds: str | None = None
    source: str = ""  # digest of the meshes, their unit, the rigs and how many of each
    beside: str = ""  # digest of what files beside the meshes tell of these

    def check(self, folder: Path):
        """Refuse to add scenes to those of another recipe."""
        mine = {"seed": self.seed, "size": list(self.size), "name": self.name}
        mine |= {"source": self.source, "ids": [part.id for part in self.parts]}
        mine["textures and symmetries"] = self.beside
        path = folder / "recipe.json"
        found = json.loads(path.read_text()) if path.exists() else mine
        for key in ("ids", "textures and symmetries"):
            found.setdefault(key, mine[key])  # of an earlier version
        differs = [key for key in mine if found.get(key) != mine[key]]
        if differs:
            key = differs[0]
            raise UserError(
                f"{folder} was made with {key} {found.get(key)!r}, got {mine[key]!r}; "
                "fix: another --out"
            )
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(mine) + "\n")


def hemispheres(split: str, index: int, views: int) -> list[str]:
    """What each view of scene `index` shows."""
    if split.startswith("control"):
        return ["both"] * views
    return [("green", "red")[(index + i) % 2] for i in range(views)]


def views_per_scene(images: int, views: int) -> list[int]:
    """How many images each scene gets; none is left with a single one, which has no partner."""
    counts = [views] * (images // views)
    rest = images % views
    if rest == 1 and counts:
        counts[-1] += 1
    elif rest:
        counts.append(rest)
    return counts
