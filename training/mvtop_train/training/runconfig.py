"""The one file that describes a training run (TOML); `training/runs/` has those of the docs."""

import dataclasses
import difflib
import json
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

from ..data.crops import Augmentation
from ..errors import UserError
from ..network import config as configs
from . import losses


@dataclass(frozen=True)
class RunConfig:
    """All keys of a run's config file, with what holds where the file says nothing.

    A run ends after `steps` steps or `minutes` of training, whichever comes first (0: no bound);
    the learning rate follows the larger of the two fractions, so it always ends annealed.
    """

    data: str = "data/mvball"  # data set in BOP layout; its split `train` is used
    object: int = 0  # id of the object; 0: the only one
    preset: str = "small"
    network: dict = field(default_factory=dict)  # changes to the preset (`network.config.Config`)
    init: str = ""  # checkpoint whose weights to start from
    backbone: str = ""  # checkpoint whose backbone to freeze; the rest is trained on close-ups
    copies: int = 5  # of each image among these, each seen otherwise
    steps: int = 0
    minutes: float = 0.0
    images: int = 64  # views per batch, of all processes together
    views: tuple = (0.2, 0.5, 0.15, 0.15)  # shares of batches with 1, 2, 3, ... views
    negatives: float = 0.125  # crops without the object, on top, as a share of `images`
    crop: int = 160  # side of the training crops, px
    lr: float = 1e-3  # at the peak
    warmup: int = 300  # steps
    clip: float = 5.0  # norm of the gradient
    precision: str = "bf16"  # or "fp32"; the geometry is in fp32 in either
    seed: int = 1
    augmentation: dict = field(default_factory=dict)  # changes to `data.crops.Augmentation`
    loss: dict = field(default_factory=dict)  # changes to `losses.WEIGHTS`
    held_out: int = 100  # scenes for validation; at most a fifth
    workers: int = 1  # processes that prepare batches, per training process
    log_steps: int = 50
    save_minutes: float = 3.0
    validate_minutes: float = 20.0
    generate: dict = field(default_factory=dict)  # what `mvtop_train.run` generates
    second: dict = field(default_factory=dict)  # its second stage, of networks with close-ups

    @property
    def closeup(self) -> int:
        """Side of the network's close-ups, px; 0: it has none."""
        return self.network.get("closeup", configs.PRESETS[self.preset].closeup)

    def network_config(self, classes) -> configs.Config:
        return configs.preset(self.preset, classes, **self.network)

    def augmentation_of(self, config: configs.Config) -> Augmentation:
        # Data sets are 640 px wide; the network sees them at this scale.
        return Augmentation(**{"scale": config.width / 640, **self.augmentation})

    def weights(self) -> dict[str, float]:
        return {**losses.WEIGHTS, **self.loss}


# What may differ when a run is resumed: how long, where and how often, but not what is learnt.
MAY_CHANGE = {
    "data", "init", "steps", "minutes", "workers", "log_steps", "save_minutes",
    "validate_minutes", "generate", "second",
}  # fmt: skip
GENERATE = {
    "scenes": 6000,  # of the training split
    "test": 100,  # scenes of the split that the result is evaluated on
    "views": 6,  # images per scene
    "window": 320,  # px rendered around the object; 0: whole images
    "start": 300,  # scenes with which the training starts
    "workers": 0,  # 0: all cores
    "reserve": 2.0,  # minutes kept for export and evaluation
}
SECOND = {
    "share": 0.4,  # of the time of the training
    "copies": 5,  # as in `RunConfig`, and those that follow
    "views": (0.15, 0.6, 0.15, 0.1),
    "lr": 1e-3,
    "warmup": 50,
}
_FIELDS = {f.name: f for f in dataclasses.fields(RunConfig)}


def _defaults(key: str):
    f = _FIELDS[key]
    return f.default if f.default is not dataclasses.MISSING else f.default_factory()


def _known(name: str, given, known, source):
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = f"did you mean {near[0]!r}?" if near else "remove it"
            raise UserError(
                f"{source}: unknown key {name}{key!r}, expected one of "
                f"{', '.join(sorted(known))}; fix: {hint}"
            )


def _typed(key: str, value, example, source):
    """`value` as the type of `example`."""
    if isinstance(example, float) and type(value) is int:
        value = float(value)
    if isinstance(example, tuple) and isinstance(value, list):
        value = tuple(value)
    if type(value) is not type(example):
        kind = {str: "text", int: "a whole number", float: "a number", tuple: "a list"}
        raise UserError(
            f"{source}: key {key!r}: expected {kind.get(type(example), 'a table')}, "
            f"got {value!r}; fix: for example {key} = {_toml(example)}"
        )
    return value


def _checked(fields: dict, source) -> RunConfig:
    """A `RunConfig` from what a file says."""
    _known("", fields, _FIELDS, source)
    fields = {key: _typed(key, value, _defaults(key), source) for key, value in fields.items()}
    if fields.get("preset", "small") not in configs.PRESETS:
        raise UserError(
            f"{source}: key 'preset': expected one of {', '.join(configs.PRESETS)}, "
            f"got {fields['preset']!r}; fix: choose one of these"
        )
    tables = {
        "network": dataclasses.asdict(configs.PRESETS[fields.get("preset", "small")]),
        "augmentation": dataclasses.asdict(Augmentation(1.0)),
        "loss": losses.WEIGHTS,
        "generate": GENERATE,
        "second": SECOND,
    }
    for table, examples in tables.items():
        content = fields.get(table, {})
        _known(f"{table}.", content, examples, source)
        for key, value in content.items():
            content[key] = _typed(key, value, examples[key], f"{source}: {table}")
    config = RunConfig(**fields)
    share = config.second.get("share", 0.5)
    for wrong, key, expected in (
        (config.backbone and not config.closeup, "backbone", "none for networks without close-ups"),
        (config.copies < 1, "copies", "at least 1"),
        (not 0 < share < 1, "second", "a share of the time between 0 and 1"),
        (config.precision not in ("bf16", "fp32"), "precision", "'bf16' or 'fp32'"),
        (config.images < len(config.views), "images", "at least as many as views of a scene"),
        (config.crop <= 0 or config.crop % 32, "crop", "a multiple of 32"),
        (min(config.views, default=0) < 0 or sum(config.views) <= 0, "views", "shares of 0 to 1"),
        (config.lr <= 0, "lr", "more than 0"),
        (config.steps <= 0 and config.minutes <= 0, "steps", "a bound: steps or minutes over 0"),
    ):
        if wrong:
            raise UserError(
                f"{source}: key {key!r}: expected {expected}, "
                f"got {getattr(config, key)!r}; fix: change it"
            )
    return config


def load(path: Path, changes: list[str] = ()) -> RunConfig:
    """The config file `path` with `changes` ("key=value", "table.key=value") on top."""
    try:
        fields = tomllib.loads(Path(path).read_text())
    except FileNotFoundError:
        raise UserError(f"{path}: no such file; fix: see training/runs/") from None
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: expected TOML, got: {error}; fix: the file") from None
    for change in changes:
        key, equals, value = change.partition("=")
        if not equals:
            raise UserError(
                f"--set {change}: expected key=value, got no '='; fix: --set {change}=..."
            )
        try:
            parsed = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            parsed = value  # text without quotes
        table, dot, inner = key.strip().rpartition(".")
        if dot:
            fields[table] = {**fields.get(table, {}), inner: parsed}
        else:
            fields[inner] = parsed
    return _checked(fields, path)


def _toml(value) -> str:
    """A value that JSON and TOML write alike."""
    return json.dumps(list(value) if isinstance(value, tuple) else value)


def dump(config: RunConfig) -> str:
    """The config as TOML, every key written out; `load` reads it back."""
    fields = {f: getattr(config, f) for f in _FIELDS}
    lines = [f"{k} = {_toml(v)}" for k, v in fields.items() if not isinstance(v, dict)]
    for table, content in fields.items():
        if isinstance(content, dict) and content:
            lines += ["", f"[{table}]", *(f"{k} = {_toml(v)}" for k, v in content.items())]
    return "\n".join(lines) + "\n"


def keep_copy(config: RunConfig, folder: Path):
    """Write `config.toml` into the run's folder; refuse to resume a run that was another one."""
    path = folder / "config.toml"
    if path.exists():
        before, free = load(path), ", ".join(sorted(MAY_CHANGE))
        for key in _FIELDS:
            old, new = getattr(before, key), getattr(config, key)
            if old != new and key not in MAY_CHANGE:
                raise UserError(
                    f"{folder}: this run was started with {key} = {_toml(old)}, got "
                    f"{_toml(new)}; fix: another --out (may change: {free})"
                )
    folder.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(dump(config))
    part.replace(path)
