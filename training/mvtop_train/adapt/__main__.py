"""Adapt a network to its user's own cell, from photographs without labels.

    mvtop-train adapt --model runs/mine/bundle --rig rig.json --images photos/ \\
        --minutes 20 --out runs/mine-adapted

Photographs are `photos/EXPOSURE/CAMERA.png`, or scenes in BOP layout without --rig. Poses that are
sure are learnt from, beside rendered scenes; --out gets `bundle/`, `accepted.html` with pictures of
what was learnt from, and `accepted.txt`, in which lines can be struck out for the next call. See
docs/tutorials/your-photographs.md.
"""

from pathlib import Path

from ..errors import UserError, argument_parser, command
from . import learn, rounds


def options_of(args) -> rounds.Options:
    """UserError where one of them cannot be."""
    for name, value, least, most in (
        ("minutes", args.minutes, 0, 1e5), ("min-confidence", args.min_confidence, 0, 1),
    ):  # fmt: skip
        if not least < value < most:
            raise UserError(
                f"--{name}: expected a number over {least} and below {most:g}, got {value:g}; "
                "fix: leave it out"
            )
    if args.min_views < 2:
        raise UserError(
            f"--min-views: expected at least 2, got {args.min_views}; fix: 3, or 2 of two cameras"
        )
    return rounds.Options(
        args.images, args.rig, args.out, args.minutes, args.min_confidence, args.min_views,
        args.only_show, args.force,
    )  # fmt: skip


@command
def main():
    parser = argument_parser(__doc__)
    add = parser.add_argument
    add("--model", type=Path, required=True, metavar="BUNDLE", help="calibrated bundle")
    add("--images", type=Path, required=True, metavar="DIR", help="photographs, see above")
    add("--rig", type=Path, help="rig.json of the cameras; not of scenes in BOP layout")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of this run")
    add("--minutes", type=float, default=20.0, help="for everything")
    add("--min-confidence", type=float, default=0.9, metavar="P", help="of an accepted pose")
    add("--min-views", type=int, default=3, metavar="N", help="that speak for an accepted pose")
    add("--only-show", action="store_true", help="stop after writing accepted.html")
    add("--force", action="store_true", help="replace a bundle that is in --out")
    made = parser.add_argument_group("how the bundle was made; of one by `run` that is known")
    add = made.add_argument
    add("--data", help="rendered scenes of its objects, split `train`, in BOP layout")
    add("--held-out", type=int, metavar="N", help="first scenes of these, not trained on")
    add("--weights", type=Path, help="that it was exported from; read out of it if left out")
    add("--backgrounds", help="folder of pictures to put behind and before the objects")
    add("--set", action="append", default=[], metavar="KEY=VALUE", help="of a run's config")
    args = parser.parse_args()
    options = options_of(args)
    asked = {
        "data": args.data, "held_out": args.held_out, "backgrounds": args.backgrounds,
        "minutes": args.minutes,
    }  # fmt: skip
    rounds.run(learn.source_of(args.model, args.weights, asked, args.set), options)


if __name__ == "__main__":
    main()
