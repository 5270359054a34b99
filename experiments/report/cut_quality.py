"""Quality of a cut against following error: how much better a follower must be before the cut shows it."""

import functools

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from ...envs.plant import cut, streamed
from ...envs.scenarios.material import Material, material
from ..plots.palette import COLOURS, INK, QUIET, SYMBOLS
from .figure import Figure, logarithmic

ERRORS = np.array([0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0, 200.0, 300.0, 500.0])
"""µm, RMS of the standoff error."""

SHOWS = 0.01
"""Share by which dross or roughness must change to show: below it lies the scatter of any roughness measurement."""

_PERIODS = 40_000


def table(steel: Material, seed: int = 0) -> pd.DataFrame:
    """Dross (mm) and roughness (µm) by RMS standoff error (µm), at the recipe's feed, and relative to no error.

    The error is a Gaussian process with a correlation of 3 mm along the cut.
    """
    rng, p = np.random.default_rng(seed), steel.params
    way = steel.feed * 1e-3
    keep = np.exp(-way / 3.0)
    noise = rng.standard_normal(_PERIODS)
    process = np.empty(_PERIODS)
    value = noise[0]
    for i, x in enumerate(noise):
        value = keep * value + np.sqrt(1.0 - keep * keep) * x
        process[i] = value
    process /= np.sqrt(np.mean(process**2))
    beam = cut.beam(p, steel.power, 0.0, 0.0, 0.0, 0.0, 0.0)
    figures = streamed.figures(p, beam, steel.feed, 1e-3 * process[:, None] * np.array(ERRORS))
    means = figures[_PERIODS // 10 :].mean(axis=0)
    frame = pd.DataFrame({"error": ERRORS, "dross": means[2], "roughness": 1e3 * means[1]})
    for name in ("dross", "roughness"):
        frame[f"{name}_change"] = frame[name] / frame[name].iloc[0] - 1.0
    return frame


def threshold(frame: pd.DataFrame) -> float:
    """Below this RMS standoff error a better follower changes neither dross nor roughness by 1 %."""
    change = frame[["dross_change", "roughness_change"]].abs().max(axis=1).to_numpy()
    if change.max() < SHOWS:
        return float("inf")
    return float(np.interp(SHOWS, change, frame["error"]))


@functools.cache
def figure(name: str, thickness: float | None = None) -> Figure:
    """Change of dross and roughness against the RMS standoff error, and where it begins to show."""
    steel = material(name, thickness)
    frame = table(steel)
    limit = threshold(frame)
    plot = go.Figure()
    for i, (column, title) in enumerate((("dross", "dross"), ("roughness", "roughness Rz"))):
        x, y, value = (frame[key].iloc[1:] for key in ("error", f"{column}_change", column))
        drawn = {"line": {"color": COLOURS[i], "width": 2}, "marker": {"symbol": SYMBOLS[i], "size": 7}}
        told = "%{y:.2f} % at %{x:g} µm: %{customdata:.3g} " + ("mm" if column == "dross" else "µm")
        how = {"mode": "lines+markers", "customdata": value, "hovertemplate": told}
        plot.add_scatter(x=x, y=100 * y, name=title, **how, **drawn)
    plot.add_hline(100 * SHOWS, line={"color": QUIET, "width": 1, "dash": "dot"})
    if np.isfinite(limit):
        plot.add_vline(limit, line={"color": INK, "width": 1, "dash": "4px,3px"})
        place = {"x": np.log10(limit), "y": 1, "yref": "paper", "xanchor": "left", "yanchor": "top"}
        plot.add_annotation(**place, text=f" {limit:.0f} µm", showarrow=False, font={"color": INK})
    change = 100 * frame[["dross_change", "roughness_change"]].to_numpy()[1:]
    plot.update_layout(
        xaxis={**logarithmic(float(ERRORS[1]), float(ERRORS[-1])), "title": "standoff error, RMS (µm)"},
        yaxis={"title": "change against no error (%)", "rangemode": "tozero", "range": [min(0.0, change.min()), 25.0]},
    )
    sheet = f"{name}, {steel.thickness:g} mm"
    title = (
        f"{sheet}: below {limit:.0f} µm RMS the cut does not tell a follower from a perfect one"
        if np.isfinite(limit)
        else f"{sheet}: up to {ERRORS[-1]:.0f} µm RMS the following error does not show in the cut"
    )
    caption = (
        f"{steel.label[0].upper()}{steel.label[1:]}. At the recipe's feed, the error a Gaussian process with a "
        f"correlation of 3 mm along the cut. The dotted line is {100 * SHOWS:g} %, below which lies the scatter of any "
        "roughness measurement."
    )
    return Figure(f"quality-{name}", title, caption, {"": plot}, height=380)
