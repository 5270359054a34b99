"""One grid of a run as the page sees it: followers and jobs with the same questions."""

from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from ...envs.figures.registered import Metric
from ...envs.plant.controller import INFORMATION
from ..results.conclusions import INFORMED, Results
from ..statistics.ranks import order

TITLES = {
    "following": "Height following",
    "ood": "Out of distribution",
    "contour": "Contours",
    "cutting": "Cutting",
    "repeated": "Repeated passes",
    "drawing": "Along a drawing",
}

KNOWS = {
    "sensor": "sees only what the machine measures",
    "preview": "knows the sheet ahead, not ranked",
    "privileged": "knows the true gap, not ranked",
}
"""Information classes in words."""


@dataclass(frozen=True)
class Suite:
    """A grid's results by the name of their suite."""

    name: str
    results: Results

    @property
    def jobs(self) -> bool:
        """Whether it is one of jobs, else of height followers."""
        return self.results.jobs

    @property
    def title(self) -> str:
        """A heading."""
        return TITLES.get(self.name, self.name)

    @property
    def metric(self) -> str:
        """What is scored."""
        return self.results.metric

    @property
    def reference(self) -> str:
        """Against whom ratios are taken."""
        return self.results.reference

    @property
    def informed(self) -> str:
        """Who has 1 on the scale: a reference with other information, no bound; empty if nobody does."""
        return "" if self.jobs else INFORMED

    @cached_property
    def metrics(self) -> dict[str, Metric]:
        """The metrics that its runs have."""
        return {name: metric for name, metric in self.results.registered.items() if name in self.results.runs}

    @cached_property
    def summary(self) -> pd.DataFrame:
        """See :meth:`Results.summary`."""
        return self.results.summary()

    @property
    def exempt(self) -> tuple[str, ...]:
        """Scenarios that are built to defeat followers."""
        return self.results.exempt

    @cached_property
    def stability(self) -> pd.DataFrame:
        """Ms and margins by controller and machine; empty of jobs."""
        return self.results.stability

    @cached_property
    def scenarios(self) -> list[str]:
        """Core scenarios, then the ordinary, then those in which collisions are expected."""
        names = self.results.scenarios
        first = [s for s in self.results.core if s in names]
        last = [s for s in names if s in self.exempt and s not in first]
        return first + [s for s in names if s not in first and s not in last] + last

    @cached_property
    def scored(self) -> list[str]:
        """The scenarios that make the score."""
        return self.results.scored

    @property
    def scored_in_words(self) -> str:
        """Over what the score is taken: ``geometric mean over the 7 core scenarios``, ``in the scenario 'wavy'`` …"""
        if len(self.scored) == 1:
            return f"in the scenario '{self.scored[0]}'"
        core = "core " if set(self.scored) <= set(self.results.core) < set(self.results.scenarios) else ""
        return f"geometric mean over the {len(self.scored)} {core}scenarios"

    @cached_property
    def classes(self) -> dict[str, list[str]]:
        """Controllers of each information class, least informed class first, in the order of :func:`ranks.order`."""
        known = [*INFORMATION, *dict.fromkeys(self.summary["information"])]
        names, out = order(self.summary), {}
        for information in dict.fromkeys(known):
            if group := [name for name in names if self.summary.at[name, "information"] == information]:
                out[information] = group
        return out

    @cached_property
    def ranked(self) -> list[str]:
        """All controllers, class by class."""
        return [name for names in self.classes.values() for name in names]

    @cached_property
    def seeds(self) -> list[int]:
        """Scenario seeds that were run."""
        return sorted({int(seed) for seed in self.results.runs["seed"]})

    @cached_property
    def traces(self) -> dict[str, dict[int, dict[str, pd.DataFrame]]]:
        """Every period of the shown runs, by scenario, seed and controller."""
        out: dict[str, dict[int, dict[str, pd.DataFrame]]] = {}
        if "scenario" in self.results.traces:
            parts = self.results.traces.groupby(["scenario", "seed", "controller"], sort=False)
            for (scenario, seed, name), run in parts:
                out.setdefault(str(scenario), {}).setdefault(int(seed), {})[str(name)] = run
        return {scenario: dict(sorted(out[scenario].items())) for scenario in self.scenarios if scenario in out}

    @property
    def traced(self) -> list[str]:
        """Scenarios of which there are traces, in order."""
        return list(self.traces)

    def pooled(self, metric: str) -> pd.DataFrame:
        """A metric over the seeds, see :meth:`Results.pooled`; scenarios in the page's order."""
        return self.results.pooled(metric)[self.scenarios]

    @cached_property
    def lost(self) -> pd.DataFrame:
        """Failed runs, controllers × scenarios."""
        runs = self.results.runs
        table = self.results.failures.groupby([runs["controller"], runs["scenario"]], sort=False).sum().unstack()
        return table.reindex(index=self.results.controllers, columns=self.scenarios).fillna(0).astype(int)

    @cached_property
    def count(self) -> pd.DataFrame:
        """Runs, controllers × scenarios."""
        table = self.results.runs.groupby(["controller", "scenario"], sort=False).size().unstack()
        return table.reindex(index=self.results.controllers, columns=self.scenarios).fillna(0).astype(int)
