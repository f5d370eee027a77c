"""How often poses are right that are said to be: of results of `mvtop-cli eval samples --out`.

    mvtop-cli eval samples samples --views 2 --out two.jsonl
    mvtop-cli eval samples samples --views 1 --out one.jsonl
    mvtop-train reliability two.jsonl one.jsonl

Each file, and of several all together: AUROC, expected calibration error, tenths of the poses.
"""

import json
from pathlib import Path

import numpy as np

from ..errors import UserError, argument_parser, command
from ..files import read_text
from .outcomes import WITHIN_DEG, WITHIN_M
from .statistics import print_reliability


def read(path: Path) -> np.ndarray:
    """[n, 2], confidence and whether it is right, of each pose of a file that has a confidence."""
    fix = "give what `mvtop-cli eval samples --out` writes"
    text = read_text(path, fix)
    try:
        rows = [json.loads(line) for line in text.splitlines()]
        poses = [
            (row["confidence"], row["rot_deg"] <= WITHIN_DEG and row["trans_m"] <= WITHIN_M)
            for row in rows
            if row.get("confidence") is not None
        ]
        return np.array(poses, float).reshape(-1, 2)
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"{path}: expected a line of results for each object, got {type(error).__name__} "
            f"({error}); fix: {fix}"
        ) from None


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("results", type=Path, nargs="+", metavar="FILE.jsonl")
    args = parser.parse_args()
    found = {path: read(path) for path in args.results}
    for path, poses in found.items():
        print_reliability(path.name, *poses.T)
    if len(found) > 1:
        print_reliability("all together", *np.concatenate(list(found.values())).T)


if __name__ == "__main__":
    main()
