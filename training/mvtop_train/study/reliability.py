"""How often poses are right that are said to be: of results of `mvtop-cli eval samples --out`.

    mvtop-cli eval samples samples --views 2 --out two.jsonl
    mvtop-cli eval samples samples --views 1 --out one.jsonl
    python -m mvtop_train.study.reliability two.jsonl one.jsonl

Each file, and of several all together: AUROC, expected calibration error, tenths of the poses.
"""

import json
from pathlib import Path

from ..errors import UserError, argument_parser, command
from ..training.confidence import WITHIN_DEG, WITHIN_M, Judged, tell


def read(path: Path) -> list[Judged]:
    """The poses of a file that have a confidence, as they were judged."""
    try:
        rows = [json.loads(line) for line in path.read_text().splitlines()]
        return [
            Judged(
                {}, row["rot_deg"] <= WITHIN_DEG and row["trans_m"] <= WITHIN_M,
                row["confidence"], row["views"], False,
            )
            for row in rows
            if row.get("confidence") is not None
        ]  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"{path}: expected what `mvtop-cli eval samples --out` writes, got "
            f"{type(error).__name__} ({error}); fix: run that first"
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
