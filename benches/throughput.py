"""What a step of training costs: batches, network, optimiser, and the processor's bound.

    PYTHONPATH=training python benches/throughput.py --config parts
    PYTHONPATH=training python benches/throughput.py --config small-cpu --json FILE

Measures batches alone, steps alone on batches that are there already, and both at once as in a run.
Multiply-adds are PyTorch's own count; the bound is the speed of large matrix products.
"""

import contextlib
import json
import tempfile
import time
from pathlib import Path

import mvtop_train  # noqa: F401, before PyTorch: it says how threads wait
import result_file
import torch
from mvtop_train.data import backgrounds, batches, objects
from mvtop_train.errors import argument_parser, command
from mvtop_train.network.precision import autocast
from mvtop_train.shipped import ConfigParser
from mvtop_train.training import loop, processes, runconfig
from mvtop_train.training.checkpoint import TrainingState
from mvtop_train.training.optimise import optimise
from torch.utils.flop_counter import FlopCounterMode

SIDE = 2048  # of the matrices whose product is the bound
LEARNING_RATE = 1e-6


class Stages:
    """Seconds by what they were spent on, by hooks into a training step."""

    def __init__(self, state: TrainingState):
        self.seconds = {}  # in the order of the table
        self._begun = {}
        self._around(state.model, "network, forward")
        if trunk := getattr(state.model.features, "trunk", None):
            self._around(trunk, "of it, never trained")
        self.seconds["optimiser"] = 0.0
        for part in state.optimizer.parts.values():
            part.register_step_pre_hook(lambda *_: self._begin("optimiser"))
            part.register_step_post_hook(lambda *_: self._end("optimiser"))

    def _around(self, module, name: str):
        self.seconds[name] = 0.0
        module.register_forward_pre_hook(lambda *_: self._begin(name))
        module.register_forward_hook(lambda *_: self._end(name))

    def _begin(self, name: str):
        self._begun[name] = time.perf_counter()

    def _end(self, name: str):
        self.seconds[name] += time.perf_counter() - self._begun[name]


def repeated(make, seconds: float) -> tuple[float, int]:
    """Seconds of one `make()` on average, and how many were made; the first call warms up."""
    make()
    begun, count = time.monotonic(), 0
    while time.monotonic() - begun < seconds:
        make()
        count += 1
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return (time.monotonic() - begun) / count, count


def peak(device: str, precision: str, seconds: float) -> float:
    """Multiply-adds a second of matrix products."""
    a = torch.ones(SIDE, SIDE, device=device)
    with autocast(device, precision):
        a = (a @ a) / SIDE  # in the precision that is measured
        return SIDE**3 / repeated(lambda: a @ a, seconds)[0]


def measure(settings: runconfig.RunConfig, seconds: float, scenes_used: int) -> dict:
    me = processes.join()
    known = settings.known()
    config = settings.network_config(objects.classes_of(*known))
    scenes = batches.Scenes(Path(settings.data), known, settings.held_out)
    scenes.training = scenes.training[:scenes_used]
    scenes.refresh = lambda: None
    with tempfile.TemporaryDirectory() as scratch:  # nothing is saved, and none resumed
        state = TrainingState(Path(scratch), config, me.device, settings.init, settings.backbone)
        composer = loop.composer_of(settings)
        for path in composer.pictures if composer else ():
            backgrounds._read(path)  # kept from then on, as they are after some minutes of a run
        stream = loop.batches_of(settings, state, scenes, composer, me)
        made, figures = [], {"device": me.device, "threads": torch.get_num_threads()}
        begun = time.process_time()
        repeated(lambda: made.append(stream[len(made)]), seconds)
        figures["batch_cpu_s"] = (time.process_time() - begun) / len(made)

        taken = iter(range(1 << 30))

        def step(batch=None):
            batch = batch or made[next(taken) % len(made)]
            optimise(state, state.model, batch, settings, LEARNING_RATE)
            state.update_average()

        with FlopCounterMode(display=False) as counter, _in_pytorch(state):
            step()
        figures["multiply_adds"] = counter.get_total_flops() / 2
        step()
        stages = Stages(state)
        figures["step_alone_s"], count = repeated(step, seconds)
        figures["stages_s"] = {name: x / (count + 1) for name, x in stages.seconds.items()}
        loader = batches.loader(stream, 0, settings.workers, pinned=me.device != "cpu")
        figures["step_in_run_s"], _ = repeated(lambda: step(next(loader)), 2 * seconds)
        figures["peak"] = peak(me.device, settings.precision, seconds / 4)
    figures["least_step_s"] = figures["multiply_adds"] / figures["peak"]
    return figures


@contextlib.contextmanager
def _in_pytorch(state: TrainingState):
    """What another runtime computes is computed by PyTorch, so that it is counted."""
    trunk = getattr(state.model.features, "trunk", None)
    fixed = getattr(trunk, "fixed", None)
    if fixed is not None:
        trunk.fixed = None
    yield
    if fixed is not None:
        trunk.fixed = fixed


def rows(figures: dict) -> list[list[str]]:
    """Of the page's table."""
    used = figures["least_step_s"] / figures["step_alone_s"]
    return [
        ["step in a run", f"{figures['step_in_run_s']:.2f} s"],
        ["step alone", f"{figures['step_alone_s']:.2f} s"],
        *([name, f"{x:.2f} s"] for name, x in figures["stages_s"].items()),
        ["batch, processor time", f"{figures['batch_cpu_s']:.2f} s"],
        ["multiply-adds of a step", f"{figures['multiply_adds'] / 1e9:.0f} G"],
        ["matrix products, multiply-adds a second", f"{figures['peak'] / 1e9:.0f} G"],
        ["a step at that speed", f"{figures['least_step_s']:.2f} s ({100 * used:.0f} %)"],
    ]


@command
def main():
    parser = argument_parser(__doc__, ConfigParser)
    runconfig.add_arguments(parser)
    parser.add_argument("--seconds", type=float, default=20.0, help="for each measurement")
    parser.add_argument("--scenes", type=int, default=40, help="of which batches are made")
    parser.add_argument("--json", type=Path, help="a section of docs/benchmarks.md")
    args = parser.parse_args()
    settings = runconfig.load(args.config, args.set)
    figures = measure(settings, args.seconds, args.scenes)
    print(json.dumps(figures))
    if args.json:
        title = f"Training step, `--config {args.config.stem}`"
        result_file.write(args.json, title, settings.seed, ["", ""], rows(figures))


if __name__ == "__main__":
    main()
