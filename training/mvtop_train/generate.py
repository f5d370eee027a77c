"""Generate scenes in BOP layout: MV-ball, or your own part through your own rig.

    mvtop-train generate --out data/mvball --scenes 3000 --seed 1 --workers 2
    mvtop-train generate --out data/mvball --paper --split train easy hard
    mvtop-train generate --out data/part --mesh part.obj --mesh-unit mm --rig rig.json

Every scene is drawn from (seed, split, scene number) alone, so that a run can be stopped, split
into shards and resumed without changing the data. Scenes that are whole are left as they are. See
docs/how-to/data-sets.md.
"""

import dataclasses
import os

from . import shipped
from .data.meshfile import UNITS
from .errors import UserError, argument_parser, command
from .synthesis import generate
from .synthesis.recipe import SPLITS


def parse_shard(text: str) -> tuple[int, int]:
    try:
        shard, shards = (int(part) for part in text.split("/"))
    except ValueError:
        shard, shards = -1, 0
    if not 0 <= shard < shards:
        raise UserError(f"--shard: expected I/N with 0 <= I < N, got {text!r}; fix: 0/4, 1/4, ...")
    return shard, shards


# Least and greatest numbers of the options.
BOUNDS = {
    "scenes": (1, 10**6), "images": (1, 10**7), "views": (1, 1000), "workers": (1, 1000),
    "width": (1, 2**14), "instances": (1, 100), "seed": (0, 2**32 - 1),
}  # fmt: skip


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--out", default="data/mvball", help="dataset folder")
    parser.add_argument("--split", choices=SPLITS, default=["train"], nargs="+")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--scenes", type=int, default=3000)
    size.add_argument("--images", type=int, help="as many images, instead of scenes")
    size.add_argument("--paper", action="store_true", help="as many images as the paper's split")
    parser.add_argument(
        "--views",
        type=int,
        default=6,
        help="images per scene of MV-ball; with --mesh each camera that sees a part gives one",
    )
    parser.add_argument(
        "--window", type=int, metavar="PX", help="render only a window around the ball (faster)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--shard", default="0/1", metavar="I/N", help="do scenes I, I+N, ...")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    own = parser.add_argument_group("your own part")
    own.add_argument("--mesh", action="append", help="obj, stl, ply or step; once for each part")
    own.add_argument("--mesh-unit", choices=UNITS, help="of the meshes; step files state theirs")
    own.add_argument("--name", action="append", help="of each part; its file's name if left out")
    own.add_argument(
        "--id",
        action="append",
        type=int,
        help="of each part; that of obj_000002.ply is 2 if left out, of others the next free ones",
    )
    own.add_argument(
        "--rig",
        action="append",
        help="rig.json, or a name of `list`: the cameras that will look at the parts; "
        "of several, each scene has one at random; any rig if left out",
    )
    own.add_argument("--instances", type=int, default=1, help="of each part in a scene, at most")
    own.add_argument("--backgrounds", help="folder of pictures to lay on floors and other things")
    own.add_argument("--width", type=int, default=640, help="of the images at most, px")
    args = parser.parse_args()
    shard, shards = parse_shard(args.shard)
    for option, (least, most) in BOUNDS.items():
        given = getattr(args, option)
        if given is not None and not least <= given <= most:
            raise UserError(
                f"--{option}: expected {least} to {most}, got {given}; fix: leave it out"
            )
    args.rig = [str(shipped.rig(path)) for path in args.rig or ()]
    recipe, work = generate.prepare(args)
    try:
        for split in args.split:
            generate.make_split(dataclasses.replace(recipe, split=split), work, args, shard, shards)
    except KeyboardInterrupt:
        raise SystemExit("stopped; the same command goes on from here") from None


if __name__ == "__main__":
    main()
