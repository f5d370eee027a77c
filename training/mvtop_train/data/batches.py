"""The stream of training batches: which scenes and views each step sees."""

import itertools
import time
from pathlib import Path

import cv2
import numpy as np
import torch

from . import bop, boxes, choice, collate, crops
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


def share_of(count: int, rank: int, processes: int) -> range:
    """Numbers of one process's items; every process has equally many."""
    return range(rank, count - count % processes, processes)


class Batches(torch.utils.data.Dataset):
    """Item `step` is that step's batch of `images` views, all scenes with one number of views.

    It is drawn from (seed, step) alone, whichever process makes it, so a run that is resumed goes
    on as if it had never stopped (as long as the data set stays the same). Of several `processes`
    each gets its part, `rank`, of the same batch.

    views: shares of batches with 1, 2, ... views; negatives: crops without the object that come on
    top, as a share of `images`.
    """

    def __init__(self, scenes: Scenes, size, images, views, negatives, seed, aug, rank, processes):
        self.scenes, self.size, self.aug, self.seed = scenes, size, aug, seed
        self.images, self.views = images, np.array(views)
        self.negatives = round(negatives * images)
        self.rank, self.processes = rank, processes
        self.boxes_of = boxes.amodal_boxes(scenes.obj.bounds)

    def _mine(self, count: int) -> range:
        return share_of(count, self.rank, self.processes)

    def __getitem__(self, step: int) -> dict[str, torch.Tensor]:
        cv2.setNumThreads(1)  # the processes share the cores
        self.scenes.refresh()
        training = self.scenes.training
        rng = np.random.default_rng([self.seed, step])
        views, enough = choice.draw_views(training, self.views, rng)
        items = []
        for number in self._mine(self.images // views):
            rng = np.random.default_rng([self.seed, step, number])
            scene = training[enough[rng.integers(len(enough))]]
            chosen = choice.choose_views(scene, views, rng)
            items.append([crops.make_view(image, self.size, rng, self.aug) for image in chosen])
        batch = collate.collate(items, self.boxes_of, self.aug.jitter)
        absent = []
        for number in self._mine(self.negatives):
            rng = np.random.default_rng([self.seed, step, self.images + number])
            absent.append(crops.make_negative(training, self.size, rng, self.aug))
        absent = [crop for crop in absent if crop is not None]
        return batch | (collate.collate_negatives(absent) if absent else {})


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
