"""From nothing to a trained, exported and evaluated network, in a given time.

    mvtop-train run --mesh box.obj --mesh can.obj --mesh-unit mm --rig rig.json \\
        --backgrounds photos/ --minutes 180 --out runs/mine
    mvtop-train run --config small-gpu --minutes 25

Scenes are rendered by all cores while the network already trains on those that are there. The
training ends when the time is nearly over, its learning rate annealed. Networks that decode
poses from close-ups learn these in a second stage, in `poses/`. A second call goes on where a
killed one was. The run folder gets `bundle/`, `evaluation.json` or of preset `lite` and of your own
parts `report/`, and all that `train.py` writes. See docs/tutorials/your-own-part.md.
"""

import math

from . import shipped
from .data.meshfile import UNITS
from .errors import UserError, argument_parser, command
from .synthesis import cad
from .training import own_parts, pipeline, runconfig

OWN = ("mesh", "name", "id", "rig")  # options that may be given several times
ONCE = ("mesh_unit", "instances", "backgrounds")


def duration(text: str) -> float:
    try:
        minutes = float(text)
    except ValueError:
        minutes = math.nan
    if not 0 < minutes < math.inf:
        raise UserError(f"--minutes: expected a number over 0, got {text}; fix: --minutes 30")
    return minutes


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


def of_parts(args) -> runconfig.RunConfig:
    """The config that the options for one's own parts stand for."""
    unit = () if all(map(cad.is_step, args.mesh)) else ("mesh_unit",)
    for name in (*unit, "out", "minutes"):
        if not getattr(args, name):
            raise UserError(f"{_option(name)}: expected with --mesh, got none; fix: add it")
    generate = {name: tuple(getattr(args, name) or ()) for name in OWN}
    instances = 1 if args.instances is None else args.instances
    generate |= {"mesh_unit": args.mesh_unit or "", "instances": instances}
    generate["rig"] = tuple(str(shipped.rig(path)) for path in generate["rig"])
    return own_parts.config(args.out, args.minutes, generate, args.backgrounds or "", args.set)


@command
def main():
    parser = argument_parser(__doc__, shipped.ConfigParser)
    parser.add_argument("--minutes", type=duration, help="for everything (those of the config)")
    own = parser.add_argument_group("your own parts, instead of --config (see generate --help)")
    own.add_argument("--mesh", action="append", help="obj, stl, ply or step; once for each part")
    own.add_argument("--mesh-unit", choices=UNITS, help="of the meshes; step files state theirs")
    own.add_argument("--name", action="append", help="of each part")
    own.add_argument("--id", action="append", type=int, help="of each part")
    own.add_argument(
        "--rig", action="append", help="rig.json, or a name of `list`; any rig if left out"
    )
    own.add_argument("--instances", type=int, help="of each part in a scene, at most")
    own.add_argument("--backgrounds", help="folder of pictures, best of the empty cell")
    args, settings, folder = runconfig.parse(parser, of_parts)
    for name in (*OWN, *ONCE) if args.config else ():
        if getattr(args, name) is not None:
            raise UserError(
                f"{_option(name)}: expected with --mesh, got it with --config; fix: leave it out, "
                "and write it into the config"
            )
    minutes = args.minutes or settings.minutes
    if not minutes:
        raise UserError("--minutes: expected a number over 0, got none; fix: --minutes 25")
    pipeline.run(settings, folder, minutes)


if __name__ == "__main__":
    main()
