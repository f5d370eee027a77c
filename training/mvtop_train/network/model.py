"""The network, top to bottom, in flow order: features, encoder, lines of sight, decoder, heads."""

from dataclasses import dataclass

import torch
from torch import nn

from . import rays
from .decoder import Boxes, Decoder
from .encoder import Encoder
from .features import Detector, build_backbone
from .views import Views


class Features(nn.Module):
    """Images to encoded tokens and detections; one view does not see another here."""

    def __init__(self, config):
        super().__init__()
        self.backbone = build_backbone(config)
        self.detector = Detector(config.d_model, len(config.classes), config.strides[0])
        self.encoder = Encoder(config)
        self.used = [config.strides.index(stride) for stride in config.pose_strides]
        # Training only: object coordinates of what a cell shows, 2x2 per cell. They teach the
        # backbone to tell the object's parts; nothing of it is exported.
        self.coordinates = nn.Conv2d(config.d_model, 3 * 4, 1)

    def forward(self, images, camera_rays, negatives=None):
        """images [V, 3, H, W], camera_rays [V, N, 3] -> memory [V, N, C], levels, detections.

        The detections of `negatives` [M, 3, H, W] follow those of the images.
        """
        # In one pass, so that both are normalised by the same statistics.
        levels = self.backbone(images if negatives is None else torch.cat([images, negatives]))
        scores, boxes = self.detector(levels[0])
        if negatives is not None:
            levels = [level[: len(images)] for level in levels]
        return self.encoder(self.pose_levels(levels), camera_rays), levels, scores, boxes

    def pose_levels(self, levels: list) -> list:
        """Those of the backbone's maps that poses are decoded from."""
        return [levels[i] for i in self.used]


@dataclass
class Prediction:
    """What the network says; poses alone where it was given levels instead of images."""

    poses: list  # per decoder layer: rotation_6d, translation, sigma
    scores: torch.Tensor | None = None  # [B * V + M, classes, h, w] logits; the M negatives last
    boxes: torch.Tensor | None = None  # [B * V + M, 4, h, w] px
    coordinates: torch.Tensor | None = None  # [B * V, 3, 2h, 2w] in units of the object's extent


class Mvtop(nn.Module):
    def __init__(self, config):
        super().__init__()
        self.config = config
        self.features = Features(config)
        self.decoder = Decoder(config)

    def forward(self, views: Views) -> Prediction:
        if views.levels is not None:
            levels = [level.flatten(0, 1) for level in views.levels]
            size = [cells * self.config.pose_strides[0] for cells in levels[0].shape[-2:]]
            camera_rays = self._camera_rays(views, *size)
            memory = self.features.encoder(levels, camera_rays.flatten(0, 1))
            return Prediction(self._poses(memory, camera_rays, views, *size))
        size = views.images.shape[-2:]
        camera_rays = self._camera_rays(views, *size)
        memory, levels, scores, boxes = self.features(
            views.images.flatten(0, 1), camera_rays.flatten(0, 1), views.negatives
        )
        coordinates = self.features.coordinates(levels[0])
        coordinates = nn.functional.pixel_shuffle(coordinates, 2).float()
        poses = self._poses(memory, camera_rays, views, *size)
        return Prediction(poses, scores, boxes, coordinates)

    def _camera_rays(self, views: Views, height: int, width: int):
        """[B, V, N, 3], 0 for cells off the image."""
        shapes, strides = self.config.level_shapes(height, width), self.config.pose_strides
        with torch.autocast(views.k.device.type, enabled=False):  # geometry stays in fp32
            pixels = rays.cell_centers(shapes, strides, views.k.device)
            return rays.unproject(views.k, pixels) * views.inside[..., None]

    def _poses(self, memory, camera_rays, views: Views, height: int, width: int) -> list:
        """memory [B * V, N, C], camera_rays [B, V, N, 3] -> see `Decoder`."""
        with torch.autocast(memory.device.type, enabled=False):
            lines = rays.encode(camera_rays, views.ref_from_cam, self.config.los_encoding)
            boxes = decoder_boxes(views, height, width)
        memory = memory.unflatten(0, views.k.shape[:2])
        shapes = self.config.level_shapes(height, width)
        return self.decoder(memory, lines, boxes, views.class_index, shapes)


def decoder_boxes(views: Views, height: int, width: int) -> Boxes:
    """Boxes in px to what the decoder takes; entries of undetected objects are neutral."""
    valid = views.valid[..., None]
    size = torch.tensor([width, height], device=views.boxes.device)
    low, high = (views.boxes[..., :2] + 0.5) / size, (views.boxes[..., 2:] + 0.5) / size
    centers = torch.where(valid > 0, (low + high) / 2, torch.full_like(low, 0.5))
    lines = rays.box_rays(views.k, views.boxes, views.ref_from_cam)
    lines = torch.where(valid > 0, lines, torch.zeros_like(lines))
    return Boxes(centers, (high - low) / 2 * valid, lines, views.valid)
