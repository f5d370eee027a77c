"""How far views may be apart before a calibration is doubted: chosen on scenes not trained on.

    python -m mvtop_train.training.deviation --bundle models/mine --data data/mine

writes `detector.most_deviation` into a bundle that was exported without; its networks stay as they
are. Takes the held-out scenes of the training split, whose calibrations are true. With `--split
test` it counts which groups of views of another split are warned of: all are false alarms.
"""

from collections import Counter
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..data import bop
from ..errors import command
from . import heldout, support

# Of groups of views with a true calibration: images of other looks are warned of more often.
ALARMS = 0.01
VIEWS = (2, 3)  # in a group


def groups_of(scenes: list[list[bop.Image]]) -> list[list[bop.Image]]:
    """The images of each scene in groups of two, and again of three, one after the other."""
    return [
        images[start : start + views]
        for images in scenes
        for views in VIEWS
        for start in range(0, len(images) - views + 1, views)
    ]


def predictions(bundle: Path, scenes: list[list[bop.Image]]):
    """Of each group of views, and how many views these are."""
    import mvtop

    estimator = mvtop.Estimator.load(bundle)
    for images in tqdm(groups_of(scenes), unit="group", desc="deviations"):
        rig, pictures = support.rig_of(images)
        try:
            prediction = estimator.predict(pictures, rig)
        except mvtop.Error:  # of a network that has hardly learnt, poses that cannot be
            continue
        yield prediction, len(images)


def found_in(bundle: Path, scenes: list[list[bop.Image]]) -> list[float]:
    """Of each group of views, how far these are apart; 0 where no object is seen by two of them."""
    fits = (prediction.rig_consistency for prediction, _ in predictions(bundle, scenes))
    return [0.0 if fit is None else fit.deviation for fit in fits]


def choose(found: list[float]) -> float | None:
    """What at most a hundredth of the groups exceed; None where there are fewer than 20."""
    if len(found) < 20:
        return None
    kept = sorted(found)[: len(found) - int(ALARMS * len(found))]
    return float(np.ceil(max(kept[-1], 0.1) * 100) / 100)


@command
def main():
    args = heldout.parser(__doc__, "count false alarms").parse_args()
    scenes, training = heldout.scenes(args), heldout.is_training(args)
    if not training:
        count, alarms = Counter(), Counter()
        for prediction, views in predictions(args.bundle, scenes):
            count[views] += 1
            alarms.update((views, warning.code) for warning in prediction.warnings)
            alarms[views, "any"] += bool(prediction.warnings)
        for views, groups in count.items():
            told = {code: alarms[key] for key in alarms if (code := key[1]) and key[0] == views}
            print(f"{views} views: {groups} groups, warned of: {told}")
        return
    found = found_in(args.bundle, scenes)
    most = choose(found)
    print(f"{len(found)} groups, most deviation: {most}")
    if most is not None:
        heldout.put(args.bundle, "most_deviation", most)


if __name__ == "__main__":
    main()
