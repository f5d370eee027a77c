"""Evaluate a model under many conditions and write the tables and pictures of docs/benchmarks.md.

    python -m mvtop_train.study.tables --model models/mvball --pairs 100      (or: make tables)

Samples are rendered once for each split, and every condition takes its views from them. Results
that are there are kept, so a run that was stopped goes on where it was. Those of the hard split
have eight views, and one and two are the first of these: a scene counts only if all eight exist, so
these are not the scenes of `make eval` with two, and the figures differ a little. Eight views that
each show 300 pixels of a hemisphere hardly exist: those of the easy split have two.
"""

import hashlib
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import children
from ..errors import UserError, argument_parser, command
from . import results

VIEWS = {"hard": 8, "easy": 2}  # of a sample
RIG_DEG = (0.25, 0.5, 1.0, 2.0)
RIG_MM = (2.5, 5.0, 10.0, 20.0)
BOX = (0.02, 0.05, 0.1, 0.2)
# Titles of the pictures of `sweeps`, and what is swept over.
NOISE = (
    ("Calibration noise", "cameras turned by, degrees"),
    ("Calibration noise", "cameras moved by, mm"),
    ("Box noise", "standard deviation of each side, of the box's size"),
)


@dataclass(frozen=True)
class Condition:
    """One run of `mvtop-cli eval`."""

    split: str
    views: int = 2
    true_boxes: bool = False
    box_noise: float = 0.0
    rig_deg: float = 0.0
    rig_mm: float = 0.0

    @property
    def name(self) -> str:
        parts = [f"views{self.views}"]
        parts += ["true-boxes"] if self.true_boxes else []
        parts += [f"box{self.box_noise:g}"] if self.box_noise else []
        parts += [f"rig{self.rig_deg:g}deg"] if self.rig_deg else []
        parts += [f"rig{self.rig_mm:g}mm"] if self.rig_mm else []
        return "-".join(parts)

    @property
    def arguments(self) -> list[str]:
        numbers = {
            "--views": self.views, "--box-noise": self.box_noise,
            "--rig-noise-deg": self.rig_deg, "--rig-noise-mm": self.rig_mm,
        }  # fmt: skip
        chosen = [text for key, x in numbers.items() if x for text in (key, f"{x:g}")]
        return chosen + (["--true-boxes"] if self.true_boxes else [])


def sweep(split: str, key: str, sizes, **base) -> list[tuple[float, Condition]]:
    """Two views with none and with more and more of one kind of noise."""
    return [(x, Condition(split, **base, **{key: x})) for x in (0.0, *sizes)]


def sweeps(split: str) -> dict[str, list[tuple[float, Condition]]]:
    """By the name of its picture."""
    return {
        "rig_rotation": sweep(split, "rig_deg", RIG_DEG),
        "rig_translation": sweep(split, "rig_mm", RIG_MM),
        "boxes": sweep(split, "box_noise", BOX, true_boxes=True),
    }


def conditions(splits: list[str]) -> list[Condition]:
    """All of them, those that matter most first; noise on the first split only."""
    pairs = [Condition(s, v, t) for t in (False, True) for s in splits for v in (2, 1)]
    noise = [condition for swept in sweeps(splits[0]).values() for _, condition in swept]
    more = [Condition(s, v) for s in splits for v in range(3, VIEWS[s] + 1)]
    return list(dict.fromkeys(pairs + noise + more))


def call(command: list[str]):
    """Runs a command; one sentence if it fails, since it has said why."""
    try:
        code = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode
    except OSError as error:
        raise UserError(
            f"cannot run {command[0]}: {error.strerror}; fix: cargo build --release"
        ) from None
    if code:
        raise UserError(f"`{' '.join(command)}` failed with code {code}; fix: see above")


def claim(out: Path, model: Path):
    """Makes `out` the folder of this model's results; refuses that of another."""
    try:
        digest = hashlib.sha256((model / "model.json").read_bytes()).hexdigest()
    except OSError as error:
        raise UserError(
            f"{model}: expected a model bundle, got {error.strerror}; fix: --model DIR"
        ) from None
    out.mkdir(parents=True, exist_ok=True)
    record = out / "model.sha256"
    if record.exists() and record.read_text().strip() != digest:
        raise UserError(
            f"{out} holds results of another model than {model}; fix: remove it or --out DIR"
        )
    record.write_text(digest + "\n")


def measure(args, wanted: list[Condition]) -> dict[Condition, results.Results]:
    """Results of all conditions; evaluates those that are missing."""
    runs = {}
    for i, condition in enumerate(wanted):
        path = args.out / condition.split / f"{condition.name}.jsonl"
        if not path.exists():
            views = VIEWS[condition.split]
            name = f"{condition.split}-seed{args.seed}-views{views}-{args.pairs}"
            samples = args.samples / name
            if len(list(samples.glob("*/truth.json"))) < args.pairs:
                call(children.python(
                    "-m", "mvtop_train.synthesis.samples", "--out", samples,
                    "--split", condition.split, "--seed", args.seed,
                    "--count", args.pairs, "--views", views,
                ))  # fmt: skip
            print(f"[{i + 1}/{len(wanted)}] {condition.split} {condition.name}", flush=True)
            path.parent.mkdir(exist_ok=True)
            call([
                args.cli, "eval", "samples", str(samples), "--model", str(args.model),
                "--out", str(path), *condition.arguments,
            ])  # fmt: skip
        runs[condition] = results.read(path)
    return runs


def table(header: list[str], rows: list[list[str]]) -> str:
    """Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def degrees(run: results.Results) -> str:
    mean, error = results.mean(run.rot_deg)
    return f"{mean:.2f} ± {error:.2f}"


def cells(run: results.Results) -> list[str]:
    """found, rotation mean ± standard error, median, share over 30 degrees, ADD, translation,
    expected rotation error."""
    found = run.found
    if not found.any():
        return [f"0/{len(found)}", *["-"] * 6]
    return [
        f"{found.sum()}/{len(found)}",
        degrees(run),
        f"{np.median(run.rot_deg[found]):.2f}",
        f"{100 * np.mean(run.rot_deg[found] > results.WRONG_DEG):.1f} %",
        f"{1e3 * results.mean(run.add_m)[0]:.1f}",
        f"{1e3 * results.mean(run.trans_m)[0]:.1f}",
        f"{results.mean(run.sigma_rot_deg)[0]:.2f}",
    ]


COLUMNS = ["found", "rotation, °", "median, °", "over 30°", "ADD, mm", "translation, mm", "expected, °"]  # noqa: E501  # fmt: skip


def tables(runs: dict[Condition, results.Results], splits: list[str], resolved_deg: float) -> str:
    parts = []

    def section(title: str, header: list[str], chosen: list[tuple[list[str], Condition]]):
        rows = [[*names, *cells(runs[condition])] for names, condition in chosen]
        parts.append(f"## {title}\n\n" + table([*header, *COLUMNS], rows))

    section(
        "One and two views",
        ["split", "views", "boxes"],
        [
            ([s, str(v), "true" if t else "detected"], Condition(s, v, t))
            for s in splits
            for v in (2, 1)
            for t in (False, True)
        ],
    )
    for split in splits:
        if VIEWS[split] > 2:
            section(
                f"Number of views ({split}, detected boxes)",
                ["views"],
                [([str(v)], Condition(split, v)) for v in range(1, VIEWS[split] + 1)],
            )
    turned, moved, boxes = sweeps(splits[0]).values()
    section(
        f"Calibration noise ({splits[0]}, 2 views, detected boxes)",
        ["turned by, °", "moved by, mm"],
        [([f"{c.rig_deg:g}", f"{c.rig_mm:g}"], c) for _, c in turned + moved[1:]],
    )
    section(
        f"Box noise ({splits[0]}, 2 views, true boxes)",
        ["standard deviation, of the box's size"],
        [([f"{x:g}"], condition) for x, condition in boxes],
    )
    header = ["split", "views", f"resolved (within {resolved_deg:g}°)", "AUROC", "correlation"]
    unsure = []
    for split in splits:
        one, two = runs[Condition(split, 1)], runs[Condition(split, 2)]
        for name, group in (("1", [one]), ("2", [two]), ("1 and 2", [one, two])):
            rot = np.concatenate([run.rot_deg[run.found] for run in group])
            resolved = f"{100 * np.mean(rot <= resolved_deg):.0f} %" if len(rot) else "-"
            area = results.pooled_roc(group, resolved_deg)[2]
            own = f"{results.correlation(group[0]):.2f}" if len(group) == 1 else "-"
            unsure.append([split, name, resolved, f"{area:.3f}", own])
    title = "Uncertainty: unresolved poses told by their expected rotation error"
    parts.append(f"## {title}\n\n" + table(header, unsure))
    return "\n".join(parts)


def pictures(out: Path, runs: dict[Condition, results.Results], splits: list[str], resolved: float):
    from . import plots

    first = splits[0]
    plots.histogram(out / "histogram.png", {s: runs[Condition(s)] for s in splits})
    series = {s: [(v, runs[Condition(s, v)]) for v in range(1, VIEWS[s] + 1)] for s in splits}
    plots.curves(out / "views.png", "One set of weights", "views", series)
    for (name, swept), (title, unit) in zip(sweeps(first).items(), NOISE, strict=True):
        series = {f"{first}, two views": [(x, runs[condition]) for x, condition in swept]}
        plots.curves(out / f"{name}.png", title, unit, series)
    views = {f"{first}, {v} view{'s' * (v > 1)}": runs[Condition(first, v)] for v in (1, 2)}
    plots.calibration(out / "calibration.png", views)
    groups = {f"{s}, 1 and 2 views": [runs[Condition(s, v)] for v in (1, 2)] for s in splits}
    plots.roc(out / "roc.png", groups, resolved)


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--model", type=Path, default=Path("models/mvball"), help="bundle")
    parser.add_argument("--pairs", type=int, default=100, help="samples of each split")
    parser.add_argument("--seed", type=int, default=0, help="of the samples")
    parser.add_argument("--splits", nargs="+", choices=["hard", "easy"], default=["hard", "easy"])
    parser.add_argument("--samples", type=Path, default=Path("out/eval"), help="rendered samples")
    parser.add_argument("--out", type=Path, help="default: out/tables/MODEL-seedS-PAIRS")
    parser.add_argument("--images", type=Path, help="also copy the pictures here (docs/images)")
    parser.add_argument("--resolved-deg", type=float, default=results.RESOLVED_DEG)
    parser.add_argument("--cli", default="target/release/mvtop-cli")
    args = parser.parse_args()
    if args.pairs < 1:
        raise UserError(f"--pairs: expected 1 or more, got {args.pairs}; fix: --pairs 100")
    args.out = args.out or Path("out/tables") / f"{args.model.name}-seed{args.seed}-{args.pairs}"
    claim(args.out, args.model)
    runs = measure(args, conditions(args.splits))
    text = f"{args.pairs} samples of each split, seed {args.seed}; mean ± standard error.\n\n"
    text += tables(runs, args.splits, args.resolved_deg)
    (args.out / "tables.md").write_text(text)
    pictures(args.out, runs, args.splits, args.resolved_deg)
    if args.images:
        args.images.mkdir(parents=True, exist_ok=True)
        for picture in args.out.glob("*.png"):
            shutil.copy(picture, args.images)
    print(text)
    print(f"written: {args.out}/tables.md and {len(list(args.out.glob('*.png')))} pictures")


if __name__ == "__main__":
    main()
