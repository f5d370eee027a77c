"""Which of the poses that are predicted for an exposure are sure enough to learn from.

A pose is accepted where its confidence is high, enough views speak for it, nothing speaks against
the rig, and most of the groups of views that accept an object there agree on it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import description
from ..data import objects
from ..data.objects import Object
from ..errors import UserError, asking_mvtop
from ..evaluation.boxes import cut_box, inside, pixels_of
from ..evaluation.groups import SAME_OBJECT, choices
from ..evaluation.outcomes import WITHIN_DEG, WITHIN_M, errors
from ..training.evidence import VIEW_TERMS
from .exposures import Exposure

MOST_VIEWS = 6  # of a group
MOST_GROUPS = 24  # of an exposure


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose that was predicted in an exposure.

    scene           name of the exposure
    world_from_obj  [4, 4], m
    views           how many speak for it
    """

    scene: str
    obj: Object
    world_from_obj: np.ndarray
    confidence: float
    views: int

    def same_object(self, other: "Pose") -> bool:
        """Whether it is of the same object of the same exposure, rightly posed or not."""
        away = np.linalg.norm(self.world_from_obj[:3, 3] - other.world_from_obj[:3, 3])
        same = (self.scene, self.obj.id) == (other.scene, other.obj.id)
        return same and bool(away < SAME_OBJECT * self.obj.diameter_m)

    def agrees(self, other: "Pose") -> bool:
        """Whether the two are one pose, but for symmetries."""
        (known,) = objects.classes_of(self.obj)
        rot_deg, t_m = errors(self.world_from_obj, other.world_from_obj, known)
        return rot_deg <= WITHIN_DEG and t_m <= WITHIN_M


class Judge:
    """A calibrated bundle, and how sure a pose must be.

    least   confidence
    views   that speak for it, at least
    """

    def __init__(self, bundle: Path, known: tuple[Object, ...], least: float, views: int):
        about = description.read(bundle)
        if "scorer" not in about:
            raise UserError(
                f"{bundle}: expected a calibrated bundle, whose confidences can be trusted, got "
                "one that is not; fix: mvtop-train calibrate"
            )
        with asking_mvtop("--model BUNDLE"):
            import mvtop  # loads its compiled part

            self.estimator = mvtop.Estimator.load(bundle)
        self.known = {obj.id: obj for obj in known}
        self.weights, self.least, self.views = about["scorer"], least, views

    def poses(self, exposure: Exposure) -> tuple[list[Pose], list[Pose]]:
        """Those of an exposure that are accepted, one for each object, and all others."""
        accepted, others = [], []
        for numbers in groups_of(len(exposure.paths)):
            part = exposure.part(numbers)
            prediction = self.predicted(part, part.images())
            doubted = prediction is None or bool(prediction.warnings)
            for found in prediction.objects if prediction else ():
                pose = self._pose(exposure.name, found, part)
                sure = pose.confidence >= self.least and pose.views >= self.views and not doubted
                (accepted if sure else others).append(pose)
        agreed = consensus(accepted)
        others = [one for one in accepted + others if not any(map(one.same_object, agreed))]
        return agreed, others

    def seen_by(self, exposure: Exposure, accepted: list[Pose]) -> dict[str, list[bool]]:
        """By camera whether what its image shows speaks for each of the accepted poses of an
        exposure: detected or not, as boxes are given."""
        found = {camera.id: [False] * len(accepted) for camera in exposure.rig.cameras}
        count = len(exposure.paths)
        chunks = -(-count // MOST_VIEWS)
        for start in range(chunks if accepted else 0):
            part = exposure.part(list(range(start, count, chunks)))
            boxes = [{"class": one.obj.name, "boxes": _boxes(one, part)} for one in accepted]
            shown = [number for number, one in enumerate(boxes) if one["boxes"]]
            prediction = self.predicted(part, part.images(), [boxes[number] for number in shown])
            for one in prediction.objects if prediction else ():
                pose = self._pose(exposure.name, one, part)
                for number in shown:
                    if pose.same_object(accepted[number]) and pose.agrees(accepted[number]):
                        for camera, speaks in self._views(one, part, given=True).items():
                            found[camera][number] |= speaks
        return found

    def predicted(self, part: Exposure, images: dict, boxes: list[dict] | None = None):
        """mvtop.Prediction; None where the images show nothing that a pose can be computed of."""
        import mvtop  # loads its compiled part

        if boxes is not None and not boxes:
            return None
        try:
            return self.estimator.predict(images, part.rig, boxes=boxes)
        except mvtop.Error:
            return None

    def _pose(self, scene: str, found, part: Exposure) -> Pose:
        return Pose(
            scene, self.known[found.class_id], np.array(found.world_from_obj),
            found.confidence or 0.0, sum(self._views(found, part).values()),
        )  # fmt: skip

    def _views(self, found, part: Exposure, given: bool = False) -> dict[str, bool]:
        """By camera that should show an object whether its view speaks for the pose: whether its
        share of the log-odds is positive (docs/explanation/confidence.md).

        - given: whether boxes were given, so that detection tells nothing
        """
        if found.evidence is None:
            return {}
        weights = self.weights["refined" if found.refinement is not None else "unrefined"]
        views = found.evidence["views"]
        obj, shares = self.known[found.class_id], []
        for camera in part.rig.cameras:
            pixels = pixels_of(obj.points, np.array(found.world_from_obj), camera)
            shares.append(inside(pixels, camera))
        # Evidence does not name its cameras: they are those with most of the object, in order.
        cameras = sorted(np.argsort(shares, kind="stable")[::-1][: len(views)].tolist())
        speaks = {}
        for number, view in zip(cameras, views, strict=True):
            terms = [name for name in VIEW_TERMS if not (given and name == "detector")]
            total = weights["view_bias"]
            total += sum(weights["view"].get(name, 0.0) * view[name] for name in terms)
            speaks[part.rig.cameras[number].id] = total > 0
        return speaks


def contours(found) -> list[float]:
    """Of an object of a prediction, the share of its contour that each view shows, 0 to 1."""
    return [view["contour"] for view in found.evidence["views"]] if found.evidence else []


def groups_of(count: int) -> list[list[int]]:
    """Which of an exposure's images are looked at together: all, or groups of `MOST_VIEWS`, each
    evenly spread."""
    if count <= MOST_VIEWS:
        return [list(range(count))]
    groups = choices(count, MOST_VIEWS, False)
    return groups[:: -(-len(groups) // MOST_GROUPS)]


def consensus(poses: list[Pose]) -> list[Pose]:
    """Of the poses of each object the one with which most agree, the surest of equals; none where
    half of them or fewer do."""
    left, found = list(poses), []
    while left:
        surest = max(left, key=lambda one: one.confidence)
        same = [one for one in left if one.same_object(surest)]
        left = [one for one in left if not one.same_object(surest)]
        votes = [(sum(map(one.agrees, same)), one.confidence, n) for n, one in enumerate(same)]
        count, _, best = max(votes)
        if 2 * count > len(same):
            found.append(same[best])
    return found


def _boxes(pose: Pose, part: Exposure) -> dict[str, list[float]]:
    found = {}
    for camera in part.rig.cameras:
        box = cut_box(pixels_of(pose.obj.bounds, pose.world_from_obj, camera), camera)
        if box is not None:
            found[camera.id] = box.tolist()
    return found
