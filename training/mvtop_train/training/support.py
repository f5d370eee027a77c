"""From which support on an object is believed: chosen on scenes that were not trained on.

    python -m mvtop_train.training.support --bundle models/mine --data data/mine

writes `detector.support_threshold` into a bundle; its networks stay as they are. Takes the held-out
scenes of the training split. What is chosen after it (`deviation`, `prints`, `confidence`) depends
on it: `detector.print_threshold` is taken out. With `--split test` it says what the bundle believes
in another split.
"""

import itertools
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..data import bop
from ..data.objects import Object, read_all
from ..errors import command
from . import heldout

RIGHT = 0.5  # of the diameter: an object that is nearer to a true one of its class is there
VIEWS = 3  # of each scene, at most
# Of F1, what is as good as the best: what little support lets in, print and confidence tell still,
# but what is left out is lost.
AS_GOOD = 0.01


def rig_of(images: list[bop.Image]):
    """The cameras of a scene, and what they show: a rig of `mvtop`, and RGB arrays by camera."""
    import mvtop  # loads its compiled part

    pictures = {str(n): bop.read_rgb(one.path) for n, one in enumerate(images)}
    cameras = []
    for (name, picture), image in zip(pictures.items(), images, strict=True):
        size, pose = picture.shape[1::-1], np.linalg.inv(image.cam_from_world)
        cameras.append(mvtop.Camera(image.k, size, world_from_cam=pose, id=name))
    # A data set says its unit; two of its cameras may be in one housing.
    return mvtop.Rig(cameras, trust_unit=True), pictures


def scenes_of(images: list[bop.Image]) -> list[list[bop.Image]]:
    """The images of each scene."""
    by_folder = itertools.groupby(images, lambda image: image.path.parent.parent)
    return [list(group) for _, group in by_folder]


def found_in(bundle: Path, scenes: list[list[bop.Image]], known: tuple[Object, ...]):
    """[(support, whether there is such an object)] of all that is found, and how many there are."""
    import mvtop

    estimator, by_id = mvtop.Estimator.load(bundle), {obj.id: obj for obj in known}
    found, wanted = [], 0
    for images in tqdm(scenes, unit="scene", desc="support"):
        images = images[:VIEWS]
        rig, pictures = rig_of(images)
        there = []
        for things in bop.sightings(images, by_id):
            one, image = things[0].instances[0], things[0]
            place = np.linalg.inv(image.cam_from_world) @ one.cam_from_obj
            there.append([one.obj_id, place[:3, 3], False])
        wanted += len(there)
        try:
            prediction = estimator.predict(pictures, rig, refine=False)
        except mvtop.Error:  # of a network that has hardly learnt, poses that cannot be
            continue
        for one in prediction.objects:
            if one.support is None:
                continue
            reach = RIGHT * by_id[one.class_id].diameter_m
            away = [
                np.linalg.norm(place - one.world_from_obj[:3, 3]) / reach
                if obj_id == one.class_id and not taken else np.inf
                for obj_id, place, taken in there
            ]  # fmt: skip
            right = bool(away) and min(away) < 1
            if right:
                there[int(np.argmin(away))][2] = True
            found.append((one.support, right))
    return found, wanted


def choose(found: list[tuple[float, bool]], wanted: int) -> float:
    """The least threshold whose F1 of `found_in` is as good as the best; 0 where nothing is."""
    if not found or not wanted:
        return 0.0
    support, right = np.array(sorted(found, reverse=True)).T
    hits = right.cumsum()
    precision, recall = hits / np.arange(1, len(hits) + 1), hits / wanted
    f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-9)
    last = int(np.flatnonzero(f1 >= f1.max() - AS_GOOD)[-1])
    # Between the last that is kept and the first that is not.
    after = support[last + 1] if last + 1 < len(support) else 0.0
    return round(float(support[last] + after) / 2, 3)


@command
def main():
    args = heldout.parser(__doc__, "say what is believed").parse_args()
    scenes, training = heldout.scenes(args), heldout.is_training(args)
    if training:
        heldout.put(args.bundle, "print_threshold", None)
        heldout.put(args.bundle, "support_threshold", 0.0)  # so that all is found
    found, wanted = found_in(args.bundle, scenes, read_all(args.data))
    right = sum(is_right for _, is_right in found)
    print(f"{wanted} objects: {right} found, {len(found) - right} invented")
    if training:
        least = choose(found, wanted)
        heldout.put(args.bundle, "support_threshold", least)
        kept = [is_right for support, is_right in found if support >= least]
        print(f"at {least:g} or more: {sum(kept)} found, {len(kept) - sum(kept)} invented")


if __name__ == "__main__":
    main()
