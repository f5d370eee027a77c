"""Train a network as a config file says; resumes by itself from the run folder.

    python -m mvtop_train.train --config training/runs/small-cpu.toml
    torchrun --nproc_per_node 2 -m mvtop_train.train --config training/runs/small-gpu.toml

Writes `last.pt` (weights, their moving average, optimiser, step), `weights.pt` (the average, half
precision), `log.jsonl`, TensorBoard's files and the config to the run folder. See docs/training.md.
"""

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from . import bank, batches, closeup, losses, objects, processes, runconfig, sampling
from . import config as configs
from .checkpoint import Run
from .data import amodal_boxes, collate, fixed_views, make_view
from .inputs import to_device, to_views


def autocast(device, precision: str = "bf16"):
    kind = torch.device(device).type
    return torch.autocast(kind, dtype=torch.bfloat16, enabled=precision == "bf16")


def learning_rate(step: int, progress: float, peak: float, warmup: int) -> float:
    """Linear over the first steps, then half a cosine down to 2 % as `progress` goes to 1."""
    if step < warmup:
        peak = peak * (step + 1) / warmup
    return peak * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(progress, 1))))


@torch.no_grad()
def validate(
    model, scenes, points, config, size, device, views: int, aug, per_scene=2, precision="bf16"
) -> dict:
    """Errors on held-out scenes with lightly jittered true boxes, without augmentation."""
    rng = np.random.default_rng(0)
    boxes_of = amodal_boxes(points)

    def make(image):
        if config.closeup:
            return closeup.make_view(image, config, points, rng, augment=False)
        return make_view(image, size, rng, aug, augment=False)

    items = [
        [make(image) for image in chosen]
        for scene in scenes
        if len(scene) >= views
        for chosen in fixed_views(scene, views, per_scene)
    ]
    rot, t = [], []
    for start in range(0, len(items), 32):
        part = items[start : start + 32]
        batch = closeup.collate_items(part) if config.closeup else collate(part, boxes_of, 0.02)
        with autocast(device, precision):
            prediction = model(to_views(batch, config, device))
        r, d = losses.pose_errors(prediction.poses, batch["cam_from_obj"][:, :1].to(device))
        rot.append(torch.rad2deg(r[-1]).flatten().cpu())
        t.append(d[-1].flatten().cpu())
    rot, t = torch.cat(rot), torch.cat(t)
    return {
        "rot_mean_deg": rot.mean().item(),
        "rot_median_deg": rot.median().item(),
        "share_over_30_deg": (rot > 30).float().mean().item(),
        "trans_mean_m": t.mean().item(),
    }


class Meter:
    """Means since the last report. Sums stay on the device, so that no step waits for another."""

    def __init__(self):
        self.sums, self.images, self.waited, self.started = {}, 0, 0.0, time.monotonic()

    def add(self, parts: dict, views: int, images: int, waited: float):
        parts["rotation_deg_multi" if views > 1 else "rotation_deg_one"] = parts["rotation_deg"]
        for name, value in parts.items():
            total, n = self.sums.get(name, (0.0, 0))
            self.sums[name] = (total + value.detach(), n + 1)
        self.images += images
        self.waited += waited

    def report(self) -> dict:
        means = {name: round(float(total) / n, 5) for name, (total, n) in self.sums.items()}
        seconds = time.monotonic() - self.started
        rates = {
            "images_per_s": round(self.images / seconds, 1),
            "waited": round(self.waited / seconds, 3),  # share of the time, for data
        }
        self.__init__()
        return {**means, **rates}


class Log:
    """`log.jsonl` and TensorBoard's files; `--logdir` is the run folder or one above it."""

    def __init__(self, run: Run):
        from torch.utils.tensorboard import SummaryWriter

        self.run, self.path = run, run.folder / "log.jsonl"
        self.writer = SummaryWriter(run.folder, purge_step=run.step + 1 if run.step else None)

    def write(self, record: dict, group: str):
        with open(self.path, "a") as file:
            file.write(json.dumps({"step": self.run.step, **record}) + "\n")
        for name, value in record.items():
            self.writer.add_scalar(f"{group}/{name}", value, self.run.step)
        self.writer.flush()


def optimise(run: Run, model, batch, settings: runconfig.RunConfig, lr: float, device) -> dict:
    """One step on `batch`; returns the parts of the loss, still on the device."""
    for group in run.optimizer.param_groups:
        group["lr"] = group["scale"] * lr
    views = to_views(batch, run.config, device)
    with autocast(device, settings.precision):
        prediction = model(views)
    names = ("cam_from_obj", "boxes", "coords")
    truth = to_device({n: batch[n] for n in names if n in batch}, device)
    loss, parts = losses.total(prediction, truth, run.config.strides[0], settings.weights())
    run.optimizer.zero_grad(set_to_none=True)
    loss.backward()
    norm = torch.nn.utils.clip_grad_norm_(run.model.parameters(), settings.clip)
    for parameter in run.model.parameters():
        if parameter.grad is not None:  # not finite anywhere: counts as zero everywhere
            parameter.grad.nan_to_num_(0, 0, 0)
    run.optimizer.step()
    return {"loss": loss, "norm": norm, **parts}


class Clock:
    """How far a run is, of its steps and of its minutes, whichever is further."""

    def __init__(self, settings: runconfig.RunConfig, run: Run, device: str, alone: bool):
        self.settings, self.run, self.device = settings, run, device
        self.every = 1 if alone else 16  # other processes must be told of the time
        self.before, self.started = run.elapsed, time.monotonic()
        self.fraction = self._look()
        self.begun = self.progress()

    def _look(self) -> float:
        minutes = self.settings.minutes
        if minutes:
            return processes.from_first(self.run.elapsed / 60 / minutes, self.device)
        return 0.0

    def progress(self) -> float:
        """0 to 1 and over; the same in all processes."""
        self.run.elapsed = self.before + time.monotonic() - self.started
        step, steps = self.run.step, self.settings.steps
        if step % self.every == 0:
            self.fraction = self._look()
        return max(self.fraction, step / steps if steps else 0.0)

    def minutes_left(self, progress: float) -> float:
        pace = (self.run.elapsed - self.before) / max(progress - self.begun, 1e-9)
        return max(1 - progress, 0) * pace / 60


class Timer:
    """True about every `minutes`."""

    def __init__(self, minutes: float):
        self.seconds, self.last = minutes * 60, time.monotonic()

    def due(self) -> bool:
        if time.monotonic() - self.last < self.seconds:
            return False
        self.last = time.monotonic()
        return True


def train(settings: runconfig.RunConfig, folder: Path):
    me = processes.join()
    device, first = me.device, me.rank == 0
    if device == "cpu" and first and not sampling.kernel_available():
        print("note: Rust sampling kernel not found, training is several times slower; "
              "fix: cargo build --release -p mvtop-ffi")  # fmt: skip
    obj = objects.read(Path(settings.data), settings.object or None)
    config = settings.network_config(configs.classes_of(obj))
    scenes = batches.Scenes(Path(settings.data), obj, settings.held_out)
    if first:
        runconfig.keep_copy(settings, folder)
    torch.manual_seed(settings.seed)  # all processes start from the same weights
    given = [Path(path) if path else None for path in (settings.init, settings.backbone)]
    run = Run(folder, config, device, *given)
    run.model.train()
    # Torchvision's FPN makes maps that are not used.
    model = processes.distributed(run.model, me, unused=config.backbone != "conv")
    aug = settings.augmentation_of(config)
    clock = Clock(settings, run, device, alone=me.count == 1)
    if settings.backbone:
        run.model.features.backbone.eval()

        def features():
            return bank.Bank(
                folder / "features", scenes.training, run.average, obj.bounds, settings.copies,
                settings.seed, settings.workers,
            )  # fmt: skip

        made = features() if first else None
        processes.from_first(0.0, device)  # the others wait until they are all there
        stream = bank.Batches(
            made or features(), settings.images, settings.views, settings.seed, me.rank, me.count
        )
    else:
        stream = batches.Batches(
            scenes, settings.crop, settings.images, settings.views, settings.negatives,
            settings.seed, aug, me.rank, me.count,
        )  # fmt: skip
    loader = batches.loader(stream, run.step, settings.workers, pinned=device != "cpu")
    saving, validating = Timer(settings.save_minutes), Timer(settings.validate_minutes)
    meter, log = Meter(), Log(run) if first else None
    bar = tqdm(
        total=settings.steps or None, initial=run.step, unit="step", smoothing=0.02,
        disable=not first,
    )  # fmt: skip

    def validation():
        for n in (1, 2):
            if any(len(scene) >= n for scene in scenes.held):
                result = validate(
                    run.average, scenes.held, obj.bounds, config, settings.crop, device, n, aug,
                    precision=settings.precision,
                )  # fmt: skip
                log.write({"validation_views": n, **result}, f"validation_{n}_views")
                bar.write(f"step {run.step}, {n} view(s): {json.dumps(result)}")

    progress = clock.begun
    while progress < 1:
        mark = time.monotonic()
        batch = next(loader)
        waited = time.monotonic() - mark
        lr = learning_rate(run.step, progress, settings.lr, settings.warmup)
        parts = optimise(run, model, batch, settings, lr, device)
        run.update_average()
        run.step += 1
        progress = clock.progress()
        scenes_in, views = batch["k"].shape[:2]
        meter.add(parts, views, scenes_in * views * me.count, waited)
        bar.update()
        last = progress >= 1
        if first and (run.step % settings.log_steps == 0 or last):
            report = meter.report()
            left = clock.minutes_left(progress)
            log.write({**report, "lr": lr, "minutes_left": round(left, 1)}, "training")
            bar.set_postfix_str(
                f"loss {report['loss']:.2f} rot {report.get('rotation_deg_multi', 0):.1f} "
                f"t {report['translation_m'] * 1e3:.0f} mm {report['images_per_s']:.0f} img/s, "
                f"{left:.0f} min left"
            )
        if first and (saving.due() or last):
            run.save()
        if first and (validating.due() or last):
            validation()
    bar.close()
    processes.leave()


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--config", type=Path, required=True, help="TOML, see training/runs/")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a key of it"
    )
    parser.add_argument(
        "--out", type=Path, help="folder of this run, resumed if there (runs/<name of the config>)"
    )
    args = parser.parse_args()
    settings = runconfig.load(args.config, args.set)
    train(settings, args.out or Path("runs") / args.config.stem)


if __name__ == "__main__":
    main()
