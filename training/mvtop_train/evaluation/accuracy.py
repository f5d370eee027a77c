"""How accurate poses are on fixed test sets, and whether one run is better than another.

    mvtop-train accuracy run --out out/accuracy.json
    mvtop-train accuracy show out/accuracy.json
    mvtop-train accuracy compare before.json after.json --fail-if-worse

`run` predicts every group of the sets that are there (`evaluation/sets.py`), makes those that can
be made, and goes on with a file that a stopped run has left. Right is a pose within 5 degrees and
5 mm of the true one, but for symmetries; found is an object whose estimate lies within its
diameter. `compare` tells what B is more than A, with the 95 % interval of a bootstrap over scenes.
"""

import argparse
import json
from pathlib import Path

from ..errors import UserError, argument_parser, command
from . import running, statistics
from .sets import fixed

# Columns of `compare` and `show`: key, title, format.
MEASURES = (
    ("recall", "recall", "{:.3f}"),
    ("false_positives", "false positives / group", "{:.3f}"),
    ("ece", "calibration error", "{:.3f}"),
    ("auroc", "AUROC of confidence", "{:.3f}"),
    ("ratio_rot_median", "rotation error / expected, median", "{:.2f}"),
    ("ratio_rot_mean", "rotation error / expected, mean", "{:.2f}"),
    ("ratio_t_median", "translation error / expected, median", "{:.2f}"),
    ("ratio_t_mean", "translation error / expected, mean", "{:.2f}"),
    ("time_ms_median", "time, median, ms", "{:.0f}"),
    ("time_ms_mean", "time, mean, ms", "{:.0f}"),
)
COUNTS = (
    ("views", "views", "{}"),
    ("groups", "groups", "{}"),
    ("objects", "objects", "{}"),
    ("found", "found", "{}"),
    ("right", "right", "{}"),
    ("invented", "false pos.", "{}"),
    ("failed", "failed", "{}"),
    ("rot_deg_median", "rot. deg", "{:.2f}"),
    ("t_mm_median", "trans. mm", "{:.2f}"),
    ("ece", "ECE", "{:.3f}"),
    ("auroc", "AUROC", "{:.3f}"),
    ("ratio_rot_median", "rot./exp.", "{:.2f}"),
    ("ratio_t_median", "trans./exp.", "{:.2f}"),
    ("time_ms_median", "ms, median", "{:.0f}"),
    ("time_ms_mean", "mean", "{:.0f}"),
)


def cell(form: str, value) -> str:
    missing = value is None or value != value  # NaN
    return "-" if missing else form.format(value)


def lined_up(rows: list[list[str]]) -> str:
    """Columns of text, the first one to the left."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = (text.rjust(width) for text, width in zip(others, widths[1:], strict=True))
        lines.append("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    return "\n".join(lines)


def shown(results: dict) -> str:
    """The tables of one run."""
    summaries = {
        name: statistics.summary(one["groups"]) | {"views": one["views"]}
        for name, one in results["sets"].items()
    }
    rows = [["set", *(title for _, title, _ in COUNTS)]]
    sure = [["set", *(f"{what} at {least}" for least in statistics.LEAST_CONFIDENCES
                      for what in ("recall", "precision"))]]  # fmt: skip
    for name, one in summaries.items():
        rows.append([name, *(cell(form, one[key]) for key, _, form in COUNTS)])
        pairs = one["at_least"].values()
        sure.append([name, *(cell("{:.3f}", share) for pair in pairs for share in pair)])
    head = f"{results['date']}, commit {results['commit']}, {results['machine']['processor']}"
    return f"{head}\n\n{lined_up(rows)}\n\n{lined_up(sure)}"


def comparison(a: dict, b: dict) -> dict:
    """What two runs amount to: by set `groups` in common, and `measures`."""
    names = [name for name in a["sets"] if name in b["sets"]]
    if not names:
        raise UserError("expected sets that both files have, got none; fix: run --set in both")
    found = {}
    for name in names:
        groups = statistics.in_common(a["sets"][name]["groups"], b["sets"][name]["groups"])
        scenes = {group["scene"] for group in groups[0]}
        found[name] = {
            "groups": len(groups[0]),
            "scenes": len(scenes),
            "groups_a": len(a["sets"][name]["groups"]),
            "groups_b": len(b["sets"][name]["groups"]),
            "measures": statistics.compared(*groups),
        }
    return found


def compared_text(found: dict) -> str:
    """A table for each set."""
    parts = []
    for name, one in found.items():
        rows = [[f"{name} ({one['groups']} groups)", "A", "B", "B - A", "95 % interval", ""]]
        for key, title, form in MEASURES:
            measure = one["measures"][key]
            signed = form.replace(":", ":+")
            values = (measure["a"], measure["b"])
            interval, beyond = "-", ""
            if measure["interval"] is not None:
                low, high = measure["interval"]
                interval = f"{signed} to {signed}".format(low, high)
                beyond = "*" if low > 0 or high < 0 else ""
            rows.append([
                f"  {title}", *(cell(form, value) for value in values),
                cell(signed, measure["difference"]), interval, beyond,
            ])  # fmt: skip
        text = lined_up(rows)
        if len({one["groups"], one["groups_a"], one["groups_b"]}) > 1:
            text += f"\n  (A has {one['groups_a']} groups, B {one['groups_b']})"
        parts.append(text)
    return "\n\n".join(parts) + "\n\n* the interval excludes 0"


def faults(a: dict, found: dict) -> list[str]:
    """A sentence for each set in which B is worse, or which it lacks."""
    sentences = [
        f"{name}: expected results in both files, got none in B; fix: run --set {name}"
        for name in a["sets"]
        if name not in found
    ]
    told = (statistics.worse(name, one["measures"]) for name, one in found.items())
    return sentences + [sentence for sentence in told if sentence]


def arguments() -> argparse.ArgumentParser:
    parser = argument_parser(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="predict the sets, and write what came of them")
    add = run.add_argument
    add("--out", type=Path, required=True, help="JSON file; a run that was stopped goes on there")
    add("--set", action="append", choices=list(fixed()), help="these alone; once for each")
    add("--limit", type=int, metavar="N", help="groups of each set, at most")
    add("--model-ycbv4", type=Path, default=Path("models/ycbv4"), metavar="DIR")
    add("--model-mvball", type=Path, default=Path("models/mvball"), metavar="DIR")
    add("--model-parts", type=Path, metavar="DIR", help="without it, sets of parts are left out")
    add(
        "--option",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="of predict; load.KEY of Estimator.load; bundle.KEY.KEY replaces what model.json says",
    )
    compare = commands.add_parser("compare", help="two runs, set by set")
    add = compare.add_argument
    add("a", type=Path)
    add("b", type=Path)
    add("--json", action="store_true", help="print JSON instead of tables")
    add("--fail-if-worse", action="store_true", help="exit 1 where B is worse beyond chance")
    show = commands.add_parser("show", help="the tables of one run")
    show.add_argument("a", type=Path)
    return parser


@command
def main():
    args = arguments().parse_args()
    if args.command == "run":
        if args.limit is not None and args.limit < 1:
            raise UserError(f"--limit: expected at least 1, got {args.limit}; fix: leave it out")
        sets = fixed()
        chosen = [one for one in sets.values() if one.usual]
        if args.set:
            chosen = [sets[name] for name in dict.fromkeys(args.set)]
        models = {"ycbv4": args.model_ycbv4, "mvball": args.model_mvball}
        if args.model_parts is not None:
            models["parts"] = args.model_parts
        options = running.options_of(args.option)
        print(shown(running.run(args.out, chosen, models, args.limit, options)))
    elif args.command == "show":
        print(shown(running.read(args.a)))
    else:
        a, b = running.read(args.a), running.read(args.b)
        found = comparison(a, b)
        print(json.dumps(found) if args.json else compared_text(found))
        sentences = faults(a, found) if args.fail_if_worse else []
        if sentences:
            raise UserError(*sentences)


if __name__ == "__main__":
    main()
