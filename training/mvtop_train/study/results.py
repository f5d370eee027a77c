"""Results of `mvtop-cli eval samples --out`: reading them, and what many of them amount to.

One line is one object of the truth (docs/reference/json.md). Where it was not found, numbers are
NaN here; statistics of errors are over the found ones, as in the summary that `eval` prints.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import UserError

RESOLVED_DEG = 15.0  # largest rotation error of a pose that counts as resolved, as in `eval`
WRONG_DEG = 30.0


@dataclass
class Results:
    """Objects of one run, arrays [N]."""

    rot_deg: np.ndarray
    trans_m: np.ndarray
    add_m: np.ndarray
    sigma_rot_deg: np.ndarray
    sigma_t_m: np.ndarray
    views: int
    samples: list[str]

    @property
    def found(self) -> np.ndarray:
        return np.isfinite(self.rot_deg)


def read(path: Path) -> Results:
    """Reads a file of `eval samples --out`; `UserError` where it is none."""
    try:
        lines = [json.loads(line) for line in Path(path).read_text().splitlines()]
        number = {key: [line[key] for line in lines] for key in ("rot_deg", "trans_m", "add_m")}
        sigma = [line["sigma"] or {"rot_deg": None, "t_m": None} for line in lines]
        views, samples = lines[0]["views"], [line["sample"] for line in lines]
    except (OSError, UnicodeDecodeError, ValueError, LookupError, TypeError) as error:
        raise UserError(
            f"{path}: expected JSON Lines, got {type(error).__name__}: {error}; "
            "fix: mvtop-cli eval samples DIR --out FILE.jsonl"
        ) from None
    sigmas = {
        "sigma_rot_deg": [s["rot_deg"] for s in sigma],
        "sigma_t_m": [s["t_m"] for s in sigma],
    }
    # None becomes NaN.
    columns = {key: np.array(x, dtype=float) for key, x in (number | sigmas).items()}
    return Results(**columns, views=views, samples=samples)


def mean(values: np.ndarray) -> tuple[float, float]:
    """Mean of the finite values and its standard error; NaN where there are too few."""
    values = values[np.isfinite(values)]
    n = len(values)
    if n == 0:
        return np.nan, np.nan
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(n)) if n > 1 else np.nan


def roc(sigma: np.ndarray, resolved: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Receiver operating characteristic of "sigma above a threshold" telling unresolved poses.

    - sigma [N], resolved [N] bool
    - returns: false positive rate, true positive rate (from (0, 0) to (1, 1), one point for each
      threshold) and the area under them; the area is NaN where one of the groups is empty

    Equal sigmas fall together, so that ties count half (Hanley and McNeil 1982).
    """
    import mvtop  # loads its compiled part

    fpr, tpr = mvtop.uncertainty.roc_curve(sigma, ~resolved).T
    area = mvtop.uncertainty.auroc(sigma, ~resolved)
    return fpr, tpr, np.nan if area is None else area


def pooled_roc(runs: list[Results], resolved_deg: float = RESOLVED_DEG):
    """`roc` over the found poses of several runs, say with one and with two views."""
    rot = np.concatenate([run.rot_deg[run.found] for run in runs])
    sigma = np.concatenate([run.sigma_rot_deg[run.found] for run in runs])
    return roc(sigma, rot <= resolved_deg)


def calibration(run: Results, bins: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Mean expected and mean actual rotation error, degrees, in bins of equal count, [bins] each.

    Bins are quantiles of the expected error; there are fewer where a bin would have under 5 poses.
    """
    import mvtop  # loads its compiled part

    expected, actual = run.sigma_rot_deg[run.found], run.rot_deg[run.found]
    bins = max(1, min(bins, len(expected) // 5))
    expected, actual = mvtop.uncertainty.calibration(expected, actual, bins).T
    return expected, actual


def correlation(run: Results) -> float:
    """Pearson's, between expected and actual rotation error; NaN where either does not vary."""
    import mvtop  # loads its compiled part

    expected, actual = run.sigma_rot_deg[run.found], run.rot_deg[run.found]
    pearson = mvtop.uncertainty.correlation(expected, actual)
    return np.nan if pearson is None else pearson
