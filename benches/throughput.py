"""How fast batches are made, and how fast the network takes them: which one bounds a run.

    PYTHONPATH=training python benches/throughput.py \\
        --config training/mvtop_train/runs/small-cpu.toml

Views a second of one loader process (and its processor time per view, which other jobs on the
machine do not change), of the training step on batches that are there already, and how many loader
processes keep it busy.
"""

import json
import tempfile
import time
from pathlib import Path

import torch
from mvtop_train.data import batches, objects
from mvtop_train.errors import UserError, argument_parser, command
from mvtop_train.training import loop, processes, runconfig
from mvtop_train.training.checkpoint import TrainingState
from mvtop_train.training.optimise import optimise


def _rate(make, seconds: float) -> float:
    """Views a second of `make()`, which returns how many it made; the first call warms up."""
    make()
    begun, views = time.monotonic(), 0
    while time.monotonic() - begun < seconds:
        views += make()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return views / (time.monotonic() - begun)


def measure(settings: runconfig.RunConfig, seconds: float) -> dict:
    if settings.backbone:
        # What never changes is computed beforehand, into the run's folder, which is none here.
        raise UserError(
            f"backbone: expected a config that trains the whole network, got "
            f"{settings.backbone!r}; name a config of another stage, or give --set backbone="
        )
    me = processes.join()
    device = me.device
    known = settings.known()
    config = settings.network_config(objects.classes_of(*known))
    scenes = batches.Scenes(Path(settings.data), known, settings.held_out)
    with tempfile.TemporaryDirectory() as scratch:  # nothing is saved, and none resumed
        state = TrainingState(Path(scratch), config, device)
    stream = loop.batches_of(settings, state, scenes, loop.composer_of(settings), me)
    made = []

    def load():
        made.append(stream[len(made)])
        return made[-1]["image"].shape[:2].numel()

    begun = time.process_time()
    loader = _rate(load, seconds)
    busy = time.process_time() - begun
    views = sum(batch["image"].shape[:2].numel() for batch in made)
    taken = iter(range(1 << 30))

    def step():
        batch = made[next(taken) % len(made)]
        optimise(state, state.model, batch, settings, 1e-6)
        state.update_average()
        return batch["image"].shape[:2].numel()

    steps = _rate(step, seconds)
    return {
        "device": device,
        "threads": torch.get_num_threads(),
        "loader_views_per_s": round(loader, 1),
        "loader_cpu_ms_per_view": round(busy / views * 1e3, 2),
        "step_views_per_s": round(steps, 1),
        "loaders_needed": round(steps / loader, 2),
    }


@command
def main():
    parser = argument_parser(__doc__)
    runconfig.add_arguments(parser)
    parser.add_argument("--seconds", type=float, default=20.0, help="for each measurement")
    args = parser.parse_args()
    settings = runconfig.load(args.config, args.set)
    print(json.dumps(measure(settings, args.seconds)))


if __name__ == "__main__":
    main()
