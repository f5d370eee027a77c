"""The training loop, resumed by itself from the run folder."""

import json
import time
from pathlib import Path

import torch
from tqdm import tqdm

from ..data import bank, batches, objects
from ..network import sampling
from . import processes, runconfig
from .checkpoint import Run
from .optimise import learning_rate, optimise
from .progress import Clock, Log, Meter, Timer
from .validate import validate


def train(settings: runconfig.RunConfig, folder: Path):
    me = processes.join()
    device, first = me.device, me.rank == 0
    if device == "cpu" and first and not sampling.kernel_available():
        print("note: mvtop's sampling kernel is not installed, training is several times slower; "
              "fix: make wheel")  # fmt: skip
    obj = objects.read(Path(settings.data), settings.object or None)
    config = settings.network_config(objects.classes_of(obj))
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
