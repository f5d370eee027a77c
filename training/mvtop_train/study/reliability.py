"""How often poses are right that are said to be: of results of `mvtop-cli eval samples --out`.

    mvtop-cli eval samples samples --views 2 --out two.jsonl
    mvtop-cli eval samples samples --views 1 --out one.jsonl
    python -m mvtop_train.study.reliability two.jsonl one.jsonl

Each file, and of several all together: AUROC, expected calibration error, tenths of the poses.
"""

import json
from pathlib import Path

from ..errors import UserError, argument_parser, command
from ..files import read_text
from ..training.confidence import WITHIN_DEG, WITHIN_M, Judged, tell


def read(path: Path) -> list[Judged]:
    """The poses of a file that have a confidence, as they were judged."""
    fix = "give what `mvtop-cli eval samples --out` writes"
    text = read_text(path, fix)
    try:
        rows = [json.loads(line) for line in text.splitlines()]
        return [
            Judged(
                {}, row["rot_deg"] <= WITHIN_DEG and row["trans_m"] <= WITHIN_M,
                row["confidence"], row["views"], False,
            )
            for row in rows
            if row.get("confidence") is not None
        ]  # fmt: skip
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
        tell(path.name, poses)
    if len(found) > 1:
        tell("all together", [one for poses in found.values() for one in poses])


if __name__ == "__main__":
    main()
