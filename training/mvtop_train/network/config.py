"""The one configuration type, and its presets."""

import dataclasses
from dataclasses import dataclass
from typing import Literal

from ..errors import UserError

LOS_CHANNELS = {"direction": 3, "origin_direction": 6, "plucker": 6, "plucker_origin": 9}
BACKBONES = ("conv", "lite", "resnet50_fpn")  # `features.py`, `lite.py`
GEOMETRIES = ("rays", "image", "image_hypotheses")  # `geometries.py`


@dataclass(frozen=True)
class ObjectClass:
    """`discrete` [[16 numbers, rows of 4x4, m]] and `continuous` [[axis 3, a point on it 3, m]] are
    the turns that leave it looking the same, as in BOP's `models_info.json`; every one but none."""

    id: int
    name: str
    diameter_m: float
    discrete: tuple[tuple[float, ...], ...] = ()
    continuous: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True)
class Config:
    """Everything that decides the shape of a network.

    `geometry` chooses how positions enter it (`geometries.py`): "rays", only through lines of
    sight, so that a network trained on crops runs on whole images; "image", the paper's and PoET's,
    in fractions of the image (`paper.py`).
    """

    preset: str
    width: int  # network input, px
    height: int
    backbone: Literal[*BACKBONES]
    channels: tuple[int, ...]  # of "conv", at strides 4, 8, 16, 32
    strides: tuple[int, ...]
    d_model: int
    heads: int
    points: int
    encoder_layers: int
    decoder_layers: int
    ffn: int
    los_encoding: Literal[*LOS_CHANNELS]
    geometry: Literal[*GEOMETRIES]
    classes: tuple[ObjectClass, ...] = ()  # what it detects; a preset leaves them open
    mean: tuple[float, float, float] = (0.5, 0.5, 0.5)
    std: tuple[float, float, float] = (0.25, 0.25, 0.25)
    closeup: int = 0  # side of the close-ups that poses are decoded from, px; 0: whole images
    closeup_strides: tuple[int, ...] = ()  # of the levels that are used of close-ups
    hypotheses: int = 1  # poses that the decoder gives of each object

    def __post_init__(self):
        for key, known in (
            ("backbone", BACKBONES), ("geometry", GEOMETRIES), ("los_encoding", LOS_CHANNELS),
        ):  # fmt: skip
            if getattr(self, key) not in known:
                raise UserError(
                    f"network: {key}: expected one of {', '.join(known)}, "
                    f"got {getattr(self, key)!r}; fix: choose one of these"
                )

    @property
    def los_channels(self) -> int:
        return LOS_CHANNELS[self.los_encoding]

    @property
    def shares_backbone(self) -> bool:
        """Whether boxes and poses are made of the same features; if not, close-ups teach the object
        coordinates and whole images the boxes."""
        return self.backbone != "lite"

    @property
    def gives_coordinates(self) -> bool:
        """Whether close-ups give object coordinates, on which PnP finds poses; if not, the decoder
        gives poses."""
        return self.backbone == "lite"

    @property
    def pose_strides(self) -> tuple[int, ...]:
        """Of the levels that poses are decoded from."""
        return self.closeup_strides if self.closeup else self.strides

    def level_shapes(self, height: int | None = None, width: int | None = None):
        """(rows, columns) of each pose level for an input of the given size."""
        height, width = height or self.height, width or self.width
        return [(-(-height // stride), -(-width // stride)) for stride in self.pose_strides]

    def decoder_shapes(self):
        """(rows, columns) of each level of what the poses are decoded from."""
        return self.level_shapes(self.closeup or self.height, self.closeup or self.width)


PRESETS = {
    "tiny": Config(
        preset="tiny", width=160, height=128, backbone="conv", channels=(8, 16, 32, 32),
        strides=(8, 16, 32), d_model=32, heads=4, points=2, encoder_layers=1, decoder_layers=2,
        ffn=64, los_encoding="plucker_origin", geometry="rays",
        closeup=64, closeup_strides=(16, 32),
    ),
    "small": Config(
        preset="small", width=512, height=384, backbone="conv", channels=(64, 128, 256, 256),
        strides=(8, 16, 32), d_model=128, heads=8, points=4, encoder_layers=2, decoder_layers=3,
        ffn=256, los_encoding="plucker_origin", geometry="rays",
        closeup=160, closeup_strides=(16, 32),
    ),
    "lite": Config(
        preset="lite", width=512, height=384, backbone="lite", channels=(),
        strides=(8, 16, 32), d_model=128, heads=8, points=4, encoder_layers=2, decoder_layers=3,
        ffn=256, los_encoding="plucker_origin", geometry="rays",
        mean=(0.485, 0.456, 0.406), std=(0.229, 0.224, 0.225),
        closeup=160, closeup_strides=(16, 32),
    ),
}  # fmt: skip


def preset(name: str, classes: tuple[ObjectClass, ...], **changes) -> Config:
    """A preset for the given classes, with single fields changed (ablations)."""
    return dataclasses.replace(PRESETS[name], classes=classes, **changes)


def to_dict(config: Config) -> dict:
    return dataclasses.asdict(config)


def from_dict(fields: dict) -> Config:
    fields = {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
    fields["classes"] = tuple(
        c if isinstance(c, ObjectClass) else ObjectClass(**_tuples(c)) for c in fields["classes"]
    )
    return Config(**fields)


def _tuples(fields: dict) -> dict:
    """JSON's lists of lists as tuples of tuples."""
    return {
        key: tuple(tuple(row) for row in value) if isinstance(value, list | tuple) else value
        for key, value in fields.items()
    }
