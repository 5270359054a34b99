"""Cells of the page's headline table."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from ...envs.figures.quality import iso_range
from ...envs.figures.registered import Metric
from ...envs.scenarios.material import material
from ..measure.stability import LIMIT_MS
from ..statistics.budgets import MARKS
from ..statistics.intervals import wilson
from .numbers import ends, fixed, known, number, part, percent, share_of_period, span
from .standing import Standing
from .suite import Suite


@dataclass(frozen=True)
class Cell:
    """What stands in a cell: text, what it is sorted by, small print under it, a mark (``best``, ``tied``, ``bad``)."""

    text: str
    value: float = math.nan
    small: str = ""
    mark: str = ""
    title: str = ""


Cells = dict[str, Cell]
"""By controller."""


def of_summary(
    suite: Suite, column: str, form: Callable[[float], str] = number, bad: Callable[[float], bool] = lambda _: False
) -> Cells:
    """A column of the summary, with its interval if it has one there."""
    out = {}
    for name in suite.ranked:
        low, value, high = ends(suite.summary.loc[name], column)
        below = span(low, high, known(low, high, value)) if math.isfinite(low) else ""
        out[name] = Cell(form(value), value, below, mark="bad" if bad(value) else "")
    return out


def in_words(suite: Suite, column: str) -> Cells:
    """A column of the summary that holds words."""
    return {name: Cell(str(suite.summary.at[name, column])) for name in suite.ranked}


def estimates(standing: Standing, small: dict[str, str] | None = None) -> Cells:
    """A figure with its interval; the best of those that may be ranked and who is tied with it are marked.

    With ``small`` the interval is only seen when the cell is pointed at, and these words stand below the figure.
    """
    out = {}
    for name, row in standing.frame.iterrows():
        low, value, high = ends(row, "score")
        if not math.isfinite(value):
            out[str(name)] = Cell("failed" if row["note"] else "–", mark="bad")
            continue
        places = known(low, high, value)
        several = len(standing.ranked) > 1 and standing.varies
        mark = "best" if several and name == standing.best else "tied" if several and name in standing.tied else ""
        interval = span(low, high, places)
        below = interval if small is None else small.get(str(name), "")
        out[str(name)] = Cell(fixed(value, places), value, below, mark, f"95 %: {interval} {standing.unit}")
    return out


def ranks(standing: Standing) -> Cells:
    """Places; who has none says why where it is pointed at."""
    rows = standing.frame.iterrows()
    return {str(name): Cell(fixed(row["rank"], 0), row["rank"], title="; ".join(row["reasons"])) for name, row in rows}


def against(standing: Standing, figure: str) -> Cells:
    """The ``scale``, the ``ratio`` to the reference, or the ``wins`` over it."""
    out = {}
    for key, row in standing.frame.iterrows():
        name = str(key)
        low, value, high = ends(row, "wins" if figure == "wins" else "ratio")
        if figure == "wins":
            text, below = percent(value), span(100 * low, 100 * high, 0)
        else:
            if figure == "scale":
                low, value, high = (standing.scale(name, f"ratio{end}") for end in ("_low", "", "_high"))
            places = 2 if figure == "scale" or value < 10 else 1
            text, below = fixed(value, places), span(low, high, places)
        base = name == standing.suite.reference
        out[name] = Cell("–") if base and figure == "wins" else Cell(text, value, "" if base else below)
    return out


def counted(suite: Suite, column: str) -> Cells:
    """``collisions`` or ``failed`` of the runs, with Wilson's interval."""
    out = {}
    for name, row in suite.summary.iterrows():
        rate = wilson(int(row[column]), int(row["runs"]))
        small = f"{100 * rate.low:.2g}–{100 * rate.high:.2g} %" if row["runs"] else ""
        mark = "bad" if row[column] else ""
        out[str(name)] = Cell(part(row[column], row["runs"]), float(row[column]), small, mark)
    return out


def of_metric(suite: Suite, standings: dict[str, Standing], metric: Metric) -> Cells:
    """Those that the page compares with their standing, others with the interval they have."""
    if metric.name not in standings:
        return of_summary(suite, metric.column)
    small = {n: text if text in ("–", "outside") else f"range {text}" for n, text in _iso(suite, metric).items()}
    return estimates(standings[metric.name], small)


def _iso(suite: Suite, metric: Metric) -> dict[str, str]:
    """Ranges after ISO 9013 of a metric that the standard knows, by controller."""
    if suite.jobs:
        column = {"roughness": "iso_roughness", "taper": "iso_taper"}.get(metric.name)
        return {name: str(suite.summary.at[name, column]) for name in suite.ranked} if column else {}
    thin = material("thin-sheet")
    rough = {n: float(suite.summary.at[n, "roughness"]) for n in suite.ranked} if metric.name == "roughness" else {}
    return {n: iso_range(1e-3 * r, thin.thickness) for n, r in rough.items() if math.isfinite(r)}


def of_stability(suite: Suite, column: str, form: Callable[[float], str]) -> Cells:
    """Ms or a margin; what was not measured says why where it is pointed at."""
    why: dict[str, list[str]] = {}
    for row in suite.stability.itertuples():
        if row.reason:
            why.setdefault(str(row.controller), []).append(f"not measured on {row.machine}: {row.reason}")
    found = of_summary(suite, column, form, lambda v: column.startswith("ms") and v > LIMIT_MS)
    return {n: replace(c, title="; ".join(why.get(n, ())) if math.isnan(c.value) else "") for n, c in found.items()}


def decisions(suite: Suite) -> Cells:
    """What a decision costs."""
    costs = suite.results.decisions().astype(float)
    took = {name: float(costs.at[name, "median_us"]) for name in suite.ranked}
    return {
        name: Cell("< 0.01" if us < 0.01 else number(us), us, share_of_period(float(costs.at[name, "ratio"])))
        for name, us in took.items()
    }


def budget(suite: Suite, column: str, form: Callable[[float], str]) -> Cells:
    """What tuning or training took; marked where that is not an equal budget."""
    out = {}
    for name, cell in of_summary(suite, column, form).items():
        mark, cpu = str(suite.summary.at[name, "budget"]), float(suite.summary.at[name, "tuning_cpu"])
        small = f"{fixed(cpu, 0)} CPU-s" if column == "tuning_steps" and cpu > 0 else ""
        out[name] = Cell(cell.text, cell.value, small, "bad" if mark else "", MARKS.get(mark, ""))
    return out


def evidence(suite: Suite) -> Cells:
    """Whether the figures of the cut stand on what was calibrated."""
    out = {}
    for name, row in suite.summary.iterrows():
        share = float(row.get("extrapolated", math.nan))
        beyond = Cell("extrapolated", share, percent(share), "bad", str(row["beyond"]))
        out[str(name)] = beyond if share > 0 else Cell("inside" if share == 0 else "–", share)
    return out
