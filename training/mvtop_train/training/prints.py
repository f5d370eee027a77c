"""How far images must look like what is printed on an object that is believed: chosen on scenes
not trained on.

    python -m mvtop_train.training.prints --bundle models/mine --data data/mine

writes `detector.print_threshold` into a bundle; its networks stay as they are. Takes the held-out
scenes of the training split. With `--split test` it says what the bundle keeps in another split.
"""

from pathlib import Path

from ..data import objects
from ..errors import command
from . import confidence, heldout
from .confidence import Judged

LOST = 0.01  # of the poses that are right: images of other looks reach less than rendered ones
FEWEST = 50  # of these


def likeness(one: Judged) -> float | None:
    """None where nothing is printed on it."""
    return one.evidence["print"] or None


def choose(found: list[Judged]) -> float | None:
    """What a hundredth of the right poses do not reach; None where there are too few."""
    right = sorted(alike for one in found if one.right and (alike := likeness(one)) is not None)
    return round(right[int(LOST * len(right))], 3) if len(right) >= FEWEST else None


def kept(found: list[Judged], least: float | None) -> list[Judged]:
    if least is None:
        return found
    return [one for one in found if (alike := likeness(one)) is None or alike >= least]


def add(bundle: Path, least: float | None):
    """Writes it into the bundle's description; None takes it out."""
    heldout.put(bundle, "print_threshold", least)


def tell(name: str, found: list[Judged]):
    for views in confidence.VIEWS:
        those = [one for one in found if one.views == views]
        right = sum(one.right for one in those)
        print(f"{name}, {views} views: {right} right poses, {len(those) - right} others")


@command
def main():
    args = heldout.parser(__doc__, "say what is kept").parse_args()
    scenes, training = heldout.scenes(args), heldout.is_training(args)
    if training:
        add(args.bundle, None)
    found = confidence.judged(args.bundle, scenes, objects.read_all(args.data), 0.0)
    tell("all that are found", found)
    if not training:
        return
    least = choose(found)
    add(args.bundle, least)
    if least is None:
        print(f"fewer than {FEWEST} right poses of printed objects: no threshold")
    else:
        tell(f"at {least:g} or more", kept(found, least))


if __name__ == "__main__":
    main()
