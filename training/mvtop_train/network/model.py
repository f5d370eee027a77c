"""The network, top to bottom, in flow order: features, encoder, lines of sight, decoder, heads."""

from dataclasses import dataclass

import torch
from torch import nn

from . import rays
from .decoder import Boxes
from .features import Features, Found
from .geometries import geometry_of
from .lite import LiteFeatures
from .views import Cached, Views


@dataclass
class Prediction:
    """What the network says."""

    poses: list  # per decoder layer: rotation_6d, translation, sigma; empty without a decoder
    found: Found | None  # None where a frozen backbone was given what it made before
    hypotheses: list = ()  # per decoder layer, if several; `poses` are the best of them


class Mvtop(nn.Module):
    def __init__(self, config):
        super().__init__()
        self.config = config
        self.features = (LiteFeatures if config.backbone == "lite" else Features)(config)
        decodes = not config.gives_coordinates
        self.decoder = geometry_of(config).decoder(config) if decodes else None

    def apart(self) -> tuple[list[nn.Parameter], ...]:
        """Parameters by what shares none that is trained; their gradients say nothing of each
        other."""
        return self.features.apart() if self.decoder is None else ([*self.parameters()],)

    def forward(self, views: Views) -> Prediction:
        features = self.features
        take = features.from_cache if isinstance(views.shown, Cached) else features
        levels, found = take(views.shown)
        if self.decoder is None:
            return Prediction([], found)
        shapes, strides = [level.shape[-2:] for level in levels], self.config.pose_strides
        with torch.autocast(views.k.device.type, enabled=False):  # geometry stays in fp32
            pixels = rays.cell_centers(shapes, strides, views.k.device)
            camera_rays = rays.unproject(views.k, pixels) * views.inside[..., None]
            lines = rays.encode(camera_rays, views.ref_from_cam, self.config.los_encoding)
            boxes = decoder_boxes(views, *(cells * strides[0] for cells in shapes[0]))
        memory = self.features.encoder(levels, camera_rays.flatten(0, 1))
        memory = memory.unflatten(0, views.k.shape[:2])
        poses = self.decoder(memory, lines, boxes, views.class_index, shapes)
        if self.config.hypotheses > 1:
            return Prediction([several.best() for several in poses], found, poses)
        return Prediction(poses, found)


def decoder_boxes(views: Views, height: int, width: int) -> Boxes:
    """Boxes in px to what the decoder takes; entries of undetected objects are neutral."""
    valid = views.valid[..., None]
    size = torch.tensor([width, height], device=views.boxes.device)
    low, high = (views.boxes[..., :2] + 0.5) / size, (views.boxes[..., 2:] + 0.5) / size
    centers = torch.where(valid > 0, (low + high) / 2, torch.full_like(low, 0.5))
    lines = rays.box_rays(views.k, views.boxes, views.ref_from_cam)
    lines = torch.where(valid > 0, lines, torch.zeros_like(lines))
    return Boxes(centers, (high - low) / 2 * valid, lines, views.valid)
