"""Variants of the network and how each is trained and tested: same features, data and budget."""

import dataclasses
import json
from pathlib import Path

import mvtop
import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from ..data import mvball, objects
from ..network import config, losses, pose, rays
from ..network.decoder import Boxes, Decoder
from ..network.encoder import Encoder
from ..training.optimise import learning_rate
from . import baselines, canonical

BINS = 512  # 22 degrees apart
IMAGES = 64  # per step


@dataclasses.dataclass(frozen=True)
class Variant:
    """What differs from the paper's baseline."""

    los_encoding: str = "origin_direction"
    encoder_layers: int = 2
    queries: int = 2
    views: int = 2
    heads: str = "pose"  # or "hypotheses"
    geometry: str = "image"  # the paper's; or "rays", that of the shipped network
    data: str = "mvball"  # or "control": both hemispheres visible, so that one view suffices


RAYS = Variant(geometry="rays", los_encoding="plucker_origin", queries=1)
VARIANTS = {
    "baseline": Variant(),
    "one_view": Variant(views=1),
    "single": Variant(los_encoding="none", views=1),
    "hypotheses": Variant(los_encoding="none", views=1, heads="hypotheses"),
    "single_control": Variant(los_encoding="none", views=1, data="control"),
    "hypotheses_control": Variant(los_encoding="none", views=1, heads="hypotheses", data="control"),
    "rays": RAYS,
    # The paper's ablations, of the network that learns to fuse views within the budget.
    "no_encoder": dataclasses.replace(RAYS, encoder_layers=0),
    "direction": dataclasses.replace(RAYS, los_encoding="direction"),
    "origin_direction": dataclasses.replace(RAYS, los_encoding="origin_direction"),
    "plucker": dataclasses.replace(RAYS, los_encoding="plucker"),
    "queries_2": dataclasses.replace(RAYS, queries=2),
    "queries_4": dataclasses.replace(RAYS, queries=4),
    "queries_8": dataclasses.replace(RAYS, queries=8),
}


class Transformer(nn.Module):
    """Encoder, FLoSE, decoder and heads on given features."""

    def __init__(self, variant: Variant, strides, channels: int):
        super().__init__()
        self.config = config.preset(
            "small", objects.classes_of(objects.ball()), width=canonical.SIZE,
            height=canonical.SIZE, strides=strides, geometry=variant.geometry,
            los_encoding=variant.los_encoding, encoder_layers=variant.encoder_layers, closeup=0,
        )  # fmt: skip
        d = self.config.d_model
        self.dummies = variant.queries - 1
        self.project = nn.ModuleList(
            nn.Sequential(nn.Linear(channels, d), nn.LayerNorm(d)) for _ in strides
        )
        self.encoder, self.decoder = Encoder(self.config), Decoder(self.config)
        if variant.heads == "hypotheses":
            self.decoder.heads = nn.ModuleList(
                baselines.HypothesisHeads(self.config, BINS)
                for _ in range(self.config.decoder_layers)
            )

    def forward(self, features, ref_from_cam, boxes):
        """features [B, V, N, C]; ref_from_cam [B, V, 4, 4] m; boxes [B, V, 4] px."""
        b, v = features.shape[:2]
        shapes = self.config.level_shapes()
        k = torch.from_numpy(canonical.K).float().expand(b, v, 3, 3)
        with torch.autocast("cpu", enabled=False):  # geometry stays in fp32
            camera_rays = rays.unproject(k, rays.cell_centers(shapes, self.config.strides))
            lines = rays.encode(camera_rays, ref_from_cam, self.config.los_encoding)
            box_rays = rays.box_rays(k, boxes[..., None, :], ref_from_cam)
        counts = [rows * columns for rows, columns in shapes]
        tokens = features.flatten(0, 1).split(counts, 1)
        levels = [
            project(t).transpose(1, 2).unflatten(-1, shape)
            for project, t, shape in zip(self.project, tokens, shapes, strict=True)
        ]
        memory = self.encoder(levels, camera_rays.flatten(0, 1)).unflatten(0, (b, v))
        queries = self._queries(boxes, box_rays)
        outputs = self.decoder(memory, lines, queries, self._classes(b), shapes)
        return [tuple(part[:, :1] for part in output) for output in outputs]

    def _queries(self, boxes, box_rays) -> Boxes:
        """The object's query, then PoET's dummies: boxes at -1, seen by self-attention."""
        size = canonical.SIZE
        low, high = (boxes[..., None, :2] + 0.5) / size, (boxes[..., None, 2:] + 0.5) / size
        b, v = boxes.shape[:2]
        dummies = torch.full((b, v, self.dummies, 2), -1.0)
        # "Seen" by the reference view, on its axis: where there is no line, nothing can be placed.
        seen = torch.zeros(b, v, self.dummies)
        seen[:, 0] = 1
        ahead = torch.tensor([0.0, 0, 0, 0, 0, 1, 1, 0, 0, 0, 1, 0]).expand(b, v, self.dummies, 12)
        queries = 1 + self.dummies
        return Boxes(
            torch.cat([(low + high) / 2, dummies], 2),
            torch.cat([(high - low) / 2, 0.5 * dummies], 2),
            torch.cat([box_rays, ahead], 2),
            torch.cat([torch.ones(b, v, 1), seen], -1),
            attended=torch.ones(b, queries),
        )

    def _classes(self, b: int):
        return torch.zeros(b, 1 + self.dummies, dtype=torch.long)


def draw(cached: canonical.Cached, rng, views: int) -> np.ndarray:
    """View numbers [views] of a random scene; two show different hemispheres, if they can."""
    scene = cached.scenes[rng.integers(len(cached.scenes))]
    first = rng.choice(scene)
    if views == 1:
        return np.array([first])
    return np.array([first, rng.choice(scene[cached.shows[scene] != cached.shows[first]])])


def batch_of(cached: canonical.Cached, numbers: np.ndarray, rng):
    """Views `numbers` [B, V] as the inputs of a `Transformer`, and the poses [B, V, 4, 4]."""
    cam_from_world = cached.cam_from_world[numbers]
    ref_from_cam = cam_from_world[:, :1] @ np.linalg.inv(cam_from_world)
    features = cached.features[torch.from_numpy(numbers)].float()
    inputs = [torch.from_numpy(x).float() for x in (ref_from_cam, cached.boxes(numbers, rng))]
    return (features, *inputs), torch.from_numpy(cached.cam_from_obj[numbers]).float()


def loss_of(model, outputs, truth, variant: Variant):
    truth = truth[:, :1]
    if variant.heads == "hypotheses":
        outputs = [
            (*output, head.bins) for output, head in zip(outputs, model.decoder.heads, strict=True)
        ]
        return baselines.hypothesis_loss(outputs, truth)
    rot, t = losses.pose_errors(outputs, truth)
    return losses.ROTATION * rot.mean((1, 2)).sum() + losses.TRANSLATION * t.mean((1, 2)).sum()


def fit(variant: Variant, cached, strides, steps: int, seed: int, name: str) -> Transformer:
    """Train one variant."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    model = Transformer(variant, strides, cached.features.shape[-1])
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3, weight_decay=1e-4)
    average = torch.optim.swa_utils.AveragedModel(
        model, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.99)
    )
    bar = tqdm(range(steps), unit="step", desc=name)
    for step in bar:
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(step, step / steps, peak=1e-3, warmup=100)
        numbers = np.stack(
            [draw(cached, rng, variant.views) for _ in range(IMAGES // variant.views)]
        )
        inputs, truth = batch_of(cached, numbers, rng)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            outputs = model(*inputs)
        loss = loss_of(model, outputs, truth, variant)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(model.parameters(), 5.0)
        optimizer.step()
        average.update_parameters(model)
        if step % 20 == 0:
            bar.set_postfix_str(f"loss {loss.item():.2f}")
    return average.module.eval()


def poses_of(output) -> np.ndarray:
    """The last layer's poses [B, 4, 4] of the object."""
    six, translation, _ = output
    poses = np.tile(np.eye(4), (len(six), 1, 1))
    poses[:, :3, :3] = pose.rotation_from_6d(six[:, 0]).numpy()
    poses[:, :3, 3] = translation[:, 0].numpy()
    return poses


def hypotheses_of(output, count: int) -> np.ndarray:
    """The `count` most likely poses [B, count, 4, 4], best first."""
    logits, rotations, translation = (part[:, 0] for part in output)
    best = logits.topk(count, -1).indices
    poses = np.tile(np.eye(4), (len(logits), count, 1, 1))
    picked = rotations.gather(1, best[..., None, None].expand(-1, -1, 3, 3))
    poses[..., :3, :3] = picked.numpy()
    poses[..., :3, 3] = translation[:, None].numpy()
    return poses


def errors(estimates: np.ndarray, truth: np.ndarray) -> dict:
    """Mean errors of poses [B, 4, 4], degrees and metres."""
    angle = mvtop.metrics.rotation_error_deg(truth, estimates)
    add = mvtop.metrics.Surface(objects.ball().points).add(truth, estimates)
    return {
        "pairs": len(angle),
        "rot_mean_deg": float(angle.mean()),
        "rot_median_deg": float(np.median(angle)),
        "share_over_30_deg": float((angle > 30).mean()),
        "add_mean_m": float(add.mean()),
    }


@torch.no_grad()
def test(model: Transformer, variant: Variant, cached, seed=0) -> dict[str, dict]:
    """Errors on the pairs of a test split, by how its views are put together."""
    rng = np.random.default_rng(seed)
    pairs = np.stack([scene[:2] for scene in cached.scenes])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        if variant.views == 2:
            inputs, truth = batch_of(cached, pairs, rng)
            return {"two_views": errors(poses_of(model(*inputs)[-1]), truth[:, 0].numpy())}
        inputs, truth = batch_of(cached, pairs.reshape(-1, 1), rng)
        output = tuple(part.float() for part in model(*inputs)[-1])
    truth = truth[:, 0].numpy().reshape(-1, 2, 4, 4)
    world = cached.cam_from_world[pairs]
    ref_from_cam = world[:, :1] @ np.linalg.inv(world)
    points = mvball.bounding_points(200)
    if variant.heads == "hypotheses":
        results = {}
        for count in (1, 5, 20, 60):
            every = hypotheses_of(output, count).reshape(-1, 2, count, 4, 4)
            voted = [baselines.vote(h, r, points) for h, r in zip(every, ref_from_cam, strict=True)]
            results[f"voting_top_{count}"] = errors(np.stack(voted), truth[:, 0])
        return results | {"one_view": errors(every[:, 0, 0], truth[:, 0])}
    every = poses_of(output).reshape(-1, 2, 4, 4)
    fused = [
        baselines.late_fusion(c, r, canonical.K, points)
        for c, r in zip(every, ref_from_cam, strict=True)
    ]
    late = errors(np.stack([f for f, _ in fused]), truth[:, 0])
    late["share_agreeing"] = float(np.mean([views > 1 for _, views in fused]))
    return {"one_view": errors(every[:, 0], truth[:, 0]), "late_fusion": late}


def table(folder: Path) -> str:
    """All results of a folder as a Markdown table: variants, splits and ways of testing."""
    lines = [
        "| variant | split | poses from | rotation mean | median | over 30° | ADD mean |",
        "|---|---|---|---|---|---|---|",
    ]
    results = [json.loads(path.read_text()) for path in folder.glob("*-seed*.json")]
    order = list(VARIANTS)
    for result in sorted(results, key=lambda r: (order.index(r["variant"]["name"]), r["seed"])):
        for split in ("hard", "easy", "control_test"):
            for way, e in result.get(split, {}).items():
                lines.append(
                    f"| {result['variant']['name']} | {split} | {way.replace('_', ' ')} "
                    f"| {e['rot_mean_deg']:.1f}° | {e['rot_median_deg']:.1f}° "
                    f"| {100 * e['share_over_30_deg']:.0f} % | {1e3 * e['add_mean_m']:.1f} mm |"
                )
    return "\n".join(lines)
