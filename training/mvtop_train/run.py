"""From nothing to a trained, exported and evaluated network, in a given time.

    python -m mvtop_train.run --config training/runs/small-gpu.toml --minutes 25

Scenes are rendered by all cores while the network already trains on those that are there. The
training ends when the time is nearly over, its learning rate annealed. Networks with close-ups
learn their poses in a second stage, in `poses/`. A second call goes on where a killed one was. The
run folder gets `bundle/`, `evaluation.json` and all that `train.py` writes.
"""

from pathlib import Path

from .errors import UserError, argument_parser, command
from .training import pipeline, runconfig


@command
def main():
    parser = argument_parser(__doc__)
    runconfig.add_arguments(parser)
    parser.add_argument("--minutes", type=float, help="for everything (those of the config)")
    parser.add_argument("--out", type=Path, help="run folder (runs/<name of the config>)")
    args = parser.parse_args()
    settings = runconfig.load(args.config, args.set)
    minutes = args.minutes or settings.minutes
    if not minutes:
        raise UserError("--minutes: expected a number over 0, got none; fix: --minutes 25")
    pipeline.run(settings, args.out or Path("runs") / args.config.stem, minutes)


if __name__ == "__main__":
    main()
