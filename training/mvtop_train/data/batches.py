"""The stream of training batches: which scenes and views each step sees."""

import itertools
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from . import bop, choice, crops, search, views
from .objects import Object

REFRESH_SECONDS = 30


class Scenes:
    """The scenes of a split, some held out; those that a generator adds meanwhile are found.

    held, training            for each thing in each scene, the images that show it alone
    held_images, images       all images with all that is in them
    """

    def __init__(
        self, root: Path, objects: tuple[Object, ...], held_out: int, split: str = "train"
    ):
        self.root, self.split, self.objects = Path(root), split, objects
        self._by_id = {obj.id: obj for obj in objects}
        paths = bop.whole_scenes(self.root / split)
        if not paths:
            bop.refuse_empty(root, split)
        count = held_count(len(paths), held_out)
        self.held, self.held_images = self._read_all(paths[:count])
        self.training, self.images = self._read_all(paths[count:])
        self._known = set(paths)
        self._looked = time.monotonic()

    def refresh(self):
        """Add the scenes that have become whole since the last look, at most every half minute."""
        if time.monotonic() - self._looked < REFRESH_SECONDS:
            return
        self._looked = time.monotonic()
        new = [path for path in bop.whole_scenes(self.root / self.split) if path not in self._known]
        self._known.update(new)
        things, images = self._read_all(new)
        self.training += things
        self.images += images

    def _read_all(self, paths: list[Path]):
        things, images = [], []
        for path in paths:
            found = bop.read_images(path)
            images += found
            things += bop.sightings(found, self._by_id)
        return things, images


class Mixed:
    """Photographs beside rendered scenes, none of them held out.

    Few as they are, photographs are listed several times, so that they make up `things` of the
    things and `images` of the images that are drawn: shares below 1.
    """

    def __init__(self, rendered: Scenes, photographs: Scenes, things: float, images: float):
        self.objects, self.held, self.held_images = rendered.objects, [], []
        self.training = _mixed(rendered.training, photographs.training, things)
        self.images = _mixed(rendered.images, photographs.images, images)

    def refresh(self):
        """Neither gets more."""


def _mixed(many: list, few: list, share: float) -> list:
    times = share / (1 - share) * len(many) / max(len(few), 1)
    return many + few * max(1, round(times))


def held_count(scenes: int, held_out: int) -> int:
    """How many of the first scenes are not trained on: `held_out`, of few a fifth."""
    return held_out if scenes > 2 * held_out else scenes // 5


class Fresh:
    """A source of views that are made when they are asked for."""

    def __init__(self, scenes: Scenes | Mixed, maker: views.ViewMaker):
        self._scenes, self.maker = scenes, maker

    @property
    def scenes(self) -> list[list[bop.Image]]:
        self._scenes.refresh()
        return self._scenes.training

    def view(self, image: bop.Image, rng) -> dict[str, np.ndarray]:
        return self.maker.make_view(image, rng)


@dataclass(frozen=True)
class Negatives:
    """Crops without the object that come on top of a batch: `count` of them."""

    scenes: Scenes
    crops: crops.Crops
    count: int

    def make(self, rng) -> dict[str, np.ndarray] | None:
        return crops.make_negative(self.scenes.training, self.crops, rng)


@dataclass(frozen=True)
class Searched:
    """Whole images with their boxes that come on top of a batch: `count` of them."""

    scenes: Scenes | Mixed
    searches: search.Searches
    count: int

    def make(self, rng) -> dict[str, np.ndarray]:
        images = self.scenes.images
        return self.searches.make(images[rng.integers(len(images))], rng)


class Batches(torch.utils.data.Dataset):
    """Item `step` is that step's batch of `images` views, all scenes with one number of views.

    It is drawn from (seed, step) alone, whichever process makes it, so a run that is resumed goes
    on as if it had never stopped (as long as the data set stays the same). Of several `processes`
    each gets its part, `rank`, of the same batch.

    source  `Fresh` or a `bank.Bank`: its scenes, and a view of each of their images
    shares  of batches with 1, 2, ... views
    more    what comes on top of every `every`-th batch
    """

    def __init__(
        self, source, images: int, shares, seed: int, rank: int, processes: int,
        more: Negatives | Searched | None = None, every: int = 1,
    ):  # fmt: skip
        self.source, self.images, self.shares, self.seed = source, images, np.array(shares), seed
        self.rank, self.processes, self.more, self.every = rank, processes, more, every

    def _mine(self, count: int) -> range:
        """Numbers of this process's items; every process has equally many."""
        return range(self.rank, count - count % self.processes, self.processes)

    def __getitem__(self, step: int) -> dict[str, torch.Tensor]:
        scenes = self.source.scenes
        count, enough = choice.draw_views(
            scenes, self.shares, np.random.default_rng([self.seed, step])
        )
        items = []
        for number in self._mine(self.images // count):
            rng = np.random.default_rng([self.seed, step, number])
            chosen = choice.choose_views(scenes[enough[rng.integers(len(enough))]], count, rng)
            items.append([self.source.view(image, rng) for image in chosen])
        return views.collate(items) | self._more(step)

    def _more(self, step: int) -> dict[str, torch.Tensor]:
        """What `more` makes, stacked; where there is no room for all of it, fewer."""
        if self.more is None or step % self.every:
            return {}
        rngs = (
            np.random.default_rng([self.seed, step, self.images + number])
            for number in self._mine(self.more.count)
        )
        made = [one for one in map(self.more.make, rngs) if one is not None]
        names = made[0] if made else ()
        return {name: torch.from_numpy(np.stack([one[name] for one in made])) for name in names}


def loader(batches: Batches, start: int, workers: int, pinned: bool):
    """Batches from step `start` on, in order, made ahead by `workers` processes."""
    views.one_thread()
    return iter(
        torch.utils.data.DataLoader(
            batches,
            batch_size=None,
            sampler=itertools.count(start),
            num_workers=workers,
            prefetch_factor=4 if workers else None,
            pin_memory=pinned,
        )
    )
