"""Statistics of a comparison: how far apart controllers are, and how sure that is.

**What is drawn at random.** The *seed* draws one machine and, for it, one sheet of every scenario. A deterministic
controller's independent runs are therefore its seeds, each a row over all scenarios that stays together when rows are
resampled, and controllers are compared on the same rows (*common random numbers*). Where one method was trained or
tuned several times, those trainings are independent runs too, drawn besides the seeds. The scenarios are those of the
suite and stay fixed.

Values are arrays (runs, seeds, scenarios), lower is better. A failed run is ``inf``: the worst, never dropped.

**Intervals** are from a hierarchical bootstrap over these axes (:mod:`bootstrap`), studentised with equal tails:
percentile and BCa intervals (Efron 1987) hold less than they say at 20 runs, those of Student's t too where figures are
skewed (``python -m kerfgym.experiments.studies.coverage``).
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

LEVEL = 0.95
TRIMMED = 0.25
WORST = 0.05


class Interval(NamedTuple):
    """A figure with its interval; the ends are NaN where there is none."""

    value: float
    low: float = math.nan
    high: float = math.nan


@dataclass(frozen=True)
class Sample:
    """What one controller, or one method trained several times, did.

    Attributes:
        values: (runs, seeds, scenarios); runs is 1 for a single deterministic controller.
        seeds: labels of the second axis; samples are paired where they share labels.
    """

    values: np.ndarray
    seeds: tuple[Any, ...]

    @classmethod
    def of(cls, values: Any, seeds: Any = None) -> "Sample":
        """A sample from an array (seeds,), (seeds, scenarios) or (runs, seeds, scenarios); NaN counts as failed.

        Raises:
            ValueError: no value at all, more than three axes, or labels of another number than there are seeds.
        """
        array = np.asarray(values, float)
        array = array[None, :, None] if array.ndim == 1 else array[None] if array.ndim == 2 else array
        if array.ndim != 3 or not array.size:
            raise ValueError(f"values of shape {np.shape(values)}; (seeds, scenarios) or (runs, seeds, scenarios)")
        labels = tuple(range(array.shape[1])) if seeds is None else tuple(seeds)
        if len(labels) != array.shape[1] or len(set(labels)) != len(labels):
            raise ValueError(f"{len(set(labels))} different labels for {array.shape[1]} seeds")
        return cls(failures_last(array), labels)


def failures_last(values: Any) -> np.ndarray:
    """Values with ``inf``, the worst there is, in place of NaN."""
    array = np.asarray(values, float)
    return np.where(np.isnan(array), np.inf, array)


# ---------------------------------------------------------------------------------------------------------- figures


def iqm(values: Any) -> float:
    """Interquartile mean: of the middle half of all values, a quarter cut off at either end (Agarwal et al. 2021)."""
    flat = np.sort(failures_last(values), axis=None)
    cut = int(TRIMMED * len(flat))
    return float(np.mean(flat[cut : len(flat) - cut]))


def cvar(values: Any, share: float = WORST) -> float:
    """Conditional value at risk: mean of the worst ``share`` of the values (Rockafellar and Uryasev 2000).

    Where ``share`` of them is no whole number, the last counts in part.
    """
    flat = np.sort(failures_last(values), axis=None)[::-1]
    mass = share * len(flat)
    weight = np.clip(mass - np.arange(len(flat)), 0.0, 1.0)
    used = weight > 0
    return float(np.sum(flat[used] * weight[used]) / mass)


def wilson(hits: int, count: int, level: float = LEVEL) -> Interval:
    """A rate with Wilson's interval (Wilson 1927); NaN of nothing."""
    if count == 0:
        return Interval(math.nan)
    found = stats.binomtest(int(hits), int(count)).proportion_ci(level, method="wilson")
    return Interval(hits / count, float(found.low), float(found.high))


def share(indicator: Any, level: float = LEVEL) -> Interval:
    """Mean of numbers between 0 and 1, (seeds, …), with Wilson's interval at the number of *independent* draws.

    NaN is what was not drawn: a seed need not have been run in every scenario. What one seed did in several scenarios
    is not independent. The effective number is that at which independent draws would vary as much as the seeds' means
    do, at most that of all numbers; where all agree it is that of the seeds.
    """
    rows = np.asarray(indicator, float)
    rows = rows.reshape(len(rows), -1)
    there = ~np.isnan(rows)
    rows, there = rows[there.any(axis=1)], there[there.any(axis=1)]
    sums, counts, n = np.where(there, rows, 0.0).sum(axis=1), there.sum(axis=1), len(rows)
    if not n:
        return Interval(math.nan)
    p = float(sums.sum() / counts.sum())
    if n < 2:
        return Interval(p)
    variance = float(np.sum((sums - p * counts) ** 2)) / (n * (n - 1)) / float(counts.mean()) ** 2
    effective = min(p * (1 - p) / variance, counts.sum()) if variance > 0 else float(n)
    z = float(stats.t.ppf(0.5 + level / 2, n - 1))
    centre = (p + z * z / (2 * effective)) / (1 + z * z / effective)
    half = z / (1 + z * z / effective) * math.sqrt(p * (1 - p) / effective + z * z / (4 * effective**2))
    return Interval(p, max(0.0, min(p, centre - half)), min(1.0, max(p, centre + half)))


def probability_of_improvement(x: Any, y: Any, paired: bool = True) -> Interval:
    """How probably a run of ``x`` is better (lower) than one of ``y``, ties counting half; mean over scenarios.

    Args:
        x: (seeds, scenarios).
        y: the same; with other seeds only if not ``paired``.
        paired: whether runs of the same seed are compared (common random numbers). Otherwise every run of ``x`` is
            compared with every one of ``y`` (Mann and Whitney 1947), as rliable does it.
    """
    a, b = _table(x), _table(y)
    if paired:
        return share((a < b) + 0.5 * (a == b))
    rows = np.mean([_below(x, y) for x, y in zip(a.T, b.T, strict=True)], axis=0)
    columns = np.mean([_below(y, x) for x, y in zip(a.T, b.T, strict=True)], axis=0)
    p = float(rows.mean())
    if min(len(a), len(b)) < 2:
        return Interval(p)
    variance = rows.var(ddof=1) / len(rows) + columns.var(ddof=1) / len(columns)  # of a two-sample U statistic
    half = float(stats.t.ppf(0.5 + LEVEL / 2, min(len(a), len(b)) - 1)) * math.sqrt(variance)
    return Interval(p, max(0.0, p - half), min(1.0, p + half))


def _below(one: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Of how many of ``others`` each of ``one`` is below, as a share; ties half."""
    ranked = np.sort(others)
    left, right = np.searchsorted(ranked, one, "left"), np.searchsorted(ranked, one, "right")
    return 1 - (left + right) / (2 * len(others))


def _table(values: Any) -> np.ndarray:
    array = failures_last(values)
    return array[:, None] if array.ndim == 1 else array


def performance_profile(values: Any, thresholds: Any) -> list[Interval]:
    """Share of runs, (seeds, scenarios), at or below each threshold, with its interval."""
    table = _table(values)
    return [share(table <= threshold) for threshold in np.asarray(thresholds, float)]
