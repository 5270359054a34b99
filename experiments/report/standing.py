"""Who stands where in one metric: figures with intervals, ranks, ties (:func:`ranks.standings`)."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from ..statistics.ranks import extrapolated, in_any_metric, order, standings
from .suite import Suite

SAME = 0.005
"""Metrics in which all are within this share of each other say nothing."""


@dataclass(frozen=True)
class Standing:
    """One metric of a suite; ``frame`` as :func:`ranks.standings` gives it."""

    suite: Suite
    metric: str
    frame: pd.DataFrame

    @property
    def unit(self) -> str:
        """Of the metric."""
        return self.suite.metrics[self.metric].unit

    @property
    def less(self) -> str:
        """The word for less of it."""
        return self.suite.metrics[self.metric].called.less or "better"

    @cached_property
    def ranked(self) -> list[str]:
        """Who may be ranked and has a figure, of the least informed class, best first."""
        for names in self.suite.classes.values():
            fair = self.frame.loc[names]
            fair = fair[fair["rank"].notna() & np.isfinite(fair["score"].astype(float))]
            if len(fair):
                return order(fair)
        return []

    @cached_property
    def order(self) -> list[str]:
        """All that have a figure, the smallest first."""
        good = self.frame[np.isfinite(self.frame["score"].astype(float))]
        return list(good.sort_values("score", kind="stable").index)

    @property
    def best(self) -> str | None:
        """The first of those that may be ranked."""
        return self.ranked[0] if self.ranked else None

    @cached_property
    def tied(self) -> list[str]:
        """Who cannot be told apart from the best."""
        return [name for name in self.ranked if name in set(self.frame.at[self.best, "tied"])] if self.best else []

    @cached_property
    def varies(self) -> bool:
        """Whether the controllers differ."""
        score = self.frame["score"].astype(float)
        score = score[np.isfinite(score)]
        return len(score) > 1 and bool(score.max() > (1 + SAME) * score.min())

    def scale(self, name: str, column: str = "ratio") -> float:
        """0 of the reference, 1 of the informed one, in the logarithm of a ratio of :attr:`frame`; NaN without them."""
        informed = self.suite.informed
        if informed not in self.frame.index:
            return float("nan")
        with np.errstate(divide="ignore", invalid="ignore"):
            top = np.log(float(self.frame.at[informed, "ratio"]))
            return float(np.log(float(self.frame.at[name, column])) / top)


def all_of(suite: Suite) -> dict[str, Standing]:
    """Standings of the suite's metric, and of the others that the page compares."""
    r = suite.results
    found = {suite.metric: Standing(suite, suite.metric, r.standings)}
    why = in_any_metric(r)
    for metric in (name for name, m in suite.metrics.items() if m.compared and name != suite.metric):
        view = replace(r, metric=metric)
        own = {name: [*reasons, *extrapolated(view, name)] for name, reasons in why.items()}
        found[metric] = Standing(suite, metric, standings(view, own, typical=False))
    return found
