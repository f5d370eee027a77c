"""The training loop, resumed by itself from the run folder."""

import functools
import time
from pathlib import Path

import torch

from .. import children
from ..data import backgrounds, bank, batches, crops, objects, search
from ..data.composite import Composer
from ..data.views import ViewMaker
from . import processes
from .checkpoint import LAST, TrainingState, digest
from .monitor import Monitor
from .optimise import learning_rate, optimise
from .progress import Clock
from .runconfig import RunConfig, keep_copy
from .validate import pose_views


def train(settings: RunConfig, folder: Path, scenes: batches.Mixed | None = None):
    """Train as `settings` say, from where the run in `folder` stands to its end.

    scenes  what to train on; those of `settings.data` if left out
    """
    me = processes.join()
    known = settings.known()
    if scenes is None:
        scenes = batches.Scenes(Path(settings.data), known, settings.held_out)
    composer = composer_of(settings)  # refuses before a config is kept
    if me.rank == 0:
        keep_copy(settings, folder)
    torch.manual_seed(settings.seed)  # all processes start from the same weights
    config = settings.network_config(objects.classes_of(*known))
    init = start_of(settings, folder, me)
    state = TrainingState(folder, config, me.device, init, settings.backbone)
    # Torchvision's FPN makes maps that are not used; boxes may not be learnt, or not each time.
    apart = not config.shares_backbone and (not settings.searched or settings.search_every > 1)
    unused = apart or config.backbone not in ("conv", "lite")
    model = processes.distributed(state.model, me, unused=unused)
    clock = Clock(settings, state, alone=me.count == 1)
    stream = batches_of(settings, state, scenes, composer, me)
    loader = batches.loader(stream, state.step, settings.workers, pinned=me.device != "cpu")
    monitor = Monitor(settings, state, scenes, me.count) if me.rank == 0 else None
    train_steps(settings, state, model, loader, clock, monitor)
    processes.leave()


def start_of(settings: RunConfig, folder: Path, me: processes.Processes) -> str:
    """The checkpoint that a run starts from. Weights of a bundle are read back out of it, as long
    as there is nothing to go on from."""
    if not settings.init or not Path(settings.init).is_dir() or (folder / LAST).exists():
        return settings.init
    path = folder / "start.pt"
    if me.rank == 0:
        path.unlink(missing_ok=True)  # of a run that was stopped early; maybe of another bundle
        children.ended_well(children.python(
            "-m", "mvtop_train.export.restore", "--start", "--bundle", settings.init,
            "--data", settings.data, "--out", path,
        ))  # fmt: skip
    processes.from_first(0.0, me.device)  # the others wait until it is there
    return str(path)


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
    settings: RunConfig, state: TrainingState, scenes: batches.Scenes | batches.Mixed,
    composer: Composer | None, me: processes.Processes,
) -> batches.Batches:  # fmt: skip
    """Crops for all of the network; where its backbone is frozen, cached features of close-ups."""
    shared = settings.images, settings.views, settings.seed, me.rank, me.count
    config = state.config
    more: batches.Negatives | batches.Searched | None = None
    if not config.shares_backbone and settings.searched:
        searches = search.Searches(config, scenes.objects, composer, settings.zoom)
        more = batches.Searched(scenes, searches, settings.searched)
    closeups = pose_views(settings, config, scenes.objects, True, composer)
    if settings.backbone:
        features = functools.partial(
            bank.Bank, state.folder / "features", scenes.training, closeups,
            state.average.features, settings.copies, settings.seed, settings.workers,
            digest(settings.backbone),
        )  # fmt: skip
        made = features() if me.rank == 0 else None
        processes.from_first(0.0, me.device)  # the others wait until they are all there
        return batches.Batches(made or features(), *shared, more, settings.search_every)
    if config.shares_backbone:
        crop = crops.Crops(settings.crop, settings.augmentation_of(config))
        closeups = ViewMaker(crop, config, scenes.objects, True, composer)
        more = batches.Negatives(scenes, crop, round(settings.negatives * settings.images))
    return batches.Batches(batches.Fresh(scenes, closeups), *shared, more, settings.search_every)


def composer_of(settings: RunConfig) -> Composer | None:
    """What puts other things around objects, where the config names pictures for it."""
    if not settings.backgrounds:
        return None
    return Composer(backgrounds.pictures(settings.backgrounds), settings.occluders)
