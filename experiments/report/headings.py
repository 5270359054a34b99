"""The columns of a benchmark's table, once: terminal and Markdown print them, the page shows them in groups.

A column of a metric is made of what the metric says about itself (:class:`envs.figures.registered.Metric`); so a metric
that is registered stands in every table. The others, such as rank and margins, are listed here.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ...envs.figures.registered import Metric
from ..measure.margins import DELAYS, GAINS
from ..measure.margins import in_words as margin
from ..measure.stability import LIMIT_MS
from ..results.conclusions import Results
from ..statistics.budgets import in_words as of_budget
from . import cells
from .cells import Cells
from .numbers import fixed, million
from .numbers import number as digits
from .standing import Standing
from .suite import Suite

HOW = {"rms": "RMS", "mean": "mean", "largest": "the largest", "smallest": "the smallest"}
"""How a metric is pooled over the seeds, in words."""

OVER = {"rms": "geometric mean", "mean": "geometric mean", "largest": "largest", "smallest": "smallest"}
"""How a metric is pooled over the scenarios, in words."""

OVER_SCORED = "mean over seeds, geometric mean over the scenarios of the score"
"""How most metrics of followers are pooled, in words."""

BESIDE = 8
"""Scenarios that have a column beside the score; more of them get a table of their own."""


@dataclass(frozen=True)
class OnPage:
    """A column as the page has it: its group, its heading, unit or direction under it, what it means, and its cells;
    ``place`` below 0: first in its group, above 0: last, and only where it is not 1 for all."""

    group: str
    head: str
    under: str
    meaning: str
    cells: Callable[[Suite, dict[str, Standing]], Cells]
    place: int = 0


@dataclass(frozen=True)
class Column:
    """A column: heading in print, name in ``summary.csv``, how a row of that is printed, how the page has it.

    Print is without those that have no title, the page without those that have nothing there.
    """

    title: str = ""
    shows: str = ""
    text: Callable[[Any], str] = str
    page: OnPage | None = None


def of(results: Results) -> list[Column]:
    """The columns of a grid, in the order in which they are printed."""
    suite, metrics = Suite("", results), []
    for metric in results.shown:
        if metric.name == "jitter":
            metrics += stable(suite)  # stands between errors and what they cost
        if metric.name != results.metric:
            metrics.append(_of_metric(suite, metric))
        if suite.jobs and metric.name == "roughness":
            words = "ranges of its roughness after ISO 9013; 1 is the finest"
            page = OnPage(
                "cut", "Rz", "range, ISO 9013", words, lambda suite, _: cells.in_words(suite, "iso_roughness")
            )
            by_range = Column("ISO 9013", "iso_roughness", lambda row: str(row["iso_roughness"]))
            metrics.append(by_range if results.metric != "roughness" else replace(by_range, page=page))
    left = f"; {', '.join(suite.exempt)} are built to defeat followers and left out" if suite.exempt else ""
    words = f"runs in which the nozzle touched the sheet, with Wilson's interval{left}"
    touched = OnPage("safety", "touched", "runs", words, lambda suite, _: cells.counted(suite, "collisions"))
    collisions = Column("collisions", "collisions", lambda row: f"{row['collisions']}/{row['runs']}", touched)
    ends = _job_ends() if suite.jobs else _follower_ends(results)
    return [*_ranked(suite), *metrics, collisions, *ends]


def explained(results: Results) -> list[str]:
    """A line on each metric that is not brief: what it is, which way is better, how it is pooled."""
    return [f"{m.title}: {said(m)}." for m in results.shown if m.shown and not m.shown.brief]


def said(metric: Metric) -> str:
    """What a metric is, in words; of those that are not brief also which way is better."""
    better = "" if metric.shown and metric.shown.brief else f"{metric.better} is better; "
    over = "mean" if metric.zero and metric.pooled == "mean" else OVER[metric.pooled]
    return f"{metric.summary}; {better}{HOW[metric.pooled]} over seeds, {over} over scenarios"


def number(value: float | None, form: str = "{:.2f}") -> str:
    """A figure, or a dash."""
    return "–" if value is None or math.isnan(value) else form.format(value)


def plain(row: Any, name: str, form: str = "{:.2f}") -> str:
    """A figure without its interval."""
    return number(row[name], form)


def figure(row: Any, name: str, form: str = "{:.2f}") -> str:
    """A figure with its interval, such as ``2.42 (2.27 … 2.54)``; alone where there is none or it is exact."""
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    ends = "" if math.isnan(low) or low == high else f" ({form.format(low)} … {form.format(high)})"
    return number(row[name], form) + ends


def rank(row: Any) -> str:
    """``1``, ``1=`` if it is shared, a dash without one."""
    return "–" if math.isnan(row["rank"]) else f"{row['rank']:.0f}{'=' * bool(row['tied'])}"


def evidence(row: Any) -> str:
    """Whether the cut's figures stand on what was calibrated."""
    if not row["extrapolated"] > 0:
        return "–" if math.isnan(row["extrapolated"]) else "inside"
    return "extrapolated" if row["extrapolated"] >= 0.995 else f"extrapolated, {row['extrapolated']:.0%} of the cut"


def _ranked(suite: Suite) -> list[Column]:
    """Who is ranked where, by what, and against whom."""
    scored, reference = suite.metrics[suite.metric], suite.reference
    page = functools.partial(OnPage, "ranked by" if suite.jobs else "score")
    title, shows = (scored.title, scored.name) if suite.jobs else ("score, µm", "score")
    how = f"{HOW[scored.pooled]} over seeds, {suite.scored_in_words}"

    def against(figure: str) -> Callable[[Suite, dict[str, Standing]], Cells]:
        return lambda suite, standings: cells.against(standings[suite.metric], figure)

    return [
        Column("rank", "rank", rank, page(
            "rank", "1 is best", "among those of its information class that may be ranked; who cannot be told apart at "
            "95 %, all comparisons together, shares it; who fails significantly more often stands below",
            lambda suite, standings: cells.ranks(standings[suite.metric]),
        )),
        Column("failed", "failed", lambda row: f"{row['failed']}/{row['runs']}", page(
            "failed", "runs", "runs that touched the sheet where they should not, hold a number that is not finite, "
            "have nothing to score or are not finished; no other figure but rank and wins is of them",
            lambda suite, _: cells.counted(suite, "failed"),
        )),
        Column(shows="" if suite.jobs else "scale", page=page(
            "scale", "0 to 1", f"0 is {reference}, 1 is {suite.informed}, logarithmic between them", against("scale"),
        )),
        Column(title, shows, lambda row: figure(row, "score"), page(
            ranked_by(suite), scored.unit, f"{scored.summary}: {how}, of the runs that did not fail; what is ranked",
            lambda suite, standings: cells.estimates(standings[suite.metric]),
        )),
        Column(f"× {reference}", "ratio", lambda row: figure(row, "ratio"), page(
            "better", "× refer\u00adence", f"that of {reference} over this one, same seeds, of the runs in which "
            "neither failed; above 1 is better than the reference", against("ratio"),
        )),
        Column("wins", "wins", lambda row: number(
            row["wins"] if row["wins_low"] < row["wins_high"] else math.nan, "{:.0%}",  # not of the reference itself
        ), page(
            "wins", "of runs", f"how often a single run is better than that of {reference} on the same seed "
            "(probability of improvement); a failed run is never better", against("wins"),
        )),
    ]  # fmt: skip


def _of_metric(suite: Suite, metric: Metric) -> Column:
    """A column as a metric says it."""
    shown, column = metric.shown, metric.column
    assert shown
    under = metric.unit if metric.unit != "1" else "share"
    if metric.name in ("taper", "roughness"):
        under += ", ISO 9013"
    if not shown.brief:
        under += f", {metric.better} is better"
    words = shown.said.format(summary=metric.summary, over=OVER_SCORED) or said(metric)
    content = functools.partial(cells.of_metric, metric=metric)
    page = OnPage(shown.group, shown.head or metric.label, under, words, content, int(shown.seldom))
    text = plain if shown.brief else figure
    on_page = page if metric.name in suite.metrics else None
    return Column(metric.title, column, lambda row: text(row, column, shown.form), on_page)


def ranked_by(suite: Suite) -> str:
    """What a suite ranks by, for a heading."""
    return suite.metrics[suite.metric].label if suite.jobs else "score"


def stable(suite: Suite) -> list[Column]:
    """Columns of Ms and margins, which followers have; what was not measured says why where it is pointed at."""
    measured = suite.stability
    many = int(measured.groupby("controller")["machine"].size().max()) if len(measured) else 1
    worst = f"on the worst corner plant of the {f'{many} machines' if many > 1 else 'machine'} that "
    worst += "were run" if many > 1 else "was run"

    def page(head: str, under: str, meaning: str, column: str, form: Callable[[float], str] = digits) -> OnPage:
        return OnPage("stability", head, under, meaning, lambda suite, _: cells.of_stability(suite, column, form))

    return [
        Column("Ms sine", "ms", lambda row: plain(row, "ms"), page(
            "Ms", f"sine, ≤ {LIMIT_MS:g}", "largest share of a small sine of the sheet that shows in the gap, over "
            f"frequencies, {worst}; tells little of a controller that learns: it learns the sine", "ms",
        )),
        Column("Ms noise", "ms_noise", lambda row: figure(row, "ms_noise"), page(
            "Ms", f"noise, ≤ {LIMIT_MS:g}", "the same with all frequencies at once, which nobody can learn: "
            f"cross-spectrum of gap and sheet over the sheet's spectrum, {worst}, with its interval", "ms_noise",
        )),
        Column("gain", "gain_margin", lambda row: gain(row["gain_margin"]), page(
            "gain", "× margin", f"factor on the loop's gain up to which a step still settles {worst}", "gain_margin",
            gain,
        )),
        Column("delay, ms", "delay_margin", lambda row: delay(row["delay_margin"]), page(
            "delay", "ms margin", "additional dead time up to which it does; both found by simulation, so friction and "
            "limits count", "delay_margin", delay,
        )),
    ]  # fmt: skip


def gain(value: float) -> str:
    """A gain margin."""
    return margin(value, GAINS[-1])


def delay(value: float) -> str:
    """A delay margin, ms."""
    return margin(value, DELAYS[-1])


def _follower_ends(results: Any) -> list[Column]:
    """Scenarios one by one, what a decision costs, budget and class."""
    there = in_scenario(results)
    words = "median time that the law takes for a command, on one core; below it the 99th percentile as a share of "
    words += "the control period"
    time = OnPage("decision", "time", "µs, P99 of period", words, lambda suite, _: cells.decisions(suite))
    return [
        *(Column(s, text=functools.partial(there, s)) for s in core(results)),
        Column("decision, µs", text=lambda row: plain(row, "median_us"), page=time),
        Column("its P99, µs", text=lambda row: plain(row, "p99_us")),
        *_budget(),
        Column("class", text=lambda row: row["information"]),
    ]


def core(results: Results) -> list[str]:
    """The scenarios that have a column beside the score."""
    return results.scored if len(results.scored) <= BESIDE else []


def in_scenario(results: Results) -> Callable[[str, Any], str]:
    """From a scenario and a controller's row to the figure, and behind it how many runs failed, if any did."""
    pooled, suite = results.pooled(), Suite("", results)
    lost, count = suite.lost, suite.count

    def text(scenario: str, row: Any) -> str:
        at = row.name, scenario
        behind = f" ({lost.at[at]}/{count.at[at]} failed)" if lost.at[at] else ""
        return number(pooled.at[at], "{:.1f}") + behind

    return text


def _budget() -> list[Column]:
    """Budget in print, and its two parts on the page."""

    def page(under: str, unit: str, said: str, column: str, form: Callable[[float], str]) -> Column:
        return Column(page=OnPage("budget", under, unit, said, lambda suite, _: cells.budget(suite, column, form)))

    steps = "simulated steps of tuning or training, and below them its CPU-seconds"
    return [
        Column("budget", text=of_budget),
        page("trials", "of tuning", "candidates of a search", "trials", lambda v: fixed(v, 0)),
        page("steps", "million", steps, "tuning_steps", lambda v: million(v) if v == v else "–"),
    ]


def _job_ends() -> list[Column]:
    """Budget, and what the figures of the cut stand on."""
    words = "whether dross, Rz, u, through and kerf lie within the settings that they were calibrated on; else the "
    words += "share of the cut that does not, and, when pointed at, in what"
    stands = OnPage("cut", "evidence", "of the cut", words, lambda suite, _: cells.evidence(suite), -1)
    return [*_budget(), Column("evidence", text=evidence, page=stands)]
