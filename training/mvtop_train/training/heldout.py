"""The scenes that a training left out, and the arguments of a command that asks for them."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from ..data import batches, bop
from ..errors import argument_parser


def parser(doc: str, of_another: str) -> ArgumentParser:
    """- of_another: what is done with another split than the training's"""
    parser = argument_parser(doc)
    add = parser.add_argument
    add("--bundle", type=Path, required=True, help="folder of model.json")
    add_data(parser)
    add("--split", default="train", help=f"another one: only {of_another}")
    return parser


def add_data(parser: ArgumentParser):
    add = parser.add_argument
    add("--data", type=Path, required=True, help="data set that it was trained on")
    add("--held-out", type=int, default=100, help="first scenes, not trained on")


def is_training(args: Namespace) -> bool:
    """Whether there is something to choose: of other splits it is only told how that does."""
    return args.split == "train"


def scenes(args: Namespace) -> list[list[bop.Image]]:
    """Images of the scenes that were held out, or of all of another split."""
    return of_split(args.data, args.split, args.held_out if is_training(args) else None)


def of_split(data: Path, split: str, most: int | None) -> list[list[bop.Image]]:
    """Images of the first scenes of a split, at most so many."""
    folders = bop.whole_scenes(data / split)
    if not folders:
        bop.refuse_empty(data, split)
    if most is not None and (fewer := batches.held_count(len(folders), most)) < most:
        print(
            f"note: of these {len(folders)} scenes a training with held_out = {most} leaves out "
            f"{fewer}; if one was trained on them, give --held-out {fewer}"
        )
    folders = folders[:most]
    return [bop.read_images(folder) for folder in folders]
