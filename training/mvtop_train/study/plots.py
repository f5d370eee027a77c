"""The pictures of docs/benchmarks.md, drawn from results (`results.Results`)."""

from pathlib import Path

import matplotlib
import numpy as np

from . import results

matplotlib.use("Agg")  # before pyplot: no display needed
from matplotlib import pyplot as plt  # noqa: E402

COLORS = ["#1f6feb", "#d9480f", "#2b8a3e", "#862e9c"]  # told apart in grey as well
BIN_DEG = 3.0  # of the histogram, as in the paper


def _axes(title: str, x: str, y: str):
    figure, axes = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    axes.set(title=title, xlabel=x, ylabel=y)
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)
    return figure, axes


def _save(figure, path: Path):
    figure.savefig(path, dpi=120)
    plt.close(figure)


def histogram(path: Path, runs: dict[str, results.Results]):
    """Counts of rotation errors in 3-degree bins, log scale; one outline for each run."""
    figure, axes = _axes("Two views", "rotation error, degrees", f"poses per {BIN_DEG:.0f} degrees")
    bins = np.arange(0, 180 + BIN_DEG, BIN_DEG)
    for (name, run), color in zip(runs.items(), COLORS, strict=False):
        values = run.rot_deg[run.found]
        label = f"{name}: {len(values)} poses, mean {results.mean(values)[0]:.1f}°"
        axes.hist(values, bins, histtype="stepfilled", color=color, alpha=0.35)
        axes.hist(values, bins, histtype="step", color=color, label=label)
    axes.set(yscale="log", xlim=(0, 180), ylim=(0.7, None))
    axes.legend()
    _save(figure, path)


def curves(path: Path, title: str, x: str, series: dict[str, list[tuple[float, results.Results]]]):
    """Mean rotation error and ADD with their standard errors over a number, a line per series."""
    figure, panels = plt.subplots(1, 2, figsize=(8.4, 3.4), layout="constrained")
    figure.suptitle(title)
    errors = (("rot_deg", 1, "mean rotation error, degrees"), ("add_m", 1e3, "mean ADD, mm"))
    for axes, (key, unit, label) in zip(panels, errors, strict=True):
        for (name, points), color in zip(series.items(), COLORS, strict=False):
            values = unit * np.array([results.mean(getattr(run, key)) for _, run in points])
            at = [number for number, _ in points]
            axes.errorbar(at, *values.T, marker="o", capsize=3, color=color, label=name)
        axes.set(xlabel=x, ylabel=label)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    panels[0].legend()
    _save(figure, path)


def calibration(path: Path, runs: dict[str, results.Results]):
    """Expected against actual rotation error: bins of equal count, and the single poses."""
    figure, axes = _axes(
        "What the network expects of its pose",
        "expected rotation error, degrees",
        "actual rotation error, degrees",
    )
    for (name, run), color in zip(runs.items(), COLORS, strict=False):
        axes.plot(run.sigma_rot_deg, run.rot_deg, ".", color=color, alpha=0.2, markersize=3)
        axes.plot(*results.calibration(run), "o-", color=color, label=name)
    axes.set(xscale="log", yscale="log")
    ends = np.array([0.5, 180])
    axes.plot(ends, ends, color="black", linewidth=0.8, linestyle="--", label="as expected")
    axes.legend()
    _save(figure, path)


def roc(path: Path, groups: dict[str, list[results.Results]], resolved_deg: float):
    """Unresolved poses told by their expected error, pooled over the runs of each group."""
    figure, axes = _axes(
        f"Telling poses that are off by more than {resolved_deg:g}°",
        "resolved poses flagged",
        "unresolved poses flagged",
    )
    for (name, runs), color in zip(groups.items(), COLORS, strict=False):
        fpr, tpr, area = results.pooled_roc(runs, resolved_deg)
        axes.plot(fpr, tpr, color=color, label=f"{name}: area {area:.3f}")
    axes.plot([0, 1], [0, 1], color="black", linewidth=0.8, linestyle="--")
    axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    axes.legend(loc="lower right")
    _save(figure, path)


def learning(path: Path, splits: dict[str, dict[str, tuple[list, list, list]]]):
    """Mean rotation errors over minutes of training with their intervals, a panel per split and a
    line per variant (`variants.curves`)."""
    if not splits:
        return
    figure, panels = plt.subplots(
        1, len(splits), figsize=(6.2 * len(splits), 4.4), layout="constrained", squeeze=False
    )
    for axes, (split, lines) in zip(panels[0], splits.items(), strict=True):
        for name, (minutes, means, intervals) in lines.items():
            (line,) = axes.plot(minutes, means, marker=".", label=name)
            axes.fill_between(minutes, *np.array(intervals).T, color=line.get_color(), alpha=0.15)
        axes.set(title=split, xlabel="minutes of training", ylabel="mean rotation error, degrees")
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    panels[0][0].legend()
    _save(figure, path)
