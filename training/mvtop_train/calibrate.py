"""Fit what a bundle stores about its own poses, on scenes that its training left out.

    mvtop-train calibrate --bundle models/mine --data data/mine
    mvtop-train calibrate --bundle models/mine --data data/mine --split test

The first writes the weights of the confidence, the limits of a true rig and the least confidence of
an object into `model.json`; with --weights also the detector's thresholds. The second changes
nothing: it says how reliable confidences are on another split, by number of views. See
docs/how-to/train.md.
"""

from pathlib import Path

import numpy as np

from . import description
from .data import bop, objects
from .data.search import Searches
from .errors import UserError, command
from .evaluation import statistics
from .training import calibrate, checkpoint, evidence, heldout, thresholds


def detector_of(args, scenes: list[list[bop.Image]], known) -> dict:
    """Thresholds for the bundle's detector; none without --weights."""
    if args.weights is None:
        return {}
    model, config, steps = checkpoint.load_weights(args.weights)
    expected = description.read(args.bundle).get("provenance", {}).get("trained_steps")
    if steps != expected:
        raise UserError(
            f"{args.weights}: expected weights of {expected} steps, as the bundle's, got {steps}; "
            "fix: the weights that the bundle was exported from"
        )
    images = [image for scene in scenes for image in scene]
    found = thresholds.choose(model, images, Searches(config, known))
    print(found)
    return found.settings()


def fit(args):
    scenes, known = heldout.scenes(args), objects.read_all(args.data)
    detector = detector_of(args, scenes, known)
    if not calibrate.calibrate(args.bundle, scenes, known, detector):
        raise UserError(
            f"{args.bundle}: {calibrate.TOO_FEW}; fix: more scenes (--held-out), or train for "
            "longer; the bundle is as it was"
        )
    about = description.read(args.bundle)
    print(f"{args.bundle}: calibrated; settings {about['inference']}")


def show(args):
    """Prints how reliable confidences are, and how many true rigs are doubted."""
    if "scorer" not in description.read(args.bundle):
        raise UserError(
            f"{args.bundle}: expected a calibrated bundle, got one without `scorer`; fix: the same "
            "command without --split"
        )
    scenes, known = heldout.scenes(args), objects.read_all(args.data)
    found = evidence.gathered(args.bundle, scenes, known, args.split, disturbed=0, change=False)
    for views in evidence.VIEWS:
        poses = [one for one in found.poses if one.images == views]
        confidence = np.array([one.confidence for one in poses], float)
        right = np.array([one.right for one in poses], bool)
        statistics.print_reliability(f"{views} views", confidence, right)
    doubted = sum(rig.deviation > 1 for rig in found.rigs)
    print(f"rigs that are doubted, though true: {doubted} of {len(found.rigs)}")


@command
def main():
    parser = heldout.parser(__doc__, "say how reliable confidences are")
    parser.add_argument(
        "--weights", type=Path, help="of the bundle's run: choose the detector's thresholds as well"
    )
    args = parser.parse_args()
    if heldout.is_training(args):
        fit(args)
    else:
        show(args)


if __name__ == "__main__":
    main()
