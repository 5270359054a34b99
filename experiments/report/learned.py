"""Learned against classical: tables of the page and of the terminal, and who spent how much."""

import math
from dataclasses import dataclass
from typing import Any

import pandas as pd

from ..results.conclusions import Results
from ..statistics.budgets import SLACK
from ..statistics.rivals import SCORE, WORSE, Effort, Pair, effort, is_learned, pairs, side_by_side
from .numbers import count, ends, fixed, listed, million, number, part, span
from .suite import Suite

MOST = 999.0
"""Per cent; an interval that reaches farther down says only that."""


@dataclass(frozen=True)
class Comparison:
    """Two controllers with their rows."""

    pair: Pair
    rows: pd.DataFrame

    @property
    def score(self) -> Any:
        """The row over all scored scenarios."""
        return self.rows.iloc[-1]

    @property
    def apart(self) -> pd.DataFrame:
        """The rows of the scenarios."""
        return self.rows.iloc[:-1]

    @property
    def closer(self) -> list[str]:
        """Scenarios in which the learned one is surely closer."""
        return list(self.apart.loc[self.apart["gain_low"] > 0, "scenario"])

    @property
    def farther(self) -> list[str]:
        """Scenarios in which it is surely farther."""
        return list(self.apart.loc[self.apart["gain_high"] < 0, "scenario"])

    @property
    def worse(self) -> list[str]:
        """Scenarios in which its error is larger by more than :data:`WORSE` per cent."""
        return list(self.apart.loc[self.apart["gain"] < -WORSE, "scenario"])


def comparisons(results: Results) -> list[Comparison]:
    """All of a grid."""
    return [Comparison(pair, side_by_side(results, pair)) for pair in pairs(results)]


# ---------------------------------------------------------------------------------------------------- in words


def spent(name: str, other: str, own: Effort) -> str:
    """What the two had, and whether that is at equal steps."""
    trained = _steps(own.training, own.training_cpu)
    beside = f"; with the search of what it starts from {_steps(own.whole)}" if own.whole > own.training else ""
    words = f"{name} was trained for {trained}{beside}. "
    words += f"{other} was not searched. " if own.search == 0 else f"The search of {other} took "
    if own.search != 0:
        words += f"{_steps(own.search, own.search_cpu)}. "
    if not math.isfinite(own.ratio):
        return words + "So nothing can be said of equal steps."
    if own.ratio <= SLACK:
        alone = f"{number(own.ratio)} times the steps of that search"
        return words + f"So the training alone had no more than equal steps: {alone}."
    return words + f"So the training had {number(own.ratio)} times the steps of that search: not at equal steps."


def _steps(steps: float, cpu: float | None = None) -> str:
    """``51.6 million simulated steps (193 CPU-s)``."""
    words = "steps that are not recorded" if math.isnan(steps) else f"{million(steps)} million simulated steps"
    if cpu is None:
        return words
    return f"{words} ({'CPU time not recorded' if math.isnan(cpu) else f'{cpu:.0f} CPU-s'})"


def headline(comparison: Comparison, one: str, other: str, unit: str) -> str:
    """The comparison in a sentence."""
    row = comparison.score
    if not math.isfinite(row["gain"]):
        return f"{one} and {other} have no scored scenario in which neither failed, so they cannot be compared."
    low, gain, high = ends(row, "gain")
    word, sure = "closer" if gain > 0 else "farther", low > 0 or high < 0
    least, most = (low, high) if gain > 0 or not sure else (-high, -low)
    within = f" ({interval(least, most)})" if math.isfinite(low) else ""
    told = f"{one} is {fixed(abs(gain), 1)} %{within} {word} than {other}"
    chance = "" if sure or not within else ", which may be chance"
    return f"{told}{chance}: {number(row['one'])} against {number(row['other'])} {unit}."


def interval(low: float, high: float) -> str:
    """Of a gain in per cent; how much worse than :data:`MOST` a few runs leave open is not told."""
    return f"< −{MOST:.0f} to {fixed(high, 1)}" if low < -MOST else span(low, high, 1)


def choice(pair: Pair) -> str:
    """How the two were chosen."""
    if not pair.best or pair.learned == pair.classical == 1:
        return ""
    many = f"{count(pair.learned, 'learned controller')} and {count(pair.classical, 'classical one')}"
    return f"Each is the best of its kind, of {many}, chosen on these very seeds, which flatters both."


def beside_base(comparison: Comparison) -> str:
    """Whether a policy is anywhere worse than the base that it hands over to."""
    bad, row = comparison.worse, comparison.score
    touched = [part(row[f"collisions_{side}"], row[f"runs_{side}"]) for side in ("one", "other")]
    where = f"in {listed(bad)}" if bad else "nowhere"
    words = f"{comparison.pair.other} is its base: more than {WORSE:g} % worse than that {where}, "
    return words + f"collisions in {touched[0]} runs against {touched[1]}."


# ------------------------------------------------------------------------------------------------------- the page


def chapter(suite: Suite, labels: dict[str, str]) -> dict[str, Any] | None:
    """The section of a suite; None if no policy took part."""
    results = suite.results
    learned = [name for name in results.controllers if is_learned(results, name)]
    if not learned:
        return None
    unit = suite.metrics[suite.metric].unit
    tables = [_table(suite, each, labels, unit) for each in comparisons(results)]
    why = ""
    if not tables or not tables[0]["best"]:
        why = f"{listed(labels[n] for n in learned)}: no classical controller with the same information is here."
        if len(learned) == len(results.controllers):
            why = "Only learned controllers took part, so there is nothing to compare them with."
    return {"tables": tables, "why": why, "unit": unit}


def _table(suite: Suite, comparison: Comparison, labels: dict[str, str], unit: str) -> dict[str, Any]:
    pair, rows = comparison.pair, comparison.rows
    one, other = labels[pair.one], labels[pair.other]
    has = {key: bool(rows[column].notna().any()) for key, column in (("bound", "bound"), ("p99", "p99_gain"))}
    title = f"{one} against {'its base ' * pair.base}{other}"
    words = [choice(pair), spent(one, other, effort(suite.results, pair))]
    words += [beside_base(comparison)] if pair.base else []
    marked = comparison.worse if pair.base else comparison.farther
    shown = [_row(suite, row, row["scenario"] in marked) for _, row in rows.iterrows()]
    lead = headline(comparison, one, other, unit)
    at = {"id": f"learned-{suite.name}-{'best' if pair.best else suite.results.controllers.index(pair.one)}"}
    names = {"one": one, "other": other, "one_name": pair.one, "other_name": pair.other}
    return {
        **at,
        "title": title,
        "lead": lead,
        "best": pair.best,
        "base": pair.base,
        "words": words,
        "rows": shown,
        **has,
        **names,
    }


def _row(suite: Suite, row: Any, bad: bool) -> dict[str, Any]:
    score = row["scenario"] == SCORE
    name = suite.scored_in_words if score else row["scenario"]
    cells = {"name": name, "score": score, "bad": bad, "exempt": row["scenario"] in suite.exempt}
    for figure in ("one", "other", "bound", "p99_one", "p99_other"):
        cells[figure] = number(float(row[figure]))
    for figure in ("gain", "p99_gain"):
        low, value, high = ends(row, figure)
        cells[figure], cells[f"{figure}_span"] = fixed(value, 1), interval(low, high)
        cells[f"{figure}_value"] = "" if math.isnan(value) else value
        cells[f"{figure}_sure"] = bool(low > 0)
    cells["bound"] = "0" if row["bound"] == 0 else cells["bound"]
    cells["closed"] = "–" if math.isnan(row["closed"]) else fixed(row["closed"], 0)
    for side in ("one", "other"):
        for what in ("collisions", "failed"):
            cells[f"{what}_{side}"] = part(row[f"{what}_{side}"], row[f"runs_{side}"])
    cells["touches"] = bool(row["collisions_one"] > row["collisions_other"] and not cells["exempt"])
    untouched = row["failed_one"] == row["collisions_one"] and row["failed_other"] == row["collisions_other"]
    cells["others"] = "" if untouched or cells["exempt"] else f"{row['failed_one']} and {row['failed_other']} failed"
    return cells
