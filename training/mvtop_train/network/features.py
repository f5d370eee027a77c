"""Images to a feature pyramid, and boxes from its finest level.

The detector is a single convolutional head on the finest level: a score map per class, peaked
at box centers, and the distances from each cell to the box's four sides (CenterNet, Zhou et al.
2019; FCOS, Tian et al. 2019). The paper takes the features of an off-the-shelf detector.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import nn

from .geometries import geometry_of
from .paper import ResNetFpn
from .views import Cached, Pictures


class Conv(nn.Sequential):
    """3x3 convolution, batch normalisation (folded away on export), ReLU."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, relu: bool = True):
        layers = [
            nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False),
            nn.BatchNorm2d(outputs, momentum=0.03),
        ]
        super().__init__(*layers, *([nn.ReLU(inplace=True)] if relu else []))


class Residual(nn.Module):
    def __init__(self, channels: int):
        super().__init__()
        self.body = nn.Sequential(Conv(channels, channels), Conv(channels, channels, relu=False))

    def forward(self, x):
        return F.relu(x + self.body(x))


class ConvBackbone(nn.Module):
    """Small residual network with a top-down path; returns one map per stride 8, 16, 32."""

    def __init__(self, config):
        super().__init__()
        d_model = config.d_model
        c4, c8, c16, c32 = config.channels
        self.stem = nn.Sequential(Conv(3, c4 // 2, 2), Conv(c4 // 2, c4, 2), Residual(c4))
        self.stage8 = nn.Sequential(Conv(c4, c8, 2), Residual(c8))
        self.stage16 = nn.Sequential(Conv(c8, c16, 2), Residual(c16))
        self.stage32 = nn.Sequential(Conv(c16, c32, 2), Residual(c32))
        self.lateral = nn.ModuleList(nn.Conv2d(c, d_model, 1) for c in (c8, c16, c32))
        self.smooth = nn.ModuleList(Conv(d_model, d_model) for _ in range(2))

    def forward(self, images):
        x8 = self.stage8(self.stem(images))
        x16 = self.stage16(x8)
        x32 = self.stage32(x16)
        p32 = self.lateral[2](x32)
        p16 = self._merge(self.lateral[1](x16), p32, self.smooth[1])
        p8 = self._merge(self.lateral[0](x8), p16, self.smooth[0])
        return [p8, p16, p32]

    @staticmethod
    def _merge(fine, coarse, smooth):
        return smooth(fine + F.interpolate(coarse, size=fine.shape[-2:], mode="nearest"))


class Detector(nn.Module):
    """Scores [V, C, h, w] as logits and boxes [V, 4, h, w] (x0, y0, x1, y1, input px)."""

    def __init__(self, d_model: int, classes: int, stride: int):
        super().__init__()
        self.stride = stride
        self.hidden = nn.Sequential(nn.Conv2d(d_model, d_model, 3, 1, 1), nn.ReLU(inplace=True))
        self.score = nn.Conv2d(d_model, classes, 1)
        self.sides = nn.Conv2d(d_model, 4, 1)
        nn.init.constant_(self.score.bias, -math.log(99))  # focal loss: start at 1 %
        nn.init.constant_(self.sides.bias, math.log(4))

    def forward(self, level):
        x = self.hidden(level)
        rows, columns = level.shape[-2:]
        sides = torch.exp(self.sides(x).float().clamp(-4, 6)) * self.stride
        u = (torch.arange(columns, device=level.device) + 0.5) * self.stride - 0.5
        v = (torch.arange(rows, device=level.device) + 0.5) * self.stride - 0.5
        left, top, right, bottom = sides.unbind(1)
        u, v = u[None, None, :], v[None, :, None]
        boxes = torch.stack([u - left, v - top, u + right, v + bottom], 1)
        return self.score(x).float(), boxes


@dataclass
class Found:
    """What images say by themselves: boxes, and which part of the object a cell shows."""

    scores: torch.Tensor  # [N, classes, h, w] logits, of the images that are searched
    boxes: torch.Tensor  # [N, 4, h, w] px
    coordinates: torch.Tensor | None  # [B * V, 3, h, w] in units of the object's extent
    trust: torch.Tensor | None = None  # [B * V, 1, h, w] logits: that the coordinates are right


BACKBONES = {"conv": ConvBackbone, "resnet50_fpn": ResNetFpn}  # "lite" is `lite.LiteFeatures`


class Features(nn.Module):
    """Images to pyramid levels, tokens and boxes; one view does not see another here.

    One backbone finds the boxes and is what poses are decoded from.
    """

    def __init__(self, config):
        super().__init__()
        self.backbone = BACKBONES[config.backbone](config)
        self.detector = Detector(config.d_model, len(config.classes), config.strides[0])
        self.encoder = geometry_of(config).encoder(config)
        self.used = [config.strides.index(stride) for stride in config.pose_strides]
        # Training only: object coordinates of what a cell shows, 2x2 per cell. They teach the
        # backbone to tell the object's parts; nothing of it is exported.
        self.coordinates = nn.Conv2d(config.d_model, 3 * 4, 1)

    def forward(self, shown: Pictures) -> tuple[list, Found]:
        """The levels that poses are decoded from, and what is found; searched are all images."""
        images, negatives = shown.images.flatten(0, 1), shown.searched
        # In one pass, so that both are normalised by the same statistics.
        levels = self.backbone(images if negatives is None else torch.cat([images, negatives]))
        scores, boxes = self.detector(levels[0])
        levels = [level[: len(images)] for level in levels]
        coordinates = nn.functional.pixel_shuffle(self.coordinates(levels[0]), 2).float()
        return self.of_poses(levels), Found(scores, boxes, coordinates)

    def freeze(self):
        """Keep all that works on one image alone as it is."""
        for part in (self.backbone, self.detector, self.coordinates):
            part.requires_grad_(False).eval()

    def detect(self, images):
        """images [B, 3, H, W] -> scores [B, C, h, w] logits, boxes [B, 4, h, w] px."""
        return self.detector(self.backbone(images)[0])

    def pose_levels(self, images) -> list:
        """images [B, 3, H, W] -> the maps that poses are decoded from."""
        return self.of_poses(self.backbone(images))

    def cache(self, images) -> list:
        """images [B, 3, H, W] -> maps [B, C, h, w] that do not change while the backbone is frozen,
        for `from_cache`."""
        return self.pose_levels(images)

    def from_cache(self, shown: Cached) -> tuple[list, Found | None]:
        """As `forward`, of what `cache` made of the images."""
        return [level.flatten(0, 1) for level in shown.maps], None

    def of_poses(self, levels: list) -> list:
        """Those of the backbone's maps that poses are decoded from."""
        return [levels[i] for i in self.used]
