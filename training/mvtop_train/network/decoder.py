"""FLoSE, projective attention over all views, and the pose heads (paper, section 4).

Axes: B batch, V views (0 is the reference), Q queries (objects), L levels, N cells, H heads.
"""

import math

import torch
import torch.nn.functional as F
from torch import nn

from .encoder import feed_forward, ring_offsets
from .rays import BOX_RAY_GAIN
from .sampling import deformable_sampling

BOX_CHANNELS = 12
VECTORS = 4  # per head, turned from a view's frame into the reference frame


def mlp(*sizes: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in zip(sizes[:-1], sizes[1:], strict=True):
        layers += [nn.Linear(a, b), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class Flose(nn.Module):
    """Feature line-of-sight encoding: [features; lines of sight] back to C channels.

    With "rays" geometry a feed-forward block follows, so that what a cell shows and where it
    looks are bound together before cells are summed.
    """

    def __init__(self, config):
        super().__init__()
        d = config.d_model
        self.linear = nn.Linear(d + config.los_channels, d)
        nn.init.xavier_uniform_(self.linear.weight)
        self.bind = config.geometry == "rays"
        if self.bind:
            self.ffn, self.norm = feed_forward(d, config.ffn), nn.LayerNorm(d)

    def forward(self, memory, rays):
        x = self.linear(torch.cat([memory, rays], -1))
        return self.norm(x + self.ffn(x)) if self.bind else x


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
        self.box_units = config.geometry == "rays"
        self.offsets = nn.Linear(d, heads * points * 2)
        self.weights = nn.Linear(d, heads * points)
        self.value = nn.Linear(d, d)
        self.lift = Lift(d, heads) if config.geometry == "rays" else None
        fused = d + (heads * VECTORS * 3 if self.lift else 0)
        self.view_logit = nn.Linear(d, heads)
        self.reference = nn.Linear(fused, d)
        self.others = nn.Linear(fused, d, bias=False)
        nn.init.zeros_(self.offsets.weight)
        ring = ring_offsets(heads, points) / (points if self.box_units else 1)
        self.offsets.bias.data.copy_(ring.reshape(-1))
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
            if self.box_units:
                unit = boxes.half_sizes[:, :, :, None, None, None]
            else:
                sizes = [[1 / w, 1 / h] for h, w in level_shapes]
                unit = torch.tensor(sizes, device=z.device)[:, None, None]
            locations = boxes.centers[:, :, :, None, None, None] + offsets * unit
            locations = locations.transpose(3, 4).reshape(b * v, q, heads, levels, points, 2)
            logits = logits.transpose(3, 4).reshape(b * v, q, heads, levels * points)
            weights = logits.softmax(-1).reshape(b * v, q, heads, levels, points)
            f = deformable_sampling(value, locations, weights, level_shapes)
            f = f.reshape(b, v, q, d)
            z_mean = z.mean(3)  # [B, V, Q, C]
            gathered = f.reshape(b, v, q, heads, d // heads)
            if self.lift:
                lifted = self.lift(f + z_mean, boxes.rays)
                gathered = torch.cat([gathered, lifted], -1)
            return self.fuse(gathered, self.view_logit(z_mean), boxes.valid)

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


class DecoderLayer(nn.Module):
    def __init__(self, config):
        super().__init__()
        d = config.d_model
        self.self_attention = SelfAttention(d, config.heads)
        self.attention = ProjectiveAttention(config)
        self.ffn = feed_forward(d, config.ffn)
        self.norm1, self.norm2, self.norm3 = (nn.LayerNorm(d) for _ in range(3))

    def forward(self, x, position, memory, at_center, boxes, level_shapes):
        with torch.autocast(x.device.type, enabled=False):
            x = self.norm1(x + self.self_attention(x, position, boxes.attended))
        x = x + self.attention(x + position, memory, at_center, boxes, level_shapes)
        with torch.autocast(x.device.type, enabled=False):
            x = self.norm2(x)
            return self.norm3(x + self.ffn(x))


class PoseHeads(nn.Module):
    """Class-specific 6-D rotation, translation and uncertainty of each query."""

    def __init__(self, config):
        super().__init__()
        d, classes = config.d_model, len(config.classes)
        self.absolute = config.geometry == "image"
        self.rotation = mlp(d, d, d, 6 * classes)
        self.translation = mlp(d, d, d, 3 * classes)
        self.uncertainty = mlp(d, d, 2 * classes)
        radii = torch.tensor([c.diameter_m / 2 for c in config.classes])
        self.register_buffer("radii", radii, persistent=False)

    def forward(self, x, class_index, boxes):
        """x [B, Q, C]; class_index [B, Q]; boxes see `Boxes`.

        returns rotation_6d [B, Q, 6], translation [B, Q, 3] m, sigma [B, Q, 2] (deg, m)
        """

        def of_class(values, size):
            values = values.unflatten(-1, (-1, size))
            index = class_index[..., None, None].expand(*class_index.shape, 1, size)
            return values.gather(-2, index)[..., 0, :]

        rotation = of_class(self.rotation(x), 6)
        translation = of_class(self.translation(x), 3)
        if not self.absolute:
            translation = self._from_box_rays(translation, class_index, boxes)
        # Learnt on what the pose heads know, without pulling on it.
        raw = of_class(self.uncertainty(x.detach()), 2)
        scale = torch.tensor([40.0, 0.04], device=x.device)  # deg, m: sizes to start from
        sigma = F.softplus(raw) * scale + 3e-3 * scale
        return rotation, translation, sigma

    def _from_box_rays(self, correction, class_index, boxes):
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
        return center + distance[:, 0] * (u * e_x[:, 0] + v * e_y[:, 0] + along * d[:, 0])


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


class Boxes:
    """Where the objects are: everything the decoder knows of the detections.

    centers, half_sizes [B, V, Q, 2] in 0..1 of the input; rays [B, V, Q, 12]; valid [B, V, Q]
    1.0 where the object was detected, else all other entries are ignored; attended [B, Q] 1.0 for
    queries that the others see (default: those with a box in the reference view).
    """

    def __init__(self, centers, half_sizes, rays, valid, attended=None):
        self.centers, self.half_sizes, self.rays, self.valid = centers, half_sizes, rays, valid
        self.attended = valid[:, 0] if attended is None else attended


class Decoder(nn.Module):
    """Memory of all views, their lines of sight and the boxes to poses, one per decoder layer."""

    def __init__(self, config):
        super().__init__()
        d = config.d_model
        self.geometry = config.geometry
        self.flose = Flose(config)
        self.class_embedding = nn.Embedding(len(config.classes), d)
        self.query = mlp(BOX_CHANNELS if self.geometry == "rays" else 4 * 2 * 10, d, d)
        if self.geometry == "rays":
            self.box_embedding = mlp(BOX_CHANNELS, d, d)
        self.layers = nn.ModuleList(DecoderLayer(config) for _ in range(config.decoder_layers))
        self.heads = nn.ModuleList(PoseHeads(config) for _ in range(config.decoder_layers))

    def forward(self, memory, rays, boxes: Boxes, class_index, level_shapes):
        """memory [B, V, N, C]; rays [B, V, N, R]; class_index [B, Q].

        returns a list over layers of (rotation_6d, translation, sigma), see `PoseHeads`
        """
        memory = self.flose(memory, rays)
        at_center = self._at_centers(memory, boxes.centers, level_shapes)
        with torch.autocast(memory.device.type, enabled=False):
            if self.geometry == "rays":
                at_center = at_center + self.box_embedding(boxes.rays)[:, :, :, None]
                position = self.query(boxes.rays[:, 0])
            else:
                full = torch.cat([boxes.centers[:, 0], 2 * boxes.half_sizes[:, 0]], -1)
                angle = full[..., None] * 2 ** torch.arange(10, device=full.device)
                position = self.query(torch.cat([angle.sin(), angle.cos()], -1).flatten(-2))
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
