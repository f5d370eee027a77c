"""How far views may be apart before a calibration is doubted: chosen on scenes not trained on.

    python -m mvtop_train.training.deviation --bundle models/mine --data data/mine

writes `detector.most_deviation` into a bundle that was exported without; its networks stay as they
are. Takes the held-out scenes of the training split, whose calibrations are true.
"""

import json
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..data import bop
from ..errors import argument_parser, command
from . import support

ALARMS = 0.01  # of groups of views with a true calibration
VIEWS = (2, 3)  # in a group


def groups_of(scenes: list[list[bop.Image]]) -> list[list[bop.Image]]:
    """The images of each scene in groups of two, and again of three, one after the other."""
    return [
        images[start : start + views]
        for images in scenes
        for views in VIEWS
        for start in range(0, len(images) - views + 1, views)
    ]


def found_in(bundle: Path, scenes: list[list[bop.Image]]) -> list[float]:
    """Of each group of views, how far these are apart; 0 where no object is seen by two of them."""
    import mvtop

    estimator, found = mvtop.Estimator.load(bundle), []
    for images in tqdm(groups_of(scenes), unit="group", desc="deviations"):
        rig, pictures = support.rig_of(images)
        fit = estimator.predict(pictures, rig).rig_consistency
        found.append(0.0 if fit is None else fit.deviation)
    return found


def choose(found: list[float]) -> float | None:
    """What at most a hundredth of the groups exceed; None where there are fewer than 20."""
    if len(found) < 20:
        return None
    kept = sorted(found)[: len(found) - int(ALARMS * len(found))]
    return float(np.ceil(max(kept[-1], 0.1) * 100) / 100)


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--bundle", type=Path, required=True, help="folder of model.json")
    parser.add_argument("--data", type=Path, required=True, help="data set that it was trained on")
    parser.add_argument("--held-out", type=int, default=100, help="first scenes, not trained on")
    args = parser.parse_args()
    folders = bop.whole_scenes(args.data / "train")[: args.held_out]
    if not folders:
        bop.refuse_empty(args.data, "train")
    found = found_in(args.bundle, [bop.read_images(folder) for folder in folders])
    most = choose(found)
    print(f"{len(found)} groups, most deviation: {most}")
    if most is not None:
        path = args.bundle / "model.json"
        description = json.loads(path.read_text())
        description["detector"]["most_deviation"] = most
        path.write_text(json.dumps(description, indent=1) + "\n")


if __name__ == "__main__":
    main()
