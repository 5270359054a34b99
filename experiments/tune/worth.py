"""What a search's result is worth: on *test* seeds, before and after it, with intervals; and what its own seeds made of
it, since whoever searches long enough among few seeds finds what suits those."""

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...envs.scenarios import Scenario
from ..statistics.bootstrap import pooled, replicate
from ..statistics.comparison import exp, has_figure, neither_failed
from ..statistics.intervals import Interval, Sample
from ..statistics.pooling import declared, power
from . import goals
from .evaluate import Evaluator
from .study import Task

FLATTERED = 1.05
"""Times the figure on tune seeds from which on one on test seeds that is surely worse is warned of [A]."""


@dataclass(frozen=True)
class Ran:
    """The runs of a controller.

    Attributes:
        figures: of each scenario's runs.
        evaluator: that ran them; its seeds and scenarios are meant.
    """

    figures: goals.Figures
    evaluator: Evaluator

    def score(self, metric: str) -> float:
        """Over those runs; NaN if one of them failed."""
        return goals.score(metric, self.figures, self.evaluator.core)

    def sample(self, metric: str) -> Sample | None:
        """The metric in the scenarios that make the score, ``inf`` where a run failed; None where a figure is not one
        of single runs, such as a ratio, or of several metrics."""
        columns = {}
        for scenario in self._core:
            seeds = [int(seed) for seed in scenario.some(self.evaluator.seeds)]
            values = self.figures[scenario.name].get(metric)
            if values is None or len(values) != len(seeds):
                return None
            lost = np.isnan(values) | self._touched(scenario)
            columns[scenario.name] = pd.Series(np.where(lost, np.inf, values), seeds)
        table = pd.DataFrame(columns)
        return Sample(table.to_numpy(float)[None], tuple(table.index))

    @property
    def touched(self) -> int:
        """Runs in which the nozzle touched the sheet where it should not."""
        return sum(int(self._touched(s).sum()) for s in self.evaluator.scenarios if s.name in self.figures)

    @property
    def tried(self) -> int:
        """Runs."""
        return sum(len(figures["collision"]) for figures in self.figures.values())

    @property
    def _core(self) -> list[Scenario]:
        return [s for s in self.evaluator.scenarios if s.name in self.evaluator.core]

    def _touched(self, scenario: Scenario) -> np.ndarray:
        return (np.asarray(self.figures[scenario.name]["collision"]) > 0) & (not scenario.exempt)


@dataclass(frozen=True)
class Figure:
    """A metric of the result.

    Attributes:
        metric: its name.
        unit: its unit.
        before, after: on test seeds, of the runs that did not fail.
        gain: how many times better the result is, on the same seeds, of the runs in which neither failed.
        flattered: how many times worse the result is on test seeds than on those of the search.
        flattered_before: the same of the controller before the search, which nothing was fitted to.
    """

    metric: str
    unit: str
    before: Interval
    after: Interval
    gain: Interval
    flattered: Interval
    flattered_before: Interval

    @property
    def sure(self) -> bool:
        """Whether the result is better beyond chance."""
        return self.gain.low > 1.0

    @property
    def too_good(self) -> bool:
        """Whether test seeds are worse than tune seeds, beyond chance and by more than :data:`FLATTERED`."""
        return self.flattered.low > 1.0 and self.flattered.value > FLATTERED


@dataclass(frozen=True)
class Limit:
    """A limit of the search, on test seeds: in words, its figure before and after, whether it is kept."""

    words: str
    before: float
    after: float
    kept: bool


@dataclass(frozen=True)
class Worth:
    """Of a result.

    Attributes:
        figures: of the metrics that were searched for, in their order.
        limits: other than Ms.
        touched: runs on test seeds in which the nozzle touched the sheet, before and after.
        tried: runs on test seeds.
        tune_seeds, test_seeds: how many.
    """

    figures: tuple[Figure, ...]
    limits: tuple[Limit, ...]
    touched: tuple[int, int]
    tried: int
    tune_seeds: int
    test_seeds: int


def worth(task: Task, before: tuple[Ran, Ran], after: tuple[Ran, Ran]) -> Worth:
    """What a study's result is worth.

    Args:
        task: the study's.
        before, after: the controller's runs as it stood, and the result's: on tune seeds, and on test seeds.
    """
    figures = tuple(_figure(name, task, before, after) for name in task.metrics)
    limits = tuple(_limit(task, limit, before[1], after[1]) for limit in task.limits.limits)
    counts = (len(each.evaluator.seeds) for each in after)
    return Worth(figures, limits, (before[1].touched, after[1].touched), after[1].tried, *counts)


def _figure(name: str, task: Task, before: tuple[Ran, Ran], after: tuple[Ran, Ran]) -> Figure:
    about = goals.metric(name, task.jobs)
    better = -1 if about.better == "higher" else 1
    return Figure(
        name,
        "1" if task.relative else about.unit,
        estimate(name, before[1]),
        estimate(name, after[1]),
        times(name, before[1], after[1], better),
        times(name, after[1], after[0], better),
        times(name, before[1], before[0], better),
    )


def _limit(task: Task, limit: goals.Limit, before: Ran, after: Ran) -> Limit:
    was, now = (goals.measured(limit.name, each.figures, each.evaluator.core, task.jobs) for each in (before, after))
    higher = goals.metric(limit.name, task.jobs).better == "higher"
    return Limit(task.told(limit), was, now, limit.broken(now, higher) <= 0)


def _bootstraps(name: str) -> bool:
    """Whether the logarithm of a metric's figure has an interval."""
    return len(goals.joined(name)) == 1 and math.isfinite(power(name)) and not declared(name).zero


def estimate(name: str, ran: Ran) -> Interval:
    """A metric's figure with its interval; without, where there is none."""
    sample = ran.sample(name) if _bootstraps(name) else None
    if sample is None or not has_figure(sample):
        return Interval(ran.score(name))
    return exp(replicate([sample], pooled(power(name))).interval([1.0]))


def times(name: str, one: Ran, other: Ran, sign: int = 1) -> Interval:
    """One's figure over the other's, over the runs on common seeds in which neither failed, or, where they have no seed
    in common, over those of each that did not; the inverse if ``sign`` is −1."""
    pair = [ran.sample(name) if _bootstraps(name) else None for ran in (one, other)]
    if pair[0] is None or pair[1] is None:
        a, b = one.score(name), other.score(name)
        return Interval((a / b) ** sign if a > 0 and b > 0 else math.nan)
    both: list[Sample] | None = [pair[0], pair[1]]
    if set(pair[0].seeds) & set(pair[1].seeds):
        both = neither_failed(pair[0], pair[1])
    if both is None or not all(map(has_figure, both)):
        return Interval(math.nan)
    return exp(replicate(both, pooled(power(name))).interval([float(sign), -float(sign)]))
