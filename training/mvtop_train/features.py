"""Images to a feature pyramid, and boxes from its finest level.

The detector is a single convolutional head on the finest level: a score map per class, peaked
at box centers, and the distances from each cell to the box's four sides (CenterNet, Zhou et al.
2019; FCOS, Tian et al. 2019). The paper takes the features of an off-the-shelf detector.
"""

import math

import torch
import torch.nn.functional as F
from torch import nn

from .processes import mean_count


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

    def __init__(self, channels, d_model: int):
        super().__init__()
        c4, c8, c16, c32 = channels
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


class ResNetFpnBackbone(nn.Module):
    """The backbone of torchvision's Mask R-CNN: FPN maps 2, 3 and pool, and one level more.

    Strides 16, 32, 64, 128, as PoET takes them. Weights are random here; a Mask R-CNN checkpoint
    fits `body` under torchvision's own names.
    """

    def __init__(self, d_model: int):
        super().__init__()
        from torchvision.models.detection.backbone_utils import resnet_fpn_backbone

        self.body = resnet_fpn_backbone(backbone_name="resnet50", weights=None, trainable_layers=5)
        self.extra = nn.Conv2d(256, 256, 3, 2, 1)
        self.project = nn.ModuleList(
            nn.Sequential(nn.Conv2d(256, d_model, 1), nn.GroupNorm(32, d_model)) for _ in range(4)
        )

    def forward(self, images):
        maps = self.body(images)
        levels = [maps["2"], maps["3"], maps["pool"], self.extra(maps["pool"])]
        return [project(level) for project, level in zip(self.project, levels, strict=True)]


def build_backbone(config) -> nn.Module:
    if config.backbone == "conv":
        return ConvBackbone(config.channels, config.d_model)
    return ResNetFpnBackbone(config.d_model)


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


def detection_loss(logits, boxes, truth, class_index, stride: int):
    """Focal loss on the center map and GIoU on the cells near each center.

    logits       [V, C, h, w]
    boxes        [V, 4, h, w] input px
    truth        [V, 4] the one object's box in each view; no object where x1 <= x0
    class_index  [V]
    """
    views, _, rows, columns = logits.shape
    present = truth[:, 2] > truth[:, 0]
    center = (truth[:, :2] + truth[:, 2:]) / 2
    size = (truth[:, 2:] - truth[:, :2]).clamp_min(1)
    u = (torch.arange(columns, device=logits.device) + 0.5) * stride - 0.5
    v = (torch.arange(rows, device=logits.device) + 0.5) * stride - 0.5
    sigma = (size / 8).clamp_min(stride * 0.6)
    dx = (u[None] - center[:, :1]) / sigma[:, :1]
    dy = (v[None] - center[:, 1:]) / sigma[:, 1:]
    heat = torch.exp(-0.5 * (dx[:, None, :] ** 2 + dy[:, :, None] ** 2)) * present[:, None, None]
    # The cell next to the center is the positive: its target is exactly 1.
    heat = torch.where(heat == heat.amax((1, 2), keepdim=True), present[:, None, None] * 1.0, heat)
    target = torch.zeros_like(logits)
    target[torch.arange(views, device=logits.device), class_index] = heat
    p = logits.sigmoid()
    positive = target == 1
    pos_loss = -F.logsigmoid(logits) * (1 - p) ** 2 * positive
    neg_loss = -F.logsigmoid(-logits) * p**2 * (1 - target) ** 4 * ~positive
    score_loss = (pos_loss.sum() + neg_loss.sum()) / mean_count(present.sum())
    # All cells, most with weight 0: to pick the others out, a GPU would have to be waited for.
    weight = (heat * (heat > 0.3)).flatten()
    wanted = truth[:, None].expand(views, rows * columns, 4).flatten(0, 1)
    box_losses = giou_loss(boxes.permute(0, 2, 3, 1).flatten(0, 2), wanted)
    box_loss = (box_losses * weight).sum() / mean_count(weight.sum())
    return score_loss + 2 * box_loss


def giou_loss(a, b):
    """1 - generalised IoU (Rezatofighi et al. 2019) of boxes [n, 4]."""
    low, high = torch.maximum(a[:, :2], b[:, :2]), torch.minimum(a[:, 2:], b[:, 2:])
    inter = (high - low).clamp_min(0).prod(-1)
    area = (a[:, 2:] - a[:, :2]).prod(-1) + (b[:, 2:] - b[:, :2]).prod(-1) - inter
    hull = torch.maximum(a[:, 2:], b[:, 2:]) - torch.minimum(a[:, :2], b[:, :2])
    hull = hull.prod(-1)
    return 1 - inter / area + (hull - area) / hull
