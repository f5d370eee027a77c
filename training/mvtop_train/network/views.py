"""What the network is given."""

from dataclasses import dataclass

import torch


@dataclass
class Pictures:
    """Images [B, V, 3, H, W], normalised, 0 where they show nothing.

    Training only: searched [M, 3, H, W], further images for the detector alone.
    """

    images: torch.Tensor
    searched: torch.Tensor | None = None


@dataclass
class Cached:
    """What the frozen part of the network made of images before: maps [B, V, C, h, w], see
    `Features.cache`; searched as in `Pictures`."""

    maps: list[torch.Tensor]
    searched: torch.Tensor | None = None


@dataclass
class Views:
    """A batch of views as the network takes them (training: pinhole cameras).

    k [B, V, 3, 3] px; ref_from_cam [B, V, 4, 4] m, identity for view 0; boxes [B, V, Q, 4] px;
    valid [B, V, Q] 1.0 where detected; class_index [B, Q]; inside [B, V, N] 1.0 where a cell's
    center lies on the image.
    """

    shown: Pictures | Cached
    k: torch.Tensor
    ref_from_cam: torch.Tensor
    boxes: torch.Tensor
    valid: torch.Tensor
    class_index: torch.Tensor
    inside: torch.Tensor
