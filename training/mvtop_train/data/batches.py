"""The stream of training batches: which scenes and views each step sees."""

import itertools
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from . import bop, choice, crops, views
from .objects import Object

REFRESH_SECONDS = 30


class Scenes:
    """The scenes of a split, some held out; those that a generator adds meanwhile are found."""

    def __init__(self, root: Path, obj: Object, held_out: int, split: str = "train"):
        self.root, self.split, self.obj = Path(root), split, obj
        scenes = bop.load_index(root, split, obj)
        count = held_out if len(scenes) > 2 * held_out else len(scenes) // 5
        self.held, self.training = scenes[:count], scenes[count:]
        self._known = {scene[0].path.parents[1] for scene in scenes}
        self._read = time.monotonic()

    def refresh(self):
        """Add the scenes that have become whole since the last look, at most every half minute."""
        if time.monotonic() - self._read < REFRESH_SECONDS:
            return
        self._read = time.monotonic()
        folder = self.root / self.split
        new = sorted(p for p in folder.iterdir() if p not in self._known and bop.is_whole(p))
        self._known.update(new)
        self.training += [scene for scene in (bop.read_scene(p, self.obj) for p in new) if scene]


class Fresh:
    """A source of views that are made when they are asked for."""

    def __init__(self, scenes: Scenes, maker: views.ViewMaker):
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


class Batches(torch.utils.data.Dataset):
    """Item `step` is that step's batch of `images` views, all scenes with one number of views.

    It is drawn from (seed, step) alone, whichever process makes it, so a run that is resumed goes
    on as if it had never stopped (as long as the data set stays the same). Of several `processes`
    each gets its part, `rank`, of the same batch.

    source  `Fresh` or a `bank.Bank`: its scenes, and a view of each of their images
    shares  of batches with 1, 2, ... views
    """

    def __init__(
        self, source, images: int, shares, seed: int, rank: int, processes: int,
        negatives: Negatives | None = None,
    ):  # fmt: skip
        self.source, self.images, self.shares, self.seed = source, images, np.array(shares), seed
        self.rank, self.processes, self.negatives = rank, processes, negatives

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
        return views.collate(items) | self._absent(step)

    def _absent(self, step: int) -> dict[str, torch.Tensor]:
        """negative_image [M, H, W, 3] uint8 and negative_on_image [M, H, W] bool."""
        if self.negatives is None:
            return {}
        rngs = (
            np.random.default_rng([self.seed, step, self.images + number])
            for number in self._mine(self.negatives.count)
        )
        made = [crop for crop in map(self.negatives.make, rngs) if crop is not None]
        names = ("image", "on_image") if made else ()
        stacked = {name: np.stack([crop[name] for crop in made]) for name in names}
        return {f"negative_{name}": torch.from_numpy(x) for name, x in stacked.items()}


def loader(batches: Batches, start: int, workers: int, pinned: bool):
    """Batches from step `start` on, in order, made ahead by `workers` processes."""
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
