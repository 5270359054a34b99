"""The headline table: controllers × everything that is asked about them, in groups of columns."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from ...envs.figures.quality import iso_range
from ...envs.figures.registered import Metric
from ...envs.scenarios.material import material
from ..measure.margins import DELAYS, GAINS
from ..measure.margins import in_words as margin
from ..statistics import comparison
from ..statistics.budgets import MARKS
from ..statistics.intervals import wilson
from . import headings
from .headings import HOW
from .numbers import fixed, known, listed, million, number, part, percent, share_of_period, span
from .sensitivity import LIMIT_MS
from .standing import Standing
from .suite import Suite

FOLLOWERS = {"true gap error": True, "reported": False, "cut of thin sheet": False, "command": False}
JOBS = {"contour error": True, "true gap error": False, "cut": True, "time": True}
"""Groups of metrics in the page's order; whether each is also on a narrow screen. Others follow."""

SELDOM = ("through", "kerf")
"""Metrics that seldom differ, which stand last in their group."""

OVER_SCORED = "mean over seeds, geometric mean over the scenarios of the score"
"""How most metrics of followers are pooled, in words."""


@dataclass(frozen=True)
class Cell:
    """What stands in a cell: text, what it is sorted by, small print under it, a mark (``best``, ``tied``, ``bad``)."""

    text: str
    value: float = math.nan
    small: str = ""
    mark: str = ""
    title: str = ""


@dataclass(frozen=True)
class Column:
    """A column: title, unit or direction under it, its cells by controller; ``meaning`` stands below the table.
    ``shows`` names the column of ``summary.csv`` with the same figures."""

    title: str
    under: str
    cells: dict[str, Cell]
    meaning: str = ""
    shows: str = ""


@dataclass(frozen=True)
class Group:
    """Columns under one heading, shown and hidden together; ``first``: also on a narrow screen."""

    title: str
    columns: list[Column] = field(default_factory=list)
    first: bool = False


def groups(suite: Suite, standings: dict[str, Standing]) -> list[Group]:
    """The columns of a suite, without those that hold nothing."""
    own = _job_ends(suite) if suite.jobs else _follower_ends(suite)
    made = [_score(suite, standings), *_metrics(suite, standings), *own, _budget(suite)]
    kept = []
    for group in made:
        columns = [c for c in group.columns if any(cell.text != "–" for cell in c.cells.values())]
        if columns:
            kept.append(Group(group.title, columns, group.first))
    return kept


def methods(suite: Suite) -> list[dict[str, str]]:
    """Rows of the methods that were trained or tuned several times, with all their trainings together."""
    rows = []
    for row in comparison.methods(suite.results).to_dict("records"):
        ends = {}
        for name in ("score", "ratio"):
            low, value, high = (float(row[f"{name}{end}"]) for end in ("_low", "", "_high"))
            places = known(low, high, value)
            ends[name], ends[f"{name}_span"] = fixed(value, places), span(low, high, places)
        rows.append({
            "method": str(row["method"]), "members": str(len(row["members"])), **ends, "best": number(row["best"]),
            "worst": number(row["worst"]),
        })  # fmt: skip
    return rows


def _score(suite: Suite, standings: dict[str, Standing]) -> Group:
    own = standings[suite.metric]
    metric, frame, reference = suite.metrics[suite.metric], own.frame, suite.reference
    rank, score, ratio, wins = {}, {}, {}, {}
    for key, row in frame.iterrows():
        name = str(key)
        place = float(row["rank"])
        rank[name] = Cell(f"{place:.0f}" if place == place else "–", place, title="; ".join(row["reasons"]))
        low, value, high = (own.scale(name, column) for column in ("ratio_low", "ratio", "ratio_high"))
        score[name] = Cell(fixed(value, 2), value, span(low, high, 2) if name != reference else "")
        low, value, high = (float(row[column]) for column in ("ratio_low", "ratio", "ratio_high"))
        places = 2 if value < 10 else 1
        ratio[name] = Cell(fixed(value, places), value, span(low, high, places) if name != reference else "")
        low, value, high = (float(row[column]) for column in ("wins_low", "wins", "wins_high"))
        won = Cell(percent(value), value, span(100 * low, 100 * high, 0))
        wins[name] = won if name != reference else Cell("–")
    how = f"{HOW[metric.pooled]} over seeds, {suite.scored_in_words}"
    return Group("score" if suite.following else "ranked by", [
        Column("rank", "1 is best", rank, "among those of its information class that may be ranked; who cannot be told "
               "apart at 95 %, all comparisons together, shares it; who fails significantly more often stands below",
               "rank"),
        Column("failed", "runs", _failed(suite), "runs that touched the sheet where they should not, hold a number "
               "that is not finite, have nothing to score or are not finished; no other figure but rank and wins is of "
               "them", "failed"),
        Column("scale", "0 to 1", score, f"0 is {reference}, 1 is {suite.informed}, logarithmic between them",
               "scale" if suite.following else ""),
        Column(ranked_by(suite), metric.unit, _estimates(own), f"{metric.summary}: {how}, of the runs that did not "
               "fail; what is ranked", "score" if suite.following else metric.name),
        Column("better", "× refer\u00adence", ratio, f"that of {reference} over this one, same seeds, of the runs in "
               "which neither failed; above 1 is better than the reference", "ratio"),
        Column("wins", "of runs", wins, f"how often a single run is better than that of {reference} on the same seed "
               "(probability of improvement); a failed run is never better", "wins"),
    ], first=True)  # fmt: skip


def _estimates(standing: Standing, small: dict[str, str] | None = None) -> dict[str, Cell]:
    """A figure with its interval; the best of those that may be ranked and who is tied with it are marked.

    With ``small`` the interval is only seen when the cell is pointed at, and these words stand below the figure.
    """
    cells = {}
    for name, row in standing.frame.iterrows():
        low, value, high = (float(row[f"score{end}"]) for end in ("_low", "", "_high"))
        if not math.isfinite(value):
            cells[name] = Cell("failed" if row["note"] else "–", mark="bad")
            continue
        places = known(low, high, value)
        several = len(standing.ranked) > 1 and standing.varies
        mark = "best" if several and name == standing.best else "tied" if several and name in standing.tied else ""
        interval = span(low, high, places)
        below = interval if small is None else small.get(str(name), "")
        cells[str(name)] = Cell(fixed(value, places), value, below, mark, f"95 %: {interval} {standing.unit}")
    return cells


def _from(
    suite: Suite, column: str, form: Callable[[float], str] = number, bad: Callable[[float], bool] = lambda _: False
) -> dict[str, Cell]:
    """Cells of a column of the summary, with its interval if it has one there."""
    out = {}
    for name in suite.ranked:
        row = suite.summary.loc[name]
        value, low, high = (float(row.get(f"{column}{end}", math.nan)) for end in ("", "_low", "_high"))
        below = span(low, high, known(low, high, value)) if math.isfinite(low) else ""
        out[name] = Cell(form(value), value, below, mark="bad" if bad(value) else "")
    return out


def _collisions(suite: Suite) -> Column:
    total = "runs"
    cells = {}
    for name, row in suite.summary.iterrows():
        rate = wilson(int(row["collisions"]), int(row[total])) if row[total] else None
        small = f"{100 * rate.low:.2g}–{100 * rate.high:.2g} %" if rate else ""
        cells[str(name)] = Cell(
            part(row["collisions"], row[total]), float(row["collisions"]), small, "bad" if row["collisions"] else ""
        )
    left = f"; {', '.join(suite.exempt)} are built to defeat followers and left out" if suite.exempt else ""
    return Column(
        "touched",
        "runs",
        cells,
        f"runs in which the nozzle touched the sheet, with Wilson's interval{left}",
        "collisions",
    )


def _failed(suite: Suite) -> dict[str, Cell]:
    cells = {}
    for name, row in suite.summary.iterrows():
        rate = wilson(int(row["failed"]), int(row["runs"]))
        small = f"{100 * rate.low:.2g}–{100 * rate.high:.2g} %"
        text = part(row["failed"], row["runs"])
        cells[str(name)] = Cell(text, float(row["failed"]), small, "bad" if row["failed"] else "")
    return cells


def _metrics(suite: Suite, standings: dict[str, Standing]) -> list[Group]:
    """The columns of metrics in the groups that they name."""
    order = JOBS if suite.jobs else FOLLOWERS
    found: dict[str, list[Column]] = {title: [] for title in order}
    metrics = [c.metric for c in headings.of(suite.results) if c.metric and c.metric.name in suite.metrics]
    for metric in sorted(metrics, key=lambda m: m.name in SELDOM):
        assert metric.shown
        column = _of_metric(suite, standings, metric)
        if metric.name != "through" or any(cell.text != "1.00" for cell in column.cells.values()):
            found.setdefault(metric.shown.group, []).append(column)
    if suite.jobs:
        found["cut"] = [_evidence(suite), *found["cut"]]
        if suite.metric == "roughness":
            iso = {name: Cell(str(suite.summary.at[name, "iso_roughness"])) for name in suite.ranked}
            said = "ranges of its roughness after ISO 9013; 1 is the finest"
            found["cut"].insert(2, Column("Rz", "range, ISO 9013", iso, said))
    return [Group(title, own, order.get(title, False)) for title, own in found.items()]


def _of_metric(suite: Suite, standings: dict[str, Standing], metric: Metric) -> Column:
    """A metric as it says; those that the page compares with their standing, others with the interval they have."""
    shown, unit = metric.shown, metric.unit if metric.unit != "1" else "share"
    assert shown
    small, ranges = {}, _iso(suite, metric)
    if ranges:
        small = {name: _range(text) for name, text in ranges.items()}
    if metric.name == "roughness" or metric.name == "taper":
        unit += ", ISO 9013"
    if not shown.brief:
        unit += f", {metric.better} is better"
    cells = _estimates(standings[metric.name], small) if metric.name in standings else _from(suite, metric.column)
    meaning = shown.said.format(summary=metric.summary, over=OVER_SCORED) or headings.said(metric)
    return Column(shown.head or metric.label, unit, cells, meaning, metric.column)


def _iso(suite: Suite, metric: Metric) -> dict[str, str]:
    """Ranges after ISO 9013 of a metric that the standard knows, by controller."""
    if suite.jobs:
        column = {"roughness": "iso_roughness", "taper": "iso_taper"}.get(metric.name)
        return {name: str(suite.summary.at[name, column]) for name in suite.ranked} if column else {}
    thin = material("thin-sheet")
    rough = {n: float(suite.summary.at[n, "roughness"]) for n in suite.ranked} if metric.name == "roughness" else {}
    return {n: iso_range(1e-3 * r, thin.thickness) for n, r in rough.items() if math.isfinite(r)}


def _follower_ends(suite: Suite) -> list[Group]:
    """Stability, safety and what a decision costs."""
    assert suite.following
    costs = suite.following.decisions()
    decided = {
        n: Cell(_microseconds(float(costs.at[n, "median_us"])), float(costs.at[n, "median_us"]),
                share_of_period(float(costs.at[n, "ratio"])))
        for n in suite.ranked
    }  # fmt: skip
    return [
        Group("stability", _stability(suite)),
        Group("safety", [_collisions(suite)]),
        Group("decision", [
            Column("time", "µs, P99 of period", decided, "median time that the law takes for a command, on one core; "
                   "below it the 99th percentile as a share of the control period"),
        ]),
    ]  # fmt: skip


def _stability(suite: Suite) -> list[Column]:
    """Ms by either signal, and the margins; what was not measured says why where it is pointed at."""
    assert suite.following
    measured = suite.following.stability
    where = {str(n): list(rows["machine"]) for n, rows in measured.groupby("controller")} if len(measured) else {}
    many = max((len(machines) for machines in where.values()), default=1)
    worst = f"on the worst corner plant of the {many} machines that were run" if many > 1 else (
        "on the worst corner plant of the machine that was run"
    )  # fmt: skip
    lacking = measured[measured["reason"] != ""] if len(measured) else measured
    why = {
        str(name): "; ".join(f"not measured on {row.machine}: {row.reason}" for row in rows.itertuples())
        for name, rows in (lacking.groupby("controller") if len(lacking) else ())
    }  # fmt: skip

    def cells(column: str, form: Callable[[float], str] = number) -> dict[str, Cell]:
        found = _from(suite, column, form, lambda v: column.startswith("ms") and v > LIMIT_MS)
        return {
            name: replace(cell, title=why.get(name, "") if math.isnan(cell.value) else "")
            for name, cell in found.items()
        }

    return [
        Column("Ms", f"sine, ≤ {LIMIT_MS:g}", cells("ms"), "largest share of a small sine of the sheet that shows in "
               f"the gap, over frequencies, {worst}; tells little of a controller that learns: it learns the sine",
               "ms"),
        Column("Ms", f"noise, ≤ {LIMIT_MS:g}", cells("ms_noise"), "the same with all frequencies at once, "
               f"which nobody can learn: cross-spectrum of gap and sheet over the sheet's spectrum, {worst}, with its "
               "interval", "ms_noise"),
        Column("gain", "× margin", cells("gain_margin", lambda v: margin(v, GAINS[-1])), "factor on the loop's gain up "
               f"to which a step still settles {worst}", "gain_margin"),
        Column("delay", "ms margin", cells("delay_margin", lambda v: margin(v, DELAYS[-1])), "additional dead time up "
               "to which it does; both found by simulation, so friction and limits count", "delay_margin"),
    ]  # fmt: skip


def ranked_by(suite: Suite) -> str:
    """What the suite ranks by, for a heading."""
    return "score" if suite.following else suite.metrics[suite.metric].label


def unmeasured(suite: Suite) -> list[str]:
    """Why some have no Ms or no margins, in sentences."""
    measured = suite.following.stability if suite.following else None
    if measured is None or not len(measured):
        return []
    found = measured[measured["reason"] != ""].groupby(["machine", "reason"], sort=False)["controller"]
    return [f"{', '.join(names)} on the machine {machine}: {why}" for (machine, why), names in found]


def by_machine(suite: Suite) -> list[dict[str, Any]]:
    """Rows of Ms and margins machine by machine, where there are several."""
    measured = suite.following.stability if suite.following else None
    if measured is None or not len(measured) or measured["machine"].nunique() < 2:
        return []
    scenarios = suite.following.machines if suite.following else {}
    return [
        {
            "machine": str(row["machine"]), "scenarios": listed(scenarios.get(row["machine"], [])),
            "name": str(row["controller"]), "ms": number(row["ms"]), "noise": number(row["ms_noise"]),
            "span": span(row["ms_noise_low"], row["ms_noise_high"], 2), "gain": margin(row["gain_margin"], GAINS[-1]),
            "delay": margin(row["delay_margin"], DELAYS[-1]), "reason": str(row["reason"]),
            "high": bool(row["ms"] > LIMIT_MS), "high_noise": bool(row["ms_noise"] > LIMIT_MS),
        }
        for _, row in measured.iterrows()
    ]  # fmt: skip


def _microseconds(value: float) -> str:
    return "< 0.01" if value < 0.01 else number(value)


def _job_ends(suite: Suite) -> list[Group]:
    return [Group("safety", [_collisions(suite)])]


def _evidence(suite: Suite) -> Column:
    """Whether the figures of the cut stand on what was calibrated."""
    cells = {}
    for name, row in suite.summary.iterrows():
        share = float(row.get("extrapolated", math.nan))
        if share > 0:
            cells[str(name)] = Cell("extrapolated", share, percent(share), "bad", str(row["beyond"]))
        else:
            cells[str(name)] = Cell("inside" if share == 0 else "–", share)
    meaning = (
        "whether dross, Rz, u, through and kerf lie within the settings that they were calibrated on; else the share "
        "of the cut that does not, and, when pointed at, in what"
    )
    return Column("evidence", "of the cut", cells, meaning)


def _range(text: str) -> str:
    return text if text in ("–", "outside") else f"range {text}"


def _budget(suite: Suite) -> Group:
    summary = suite.summary

    def cells(column: str, form: Callable[[float], str]) -> dict[str, Cell]:
        out = {}
        for name, cell in _from(suite, column, form).items():
            mark, cpu = str(summary.at[name, "budget"]), float(summary.at[name, "tuning_cpu"])
            small = f"{fixed(cpu, 0)} CPU-s" if column == "tuning_steps" and cpu > 0 else ""
            out[name] = Cell(cell.text, cell.value, small, "bad" if mark else "", MARKS.get(mark, ""))
        return out

    return Group("budget", [
        Column("trials", "of tuning", cells("trials", lambda v: fixed(v, 0)), "candidates of a search"),
        Column("steps", "million", cells("tuning_steps", lambda v: million(v) if v == v else "–"), "simulated steps of "
               "tuning or training, and below them its CPU-seconds"),
    ])  # fmt: skip
