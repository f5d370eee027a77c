"""The training loop, resumed by itself from the run folder."""

import json
import time
from pathlib import Path

import torch
from tqdm import tqdm

from ..data import bank, batches, crops, objects
from ..data.views import ViewMaker
from ..network import sampling
from . import processes, runconfig
from .checkpoint import Run
from .optimise import learning_rate, optimise
from .progress import Clock, Log, Meter, Timer
from .validate import pose_views, validate


def train(settings: runconfig.RunConfig, folder: Path):
    me = processes.join()
    device, first = me.device, me.rank == 0
    if device == "cpu" and first and not sampling.kernel_available():
        print("note: Rust sampling kernel not found, training is several times slower; "
              "fix: cargo build --release -p mvtop-ffi")  # fmt: skip
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
    clock = Clock(settings, run, device, alone=me.count == 1)
    shared = settings.images, settings.views, settings.seed, me.rank, me.count
    if settings.backbone:
        run.model.features.backbone.eval()

        def features():
            maker = pose_views(settings, config, obj.bounds, True)
            return bank.Bank(
                folder / "features", scenes.training, maker, run.average.features.backbone,
                settings.copies, settings.seed, settings.workers,
            )  # fmt: skip

        made = features() if first else None
        processes.from_first(0.0, device)  # the others wait until they are all there
        stream = batches.Batches(made or features(), *shared)
    else:
        crop = crops.Crops(settings.crop, settings.augmentation_of(config))
        fresh = batches.Fresh(scenes, ViewMaker(crop, config, obj.bounds))
        negatives = batches.Negatives(scenes, crop, round(settings.negatives * settings.images))
        stream = batches.Batches(fresh, *shared, negatives)
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
                    run.average, scenes.held, pose_views(settings, config, obj.bounds, False),
                    device, n, precision=settings.precision,
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
