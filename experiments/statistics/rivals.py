"""Learned against classical: two controllers side by side, scenario by scenario, and what was spent on each.

Errors and gains are over the runs in which neither of the two failed, on the same seeds, with the intervals of
:mod:`bootstrap`; how many runs failed and touched the sheet stands beside them, and is no part of an error. A *gain* is
how much smaller the error is, in per cent of the other's. What a policy *closes* is a share of the distance from the
other's error to the causal bound (:mod:`..bounds`), which is that of the benchmark's seeds: on few seeds it may be more
than all of it.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from ...envs.plant.controller import INFORMATION
from . import budgets, pooling
from .bootstrap import pooled, replicate
from .comparison import better, failures, neither_failed, samples
from .intervals import Interval

SCORE = "score"
"""Name of the row over all scored scenarios."""

TAIL = "p99_true"
"""What is compared beside the score, where the runs have it."""

WORSE = 5.0
"""Per cent more error than the base's that is marked."""

_GAIN = ("one", "other", "gain", "gain_low", "gain_high")
COLUMNS = (
    *("scenario", *_GAIN, "bound", "closed", *(f"p99_{each}" for each in _GAIN)),
    *("collisions_one", "collisions_other", "failed_one", "failed_other", "runs_one", "runs_other"),
)


@dataclass(frozen=True)
class Pair:
    """Two controllers that are compared.

    Attributes:
        one: the learned one.
        other: the classical one.
        best: each is the best of its kind.
        base: the classical one is the base that the policy acts on.
        learned, classical: controllers of each kind, of which the best was taken.
    """

    one: str
    other: str
    best: bool = False
    base: bool = False
    learned: int = 1
    classical: int = 1

    @property
    def kind(self) -> str:
        """``best``, ``base`` or ``best, base``."""
        return ", ".join(word for word in ("best", "base") if getattr(self, word))


@dataclass(frozen=True)
class Effort:
    """Simulated steps and CPU-seconds of a training alone, of it with the search of its base, and of the other's
    search; NaN where they are not recorded."""

    training: float
    whole: float
    search: float
    training_cpu: float
    search_cpu: float

    @property
    def ratio(self) -> float:
        """Steps of the training over those of the search; NaN if one is not known, or nothing was searched."""
        return self.training / self.search if self.search > 0 else math.nan


def is_learned(results: Any, name: str) -> bool:
    """Whether a policy was trained in one of a controller's slots."""
    return bool(_trained(_record(results, name)))


def best(results: Any) -> Pair | None:
    """The best learned and the best classical controller of the least informed class that has both; None without.

    Of each kind it is the one that fewest are better than (:func:`comparison.better`), of several of those the closest.
    Who is not ranked because of his budget takes part: here budgets stand beside the gain.
    """
    frame = results.standings
    scored = frame[np.isfinite(frame["score"].astype(float))]
    for information in dict.fromkeys([*INFORMATION, *scored["information"]]):
        names = list(scored.index[scored["information"] == information])
        learned = [name for name in names if is_learned(results, name)]
        classical = [name for name in names if name not in learned]
        if learned and classical:
            one, other = (_first(results, scored, kind) for kind in (learned, classical))
            return Pair(one, other, best=True, learned=len(learned), classical=len(classical))
    return None


def _first(results: Any, scored: pd.DataFrame, names: list[str]) -> str:
    beaten = better(results, names).sum(axis=0).reindex(names, fill_value=len(names))
    return min(names, key=lambda name: (int(beaten[name]), float(scored.at[name, "score"])))


def with_bases(results: Any) -> list[Pair]:
    """Each learned controller whose base took part, with it: the classical one with the same parameters, to the last
    digit, and the same knowledge."""
    told = results.meta.get("parameters") or {}
    knows = dict(zip(results.runs["controller"], results.runs["information"], strict=True))
    found = []
    for name in results.controllers:
        if not is_learned(results, name) or not told.get(name):
            continue
        for other in results.controllers:
            alike = told.get(other) == told[name] and knows[other] == knows[name]
            if alike and not is_learned(results, other):
                found.append(Pair(name, other, base=True))
                break
    return found


def side_by_side(results: Any, pair: Pair) -> pd.DataFrame:
    """One row per scenario, and :data:`SCORE` last: :data:`COLUMNS`, errors in the metric's unit, gains in per cent."""
    lost, bounds = failures(results), results.bounds
    touched = results.runs["collision"] > 0 if "collision" in results.runs else lost & False
    ordinary = [name for name in results.scenarios if name not in results.exempt]
    rows = []
    for name, chosen, counted in (
        *((each, [each], [each]) for each in results.scenarios),
        (SCORE, results.scored, ordinary),
    ):
        row: dict[str, Any] = {"scenario": name, **_compared(results, pair, chosen, results.metric)}
        tail = _compared(results, pair, chosen, TAIL) if TAIL in results.runs else {}
        row |= {f"p99_{each}": tail.get(each, math.nan) for each in _GAIN}
        row["bound"] = results.bound if name == SCORE else bounds.get(name, math.nan)
        room = row["other"] - row["bound"]
        row["closed"] = 100.0 * (row["other"] - row["one"]) / room if room > 0 else math.nan
        here = results.runs["scenario"].isin(counted)
        for side in ("one", "other"):
            own = here & (results.runs["controller"] == getattr(pair, side))
            row |= {f"collisions_{side}": int(touched[own].sum()), f"failed_{side}": int(lost[own].sum())}
            row[f"runs_{side}"] = int(own.sum())
        rows.append(row)
    return pd.DataFrame(rows, columns=list(COLUMNS))


def effort(results: Any, pair: Pair) -> Effort:
    """What was spent on the two."""
    spent = budgets.budgets(results.meta.get("tuning") or {}, [pair.one, pair.other], results.reference)
    ledgers = [each.get("ledger", each) for each in _trained(_record(results, pair.one))]
    training, cpu = (_sum(ledgers, key) for key in ("simulated_steps", "cpu_seconds"))
    whole = float(spent.at[pair.one, "tuning_steps"])
    search, search_cpu = (float(spent.at[pair.other, key]) for key in ("tuning_steps", "tuning_cpu"))
    return Effort(training, whole, search, cpu, search_cpu)


def pairs(results: Any) -> list[Pair]:
    """Every comparison of a grid: the best learned with the best classical controller, then each learned one with its
    base, if it is not the same pair."""
    first, bases = best(results), with_bases(results)
    if first is None:
        return bases
    same = any((each.one, each.other) == (first.one, first.other) for each in bases)
    others = [each for each in bases if (each.one, each.other) != (first.one, first.other)]
    return [replace(first, base=same), *others]


def table(results: Any) -> pd.DataFrame:
    """All of them, as ``learned.csv`` has them; empty if there is none."""
    names = {column: column.replace("_one", "_learned").replace("_other", "_classical") for column in COLUMNS}
    names |= {"one": "error_learned", "other": "error_classical"}
    parts = []
    for pair in pairs(results):
        frame = side_by_side(results, pair).rename(columns=names)
        frame.insert(0, "kind", pair.kind)
        frame.insert(0, "classical", pair.other)
        frame.insert(0, "learned", pair.one)
        parts.append(frame)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


# ------------------------------------------------------------------------------------------------------------------


def _compared(results: Any, pair: Pair, chosen: list[str], metric: str) -> dict[str, float]:
    """Both figures of a metric over some scenarios, and the gain with its interval; NaN where there is none."""
    nothing = dict.fromkeys(_GAIN, math.nan)
    view = replace(results, metric=metric, runs=results.runs.assign(failed=failures(results)))
    found, power = samples(view, [pair.one, pair.other], chosen), pooling.power(metric)
    if len(found) < 2 or not math.isfinite(power):
        return nothing
    both = neither_failed(found[pair.one], found[pair.other])
    if both is None or any((sample.values <= 0).any() for sample in both):
        return nothing
    replicates = replicate(both, pooled(power))
    one, other = (float(np.exp(value)) for value in replicates.value)
    ratio: Interval = replicates.interval([1.0, -1.0])
    gain, high, low = (100.0 * (1.0 - float(np.exp(end))) for end in ratio)
    return {"one": one, "other": other, "gain": gain, "gain_low": low, "gain_high": high}


def _record(results: Any, name: str) -> dict[str, Any]:
    return (results.meta.get("tuning") or {}).get(name) or {}


def _trained(record: dict[str, Any]) -> list[dict[str, Any]]:
    """What is recorded of the policies in the slots of a controller."""
    return [body["policy"] for body in budgets.slots(record).values() if isinstance(body.get("policy"), dict)]


def _sum(ledgers: list[dict[str, Any]], key: str) -> float:
    found = [float(each[key]) for each in ledgers if each.get(key) is not None]
    return sum(found) if found and len(found) == len(ledgers) else math.nan
