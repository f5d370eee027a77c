"""What the frozen part of the network makes of many views, computed once: the rest trains on it.

A step then costs neither pictures nor that part: of a frozen backbone, as in the paper, only
encoder, decoder and heads are left. A bank is a folder of arrays; making one goes on after a kill.
"""

import errno
import json
import math
import os
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from ..errors import UserError
from ..network.precision import autocast
from . import bop
from .inputs import normalised
from .views import COORDINATE_STRIDE, ViewMaker, one_thread

BATCH = 64  # views through the backbone at once
FULL = errno.ENOSPC, errno.EDQUOT
META = {
    "k": ((3, 3), np.float64),
    "cam_from_world": ((4, 4), np.float64),
    "cam_from_obj": ((4, 4), np.float64),
    "box": ((4,), np.float64),
    "extent": ((), np.float64),
    "class_index": ((), np.int64),
}


class Copies(torch.utils.data.Dataset):
    """Item n: a view of image n, drawn from (seed, n) alone."""

    def __init__(self, images: list[bop.Image], maker: ViewMaker, seed: int):
        self.images, self.maker, self.seed = images, maker, seed

    def __len__(self):
        return len(self.images)

    def __getitem__(self, n: int) -> dict[str, np.ndarray]:
        return self.maker.make_view(self.images[n], np.random.default_rng([self.seed, n]))


class Bank:
    """A source of views (`batches.Batches`): every image of `scenes`, seen `copies` times.

    arrays    features_0, ... [N, C, h, w] float16, inside [N, cells], coords [N, h, w, 3] coded
              and those of `META` [N, ...]
    numbers   which of the N show what, by the image's path and the annotation in it
    features  of the network, whose `cache` these are
    backbone  digest of the checkpoint that it has them from, if any
    """

    def __init__(
        self, folder: Path, scenes, maker: ViewMaker, features, copies: int, seed: int, workers=1,
        backbone: str = "",
    ):  # fmt: skip
        self.scenes, self.config, self.numbers = scenes, maker.config, {}
        config, size = self.config, self.config.closeup
        images = [image for scene in scenes for image in scene] * copies
        for n, image in enumerate(images):
            self.numbers.setdefault((image.path, image.annotation), []).append(n)
        recipe = {
            "images": len(images), "copies": copies, "seed": seed, "size": size,
            "strides": list(config.pose_strides), **_of(backbone),
        }  # fmt: skip
        state = folder / "state.json"
        done = self._done(state, recipe)
        cells = sum(rows * columns for rows, columns in config.level_shapes(size, size))
        kinds = META | {"inside": ((cells,), np.bool_)}
        kinds["coords"] = ((size // COORDINATE_STRIDE, size // COORDINATE_STRIDE, 3), np.uint8)
        device = next(features.parameters()).device
        with torch.no_grad():
            maps = features.cache(torch.zeros(1, 3, size, size, device=device))
        kinds |= {f"features_{n}": (one.shape[1:], np.float16) for n, one in enumerate(maps)}
        if done:
            self.arrays = {
                name: np.lib.format.open_memmap(folder / f"{name}.npy", "r+") for name in kinds
            }
        else:
            self.arrays = new_arrays(folder, len(images), kinds)
        if done < len(images):
            views = Copies(images, maker, seed)
            for count in self._fill(features, views, done, workers):
                bop.write_json(state, {**recipe, "done": count})

    def view(self, image: bop.Image, rng) -> dict[str, np.ndarray]:
        """One of the image's copies, its features instead of its picture."""
        return self.row(rng.choice(self.numbers[image.path, image.annotation]))

    def first(self, image: bop.Image) -> dict[str, np.ndarray]:
        """The first of the image's copies."""
        return self.row(self.numbers[image.path, image.annotation][0])

    def row(self, n: int) -> dict[str, np.ndarray]:
        return {name: array[n] for name, array in self.arrays.items()}

    @staticmethod
    def _done(state: Path, recipe: dict) -> int:
        if not state.exists():
            return 0
        found = json.loads(state.read_text())
        done = found.pop("done")
        if found != recipe:
            raise UserError(
                f"{state.parent}: expected features of {recipe}, got {found}; "
                "fix: another folder, or delete this one"
            )
        return done

    @torch.no_grad()
    def _fill(self, features, views: Copies, done: int, workers: int):
        """Computes what is missing; yields how many are there, after each batch."""
        device, config = next(features.parameters()).device, self.config
        rest = torch.utils.data.Subset(views, range(done, len(views)))
        one_thread()
        loader = torch.utils.data.DataLoader(rest, BATCH, num_workers=workers)
        with tqdm(total=len(views), initial=done, unit="view", desc="features") as bar:
            for batch in loader:
                x = normalised(batch["image"].to(device), batch["on_image"].to(device), config)
                with autocast(device):
                    maps = features.cache(x.contiguous(memory_format=torch.channels_last))
                rows = slice(done, done + len(x))
                for n, one in enumerate(maps):
                    self.arrays[f"features_{n}"][rows] = one.half().cpu().numpy()
                for name in (*META, "inside", "coords"):
                    self.arrays[name][rows] = batch[name].numpy()
                done = rows.stop
                bar.update(len(x))
                yield done


def new_arrays(folder: Path, count: int, kinds: dict) -> dict[str, np.memmap]:
    """Arrays [count, *shape] by name, in files. Their room on the disk is taken at once: without,
    a disk that gets full ends the process without a word.

    kinds  shape and type by name
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = {name: folder / f"{name}.npy" for name in kinds}
    arrays = {}
    try:
        for name, (shape, kind) in kinds.items():
            arrays[name] = np.lib.format.open_memmap(paths[name], "w+", kind, (count, *shape))
            _take_room(paths[name])
    except OSError as error:
        if error.errno not in FULL:
            raise
        for path in paths.values():
            path.unlink(missing_ok=True)
        size = sum(math.prod(shape) * np.dtype(kind).itemsize for shape, kind in kinds.values())
        raise UserError(
            f"{folder}: expected room for {count * size / 1e9:.1f} GB, the features of {count} "
            "views, got a full disk; fix: make room, or another --out with fewer of them "
            "(--set copies=N or generate.scenes=N)"
        ) from None
    return arrays


def _take_room(path: Path):
    if not hasattr(os, "posix_fallocate"):
        return
    with open(path, "r+b") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, path.stat().st_size)
        except OSError as error:  # that a file system cannot do it is no harm
            if error.errno in FULL:
                raise


def _of(backbone: str) -> dict:
    return {"backbone": backbone} if backbone else {}


def is_of(folder: Path, backbone: str) -> bool:
    """Whether the bank `folder` is there, of this checkpoint."""
    state = folder / "state.json"
    return state.exists() and json.loads(state.read_text()).get("backbone") == backbone
