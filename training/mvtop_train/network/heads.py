"""From the decoder's state to poses and their uncertainty. Axes as in `attention`."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import nn

from .layers import mlp
from .rays import BOX_RAY_GAIN


class Hypotheses(NamedTuple):
    """Several poses of each query, of which one is meant to be right.

    rotation_6d [B, Q, K, 6]; translation [B, Q, K, 3] m; sigma [B, Q, K, 2] (deg, m), of each if it
    is the right one; score [B, Q, K], logits of which is
    """

    rotation_6d: torch.Tensor
    translation: torch.Tensor
    sigma: torch.Tensor
    score: torch.Tensor

    def best(self):
        """The pose that is most likely right, as `PoseHeads` gives a single one."""
        index = self.score.argmax(-1)[..., None, None]
        # -1, as numbers of queries would be those of the export.
        return tuple(
            x.gather(-2, index.expand(-1, -1, -1, x.shape[-1]))[..., 0, :] for x in self[:3]
        )


class PoseHeads(nn.Module):
    """Class-specific 6-D rotation, translation and uncertainty of each query.

    With `config.hypotheses` K over 1, K poses and a score of each: what the views leave open shows
    as several poses instead of their mean.
    """

    def __init__(self, config):
        super().__init__()
        d, self.count = config.d_model, config.hypotheses
        poses = len(config.classes) * self.count
        self.rotation = mlp(d, d, d, 6 * poses)
        self.translation = mlp(d, d, d, 3 * poses)
        self.uncertainty = mlp(d, d, 2 * poses)
        if self.count > 1:
            self.score = mlp(d, d, poses)
        radii = torch.tensor([c.diameter_m / 2 for c in config.classes])
        self.register_buffer("radii", radii, persistent=False)

    def forward(self, x, class_index, boxes):
        """x [B, Q, C]; class_index [B, Q]; boxes see `Boxes`.

        returns rotation_6d [B, Q, 6], translation [B, Q, 3] m, sigma [B, Q, 2] (deg, m), or
        `Hypotheses`
        """
        several = self.count > 1

        def of_class(values, size):
            """[B, Q, size], or [B, Q, K, size]"""
            values = values.unflatten(-1, (-1, self.count * size))
            index = class_index[..., None, None].expand(*class_index.shape, 1, self.count * size)
            values = values.gather(-2, index)[..., 0, :]
            return values.unflatten(-1, (self.count, size)) if several else values

        rotation = of_class(self.rotation(x), 6)
        translation = self._placed(of_class(self.translation(x), 3), class_index, boxes)
        # Learnt on what the pose heads know, without pulling on it.
        raw = of_class(self.uncertainty(x.detach()), 2)
        scale = torch.tensor([40.0, 0.04], device=x.device)  # deg, m: sizes to start from
        sigma = F.softplus(raw) * scale + 3e-3 * scale
        if not several:
            return rotation, translation, sigma
        return Hypotheses(rotation, translation, sigma, of_class(self.score(x), 1)[..., 0])

    def _placed(self, correction, class_index, boxes):
        """Where the boxes alone put the object, moved by a learnt correction (u, v, w).

        Each box gives a point: on its center ray, as far away as a sphere of the object's diameter
        that fills it. The points of all views are averaged, each precise across its ray and ten
        times less along it: with one view this is its point, with more it triangulates. The
        correction is u, v half extents across the reference ray and w (logarithmic) along it.
        """
        o, d = boxes.rays[..., :3], boxes.rays[..., 3:6]  # [B, V, Q, 3]
        e_x, e_y = boxes.rays[..., 6:9] / BOX_RAY_GAIN, boxes.rays[..., 9:12] / BOX_RAY_GAIN
        angle = (e_x.norm(dim=-1) + e_y.norm(dim=-1)) / 2
        radius = self.radii[class_index][:, None]
        distance = (radius / angle.clamp_min(1e-4))[..., None]
        points = o + distance * d
        # Precision matrices I - (1 - 0.1^2) d d^T; views without the object have none.
        eye = torch.eye(3, device=d.device)
        precision = (eye - 0.99 * d[..., None] * d[..., None, :]) * boxes.valid[..., None, None]
        total = precision.sum(1)
        weighted = (precision @ points[..., None]).sum(1)[..., 0]
        center = solve3(total, weighted)
        u, v, w = correction[..., 0:1], correction[..., 1:2], correction[..., 2:3]
        along = torch.exp(w.clamp(-3, 3)) - 1
        reference = [center, *(x[:, 0] for x in (distance, e_x, e_y, d))]
        if self.count > 1:
            reference = [x[..., None, :] for x in reference]
        center, distance, e_x, e_y, d = reference
        return center + distance * (u * e_x + v * e_y + along * d)


def solve3(a, b):
    """x [..., 3] of a x = b for symmetric a [..., 3, 3], by Cramer's rule (exportable)."""
    c0, c1, c2 = a.unbind(-1)
    x = torch.stack(
        [(b * _cross(c1, c2)).sum(-1), (b * _cross(c2, c0)).sum(-1), (b * _cross(c0, c1)).sum(-1)],
        -1,
    )
    return x / (c0 * _cross(c1, c2)).sum(-1, keepdim=True)


def _cross(a, b):
    a0, a1, a2 = a.unbind(-1)
    b0, b1, b2 = b.unbind(-1)
    return torch.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], -1)
