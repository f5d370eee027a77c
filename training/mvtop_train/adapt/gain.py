"""What was gained on exposures that were held out, with accepted poses as the truth."""

from pathlib import Path

import numpy as np

from ..data import objects
from ..evaluation import detector as yardstick
from ..evaluation.boxes import Detector
from ..evaluation.groups import Group, Truth
from ..evaluation.outcomes import matches, outcome
from .accept import Judge, Pose, consensus, contours, groups_of
from .exposures import Exposure

PAIR = 2  # views, where finding objects is hard
ROWS = (
    ("detector", "boxes found, of objects in sight"),
    ("detector_near", "the same, roughly"),
    ("found_2", "objects found with two views"),
    ("right_2", "right with two views"),
    ("found", "objects found with all views"),
    ("right", "right with all views"),
    ("contour", "share of their contours that images show"),
)


def truth_of(
    judges: list[Judge], held: list[Exposure], accepted: dict[str, list[Pose]], struck: list[Pose]
) -> dict[str, list[Pose]]:
    """By exposure the poses that all judges together accept there.

    - accepted: of the exposures that were learnt from: of one in several parts these hold
    - struck: poses that a person has struck out
    """
    found = {}
    for one in held:
        there = accepted.get(one.name) or []
        if not there:
            there = consensus([pose for judge in judges for pose in judge.poses(one)[0]])
        found[one.name] = [x for x in there if not any(map(x.same_object, struck))]
    return found


def measured(judge: Judge, bundle: Path, held: list[Exposure], truth: dict[str, list[Pose]]):
    """Shares by key of `ROWS`, None of nothing, and `objects`, how many there are."""
    boxes = Detector(bundle)
    groups = [_group(one, truth[one.name]) for one in held if truth[one.name]]
    looks = yardstick.measured(boxes, groups, ["plain"])["plain"]
    told = yardstick.summary(looks, boxes.threshold)
    result = {"detector": told["recall"], "detector_near": told["near"], "views": told["objects"]}
    for suffix, views in (("_2", PAIR), ("", 0)):
        outcomes, shown = [], []
        for one in held:
            for numbers in _parts(len(one.paths), views):
                part = one.part(numbers)
                group = _group(part, truth[one.name])
                if not group.truth:
                    continue
                prediction = judge.predicted(part, group.images)
                outcomes += outcome(group, prediction or ValueError("none"))["objects"]
                found = prediction.objects if prediction else []
                for place in matches(group.truth, found):
                    if place is not None:
                        shown += contours(found[place])
        result["found" + suffix] = _share([one["found"] for one in outcomes])
        result["right" + suffix] = _share([one["right"] for one in outcomes])
        result["objects" + suffix] = len(outcomes)
    return result | {"contour": _share(shown)}


def table(before: dict, after: dict) -> str:
    """Both beside each other."""
    rows = [["held out", "before", "after"]]
    for key, title in ROWS:
        shown = ("-" if x[key] is None else f"{100 * x[key]:.0f} %" for x in (before, after))
        rows.append([title, *shown])
    return yardstick.lined_up(rows)


def _share(values: list) -> float | None:
    return float(np.mean(values)) if values else None


def _parts(count: int, views: int) -> list[list[int]]:
    """Groups of an exposure's images: of so many views, evenly spread; 0: as for acceptance."""
    if not views:
        return groups_of(count)
    half = -(-count // views)
    return [list(range(start, count, half))[:views] for start in range(count // views)]


def _group(exposure: Exposure, truth: list[Pose]) -> Group:
    """As the yardsticks take it; what an image does not show is not asked of it."""
    there = []
    for pose in truth:
        (known,) = objects.classes_of(pose.obj)
        cameras = dict.fromkeys(camera.id for camera in exposure.rig.cameras)
        there.append(Truth(known, pose.world_from_obj, cameras))
    asked = frozenset(one.known.name for one in there)
    name = exposure.name
    return Group(name, name, exposure.rig, exposure.images(), tuple(there), asked)
