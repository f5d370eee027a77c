"""Whole predictions: how time and memory grow with pixels, cameras, objects and classes.

    make bench-predict

Images of parts of a shipped bundle on a table are predicted as `infer` does it: detection, poses,
refinement, scores and the check of the rig; only decoding of image files is not counted. One thing
changes at a time, see `AXES`. Each case is a process of its own, so that its memory is its own as
well. Writes predict.json and predict.png.
"""

import json
import os
import platform
import statistics
import subprocess
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import matplotlib
import numpy as np
import result_file
from mvtop_train.errors import argument_parser, command
from predict_scene import Table, rig, ring, smaller

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
WORKER = Path(__file__).with_name("predict_worker.py")
LARGEST = (4000, 3000)  # px: images are rendered so, or at SIZE, and made smaller


@dataclass(frozen=True)
class Case:
    """What is predicted."""

    width: int = 1280  # of images of 4:3
    cameras: int = 4
    objects: int = 6
    classes: int = 4
    cores: int = os.cpu_count() or 1

    @property
    def size(self) -> tuple[int, int]:
        return self.width, self.width * 3 // 4

    @property
    def megapixels(self) -> float:
        return self.size[0] * self.size[1] / 1e6


AXES = {
    "megapixels": [replace(Case(), width=width) for width in (640, 1600, 2560, 4000)],
    "cameras": [replace(Case(), cameras=count) for count in (1, 2, 4, 8)],
    "objects": [replace(Case(), objects=count) for count in (1, 3, 10, 30)],
    "classes": [replace(Case(), objects=12, classes=count) for count in (1, 2, 4)],
    "cores": [replace(Case(), cores=count) for count in (1, 2, 4, 8) if count <= Case().cores],
}
CALLERS = 4  # most threads that ask at once, where cores are compared
OF_VIEWS = ("prepare", "features")  # stages that work on each view by itself


class Scenes:
    """Images of scenes, rendered once."""

    def __init__(self, bundle: Path, work: Path):
        self.bundle, self.work, self.table = bundle, work, None

    def of(self, case: Case, seed: int) -> Path:
        """The folder of a scene: `rig.json`, and `images.npz` by camera id."""
        folder = self.work / f"{case.width}-{case.cameras}-{case.objects}-{seed}"
        if (folder / "images.npz").is_file():
            return folder
        folder.mkdir(parents=True, exist_ok=True)
        self.table = self.table or Table(self.bundle)
        rendered = LARGEST if case.width > Case().width else Case().size
        images = self.table.render(seed, case.objects, rendered, case.cameras)
        cameras = ring(*case.size)[: case.cameras]
        (folder / "rig.json").write_text(json.dumps(rig(cameras, *case.size)))
        images = {
            camera.id: smaller(x, case.size) for camera, x in zip(cameras, images, strict=True)
        }
        np.savez(folder / "part.npz", **images)
        (folder / "part.npz").rename(folder / "images.npz")
        return folder


def measure(bundle: Path, case: Case, folders: list[Path], rounds: int, callers: int) -> dict:
    """Times in ms, objects found and peak memory of one case; throughput of up to `callers`."""
    asked = [bundle, case.classes, rounds, case.cores, callers, *folders]
    run = subprocess.run(
        [sys.executable, str(WORKER), *map(str, asked)],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    found = json.loads(run.stdout.splitlines()[-1])
    total = sorted(row["total"] for row in found["rows"])
    stages = [name for name in found["rows"][0] if name != "total"]
    medians = {name: statistics.median(row[name] for row in found["rows"]) for name in stages}
    of_views = {name: ms for name, ms in medians.items() if name in OF_VIEWS}
    if found["first_crop"]:
        of_views["crop"] = statistics.median(found["first_crop"])
    joint = sum(medians.values()) - sum(of_views.values())
    return {
        "case": asdict(case) | {"megapixels": round(case.megapixels, 2)},
        "median_ms": statistics.median(total),
        "p95_ms": float(np.percentile(total, 95)),
        "stages_ms": medians,
        "tracked_ms": statistics.median(found["tracked"]) if found["tracked"] else None,
        "tracked_bound_ms": joint + sum(of_views.values()) / case.cameras,
        "per_second": {int(count): rate for count, rate in found["per_second"].items()},
        "found": found["found"],
        "shown": case.objects * len(folders),
        "peak_mb": found["peak_mb"],
    }


def exponent(axis: str, rows: list[dict]) -> float:
    """Of the power of the axis that fits the medians best: 1 where cost is proportional to it."""
    x = [row["case"][axis] for row in rows]
    return float(np.polyfit(np.log(x), np.log([row["median_ms"] for row in rows]), 1)[0])


def serial(rows: list[dict]) -> dict[str, float]:
    """By stage and in total, the share of time that a second core does not shorten (Amdahl)."""
    one, two = (next(row for row in rows if row["case"]["cores"] == count) for count in (1, 2))

    def share(of) -> float:
        return float(np.clip(2 * of(two) / of(one) - 1, 0, 1))

    stages = {name: share(lambda row, n=name: row["stages_ms"][n]) for name in one["stages_ms"]}
    return stages | {"total": share(lambda row: sum(row["stages_ms"].values()))}


def notes(axes: dict) -> list[str]:
    """Paragraphs below the table."""
    found = []
    rows = [row for row in axes.get("cameras", {}).get("rows", ()) if row["tracked_ms"]]
    if rows:
        cameras = ", ".join(str(row["case"]["cameras"]) for row in rows)
        times = ", ".join(f"{row['tracked_ms']:.0f}" for row in rows)
        bounds = ", ".join(f"{row['tracked_bound_ms']:.0f}" for row in rows)
        found.append(
            f"`Tracker`, one new image of {cameras} cameras: {times} ms. Its bound, that image's "
            f"share of `prepare`, `features` and crops of detected boxes, and all of the rest: "
            f"{bounds} ms."
        )
    rows = axes.get("cores", {}).get("rows", ())
    if len(rows) > 1:
        shares = serial(rows)
        stages = ", ".join(f"`{name}` {100 * share:.0f}" for name, share in shares.items())
        one = sum(rows[0]["stages_ms"].values())
        expected = [one * (shares["total"] + (1 - shares["total"]) / count) for count in (4, 8)]
        found.append(
            f"Serial share by one and two cores, %: {stages}. By Amdahl's law, 4 and 8 cores "
            f"would take {expected[0]:.0f} and {expected[1]:.0f} ms."
        )
        alone, last = rows[0]["per_second"][1], rows[-1]
        count = last["case"]["cores"]
        rates = ", ".join(f"{rate:.2f}" for rate in last["per_second"].values())
        found.append(
            f"{', '.join(map(str, last['per_second']))} callers at once, {count} cores: {rates} "
            f"predictions a second; {count} times one core: {count * alone:.2f}."
        )
    return found


def plot(axes: dict, path: Path) -> None:
    """Stages over each axis, stacked."""
    figure = plt.figure(figsize=(3.2 * len(axes), 3.2), layout="constrained")
    panels = figure.subplots(1, len(axes), squeeze=False)[0]
    for panel, (axis, found) in zip(panels, axes.items(), strict=True):
        rows = found["rows"]
        names = [f"{row['case'][axis]:g}" for row in rows]
        bottom = np.zeros(len(rows))
        for stage in rows[0]["stages_ms"]:
            heights = np.array([row["stages_ms"][stage] for row in rows])
            panel.bar(names, heights, bottom=bottom, label=stage)
            bottom += heights
        panel.set_xlabel(axis)
        panel.set_title(f"exponent {found['exponent']:.2f}", fontsize=10)
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("ms")
    # Of the last panel, in the order of its bars from above.
    handles, names = panels[-1].get_legend_handles_labels()
    figure.legend(handles[::-1], names[::-1], frameon=False, fontsize=9, loc="outside right center")
    figure.savefig(path, dpi=150)


def table(axes: dict) -> str:
    """Markdown."""
    lines = ["| axis | value | median, 95 % (ms) | found | peak MB |", "|---|---|---|---|---|"]
    for axis, found in axes.items():
        for row in found["rows"]:
            times = f"{row['median_ms']:.0f}, {row['p95_ms']:.0f}"
            seen = f"{row['found']}/{row['shown']}"
            value = f"{row['case'][axis]:g}"
            lines.append(f"| {axis} | {value} | {times} | {seen} | {row['peak_mb']:.0f} |")
        lines.append(f"| {axis} | exponent | {found['exponent']:.2f} | | |")
    return "\n".join(lines)


def result(axes: dict) -> list[list[str]]:
    """Rows of docs/benchmarks.md: each axis with all its values."""

    def row(axis: str, found: dict) -> list[str]:
        def each(of) -> str:
            return ", ".join(f"{of(row):g}" for row in found["rows"])

        values, times = each(lambda r: r["case"][axis]), each(lambda r: round(r["median_ms"]))
        seen = ", ".join(f"{r['found']}/{r['shown']}" for r in found["rows"])
        peak = each(lambda r: round(r["peak_mb"]))
        return [f"{axis}: {values}", times, seen, peak, f"{found['exponent']:.2f}"]

    return [row(axis, found) for axis, found in axes.items()]


@command
def main():
    parser = argument_parser(__doc__)
    parser.add_argument("--model", type=Path, default=ROOT / "models/ycbv4")
    parser.add_argument("--out", type=Path, default=ROOT / "out/predict")
    parser.add_argument("--scenes", type=int, default=3, help="of each case")
    parser.add_argument("--rounds", type=int, default=5, help="predictions of each scene")
    parser.add_argument("--json", type=Path, help="a section of docs/benchmarks.md")
    parser.add_argument("--axis", choices=AXES, action="append", help="only this one; repeatable")
    args = parser.parse_args()
    scenes = Scenes(args.model, args.out / "scenes")
    axes = {}
    for axis in args.axis or AXES:
        rows = []
        for case in AXES[axis]:
            folders = [scenes.of(case, seed) for seed in range(args.scenes)]
            callers = CALLERS if axis == "cores" else 0
            rows.append(measure(args.model, case, folders, args.rounds, callers))
            print(f"{axis} {rows[-1]['case'][axis]:g}: {rows[-1]['median_ms']:.0f} ms", flush=True)
        axes[axis] = {"exponent": exponent(axis, rows), "rows": rows}
    figures = {"machine": platform.processor(), "axes": axes}
    (args.out / "predict.json").write_text(json.dumps(figures, indent=1))
    if args.json:
        columns = ["axis", "median, ms", "found", "peak MB", "exponent"]
        rows = result(axes)
        result_file.write(args.json, "Whole predictions", 0, columns, rows, notes(axes))
    plot(axes, args.out / "predict.png")
    print(table(axes))
    print(*notes(axes), sep="\n")


if __name__ == "__main__":
    main()
