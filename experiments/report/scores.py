"""Scores: every controller's error with its interval, classes apart, the reported error beside it."""

import math
from typing import Any

import numpy as np
import plotly.graph_objects as go

from ..bounds.stored import LABEL, LINEAR
from ..plots.palette import INK, QUIET, Look
from .figure import Figure, logarithmic
from .numbers import fixed, known, number, span
from .standing import Standing
from .suite import Suite


def figure(standing: Standing, look: dict[str, Look], labels: dict[str, str]) -> Figure | None:
    """Points with intervals on a logarithmic axis; None if nobody has a score."""
    suite, frame = standing.suite, standing.frame
    if not standing.order:
        return None
    metric = suite.metrics[suite.metric]
    at, headings, bottom = _rows(suite)
    ends = frame.loc[standing.order, ["score", "score_low", "score_high"]].to_numpy(float)
    reported = None if suite.jobs else suite.summary["reported"]
    if reported is not None:
        ends = np.concatenate([ends.ravel(), reported.loc[standing.order].to_numpy(float)])
    ends = ends[np.isfinite(ends) & (ends > 0)]
    limits = {
        label: value
        for label, value in ((LABEL, suite.results.bound), (LINEAR, suite.results.linear_bound))
        if value > 0
    }
    ends = np.append(ends, list(limits.values()))
    low, high = float(ends.min()) / 1.25, min(float(ends.max()) * 1.25, 8 * float(frame["score"][standing.order].max()))
    plot = go.Figure()
    annotations = []
    for name, y in at.items():
        value, first, last = (float(frame.at[name, c]) for c in ("score", "score_low", "score_high"))
        if not math.isfinite(value):
            words = f"no score: {int(suite.summary.at[name, 'failed'])} failed runs"
            annotations.append(_text(math.log10(low), y, words))
            continue
        fair, colour = name in standing.ranked, look[name].colour
        places = known(first, last, value)
        if math.isfinite(first):
            drawn = {"mode": "lines", "line": {"color": colour, "width": 3 if fair else 1.5}}
            plot.add_scatter(x=[first, min(last, high)], y=[y, y], **drawn, hoverinfo="skip", showlegend=False)
        if reported is not None and math.isfinite(float(reported[name])):
            x, tick = (
                float(reported[name]),
                {"symbol": "line-ns-open", "size": 11, "color": colour, "line": {"width": 2}},
            )
            told = f"{labels[name]}, reported: {number(x)} {metric.unit}<extra></extra>"
            plot.add_scatter(x=[x], y=[y], mode="markers", showlegend=False, marker=tick, hovertemplate=told)
        edge = {"width": 0 if fair else 2, "color": colour}
        marker = {"symbol": look[name].symbol + ("" if fair else "-open"), "size": 11, "color": colour, "line": edge}
        told = f"{fixed(value, places)} {metric.unit} ({span(first, last, places)})<extra></extra>"
        told = f"{labels[name]}: {told}"
        plot.add_scatter(x=[value], y=[y], mode="markers", showlegend=False, marker=marker, hovertemplate=told)
        above = {"xref": "paper", "font": {"size": 13, "color": INK}}
        annotations.append({**_text(1.0, y, fixed(value, places), 6), **above})
    for information, y in headings.items():
        words = "sensor only" if information == "sensor" else f"{information}, not ranked"
        annotations.append({**_text(0.0, y, words), "xref": "paper"})
    if suite.reference in standing.order:
        dashes = {"color": INK, "width": 1, "dash": "4px,3px"}
        plot.add_vline(float(frame.at[suite.reference, "score"]), line=dashes, layer="below")
    for i, (label, bound) in enumerate(limits.items()):
        dash = "1px,3px" if label == LABEL else "6px,2px,1px,2px"
        plot.add_vline(bound, line={"color": INK, "width": 2, "dash": dash}, layer="below")
        place = bottom + 0.2 - 0.45 * i
        annotations.append({**_text(math.log10(bound), place, f"{label}: {number(bound)}", 6)})
    bottom -= 0.45 * max(len(limits) - 1, 0)
    title = f"{metric.exact or metric.name} ({metric.unit}, log scale)"
    names = {"tickvals": list(at.values()), "ticktext": [labels[n] for n in at], "ticks": ""}
    bare = {"showgrid": False, "fixedrange": True, "showline": False}
    plot.update_layout(
        xaxis={**logarithmic(low, high), "title": title, "fixedrange": True},
        yaxis={**names, **bare, "range": [bottom + 0.4, 0.7]},
        annotations=annotations,
        margin={"r": 64, "t": 34},
        hovermode="closest",
    )
    _score_axis(plot, standing, low, high)
    beside = " The upright stroke is what the machine itself reports." if reported is not None else ""
    if LABEL in limits:
        beside += " The dotted line is what no causal controller with only the sensor can go below (docs/bounds.md)."
    if LINEAR in limits:
        beside += " No fixed linear controller can go below the line of dashes and dots."
    caption = (
        f"Points are over the seeds whose run did not fail, {suite.scored_in_words}, with 95 % intervals; shorter is "
        f"better, and equal distances are equal ratios.{beside} Intervals of two controllers may overlap though the "
        "difference is sure: both met the same sheets and machines, and are compared on those. Hollow points are not "
        "ranked."
    )
    return Figure(
        f"scores-{suite.name}", _title(standing, labels), caption, {"": plot}, height=round(110 + 30 * (0.5 - bottom))
    )


def _title(standing: Standing, labels: dict[str, str]) -> str:
    if standing.best is None:
        return "Nobody may be ranked here"
    if standing.tied:
        return f"{labels[standing.best]} and {len(standing.tied)} more cannot be told apart at the top"
    return f"{labels[standing.best]} is ahead of everyone it may be compared with"


def _score_axis(plot: go.Figure, standing: Standing, low: float, high: float) -> None:
    """The scale, above: 0 at the reference and 1 at the one with other information."""
    suite, frame = standing.suite, standing.frame
    if suite.informed not in standing.order or suite.reference not in standing.order:
        return
    zero, one = (math.log10(float(frame.at[n, "score"])) for n in (suite.reference, suite.informed))
    ticks = [s / 4 for s in range(-8, 9) if math.log10(low) <= zero + s / 4 * (one - zero) <= math.log10(high)]
    plot.add_scatter(x=[None], y=[None], xaxis="x2", showlegend=False, hoverinfo="skip")
    words = [f"{s:g}".replace("-", "−") for s in ticks]
    small = {"size": 11, "color": QUIET}
    place = {"overlaying": "x", "side": "top", "matches": None, "range": [math.log10(low), math.log10(high)]}
    shown = {"tickvals": [zero + s * (one - zero) for s in ticks], "ticktext": words, "tickfont": small}
    bare = {"fixedrange": True, "showgrid": False, "title": {"text": "scale", "font": small, "standoff": 0}}
    plot.update_layout(xaxis2=place | shown | bare)


def _text(x: float, y: float, words: str, shift: int = 0) -> dict[str, Any]:
    font = {"size": 11.5, "color": QUIET}
    return {"x": x, "y": y, "text": words, "showarrow": False, "xanchor": "left", "font": font, "xshift": shift}


def _rows(suite: Suite) -> tuple[dict[str, float], dict[str, float], float]:
    """Height of each controller's row and of each class's heading, best at the top, and the lowest edge."""
    at, headings, y = {}, {}, 0.0
    for information, names in suite.classes.items():
        if len(suite.classes) > 1 or information != "sensor":
            headings[information] = y
            y -= 0.85
        for name in names:
            at[name] = y
            y -= 1.0
        y -= 0.25
    return at, headings, y
