"""Attention of the decoder: projective over all views, and among queries (paper, section 4).

Axes: B batch, V views (0 is the reference), Q queries (objects), L levels, N cells, H heads.
"""

import math

import torch
import torch.nn.functional as F
from torch import nn

from .layers import mlp, ring_offsets
from .sampling import deformable_sampling

VECTORS = 4  # per head, turned from a view's frame into the reference frame


class Lift(nn.Module):
    """Vectors predicted in a view's own box frame, turned into the reference frame.

    The frame's axes are the box's lines of sight: half extents e_x, e_y and center ray d_c. After
    it, what every view says about directions is said in one frame, and fusing views is adding.
    """

    def __init__(self, d_model: int, heads: int):
        super().__init__()
        self.heads = heads
        self.coefficients = mlp(d_model, d_model, heads * VECTORS * 3)

    def forward(self, features, box_rays):
        """features [B, V, Q, C]; box_rays [B, V, Q, 12]; returns [B, V, Q, H, 3 * VECTORS]."""
        coefficients = self.coefficients(features)
        coefficients = coefficients.unflatten(-1, (self.heads * VECTORS, 3))
        d_c, e_x, e_y = box_rays[..., 3:6], box_rays[..., 6:9], box_rays[..., 9:12]
        axes = torch.stack(
            [F.normalize(e_x, dim=-1), F.normalize(e_y, dim=-1), d_c], -2
        )  # [B, V, Q, 3 axes, 3]; all zero where the object was not detected
        vectors = coefficients @ axes
        return vectors.unflatten(-2, (self.heads, VECTORS)).flatten(-2)


class ProjectiveAttention(nn.Module):
    """Each query gathers features around its box in every view, then fuses the views.

    Fusion: the reference view has its own weights, all others share theirs and are averaged with
    learnt weights. With two views this equals the paper's Concat(f_1, f_2) W^p; with any number
    it does not depend on their order.
    """

    def __init__(self, config):
        super().__init__()
        d, heads, points = config.d_model, config.heads, config.points
        self.heads, self.points, self.levels = heads, points, len(config.pose_strides)
        self.offsets = nn.Linear(d, heads * points * 2)
        self.weights = nn.Linear(d, heads * points)
        self.value = nn.Linear(d, d)
        fused = d + self._add_lift(d)
        self.view_logit = nn.Linear(d, heads)
        self.reference = nn.Linear(fused, d)
        self.others = nn.Linear(fused, d, bias=False)
        nn.init.zeros_(self.offsets.weight)
        self.offsets.bias.data.copy_(self._ring().reshape(-1))
        for zero in (self.weights.weight, self.weights.bias, self.value.bias):
            nn.init.zeros_(zero)
        for linear in (self.value, self.reference, self.others):
            nn.init.xavier_uniform_(linear.weight)

    def forward(self, query, memory, at_center, boxes, level_shapes):
        """query [B, Q, C] with position; memory [B, V, N, C]; at_center [B, V, Q, L, C]."""
        b, v, n, d = memory.shape
        q, heads, levels, points = query.shape[1], self.heads, self.levels, self.points
        value = self.value(memory).float().reshape(b * v, n, heads, d // heads)
        with torch.autocast(memory.device.type, enabled=False):
            z = query[:, None, :, None] + at_center  # [B, V, Q, L, C]
            offsets = self.offsets(z).reshape(b, v, q, levels, heads, points, 2)
            logits = self.weights(z).reshape(b, v, q, levels, heads, points)
            unit = self._unit(boxes, level_shapes)
            locations = boxes.centers[:, :, :, None, None, None] + offsets * unit
            locations = locations.transpose(3, 4).reshape(b * v, q, heads, levels, points, 2)
            logits = logits.transpose(3, 4).reshape(b * v, q, heads, levels * points)
            weights = logits.softmax(-1).reshape(b * v, q, heads, levels, points)
            f = deformable_sampling(value, locations, weights, level_shapes)
            f = f.reshape(b, v, q, d)
            z_mean = z.mean(3)  # [B, V, Q, C]
            gathered = f.reshape(b, v, q, heads, d // heads)
            gathered = self._lifted(gathered, f + z_mean, boxes)
            return self.fuse(gathered, self.view_logit(z_mean), boxes.valid)

    def _add_lift(self, d: int) -> int:
        """Adds what is learnt of directions; returns its channels, of all heads."""
        self.lift = Lift(d, self.heads)
        return self.heads * VECTORS * 3

    def _ring(self):
        """Offsets [H, K, 2] to start from."""
        return ring_offsets(self.heads, self.points) / self.points

    def _unit(self, boxes, level_shapes):
        """What offsets [B, V, Q, L, H, K, 2] are multiples of: the box's half size."""
        return boxes.half_sizes[:, :, :, None, None, None]

    def _lifted(self, gathered, z, boxes):
        """[B, V, Q, H, D], with what `z` [B, V, Q, C] says of directions behind it."""
        return torch.cat([gathered, self.lift(z, boxes.rays)], -1)

    def fuse(self, gathered, logit, valid):
        """gathered [B, V, Q, H, D]; logit [B, V, Q, H]; valid [B, V, Q]; returns [B, Q, C]."""
        first = torch.arange(valid.shape[1], device=valid.device) == 0
        mask = (valid * ~first[None, :, None])[..., None]  # the reference is not among the others
        logit = torch.where(mask > 0, logit, torch.full_like(logit, -1e4))
        share = torch.exp(logit - logit.amax(1, keepdim=True)) * mask
        share = share / share.sum(1, keepdim=True).clamp_min(0.5)  # the largest term is 1
        others = (share[..., None] * gathered).sum(1).flatten(-2)
        return self.reference(gathered[:, 0].flatten(-2)) + self.others(others)


class SelfAttention(nn.Module):
    """Attention among queries; dummy queries are masked out, so they change nothing."""

    def __init__(self, d_model: int, heads: int):
        super().__init__()
        self.heads = heads
        self.query_key = nn.Linear(d_model, 2 * d_model)
        self.value, self.output = nn.Linear(d_model, d_model), nn.Linear(d_model, d_model)

    def forward(self, x, position, valid):
        b, n, d = x.shape
        q, k = self.query_key(x + position).reshape(b, n, 2, self.heads, -1).unbind(2)
        v = self.value(x).reshape(b, n, self.heads, -1)
        scores = torch.einsum("bqhd,bkhd->bhqk", q, k) / math.sqrt(d // self.heads)
        scores = scores + (valid[:, None, None] - 1) * 1e4
        mixed = torch.einsum("bhqk,bkhd->bqhd", scores.softmax(-1), v).reshape(b, n, d)
        return self.output(mixed)
