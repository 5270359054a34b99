"""What a search is for: metrics that are made small (or large), and what a controller must not do meanwhile.

Over seeds and over the suite's core a metric is pooled as reports pool it (:mod:`pooling`). A limit that is kept gives
a number below 0, one that is broken a number above, on a logarithmic scale, so that a tenth too much weighs the same.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...envs.engine.quantity import InvalidInput
from ...envs.figures import job_metrics, metrics
from ...envs.figures.registered import Metric
from ..statistics.pooling import over_scenarios, over_seeds

FAILED = 1e6
"""Value of a candidate one of whose runs failed."""

FAR = 10.0
"""Largest violation of a limit that is told to a sampler."""

TIE = 0.01
"""Weight of the mean beside the largest, so that of two candidates with the same worst figure the better is found."""

JOINT = {
    "mean of": lambda logs: logs.mean(),
    "worst of": lambda logs: logs.max() + TIE * logs.mean(),
}
"""How several metrics make one, from the logarithms of all of them in all scenarios."""

Figures = dict[str, dict[str, Any]]
"""Scenario, then metric, to the values of its runs, shape (seeds,)."""


def metric(name: str, with_jobs: bool) -> Metric:
    """A metric of jobs or of followers by name; of a joint one, such as ``mean of roughness, dross``, what all of them
    have in common.

    Raises:
        InvalidInput: unknown; the nearest is offered.
    """
    if len(parts := joined(name)) > 1:
        for each in parts:
            if metric(each, with_jobs).better == "higher":
                raise InvalidInput(f"'{name}': of joint metrics less is better, of {each} more")
        return replace(metric(parts[0], with_jobs), name=name, unit="1")
    return (job_metrics.METRICS if with_jobs else metrics.METRICS).named(name)


def joined(name: str) -> list[str]:
    """The metrics of a joint one; of another itself."""
    how = next((how for how in JOINT if name.startswith(how)), "")
    return [each.strip() for each in name.removeprefix(how).split(",")] if how else [name]


def score(name: str, figures: Figures, core: tuple[str, ...]) -> float:
    """The metric over those scenarios of the core that have been run."""
    ran = [figures[s] for s in core if s in figures]
    each = {part: [over_seeds(part, of[part]) for of in ran] for part in joined(name)}
    if name in each:
        return over_scenarios(name, each[name])
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.exp(JOINT[name[: name.index(" of") + 3]](np.log(list(each.values())))))


@dataclass(frozen=True)
class Limit:
    """A metric that must stay at or below ``most`` (at or above, if higher is better)."""

    name: str
    most: float

    def broken(self, value: float, higher: bool = False) -> float:
        """By how much, as a logarithm; at or below 0 it is kept."""
        if math.isnan(value):
            return FAR
        if value <= 0 or self.most <= 0:
            difference = value - self.most
        else:
            difference = math.log(value / self.most)
        return float(np.clip(-difference if higher else difference, -FAR, FAR))


DESCENT = "descent"
"""Among the metrics of a scenario that begins with an approach from above; it has no values."""


@dataclass(frozen=True)
class Limits:
    """What a candidate must keep.

    Attributes:
        ms: largest sensitivity peak; infinite: any.
        limits: of metrics, over the core; ``overshoot`` is the largest of any descent instead.

    Raises:
        InvalidInput: a limit that no loop can keep, or that is no number.
    """

    ms: float = math.inf
    limits: tuple[Limit, ...] = ()

    def __post_init__(self) -> None:
        if not self.ms > 1.0:  # nan neither
            raise InvalidInput(f"ms = {self.ms:g} is out of range; above 1, inf for no cap")
        for limit in self.limits:
            if not math.isfinite(limit.most):
                raise InvalidInput(f"the limit {limit.name} = {limit.most:g} is no number that can be kept")

    @property
    def metrics(self) -> tuple[str, ...]:
        """What has to be measured for them."""
        return ("collision", *(limit.name for limit in self.limits))

    def peak(self, peak: float) -> float:
        """Violation of the cap on Ms."""
        if math.isinf(self.ms):
            return -FAR if math.isfinite(peak) else FAR
        return Limit("ms", self.ms).broken(peak if math.isfinite(peak) else math.nan)

    def check(self, figures: Figures, core: tuple[str, ...], with_jobs: bool) -> dict[str, float]:
        """Violations by name; collisions count in every scenario that was run."""
        crashes = sum(float(np.nansum(figures[s]["collision"])) for s in figures)
        found = {"collision": 0.1 + 0.01 * crashes if crashes else 0.0}
        for limit in self.limits:
            found[limit.name] = limit.broken(
                measured(limit.name, figures, core, with_jobs), metric(limit.name, with_jobs).better == "higher"
            )
        return found


def measured(name: str, figures: Figures, core: tuple[str, ...], with_jobs: bool) -> float:
    """The number that a limit of this name is about."""
    if name == "overshoot" and not with_jobs:
        return max((over_seeds(name, figures[s][name]) for s in figures if DESCENT in figures[s]), default=0.0)
    return score(name, figures, core)
