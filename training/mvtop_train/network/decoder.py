"""FLoSE and the decoder: from tokens of all views, and boxes, to poses (paper, section 4).

Axes: B batch, V views (0 is the reference), Q queries (objects), L levels, N cells.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import nn

from .attention import ProjectiveAttention, SelfAttention
from .heads import PoseHeads
from .layers import feed_forward, mlp
from .sampling import deformable_sampling

BOX_CHANNELS = 12


@dataclass
class Boxes:
    """Where the objects are: everything the decoder knows of the detections.

    centers, half_sizes [B, V, Q, 2] in 0..1 of the input; rays [B, V, Q, 12]; valid [B, V, Q]
    1.0 where the object was detected, else all other entries are ignored. Queries see those that
    have a box in the reference view.
    """

    centers: torch.Tensor
    half_sizes: torch.Tensor
    rays: torch.Tensor
    valid: torch.Tensor


class Flose(nn.Module):
    """Feature line-of-sight encoding: [features; lines of sight] back to C channels.

    A feed-forward block follows, so that what a cell shows and where it looks are bound together
    before cells are summed.
    """

    def __init__(self, config):
        super().__init__()
        d = config.d_model
        self.linear = nn.Linear(d + config.los_channels, d)
        nn.init.xavier_uniform_(self.linear.weight)
        self.ffn, self.norm = feed_forward(d, config.ffn), nn.LayerNorm(d)

    def forward(self, memory, rays):
        x = self.linear(torch.cat([memory, rays], -1))
        return self.norm(x + self.ffn(x))


class DecoderLayer(nn.Module):
    def __init__(self, config, attention: type[ProjectiveAttention]):
        super().__init__()
        d = config.d_model
        self.self_attention = SelfAttention(d, config.heads)
        self.attention = attention(config)
        self.ffn = feed_forward(d, config.ffn)
        self.norm1, self.norm2, self.norm3 = (nn.LayerNorm(d) for _ in range(3))

    def forward(self, x, position, memory, at_center, boxes, level_shapes):
        with torch.autocast(x.device.type, enabled=False):
            x = self.norm1(x + self.self_attention(x, position, boxes.valid[:, 0]))
        x = x + self.attention(x + position, memory, at_center, boxes, level_shapes)
        with torch.autocast(x.device.type, enabled=False):
            x = self.norm2(x)
            return self.norm3(x + self.ffn(x))


class Parts(NamedTuple):
    """The classes that a decoder is made of, each taking a config."""

    flose: type[nn.Module]
    attention: type[ProjectiveAttention]
    heads: type[nn.Module]


class Decoder(nn.Module):
    """Memory of all views, their lines of sight and the boxes to poses, one per decoder layer."""

    # What another geometry or another kind of answer replaces.
    parts = Parts(Flose, ProjectiveAttention, PoseHeads)

    def __init__(self, config):
        super().__init__()
        d = config.d_model
        layers, parts = config.decoder_layers, self.parts
        self.flose = parts.flose(config)
        self.class_embedding = nn.Embedding(len(config.classes), d)
        self._add_queries(d)
        self.layers = nn.ModuleList(DecoderLayer(config, parts.attention) for _ in range(layers))
        self.heads = nn.ModuleList(parts.heads(config) for _ in range(layers))

    def _add_queries(self, d: int):
        self.query, self.box_embedding = mlp(BOX_CHANNELS, d, d), mlp(BOX_CHANNELS, d, d)

    def _positions(self, at_center, boxes: Boxes):
        """What is seen at the box centers, and each query's position [B, Q, C], from the boxes."""
        at_center = at_center + self.box_embedding(boxes.rays)[:, :, :, None]
        return at_center, self.query(boxes.rays[:, 0])

    def forward(self, memory, rays, boxes: Boxes, class_index, level_shapes):
        """memory [B, V, N, C]; rays [B, V, N, R]; class_index [B, Q].

        returns a list over layers of (rotation_6d, translation, sigma) or of hypotheses, see
        `heads.PoseHeads`
        """
        memory = self.flose(memory, rays)
        at_center = self._at_centers(memory, boxes.centers, level_shapes)
        with torch.autocast(memory.device.type, enabled=False):
            at_center, position = self._positions(at_center, boxes)
            x = position + self.class_embedding(class_index)
        outputs = []
        for layer, head in zip(self.layers, self.heads, strict=True):
            x = layer(x, position, memory, at_center, boxes, level_shapes)
            with torch.autocast(x.device.type, enabled=False):
                outputs.append(head(x.float(), class_index, boxes))
        return outputs

    @staticmethod
    def _at_centers(memory, centers, level_shapes):
        """Features at the box centers, each level by itself [B, V, Q, L, C]."""
        b, v, n, d = memory.shape
        q, levels = centers.shape[2], len(level_shapes)
        value = memory.float().reshape(b * v, n, 1, d)
        locations = centers.reshape(b * v, q, 1, 1, 1, 1, 2)
        locations = locations.expand(b * v, q, levels, 1, levels, 1, 2)
        locations = locations.reshape(b * v, q * levels, 1, levels, 1, 2)
        pick = torch.eye(levels, device=memory.device, dtype=value.dtype)
        weights = pick[None, None].expand(b * v, q, levels, levels)
        weights = weights.reshape(b * v, q * levels, 1, levels, 1)
        out = deformable_sampling(value, locations, weights, level_shapes)
        return out.reshape(b, v, q, levels, d)
