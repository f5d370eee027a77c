"""The paper's and PoET's own choices, which no shipped network has.

Positions are fractions of the image, the translation is regressed in metres, and lines of sight
enter through the features alone. The study has these classes (`study/paper.py`, `variants.py`).
"""

import torch
from torch import nn

from .attention import ProjectiveAttention
from .decoder import Decoder, Parts
from .encoder import Encoder
from .geometry import Geometry
from .heads import PoseHeads
from .layers import mlp, ring_offsets

FREQUENCIES = 10  # of a box's sine encoding


def sine_positions(shape, channels: int, device=None) -> torch.Tensor:
    """DETR's sine position encoding [rows * columns, channels]: y half, then x half."""
    rows, columns = shape
    half = channels // 2
    frequency = 10000 ** (2 * (torch.arange(half, device=device) // 2) / half)
    parts = []
    for length, index in ((rows, 0), (columns, 1)):
        angle = (torch.arange(length, device=device) + 0.5) / (length + 1e-6) * 2 * torch.pi
        x = angle[:, None] / frequency
        x = torch.stack([x[:, 0::2].sin(), x[:, 1::2].cos()], -1).flatten(1)
        x = x[:, None] if index == 0 else x[None]
        parts.append(x.expand(rows, columns, half))
    return torch.cat(parts, -1).reshape(rows * columns, channels)


class ImageEncoder(Encoder):
    """Cells are told apart by their row and column.

    Each level is projected first, as in PoET: also features of a frozen backbone are adapted.
    """

    def _add_positions(self, d: int):
        self.project = nn.ModuleList(
            nn.Sequential(nn.Conv2d(d, d, 1), nn.GroupNorm(32, d)) for _ in self.strides
        )

    def forward(self, levels, camera_rays):
        levels = [project(level) for project, level in zip(self.project, levels, strict=True)]
        return super().forward(levels, camera_rays)

    def _placed(self, tokens, camera_rays, shapes):
        d = tokens.shape[-1]
        sine = torch.cat([sine_positions(shape, d, tokens.device) for shape in shapes])
        return tokens, sine[None]


class ImageFlose(nn.Module):
    """[features; lines of sight] back to C channels, and nothing else."""

    def __init__(self, config):
        super().__init__()
        self.linear = nn.Linear(config.d_model + config.los_channels, config.d_model)
        nn.init.xavier_uniform_(self.linear.weight)

    def forward(self, memory, rays):
        return self.linear(torch.cat([memory, rays], -1))


class ImageAttention(ProjectiveAttention):
    """Offsets are in cells, and features are fused as they are."""

    def _add_lift(self, d: int) -> int:
        return 0

    def _ring(self):
        return ring_offsets(self.heads, self.points)

    def _unit(self, boxes, level_shapes):
        sizes = [[1 / columns, 1 / rows] for rows, columns in level_shapes]
        return torch.tensor(sizes, device=boxes.centers.device)[:, None, None]

    def _lifted(self, gathered, z, boxes):
        return gathered


class ImageHeads(PoseHeads):
    """The translation is what the head says, in metres."""

    def _placed(self, translation, class_index, boxes):
        return translation


class ImageDecoder(Decoder):
    """Queries are made of the box's place and size in the reference image."""

    parts = Parts(ImageFlose, ImageAttention, ImageHeads)

    def _add_queries(self, d: int):
        self.query = mlp(4 * 2 * FREQUENCIES, d, d)

    def _positions(self, at_center, boxes):
        full = torch.cat([boxes.centers[:, 0], 2 * boxes.half_sizes[:, 0]], -1)
        angle = full[..., None] * 2 ** torch.arange(FREQUENCIES, device=full.device)
        return at_center, self.query(torch.cat([angle.sin(), angle.cos()], -1).flatten(-2))


IMAGE = Geometry(ImageEncoder, ImageDecoder)


class ResNetFpn(nn.Module):
    """The backbone of torchvision's Mask R-CNN: FPN maps 2, 3 and pool, and one level more.

    Strides 16, 32, 64, 128, as PoET takes them. Weights are random here; a Mask R-CNN checkpoint
    fits `body` under torchvision's own names.
    """

    def __init__(self, config):
        super().__init__()
        from torchvision.models.detection.backbone_utils import resnet_fpn_backbone

        self.body = resnet_fpn_backbone(backbone_name="resnet50", weights=None, trainable_layers=5)
        self.extra = nn.Conv2d(config.d_model, config.d_model, 3, 2, 1)

    def forward(self, images):
        maps = self.body(images)
        return [maps["2"], maps["3"], maps["pool"], self.extra(maps["pool"])]
