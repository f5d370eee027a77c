"""Arguments of studies that disturb samples, as `mvtop-cli eval samples` reads them."""

from argparse import Namespace
from pathlib import Path

from ..errors import argument_parser
from .samples import folders


def arguments(doc: str, of_seed: str) -> tuple[Namespace, list[Path]]:
    """The arguments, and the folders of the samples.

    - of_seed: what the seed draws
    """
    parser = argument_parser(doc)
    add = parser.add_argument
    add("--samples", type=Path, required=True, help="folder of samples")
    add("--model", type=Path, default=Path("models/mvball"))
    add("--count", type=int, help="samples to use, the first ones")
    add("--seed", type=int, default=0, help=f"of the {of_seed}")
    add("--out", type=Path, required=True, help="file of JSON Lines")
    args = parser.parse_args()
    return args, folders(args.samples)[: args.count]
