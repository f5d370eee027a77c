"""Backbone features of many close-ups, computed once: the pose network then trains on these alone.

The backbone is frozen, as in the paper, so a step costs only encoder, decoder and heads. A bank is
a folder of arrays; making one goes on after a kill.
"""

import json
from pathlib import Path

import cv2
import numpy as np
import torch
from tqdm import tqdm

from ..errors import UserError
from . import batches, choice, closeup

BATCH = 64  # close-ups through the backbone at once
META = {"k": (3, 3), "cam_from_world": (4, 4), "cam_from_obj": (4, 4), "box": (4,)}


class Pictures(torch.utils.data.Dataset):
    """Item n: close-up n of a bank, drawn from (seed, n) alone."""

    def __init__(self, images, config, bounds, seed: int):
        self.images, self.config, self.bounds, self.seed = images, config, bounds, seed

    def __len__(self):
        return len(self.images)

    def __getitem__(self, n: int) -> dict:
        cv2.setNumThreads(1)
        rng = np.random.default_rng([self.seed, n])
        return closeup.make_view(self.images[n], self.config, self.bounds, rng, True)


class Bank:
    """Close-ups of every image of `scenes`, each seen `copies` times.

    arrays   features [N, cells, C] float16, inside [N, cells], and those of `META` [N, ...]
    numbers  numbers[scene][image]: which of the N show it
    """

    def __init__(self, folder: Path, scenes, model, bounds, copies: int, seed: int, workers=1):
        config = model.config
        order = [(s, i) for s, scene in enumerate(scenes) for i in range(len(scene))] * copies
        images = [scenes[s][i] for s, i in order]
        self.scenes, self.numbers = scenes, [[[] for _ in scene] for scene in scenes]
        for n, (s, i) in enumerate(order):
            self.numbers[s][i].append(n)
        recipe = {
            "images": len(images), "copies": copies, "seed": seed, "size": config.closeup,
            "strides": list(config.pose_strides),
        }  # fmt: skip
        state = folder / "state.json"
        done = self._done(state, recipe)
        cells = sum(rows * columns for rows, columns in config.decoder_shapes())
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
            pictures = Pictures(images, config, bounds, seed)
            for count in self._fill(model, pictures, done, workers):
                state.write_text(json.dumps({**recipe, "done": count}))

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
    def _fill(self, model, pictures, done: int, workers: int):
        """Computes what is missing; yields how many are there, after each batch."""
        device = next(model.parameters()).device
        mean, std = (torch.tensor(x, device=device) for x in (model.config.mean, model.config.std))
        rest = torch.utils.data.Subset(pictures, range(done, len(pictures)))
        loader = torch.utils.data.DataLoader(rest, BATCH, num_workers=workers)
        with tqdm(total=len(pictures), initial=done, unit="picture", desc="features") as bar:
            for batch in loader:
                x = (batch["image"].to(device).float() / 255 - mean) / std
                x = (x * batch["on_image"].to(device)[..., None]).permute(0, 3, 1, 2)
                with torch.autocast(device.type, dtype=torch.bfloat16):
                    levels = model.features.pose_levels(
                        model.features.backbone(x.contiguous(memory_format=torch.channels_last))
                    )
                tokens = torch.cat([level.flatten(2).transpose(1, 2) for level in levels], 1)
                rows = slice(done, done + len(x))
                self.arrays["features"][rows] = tokens.half().cpu().numpy()
                for name in (*META, "inside"):
                    self.arrays[name][rows] = batch[name].numpy()
                done = rows.stop
                bar.update(len(x))
                yield done


class Batches(torch.utils.data.Dataset):
    """Item `step` is that step's batch, drawn from (seed, step) alone; as `batches.Batches`."""

    def __init__(self, bank: Bank, images: int, views, seed: int, rank: int, processes: int):
        self.bank, self.images, self.views, self.seed = bank, images, np.array(views), seed
        self.rank, self.processes = rank, processes

    def __getitem__(self, step: int) -> dict[str, torch.Tensor]:
        rng = np.random.default_rng([self.seed, step])
        scenes = self.bank.scenes
        views, enough = choice.draw_views(scenes, self.views, rng)
        chosen = []
        for number in batches.share_of(self.images // views, self.rank, self.processes):
            rng = np.random.default_rng([self.seed, step, number])
            s = enough[rng.integers(len(enough))]
            images = choice.choose_views(scenes[s], views, rng)
            chosen.append([rng.choice(self.bank.numbers[s][_index(scenes[s], x)]) for x in images])
        rows = np.array(chosen)
        return closeup.collate({name: array[rows] for name, array in self.bank.arrays.items()})


def _index(scene, image) -> int:
    return next(i for i, other in enumerate(scene) if other is image)
