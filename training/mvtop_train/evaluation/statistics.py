"""What the outcomes of many groups amount to, and how far two runs differ.

Intervals are of a bootstrap: scenes are drawn with replacement, the same ones of both runs, as
groups of one scene are alike; of a set with one scene, groups are drawn.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

BINS = 10  # of confidences, as `mvtop-cli eval` has it
RESAMPLES = 2000
INTERVAL = 0.95
LEAST_CONFIDENCES = 0.2, 0.5, 0.8


@dataclass(frozen=True)
class Column:
    """One number of each thing that was counted or measured, and the group that it is of."""

    value: np.ndarray  # [n] or [n, 2]
    group: np.ndarray  # [n] int


@dataclass(frozen=True)
class Table:
    """The outcomes of groups, as arrays."""

    groups: int
    right: Column  # 0 or 1 of each true object
    found: Column  # the same
    extra: Column  # 1 of each false positive
    judged: Column  # [n, 2] confidence and right, of each estimate that has a confidence
    ratio_rot: Column  # error over expected error, of each found object
    ratio_t: Column
    rot_deg: Column
    t_mm: Column
    time_ms: Column  # of each group

    @classmethod
    def of(cls, groups: list[dict]) -> "Table":
        objects = [(n, one) for n, group in enumerate(groups) for one in group["objects"]]
        extra = [(n, one) for n, group in enumerate(groups) for one in group["false_positives"]]
        found = [(n, one) for n, one in objects if one["found"]]
        judged = [(n, (one["confidence"], one["right"])) for n, one in found]
        judged += [(n, (one["confidence"], False)) for n, one in extra]
        times = [(n, group["timings_ms"].get("total")) for n, group in enumerate(groups)]

        def ratio(error: str, sigma: str) -> Column:
            return _column([(n, one[error] / one[sigma]) for n, one in found if one[sigma]])

        return cls(
            groups=len(groups),
            right=_column([(n, one["right"]) for n, one in objects]),
            found=_column([(n, one["found"]) for n, one in objects]),
            extra=_column([(n, 1) for n, _ in extra]),
            judged=_column([(n, pair) for n, pair in judged if pair[0] is not None], 2),
            ratio_rot=ratio("rot_err_deg", "sigma_rot_deg"),
            ratio_t=ratio("t_err_mm", "sigma_t_mm"),
            rot_deg=_column([(n, one["rot_err_deg"]) for n, one in found]),
            t_mm=_column([(n, one["t_err_mm"]) for n, one in found]),
            time_ms=_column([(n, time) for n, time in times if time is not None]),
        )

    def drawn(self, times: np.ndarray) -> "Table":
        """With each group as often as `times` [groups] has it."""
        columns = {
            name: Column(
                np.repeat(column.value, times[column.group], 0),
                np.repeat(column.group, times[column.group]),
            )
            for name, column in vars(self).items()
            if name != "groups"
        }
        return Table(groups=int(times.sum()), **columns)


def _column(rows: list[tuple], width: int | None = None) -> Column:
    groups = np.array([n for n, _ in rows], int)
    values = np.array([value for _, value in rows], float)
    return Column(values.reshape(-1, width) if width else values, groups)


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else np.nan


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else np.nan


def reliability(confidence: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, float]:
    """[bins, 3] of count, mean confidence and share of right poses, in bins of as many poses; and
    the expected calibration error.

    - confidence [n] 0 to 1, right [n] 0 or 1
    """
    order = np.argsort(confidence, kind="stable")
    bins = np.array_split(order, min(BINS, len(order)))
    rows = np.array([[len(b), confidence[b].mean(), right[b].mean()] for b in bins])
    return rows, float(np.average(abs(rows[:, 1] - rows[:, 2]), weights=rows[:, 0]))


def print_reliability(name: str, confidence: np.ndarray, right: np.ndarray):
    """Prints AUROC, calibration error and bins of poses; of fewer than `BINS`, only how many."""
    import mvtop  # loads its compiled part

    if len(right) < BINS:
        print(f"{name}: {len(right)} poses, too few for statistics")
        return
    rows, error = reliability(confidence, right)
    area = mvtop.uncertainty.auroc(confidence, right > 0)
    area = "-" if area is None else f"{area:.3f}"
    print(f"{name}: {len(right)} poses, {right.mean():.1%} right, AUROC {area}, "
          f"calibration error {error:.3f}")  # fmt: skip
    for count, mean, share in rows:
        print(f"  {count:5.0f} poses  confidence {mean:6.1%}  right {share:6.1%}")


def ece(table: Table) -> float:
    """Expected calibration error of confidences, in bins of as many estimates."""
    if not len(table.judged.value):
        return np.nan
    return reliability(*table.judged.value.T)[1]


def auroc(table: Table) -> float:
    """How probable it is that a right estimate has more confidence than a wrong one."""
    import mvtop  # loads its compiled part

    confidence, right = table.judged.value.T
    area = mvtop.uncertainty.auroc(confidence, right > 0)
    return np.nan if area is None else area


# What two runs are compared by.
MEASURES: dict[str, Callable[[Table], float]] = {
    "recall": lambda table: _mean(table.right.value),
    "false_positives": lambda table: len(table.extra.value) / max(table.groups, 1),
    "ece": ece,
    "auroc": auroc,
    "ratio_rot_median": lambda table: _median(table.ratio_rot.value),
    "ratio_rot_mean": lambda table: _mean(table.ratio_rot.value),
    "ratio_t_median": lambda table: _median(table.ratio_t.value),
    "ratio_t_mean": lambda table: _mean(table.ratio_t.value),
    "time_ms_median": lambda table: _median(table.time_ms.value),
    "time_ms_mean": lambda table: _mean(table.time_ms.value),
}


def at_least(table: Table, confidence: float) -> tuple[float, float]:
    """Recall and precision of the estimates with as much confidence."""
    right = table.judged.value[table.judged.value[:, 0] >= confidence, 1]
    return right.sum() / max(len(table.right.value), 1), _mean(right)


def summary(groups: list[dict]) -> dict:
    """The numbers of one set."""
    table = Table.of(groups)
    return {
        "groups": len(groups),
        "objects": len(table.right.value),
        "found": int(table.found.value.sum()),
        "right": int(table.right.value.sum()),
        "invented": len(table.extra.value),
        "failed": sum(group["error"] is not None for group in groups),
        "rot_deg_median": _median(table.rot_deg.value),
        "t_mm_median": _median(table.t_mm.value),
        **{name: measure(table) for name, measure in MEASURES.items()},
        "at_least": {str(least): at_least(table, least) for least in LEAST_CONFIDENCES},
    }


def in_common(a: list[dict], b: list[dict]) -> tuple[list[dict], list[dict]]:
    """The groups that both runs have, in the same order."""
    others = {group["group"]: group for group in b}
    both = [group for group in a if group["group"] in others]
    return both, [others[group["group"]] for group in both]


def compared(
    a: list[dict], b: list[dict], resamples: int = RESAMPLES, seed: int = 0
) -> dict[str, dict]:
    """By measure `a`, `b`, `difference` (b - a) and its `interval` [2]; None where there is none.

    - a, b: outcomes of the same groups
    """
    scenes, scene_of = np.unique([group["scene"] for group in a], return_inverse=True)
    if len(scenes) < 2:
        scene_of = np.arange(len(a))
    count = scene_of.max() + 1 if len(a) else 0
    tables = Table.of(a), Table.of(b)
    values = {name: [measure(table) for table in tables] for name, measure in MEASURES.items()}
    rng = np.random.default_rng(seed)
    differences = {name: np.full(resamples, np.nan) for name in MEASURES}
    for n in range(resamples if count else 0):
        times = np.bincount(rng.integers(count, size=count), minlength=count)[scene_of]
        drawn = [table.drawn(times) for table in tables]
        for name, measure in MEASURES.items():
            differences[name][n] = measure(drawn[1]) - measure(drawn[0])
    ends = (1 - INTERVAL) / 2, (1 + INTERVAL) / 2
    found = {}
    for name, (was, now) in values.items():
        known = differences[name][np.isfinite(differences[name])]
        told = len(known) > resamples / 2 and np.isfinite(now - was)
        found[name] = {
            "a": _number(was),
            "b": _number(now),
            "difference": _number(now - was),
            "interval": np.quantile(known, ends).tolist() if told else None,
        }
    return found


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


def worse(name: str, measures: dict[str, dict]) -> str | None:
    """A sentence where a set's recall is lower or its false positives are more, beyond chance."""
    told = []
    for measure, sign, what in (
        ("recall", -1, "recall is lower"),
        ("false_positives", 1, "false positives per group are more"),
    ):
        one = measures[measure]
        if one["interval"] is None:
            continue
        low, high = one["interval"]
        if sign * one["difference"] > 0 and (high < 0 if sign < 0 else low > 0):
            told.append(
                f"{what}: {one['b']:.3f} instead of {one['a']:.3f} "
                f"(difference {one['difference']:+.3f}, 95 % from {low:+.3f} to {high:+.3f})"
            )
    return f"{name}: {', and '.join(told)}" if told else None
