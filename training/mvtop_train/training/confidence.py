"""How probable it is that a pose is right: fitted on scenes not trained on.

    python -m mvtop_train.training.confidence --bundle models/mine --data data/mine

writes `confidence` into a bundle's `model.json`, by which `mvtop` judges its poses: the weights of
a logistic regression over what is known of each and its squares (`mvtop-core/src/confidence.rs`),
where there is enough of them another one for poses that one view alone shows. Takes the
held-out scenes of the training split in groups of one, two and three views, a share of them with
cameras that are not quite where the rig has them. With `--split test` it says how reliable the
confidences of another split are.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from .. import description
from ..data import bop, objects
from ..data.objects import Object
from ..errors import UserError, command
from ..network import symmetry
from . import heldout, support

WITHIN_DEG, WITHIN_M = 5.0, 0.005
VIEWS = (1, 2, 3)  # in a group
DISTURBED = 0.2  # of the groups have cameras that are off
MOST_OFF = 2.0, 0.02  # degrees and metres, of these
RIDGE = 1.0  # on weights of evidence of unit spread
LEAST = 100  # poses, right and wrong ones among them
LIMITS = 0.01, 0.99  # shares of the poses by which evidence is bounded
MOST_WEIGHT = 1e5  # of evidence in its unit; bundles may have up to ten times that
BINS = 10  # as `mvtop-cli eval` has it


@dataclass(frozen=True)
class Judged:
    """One predicted pose."""

    evidence: dict[str, float]
    right: bool
    confidence: float | None  # what the bundle says by now
    views: int
    disturbed: bool


def judged(bundle: Path, scenes, known: tuple[Object, ...], disturbed: float, seed: int = 0):
    """Of each pose that is predicted for groups of views; what is no object's is wrong."""
    import mvtop

    rng = np.random.default_rng(seed)
    estimator, by_id = mvtop.Estimator.load(bundle), {obj.id: obj for obj in known}
    groups = [
        images[start : start + views]
        for images in scenes
        for views in VIEWS
        for start in range(0, len(images) - views + 1, views)
    ]
    found = []
    for images in tqdm(groups, unit="group", desc="confidence"):
        rig, pictures = support.rig_of(images)
        off = len(images) > 1 and rng.random() < disturbed
        if off:
            rig = moved(rig, rng)
        try:
            prediction = estimator.predict(pictures, rig)
        except mvtop.Error:  # of a network that has hardly learnt, poses that cannot be
            continue
        truth = true_poses(images, by_id)
        for one in prediction.objects:
            if one.evidence is not None:
                right = is_right(one, truth, by_id[one.class_id])
                found.append(Judged(one.evidence, right, one.confidence, len(images), off))
    return found


def moved(rig, rng):
    """The rig with all cameras but the first off by up to `MOST_OFF`."""
    import mvtop

    first, *others = rig.cameras
    cameras = [first]
    for camera in others:
        size = rng.random()
        turn = rng.standard_normal(3)
        turn *= np.radians(MOST_OFF[0]) * size / np.linalg.norm(turn)
        off = np.eye(4)
        off[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        shift = rng.standard_normal(3)
        off[:3, 3] = shift * MOST_OFF[1] * size / np.linalg.norm(shift)
        pose = camera.world_from_cam @ off
        cameras.append(mvtop.Camera(camera.K, camera.size, world_from_cam=pose, id=camera.id))
    return mvtop.Rig(cameras, trust_unit=True)


def true_poses(images: list[bop.Image], by_id: dict[int, Object]) -> list[tuple[int, np.ndarray]]:
    """(id, world_from_obj [4, 4]) of all that stands in a scene, also what is hardly seen."""
    return [
        (one.obj_id, np.linalg.inv(image.cam_from_world) @ one.cam_from_obj)
        for image in images
        for one in image.instances
        if one.obj_id in by_id
    ]


def is_right(one, truth: list[tuple[int, np.ndarray]], obj: Object) -> bool:
    """Whether an object of its class has this pose, within the bounds, but for symmetries."""
    alike = symmetry.of(objects.classes_of(obj))
    for obj_id, world_from_obj in truth:
        if obj_id != obj.id:
            continue
        pose, known = (torch.tensor(x).float() for x in (one.world_from_obj, world_from_obj))
        turn = symmetry.nearest(pose[:3, :3], pose[:3, 3], known, torch.tensor(0), alike)
        known = known @ turn
        cos = ((pose[:3, :3] * known[:3, :3]).sum() - 1) / 2
        angle = torch.rad2deg(cos.clamp(-1, 1).acos())
        if angle <= WITHIN_DEG and (pose[:3, 3] - known[:3, 3]).norm() <= WITHIN_M:
            return True
    return False


def fit(found: list[Judged]) -> dict | None:
    """As it stands in `model.json`; None where there is too little to tell right from wrong."""
    bounds = {"within_deg": WITHIN_DEG, "within_m": WITHIN_M}
    alone = _odds([one for one in found if one.evidence["views"] == 0])
    several = _odds([one for one in found if one.evidence["views"] != 0])
    if alone and several:
        return bounds | several | {"one_view": alone}
    all_alike = _odds(found)
    return all_alike and bounds | all_alike


def _odds(found: list[Judged]) -> dict | None:
    """How the odds of being right follow from evidence, bounded by what it is of these poses."""
    right = np.array([one.right for one in found], float)
    if len(found) < LEAST or not LEAST / 10 <= right.sum() <= len(found) - LEAST / 10:
        return None
    names = sorted(found[0].evidence)
    x = np.array([[one.evidence[name] for name in names] for one in found])
    # Values that occur: between what is nearly always the same and the next there are none.
    ends = zip(LIMITS, ("lower", "higher"), strict=True)
    limits = np.stack([np.quantile(x, at, axis=0, method=method) for at, method in ends]).round(6)
    x = x.clip(*limits)
    mean, spread = x.mean(0), x.std(0)
    varies = spread > 1e-6
    while True:
        scale = np.where(varies, spread, 1.0)
        unit = (x - mean) / scale * varies
        weights = _regression(np.concatenate([unit, unit**2], 1), right)
        by, by_square = weights[1:].reshape(2, -1) * varies / (scale, scale**2)
        greatest = np.maximum(abs(by - 2 * by_square * mean), abs(by_square))
        if (greatest < MOST_WEIGHT).all():
            break
        varies &= greatest < greatest.max()  # what hardly varies, but tells by how little it does

    def named(values):
        each = zip(names, values, varies, strict=True)
        return {name: np.round(value, 6).tolist() for name, value, used in each if used}

    return {
        "bias": round(float(weights[0] - by @ mean + by_square @ mean**2), 6),
        "weights": named(by - 2 * by_square * mean),
        "squares": named(by_square),
        "limits": named(limits.T),
    }


def _regression(x: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Weights [1 + n] of a constant and of x [poses, n], by Newton's method; the cost is convex."""
    x = np.concatenate([np.ones((len(x), 1)), x], 1)
    ridge = np.diag([0.0, *[RIDGE] * (x.shape[1] - 1)])
    weights = np.zeros(x.shape[1])
    for _ in range(50):
        p = 1 / (1 + np.exp(-x @ weights))
        slope = x.T @ (p - right) + ridge @ weights
        step = np.linalg.solve((x * (p * (1 - p))[:, None]).T @ x + ridge, slope)
        weights -= step
        if np.abs(step).max() < 1e-9:
            break
    return weights


def add(bundle: Path, fitted: dict):
    """Writes it into the bundle's description."""
    parts = list(description.read(bundle).items())
    at = 1 + next(n for n, (key, _) in enumerate(parts) if key == "detector")
    parts = [part for part in parts if part[0] != "confidence"]
    parts.insert(at, ("confidence", fitted))
    description.write(bundle, dict(parts))


def reliability(confidence: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, float]:
    """[bins, 3] of count, mean confidence and share of right poses, and the calibration error."""
    order = np.argsort(confidence, kind="stable")
    bins = np.array_split(order, min(BINS, len(order)))
    rows = np.array([[len(b), confidence[b].mean(), right[b].mean()] for b in bins])
    return rows, float(np.average(abs(rows[:, 1] - rows[:, 2]), weights=rows[:, 0]))


def tell(name: str, found: list[Judged]):
    import mvtop

    sure = [one for one in found if one.confidence is not None]
    if len(sure) < BINS:
        return
    confidence = np.array([one.confidence for one in sure])
    right = np.array([one.right for one in sure])
    rows, error = reliability(confidence, right)
    area = mvtop.statistics.auroc(confidence, right)
    area = "-" if area is None else f"{area:.3f}"
    print(f"{name}: {len(sure)} poses, {right.mean():.1%} right, AUROC {area}, "
          f"calibration error {error:.3f}")  # fmt: skip
    for count, said, came in rows:
        print(f"  {count:5.0f} poses  said {said:6.1%}  right {came:6.1%}")


@command
def main():
    parser = heldout.parser(__doc__, "say how reliable it is")
    parser.add_argument("--disturbed", type=float, help="share of groups with cameras that are off")
    args = parser.parse_args()
    scenes, training = heldout.scenes(args), heldout.is_training(args)
    disturbed = args.disturbed if args.disturbed is not None else DISTURBED * training
    known = objects.read_all(args.data)
    found = judged(args.bundle, scenes, known, disturbed)
    if training:
        fitted = fit(found)
        if fitted is None:
            raise UserError(
                f"{args.bundle}: expected {LEAST} poses on held-out scenes, right and wrong ones, "
                f"got {len(found)}, {sum(one.right for one in found)} of them right; fix: more "
                "scenes (--held-out), or train for longer"
            )
        add(args.bundle, fitted)
        print(json.dumps(fitted, indent=1))
        return
    tell("one and two views", [one for one in found if one.views < 3])
    for views in VIEWS:
        tell(f"{views} views", [one for one in found if one.views == views])
    if disturbed:
        tell("cameras that are off", [one for one in found if one.disturbed])


if __name__ == "__main__":
    main()
