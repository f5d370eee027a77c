"""Variants of the network and how each is trained and tested: same features, data and budget."""

import copy
import dataclasses
import json
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.stats
import torch
from tqdm import tqdm

from ..data import batches, mvball, objects
from ..data.bank import Bank
from ..data.inputs import to_views
from ..data.views import collate
from ..network import losses, pose
from ..network.config import Config
from ..network.model import Mvtop
from ..network.precision import autocast
from ..network.views import Views
from ..training.checkpoint import TrainingState
from ..training.optimise import descend, learning_rate
from ..training.progress import Timer
from . import baselines, canonical, tables

IMAGES = 64  # per step
PEAK, WARMUP, CLIP = 1e-3, 100, 5.0  # learning rate, steps to it, norm of the gradient
PRECISION = "fp32"  # bf16 gains nothing on matrices as small as these
SAVE_MINUTES = 3.0
LOOKED_AT = 500  # steps from one point of the learning curve to the next


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
    "baseline_no_encoder": Variant(encoder_layers=0),
    # Without the encoder a step takes a third of the time.
    "no_encoder_direction": Variant(encoder_layers=0, los_encoding="direction"),
    "no_encoder_plucker": Variant(encoder_layers=0, los_encoding="plucker"),
    "no_encoder_plucker_origin": Variant(encoder_layers=0, los_encoding="plucker_origin"),
    "no_encoder_single": Variant(encoder_layers=0, los_encoding="none", views=1),
    "baseline_direction": Variant(los_encoding="direction"),
    "baseline_plucker": Variant(los_encoding="plucker"),
    "baseline_plucker_origin": Variant(los_encoding="plucker_origin"),
    "one_view": Variant(views=1),
    "single": Variant(los_encoding="none", views=1),
    "hypotheses": Variant(los_encoding="none", views=1, heads="hypotheses"),
    "single_control": Variant(los_encoding="none", views=1, data="control"),
    "hypotheses_control": Variant(los_encoding="none", views=1, heads="hypotheses", data="control"),
    "rays": RAYS,
    # The paper's ablations, of the shipped network's geometry.
    "no_encoder": dataclasses.replace(RAYS, encoder_layers=0),
    "direction": dataclasses.replace(RAYS, los_encoding="direction"),
    "origin_direction": dataclasses.replace(RAYS, los_encoding="origin_direction"),
    "plucker": dataclasses.replace(RAYS, los_encoding="plucker"),
    "queries_2": dataclasses.replace(RAYS, queries=2),
    "queries_4": dataclasses.replace(RAYS, queries=4),
    "queries_8": dataclasses.replace(RAYS, queries=8),
}


def config_of(variant: Variant, trained: Config, strides: tuple[int, ...]) -> Config:
    """The variant's network, for the features of the network `trained` at some of its strides."""
    poses = variant.heads == "pose"
    blind = variant.los_encoding == "none"  # see `given`
    return dataclasses.replace(
        trained,
        geometry=variant.geometry if poses else f"{variant.geometry}_{variant.heads}",
        los_encoding="direction" if blind else variant.los_encoding,
        encoder_layers=variant.encoder_layers,
        hypotheses=1,
        closeup=canonical.SIZE,
        closeup_strides=strides,
    )


def given(batch: dict, variant: Variant, config: Config, device="cpu") -> Views:
    """A batch as the variant's network takes it.

    Without lines of sight no cell has one. PoET's dummy queries follow the object's: boxes at -1
    of the reference image, seen by self-attention.
    """
    views = to_views(batch, config, device)
    if variant.los_encoding == "none":
        views = dataclasses.replace(views, inside=torch.zeros_like(views.inside))
    dummies = variant.queries - 1
    # Of center and size -1, in px.
    low, high = -0.5 * canonical.SIZE - 0.5, -1.5 * canonical.SIZE - 0.5
    b, v = views.valid.shape[:2]
    boxes = torch.tensor([low, low, high, high], device=device).expand(b, v, dummies, 4)
    seen = torch.zeros(b, v, dummies, device=device)
    seen[:, 0] = 1
    return dataclasses.replace(
        views,
        boxes=torch.cat([views.boxes, boxes], 2),
        valid=torch.cat([views.valid, seen], 2),
        class_index=views.class_index.repeat(1, variant.queries),
    )


def outputs_of(model: Mvtop, views: Views) -> list:
    """What each decoder layer says of the object, not of the dummies."""
    return [tuple(part[:, :1] for part in output) for output in model(views).poses]


def loss_of(model: Mvtop, outputs, truth, variant: Variant):
    """truth [B, V, 4, 4] cam_from_obj"""
    truth = truth[:, :1]
    if variant.heads == "hypotheses":
        outputs = [
            (*output, head.bins) for output, head in zip(outputs, model.decoder.heads, strict=True)
        ]
        return baselines.hypothesis_loss(outputs, truth)
    rot, t = losses.pose_errors(outputs, truth)
    return losses.ROTATION * rot.mean((1, 2)).sum() + losses.TRANSLATION * t.mean((1, 2)).sum()


@dataclasses.dataclass(frozen=True)
class Budget:
    """What one variant may use; training ends with what is used up first."""

    steps: float = math.inf
    minutes: float = math.inf  # of processor time, as other work may run beside it

    def used(self, state: TrainingState) -> float:
        """The share of it, 0 to 1 and over."""
        return max(state.step / self.steps, state.elapsed / 60 / self.minutes)


def fit(
    variant: Variant,
    bank: Bank,
    config: Config,
    folder: Path,
    weights: Path,
    budget: Budget,
    seed: int,
    look: Callable[[Mvtop], dict] | None = None,
) -> TrainingState:
    """Train one variant in a run folder of its own, which a later call goes on with.

    - weights: of the network whose backbone's features `bank` has
    - look: what it says of the network after each `LOOKED_AT` steps becomes a line of `curve.jsonl`
    - returns: the state at its end, `elapsed` in seconds of processor time
    """
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.manual_seed(seed)
    state = TrainingState(folder, config, device, backbone=weights)
    shares = [float(views == variant.views) for views in range(1, variant.views + 1)]
    stream = batches.Batches(bank, IMAGES, shares, seed, 0, 1)
    loader = batches.loader(stream, state.step, workers=0, pinned=False)
    saving = Timer(SAVE_MINUTES)
    bar = tqdm(desc=folder.name, initial=state.step, unit="step")
    while (used := budget.used(state)) < 1:
        begun = time.process_time()
        batch = next(loader)
        views = given(batch, variant, config, device)
        with autocast(device, PRECISION):
            outputs = outputs_of(state.model, views)
        loss = loss_of(state.model, outputs, batch["cam_from_obj"].to(device), variant)
        descend(state, loss, learning_rate(state.step, used, PEAK, WARMUP), CLIP)
        state.update_average()
        state.step += 1
        state.elapsed += time.process_time() - begun
        bar.update()
        if state.step % 20 == 0:
            bar.set_postfix_str(f"{100 * used:.0f} % of the budget, loss {loss.item():.2f}")
        looked_at = look is not None and state.step % LOOKED_AT == 0
        if looked_at:
            # A copy, as moving a network moves the one that is trained on.
            point = {"step": state.step, "minutes": round(state.elapsed / 60, 2)}
            point |= look(copy.deepcopy(state.average).cpu())
            with open(folder / "curve.jsonl", "a") as curve:
                curve.write(json.dumps(point) + "\n")
        if saving.due() or looked_at or budget.used(state) >= 1:
            state.save()
    bar.close()
    state.average.cpu()
    return state


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
    """Errors of poses [B, 4, 4], degrees and metres, and the mean rotation's interval."""
    import mvtop  # loads its compiled part

    angle = mvtop.metrics.rotation_error_deg(truth, estimates)
    add = mvtop.metrics.Surface(objects.ball().points).add(truth, estimates)
    return {
        "pairs": len(angle),
        "rot_mean_deg": float(angle.mean()),
        "rot_interval_deg": interval(angle),
        "rot_median_deg": float(np.median(angle)),
        "share_over_30_deg": float((angle > 30).mean()),
        "add_mean_m": float(add.mean()),
        "rot_deg": angle.round(3).tolist(),
    }


@torch.no_grad()
def test(model: Mvtop, variant: Variant, bank: Bank) -> dict[str, dict]:
    """Errors on the pairs of a test split, by how its views are put together."""
    pairs = [[bank.first(image) for image in scene[:2]] for scene in bank.scenes]
    items = pairs if variant.views == 2 else [[view] for views in pairs for view in views]
    views = given(collate(items), variant, model.config)
    with autocast("cpu", PRECISION):
        output = tuple(part.float() for part in outputs_of(model, views)[-1])
    world, truth, k = (
        np.array([[view[name] for view in views] for views in pairs])
        for name in ("cam_from_world", "cam_from_obj", "k")
    )
    if variant.views == 2:
        return {"two_views": errors(poses_of(output), truth[:, 0])}
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
        baselines.late_fusion(*views, points) for views in zip(every, ref_from_cam, k, strict=True)
    ]
    late = errors(np.stack([f for f, _ in fused]), truth[:, 0])
    late["share_agreeing"] = float(np.mean([views > 1 for _, views in fused]))
    return {"one_view": errors(every[:, 0], truth[:, 0]), "late_fusion": late}


def interval(values: np.ndarray) -> list[float]:
    """Of the mean of `values` [N]: 95 %, by a bootstrap."""
    if len(values) < 2:
        return [float(values.mean())] * 2
    drawn = scipy.stats.bootstrap((values,), np.mean, method="percentile", rng=0)
    return [float(end) for end in drawn.confidence_interval]


def read(folder: Path) -> list[dict]:
    """The results in a folder, in the order of `VARIANTS`."""
    results = [json.loads(path.read_text()) for path in folder.glob("*-seed*.json")]
    order = list(VARIANTS)
    return sorted(results, key=lambda r: (order.index(r["variant"]["name"]), r["seed"]))


def curves(folder: Path) -> dict[str, dict[str, tuple[list, list, list]]]:
    """By split and by variant of a folder: minutes, mean rotation errors and their intervals, of
    two views where the variant has them."""
    found = {}
    for path in sorted(folder.glob("*/curve.jsonl")):
        for point in map(json.loads, path.read_text().splitlines()):
            for split, ways in point.items():
                if isinstance(ways, dict):
                    way = ways.get("two_views") or ways["one_view"]
                    columns = found.setdefault(split, {}).setdefault(path.parent.name, ([], [], []))
                    row = point["minutes"], way["rot_mean_deg"], way["rot_interval_deg"]
                    for column, value in zip(columns, row, strict=True):
                        column.append(value)
    return found


def against(result: dict, first: dict, split: str, way: str) -> str:
    """The difference of a mean rotation error to that of the first variant, by pairs."""
    mine, its = (
        np.array(r.get(split, {}).get(way, {}).get("rot_deg", [])) for r in (result, first)
    )
    if result is first or len(mine) != len(its) or not len(mine):
        return ""
    low, high = interval(mine - its)
    chance = ", within chance" if low <= 0 <= high else ""
    return f"{(mine - its).mean():+.1f}° [{low:+.1f}, {high:+.1f}]{chance}"


def table(folder: Path) -> str:
    """All results of a folder as a Markdown table: variants, splits and ways of testing."""
    header = ["variant", "steps", "split", "poses from", "rotation mean", "median", "over 30°", "ADD mean", "beside the first"]  # noqa: E501  # fmt: skip
    results = read(folder)
    rows = [
        [
            result["variant"]["name"], str(result["steps"]), split, way.replace("_", " "),
            "{:.1f}° [{:.1f}, {:.1f}]".format(e["rot_mean_deg"], *e["rot_interval_deg"]),
            f"{e['rot_median_deg']:.1f}°", f"{100 * e['share_over_30_deg']:.0f} %",
            f"{1e3 * e['add_mean_m']:.1f} mm", against(result, results[0], split, way),
        ]
        for result in results
        for split in ("hard", "easy", "control_test")
        for way, e in result.get(split, {}).items()
    ]  # fmt: skip
    return tables.table(header, rows)
