"""What a network answers to one fixed input, for the manifest: `mvtop-cli doctor` compares.

Computed by PyTorch, so that an export that went wrong is told, too; of networks in whole numbers by
ONNX Runtime with standard operators. The input is the same numbers in Rust
(mvtop-core/src/estimator/self_test.rs), one picture and one object. The decoder is asked about
given numbers, not about what the encoder makes of the picture: networks in whole numbers round
noise by so much that this would be another pose on each kind of processor.
"""

from dataclasses import dataclass

import numpy as np
import onnx
import onnxruntime
import torch

from ..network.config import Config
from ..network.decoder import Boxes
from ..network.model import Mvtop

GOLDEN = 0.6180339887498949


def numbers(*shape: int, start: int = 0) -> torch.Tensor:
    """The golden ratio's multiples from `start`, less whole numbers, in [-1, 1)."""
    steps = np.arange(start, start + int(np.prod(shape))) * GOLDEN
    return torch.from_numpy((2 * (steps - np.floor(steps)) - 1).reshape(shape)).float()


def rays(cells: int) -> torch.Tensor:
    """[1, N, 3], unit vectors around the axis."""
    beside = 0.5 * numbers(1, cells, 2)
    return torch.nn.functional.normalize(torch.cat([beside, torch.ones(1, cells, 1)], -1), dim=-1)


@torch.no_grad()
def outputs(network: "OfModel | OfGraphs") -> dict[str, list[float]]:
    """By name, in the order that `mvtop-cli doctor` names them."""
    config = network.config
    images = numbers(1, 3, config.height, config.width)
    probable, boxes = network.detect(images)
    found = {
        "det_scores": [probable.mean().item(), probable.max().item()],
        "det_boxes": [boxes[:, side].mean().item() for side in range(4)],
    }
    pictures = numbers(1, 3, config.closeup, config.closeup)
    if config.gives_coordinates:
        coordinates = network.coordinates(pictures)
        return found | {"coordinates": coordinates.mean((0, 2, 3)).tolist()}
    cells = sum(rows * columns for rows, columns in config.decoder_shapes())
    memory = network.encode(pictures, rays(cells))
    centers, half_sizes = torch.full((1, 1, 2), 0.5), torch.full((1, 1, 2), 0.3)
    decoded = network.decode(
        numbers(*memory.shape), numbers(1, cells, config.los_channels),
        (centers, half_sizes, numbers(1, 1, 12), torch.ones(1, 1)),
        torch.zeros(1, dtype=torch.long),
    )  # fmt: skip
    rotation_6d, translation, sigma = (x[0].tolist() for x in decoded)
    return found | {
        "memory": [memory.mean().item(), memory.abs().mean().item()],
        "rotation_6d": rotation_6d,
        "translation": translation,
        "sigma": sigma,
    }


def of(network: "OfModel | OfGraphs") -> dict:
    """The manifest's entry."""
    rounded = {
        name: [float(f"{number:.6g}") for number in values]
        for name, values in outputs(network).items()
    }
    return {"tolerance": network.tolerance, "outputs": rounded}


@dataclass(frozen=True)
class OfModel:
    """What PyTorch computes."""

    model: Mvtop
    # Of the outputs, as a share of the largest in its group. Providers in half precision keep it; a
    # network with other weights or a broken operator is off by far more.
    tolerance: float = 0.05

    @property
    def config(self) -> Config:
        return self.model.config

    def detect(self, images):
        scores, boxes = self.model.features.detect(images)
        return scores.sigmoid(), boxes

    def coordinates(self, pictures):
        return self.model.features.describe(pictures)

    def encode(self, pictures, camera_rays):
        features = self.model.features
        return features.encoder(features.pose_levels(pictures), camera_rays)

    def decode(self, memory, lines, boxes, class_index):
        boxes = Boxes(*(x[None] for x in boxes))
        poses = self.model.decoder(
            memory[None], lines[None], boxes, class_index[None], self.config.decoder_shapes()
        )[-1]
        poses = poses.best() if self.config.hypotheses > 1 else poses
        return [x[0] for x in poses]


@dataclass(frozen=True)
class OfGraphs:
    """What ONNX Runtime computes of portable graphs: of networks that PyTorch knows only in
    floating point."""

    graphs: dict[str, onnx.ModelProto]
    config: Config
    # Steps of 8 bits, which other providers may round otherwise, are magnified on such pictures.
    tolerance: float = 0.2

    def _run(self, graph: str, outputs: list[str], inputs: tuple):
        session = onnxruntime.InferenceSession(self.graphs[graph].SerializeToString())
        names = [x.name for x in session.get_inputs()]
        made = session.run(outputs, {n: x.numpy() for n, x in zip(names, inputs, strict=True)})
        return [torch.from_numpy(x) for x in made]

    def detect(self, images):
        return self._run("features", ["det_scores", "det_boxes"], (images,))

    def coordinates(self, pictures):
        return self._run("closeup", ["coordinates"], (pictures,))[0]

    def encode(self, pictures, camera_rays):
        return self._run("closeup", ["memory"], (pictures, camera_rays))[0]

    def decode(self, memory, lines, boxes, class_index):
        given = (memory, lines, *boxes, class_index)
        return self._run("decoder", ["rotation_6d", "translation", "sigma"], given)
