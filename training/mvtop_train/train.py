"""Train a network; resumes by itself from the run folder.

    python -m mvtop_train.train --data data/mvball --preset small --run runs/small --steps 12000

Writes `last.pt` (weights, their moving average, optimiser, step) and `log.jsonl` to the run
folder every few hundred steps, and picks up from there after a kill.
"""

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from . import config as configs
from . import losses, objects, rays, sampling
from .data import Augmentation, Batches, amodal_boxes, collate, fixed_views, load_index, make_view
from .model import Mvtop, Views

HELD_OUT_SCENES = 100


def to_views(batch, config, device="cpu") -> Views:
    """A batch of `data.collate` as the network takes it."""
    batch = {name: x.to(device) for name, x in batch.items()}
    height, width = batch["images"].shape[-3:-1]
    pixels = rays.cell_centres(config.level_shapes(height, width), config.strides, device)
    a = batch["crop_from_image"]
    source = (pixels - a[..., None, :, 2]) @ torch.linalg.inv(a[..., :2]).transpose(-1, -2)
    size = batch["image_size"][:, :, None]
    inside = ((source >= -0.5) & (source <= size - 0.5)).all(-1).float()
    shape = batch["boxes_in"].shape[:2]
    negatives = None
    if "negatives" in batch:
        negatives = _normalised(
            batch["negatives"],
            batch["negatives_crop_from_image"],
            batch["negatives_image_size"],
            config,
        )
    return Views(
        images=_normalised(batch["images"], a, batch["image_size"], config),
        k=batch["k"],
        ref_from_cam=batch["ref_from_cam"],
        boxes=batch["boxes_in"][:, :, None],
        valid=torch.ones(*shape, 1, device=device),
        class_index=torch.zeros(shape[0], 1, dtype=torch.long, device=device),
        inside=inside,
        negatives=negatives,
    )


def _normalised(images, crop_from_image, image_size, config):
    """Crops [..., H, W, 3] uint8 as [..., 3, H, W], 0 where they are off their source image."""
    mean = torch.tensor(config.mean, device=images.device)[:, None, None]
    std = torch.tensor(config.std, device=images.device)[:, None, None]
    mask = _pixel_mask(crop_from_image, image_size, *images.shape[-3:-1])
    return (images.movedim(-1, -3).float() / 255 - mean) / std * mask[..., None, :, :]


def _pixel_mask(a, image_size, height, width):
    """1.0 where a crop pixel lies on its source image [..., H, W]; the rest is exactly 0, as the
    padding of inference."""
    inverse = torch.linalg.inv(a[..., :2])
    u = torch.arange(width, device=a.device, dtype=torch.float32)
    v = torch.arange(height, device=a.device, dtype=torch.float32)
    x = (u[None] - a[..., 0, 2, None])[..., None, :]
    y = (v[None] - a[..., 1, 2, None])[..., None]
    inside = torch.ones((), device=a.device)
    for axis in range(2):
        s = inverse[..., axis, 0, None, None] * x + inverse[..., axis, 1, None, None] * y
        inside = inside * (s >= -0.5) * (s <= image_size[..., axis, None, None] - 0.5)
    return inside


def autocast(device):
    return torch.autocast(device, dtype=torch.bfloat16)


def learning_rate(step: int, total: int, peak: float, warmup: int = 300) -> float:
    if step < warmup:
        return peak * (step + 1) / warmup
    progress = min((step - warmup) / max(total - warmup, 1), 1)
    return peak * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * progress)))


@torch.no_grad()
def validate(
    model, scenes, points, config, size, device, views: int, aug, per_scene: int = 2
) -> dict:
    """Errors on held-out scenes with lightly jittered true boxes, without augmentation."""
    model.eval()
    rng = np.random.default_rng(0)
    boxes_of = amodal_boxes(points)
    items = [
        [make_view(image, size, rng, aug, augment=False) for image in chosen]
        for scene in scenes
        if len(scene) >= views
        for chosen in fixed_views(scene, views, per_scene)
    ]
    rot, t = [], []
    for start in range(0, len(items), 32):
        batch = collate(items[start : start + 32], boxes_of, 0.02, rng)
        with autocast(device):
            prediction = model(to_views(batch, config, device))
        r, d = losses.pose_errors(prediction, batch["cam_from_obj"][:, :1].to(device))
        rot.append(torch.rad2deg(r[-1]).flatten().cpu())
        t.append(d[-1].flatten().cpu())
    rot, t = torch.cat(rot), torch.cat(t)
    model.train()
    return {
        "rot_mean_deg": rot.mean().item(),
        "rot_median_deg": rot.median().item(),
        "share_over_30_deg": (rot > 30).float().mean().item(),
        "trans_mean_m": t.mean().item(),
    }


def _moving_average(average, new, updates):
    """Exponential moving average that forgets the first, untrained steps quickly."""
    share = 1 - min(0.995, (1 + float(updates)) / (10 + float(updates)))
    if not average.is_floating_point():
        return new
    return average + share * (new - average)


class Run:
    """Model, its moving average and optimiser, saved to and restored from one file."""

    def __init__(self, folder: Path, config, device: str, init: Path | None = None):
        self.folder, self.config, self.step = folder, config, 0
        folder.mkdir(parents=True, exist_ok=True)
        self.model = Mvtop(config).to(device)
        if config.backbone == "conv":
            self.model = self.model.to(memory_format=torch.channels_last)
        decay, plain = [], []
        slow = []
        for name, p in self.model.named_parameters():
            if ".offsets." in name:
                slow.append(p)
            else:
                (decay if p.ndim > 1 else plain).append(p)
        self.optimizer = torch.optim.AdamW(
            [
                {"params": decay, "weight_decay": 1e-4, "scale": 1.0},
                {"params": plain, "weight_decay": 0.0, "scale": 1.0},
                {"params": slow, "weight_decay": 0.0, "scale": 0.1},  # as Deformable DETR
            ],
            lr=1e-3,
        )
        self.average = torch.optim.swa_utils.AveragedModel(
            self.model, avg_fn=_moving_average, use_buffers=True
        )
        if self.path.exists():
            state = torch.load(self.path, map_location=device, weights_only=True)
            self.model.load_state_dict(state["model"])
            self.average.load_state_dict(state["average"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step = state["step"]
        elif init:
            state = torch.load(init, map_location=device, weights_only=True)
            self.average.load_state_dict(state["average"])
            self.model.load_state_dict(self.average.module.state_dict())

    @property
    def path(self) -> Path:
        return self.folder / "last.pt"

    def save(self):
        state = {
            "config": json.dumps(configs.to_dict(self.config)),
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
        }
        part = self.path.with_suffix(".part")
        torch.save(state, part)
        part.replace(self.path)  # a kill leaves the old file or the new one

    def log(self, record: dict):
        with open(self.folder / "log.jsonl", "a") as file:
            file.write(json.dumps({"step": self.step, **record}) + "\n")


def load_weights(path: Path) -> tuple[Mvtop, configs.Config, int]:
    """The averaged network of a run's `last.pt`, in eval mode."""
    state = torch.load(path, map_location="cpu", weights_only=True)
    config = configs.from_dict(json.loads(state["config"]))
    model = Mvtop(config)
    prefix = "module."
    average = {
        name[len(prefix) :]: x for name, x in state["average"].items() if name.startswith(prefix)
    }
    model.load_state_dict(average)
    return model.eval(), config, state["step"]


def train(args):
    device = "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cpu" and not sampling.kernel_available():
        print("note: Rust sampling kernel not found, training is several times slower; "
              "fix: cargo build --release -p mvtop-ffi")  # fmt: skip
    torch.manual_seed(args.seed)
    obj = objects.read(Path(args.data), args.object)
    config = configs.preset(args.preset, classes=configs.classes_of(obj))
    run = Run(Path(args.run), config, device, args.init)
    scenes = load_index(Path(args.data), obj=obj)
    held_out = HELD_OUT_SCENES if len(scenes) > 2 * HELD_OUT_SCENES else len(scenes) // 5
    training, held = scenes[held_out:], scenes[:held_out]
    aug = Augmentation(scale=config.width / 640)
    seed = args.seed * 1000 + run.step
    batches = Batches(training, obj.bounds, args.crop, args.images, seed, aug, args.negatives)
    loader = iter(
        torch.utils.data.DataLoader(
            batches,
            batch_size=None,
            num_workers=args.workers,
            prefetch_factor=4 if args.workers else None,
        )  # fmt: skip
    )
    run.model.train()
    bar = tqdm(total=args.steps, initial=run.step, unit="step", smoothing=0.02)
    started, seen, sums, count, waited = time.time(), 0, {}, 0, 0.0
    while run.step < args.steps:
        mark = time.time()
        batch = next(loader)
        waited += time.time() - mark
        for group in run.optimizer.param_groups:
            group["lr"] = group["scale"] * learning_rate(run.step, args.steps, args.lr)
        views = to_views(batch, config, device)
        with autocast(device):
            prediction = run.model(views)
        batch = {name: batch[name].to(device) for name in ("cam_from_obj", "boxes", "coords")}
        loss, parts = losses.total(prediction, batch, config.strides[0])
        run.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(run.model.parameters(), args.clip)
        if torch.isfinite(norm):
            run.optimizer.step()
        run.average.update_parameters(run.model)
        run.step += 1
        seen += views.images.shape[0] * views.images.shape[1]
        parts = {"loss": loss, "norm": norm, **parts}
        several = views.images.shape[1] > 1
        parts["rotation_deg_multi" if several else "rotation_deg_one"] = parts["rotation_deg"]
        for name, value in parts.items():
            total, n = sums.get(name, (0.0, 0))
            sums[name] = (total + value.item(), n + 1)
        count += 1
        bar.update()
        if run.step % args.log == 0 or run.step == args.steps:
            means = {name: round(total / n, 5) for name, (total, n) in sums.items()}
            rate = seen / (time.time() - started)
            run.log({**means, "images_per_s": round(rate, 1), "waited": round(waited, 1)})
            bar.set_postfix_str(
                f"rot {means.get('rotation_deg_multi', 0):.1f} "
                f"t {means['translation_m'] * 1e3:.0f} mm {rate:.0f} img/s"
            )
            sums = {}
        if run.step % args.save == 0 or run.step == args.steps:
            run.save()
        if run.step % args.validate == 0 or run.step == args.steps:
            for n in (1, 2):
                if not any(len(scene) >= n for scene in held):
                    continue
                result = validate(
                    run.average.module, held, obj.bounds, config, args.crop, device, n, aug
                )
                run.log({"validation_views": n, **result})
                bar.write(f"step {run.step}, {n} view(s): {json.dumps(result)}")
    bar.close()


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", default="data/mvball")
    parser.add_argument("--object", type=int, metavar="ID", help="of the objects in --data")
    parser.add_argument("--preset", choices=configs.PRESETS, default="small")
    parser.add_argument("--run", default="runs/small", help="folder of this run; resumed if there")
    parser.add_argument("--init", type=Path, help="start from the weights of another run's last.pt")
    parser.add_argument("--steps", type=int, default=12000)
    parser.add_argument("--images", type=int, default=64, help="images per batch")
    parser.add_argument(
        "--negatives", type=float, default=0.125, help="crops without the object, per image"
    )
    parser.add_argument("--crop", type=int, default=160, help="side of the training crops, px")
    parser.add_argument("--lr", type=float, default=1e-3)
    parser.add_argument("--clip", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1, help="processes that prepare batches")
    parser.add_argument("--log", type=int, default=50)
    parser.add_argument("--save", type=int, default=250)
    parser.add_argument("--validate", type=int, default=1000)
    train(parser.parse_args())


if __name__ == "__main__":
    main()
