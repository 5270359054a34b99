"""Do the intervals hold? How often a 95 % interval contains the truth, on synthetic runs whose truth is known.

``python -m kerfgym.experiments.studies.coverage`` prints it at 5, 10, 20 and 50 independent runs for the kinds of
interval that one could use, and how often two copies of one controller are declared different. Each repeat draws errors
in seven scenarios that share a machine, so they go together:

- ``normal``: errors of 10 ± 1;
- ``lognormal``: with a spread of 50 %, about what is found in the following suite;
- ``collisions``: the same, three runs in a hundred with ten times the error;
- ``trainings``: the runs are trainings of one method that differ by a quarter, each measured on 20 lognormal seeds.

With ``--run runs/standard`` errors are drawn from the runs of a finished benchmark besides; the truth is then what all
of its seeds say together. The table stands in ``docs/statistics.md``.
"""

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from joblib import Parallel, delayed
from scipy import stats

from ..statistics.bootstrap import Statistic, log_score, mean_of_middle, replicate
from ..statistics.intervals import LEVEL, Interval, Sample
from ..store import markdown, script
from ..store.progress import Bars

COUNTS = (5, 10, 20, 50)
SCENARIOS, SEEDS = 7, 20
INTERVALS = ("percentile", "BCa", "Student", "bootstrap-t")
"""The last is what :mod:`bootstrap` uses."""


def _together(random: np.random.Generator, *shape: int) -> np.ndarray:
    """Standard normal numbers (…, seeds, scenarios); a quarter of the variance is common to a seed's scenarios."""
    return 0.5 * random.normal(size=(*shape, 1)) + 0.75**0.5 * random.normal(size=(*shape, SCENARIOS))


def _normal(random: np.random.Generator, count: int) -> np.ndarray:
    return 10.0 + _together(random, 1, count)


def _lognormal(random: np.random.Generator, count: int) -> np.ndarray:
    return np.exp(0.5 * _together(random, 1, count))


def _collisions(random: np.random.Generator, count: int) -> np.ndarray:
    hit = random.random((1, count, SCENARIOS)) < 0.03
    return np.where(hit, 10.0, 1.0) * _lognormal(random, count)


def _trainings(random: np.random.Generator, count: int) -> np.ndarray:
    method = 0.15 * random.normal(size=(count, 1, 1)) + 0.2 * random.normal(size=(count, 1, SCENARIOS))
    own = 0.1 * random.normal(size=(count, SEEDS, SCENARIOS))
    return np.exp(method + 0.5 * _together(random, 1, SEEDS) + own)


@dataclass(frozen=True)
class Kind:
    """A way to draw errors (runs, seeds, scenarios) with as many independent runs as asked for, and their truth:
    logarithm of the score, and middle of the errors' logarithms."""

    draw: Callable[[np.random.Generator, int], np.ndarray]
    score: float
    middle: float

    def truth(self, statistic: str) -> float:
        """Of one of :data:`STATISTICS`."""
        return self.score if statistic == "score" else self.middle


STATISTICS: dict[str, tuple[Statistic, Callable[[np.ndarray], np.ndarray]]] = {
    "score": (log_score, lambda errors: errors),
    "typical": (mean_of_middle, np.log),
}
"""What is estimated, and of what: the suite's score; the interquartile mean of logarithms."""


def _middle(cdf: Callable[[np.ndarray], np.ndarray], low: float, high: float) -> float:
    """Mean of the middle half of a distribution."""
    x = np.linspace(low, high, 400_001)
    quantiles = np.interp((np.arange(10_000) + 0.5) / 20_000 + 0.25, cdf(x), x)
    return float(quantiles.mean())


KINDS = {
    "normal": Kind(_normal, 0.5 * math.log(101.0), _middle(lambda x: stats.norm.cdf(np.exp(x) - 10.0), 1.5, 2.8)),
    "lognormal": Kind(_lognormal, 0.25, 0.0),
    "collisions": Kind(
        _collisions,
        0.25 + 0.5 * math.log(0.97 + 0.03 * 100.0),
        _middle(lambda x: 0.97 * stats.norm.cdf(2 * x) + 0.03 * stats.norm.cdf(2 * (x - math.log(10.0))), -4.0, 7.0),
    ),
    "trainings": Kind(_trainings, 0.25 + 0.1**2, 0.0),
}


def intervals(values: np.ndarray, statistic: Statistic, count: int = 1000) -> dict[str, Interval]:
    """Every kind of :data:`INTERVALS` for one statistic of values (runs, seeds, scenarios)."""
    found = replicate([Sample.of(values)], statistic, count=count)
    value, replicates, error = found.value[0], found.values[:, 0], math.sqrt(found.spread[0, 0])
    axis = 0 if len(values) > 1 else 1
    members, tails = values.shape[axis], np.array([0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    half = float(stats.t.ppf(tails[1], members - 1)) * error
    ones: list[np.ndarray | None] = [None, None]
    ones[axis] = np.ones((1, members))
    influence = statistic(values, tuple(ones))[1][axis]
    assert influence is not None
    centred = influence[0] - influence[0].mean()
    bias = stats.norm.ppf(np.clip(np.mean(replicates < value), 1 / count, 1 - 1 / count))
    skew = np.sum(centred**3) / (6 * np.sum(centred**2) ** 1.5)
    shifted = bias + stats.norm.ppf(tails)
    ranks = stats.norm.cdf(bias + shifted / (1 - skew * shifted))
    return {
        "percentile": Interval(value, *np.quantile(replicates, tails)),
        "BCa": Interval(value, *np.quantile(replicates, ranks)),
        "Student": Interval(value, value - half, value + half),
        "bootstrap-t": found.interval([1.0]),
    }


def coverage(kind: Kind, statistic: str, count: int, repeats: int, seed: int = 0) -> dict[str, float]:
    """The share of repeats in which each kind of interval holds the truth, at ``count`` independent runs."""
    function, of = STATISTICS[statistic]
    random, truth = np.random.default_rng([seed, count]), kind.truth(statistic)
    held = dict.fromkeys(INTERVALS, 0)
    for _ in range(repeats):
        for name, found in intervals(of(kind.draw(random, count)), function).items():
            held[name] += bool(found.low <= truth <= found.high)
    return {name: hits / repeats for name, hits in held.items()}


def false_winners(kind: Kind, count: int, repeats: int, seed: int = 0) -> float:
    """The share of repeats in which one of two copies of a controller, on independent seeds, is declared better."""
    random, won = np.random.default_rng([seed, count, 1]), 0
    for _ in range(repeats):
        drawn = [kind.draw(random, count) for _ in range(2)]
        both = [Sample.of(d, [(copy, i) for i in range(d.shape[1])]) for copy, d in enumerate(drawn)]
        won += bool(replicate(both, log_score).better().any())
    return won / repeats


def measured(folder: Path) -> dict[str, Kind]:
    """Kinds that draw seeds anew from the runs of a benchmark, one for each controller that did not fail."""
    from ..results.archive import load
    from ..statistics.comparison import samples

    out = {}
    for name, results in load(folder).grids.items():
        for controller, sample in samples(results).items():
            errors = sample.values
            if np.isfinite(errors).all():
                score = float(log_score(errors, (None, None))[0][0])
                middle = float(mean_of_middle(np.log(errors), (None, None))[0][0])
                out[f"{name}: {controller}"] = Kind(_drawn_from(errors), score, middle)
    return out


def _drawn_from(errors: np.ndarray) -> Callable[[np.random.Generator, int], np.ndarray]:
    return lambda random, count: errors[:, random.integers(errors.shape[1], size=count)]


Cell = tuple[str, str, int]
"""Name of the kind, statistic, number of runs."""


Shares = dict[str, float | None]
"""In which an interval of each kind holds the truth, and in which there is a false winner; in percent."""


def shares(kind: Kind, cell: Cell, repeats: int) -> Shares:
    """Of one cell, rounded as the table shows them."""
    _, statistic, count = cell
    held: Shares = {name: round(100.0 * share, 1) for name, share in coverage(kind, statistic, count, repeats).items()}
    wrong = round(100.0 * false_winners(kind, count, repeats), 1) if statistic == "score" else None
    return held | {"false winners": wrong}


def studied(kinds: Iterable[str]) -> list[Cell]:
    """What the table has rows for; the middle of many trainings on many seeds would take longer than all the rest."""
    every = itertools.product(kinds, STATISTICS, COUNTS)
    return [cell for cell in every if cell[:2] != ("trainings", "typical")]


def measured_cells(kinds: dict[str, Kind], repeats: int, jobs: int = 1) -> dict[Cell, Shares]:
    """Coverage of every kind of interval, and false winners, by cell."""
    cells = studied(kinds)
    pool = Parallel(n_jobs=jobs, return_as="generator", inner_max_num_threads=1 if jobs > 1 else None)
    with Bars() as bars:
        found = pool(delayed(shares)(kinds[cell[0]], cell, repeats) for cell in cells)
        return dict(zip(cells, bars.each("cells", found, len(cells)), strict=True))


def table(found: dict[Cell, Shares]) -> str:
    """The same in Markdown."""
    titles = ("errors", "figure", "runs", *INTERVALS, "false winners")
    rows = [(*cell, *("–" if x is None else f"{x:.1f} %" for x in each.values())) for cell, each in found.items()]
    return "\n".join(map(markdown.row, [titles, ["---", "---", *["---:"] * (len(titles) - 2)], *rows])) + "\n"


def main(
    repeats: int = 400, run: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None, jobs: int = 2
) -> None:
    """Measure how often 95 % intervals hold the truth; prints a table in Markdown.

    Args:
        repeats: of each cell; with 400 a share of 95 % is known to 2 % (two standard errors).
        run: a benchmark's folder; errors are drawn from its runs too.
        jobs: worker processes.
    """
    print(table(measured_cells(KINDS | (measured(run) if run else {}), repeats, jobs)))


if __name__ == "__main__":
    script.run(main, "kerfgym.experiments.studies.coverage")
