"""The columns of a benchmark's table, once: terminal and Markdown print them, the page shows them.

A column of a metric is made of what the metric says about itself (:class:`envs.figures.registered.Metric`); so a metric
that is registered stands in every table. The others, such as rank and margins, are listed here.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...envs.figures.registered import Metric
from ..measure.margins import DELAYS, GAINS
from ..measure.margins import in_words as margin
from ..results.followers import Results
from ..results.jobs import JobResults
from ..statistics.pooling import declared

HOW = {"rms": "RMS", "mean": "mean", "largest": "the largest", "smallest": "the smallest"}
"""How a metric is pooled over the seeds, in words."""

OVER = {"rms": "geometric mean", "mean": "geometric mean", "largest": "largest", "smallest": "smallest"}
"""How a metric is pooled over the scenarios, in words."""


@dataclass(frozen=True)
class Column:
    """A column: heading in print, name in ``summary.csv``, how a row of that is printed, and its metric if it has
    one."""

    title: str
    shows: str
    text: Callable[[Any], str]
    metric: Metric | None = None


def of(results: Results | JobResults) -> list[Column]:
    """The columns of a grid that show one of its summary's, in the order in which they are printed."""
    scored = declared(results.metric)
    followers = isinstance(results, Results)
    head = [
        Column("rank", "rank", _rank),
        Column("failed", "failed", lambda row: f"{row['failed']}/{row['runs']}"),
        Column("score, µm" if followers else scored.title, "score" if followers else scored.name, _score),
        Column(f"× {results.reference}", "ratio", lambda row: figure(row, "ratio")),
        Column("wins", "wins", _wins),
    ]
    own = []
    for metric in results.shown:
        if metric.name == "jitter":
            own += STABLE  # stands between errors and what they cost
        if metric.name != results.metric:
            own.append(_of_metric(metric))
        if not followers and metric.name == "roughness":
            own.append(Column("ISO 9013", "iso_roughness", lambda row: str(row["iso_roughness"])))
    return [*head, *own, Column("collisions", "collisions", lambda row: f"{row['collisions']}/{row['runs']}")]


def explained(results: Results | JobResults) -> list[str]:
    """A line on each metric that is not brief: what it is, which way is better, how it is pooled."""
    return [f"{m.title}: {said(m)}." for m in results.shown if m.shown and not m.shown.brief]


def said(metric: Metric) -> str:
    """What a metric is, in words; of those that are not brief also which way is better."""
    better = "" if metric.shown and metric.shown.brief else f"{metric.better} is better; "
    over = "mean" if metric.zero and metric.pooled == "mean" else OVER[metric.pooled]
    return f"{metric.summary}; {better}{HOW[metric.pooled]} over seeds, {over} over scenarios"


def number(value: float, form: str = "{:.2f}") -> str:
    """A figure, or a dash."""
    return "–" if value is None or math.isnan(value) else form.format(value)


def figure(row: Any, name: str, form: str = "{:.2f}") -> str:
    """A figure with its interval, such as ``2.42 (2.27 … 2.54)``; alone where there is none or it is exact."""
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    ends = "" if math.isnan(low) or low == high else f" ({form.format(low)} … {form.format(high)})"
    return number(row[name], form) + ends


def _of_metric(metric: Metric) -> Column:
    shown, column = metric.shown, metric.column
    assert shown
    if shown.brief:
        return Column(metric.title, column, lambda row: number(row[column], shown.form), metric)
    return Column(metric.title, column, lambda row: figure(row, column, shown.form), metric)


def _score(row: Any) -> str:
    return figure(row, "score")


def _rank(row: Any) -> str:
    """``1``, ``1=`` if it is shared, a dash without one."""
    return "–" if math.isnan(row["rank"]) else f"{row['rank']:.0f}{'=' * bool(row['tied'])}"


def _wins(row: Any) -> str:
    """How often it beats the reference; a dash for the reference itself."""
    return number(row["wins"] if row["wins_low"] < row["wins_high"] else math.nan, "{:.0%}")


STABLE = [
    Column("Ms sine", "ms", lambda row: number(row["ms"])),
    Column("Ms noise", "ms_noise", lambda row: figure(row, "ms_noise")),
    Column("gain", "gain_margin", lambda row: margin(row["gain_margin"], GAINS[-1])),
    Column("delay, ms", "delay_margin", lambda row: margin(row["delay_margin"], DELAYS[-1])),
]
"""Columns of Ms and margins, which followers have."""
