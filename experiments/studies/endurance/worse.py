"""Does a controller get worse with time?

The seeds are the independent draws; what a controller does within one run is not.

- *Growth of the RMS*: of each seed, the RMS over the last third of the windows over that of the three windows that
  follow the first (in the first a controller still learns). Its geometric mean has a t interval over seeds, in the
  logarithm. All intervals of a table hold together with 95 % (Bonferroni).
- *Growth of the largest error*: the same of the windows' largest errors, whose logarithms are averaged. A maximum grows
  with the time that it is taken over, even if nothing gets worse, so only windows of equal length are compared here.
- *worse*: one of the two intervals lies above what is tolerated, :data:`RMS_MARGIN` and :data:`LARGEST_MARGIN`.
  *steady*: both lie below. *open*: neither, so these seeds do not tell.
- *Later over first*: the largest error after the first window over that within it, over all seeds. It grows by itself
  with the length of the run; the limit of :data:`LIMIT` is that of the project, for ``self-tuning``.
- *Above*: share of the later windows whose largest error exceeds the first window's of the same run. Without a trend
  one half is expected.
- *Burst*: a window whose largest error exceeds :data:`BURST` µm and :data:`TIMES` times the median of its run.

Windows from a collision or an alarm on are left out; lost runs are counted by themselves. Along a drawing nothing is
said of growth: a job is not the same from beginning to end.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

from ...statistics.intervals import Interval
from .stream import Windows

RMS_MARGIN, LARGEST_MARGIN = 1.05, 1.10
"""Growth that is tolerated."""

EARLY = 3
"""Windows after the first that later ones are compared with."""

LIMIT = 1.5

BURST, TIMES = 50.0, 3.0

HIGH = 100.0
"""µm; windows above it are counted too, whatever is usual."""

WORSE, STEADY, OPEN, NOT_JUDGED = "worse", "steady", "open", "–"
"""The last is for a drawing: a job is not the same from beginning to end."""


class Verdict(NamedTuple):
    """A controller on a sheet; errors in µm."""

    seeds: int
    lost: int
    rms_first: float  # RMS over all seeds, of the first window …
    rms_later: float  # … and of all others
    largest_first: float
    largest_later: float
    ratio: float  # of these two
    above: float
    rms_growth: Interval
    largest_growth: Interval
    bursts: int
    over_50: int  # windows
    over_100: int
    windows: int  # of all seeds that were judged
    word: str


def judge(found: Windows, tests: int = 1) -> Verdict:
    """The verdict on some runs; ``tests`` is how many verdicts must hold together."""
    rms, largest = found.rms, found.largest
    first, later = slice(0, 1), slice(1, None)
    third = max(1, (found.whole - 1) // 3)
    early, late = slice(1, 1 + min(EARLY, third)), slice(found.whole - third, found.whole)
    rms_growth = _growth(_log(found.over(late)) - _log(found.over(early)), tests)
    largest_growth = _growth(_mean_log(largest[late]) - _mean_log(largest[early]), tests)
    known = largest[later][np.isfinite(largest[later])]
    usual = _median(largest)
    with np.errstate(invalid="ignore"):
        bursts = (largest > BURST) & (largest > TIMES * usual)
        above = (largest[later] > largest[first])[np.isfinite(largest[later] + largest[first])]
    one, rest = _largest(largest[first]), _largest(known)
    return Verdict(
        seeds=rms.shape[1],
        lost=int(found.lost.sum()),
        rms_first=_pooled(found, first),
        rms_later=_pooled(found, later),
        largest_first=one,
        largest_later=rest,
        ratio=rest / one,
        above=float(above.mean()) if above.size else np.nan,
        rms_growth=rms_growth,
        largest_growth=largest_growth,
        bursts=int(bursts.sum()),
        over_50=int((largest > 50.0).sum()),
        over_100=int((largest > HIGH).sum()),
        windows=int(np.isfinite(largest).sum()),
        word=_word(rms_growth, largest_growth),
    )


def _word(rms: Interval, largest: Interval) -> str:
    if rms.low > RMS_MARGIN or largest.low > LARGEST_MARGIN:
        return WORSE
    return STEADY if rms.high < RMS_MARGIN and largest.high < LARGEST_MARGIN else OPEN


def _growth(logs: np.ndarray, tests: int) -> Interval:
    """Geometric mean of ratios with a t interval; seeds that were lost too early are left out."""
    logs = logs[np.isfinite(logs)]
    if not logs.size:
        return Interval(np.nan)
    middle = float(logs.mean())
    if logs.size < 2:
        return Interval(float(np.exp(middle)))
    reach = float(stats.t.ppf(1 - 0.025 / tests, logs.size - 1) * logs.std(ddof=1) / np.sqrt(logs.size))
    return Interval(float(np.exp(middle)), float(np.exp(middle - reach)), float(np.exp(middle + reach)))


def _log(values: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log(values))


def _mean_log(windows: np.ndarray) -> np.ndarray:
    """Mean over windows of each seed's logarithms; NaN where one is missing."""
    return np.asarray(_log(windows).mean(axis=0)) if len(windows) else np.full(windows.shape[1], np.nan)


def _median(windows: np.ndarray) -> np.ndarray:
    """Median of each seed's windows; NaN of a seed without any."""
    known = np.isfinite(windows)
    return np.array([np.median(w[k]) if k.any() else np.nan for w, k in zip(windows.T, known.T, strict=True)])


def _largest(values: np.ndarray) -> float:
    values = values[np.isfinite(values)]
    return float(values.max()) if values.size else np.nan


def _pooled(found: Windows, some: slice) -> float:
    weight = np.where(np.isnan(found.rms[some]), 0, found.counts[some])
    total = weight.sum()
    return float(np.sqrt(np.nansum(found.rms[some] ** 2 * weight) / total)) if total else np.nan
