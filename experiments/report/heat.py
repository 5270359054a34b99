"""Controller × scenario: where each is weak, and what each scenario demands."""

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from ..bounds.stored import LABEL, LINEAR
from ..plots.palette import DIVERGING
from .figure import Figure
from .numbers import number
from .suite import Suite

FURTHEST = 3.0
"""Doublings at the ends of the colours: eight times better or worse."""


def figure(suite: Suite, labels: dict[str, str]) -> Figure | None:
    """The map of every metric, and of the share of runs with a collision; None for a single scenario."""
    if len(suite.scenarios) < 2:
        return None
    own = suite.metrics[suite.metric]
    wanted = [own, *(m for m in suite.metrics.values() if m.exact and m != own)]
    views = {f"{m.exact or m.name}, {m.unit}": _errors(suite, m.name, labels) for m in wanted}
    if (suite.results.runs["collision"] > 0).any():
        views["collisions, share of runs"] = _collisions(suite, labels)
    against = f"{suite.reference} in the same scenario" if suite.reference in suite.ranked else "the scenario's median"
    caption = (
        f"Numbers are over all seeds of a scenario whose run did not fail; colours compare with {against}: blue is "
        f"better, orange worse, {2**FURTHEST:g} times at the ends. Columns right of the line make no score"
        f"{'; an asterisk marks scenarios that are built to defeat followers' if suite.exempt else ''}."
    )
    height, least = 110 + 34 * (len(suite.ranked) + 1), 130 + 62 * len(suite.scenarios)
    return Figure(f"heat-{suite.name}", "Where the error comes from", caption, views, "show", height, least)


def _errors(suite: Suite, metric: str, labels: dict[str, str]) -> go.Figure:
    table = suite.pooled(metric).loc[suite.ranked, suite.scenarios].astype(float)
    base = table.loc[suite.reference] if suite.reference in table.index else table.median()
    with np.errstate(divide="ignore", invalid="ignore"):
        doublings = np.log2(table.to_numpy() / base.to_numpy()[None, :])
    if suite.metrics[metric].better == "higher":
        doublings = -doublings
    lost = suite.lost.loc[suite.ranked, suite.scenarios].to_numpy()
    text = [[_cell(v, n) for v, n in zip(*rows, strict=True)] for rows in zip(table.to_numpy(), lost, strict=True)]
    ends = np.arange(-FURTHEST, FURTHEST + 1)
    bar = {
        "tickvals": ends,
        "title": {"text": "×", "side": "top"},
        "ticktext": [f"{2.0 ** abs(e):g} {'better' if e < 0 else 'worse'}" if e else "same" for e in ends],
    }
    look = {"colorscale": DIVERGING, "zmin": -FURTHEST, "zmax": FURTHEST, "colorbar": bar}
    colours = np.clip(np.nan_to_num(doublings, nan=np.nan), -FURTHEST, FURTHEST)
    bounds = {LABEL: suite.results.bounds, LINEAR: suite.results.linear} if metric == "rms_true" else {}
    return _map(suite, table, colours, text, labels, look, suite.metrics[metric].unit, bounds)


def _cell(value: float, lost: int) -> str:
    """A figure, and below it how many runs failed, if any did."""
    if not np.isfinite(value):
        return "failed"
    text = "< 0.001" if 0 < value < 0.0005 else number(value)
    return f"{text}<br>{lost} failed" if lost else text


def _collisions(suite: Suite, labels: dict[str, str]) -> go.Figure:
    groups = suite.results.runs.groupby(["controller", "scenario"], sort=False)["collision"]
    hits, sizes = groups.sum().unstack(), groups.size().unstack()
    rates = (hits / sizes).loc[suite.ranked, suite.scenarios]
    text = [
        ["" if hits.at[c, s] == 0 else f"{hits.at[c, s]:.0f}/{sizes.at[c, s]:.0f}" for s in suite.scenarios]
        for c in suite.ranked
    ]
    bar = {"tickformat": ".0%", "title": {"text": "runs", "side": "top"}}
    scale = [(0.0, "#f7f7f5"), (0.02, "#fde0c5"), (0.3, "#f4a35f"), (1.0, "#a63603")]
    more = {"colorscale": scale, "zmin": 0, "zmax": 1, "colorbar": bar}
    return _map(suite, rates, rates.to_numpy(float), text, labels, more, "of the runs")


def _map(
    suite: Suite,
    table: pd.DataFrame,
    colours: np.ndarray,
    text: list,
    labels: dict[str, str],
    more: dict,
    unit: str,
    limits: dict[str, dict[str, float]] | None = None,
) -> go.Figure:
    """The map; ``limits`` by label and scenario make last rows, in the colour of the best."""
    columns = [s + ("*" if s in suite.exempt else "") for s in suite.scenarios]
    rows, values = [labels[c] for c in suite.ranked], table.to_numpy(float)
    limits = {label: bounds for label, bounds in (limits or {}).items() if bounds}
    for label, bounds in limits.items():
        last = np.array([[bounds.get(s, np.nan) for s in suite.scenarios]])
        rows, values = [*rows, label], np.vstack([values, last])
        colours = np.vstack([colours, np.where(np.isfinite(last), more["zmin"], np.nan)])
        text = [*text, [_cell(v, 0) if np.isfinite(v) else "" for v in last[0]]]
    more["colorbar"] |= {"thickness": 10, "outlinewidth": 0, "tickfont": {"size": 11}, "x": 1.01, "xpad": 4}
    words = {"text": text, "texttemplate": "%{text}", "textfont": {"size": 12}, "xgap": 1, "ygap": 1}
    told = {"hovertemplate": "%{y}<br>%{x}: %{customdata:.4g} " + unit + "<extra></extra>", "hoverongaps": False}
    plot = go.Figure(go.Heatmap(z=colours, x=columns, y=rows, customdata=values, **words, **told, **more))
    shapes = []
    for here, after in zip(suite.scenarios, suite.scenarios[1:], strict=False):
        if (here in suite.scored) != (after in suite.scored):
            at = suite.scenarios.index(after) - 0.5
            shapes.append(_rule(x0=at, x1=at, y0=0, y1=1, yref="paper"))
    below = 0
    for names in list(suite.classes.values())[: None if limits else -1]:
        below += len(names)
        shapes.append(_rule(x0=0, x1=1, xref="paper", y0=below - 0.5, y1=below - 0.5))
    plot.update_layout(
        xaxis={"side": "top", "tickangle": -40, "fixedrange": True, "showgrid": False},
        yaxis={"autorange": "reversed", "fixedrange": True, "showgrid": False},
        shapes=shapes,
        margin={"t": 70, "b": 10, "l": 10, "r": 10},
    )
    return plot


def _rule(**place: object) -> dict[str, object]:
    return {"type": "line", "line": {"color": "#1a1d20", "width": 1.2}, **place}
