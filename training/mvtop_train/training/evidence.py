"""The evidence of poses that are predicted on held-out scenes, and whether these are right.

Rendered scenes differ less from each other than photographs do. So images are changed as cameras
and lamps change them (exposure, white balance, tone, blur, noise), and a share of the groups has
cameras that are off.
"""

import functools
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from .. import description
from ..data import bop, objects
from ..data.objects import Object
from ..errors import asking_mvtop
from ..evaluation.outcomes import WITHIN_DEG, WITHIN_M, errors

VIEWS = (1, 2, 3, 4)  # of a group
DISTURBED = 0.2  # share of the groups of several views with cameras that are off
MAX_TURN_DEG, MAX_SHIFT_M = 2.0, 0.02  # of these cameras
EXISTS = 0.5  # of the diameter: a pose that is nearer to a true object of its class is of that one
FIX = "name another bundle or data set"

# The sign of each weight by what its evidence means: 1 where more of it speaks for the pose, -1
# where more of it speaks against it. Views speak for a pose by what they show, not by their number:
# else more of them than in these groups make false objects probable. Names and order as in
# `mvtop-core/src/scorer.rs`.
VIEW_TERMS = {
    "detector": 1, "coordinates": 1, "contour": 1, "color": 1, "mutual_information": 1,
    "texture": 1,
}  # fmt: skip
POSE_TERMS = {
    "prior": 1, "expected_rotation": -1, "expected_translation": -1, "initial_rotation": -1,
    "residual": -1, "views": -1, "object_deviation": -1, "rig_deviation": -1,
}  # fmt: skip
MAX_DEVIATION = 50.0  # as the core bounds it


@dataclass(frozen=True)
class Judged:
    """One predicted pose."""

    visible: np.ndarray  # [V], share of its projection that each view shows, 0 to 1
    views: np.ndarray  # [V, view terms]
    pose: np.ndarray  # [pose terms]
    refined: bool  # on the images: which weights it is scored by
    right: bool  # within `WITHIN_DEG` and `WITHIN_M` of a true pose of its class
    exists: bool  # an object of its class stands about there
    images: int  # of its group
    disturbed: bool  # cameras of its group are off
    confidence: float | None = None  # by the bundle
    rig: object | None = None  # `rig_consistency` of its group
    initial: float = 0.0  # log-odds before refinement, by the bundle


@dataclass
class Gathered:
    """What is predicted for held-out groups."""

    poses: list[Judged] = field(default_factory=list)
    rigs: list[object] = field(default_factory=list)  # `rig_consistency` of undisturbed groups
    failed: int = 0  # groups without a prediction


def groups_of(scenes: list[list[bop.Image]]) -> list[list[bop.Image]]:
    """The images of each scene in groups of each number of views, one after the other."""
    return [
        images[start : start + views]
        for images in scenes
        for views in VIEWS
        for start in range(0, len(images) - views + 1, views)
    ]


def changed(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An image as another camera may show it in other light: [H, W, 3] uint8 RGB."""
    x = image.astype(np.float32) / 255
    if rng.random() < 0.3:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.4, 1.4))
    gain = rng.uniform(0.65, 1.4) * rng.uniform(0.87, 1.15, 3)
    x = np.clip(x * gain.astype(np.float32), 0, 1) ** rng.uniform(0.8, 1.25)
    x = x + rng.normal(size=x.shape).astype(np.float32) * rng.uniform(0, 0.02)
    return np.clip(x * 255 + 0.5, 0, 255).astype(np.uint8)


def moved(rig, rng: np.random.Generator):
    """The rig with each camera but the first off by up to `MAX_TURN_DEG` and `MAX_SHIFT_M`."""
    import mvtop  # loads its compiled part

    first, *others = rig.cameras
    cameras = [first]
    for camera in others:
        size = rng.random()
        turn, shift = rng.standard_normal((2, 3))
        off = np.eye(4)
        turn *= np.radians(MAX_TURN_DEG) * size / np.linalg.norm(turn)
        off[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        off[:3, 3] = shift * MAX_SHIFT_M * size / np.linalg.norm(shift)
        pose = camera.world_from_cam @ off
        cameras.append(mvtop.Camera(camera.K, camera.size, world_from_cam=pose, id=camera.id))
    return mvtop.Rig(cameras, trust_unit=True)


def true_poses(images: list[bop.Image], by_id: dict[int, Object]) -> list[tuple[int, np.ndarray]]:
    """(id, world_from_obj [4, 4], m) of each object of a scene, also of what is hardly visible."""
    found: list[tuple[int, np.ndarray]] = []
    for image in images:
        for one in image.instances:
            if one.obj_id not in by_id:
                continue
            place = np.linalg.inv(image.cam_from_world) @ one.cam_from_obj
            reach = bop.SAME_PLACE * by_id[one.obj_id].diameter_m
            if not any(
                obj_id == one.obj_id and np.linalg.norm(other[:3, 3] - place[:3, 3]) < reach
                for obj_id, other in found
            ):
                found.append((one.obj_id, place))
    return found


def nearest(
    world_from_obj: np.ndarray, truth: list[tuple[int, np.ndarray]], obj: Object
) -> tuple[float, float]:
    """Degrees and metres, up to symmetries, from a pose [4, 4] to the true one of its class that is
    nearest to it in place; infinite where none is within the object's diameter."""
    (known,) = objects.classes_of(obj)
    off = [
        errors(place, world_from_obj, known)
        for obj_id, place in truth
        if obj_id == obj.id
        and np.linalg.norm(place[:3, 3] - world_from_obj[:3, 3]) < obj.diameter_m
    ]
    return min(off, key=lambda pair: pair[1], default=(np.inf, np.inf))


def gathered(
    bundle: Path,
    scenes: list[list[bop.Image]],
    known: tuple[Object, ...],
    name: str,
    *,
    refine: bool | None = None,
    inference: dict | None = None,
    disturbed: float = DISTURBED,
    change: bool = True,
    seed: int = 0,
) -> Gathered:
    """Every pose that is predicted for groups of views.

    - name: of the progress bar
    - refine: as of `mvtop.Estimator.predict`
    - inference: settings that replace the bundle's
    - disturbed: share of the groups of several views with cameras that are off
    - change: whether images are changed (`changed`)
    """
    with asking_mvtop(FIX):
        import mvtop

        estimator = mvtop.Estimator.load(bundle, inference=inference)
    rng = np.random.default_rng(seed)
    by_id = {obj.id: obj for obj in known}
    found, groups = Gathered(), groups_of(scenes)
    with tqdm(total=sum(map(len, groups)), unit="image", desc=name) as bar:
        for images in groups:
            rig, pictures = bop.rig_of(images)
            if change:
                pictures = {key: changed(picture, rng) for key, picture in pictures.items()}
            off = len(images) > 1 and rng.random() < disturbed
            try:
                prediction = estimator.predict(
                    pictures, moved(rig, rng) if off else rig, refine=refine
                )
            except mvtop.Error:  # of a network that has hardly learnt: no pose can be computed
                found.failed += 1
            else:
                _add(found, prediction, images, by_id, off)
            bar.update(len(images))
    return found


def _add(found: Gathered, prediction, images: list[bop.Image], by_id: dict[int, Object], off: bool):
    """Adds the poses of a group, and its rig where that is true."""
    rig, truth = prediction.rig_consistency, true_poses(images, by_id)
    if not off and rig is not None:
        found.rigs.append(rig)
    for one in prediction.objects:
        obj = by_id[one.class_id]
        rot_deg, t_m = nearest(one.world_from_obj, truth, obj)
        found.poses.append(Judged(
            *terms(one.evidence), one.refinement is not None,
            rot_deg <= WITHIN_DEG and t_m <= WITHIN_M, t_m < EXISTS * obj.diameter_m,
            len(images), off, one.confidence, rig, one.evidence["initial_log_odds"],
        ))  # fmt: skip


def terms(evidence: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Visible shares [V], terms of the views [V, view terms], and of the pose [pose terms].

    - evidence: of an object, as predictions have it
    """
    shown = evidence["views"]
    views = np.array([[view[name] for name in VIEW_TERMS] for view in shown], float)
    return (
        np.array([view["visible"] for view in shown], float),
        views.reshape(-1, len(VIEW_TERMS)),
        np.array([evidence["pose"][name] for name in POSE_TERMS], float),
    )


def by_boxes(rig) -> bool:
    """Whether boxes alone say how well a rig fits, as no object has views with poses to compare."""
    return rig.box_deviation > 0


@functools.cache
def defaults() -> dict[str, float]:
    """`inference.rig` of the core, by setting."""
    return description.default_inference("rig")


def contradiction(rig, settings: dict[str, float]) -> float:
    """`rig_consistency.contradiction` as it is with these settings of `inference.rig`."""
    of_true, of_wrong = settings["unconfirmed_true"], settings["unconfirmed_wrong"]
    by_each = np.log((1 - of_wrong) / (1 - of_true)), np.log(of_wrong / of_true)
    return float(by_each[0] * rig.confirmed + by_each[1] * rig.unconfirmed)


def deviation(rig, settings: dict[str, float]) -> float:
    """`rig_consistency.deviation` as it is with these settings of `inference.rig`; the core's own
    for others."""
    settings = defaults() | settings
    if by_boxes(rig):
        poses = rig.box_deviation / settings["max_box_deviation"]
    else:
        poses = max(
            rig.camera_deviation / settings["max_camera_deviation"],
            rig.scale_deviation / settings["max_scale_deviation"],
        )
    return max(poses, contradiction(rig, settings) / settings["max_contradiction"])


def with_limits(one: Judged, limits: dict[str, float]) -> Judged:
    """A pose with the evidence of its rig as it is with these settings of `inference.rig`."""
    if one.rig is None:
        return one
    pose = one.pose.copy()
    by_rig = min(deviation(one.rig, limits), MAX_DEVIATION)
    pose[list(POSE_TERMS).index("rig_deviation")] = np.log1p(by_rig)
    return replace(one, pose=pose)
