"""The one file that describes a training run (TOML); `mvtop-train list` names those shipped."""

import argparse
import dataclasses
import difflib
import functools
import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, get_type_hints

import pydantic
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat
from pydantic_core import PydanticCustomError

from ..data import composite, objects, search
from ..data.crops import Augmentation
from ..errors import UserError
from ..files import read_text
from ..network import config as configs
from ..network import losses
from ..network.precision import PRECISIONS
from .checkpoint import PRETRAINED

MAX_FILE_BYTES = 1 << 20


class Table(pydantic.BaseModel):
    """Refuses unknown keys, other types ("1" and true are no numbers) and what is out of range."""

    model_config = pydantic.ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False
    )

    @pydantic.field_validator("*", mode="before")
    @classmethod
    def _tuple(cls, value):
        return tuple(value) if isinstance(value, list) else value


def _changes_to(example, *without: str) -> type[Table]:
    """Any fields of a dataclass; those that are left out (None) stay as they are."""
    fields = {
        name: (kind | None, Field(None, examples=[getattr(example, name)]))
        for name, kind in get_type_hints(type(example)).items()
        if name not in without
    }
    return pydantic.create_model(type(example).__name__, __base__=Table, **fields)


def _shares(views: tuple) -> tuple:
    if sum(views) <= 0:
        raise PydanticCustomError("shares", "shares of 0 to 1")
    return views


def _file_name(text: str) -> str:
    if not objects.is_file_name(text):
        raise PydanticCustomError("file_name", "names that files can have")
    return text


Count = Annotated[int, Field(ge=1)]
FileName = Annotated[str, pydantic.AfterValidator(_file_name)]
Shares = Annotated[tuple[NonNegativeFloat, ...], pydantic.AfterValidator(_shares)]
NetworkChanges = _changes_to(configs.PRESETS["small"], "classes")
AugmentationChanges = _changes_to(Augmentation(scale=0.8))
LossWeights = pydantic.create_model(
    "LossWeights", __base__=Table, **{k: (NonNegativeFloat, w) for k, w in losses.WEIGHTS.items()}
)


class Generate(Table):
    """What `mvtop_train.run` generates: MV-ball, or scenes of the parts in `mesh`."""

    mesh: tuple[str, ...] = ()  # as the options of `mvtop_train.generate`, and those that follow
    mesh_unit: str = ""
    name: Annotated[tuple[FileName, ...], Field(examples=[["box", "can"]])] = ()
    id: tuple[NonNegativeInt, ...] = ()
    rig: tuple[str, ...] = ()
    instances: Count = 1
    width: Count = 640

    scenes: Count = 6000  # of the training split
    test: Count = 100  # scenes of the split that the result is evaluated on
    views: Count = 6  # images per scene
    window: NonNegativeInt = 320  # px rendered around the object; 0: whole images
    start: NonNegativeInt = 300  # scenes with which the training starts
    workers: NonNegativeInt = 0  # 0: all cores
    reserve: NonNegativeFloat = 2.0  # minutes kept for export and evaluation


class SecondStage(Table):
    """The second stage of `mvtop_train.run`, of networks that decode poses from close-ups."""

    share: Annotated[float, Field(gt=0, lt=1)] = 0.4  # of the time of the training
    copies: NonNegativeInt = 0  # as in `RunConfig`, and those that follow; 0: as many as there
    searched: NonNegativeInt = 1
    views: Shares = (0.15, 0.6, 0.15, 0.1)
    lr: PositiveFloat = 1e-3
    warmup: NonNegativeInt = 50


def _network_rules(config: configs.Config) -> list[tuple[bool, str, str]]:
    """What a network cannot be built with: whether it is so, the key, and what was expected."""
    rules = [
        (getattr(config, field.name) < 1, field.name, "at least 1")
        for field in dataclasses.fields(config)
        if field.type in (int, "int") and field.name != "closeup"
    ]
    rising = ("strides", config.strides, config.width), ("strides", config.strides, config.height)
    if config.closeup:
        rising += (("closeup_strides", config.closeup_strides, config.closeup),)
    for name, strides, side in rising:
        fit = all(stride > 0 for stride in strides) and list(strides) == sorted(set(strides))
        fit = bool(strides) and fit and side % strides[0] == 0
        rules.append((not fit, name, f"rising numbers of which the first divides {side}"))
    if config.backbone == "lite":  # whose maps are brought to each other's size
        rules += [
            (getattr(config, name) % 32 != 0, name, "a multiple of 32")
            for name in ("width", "height", "closeup")
        ]
    rules += [
        (config.closeup < 0, "closeup", "0 or more"),
        (config.d_model % max(config.heads, 1) != 0, "heads", "a divisor of d_model"),
        (min(config.std) <= 0, "std", "numbers above 0"),
    ]
    return [(wrong, f"network.{name}", expected) for wrong, name, expected in rules]


class RunConfig(Table):
    """All keys of a run's config file, with what holds where the file says nothing.

    A run ends after `steps` steps or `minutes` of training, whichever comes first (0: no bound);
    the learning rate follows the larger of the two fractions, so it always ends annealed.
    """

    data: str = "data/mvball"  # data set in BOP layout; its split `train` is used
    object: NonNegativeInt = 0  # id of the object; 0: the only one
    preset: Literal[*configs.PRESETS] = "small"
    network: NetworkChanges = NetworkChanges()
    init: str = ""  # checkpoint whose weights to start from
    # Checkpoint whose backbone to freeze, or "pretrained": what of the preset is never trained; the
    # rest is trained on what that made of close-ups before.
    backbone: str = ""
    copies: Count = 5  # of each image among these, each seen otherwise
    steps: Annotated[int, Field(ge=0, examples=[20_000])] = 0
    minutes: Annotated[float, Field(ge=0, examples=[25])] = 0.0
    images: Count = 64  # views per batch, of all processes together
    views: Shares = (0.2, 0.5, 0.15, 0.15)  # of batches with 1, 2, 3, ... views
    searched: NonNegativeInt = (
        4  # whole images for the detector, on top, of networks that learn it apart
    )
    search_every: Count = 1  # steps from one batch with such images to the next
    # Of these, the deviation of the logarithm of their scale: more of it finds objects of more
    # sizes, later.
    zoom: Annotated[float, Field(ge=0, le=2)] = search.ZOOM
    backgrounds: str = ""  # folder of pictures to put behind and before the objects
    # Share of the crops of objects in which one of these pictures hides a part.
    occluders: Annotated[float, Field(ge=0, le=1)] = composite.OCCLUDED
    negatives: NonNegativeFloat = 0.125  # crops without the object, on top, as a share of `images`
    crop: Annotated[int, Field(gt=0, multiple_of=32)] = 160  # side of the training crops, px
    lr: PositiveFloat = 1e-3  # at the peak
    warmup: NonNegativeInt = 300  # steps
    clip: PositiveFloat = 5.0  # norm of the gradient, of boxes and coordinates each
    precision: Literal[*PRECISIONS] = "auto"  # the geometry is in fp32 in any
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    augmentation: AugmentationChanges = AugmentationChanges()
    loss: LossWeights = LossWeights()
    held_out: NonNegativeInt = 100  # scenes for validation; at most a fifth
    workers: NonNegativeInt = 1  # processes that prepare batches, per training process
    log_steps: Count = 50
    save_minutes: NonNegativeFloat = 3.0
    validate_minutes: NonNegativeFloat = 20.0
    generate: Generate = Generate()
    second: SecondStage = SecondStage()

    @pydantic.model_validator(mode="after")
    def _fits_together(self):
        for wrong, key, expected in (
            *_network_rules(self.network_config(())),
            (self.backbone and not self.closeup, "backbone", "none for networks without close-ups"),
            (
                self.backbone == PRETRAINED and not self.pretrained,
                "backbone",
                "a checkpoint, for networks that are not",
            ),
            (self.images < len(self.views), "images", "at least as many as views of a scene"),
            (not (self.steps or self.minutes), "steps", "a bound: steps or minutes over 0"),
        ):
            if wrong:
                value = functools.reduce(getattr, key.split("."), self)
                context = {"key": key, "value": value}
                raise PydanticCustomError("together", expected, context)
        return self

    @property
    def closeup(self) -> int:
        """Side of the network's close-ups, px; 0: it has none."""
        return self.network_config(()).closeup

    @property
    def pretrained(self) -> bool:
        return not self.network_config(()).shares_backbone

    def known(self) -> tuple[objects.Object, ...]:
        """The objects of the data set that the network learns."""
        return objects.read_all(Path(self.data), (self.object,) if self.object else ())

    def network_config(self, classes) -> configs.Config:
        return configs.preset(self.preset, classes, **self.network.model_dump(exclude_none=True))

    def augmentation_of(self, config: configs.Config) -> Augmentation:
        # Data sets are 640 px wide; the network sees them at this scale.
        changes = self.augmentation.model_dump(exclude_none=True)
        return Augmentation(**{"scale": config.width / 640, **changes})


# What may differ when a run is resumed: how long, where and how often, but not what is learnt.
MAY_CHANGE = {
    "data", "init", "steps", "minutes", "workers", "log_steps", "save_minutes",
    "validate_minutes", "second", "generate.scenes", "generate.test", "generate.views",
    "generate.start", "generate.workers", "generate.reserve",
    # What these files hold, the generator compares.
    "generate.mesh", "generate.rig",
}  # fmt: skip
# Where pydantic's own "Input should be ..." is not what these pages say.
EXPECTED = {
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "text",
    "tuple_type": "a list",
    "model_type": "a table",
    "greater_than_equal": "at least {ge:g}",
    "missing": "more entries",
    "too_long": "at most {max_length} entries",
}


def _sentence(error: dict) -> str:
    """One of pydantic's errors as what was expected, what came, and the fix."""
    context = error.get("ctx", {})
    # Nowhere: a rule about several keys.
    path = error["loc"] or tuple(context["key"].split("."))
    *tables, name = [part for part in path if isinstance(part, str)]
    key, fields = ".".join([*tables, name]), RunConfig.model_fields
    for table in tables:
        fields = fields[table].annotation.model_fields
    if error["type"] == "extra_forbidden":
        near = difflib.get_close_matches(name, fields, 1)
        hint = f"did you mean {near[0]!r}?" if near else "remove it"
        return f"unknown key {key!r}, expected one of {', '.join(sorted(fields))}; fix: {hint}"
    expected = error["msg"].removeprefix("Input should be ")
    expected = EXPECTED.get(error["type"], expected).format(**context)
    example = (fields[name].examples or [fields[name].default])[0]
    example = f"[{key}]" if isinstance(example, Table) else f"{key} = {_toml(example)}"
    got = context.get("value", error["input"])
    return f"key {key!r}: expected {expected}, got {got!r}; fix: for example {example}"


def _change(fields: dict, change: str):
    """Put "key=value" or "table.key=value" on top of what a file says."""
    key, equals, value = change.partition("=")
    if not equals:
        raise UserError(f"--set {change}: expected key=value, got no '='; fix: --set {change}=...")
    try:
        value = tomllib.loads(f"value = {value}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        pass  # text without quotes
    table, dot, name = key.strip().rpartition(".")
    if dot:
        before = fields.get(table)
        fields[table] = {**(before if isinstance(before, dict) else {}), name: value}
    else:
        fields[name] = value


def load(path: Path, changes: list[str] = ()) -> RunConfig:
    """The config file `path` with `changes` ("key=value", "table.key=value") on top."""
    text = read_text(path, "see `mvtop-train list`", MAX_FILE_BYTES)
    try:
        fields = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected TOML, got: {error}; fix: the file") from None
    return validated(path, fields, changes)


def validated(source, fields: dict, changes: list[str]) -> RunConfig:
    for change in changes:
        _change(fields, change)
    try:
        return RunConfig.model_validate(fields)
    except pydantic.ValidationError as error:
        raise UserError(f"{source}: {_sentence(error.errors()[0])}") from None


def _toml(value) -> str:
    """A value that JSON and TOML write alike."""
    return json.dumps(value, ensure_ascii=False)


def dump(config: RunConfig) -> str:
    """The config as TOML, every key written out; `load` reads it back."""
    fields, lines = config.model_dump(exclude_none=True), []
    for table in [name for name, value in fields.items() if isinstance(value, dict)]:
        if content := fields.pop(table):
            lines += ["", f"[{table}]", *(f"{k} = {_toml(v)}" for k, v in content.items())]
    return "\n".join([*(f"{k} = {_toml(v)}" for k, v in fields.items()), *lines]) + "\n"


def begun(folder: Path) -> RunConfig | None:
    """The config of the run that was begun in a folder."""
    path = folder / "config.toml"
    return load(path) if path.exists() else None


def _lasting(config: RunConfig) -> dict:
    """What may not differ when a run is resumed, by key; of paths where they lead."""
    fields = config.model_dump(exclude_none=True)
    fields |= {f"generate.{key}": value for key, value in fields.pop("generate").items()}
    if fields["backgrounds"]:
        fields["backgrounds"] = str(Path(fields["backgrounds"]).resolve())
    # Which one it is, is known where its features are kept (`data.bank`).
    if fields["backbone"] not in ("", PRETRAINED):
        fields["backbone"] = "a checkpoint"
    return {key: value for key, value in fields.items() if key not in MAY_CHANGE}


def refuse_another(config: RunConfig, folder: Path):
    """UserError where another run than this one was begun in the folder."""
    kept = begun(folder)
    if kept is None:
        return
    was, now = _lasting(kept), _lasting(config)
    for key in now:
        if was[key] != now[key]:
            raise UserError(
                f"{folder}: this run was started with {key} = {_toml(was[key])}, got "
                f"{_toml(now[key])}; fix: another --out (may change: "
                f"{', '.join(sorted(MAY_CHANGE))})"
            )


def keep_copy(config: RunConfig, folder: Path):
    """Write `config.toml` into the run's folder; refuse to resume a run that was another one."""
    refuse_another(config, folder)
    path = folder / "config.toml"
    folder.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(dump(config))
    part.replace(path)


def add_arguments(parser: argparse.ArgumentParser, required: bool = True):
    """The options by which commands take a config."""
    parser.add_argument("--config", type=Path, required=required, help="TOML, or a name of `list`")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="change a key of the config"
    )


def parse(
    parser: argparse.ArgumentParser, of_parts: Callable | None = None
) -> tuple[argparse.Namespace, RunConfig, Path]:
    """The arguments of a command that makes a run; its config and its folder.

    of_parts  makes a config of the arguments where these name meshes instead
    """
    add_arguments(parser, required=of_parts is None)
    parser.add_argument(
        "--out", type=Path, help="folder of this run, resumed if there (runs/<name of the config>)"
    )
    args = parser.parse_args()
    own = of_parts is not None and bool(args.mesh)
    if own == bool(args.config):
        got = "both" if own else "none"
        raise UserError(f"--mesh or --config: expected one of them, got {got}; fix: see --help")
    settings = of_parts(args) if own else load(args.config, args.set)
    return args, settings, args.out or Path("runs") / args.config.stem
