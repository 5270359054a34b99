"""|S|: how much of a small motion of the sheet is left in the gap, frequency by frequency."""

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from ..measure.stability import LIMIT_MS
from ..plots.palette import INK, QUIET, Look
from .figure import Figure, line, logarithmic
from .suite import Suite

SIGNALS = {"sine": "one sine at a time", "noise": "noise, all frequencies at once"}
"""What is injected (:mod:`..stability`), in words."""


def figure(suite: Suite, look: dict[str, Look], labels: dict[str, str]) -> Figure | None:
    """Magnitude against frequency, a view for each signal and machine; None if it was not measured."""
    curves = suite.results.curves
    if not len(curves):
        return None
    several = curves["machine"].nunique() > 1
    views: dict[str, go.Figure] = {}
    over: set[str] = set()
    for (machine, signal), rows in curves.groupby(["machine", "signal"], sort=False):
        found = _view(suite, rows, look, labels)
        if found is None:
            continue
        views[SIGNALS[signal] + (f", machine {machine}" if several else "")] = found[0]
        over.update(found[1])
    if not views:
        return None
    names = [labels[name] for name in suite.ranked if name in over]
    title = f"Ms above {LIMIT_MS:g}: {', '.join(names)}" if names else f"Every measured Ms is within {LIMIT_MS:g}"
    caption = (
        "Measured by injection on the machine that was run, for the worst of its corner plants: how much of a small "
        "motion of the sheet shows in the true gap. Below 1 the motion is followed, above 1 it is made larger. The "
        f"marked peak is Ms; above {LIMIT_MS:g} a loop has little margin for a machine that differs from its model. "
        "A head that stands still has 1. A controller that learns while it runs predicts a sine, so its Ms is that of "
        "noise."
    )
    return Figure(f"sensitivity-{suite.name}", title, caption, views, "injected", height=440)


def _view(
    suite: Suite, curves: pd.DataFrame, look: dict[str, Look], labels: dict[str, str]
) -> tuple[go.Figure, list[str]] | None:
    """Curves of one signal and machine, and whose peak is too high; None if there is none."""
    plot = go.Figure()
    peaks = {}
    for name in suite.ranked:
        frame = curves[curves["controller"] == name]
        f, s = frame["frequency"].to_numpy(float), frame["magnitude"].to_numpy(float)
        good = np.isfinite(s)
        if not good.any():
            continue
        own = {"name": labels[name], "legendgroup": name, "line": line(look[name]), "mode": "lines"}
        told = "%{y:.2f} at %{x:.3g} Hz"
        plot.add_scatter(x=f[good].astype("f4"), y=s[good].astype("f4"), hovertemplate=told, **own)
        at = int(np.argmax(np.where(good, s, -np.inf)))
        peaks[name] = float(s[at]) if good.all() else float("inf")
        marker = {"color": look[name].colour, "symbol": look[name].symbol, "size": 8}
        quiet = {"showlegend": False, "legendgroup": name, "hoverinfo": "skip"}
        plot.add_scatter(x=[f[at]], y=[s[at]], mode="markers", marker=marker, **quiet)
    if not peaks:
        return None
    plot.add_hline(LIMIT_MS, line={"color": INK, "width": 1, "dash": "4px,3px"})
    plot.add_hline(1.0, line={"color": QUIET, "width": 0.8})
    place = {"x": 0, "xref": "paper", "y": np.log10(LIMIT_MS), "xanchor": "left", "yanchor": "bottom"}
    limit, font = f"limit of tuning, Ms = {LIMIT_MS:g}", {"size": 11, "color": INK}
    plot.add_annotation(**place, text=limit, showarrow=False, font=font)
    found = [p for p in peaks.values() if np.isfinite(p)]
    magnitude = curves["magnitude"].to_numpy(float)
    lowest = float(magnitude[np.isfinite(magnitude) & (magnitude > 0)].min())
    frequencies = curves["frequency"].to_numpy(float)
    plot.update_layout(
        xaxis={
            **logarithmic(float(frequencies.min()), float(frequencies.max())),
            "title": "frequency of the sheet's motion (Hz)",
        },
        yaxis={**logarithmic(lowest / 1.2, max([LIMIT_MS, *found]) * 1.3), "title": "|S|, worst corner plant"},
        hovermode="x",
    )
    return plot, [name for name, peak in peaks.items() if peak > LIMIT_MS]
