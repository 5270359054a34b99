"""What a benchmark's runs say about who is closer, by how much and how surely: :mod:`inference` on its tables."""

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from .inference import Interval, Sample, iqm, probability_of_improvement
from .resampling import Replicates, log_score, mean_of_middle, replicate

COLUMNS = ("score", "ratio", "typical", "wins")
"""Figures of :func:`figures`; each has its interval in the columns ``…_low`` and ``…_high``."""


def samples(
    results: Any, names: Iterable[str] | None = None, scenarios: Iterable[str] | None = None
) -> dict[str, Sample]:
    """What each controller did in the scenarios that make the score: the suite's metric, ``inf`` where a run failed.

    A controller that was not run in all of these scenarios is left out; so are its seeds that it was not run on in all
    of them.
    """
    chosen = list(scenarios or results.scored)
    frame = results.runs[results.runs["scenario"].isin(chosen)]
    values = frame[results.metric].where(~frame["failed"].astype(bool) & frame[results.metric].notna(), np.inf)
    tables = frame.assign(value=values).pivot(index=["controller", "seed"], columns="scenario", values="value")
    out = {}
    for name in results.controllers if names is None else names:
        if name not in tables.index.get_level_values("controller"):
            continue
        table = tables.loc[name].reindex(columns=chosen).dropna()
        if len(table):
            out[name] = Sample.of(table.to_numpy(float), tuple(int(seed) for seed in table.index))
    return out


def sound(found: dict[str, Sample]) -> list[str]:
    """Names of those of whom no run failed."""
    return [name for name, sample in found.items() if np.isfinite(sample.values).all() and (sample.values > 0).all()]


def bootstrapped(found: dict[str, Sample]) -> tuple[list[str], Replicates | None]:
    """The logarithm of the scores of those without a failed run, and who they are."""
    names = sound(found)
    return names, replicate([found[name] for name in names], log_score) if names else None


def figures(results: Any, typical: bool = True) -> pd.DataFrame:
    """One row per controller, intervals of 95 % beside each figure; NaN where there is none.

    ``score``: geometric mean over the scenarios of the RMS over seeds, in the metric's unit (``inf`` if a run failed);
    ``ratio``: that of the reference over it; ``typical``: the same, run by run on the same seeds, of which the
    interquartile mean, which a few very bad runs do not move (NaN unless asked for, because it takes longest);
    ``wins``: how probably a run is better than the reference's on the same seed (0.5 for the reference itself).
    """
    found, reference = samples(results), results.reference
    names, replicates = bootstrapped(found)
    rows: dict[str, dict[str, Interval]] = {name: {} for name in results.controllers}
    for name in found:
        rows[name]["score"] = Interval(math.inf)
    for i, name in enumerate(names):
        assert replicates
        one = np.eye(len(names))
        rows[name]["score"] = _exp(replicates.interval(one[i]))
        if reference in names:
            rows[name]["ratio"] = _exp(replicates.interval(one[names.index(reference)] - one[i]))
    if reference in found:
        for name, sample in found.items():
            mine, base = common(sample, found[reference])
            if len(mine):
                rows[name]["wins"] = Interval(0.5) if name == reference else probability_of_improvement(mine, base)
                if typical:
                    rows[name]["typical"] = Interval(1.0, 1.0, 1.0) if name == reference else _typical(mine, base)
    flat = {
        name: {
            f"{column}{ending}": getattr(row.get(column, Interval(math.nan)), part)
            for column in COLUMNS
            for ending, part in (("", "value"), ("_low", "low"), ("_high", "high"))
        }
        for name, row in rows.items()
    }
    return pd.DataFrame.from_dict(flat, orient="index").reindex(results.controllers)


def _typical(mine: np.ndarray, base: np.ndarray) -> Interval:
    """Interquartile mean of the ratio run by run, on the same seeds, (seeds, scenarios) each."""
    with np.errstate(divide="ignore", invalid="ignore"):
        closer = np.log(base) - np.log(mine)
    closer = np.where(np.isnan(closer), 0.0, closer)  # both failed, or both without error
    middle = Interval(iqm(closer))
    if math.isfinite(middle.value):
        middle = replicate([Sample.of(closer)], mean_of_middle).interval([1.0])
    return _exp(middle)


def common(one: Sample, other: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Values of two single controllers on the seeds that both have, (seeds, scenarios) each."""
    seeds = [seed for seed in one.seeds if seed in set(other.seeds)]
    at = [[sample.seeds.index(seed) for seed in seeds] for sample in (one, other)]
    return one.values[0, at[0]], other.values[0, at[1]]


def better(results: Any, names: Iterable[str]) -> pd.DataFrame:
    """Names × names: whether the first has a significantly better score than the second.

    All these statements hold together with 95 %. Who failed in a run is worse than all who did not.
    """
    found = samples(results, names)
    table = pd.DataFrame(False, index=list(found), columns=list(found))
    finite, replicates = bootstrapped(found)
    if replicates:
        table.loc[finite, finite] = replicates.better()
    table.loc[finite, [name for name in found if name not in finite]] = True
    return table


def by_scenario(results: Any) -> pd.DataFrame:
    """One row per controller and scenario: ``controller, scenario``, the RMS over seeds ``value, low, high``, and
    ``ratio, ratio_low, ratio_high``, that of the reference over it."""
    rows = []
    for scenario in results.scenarios:
        found = samples(results, scenarios=[scenario])
        names, replicates = bootstrapped(found)
        for name in found:
            value, ratio = Interval(math.inf), Interval(math.nan)
            if name in names:
                assert replicates
                one = np.eye(len(names))
                i = names.index(name)
                value = _exp(replicates.interval(one[i]))
                if results.reference in names:
                    ratio = _exp(replicates.interval(one[names.index(results.reference)] - one[i]))
            rows.append((name, scenario, *value, *ratio))
    columns = ["controller", "scenario", "value", "low", "high", "ratio", "ratio_low", "ratio_high"]
    return pd.DataFrame(rows, columns=columns)


def relative(results: Any, metrics: Iterable[str]) -> pd.DataFrame:
    """One row per controller but the reference: each metric over the reference's, ``metric, metric_low, metric_high``.

    Each is pooled as the score is, over runs on the same seeds; NaN where a run failed.
    """
    rows: dict[str, dict[str, float]] = {name: {} for name in results.controllers if name != results.reference}
    for metric in metrics:
        found = figures(replace(results, metric=metric))
        for name, row in rows.items():
            at = found.loc[name]
            row[metric] = 1.0 / at["ratio"]
            row[f"{metric}_low"], row[f"{metric}_high"] = 1.0 / at["ratio_high"], 1.0 / at["ratio_low"]
    return pd.DataFrame.from_dict(rows, orient="index")


def _exp(interval: Interval) -> Interval:
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
    found = samples(results)
    groups: dict[str, list[str]] = {}
    for name in sound(found):
        command = _command((results.meta.get("tuning") or {}).get(name) or {})
        if command:
            groups.setdefault(_OWN.sub("", str(command)), []).append(name)
    rows = []
    for method, members in groups.items():
        seeds = [seed for seed in found[members[0]].seeds if all(seed in found[name].seeds for name in members)]
        if len(members) < 2 or not seeds:
            continue
        at = {name: [found[name].seeds.index(seed) for seed in seeds] for name in members}
        whole = Sample.of(np.stack([found[name].values[0, at[name]] for name in members]), seeds)
        base = [found[results.reference]] if results.reference in sound(found) else []
        replicates = replicate([whole, *base], log_score)
        score = _exp(replicates.interval([1.0, 0.0][: 1 + len(base)]))
        ratio = _exp(replicates.interval([-1.0, 1.0])) if base else Interval(math.nan)
        each = [float(np.exp(log_score(run[None], (None, None, None))[0][0])) for run in whole.values]
        rows.append((method, members, *score, *ratio, min(each), max(each)))
    flat = [f"{figure}{end}" for figure in ("score", "ratio") for end in ("", "_low", "_high")]
    columns = ["method", "members", *flat, "best", "worst"]
    return pd.DataFrame(rows, columns=columns)
