"""Results of a benchmark and what is concluded from them.

Every figure of a controller is a metric of its runs that did not fail, pooled over seeds and scenarios as
:mod:`pooling` says; how many runs failed stands beside it, and tells in the rank (:mod:`comparison`). The *score* of
followers is that of the RMS of the true gap error over the suite's core, µm, of jobs that of their suite's metric; the
ratio is that of the reference over it. On the followers' *scale*, 0 is ``xi2023-tuned`` and 1 is ``preview-5ms``, in
the logarithm; who is better than the latter, which has other information and is no bound, has more than 1. Rankings
never mix information classes.

**Ms and margins** are the worst over the corner plants of every machine that the run's scenarios draw (:mod:`plants`).
"""

import functools
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ...envs.figures import evidence, job_metrics, metrics
from ...envs.figures.registered import Metric, Registry
from ..measure.plants import STANDARD
from ..statistics import comparison, pooling
from ..statistics.budgets import budgets, slots
from ..statistics.ranks import standings

REFERENCE, INFORMED = "xi2023-tuned", "preview-5ms"

STABILITY = ("ms", "ms_noise", "ms_noise_low", "ms_noise_high", "gain_margin", "delay_margin")
"""Columns of :attr:`Results.stability`."""


FIRST = ("rms_reported", "p99_true", "max_true", "jitter", "dross", "roughness")
"""Metrics of followers that stand in front of the others in tables."""


@dataclass
class Results:
    """A benchmark's tables, of height followers or of jobs.

    Attributes:
        runs: one row per run: ``controller, information, scenario, seed, failed`` and every metric of its kind.
        traces: one row per period of the shown seed of each scenario: ``controller, scenario, seed, time`` (s) and the
            recorder's channels, with ``x, y`` (mm) where the path is a drawing.
        sensitivity: ``controller, machine, signal`` (``sine`` or ``noise``, :mod:`stability`), ``frequency`` (Hz) and
            ``magnitude``, the worst |S| over the machine's corner plants; ``peak_low, peak_high``, the interval of the
            largest, of noise.
        meta: the run's record (``run.json``).
        core: names of the scenarios that make the score.
        exempt: names of the followers' scenarios in which collisions are expected.
        summaries: of the scenarios, a line each.
        margins: ``controller, machine, gain`` (factor) and ``delay_ms``, worst over the machine's corner plants
            (:mod:`margins`), and ``reason``, why there is no figure.
        blame: shares of stages in the error of some controllers, see :func:`blame.tables.shares`.
        headroom: those beside references with other information, see :func:`blame.tables.headroom`.
        detuned: how much worse presets get with one parameter 20 % off, see :func:`detuned.in_report`.
        metric: what is scored, over seeds and the core's scenarios, in its unit (:mod:`pooling`).
        reference: against whom ratios are taken.
        jobs: whether teams did jobs; ``sensitivity``, ``margins`` and what follows it are of followers, what is below
            of jobs.
        labels: what the figures of each cut material stand on.
        materials: with their thickness, mm.
        plans: how the parts are cut, see :func:`plans.table`.
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
    metric: str = "rms_true"
    reference: str = REFERENCE
    jobs: bool = False
    labels: tuple[str, ...] = ()
    materials: tuple[tuple[str, float], ...] = ()
    plans: pd.DataFrame = field(default_factory=pd.DataFrame)

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

    @property
    def registered(self) -> Registry:
        """The metrics of its kind."""
        return job_metrics.METRICS if self.jobs else metrics.METRICS

    @property
    def shown(self) -> list[Metric]:
        """The metrics that tables show, in order, without those that its runs do not have unless they are brief."""
        found = [m for m in self.registered.values() if m.shown and (m.shown.brief or m.name in self.runs)]
        first = () if self.jobs else FIRST
        return sorted(found, key=lambda m: first.index(m.name) if m.name in first else len(first))

    @property
    def failures(self) -> pd.Series:
        """Whether each run failed, see :func:`comparison.failures`."""
        return comparison.failures(self)

    def pooled(self, metric: str = "rms_true") -> pd.DataFrame:
        """A metric over the seeds (:mod:`pooling`), controllers × scenarios; NaN where no run is without failure."""
        sound = self.runs if pooling.declared(metric).always else self.runs[~self.failures]
        groups = sound.groupby(["controller", "scenario"], sort=False)[metric]
        table = groups.apply(lambda values: pooling.over_seeds(metric, values)).unstack()
        return table.reindex(index=self.controllers, columns=self.scenarios)

    def over(self, metric: str) -> pd.Series:
        """A metric over seeds and the scenarios that make the score, by controller; NaN if the runs do not have it."""
        if metric not in self.runs:  # of earlier versions
            return pd.Series(np.nan, index=self.controllers)
        table = self.pooled(metric)[self.scored]
        return table.apply(lambda row: pooling.over_scenarios(metric, row), axis=1)

    def estimated(self, frame: pd.DataFrame, wanted: Iterable[Metric]) -> pd.DataFrame:
        """A summary with these metrics, and the intervals of those that have one beside them in the tables."""
        for metric in wanted:
            frame[metric.column] = self.over(metric.name)
            told = metric.shown and not metric.shown.brief and metric.name in self.runs
            if told and metric.name != self.metric:  # what is ranked has its interval with the ranks
                ends = comparison.interval(self, metric.name).where(np.isfinite(frame[metric.column]))
                frame[[f"{metric.column}_low", f"{metric.column}_high"]] = ends
        return frame

    def counts(self, frame: pd.DataFrame) -> pd.DataFrame:
        """A summary with the ``runs`` in which nobody should touch the sheet, and of them those that touched it
        (``collisions``) or failed (``failed``)."""
        ordinary = self.runs[~self.runs["scenario"].isin(self.exempt)]
        controllers = ordinary["controller"]
        counted = {
            "collisions": ordinary["collision"].groupby(controllers, sort=False).sum(),
            "failed": self.failures[ordinary.index].groupby(controllers, sort=False).sum(),
            "runs": controllers.groupby(controllers, sort=False).size(),
        }
        return frame.assign(**{k: each.reindex(frame.index, fill_value=0).astype(int) for k, each in counted.items()})

    @functools.cached_property
    def standings(self) -> pd.DataFrame:
        """Ranks, ties, intervals, and who is not ranked and why: :func:`ranks.standings`."""
        return standings(self)

    def placed(self, frame: pd.DataFrame) -> pd.DataFrame:
        """A summary with ranks, intervals and reasons beside its figures, lists in words."""
        more = self.standings.drop(columns=[c for c in frame if c in self.standings]).reindex(frame.index)
        return frame.join(more.assign(tied=more["tied"].str.join(", "), reasons=more["reasons"].str.join("; ")))

    @property
    def bounds(self) -> dict[str, float]:
        """What no controller with only the sensor can go below (:mod:`bounds`), µm, by scenario, where it is known."""
        return {name: bound for name, bound in (self.meta.get("bounds") or {}).items() if name in self.scenarios}

    @property
    def linear(self) -> dict[str, float]:
        """What no fixed linear controller tuned to a scenario can go below at the set height, likewise."""
        return {name: bound for name, bound in (self.meta.get("linear") or {}).items() if name in self.scenarios}

    @property
    def bound(self) -> float:
        """The score of a controller at its bound in every scored scenario, µm; NaN if one of them has none above 0."""
        return self._score_at(self.bounds)

    @property
    def linear_bound(self) -> float:
        """The same of :attr:`linear`."""
        return self._score_at(self.linear)

    def _score_at(self, values: dict[str, float]) -> float:
        scored = np.array([values.get(name, np.nan) for name in self.scored])
        return float(np.exp(np.log(scored).mean())) if (scored > 0).all() else np.nan

    @property
    def curves(self) -> pd.DataFrame:
        """:attr:`sensitivity` with machine and signal, which runs of earlier versions did not name."""
        return _of_machines(self.sensitivity)

    @property
    def stability(self) -> pd.DataFrame:
        """One row per controller and machine: ``ms`` with sines, ``ms_noise`` with ``…_low`` and ``…_high``,
        ``gain_margin``, ``delay_margin`` (ms), and ``reason``, why one is missing; empty if nothing was measured."""
        by = ["controller", "machine"]
        curves, room = self.curves, _of_machines(self.margins)
        parts = []
        if len(curves):
            told = curves if "signal" in curves else curves.assign(signal="sine")  # earlier versions knew no other
            peaks = told.groupby([*by, "signal"], sort=False)["magnitude"].max().unstack()
            parts.append(peaks.rename(columns={"sine": "ms", "noise": "ms_noise"}))
            if {"signal", "peak_low", "peak_high"} <= set(curves):
                ends = curves[curves["signal"] == "noise"].groupby(by, sort=False)[["peak_low", "peak_high"]].first()
                parts.append(ends.rename(columns={"peak_low": "ms_noise_low", "peak_high": "ms_noise_high"}))
        if len(room):
            names = {"gain": "gain_margin", "delay_ms": "delay_margin"}
            parts.append(room.set_index(by).rename(columns=names).rename_axis(columns=None))
        if not parts:
            return pd.DataFrame()
        frame = pd.concat(parts, axis=1, sort=False).reindex(columns=[*STABILITY, "reason"])
        rows = pd.concat([each[by] for each in (room, curves) if len(each)]).drop_duplicates()
        frame = frame.reindex(pd.MultiIndex.from_frame(rows))
        reason = frame["reason"].astype(object)
        return frame.assign(reason=reason.where(reason.notna(), "")).reset_index()

    @property
    def apart(self) -> pd.DataFrame:
        """:attr:`stability` where there are several machines; empty for one."""
        found = self.stability
        return found if len(found) and found["machine"].nunique() > 1 else pd.DataFrame()

    @property
    def unmeasured(self) -> Iterable[tuple[Any, Iterable[str]]]:
        """Machine and reason for which some have no Ms or no margins, and their names."""
        found = self.stability.reindex(columns=["machine", "reason", "controller"])
        return found[found["reason"] != ""].groupby(["machine", "reason"], sort=False)["controller"]

    @property
    def ranged(self) -> list[str]:
        """Policies that are their base beyond a range of feeds, so that Ms and margins, measured at rest and at a high
        feed, may be their base's."""
        told = {name: slots(record) for name, record in (self.meta.get("tuning") or {}).items()}
        policies = {name: [body.get("policy") for body in bodies.values()] for name, bodies in told.items()}
        return [
            name
            for name in self.controllers
            if any(isinstance(made, dict) and "feed" in str(made.get("range", "")) for made in policies.get(name, ()))
        ]

    def summary(self) -> pd.DataFrame:
        """One row per controller: score and ratio with intervals, budget, collision and failure counts, other metrics
        over the core, standing (:func:`ranks.standings`); of followers scale and stability, of jobs what the figures of
        the cut stand on. The score of jobs is the suite's metric, so the same as the column of its name."""
        standing = self.standings
        frame = pd.DataFrame({"score": standing["score"].replace(np.inf, np.nan), "ratio": standing["ratio"]})
        spent = budgets(self.meta.get("tuning") or {}, frame.index, self.reference)
        if self.jobs:
            frame["information"] = standing["information"]
            frame = self.counts(self.estimated(frame, self.registered.values()))
            return self.placed(self._calibrated(frame).join(spent))
        frame["scale"] = np.log(frame["ratio"]) / np.log(frame["ratio"].get(INFORMED, np.nan))
        frame = self.estimated(frame, self.shown)
        frame = frame.join(_worst(self.stability).reindex(frame.index)).join(spent)
        frame["information"] = standing["information"]
        frame = self.counts(frame)
        everywhere = self.runs.groupby("controller", sort=False)["collision"].sum()
        frame["exempt_collisions"] = (everywhere - frame["collisions"]).astype(int)
        return self.placed(frame)

    def _calibrated(self, frame: pd.DataFrame) -> pd.DataFrame:
        """A summary with what the figures of the cut stand on, and its ranges after ISO 9013."""
        core = self.runs[self.runs["scenario"].isin(self.scored) & ~self.failures].groupby("controller", sort=False)
        known = "extrapolated" in self.runs  # runs of earlier versions do not know
        frame["extrapolated"] = core["extrapolated"].mean() if known else np.nan
        frame["beyond"] = [
            evidence.pooled(core.get_group(name)) if known and name in core.groups else "" for name in frame.index
        ]
        for column in ("iso_roughness", "iso_taper"):
            frame[column] = "–"
            if column in self.runs:
                found = core[column].agg(lambda values: "/".join(sorted(set(values.dropna()))) or "–")
                frame[column] = found.reindex(frame.index, fill_value="–")
        return frame

    def decisions(self) -> pd.DataFrame:
        """Cost of a decision, one row per controller: ``median_us``, ``p99_us`` and ``ratio`` of the latter to the
        control period; NaN if it was not timed. Timings differ from run to run, so the summary is without them."""
        measured = self.meta.get("decisions") or {}
        columns = ["median_us", "p99_us", "ratio"]
        return pd.DataFrame.from_dict(measured, orient="index", columns=columns).reindex(self.controllers)

    @property
    def machines(self) -> dict[str, list[str]]:
        """The machines of the run by their label, and the scenarios that have each; empty if that was not recorded."""
        return self.meta.get("machines") or {}


def in_order(runs: pd.DataFrame, controllers: Iterable[str], scenarios: Iterable[str]) -> pd.DataFrame:
    """Rows of runs by controller and scenario in the order of these, seeds rising."""
    order = {"controller": list(controllers), "scenario": list(scenarios)}
    return runs.sort_values(
        [*order, "seed"], key=lambda c: c.map(order[c.name].index) if c.name in order else c, ignore_index=True
    )


def _of_machines(table: pd.DataFrame) -> pd.DataFrame:
    """A table of stability, of which runs of earlier versions had but the standard machine, and sines."""
    for column, usual in (("machine", STANDARD.label), ("signal", "sine")) if len(table) else ():
        table = table.assign(**{column: table[column].fillna(usual) if column in table else usual})
    return table


def _worst(stability: pd.DataFrame) -> pd.DataFrame:
    """The worst of the machines by controller; one machine without a figure leaves none for all."""
    rows: dict[str, dict[str, float]] = {}
    for name, here in stability.groupby("controller", sort=False) if len(stability) else ():
        row = {column: float(here[column].max(skipna=False)) for column in ("ms", "ms_noise")}
        row |= {column: float(here[column].min(skipna=False)) for column in ("gain_margin", "delay_margin")}
        highest = here[here["ms_noise"] == row["ms_noise"]].head(1)
        row |= {end: float(highest[end].max()) for end in ("ms_noise_low", "ms_noise_high")}
        rows[str(name)] = row
    return pd.DataFrame.from_dict(rows, orient="index", columns=list(STABILITY), dtype=float)
