"""The network, top to bottom, in flow order: features, encoder, lines of sight, decoder, heads."""

from dataclasses import dataclass

import torch
from torch import nn

from . import rays
from .decoder import Boxes, Decoder
from .encoder import Encoder
from .features import Detector, build_backbone


@dataclass
class Views:
    """A batch of views as the network takes them (training: pinhole cameras).

    images [B, V, 3, H, W] normalised; k [B, V, 3, 3] px; ref_from_cam [B, V, 4, 4] m, identity
    for view 0; boxes [B, V, Q, 4] px; valid [B, V, Q] 1.0 where detected; class_index [B, Q];
    inside [B, V, N] 1.0 where a cell's centre lies on the image. Training only: negatives
    [M, 3, H, W], images without the object, which only the detector is given.
    """

    images: torch.Tensor
    k: torch.Tensor
    ref_from_cam: torch.Tensor
    boxes: torch.Tensor
    valid: torch.Tensor
    class_index: torch.Tensor
    inside: torch.Tensor
    negatives: torch.Tensor | None = None


class Features(nn.Module):
    """Images to encoded tokens and detections; one view does not see another here."""

    def __init__(self, config):
        super().__init__()
        self.backbone = build_backbone(config)
        self.detector = Detector(config.d_model, len(config.classes), config.strides[0])
        self.encoder = Encoder(config)
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
        return self.encoder(levels, camera_rays), levels, scores, boxes


@dataclass
class Prediction:
    poses: list  # per decoder layer: rotation_6d, translation, sigma
    scores: torch.Tensor  # [B * V + M, classes, h, w] logits; the M negatives come last
    boxes: torch.Tensor  # [B * V + M, 4, h, w] px
    coordinates: torch.Tensor  # [B * V, 3, 2h, 2w] in units of the object's extent


class Mvtop(nn.Module):
    def __init__(self, config):
        super().__init__()
        self.config = config
        self.features = Features(config)
        self.decoder = Decoder(config)

    def forward(self, views: Views) -> Prediction:
        b, v, _, height, width = views.images.shape
        shapes = self.config.level_shapes(height, width)
        with torch.autocast(views.images.device.type, enabled=False):  # geometry stays in fp32
            pixels = rays.cell_centres(shapes, self.config.strides, views.images.device)
            camera_rays = rays.unproject(views.k, pixels) * views.inside[..., None]
            lines = rays.encode(camera_rays, views.ref_from_cam, self.config.los_encoding)
            boxes_in = decoder_boxes(views, height, width)
        memory, levels, scores, boxes = self.features(
            views.images.flatten(0, 1), camera_rays.flatten(0, 1), views.negatives
        )
        coordinates = self.features.coordinates(levels[0])
        coordinates = nn.functional.pixel_shuffle(coordinates, 2).float()
        memory = memory.unflatten(0, (b, v))
        poses = self.decoder(memory, lines, boxes_in, views.class_index, shapes)
        return Prediction(poses, scores, boxes, coordinates)


def decoder_boxes(views: Views, height: int, width: int) -> Boxes:
    """Boxes in px to what the decoder takes; entries of undetected objects are neutral."""
    valid = views.valid[..., None]
    size = torch.tensor([width, height], device=views.boxes.device)
    low, high = (views.boxes[..., :2] + 0.5) / size, (views.boxes[..., 2:] + 0.5) / size
    centres = torch.where(valid > 0, (low + high) / 2, torch.full_like(low, 0.5))
    lines = rays.box_rays(views.k, views.boxes, views.ref_from_cam)
    lines = torch.where(valid > 0, lines, torch.zeros_like(lines))
    return Boxes(centres, (high - low) / 2 * valid, lines, views.valid)
