"""What a benchmark's runs say about who is closer, by how much and how surely: :mod:`intervals` on its tables.

**A run fails** if the nozzle touches the sheet where it should not, if it holds a number that is not finite, if it has
nothing to score, or if its job is not finished (:func:`failures`). What that means for each figure:

- *score* and every other figure of a metric are over the runs that did not fail; how many did stands beside them;
- *ratios* are over the runs in which neither of the two failed, so nobody gains by failing where it is difficult;
- *wins*, *typical* and profiles compare run by run; a failed run is worse than all that did not fail on its seed;
- *ranks*: who fails on significantly fewer seeds stands above (:func:`better`).
"""

import itertools
import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from . import pooling
from .bootstrap import Replicates, mean_of_middle, pooled, pooled_mean, replicate
from .intervals import LEVEL, Interval, Sample, iqm, share

COLUMNS = ("score", "ratio", "typical", "wins")
"""Figures of :func:`figures`; each has its interval in the columns ``…_low`` and ``…_high``."""


def failures(results: Any) -> pd.Series:
    """Whether each run failed, one bool per row of ``results.runs``; those that are built to be touched in do not fail
    by that."""
    frame = results.runs
    lost = frame["failed"].astype(bool)
    if results.metric in frame:
        lost = lost | frame[results.metric].isna()
    if "collision" in frame:
        lost = lost | ((frame["collision"] > 0) & ~frame["scenario"].isin(results.exempt))
    return lost


def samples(
    results: Any, names: Iterable[str] | None = None, scenarios: Iterable[str] | None = None
) -> dict[str, Sample]:
    """What each controller did in the scenarios that make the score: the suite's metric, ``inf`` where a run failed.

    A controller that was not run in all of these scenarios is left out. A scenario on fewer seeds than the others has
    NaN on those.
    """
    chosen = list(scenarios or results.scored)
    here = results.runs["scenario"].isin(chosen)
    frame, lost = results.runs[here], failures(results)[here]
    values = frame[results.metric].where(~lost & frame[results.metric].notna(), np.inf)
    tables = frame.assign(value=values).pivot(index=["controller", "seed"], columns="scenario", values="value")
    out = {}
    for name in results.controllers if names is None else names:
        if name not in tables.index.get_level_values("controller"):
            continue
        table = tables.loc[name].reindex(columns=chosen)
        if table.notna().any().all():
            out[name] = Sample(table.to_numpy(float)[None], tuple(int(seed) for seed in table.index))
    return out


def unfailing(found: dict[str, Sample]) -> list[str]:
    """Names of those of whom no run failed."""
    return [name for name, sample in found.items() if not np.isinf(sample.values).any()]


def measured(found: dict[str, Sample]) -> list[str]:
    """Names of those who have a figure: in every scenario a run that did not fail, and none without any error."""
    return [name for name, sample in found.items() if has_figure(sample)]


def has_figure(sample: Sample) -> bool:
    """Whether there is in every scenario a run that did not fail, and none without any error."""
    return bool(np.isfinite(sample.values).any(axis=1).all() and not (sample.values <= 0).any())


def bootstrapped(found: dict[str, Sample], power: float) -> tuple[list[str], Replicates | None]:
    """The logarithm of the figures of those who have one, and who they are."""
    names = measured(found) if math.isfinite(power) else []
    return names, replicate([found[name] for name in names], pooled(power)) if names else None


def figures(results: Any, typical: bool = True) -> pd.DataFrame:
    """One row per controller, intervals of 95 % beside each figure; NaN where there is none.

    ``score``: the metric over seeds and scenarios (:mod:`pooling`), in its unit, of the runs that did not fail (``inf``
    if all of a scenario's did); ``ratio``: that of the reference over it, of the runs in which neither failed;
    ``typical``: the same, run by run on the same seeds, of which the interquartile mean, which a few very bad runs do
    not move (NaN unless asked for, because it takes longest; without scenarios on fewer seeds, :func:`everywhere`);
    ``wins``: how probably a run is better than the reference's on the same seed (0.5 for the reference itself).
    ``lost`` and ``tried``: how many of the runs that make the score failed, and their number.
    """
    found, reference = samples(results), results.reference
    power = pooling.power(results.metric)
    names, replicates = bootstrapped(found, power)
    rows: dict[str, dict[str, Interval]] = {name: {} for name in results.controllers}
    for name in found:
        rows[name]["score"] = Interval(math.inf)
    for i, name in enumerate(names):
        assert replicates
        one = np.eye(len(names))
        rows[name]["score"] = exp(replicates.interval(one[i]))
        if reference in names:
            rows[name]["ratio"] = _ratio(found, name, reference, power, names, replicates)
    if reference in found:
        for name, sample in found.items():
            mine, base = common(sample, found[reference])
            if len(mine):
                rows[name]["wins"] = Interval(0.5) if name == reference else share(_won(mine, base))
            mine, base = everywhere(mine, base)
            if mine.size and typical:
                rows[name]["typical"] = Interval(1.0, 1.0, 1.0) if name == reference else _typical(mine, base)
    flat = {
        name: {
            f"{column}{ending}": getattr(row.get(column, Interval(math.nan)), part)
            for column in COLUMNS
            for ending, part in (("", "value"), ("_low", "low"), ("_high", "high"))
        }
        for name, row in rows.items()
    }
    frame = pd.DataFrame.from_dict(flat, orient="index").reindex(results.controllers)
    within = results.runs["scenario"].isin(results.scored)
    lost = failures(results)[within].groupby(results.runs["controller"][within], sort=False)
    return frame.assign(
        lost=lost.sum().reindex(frame.index, fill_value=0).astype(int),
        tried=lost.size().reindex(frame.index, fill_value=0).astype(int),
    )


def interval(results: Any, metric: str) -> pd.DataFrame:
    """Ends ``low`` and ``high`` of any metric over seeds and scenarios, by controller, of the runs that did not fail;
    NaN where there are none, as of a largest value."""
    view = replace(results, metric=metric, runs=results.runs.assign(failed=failures(results)))
    found, power = samples(view), pooling.power(metric)
    if pooling.declared(metric).zero and power == 1.0:
        names = [name for name, each in found.items() if np.isfinite(each.values).any(axis=1).all()]
        replicates = replicate([found[name] for name in names], pooled_mean) if names else None
    else:
        names, replicates = bootstrapped(found, power)
    ends = pd.DataFrame(math.nan, index=results.controllers, columns=["low", "high"])
    for i, name in enumerate(names):
        assert replicates
        at = replicates.interval(np.eye(len(names))[i])
        ends.loc[name] = (at if pooling.declared(metric).zero else exp(at))[1:]
    return ends


def _ratio(
    found: dict[str, Sample], name: str, reference: str, power: float, names: list[str], replicates: Replicates
) -> Interval:
    """The reference's figure over that of ``name``, over the runs in which neither failed."""
    if {name, reference} <= set(unfailing(found)):
        one = np.eye(len(names))
        return exp(replicates.interval(one[names.index(reference)] - one[names.index(name)]))
    if name == reference:
        return Interval(1.0, 1.0, 1.0)
    pair = neither_failed(found[name], found[reference])
    if pair is None:
        return Interval(math.nan)
    return exp(replicate(pair, pooled(power)).interval([-1.0, 1.0]))


def _typical(mine: np.ndarray, base: np.ndarray) -> Interval:
    """Interquartile mean of the ratio run by run, on the same seeds, (seeds, scenarios) each."""
    with np.errstate(divide="ignore", invalid="ignore"):
        closer = np.log(base) - np.log(mine)
    closer = np.where(np.isnan(closer), 0.0, closer)  # both failed, or both without error
    middle = Interval(iqm(closer))
    if math.isfinite(middle.value):
        middle = replicate([Sample.of(closer)], mean_of_middle).interval([1.0])
    return exp(middle)


def _won(mine: np.ndarray, base: np.ndarray) -> np.ndarray:
    """1 where the first is better than the second, ½ where they are alike, NaN where one of them was not run."""
    won = (mine < base) + 0.5 * (mine == base)
    return np.where(np.isnan(mine) | np.isnan(base), np.nan, won)


def common(one: Sample, other: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Values of two single controllers on the seeds that both have, (seeds, scenarios) each."""
    seeds = [seed for seed in one.seeds if seed in set(other.seeds)]
    mine, base = (sample.values[0, [sample.seeds.index(seed) for seed in seeds]] for sample in (one, other))
    return mine, base


def everywhere(mine: np.ndarray, base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of two tables (seeds, scenarios) that has no gaps: the scenarios that were run on most seeds, and the
    seeds that all of these have. A scenario on a share of the seeds would take the others' seeds with it."""
    there = ~(np.isnan(mine) | np.isnan(base))
    most = there.sum(axis=0) == there.sum(axis=0).max(initial=0)
    seeds = there[:, most].all(axis=1)
    return mine[np.ix_(seeds, most)], base[np.ix_(seeds, most)]


def better(results: Any, names: Iterable[str]) -> pd.DataFrame:
    """Names × names: whether the first is better than the second. The rule of all ranks.

    1. Of two of whom one failed, it is the one that fails on significantly fewer seeds (sign test).
    2. If neither does, it is the one with the significantly smaller score over the runs in which neither failed.

    So nobody gains by failing where it is difficult, and a single failed run decides nothing. All statements hold
    together with 95 %.
    """
    found, power = samples(results, names), pooling.power(results.metric)
    table = pd.DataFrame(False, index=list(found), columns=list(found))
    clean = unfailing(found)
    pairs = [pair for pair in itertools.combinations(found, 2) if not set(pair) <= set(clean)]
    level = 1.0 - (1.0 - LEVEL) / (2 if pairs and len(clean) > 1 else 1)
    finite, replicates = bootstrapped({name: found[name] for name in clean}, power)
    if replicates:
        table.loc[finite, finite] = replicates.better(level)
    for one, other in pairs:
        risk = (1.0 - level) / (2 * len(pairs))
        verdict = _steadier(found[one], found[other], risk) or _closer(found[one], found[other], risk, power)
        table.loc[one, other], table.loc[other, one] = verdict > 0, verdict < 0
    return table


def _steadier(one: Sample, other: Sample, risk: float) -> int:
    """1 if the first fails on significantly fewer seeds, −1 if the second does, 0 if neither; ``risk`` of an error."""
    mine, theirs = common(one, other)
    less = np.isinf(mine).sum(axis=1) - np.isinf(theirs).sum(axis=1)
    fewer, more = int((less < 0).sum()), int((less > 0).sum())  # seeds; what one seed did is not independent
    if fewer + more and stats.binomtest(fewer, fewer + more).pvalue < risk:
        return 1 if fewer > more else -1
    return 0


def _closer(one: Sample, other: Sample, risk: float, power: float) -> int:
    """1 if the first has the significantly smaller score over the runs in which neither failed, −1 if the second has, 0
    if neither; ``risk`` of an error."""
    pair = neither_failed(one, other)
    if pair is None or not math.isfinite(power):
        return 0
    apart = replicate(pair, pooled(power)).interval([1.0, -1.0], 1.0 - risk)
    return int(apart.high < 0.0) - int(apart.low > 0.0)


def neither_failed(one: Sample, other: Sample) -> list[Sample] | None:
    """Both on the seeds that both have, without the runs in which one failed; None if a scenario has none left."""
    mine, theirs = common(one, other)
    both = np.isfinite(mine) & np.isfinite(theirs)
    if not len(mine) or not both.any(axis=0).all():
        return None
    return [Sample.of(np.where(both, values, np.inf)) for values in (mine, theirs)]


def by_scenario(results: Any) -> pd.DataFrame:
    """One row per controller and scenario: ``controller, scenario``, the metric over seeds ``value, low, high``,
    ``ratio, ratio_low, ratio_high``, that of the reference over it, and ``lost``, the failed runs."""
    rows = []
    for scenario in results.scenarios:
        view = replace(results, core=(scenario,))
        here = figures(view, typical=False)
        for name in samples(view):
            at = here.loc[name]
            ends = [at[f"{figure}{end}"] for figure in ("score", "ratio") for end in ("", "_low", "_high")]
            rows.append((name, scenario, *ends, int(at["lost"])))
    columns = ["controller", "scenario", "value", "low", "high", "ratio", "ratio_low", "ratio_high", "lost"]
    return pd.DataFrame(rows, columns=columns)


def relative(results: Any, metrics: Iterable[str]) -> pd.DataFrame:
    """One row per controller but the reference: each metric over the reference's, ``metric, metric_low, metric_high``.

    Each is pooled as :mod:`pooling` says, over the runs on the same seeds in which neither failed.
    """
    rows: dict[str, dict[str, float]] = {name: {} for name in results.controllers if name != results.reference}
    for metric in metrics:
        found = figures(replace(results, metric=metric), typical=False)
        for name, row in rows.items():
            at = found.loc[name]
            row[metric] = 1.0 / at["ratio"]
            row[f"{metric}_low"], row[f"{metric}_high"] = 1.0 / at["ratio_high"], 1.0 / at["ratio_low"]
    return pd.DataFrame.from_dict(rows, orient="index")


def exp(interval: Interval) -> Interval:
    """A figure with its interval from those of its logarithm."""
    with np.errstate(over="ignore"):
        return Interval(*(float(np.exp(end)) for end in interval))


_OWN = re.compile(r"\s--(?:seed|name|workers|threads|device|storage)[ =]\S+|\s--(?:overwrite|resume)")
"""What two trainings of one method may differ in."""


def _command(record: dict[str, Any]) -> Any:
    """What made a controller: the policy among a stack or a team's stacks, or else the stack itself."""
    trained = [each["policy"] for each in (record, *record.values()) if isinstance(each, dict) and "policy" in each]
    return (trained[0] if trained else record).get("command")


def methods(results: Any) -> pd.DataFrame:
    """Methods that were trained or tuned several times, a row each; none if every one was once.

    Controllers are runs of one method if the commands that made them differ in nothing but the seed. Columns:
    ``method``, its command; ``members``, their names; ``score`` and ``ratio`` with ``…_low`` and ``…_high``: of the
    method, so its interval is over trainings as over seeds; ``best`` and ``worst``: its members' scores.
    """
    found, power = samples(results), pooling.power(results.metric)
    groups: dict[str, list[str]] = {}
    for name in measured(found):
        command = _command((results.meta.get("tuning") or {}).get(name) or {})
        if command:
            groups.setdefault(_OWN.sub("", str(command)), []).append(name)
    rows = []
    for method, members in groups.items():
        seeds = [seed for seed in found[members[0]].seeds if all(seed in found[name].seeds for name in members)]
        if len(members) < 2 or not seeds:
            continue
        at = {name: [found[name].seeds.index(seed) for seed in seeds] for name in members}
        whole = Sample(np.stack([found[name].values[0, at[name]] for name in members]), tuple(seeds))
        base = [found[results.reference]] if results.reference in measured(found) else []
        replicates = replicate([whole, *base], pooled(power))
        score = exp(replicates.interval([1.0, 0.0][: 1 + len(base)]))
        ratio = exp(replicates.interval([-1.0, 1.0])) if base else Interval(math.nan)
        each = [float(np.exp(pooled(power)(run[None], (None, None))[0][0])) for run in whole.values]
        rows.append((method, members, *score, *ratio, min(each), max(each)))
    flat = [f"{figure}{end}" for figure in ("score", "ratio") for end in ("", "_low", "_high")]
    columns = ["method", "members", *flat, "best", "worst"]
    return pd.DataFrame(rows, columns=columns)
