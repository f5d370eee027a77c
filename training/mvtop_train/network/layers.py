"""Pieces that several stages are made of."""

import math

import torch
from torch import nn


def mlp(*sizes: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in zip(sizes[:-1], sizes[1:], strict=True):
        layers += [nn.Linear(a, b), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def feed_forward(d_model: int, hidden: int) -> nn.Module:
    return nn.Sequential(nn.Linear(d_model, hidden), nn.ReLU(), nn.Linear(hidden, d_model))


def ring_offsets(heads: int, points: int) -> torch.Tensor:
    """Initial offsets [H, K, 2]: head m looks along angle 2 pi m / H, point k at k + 1 cells."""
    theta = torch.arange(heads) * (2 * math.pi / heads)
    direction = torch.stack([theta.cos(), theta.sin()], -1)
    direction = direction / direction.abs().amax(-1, keepdim=True)
    return direction[:, None] * torch.arange(1, points + 1)[None, :, None]
