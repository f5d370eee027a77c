"""Deformable encoder, each view on its own (Deformable DETR, Zhu et al. 2021; post-norm)."""

import torch
import torch.nn.functional as F
from torch import nn

from .layers import feed_forward, ring_offsets
from .rays import cell_centers
from .sampling import deformable_sampling


class DeformableAttention(nn.Module):
    """Every cell gathers from a few learnt places around itself on all levels."""

    def __init__(self, d_model: int, heads: int, levels: int, points: int):
        super().__init__()
        self.shape = (heads, levels, points)
        self.offsets = nn.Linear(d_model, heads * levels * points * 2)
        self.weights = nn.Linear(d_model, heads * levels * points)
        self.value = nn.Linear(d_model, d_model)
        self.output = nn.Linear(d_model, d_model)
        nn.init.zeros_(self.offsets.weight)
        ring = ring_offsets(heads, points)[:, None].expand(heads, levels, points, 2)
        self.offsets.bias.data.copy_(ring.reshape(-1))
        for zero in (self.weights.weight, self.weights.bias, self.value.bias, self.output.bias):
            nn.init.zeros_(zero)
        nn.init.xavier_uniform_(self.value.weight)
        nn.init.xavier_uniform_(self.output.weight)

    def forward(self, query, tokens, centers, level_shapes):
        """query, tokens [V, N, C]; centers [N, 2] in 0..1; returns [V, N, C]."""
        views, n, _ = tokens.shape
        heads, levels, points = self.shape
        value = self.value(tokens).float().reshape(views, n, heads, -1)
        # Offsets are in cells of their level. The scale goes into the linear layer's parameters:
        # on the offsets themselves it would cost as much as the sampling.
        cell = self.cells(level_shapes).to(query.device)
        offsets = F.linear(query, self.offsets.weight * cell[:, None], self.offsets.bias * cell)
        locations = offsets.float() + centers.repeat(1, heads * levels * points)
        locations = locations.reshape(views, n, heads, levels, points, 2)
        logits = self.weights(query).float().reshape(views, n, heads, levels * points)
        weights = logits.softmax(-1).reshape(views, n, heads, levels, points)
        return self.output(deformable_sampling(value, locations, weights, level_shapes))

    def cells(self, level_shapes):
        """Size of a cell, as a share of its level, by what `offsets` gives."""
        size = torch.tensor([[1 / w, 1 / h] for h, w in level_shapes])
        return size[:, None].expand(*self.shape, 2).reshape(-1)


class EncoderLayer(nn.Module):
    def __init__(self, config):
        super().__init__()
        d, levels = config.d_model, len(config.pose_strides)
        self.attention = DeformableAttention(d, config.heads, levels, config.points)
        self.norm1, self.norm2 = nn.LayerNorm(d), nn.LayerNorm(d)
        self.ffn = feed_forward(d, config.ffn)

    def forward(self, tokens, position, centers, level_shapes):
        attended = self.attention(tokens + position, tokens, centers, level_shapes)
        tokens = self.norm1(tokens + attended)
        return self.norm2(tokens + self.ffn(tokens))


class Encoder(nn.Module):
    """Pyramid levels to tokens [V, N, C]."""

    def __init__(self, config):
        super().__init__()
        d = config.d_model
        self.strides = config.pose_strides
        self.level_embedding = nn.Parameter(torch.randn(len(config.pose_strides), d) * 0.1)
        self._add_positions(d)
        self.layers = nn.ModuleList(EncoderLayer(config) for _ in range(config.encoder_layers))

    def _add_positions(self, d: int):
        self.position, self.norm = nn.Linear(3, d), nn.LayerNorm(d)

    def _placed(self, tokens, camera_rays, shapes):
        """Tokens [V, N, C] of levels of `shapes` as the layers take them, and where each is."""
        return self.norm(tokens), self.position(camera_rays)

    def forward(self, levels, camera_rays):
        """levels: L maps [V, C, h, w]; camera_rays [V, N, 3] unit, in each camera's own frame."""
        shapes = [tuple(int(s) for s in level.shape[-2:]) for level in levels]
        tokens = torch.cat([level.flatten(2).transpose(1, 2) for level in levels], 1)
        counts = torch.tensor([rows * columns for rows, columns in shapes])
        embedding = self.level_embedding.repeat_interleave(counts.to(tokens.device), 0)
        tokens, position = self._placed(tokens, camera_rays, shapes)
        position = embedding + position
        size = torch.tensor(
            [shapes[0][1] * self.strides[0], shapes[0][0] * self.strides[0]], device=tokens.device
        )
        centers = (cell_centers(shapes, self.strides, tokens.device) + 0.5) / size
        for layer in self.layers:
            tokens = layer(tokens, position, centers, shapes)
        return tokens
