"""What the network is given."""

from dataclasses import dataclass

import torch


@dataclass
class Views:
    """A batch of views as the network takes them (training: pinhole cameras).

    images [B, V, 3, H, W] normalised; k [B, V, 3, 3] px; ref_from_cam [B, V, 4, 4] m, identity
    for view 0; boxes [B, V, Q, 4] px; valid [B, V, Q] 1.0 where detected; class_index [B, Q];
    inside [B, V, N] 1.0 where a cell's center lies on the image.
    Training only: negatives [M, 3, H, W], images without the object, which only the detector is
    given; levels, maps [B, V, C, h, w] that the backbone made of the images before (`bank.py`).
    """

    images: torch.Tensor | None
    k: torch.Tensor
    ref_from_cam: torch.Tensor
    boxes: torch.Tensor
    valid: torch.Tensor
    class_index: torch.Tensor
    inside: torch.Tensor
    negatives: torch.Tensor | None = None
    levels: list | None = None
