"""Backbone features of many views, computed once: the pose network then trains on these alone.

The backbone is frozen, as in the paper, so a step costs only encoder, decoder and heads. A bank is
a folder of arrays; making one goes on after a kill.
"""

import json
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from ..errors import UserError
from . import bop
from .inputs import normalised
from .views import ViewMaker

BATCH = 64  # views through the backbone at once
META = {"k": (3, 3), "cam_from_world": (4, 4), "cam_from_obj": (4, 4), "box": (4,)}


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

    arrays    features [N, cells, C] float16, inside [N, cells], and those of `META` [N, ...]
    numbers   which of the N show an image, by its path
    backbone  [B, 3, S, S] -> maps at `config.strides`, of the maker's config
    """

    def __init__(
        self, folder: Path, scenes, maker: ViewMaker, backbone, copies: int, seed: int, workers=1
    ):
        self.scenes, self.config, self.numbers = scenes, maker.config, {}
        config, size = self.config, self.config.closeup
        images = [image for scene in scenes for image in scene] * copies
        for n, image in enumerate(images):
            self.numbers.setdefault(image.path, []).append(n)
        recipe = {
            "images": len(images), "copies": copies, "seed": seed, "size": size,
            "strides": list(config.pose_strides),
        }  # fmt: skip
        state = folder / "state.json"
        done = self._done(state, recipe)
        cells = sum(rows * columns for rows, columns in config.level_shapes(size, size))
        kinds = {name: (shape, np.float64) for name, shape in META.items()}
        kinds |= {"features": ((cells, config.d_model), np.float16), "inside": ((cells,), np.bool_)}
        folder.mkdir(parents=True, exist_ok=True)
        self.arrays = {
            name: np.lib.format.open_memmap(folder / f"{name}.npy", "r+")
            if done
            else np.lib.format.open_memmap(
                folder / f"{name}.npy", "w+", kind, (len(images), *shape)
            )
            for name, (shape, kind) in kinds.items()
        }
        if done < len(images):
            views = Copies(images, maker, seed)
            for count in self._fill(backbone, views, done, workers):
                state.write_text(json.dumps({**recipe, "done": count}))

    def view(self, image: bop.Image, rng) -> dict[str, np.ndarray]:
        """One of the image's copies, its features instead of its picture."""
        return self.row(rng.choice(self.numbers[image.path]))

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
    def _fill(self, backbone, views: Copies, done: int, workers: int):
        """Computes what is missing; yields how many are there, after each batch."""
        device, config = next(backbone.parameters()).device, self.config
        rest = torch.utils.data.Subset(views, range(done, len(views)))
        loader = torch.utils.data.DataLoader(rest, BATCH, num_workers=workers)
        with tqdm(total=len(views), initial=done, unit="view", desc="features") as bar:
            for batch in loader:
                x = normalised(batch["image"].to(device), batch["on_image"].to(device), config)
                with torch.autocast(device.type, dtype=torch.bfloat16):
                    maps = backbone(x.contiguous(memory_format=torch.channels_last))
                levels = [maps[config.strides.index(stride)] for stride in config.pose_strides]
                tokens = torch.cat([level.flatten(2).transpose(1, 2) for level in levels], 1)
                rows = slice(done, done + len(x))
                self.arrays["features"][rows] = tokens.half().cpu().numpy()
                for name in (*META, "inside"):
                    self.arrays[name][rows] = batch[name].numpy()
                done = rows.stop
                bar.update(len(x))
                yield done
