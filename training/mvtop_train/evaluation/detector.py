"""How often the detector finds what single images show, before any pose.

    mvtop-train detector --model models/ycbv4 --out out/detector.json
    mvtop-train detector --model runs/mine/bundle --data runs/mine/data

Takes the test sets that ask for the model's objects (`evaluation/sets.py`), or a data set in BOP
layout, image by image, as they are and under conditions (`evaluation/conditions.py`). An object
counts where at least half of it is in sight. It is found by a box of its class with an IoU of at
least 0.5, the bound by which the bundle's thresholds are chosen: with less the box tells another
size than association accepts. `near` also counts boxes that only have their middle in the true one.
"""

import datetime
import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from ..errors import UserError, argument_parser, command
from ..files import write_text
from .accuracy import cell, lined_up
from .boxes import Detector, Visible
from .conditions import NAMES, Shown, pictures
from .groups import Group, Planned, classes_of
from .matching import assigned
from .running import commit, digest, machine
from .sets import CLASSES, TestSet, single_views

FORMAT = 1
PLAIN_SIGHT = 0.5  # share of an object in sight, from which on it counts
FALSE_PER_IMAGE = 1.0  # of the second threshold
COLUMNS = (
    ("images", "images", "{}"),
    ("objects", "objects", "{}"),
    ("recall", "recall", "{:.3f}"),
    ("near", "near", "{:.3f}"),
    ("false_per_image", "false/image", "{:.2f}"),
    ("recall_at_one", "recall at 1", "{:.3f}"),
    ("threshold_at_one", "its score", "{:.2f}"),
)


def looked_at(detector: Detector, shown: Shown, there: list[Visible], asked: set[str]) -> dict:
    """What the detector makes of a picture.

    - there: what the image shows that the picture is of
    - asked: names of the classes that count

    returns: `objects`, of each that counts the class, the `score` of the box that finds it and the
    best score of a box that is `near`, 0 where there is none; `false`, scores of other boxes
    """
    height, width = shown.rgb.shape[:2]
    end = np.array([width, height] * 2) - 0.5
    boxes, kinds = [], []
    for number, one in enumerate(there):
        moved = shown.box(one.box)
        cut = moved.clip(-0.5, end)
        if (cut[2:] - cut[:2]).min() <= 0:
            continue
        share = one.share * np.prod(cut[2:] - cut[:2]) / np.prod(moved[2:] - moved[:2])
        counts = share >= PLAIN_SIGHT and shown.about in (None, number)
        boxes.append(cut)
        kinds.append(one.kind if counts else -1)
    true_boxes = torch.tensor(np.array(boxes).reshape(-1, 4)).float()
    found, scores, classes = detector(shown.rgb)
    kept = torch.tensor([detector.names[n] in asked for n in classes.tolist()], dtype=torch.bool)
    found, scores, classes = found[kept], scores[kept], classes[kept]
    owners = assigned(found, scores, classes, true_boxes, torch.tensor(kinds, dtype=torch.long))
    by_object = {owner: float(scores[n]) for n, owner in owners if owner is not None}
    middles = (found[:, :2] + found[:, 2:]) / 2
    objects = []
    for number, (box, kind) in enumerate(zip(true_boxes, kinds, strict=True)):
        if kind < 0:
            continue
        inside = ((middles >= box[:2]) & (middles <= box[2:])).all(1) & (classes == kind)
        near = float(scores[inside].max()) if inside.any() else 0.0
        score = by_object.get(number, 0.0)
        objects.append({
            "class": detector.names[kind], "score": round(score, 4),
            "near": round(max(near, score), 4),
        })  # fmt: skip
    false = [round(float(scores[n]), 4) for n, owner in owners if owner is None]
    return {"objects": objects, "false": false}


def measured(
    detector: Detector, groups: Iterable[Group], conditions: Iterable[str] = NAMES
) -> dict[str, list[dict]]:
    """By condition what the detector makes of each picture (`looked_at`), and of which image."""
    found = {name: [] for name in conditions}
    for group in groups:
        for camera in group.rig.cameras:
            there = detector.truth(group, camera)
            boxes = [one.box for one in there]
            for name, pictures_ in found.items():
                for shown in pictures(name, group.images[camera.id], boxes):
                    told = looked_at(detector, shown, there, set(group.asked))
                    pictures_.append({"image": f"{group.name}/{camera.id}", **told})
    return found


def summary(pictures_: list[dict], threshold: float) -> dict:
    """Recall at the bundle's own threshold, and at `FALSE_PER_IMAGE`; None where nothing counts."""
    objects = [one for picture in pictures_ for one in picture["objects"]]
    false = np.array([score for picture in pictures_ for score in picture["false"]])
    at_one = score_at(false, int(FALSE_PER_IMAGE * len(pictures_)))

    def recall(key: str, least: float, name: str | None = None) -> float | None:
        scores = [one[key] for one in objects if name in (None, one["class"])]
        right = [score > 0 and score >= least for score in scores]
        return float(np.mean(right)) if right else None

    return {
        "images": len(pictures_),
        "objects": len(objects),
        "recall": recall("score", threshold),
        "near": recall("near", threshold),
        "false_per_image": float((false >= threshold).sum() / max(len(pictures_), 1)),
        "recall_at_one": recall("score", at_one),
        "threshold_at_one": at_one,
        "by_class": {
            name: {
                "objects": sum(one["class"] == name for one in objects),
                "recall": recall("score", threshold, name),
                "near": recall("near", threshold, name),
                "recall_at_one": recall("score", at_one, name),
            }
            for name in sorted({one["class"] for one in objects})
        },
    }


def score_at(false: np.ndarray, count: int) -> float:
    """The least score at which at most so many of the false boxes [n] are left; 0 where there are
    no more."""
    if len(false) <= count:
        return 0.0
    return float(np.nextafter(np.sort(false)[::-1][count], 1))


def table(summaries: dict[str, dict]) -> str:
    """A row for each condition: of all objects, then of each class recall and `near`.

    - summaries: by condition
    """
    names = sorted({name for one in summaries.values() for name in one["by_class"]})
    rows = [["", *(title for _, title, _ in COLUMNS), *(f"{x} (near)" for x in names)]]
    for condition, one in summaries.items():
        cells = [cell(form, one[key]) for key, _, form in COLUMNS]
        for name in names:
            of = one["by_class"].get(name, {"recall": None, "near": None})
            cells.append(f"{cell('{:.3f}', of['recall'])} ({cell('{:.3f}', of['near'])})")
        rows.append([condition, *cells])
    return lined_up(rows)


def chosen(args, classes) -> list[TestSet]:
    """The sets that are named, or `--data`, or those that ask for the bundle's objects."""
    if args.data:
        return [TestSet(str(args.data), "", 1, (args.data,), bop=True)]
    sets = single_views()
    if args.set:
        return [sets[name] for name in dict.fromkeys(args.set)]
    found = [one for one in sets.values() if one.usual and CLASSES[one.model] <= set(classes)]
    if not found:
        raise UserError(
            f"{args.model}: expected the objects of a test set, got {', '.join(sorted(classes))}; "
            "fix: --data DIR, a data set of these with a split `test`"
        )
    return found


def loaded(planned: list[Planned], name: str) -> Iterable[Group]:
    """The groups one after the other."""
    for plan in tqdm(planned, unit="group", desc=name):
        yield plan.load()


@command
def main():
    parser = argument_parser(__doc__)
    add = parser.add_argument
    add("--model", type=Path, required=True, metavar="BUNDLE", help="folder of model.json")
    add("--set", action="append", choices=list(single_views()), help="these alone; once for each")
    add("--data", type=Path, metavar="DIR", help="a data set in BOP layout, of its split `test`")
    add("--condition", action="append", choices=NAMES, help="these alone; once for each")
    add("--limit", type=int, metavar="N", help="groups of each set, at most")
    add("--out", type=Path, metavar="FILE", help="JSON with every score")
    args = parser.parse_args()
    if args.limit is not None and args.limit < 1:
        raise UserError(f"--limit: expected at least 1, got {args.limit}; fix: leave it out")
    if args.data and args.set:
        raise UserError("--data: expected alone, got it with --set; fix: leave one of them out")
    if args.out and args.out.exists():
        raise UserError(f"{args.out}: expected no such file, got one; fix: another --out")
    detector, classes = Detector(args.model), classes_of(args.model)
    results = {
        "format": FORMAT, "machine": machine(), "commit": commit(),
        "date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        "model": str(args.model), "bundle": digest(args.model), "threshold": detector.threshold,
        "sets": {},
    }  # fmt: skip
    for one in chosen(args, classes):
        if (why := one.missing(args.limit)) is not None:
            print(f"{one.name}: left out: {why}")
            continue
        planned = one.planned(classes, args.limit)
        found = measured(detector, loaded(planned, one.name), args.condition or NAMES)
        told = {name: summary(of, detector.threshold) for name, of in found.items()}
        results["sets"][one.name] = {"summary": told, "pictures": found}
        print(f"{one.name}, boxes from a score of {detector.threshold:g}\n{table(told)}\n")
    if not results["sets"]:
        raise UserError("no set could be taken: expected test data, got none; fix: --data DIR")
    if args.out:
        write_text(args.out, json.dumps(results) + "\n")


if __name__ == "__main__":
    main()
