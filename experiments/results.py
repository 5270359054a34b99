"""Results of a benchmark and what is concluded from them.

Per scenario a controller's error is the RMS over all its scored periods of all its seeds (so a run that collides, and
sits retracted afterwards, weighs as heavily as it deserves). The score is the geometric mean over the suite's core; the
ratio is that of the reference over it. On the scale, 0 is ``xi2023-tuned`` and 1 is ``preview-5ms``, in the logarithm;
who is better than the latter, which has other information and is no bound, has more than 1. Rankings never mix
information classes.
"""

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from .budgets import budgets
from .fairness import standings

REFERENCE, CEILING = "xi2023-tuned", "preview-5ms"


class Comparison:
    """What the results of followers and of jobs have in common: tables of runs, a metric, a core, a reference."""

    runs: pd.DataFrame
    meta: dict[str, Any]
    core: tuple[str, ...]
    metric: str
    reference: str

    @property
    def controllers(self) -> list[str]:
        """In the order in which they were asked for."""
        return list(self.runs["controller"].unique())

    @property
    def scenarios(self) -> list[str]:
        """In the order in which they were run."""
        return list(self.runs["scenario"].unique())

    @property
    def scored(self) -> list[str]:
        """The scenarios that make the score: those of the core that were run, or all if none of them was."""
        ran = self.scenarios
        return [s for s in self.core if s in ran] or ran

    def pooled(self, metric: str) -> pd.DataFrame:
        """RMS over seeds of a metric, controllers × scenarios; NaN where a run failed."""

        def root(values: pd.Series) -> float:
            return float(np.sqrt(np.mean(np.square(values.to_numpy(float)))))

        table = self.runs.groupby(["controller", "scenario"], sort=False)[metric].apply(root).unstack()
        return table.reindex(index=self.controllers, columns=self.scenarios)

    @functools.cached_property
    def standings(self) -> pd.DataFrame:
        """Ranks, ties, intervals, and who is not ranked and why: :func:`fairness.standings`."""
        return standings(self)

    def placed(self, frame: pd.DataFrame) -> pd.DataFrame:
        """A summary with ranks, intervals and reasons beside its figures, lists in words."""
        more = self.standings.drop(columns=["information", "score", "ratio"]).reindex(frame.index)
        return frame.join(more.assign(tied=more["tied"].str.join(", "), reasons=more["reasons"].str.join("; ")))


def _geometric(table: pd.DataFrame) -> pd.Series:
    """Geometric mean of each row; NaN if one of its values is."""
    return pd.Series(np.exp(np.log(table.to_numpy(float)).mean(axis=1)), index=table.index)


@dataclass
class Results(Comparison):
    """A benchmark's tables.

    Attributes:
        runs: one row per run: ``controller, information, scenario, seed, failed`` and every metric.
        traces: one row per period of the shown seed of each scenario: ``controller, scenario, seed, time`` (s) and the
            recorder's channels, with ``x, y`` (mm) where the path is a drawing.
        sensitivity: ``controller, frequency`` (Hz) and ``magnitude``, the worst |S| over the corner plants.
        meta: the run's record (``run.json``).
        core: names of the scenarios that make the score.
        exempt: names of the scenarios in which collisions are expected.
        margins: ``controller, gain`` (factor) and ``delay_ms``, worst over the corner plants (:mod:`margins`).
        blame: shares of stages in the error of some controllers, see :func:`blame.tables.shares`.
        headroom: those beside references with other information, see :func:`blame.tables.headroom`.
        detuned: how much worse presets get with one parameter 20 % off, see :func:`detuned.in_report`.
    """

    runs: pd.DataFrame
    traces: pd.DataFrame
    sensitivity: pd.DataFrame
    meta: dict[str, Any]
    core: tuple[str, ...] = ()
    exempt: tuple[str, ...] = ()
    summaries: dict[str, str] = field(default_factory=dict)
    margins: pd.DataFrame = field(default_factory=pd.DataFrame)
    blame: pd.DataFrame = field(default_factory=pd.DataFrame)
    headroom: pd.DataFrame = field(default_factory=pd.DataFrame)
    detuned: pd.DataFrame = field(default_factory=pd.DataFrame)

    metric, reference = "rms_true", REFERENCE

    def pooled(self, metric: str = "rms_true") -> pd.DataFrame:
        """RMS over seeds of an RMS metric, controllers × scenarios; NaN where a run failed."""
        return super().pooled(metric)

    @property
    def bounds(self) -> dict[str, float]:
        """What no controller with only the sensor can go below (:mod:`bounds`), µm, by scenario, where it is known."""
        return {name: bound for name, bound in (self.meta.get("bounds") or {}).items() if name in self.scenarios}

    @property
    def bound(self) -> float:
        """The score of a controller at its bound in every scored scenario, µm; NaN if one of them has none."""
        values = np.array([self.bounds.get(name, np.nan) for name in self.scored])
        return float(np.exp(np.log(values).mean()))

    def summary(self) -> pd.DataFrame:
        """One row per controller: score (µm), ratio, scale, stability, budget, collision and failure counts, jitter,
        standing (:func:`fairness.standings`)."""
        pooled, reported = self.pooled(), self.pooled("rms_reported")
        scored = self.scored
        score = _geometric(pooled[scored])
        frame = pd.DataFrame({"score": score, "reported": _geometric(reported[scored])})
        reference = score.get(REFERENCE, np.nan)
        frame["ratio"] = reference / score
        frame["scale"] = np.log(reference / score) / np.log(reference / score.get(CEILING, np.nan))
        if len(self.sensitivity):
            frame["ms"] = self.sensitivity.groupby("controller")["magnitude"].max().reindex(frame.index)
        else:
            frame["ms"] = np.nan
        for column, name in (("gain_margin", "gain"), ("delay_margin", "delay_ms")):
            room = self.margins.set_index("controller")[name] if len(self.margins) else pd.Series(dtype=float)
            frame[column] = room.reindex(frame.index)
        frame = frame.join(budgets(self.meta.get("tuning") or {}, frame.index, REFERENCE))
        groups = self.runs.groupby("controller", sort=False)
        frame["information"] = groups["information"].first()
        ordinary = self.runs[~self.runs["scenario"].isin(self.exempt)].groupby("controller", sort=False)
        frame["collisions"] = ordinary["collision"].sum().reindex(frame.index, fill_value=0).astype(int)
        frame["collision_runs"] = ordinary.size().reindex(frame.index, fill_value=0)
        everywhere = groups["collision"].sum()
        frame["exempt_collisions"] = (
            everywhere - ordinary["collision"].sum().reindex(everywhere.index, fill_value=0)
        ).astype(int)
        frame["failed"] = groups["failed"].sum().astype(int)
        core = self.runs[self.runs["scenario"].isin(scored)].groupby("controller", sort=False)
        shown = (("p99", "p99_true"), ("jitter", "jitter"), ("dross", "dross"), ("roughness", "roughness"))
        for column, metric in shown:  # runs of earlier versions know nothing of the cut
            known = metric in self.runs
            frame[column] = core[metric].apply(lambda values: values.mean(skipna=False)) if known else np.nan
        return self.placed(frame)

    def decisions(self) -> pd.DataFrame:
        """Cost of a decision, one row per controller: ``median_us``, ``p99_us`` and ``ratio`` of the latter to the
        control period; NaN if it was not timed. Timings differ from run to run, so the summary is without them."""
        measured = self.meta.get("decisions") or {}
        columns = ["median_us", "p99_us", "ratio"]
        return pd.DataFrame.from_dict(measured, orient="index", columns=columns).reindex(self.controllers)

    def collision_rates(self) -> pd.DataFrame:
        """Share of runs with a collision, controllers × scenarios."""
        rates = self.runs.groupby(["controller", "scenario"], sort=False)["collision"].mean().unstack()
        return rates.reindex(index=self.controllers, columns=self.scenarios)
