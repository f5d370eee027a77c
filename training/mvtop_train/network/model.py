"""The network, top to bottom, in flow order: features, encoder, lines of sight, decoder, heads."""

from dataclasses import dataclass

import torch
from torch import nn

from . import rays
from .config import BACKBONES, GEOMETRIES
from .decoder import Boxes
from .features import Detector
from .geometry import find
from .views import Levels, Views


@dataclass
class Detections:
    """What the finest level says of the images; of B * V images, then of the M negatives."""

    scores: torch.Tensor  # [B * V + M, classes, h, w] logits
    boxes: torch.Tensor  # [B * V + M, 4, h, w] px
    coordinates: torch.Tensor  # [B * V, 3, 2h, 2w] in units of the object's extent


@dataclass
class Prediction:
    """What the network says."""

    poses: list  # per decoder layer: rotation_6d, translation, sigma
    detections: Detections | None  # None where it was given `Levels`


class Features(nn.Module):
    """Images to pyramid levels, tokens and detections; one view does not see another here."""

    def __init__(self, config):
        super().__init__()
        self.backbone = find(BACKBONES[config.backbone])(config)
        self.detector = Detector(config.d_model, len(config.classes), config.strides[0])
        self.encoder = find(GEOMETRIES[config.geometry]).encoder(config)
        self.used = [config.strides.index(stride) for stride in config.pose_strides]
        # Training only: object coordinates of what a cell shows, 2x2 per cell. They teach the
        # backbone to tell the object's parts; nothing of it is exported.
        self.coordinates = nn.Conv2d(config.d_model, 3 * 4, 1)

    def forward(self, images, negatives=None) -> tuple[list, Detections]:
        """images [V, 3, H, W] -> the levels that poses are decoded from, and detections."""
        # In one pass, so that both are normalised by the same statistics.
        levels = self.backbone(images if negatives is None else torch.cat([images, negatives]))
        scores, boxes = self.detector(levels[0])
        levels = [level[: len(images)] for level in levels]
        coordinates = nn.functional.pixel_shuffle(self.coordinates(levels[0]), 2).float()
        return self.pose_levels(levels), Detections(scores, boxes, coordinates)

    def pose_levels(self, levels: list) -> list:
        """Those of the backbone's maps that poses are decoded from."""
        return [levels[i] for i in self.used]


class Mvtop(nn.Module):
    def __init__(self, config):
        super().__init__()
        self.config = config
        self.features = Features(config)
        self.decoder = find(GEOMETRIES[config.geometry]).decoder(config)

    def forward(self, views: Views) -> Prediction:
        if isinstance(views.shown, Levels):
            levels, detections = [level.flatten(0, 1) for level in views.shown.maps], None
        else:
            levels, detections = self.features(
                views.shown.images.flatten(0, 1), views.shown.negatives
            )
        shapes, strides = [level.shape[-2:] for level in levels], self.config.pose_strides
        with torch.autocast(views.k.device.type, enabled=False):  # geometry stays in fp32
            pixels = rays.cell_centers(shapes, strides, views.k.device)
            camera_rays = rays.unproject(views.k, pixels) * views.inside[..., None]
            lines = rays.encode(camera_rays, views.ref_from_cam, self.config.los_encoding)
            boxes = decoder_boxes(views, *(cells * strides[0] for cells in shapes[0]))
        memory = self.features.encoder(levels, camera_rays.flatten(0, 1))
        memory = memory.unflatten(0, views.k.shape[:2])
        poses = self.decoder(memory, lines, boxes, views.class_index, shapes)
        return Prediction(poses, detections)


def decoder_boxes(views: Views, height: int, width: int) -> Boxes:
    """Boxes in px to what the decoder takes; entries of undetected objects are neutral."""
    valid = views.valid[..., None]
    size = torch.tensor([width, height], device=views.boxes.device)
    low, high = (views.boxes[..., :2] + 0.5) / size, (views.boxes[..., 2:] + 0.5) / size
    centers = torch.where(valid > 0, (low + high) / 2, torch.full_like(low, 0.5))
    lines = rays.box_rays(views.k, views.boxes, views.ref_from_cam)
    lines = torch.where(valid > 0, lines, torch.zeros_like(lines))
    return Boxes(centers, (high - low) / 2 * valid, lines, views.valid)
