"""The training loop, resumed by itself from the run folder."""

import functools
import time
from pathlib import Path

import torch

from ..data import bank, batches, crops, objects
from ..data.views import ViewMaker
from ..network import sampling
from . import processes
from .checkpoint import TrainingState
from .monitor import Monitor
from .optimise import learning_rate, optimise
from .progress import Clock
from .runconfig import RunConfig, keep_copy
from .validate import pose_views


def train(settings: RunConfig, folder: Path):
    """Train as `settings` say, from where the run in `folder` stands to its end."""
    me = processes.join()
    if me.device == "cpu" and me.rank == 0 and not sampling.kernel_available():
        print("note: mvtop's sampling kernel is not installed, training is several times slower; "
              "fix: make wheel")  # fmt: skip
    obj = objects.read(Path(settings.data), settings.object or None)
    scenes = batches.Scenes(Path(settings.data), obj, settings.held_out)
    if me.rank == 0:
        keep_copy(settings, folder)
    torch.manual_seed(settings.seed)  # all processes start from the same weights
    config = settings.network_config(objects.classes_of(obj))
    state = TrainingState(folder, config, me.device, settings.init, settings.backbone)
    # Torchvision's FPN makes maps that are not used.
    model = processes.distributed(state.model, me, unused=config.backbone != "conv")
    clock = Clock(settings, state, alone=me.count == 1)
    stream = batches_of(settings, state, scenes, me)
    loader = batches.loader(stream, state.step, settings.workers, pinned=me.device != "cpu")
    monitor = Monitor(settings, state, scenes, me.count) if me.rank == 0 else None
    train_steps(settings, state, model, loader, clock, monitor)
    processes.leave()


def train_steps(
    settings: RunConfig, state: TrainingState, model, loader, clock: Clock, monitor: Monitor | None
):
    """Steps on batches of `loader` until the clock says that the run is over."""
    progress = clock.begun
    while progress < 1:
        mark = time.monotonic()
        batch = next(loader)
        waited = time.monotonic() - mark
        lr = learning_rate(state.step, progress, settings.lr, settings.warmup)
        terms = optimise(state, model, batch, settings, lr)
        state.update_average()
        state.step += 1
        progress = clock.progress()
        if monitor:
            monitor.after_step(clock, progress, lr, terms, batch["k"].shape[:2], waited)


def batches_of(
    settings: RunConfig, state: TrainingState, scenes: batches.Scenes, me: processes.Processes
) -> batches.Batches:
    """Crops for all of the network; where its backbone is frozen, cached features of close-ups."""
    shared = settings.images, settings.views, settings.seed, me.rank, me.count
    if not settings.backbone:
        crop = crops.Crops(settings.crop, settings.augmentation_of(state.config))
        fresh = batches.Fresh(scenes, ViewMaker(crop, state.config, scenes.obj.bounds))
        negatives = batches.Negatives(scenes, crop, round(settings.negatives * settings.images))
        return batches.Batches(fresh, *shared, negatives)
    maker = pose_views(settings, state.config, scenes.obj.bounds, True)
    features = functools.partial(
        bank.Bank, state.folder / "features", scenes.training, maker,
        state.average.features.backbone, settings.copies, settings.seed, settings.workers,
    )  # fmt: skip
    made = features() if me.rank == 0 else None
    processes.from_first(0.0, me.device)  # the others wait until they are all there
    return batches.Batches(made or features(), *shared)
