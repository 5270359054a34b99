"""Blame: what each stage of the machine costs, and how references with other information do on the same seeds."""

from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from ..blame.shares import REST
from ..plots.palette import INK, Look
from .figure import Figure
from .numbers import listed, number, span, times
from .suite import Suite


def figure(suite: Suite, look: dict[str, Look], labels: dict[str, str]) -> Figure | None:
    """Shares of the mean-square error stage by stage, a view for each scenario; None if it was not asked for."""
    shares = suite.results.blame
    if not len(shares):
        return None
    views = {str(scenario): _view(here, look, labels) for scenario, here in shares.groupby("scenario", sort=False)}
    caption = (
        "Each stage's Shapley share of the mean-square error of the true gap: what idealising it gains, averaged over "
        f"all orders in which the stages can be idealised, with 95 % intervals over seeds. “{REST}” is what is left "
        "when all are ideal: law, supervisor and sampling. The shares of a controller add up to its mean-square error. "
        "A negative share is no mistake: a controller tuned around a fault can do worse without it. The hollow "
        "diamond is what idealising this stage alone would gain."
    )
    height, least = 110 + 34 * shares["stage"].nunique(), 340 * shares["controller"].nunique()
    return Figure(f"blame-{suite.name}", _title(shares, labels), caption, views, "scenario", height, least)


def _view(here: pd.DataFrame, look: dict[str, Look], labels: dict[str, str]) -> go.Figure:
    """A panel for each controller, whose errors may differ by orders of magnitude."""
    plot = go.Figure()
    unit, names = str(here["unit"].iloc[0]), list(dict.fromkeys(here["controller"]))
    stages, across = list(dict.fromkeys(here["stage"])), 1 / len(names)
    axes: dict[str, Any] = {}
    for i, name in enumerate(names):
        rows, n = here[here["controller"] == name], str(i + 1) if i else ""
        share, y = rows["share"].to_numpy(float), rows["stage"]
        total = float(np.nansum(share)) or np.nan
        left, right = i * across, (i + 1) * across - (0.04 if i + 1 < len(names) else 0.0)
        line = {"zeroline": True, "zerolinecolor": INK, "zerolinewidth": 1}
        axes[f"xaxis{n}"] = {"domain": [left, right], "anchor": f"y{n}", "title": unit, **line, "nticks": 6}
        order = {"autorange": "reversed", "categoryorder": "array", "categoryarray": stages}
        plain = {"showgrid": False, "ticks": "", "showticklabels": i == 0, "matches": "y" if i else None}
        axes[f"yaxis{n}"] = {"anchor": f"x{n}", **order, **plain}
        text = f"{labels.get(name, name)}, in all {number(total)} {unit}"
        place = {"x": left, "y": 1, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "bottom"}
        title = {"text": text, **place, "showarrow": False, "font": {"size": 13}}
        axes.setdefault("annotations", []).append(title)
        on = {"y": y, "xaxis": f"x{n}", "yaxis": f"y{n}", "showlegend": False}
        ends = {"type": "data", "symmetric": False, "array": rows["high"] - share, "arrayminus": share - rows["low"]}
        drawn = {"width": 0.55, "orientation": "h", "marker": {"color": look[name].colour, "opacity": 0.85}}
        told = f"{labels.get(name, name)}: %{{x:.3g}} {unit}, %{{customdata:.0f}} %<extra></extra>"
        ends |= {"thickness": 1.4, "width": 3, "color": INK}
        plot.add_bar(x=share, customdata=100 * share / total, error_x=ends, hovertemplate=told, **drawn, **on)
        diamond = {"symbol": "diamond-open", "size": 8, "color": INK, "line": {"width": 1.4}}
        told = f"{labels.get(name, name)}, this stage alone: %{{x:.3g}} {unit}<extra></extra>"
        plot.add_scatter(x=rows["alone"], mode="markers", marker=diamond, hovertemplate=told, **on)
    plot.update_layout(hovermode="closest", margin={"t": 30}, **axes)
    return plot


def _title(shares: pd.DataFrame, labels: dict[str, str]) -> str:
    """The largest share of each controller in the first scenario."""
    here = shares[shares["scenario"] == shares["scenario"].iloc[0]]
    words = []
    for name, rows in here.groupby("controller", sort=False):
        share = rows.set_index("stage")["share"].astype(float)
        if np.isfinite(share).all():
            words.append(f"{share.idxmax()} ({labels.get(str(name), str(name))})")
    return f"Largest share of the error in {here['scenario'].iloc[0]}: {listed(words) or 'unknown, a run failed'}"


def headroom(suite: Suite, labels: dict[str, str]) -> list[dict[str, Any]]:
    """Rows of the table of references: their RMS and the factor to it; empty if it was not asked for."""
    table = suite.results.headroom
    rows: list[dict[str, Any]] = []
    for (scenario, name), here in table.groupby(["scenario", "controller"], sort=False) if len(table) else []:
        known = {}
        for row in here.itertuples():
            finite = np.isfinite(row.ratio)
            known[labels.get(row.informed, row.informed)] = {
                "rms": number(row.informed_rms),
                "ratio": f"× {times(row.ratio)}" if finite else "–",
                "span": span(row.low, row.high, 1),
            }
        row = {"scenario": scenario, "controller": labels.get(str(name), str(name))}
        rows.append(row | {"rms": number(here["rms"].iloc[0]), "references": known})
    return rows
