"""Train a network as a config file says; resumes by itself from the run folder.

    mvtop-train train --config small-cpu
    torchrun --nproc_per_node 2 -m mvtop_train.train --config small-gpu

Writes `last.pt` (weights, their moving average, optimiser, step), `weights.pt` (the average, half
precision), `log.jsonl`, TensorBoard's files and the config to the run folder. See
docs/how-to/train.md.
"""

from . import shipped
from .errors import argument_parser, command
from .training import loop, runconfig


@command
def main():
    _, settings, folder = runconfig.parse(argument_parser(__doc__, shipped.ConfigParser))
    loop.train(settings, folder)


if __name__ == "__main__":
    main()
