"""Everything of a run that survives a kill: network, moving average, optimiser, progress."""

import contextlib
import copy
import dataclasses
import hashlib
import json
from pathlib import Path

import torch

from ..errors import UserError
from ..network import config as configs
from ..network import symmetry
from ..network.fixed import Fixed
from ..network.lite import load_pretrained
from ..network.model import Mvtop
from .optimiser import Optimizer

PRETRAINED = "pretrained"  # in place of a checkpoint: what keeps its pretrained weights anyway
LAST = "last.pt"  # of a run, what it goes on from
AVERAGE = "module."  # prefix of the average's tensors in a file


class TrainingState:
    """Model, its moving average and optimiser, saved to and restored from one file.

    last.pt     all of it, to go on from
    weights.pt  the average alone in half precision: for export and to start other runs from
    """

    def __init__(
        self, folder: Path, config: configs.Config, device: str, init: str = "", backbone: str = ""
    ):
        self.folder, self.config, self.device = Path(folder), config, device
        self.step, self.elapsed = 0, 0.0  # seconds
        self.folder.mkdir(parents=True, exist_ok=True)
        self.model = Mvtop(config).to(device, memory_format=torch.channels_last)
        self.average = copy.deepcopy(self.model).eval().requires_grad_(False)
        self.updates = 0  # of the average
        self.symmetries = symmetry.of(config.classes).to(device)
        self.optimizer = Optimizer(self.model)
        resumed = self.path.exists()
        if resumed:
            state = _read(self.path)
            with _fits(self.path):
                self.model.load_state_dict(state["model"])
                self._load_average(state)
                self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.elapsed = state["step"], state.get("elapsed_s", 0.0)
        elif config.backbone == "lite" and not init:
            load_pretrained(self.model.features)
            self.average.load_state_dict(self.model.state_dict())
        elif init:
            self._start_from(init)
        self.model.train()
        if backbone and backbone != PRETRAINED:
            if not resumed:  # what finds boxes may have been learnt on since
                self._take(backbone)
            for model in (self.model, self.average):
                model.features.freeze()
        if config.backbone == "lite" and device == "cpu":
            fixed = Fixed(self.model.features.trunk)  # never trained: the average's is the same
            for model in (self.model, self.average):
                model.features.trunk.fixed = fixed

    def _start_from(self, path: str):
        """Take the average of another run; of other objects, what belongs to none, or to one that
        this network knows as well, by its name."""
        state = _read(path)
        with _fits(path):
            known = configs.from_dict(json.loads(state["config"])).classes
            names = [[c.name for c in classes] for classes in (known, self.config.classes)]
            if names[0] == names[1]:
                grow_hypotheses(state["average"], self.average)
                self._load_average(state)
            else:
                given = of_objects(_average_of(state), *names, self.average)
                self.average.load_state_dict(given)
        self.model.load_state_dict(self.average.state_dict())

    def _take(self, path: str):
        """Take all that works on images alone from another run's average."""
        given = _average_of(_read(path))
        for model in (self.model, self.average):
            for name, part in model.features.named_children():
                if name != "encoder":
                    own = f"features.{name}."
                    mine = {k.removeprefix(own): x for k, x in given.items() if k.startswith(own)}
                    with _fits(path):
                        part.load_state_dict(mine)

    @property
    def path(self) -> Path:
        return self.folder / LAST

    def _load_average(self, state):
        self.average.load_state_dict(_average_of(state))
        self.updates = int(state["average"].get("n_averaged", state["step"]))

    @torch.no_grad()
    def update_average(self):
        """Exponential moving average that forgets the first, untrained steps quickly."""
        share = 1 - min(0.995, (1 + self.updates) / (10 + self.updates))
        self.updates += 1
        old, new = self.average.state_dict().values(), self.model.state_dict().values()
        pairs = [(a, b) for a, b in zip(old, new, strict=True) if a.is_floating_point()]
        torch._foreach_lerp_([a for a, _ in pairs], [b for _, b in pairs], share)
        for a, b in zip(old, new, strict=True):
            if not a.is_floating_point():
                a.copy_(b)

    def save(self):
        state = _described(self.average, self.updates, self.step) | {
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "elapsed_s": self.elapsed,
        }
        _write(state, self.path)
        save_weights(self.average, self.updates, self.step, self.folder / "weights.pt")


def save_weights(average: Mvtop, updates: int, step: int, path: Path):
    """Write a network in half precision, for export and to start runs from."""
    state = _described(average, updates, step)
    half = {k: x.half() if x.is_floating_point() else x for k, x in state["average"].items()}
    _write(state | {"average": half}, path)


def _described(average: Mvtop, updates: int, step: int) -> dict:
    """What every file holds: the moving average, of as many updates, and what network it is of."""
    tensors = {AVERAGE + name: x for name, x in average.state_dict().items()}
    tensors["n_averaged"] = torch.tensor(updates)
    return {"config": json.dumps(configs.to_dict(average.config)), "average": tensors, "step": step}


def _write(state: dict, path: Path):
    part = path.with_suffix(".part")
    torch.save(state, part)
    part.replace(path)  # a kill leaves the old file or the new one


def _read(path: Path | str) -> dict:
    try:  # to the CPU, where Adam's counts stay; what belongs on the device is copied there
        return torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise UserError(f"{path}: no such file; fix: name a checkpoint") from None
    except Exception as error:
        raise UserError(
            f"{path}: expected a checkpoint of a run, got a file that does not load "
            f"({type(error).__name__}); fix: use last.pt or weights.pt of a run"
        ) from None


def digest(path: Path | str) -> str:
    """Of a checkpoint's content; nothing of `PRETRAINED`."""
    return "" if path == PRETRAINED else hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]


@contextlib.contextmanager
def _fits(path: Path | str):
    """Turns what `load_state_dict` says of a network of another shape into one sentence."""
    try:
        yield
    except (RuntimeError, ValueError, KeyError) as error:
        lines = str(error).strip().splitlines()
        raise UserError(
            f"{path}: expected weights of this network, got others "
            f"({lines[min(1, len(lines) - 1)].strip()}); fix: the preset it was trained with"
        ) from None


def of_objects(given: dict, known: list[str], names: list[str], model: Mvtop) -> dict:
    """The weights of a network that knows objects of these names, for `model`, which is of others:
    it keeps its own for objects that are new."""
    config, weights = model.config, {}
    more = dataclasses.replace(config, classes=(*config.classes, config.classes[0]))
    shapes = {name: x.shape for name, x in Mvtop(more).state_dict().items()}
    for name, own in model.state_dict().items():
        weights[name] = given[name]
        if shapes[name] != own.shape:  # it has rows for each object
            of_each = own.clone().unflatten(0, (len(names), -1))
            before = given[name].unflatten(0, (len(known), -1))
            for i, of_object in enumerate(names):
                if of_object in known:
                    of_each[i] = before[known.index(of_object)]
            weights[name] = of_each.flatten(0, 1)
    return weights


def grow_hypotheses(given: dict, model: Mvtop):
    """To the average of a network with one pose of each object, the further ones of `model`."""
    classes, count = len(model.config.classes), model.config.hypotheses
    for name, own in model.state_dict().items():
        key = AVERAGE + name
        if not name.startswith("decoder.heads."):
            continue
        if key not in given:
            given[key] = own.clone()
        elif given[key].shape[0] * count == own.shape[0]:
            grown = own.clone().unflatten(0, (classes, count, -1))
            grown[:, 0] = given[key].unflatten(0, (classes, -1))
            given[key] = grown.flatten(0, 2)


def _average_of(state: dict) -> dict:
    average = state["average"].items()
    return {name[len(AVERAGE) :]: x for name, x in average if name.startswith(AVERAGE)}


def load_weights(path: Path) -> tuple[Mvtop, configs.Config, int]:
    """The averaged network of a run's `last.pt` or `weights.pt`, in eval mode."""
    state = _read(path)
    config = configs.from_dict(json.loads(state["config"]))
    model = Mvtop(config)
    model.load_state_dict(_average_of(state))
    return model.eval(), config, state["step"]
