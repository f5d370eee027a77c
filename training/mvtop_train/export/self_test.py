"""What a network answers to one fixed input, for the manifest: `mvtop-cli doctor` compares.

Computed by PyTorch, so that an export that went wrong is told, too. The input is the same numbers
in Rust (mvtop-core/src/estimator/self_test.rs), one picture and one object.
"""

import numpy as np
import torch

from ..network.decoder import Boxes
from ..network.model import Mvtop

# Of the outputs, as a share of the largest in its group. Providers in half precision keep it; a
# network with other weights or a broken operator is off by far more.
TOLERANCE = 0.05
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
def outputs(model: Mvtop) -> dict[str, list[float]]:
    """By name, in the order that `mvtop-cli doctor` names them."""
    config, features = model.config, model.features
    cells = sum(rows * columns for rows, columns in config.decoder_shapes())
    images = numbers(1, 3, config.height, config.width)
    scores, boxes = features.detect(images)
    pictures = numbers(1, 3, config.closeup, config.closeup) if config.closeup else images
    memory = features.encoder(features.pose_levels(pictures), rays(cells))
    centers, half_sizes = torch.full((1, 1, 1, 2), 0.5), torch.full((1, 1, 1, 2), 0.3)
    box_rays, valid = numbers(1, 1, 1, 12), torch.ones(1, 1, 1)
    poses = model.decoder(
        memory[None], numbers(1, 1, cells, config.los_channels),
        Boxes(centers, half_sizes, box_rays, valid),
        torch.zeros(1, 1, dtype=torch.long), config.decoder_shapes(),
    )[-1]  # fmt: skip
    if config.hypotheses > 1:
        poses = poses.best()
    rotation_6d, translation, sigma = (x[0, 0].tolist() for x in poses)
    probable = scores.sigmoid()
    return {
        "det_scores": [probable.mean().item(), probable.max().item()],
        "det_boxes": [boxes[:, side].mean().item() for side in range(4)],
        "memory": [memory.mean().item(), memory.abs().mean().item()],
        "rotation_6d": rotation_6d,
        "translation": translation,
        "sigma": sigma,
    }


def of(model: Mvtop) -> dict:
    """The manifest's entry."""
    rounded = {
        name: [float(f"{number:.6g}") for number in values]
        for name, values in outputs(model).items()
    }
    return {"tolerance": TOLERANCE, "outputs": rounded}
