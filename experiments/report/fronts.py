"""Pareto fronts: what following, dross, roughness and time cost each other."""

import math
from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from ..plots.palette import QUIET, Look
from .figure import Figure, logarithmic
from .numbers import number
from .standing import Standing
from .suite import Suite

PAIRS = (
    *(("time", other) for other in ("roughness", "dross", "contour_rms", "gap_rms")),
    *((error, other) for error in ("rms_true", "gap_rms") for other in ("dross", "roughness")),
    *(("dross", "roughness"), ("rms_true", "jitter")),
)


def efficient(points: pd.DataFrame) -> list[str]:
    """Names of the points, columns lower is better, that no other is as good as in all and better in one."""
    table = points.to_numpy(float)
    kept = []
    for i, mine in enumerate(table):
        if np.isfinite(mine).all():
            beaten = (table <= mine).all(axis=1) & (table < mine).any(axis=1)
            if not beaten.any():
                kept.append(str(points.index[i]))
    return kept


def figure(
    suite: Suite, standings: dict[str, Standing], look: dict[str, Look], labels: dict[str, str]
) -> Figure | None:
    """A view for every pair of metrics that vary; None if there is none, or one controller."""
    views: dict[str, go.Figure] = {}
    sound = []
    for pair in PAIRS:
        if not all(m in standings and standings[m].varies for m in pair):
            continue
        view, on = _view(suite, standings, pair, look, labels)
        views[" – ".join(suite.metrics[m].spoken for m in pair)] = view
        sound.append(on)
    if not views or len(suite.ranked) < 2:
        return None
    first = next(iter(views))
    title = f"{first.replace(' – ', ' against ')}: {', '.join(labels[n] for n in sound[0])} on the front"
    caption = (
        "Left and down is better in every view. Bars are 95 % intervals. The grey line joins those of the controllers "
        "that may be ranked for whom no other is at least as good in both; hollow points know more than a real machine "
        "or are not ranked for another reason given above."
    )
    return Figure(f"fronts-{suite.name}", title[0].upper() + title[1:], caption, views, "axes", height=460)


def _view(
    suite: Suite, standings: dict[str, Standing], pair: tuple[str, str], look: dict[str, Look], labels: dict[str, str]
) -> tuple[go.Figure, list[str]]:
    tables = [standings[m].frame for m in pair]
    points = pd.DataFrame({m: table["score"] for m, table in zip(pair, tables, strict=True)})
    ranked = [name for name in suite.ranked if name in standings[suite.metric].ranked]
    front = sorted(efficient(points.loc[ranked]), key=lambda n: points.at[n, pair[0]])
    plot = go.Figure()
    steps = points.loc[front]
    stairs = {"color": QUIET, "width": 1.2, "shape": "hv"}
    plot.add_scatter(x=steps[pair[0]], y=steps[pair[1]], mode="lines", line=stairs, hoverinfo="skip", showlegend=False)
    for name in suite.ranked:
        x, y = (float(points.at[name, m]) for m in pair)
        if not (math.isfinite(x) and math.isfinite(y)):
            continue
        full = name in ranked
        bars: dict[str, Any] = {}
        for axis, table, value in zip("xy", tables, (x, y), strict=True):
            low, high = float(table.at[name, "score_low"]), float(table.at[name, "score_high"])
            if math.isfinite(low):
                ends = {"array": [high - value], "arrayminus": [value - low]}
                drawn = {"thickness": 1.2, "width": 0, "color": look[name].colour}
                bars[f"error_{axis}"] = {"type": "data", "symmetric": False, **ends, **drawn}
        own = look[name]
        edge = {"width": 0.8, "color": "#fff"} if full else {"width": 1.6, "color": own.colour}
        marker = {"symbol": own.symbol + ("" if full else "-open"), "size": 11, "color": own.colour, "line": edge}
        told = f"{number(x)} {suite.metrics[pair[0]].unit}, {number(y)} {suite.metrics[pair[1]].unit}"
        plot.add_scatter(x=[x], y=[y], mode="markers", name=labels[name], marker=marker, hovertemplate=told, **bars)
    axes = [
        {"title": f"{suite.metrics[m].spoken} ({suite.metrics[m].unit})", **_scale(table)}
        for m, table in zip(pair, tables, strict=True)
    ]
    plot.update_layout(xaxis=axes[0], yaxis=axes[1], hovermode="closest")
    return plot, front


def _scale(frame: pd.DataFrame) -> dict[str, Any]:
    """Logarithmic where the values differ by more than a factor of three."""
    ends = frame[["score", "score_low", "score_high"]].to_numpy(float).ravel()
    ends = ends[np.isfinite(ends) & (ends > 0) & (ends < 5 * frame["score"].replace(np.inf, np.nan).max())]
    if len(ends) and ends.max() > 3 * ends.min():
        return logarithmic(float(ends.min()) / 1.15, float(ends.max()) * 1.15)
    return {"type": "linear"}
