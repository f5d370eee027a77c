"""Fits all that a bundle stores about its own poses, on scenes that training left out.

What is fitted stands in `model.json`: `scorer` (the weights of the evidence by which poses are
ranked, rejected and given a confidence; `mvtop-core/src/scorer.rs`), the limits of `inference.rig`
from which a rig is doubted, `inference.search.min_confidence` below which objects are rejected, and
`pipeline_version`. The networks stay as they are. The command is `mvtop_train/calibrate.py`.

Each weight has the sign that its evidence means (`evidence.VIEW_TERMS`, `evidence.POSE_TERMS`), and
each term is bounded: what the held-out scenes do not show cannot outweigh all the rest.
"""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import brentq
from scipy.special import expit
from torch.nn.functional import binary_cross_entropy_with_logits, softplus

from .. import description
from ..data import bop
from ..data.objects import Object
from ..errors import asking_mvtop
from ..evaluation.outcomes import WITHIN_DEG, WITHIN_M
from .evidence import (
    FIX,
    POSE_TERMS,
    VIEW_TERMS,
    Gathered,
    Judged,
    by_boxes,
    defaults,
    gathered,
    with_limits,
)

LESS_TEXTURE = 0.4  # share of the poses whose texture is made to agree less, by any share
RIDGE = 1.0  # on weights of evidence of unit spread
MIN_POSES = 100  # to fit weights
MIN_OF_EACH = 10  # right ones, and wrong ones, among them
MIN_GROUPS = 20  # to choose a limit
TOO_FEW = (
    f"expected {MIN_POSES} poses on held-out scenes, {MIN_OF_EACH} right and {MIN_OF_EACH} wrong "
    "ones among them, got fewer"
)
BOUND = 4.0  # of the log-odds of a view, and of a term of the pose
MIN_SPREAD = 0.02, 0.05  # of evidence of views and of poses, so that weights stay finite
FALSE = 0.02  # share of the objects reported of several images that may be false
LOST = 0.005  # share of the right poses that may be rejected before refinement,
MARGIN = 2.0  # with log-odds that images of another look may lack besides
FEW = 3  # one scene in so many is of the first pass, or all where these are too few
ALARMS = 0.01  # share of the groups with true calibrations that may be warned of
# Limits that chance alone exceeds in one of a hundred groups, where cameras and objects are off as
# `mvtop-core/src/estimator/rig_test.rs` takes it: the root of what six numbers, or one, gain.
CHANCE = {"max_camera_deviation": 3.3, "max_scale_deviation": 2.4, "max_box_deviation": 1.0}
# Bounds of `unconfirmed_true`. Unknown things are detected, each by one camera: of `models/ycbv4`
# in path-traced scenes three times as often as in held-out ones (`make lies`, 0.13 and 0.19; 0.05).
UNCONFIRMED = 0.15, 0.5


class Model(torch.nn.Module):
    """The score of `mvtop-core/src/scorer.rs`, in terms of evidence of unit spread."""

    def __init__(self, view_scale: np.ndarray, pose_scale: np.ndarray):
        """- view_scale [view terms], pose_scale [pose terms]: spread of the evidence"""
        super().__init__()
        self.view_scale, self.pose_scale = torch.tensor(view_scale), torch.tensor(pose_scale)
        self.view_sign = torch.tensor(list(VIEW_TERMS.values()))
        self.pose_sign = torch.tensor(list(POSE_TERMS.values()))

        def parameter(count: int, start: float) -> torch.nn.Parameter:
            return torch.nn.Parameter(torch.full((count,), start, dtype=torch.float64))

        self.view = parameter(len(VIEW_TERMS), -0.5)
        self.pose = parameter(len(POSE_TERMS), -2.0)
        self.bias, self.nothing, self.correlation = (parameter(1, 0.0) for _ in range(3))

    @property
    def view_bias(self) -> torch.Tensor:
        """Of a view that shows nothing [1]: it speaks against the pose."""
        return -softplus(self.nothing)

    def unit_weights(self) -> tuple[torch.Tensor, torch.Tensor]:
        """[view terms] and [pose terms], for evidence of unit spread, each of its sign."""
        return self.view_sign * softplus(self.view), self.pose_sign * softplus(self.pose)

    def weights(self) -> tuple[torch.Tensor, torch.Tensor]:
        """[view terms] and [pose terms], for evidence in its own units."""
        view, pose = self.unit_weights()
        return view / self.view_scale, pose / self.pose_scale

    def forward(self, visible, shown, views, pose) -> torch.Tensor:
        """Log-odds [B].

        - visible [B, V]: share of the projection, 0 to 1
        - shown [B, V]: 1 where there is such a view, else 0
        - views [B, V, view terms], pose [B, pose terms]: evidence
        """
        by_view, by_pose = self.weights()
        each = BOUND * torch.tanh((views @ by_view + self.view_bias) / BOUND)
        count = shown.sum(1).clamp(min=1) ** torch.sigmoid(self.correlation)
        sums = (each * visible * shown).sum(1) / count
        return self.bias + sums + (BOUND * torch.tanh(pose * by_pose / BOUND)).sum(1)

    def as_stored(self) -> dict:
        """As `scorer.refined` of a bundle."""

        def number(x) -> float:
            return round(x.item(), 5)

        def named(terms, values):
            return {name: number(x) for name, x in zip(terms, values, strict=True)}

        view, pose = self.weights()
        return {
            "bias": number(self.bias), "view_bias": number(self.view_bias),
            "view": named(VIEW_TERMS, view), "pose": named(POSE_TERMS, pose),
            "bound": BOUND, "correlation": number(torch.sigmoid(self.correlation)),
        }  # fmt: skip


def stacked(found: list[Judged]) -> tuple[np.ndarray, ...]:
    """Inputs of `Model`, with as many views of each pose as the most have."""
    most = max(1, *(len(one.views) for one in found))
    visible, shown = np.zeros((2, len(found), most))
    views = np.zeros((len(found), most, len(VIEW_TERMS)))
    for row, one in enumerate(found):
        count = len(one.views)
        visible[row, :count], shown[row, :count], views[row, :count] = one.visible, 1, one.views
    return visible, shown, views, np.array([one.pose for one in found])


def fit(found: list[Judged], less_texture: float = LESS_TEXTURE, seed: int = 0) -> dict | None:
    """Weights as `scorer.refined` has them; None of too few poses, or too few right or wrong ones.

    - less_texture: share of the poses whose texture is made to agree less, as prints fade
    """
    right = np.array([one.right for one in found], float)
    count = int(right.sum())
    if len(found) < MIN_POSES or min(count, len(found) - count) < MIN_OF_EACH:
        return None
    visible, shown, views, pose = stacked(found)
    rng = np.random.default_rng(seed)
    fading = np.where(rng.random(len(found)) < less_texture, rng.random(len(found)), 1.0)
    views[:, :, list(VIEW_TERMS).index("texture")] *= fading[:, None]
    seen = views[shown > 0] if shown.any() else views.reshape(-1, len(VIEW_TERMS))
    model = Model(*(np.maximum(x.std(0), y) for x, y in zip((seen, pose), MIN_SPREAD, strict=True)))
    _minimise(model, [torch.tensor(x) for x in (visible, shown, views, pose)], torch.tensor(right))
    return model.as_stored()


def fit_to_existence(found: list[Judged]) -> dict | None:
    """As `fit`, where too few poses are right for it: the weights are those of the probability that
    the object exists, and the bias makes the mean confidence the share of right poses."""
    weights = fit([replace(one, right=one.exists) for one in found])
    if weights is None:
        return None
    odds = np.array([log_odds(weights, one) for one in found])
    share = (sum(one.right for one in found) + 0.5) / (len(found) + 1)
    shift = brentq(lambda x: expit(odds + x).mean() - share, -50, 50)
    return weights | {"bias": round(weights["bias"] + shift, 5)}


def _minimise(model: Model, inputs: list[torch.Tensor], right: torch.Tensor):
    """Minimises the cross entropy of log-odds against `right` [B], and a ridge on the weights."""
    optimiser = torch.optim.LBFGS(model.parameters(), max_iter=500, line_search_fn="strong_wolfe")

    def cost():
        optimiser.zero_grad()
        loss = binary_cross_entropy_with_logits(model(*inputs), right, reduction="sum")
        loss = loss + RIDGE * sum((x**2).sum() for x in model.unit_weights()) / 2
        loss.backward()
        return loss

    optimiser.step(cost)


def log_odds(weights: dict, one: Judged) -> float:
    """As the core computes them.

    - weights: `scorer.refined` or `scorer.unrefined`
    """
    bound = weights["bound"]
    by_view = np.array([weights["view"].get(name, 0.0) for name in VIEW_TERMS])
    by_pose = np.array([weights["pose"].get(name, 0.0) for name in POSE_TERMS])
    each = bound * np.tanh((one.views @ by_view + weights["view_bias"]) / bound)
    count = max(len(one.views), 1) ** weights["correlation"]
    terms = bound * np.tanh(one.pose * by_pose / bound)
    return float(weights["bias"] + (each * one.visible).sum() / count + terms.sum())


def confidence(scorer: dict, one: Judged) -> float:
    """Probability that a pose is right, by the weights of its kind."""
    weights = scorer["refined" if one.refined else "unrefined"]
    return float(expit(log_odds(weights, one)))


def least_confidence(confidences: np.ndarray, exists: np.ndarray) -> float:
    """The least confidence such that, of the poses that have it or more, at most a share `FALSE` is
    of objects that do not exist; 0.5 where there is none.

    - confidences [n], exists [n] bool
    """
    order = np.argsort(-confidences, kind="stable")
    share = np.cumsum(~exists[order]) / np.arange(1, len(order) + 1)
    good = np.flatnonzero(share <= FALSE)
    # Rounded down, so that the last pose is kept.
    return float(np.floor(confidences[order][good[-1]] * 1e3) / 1e3) if len(good) else 0.5


def limits(rigs: list, by_boxes_alone: list) -> dict[str, float]:
    """Settings of `inference.rig`: what at most a share `ALARMS` of the groups exceeds, and the
    share of objects that one camera misses. The core's own of too few groups.

    - rigs: `rig_consistency` of groups with true calibrations
    - by_boxes_alone: the same of groups where boxes alone say how well the rig fits
    """
    by_views = [one for one in rigs if not by_boxes(one)]
    of = {
        "max_camera_deviation": by_views, "max_scale_deviation": by_views,
        "max_box_deviation": by_boxes_alone,
    }  # fmt: skip
    found = {}
    for setting, groups in of.items():
        values = sorted(getattr(one, setting.removeprefix("max_")) for one in groups)
        enough = len(values) >= MIN_GROUPS
        found[setting] = _limit(values, CHANCE[setting]) if enough else defaults()[setting]
    found["unconfirmed_true"] = _unconfirmed(rigs)
    return found


def _limit(values: list[float], least: float) -> float:
    kept = values[: len(values) - int(ALARMS * len(values))]
    return float(np.ceil(max(kept[-1], least) * 100) / 100)


def _unconfirmed(rigs: list) -> float:
    unconfirmed = sum(one.unconfirmed for one in rigs)
    count = unconfirmed + sum(one.confirmed for one in rigs)
    if count < MIN_GROUPS:
        return defaults()["unconfirmed_true"]
    return float(np.clip(np.ceil(unconfirmed / count * 1e3) / 1e3, *UNCONFIRMED))


def put(
    bundle: Path,
    scorer: dict,
    rig: dict[str, float],
    least: float,
    least_initial: float | None,
    detector: dict,
):
    """Writes what was fitted into the bundle's description, in place of what stood there.

    - scorer: `refined` and `unrefined`, as of `fit`
    - rig: settings of `inference.rig`, as of `limits`
    - least: `inference.search.min_confidence`
    - least_initial: `inference.search.min_initial_log_odds`
    - detector: thresholds that replace the bundle's
    """
    from mvtop._mvtop import PIPELINE_VERSION

    about = description.uncalibrated(description.read(bundle))
    inference = about.pop("inference", {})
    inference["rig"] = inference.get("rig", {}) | rig
    search = {"min_confidence": least, "min_initial_log_odds": least_initial}
    inference["search"] = inference.get("search", {}) | search
    fitted = {
        "pipeline_version": PIPELINE_VERSION,
        "scorer": {"within_deg": WITHIN_DEG, "within_m": WITHIN_M, **scorer},
        "inference": inference,
    }
    parts = {}
    for key, value in about.items():
        parts |= {key: value | detector, **fitted} if key == "detector" else {key: value}
    description.write(bundle, parts)


@contextlib.contextmanager
def uncalibrated(bundle: Path, detector: dict) -> Iterator[Path]:
    """A copy of a bundle without what is fitted: of any pipeline version, the copy can be loaded.

    - detector: thresholds that replace the bundle's
    """
    about = description.uncalibrated(description.read(bundle))
    about["detector"] |= detector
    with tempfile.TemporaryDirectory() as folder:
        with asking_mvtop(FIX):
            for name in about["files"]:
                shutil.copyfile(bundle / name, Path(folder) / name)
        description.write(Path(folder), about)
        yield Path(folder)


def calibrate(
    bundle: Path,
    scenes: list[list[bop.Image]],
    known: tuple[Object, ...],
    detector: dict | None = None,
) -> bool:
    """Fits a bundle; False where there are too few poses, which leaves the bundle as it is.

    - scenes: images of each held-out scene
    - detector: thresholds that replace the bundle's
    """
    every = {"search.min_confidence": 0.0, "search.min_initial_log_odds": None}
    first = initial = before = None
    with uncalibrated(bundle, detector or {}) as plain:
        raw = gathered(plain, scenes, known, "unrefined poses", inference=every, refine=False)
        found, boxed = raw, [one for one in raw.rigs if by_boxes(one)]
        # The scorer ranks candidates: a first one, of few scenes, ranks those of the second.
        for part in (scenes[::FEW], scenes):
            refined = gathered(plain, part, known, "refined, first pass", inference=every)
            if not any(one.refined for one in refined.poses):
                break
            found = refined
            before = limits(found.rigs, boxed)
            first = scorer_of(found, raw, before)
            if first is not None:
                break
        if found is not raw:
            if first is None:
                return False
            put(plain, first, before, 0.0, None, detector or {})
            found = gathered(plain, scenes, known, "refined, second pass", inference=every)
            initial = least_initial(found.poses)
    failed = found.failed + (raw.failed if raw is not found else 0)
    if failed:
        print(f"note: {failed} groups of views have no prediction")
    rig = limits(found.rigs, boxed)
    if first is not None:
        # Without a scorer all that two cameras detect is confirmed, whatever their poses are worth.
        rig["unconfirmed_true"] = before["unconfirmed_true"]
    scorer = scorer_of(found, raw, rig)
    if scorer is None:
        return False
    if first is not None:
        scorer["unrefined"] = first["unrefined"]  # by which the log-odds before refinement are
    shown = [with_limits(one, rig) for one in found.poses if one.images > 1 and not one.disturbed]
    said = np.array([confidence(scorer, one) for one in shown])
    least = least_confidence(said, np.array([one.exists for one in shown], bool))
    put(bundle, scorer, rig, least, initial, detector or {})
    return True


def least_initial(found: list[Judged]) -> float | None:
    """The log-odds before refinement that at most a share `LOST` of the right poses is below, less
    `MARGIN`; None of too few of them."""
    odds = [one.initial for one in found if one.right and one.refined]
    if len(odds) < MIN_POSES:
        return None
    return float(np.floor((np.quantile(odds, LOST) - MARGIN) * 1e3) / 1e3)


def scorer_of(found: Gathered, raw: Gathered, rig: dict[str, float]) -> dict | None:
    """`refined` and `unrefined` weights, of a bundle with these limits; None of too few poses.

    - found, raw: what is predicted with and without refinement; the same where no pose is refined
    """
    poses = [with_limits(one, rig) for one in raw.poses]
    unrefined = fit(poses)
    if raw is found:
        return unrefined and {"refined": unrefined, "unrefined": unrefined}
    # Refinement makes poses right of which none was before.
    unrefined = unrefined or fit_to_existence(poses)
    refined = fit([with_limits(one, rig) for one in found.poses if one.refined])
    return refined and unrefined and {"refined": refined, "unrefined": unrefined}
