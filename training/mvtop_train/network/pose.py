"""Rotations from six numbers, and pose errors. Counterpart of `mvtop-geometry/src/pose.rs`.

Errors are those that losses need, differentiable; poses are measured by `mvtop.metrics`.
"""

import torch
import torch.nn.functional as F

EPS = 1e-8


def rotation_from_6d(six: torch.Tensor) -> torch.Tensor:
    """Gram-Schmidt: rotation [..., 3, 3] with columns x, y, z from [..., 6].

    Zhou et al. 2019 in PoET's order: x = norm(a), z = norm(x x b), y = z x x.
    """
    x = F.normalize(six[..., :3], dim=-1, eps=EPS)
    z = F.normalize(torch.linalg.cross(x, six[..., 3:]), dim=-1, eps=EPS)
    return torch.stack([x, torch.linalg.cross(z, x), z], -1)


def rotation_angle(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Angle between rotations [..., 3, 3], radians, with finite gradients at 0 and 180 degrees.

    2 atan2(|a - b|, sqrt(8 - |a - b|^2)) equals arccos((tr(a b^T) - 1) / 2) of the paper.
    """
    square = ((a - b) ** 2).sum((-2, -1))
    return 2 * torch.atan2((square + EPS).sqrt(), (8 - square).clamp_min(EPS).sqrt())


def translation_error(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Distance [...] between translations [..., 3], metres, with a finite gradient at 0."""
    return (((a - b) ** 2).sum(-1) + EPS**2).sqrt()


def add_error(points, rotation_a, t_a, rotation_b, t_b):
    """ADD (Hinterstoisser et al. 2012): mean distance of the model points under two poses."""
    a = points @ rotation_a.transpose(-1, -2) + t_a[..., None, :]
    b = points @ rotation_b.transpose(-1, -2) + t_b[..., None, :]
    return (a - b).norm(dim=-1).mean(-1)
