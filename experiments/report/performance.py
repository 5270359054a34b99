"""Performance profiles: how often a controller is how much better or worse than the reference, run by run."""

import numpy as np
import plotly.graph_objects as go

from ..plots.palette import INK, Look, faded
from ..statistics.comparison import common, everywhere, samples
from ..statistics.intervals import performance_profile
from .figure import Figure, line
from .numbers import percent
from .suite import Suite

POINTS = 121
FURTHEST = 16.0
"""Times better and worse at the ends."""


def figure(suite: Suite, look: dict[str, Look], labels: dict[str, str]) -> Figure | None:
    """Share of runs within a factor of the reference's error on the same seed; None without the reference."""
    found = samples(suite.results)
    if suite.reference not in found or len(found) < 2:
        return None
    factors = np.geomspace(1 / FURTHEST, FURTHEST, POINTS)
    plot, shares, reached = go.Figure(), {}, 2.0
    for name in [n for n in suite.ranked if n in found and n != suite.reference]:
        mine, base = everywhere(*common(found[name], found[suite.reference]))
        if not mine.size:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(np.isinf(mine), np.inf, mine / base)
        curve = performance_profile(ratio, factors)
        value, low, high = (np.array([getattr(p, end) for p in curve]) for end in ("value", "low", "high"))
        reached = max(reached, factors[min(int(np.argmax(value >= value[-1])), POINTS - 1)])
        shares[name] = float(np.interp(0.0, np.log(factors), value))
        scatter = np.ptp((ratio[:, :, None] <= factors).mean(axis=1), axis=0) > 0
        open_ = scatter & np.isfinite(low)  # what all seeds agree on has no band that tells anything
        if open_.any():
            first, last = np.flatnonzero(open_)[[0, -1]]
            part = slice(max(first - 1, 0), last + 2)
            f, low, high = factors[part], np.where(open_, low, value)[part], np.where(open_, high, value)[part]
            x, y = np.concatenate([f, f[::-1]]), np.concatenate([high, low[::-1]])
            band = {"fill": "toself", "fillcolor": faded(look[name].colour, 0.1), "line": {"width": 0}, "mode": "lines"}
            silent = {"hoverinfo": "skip", "showlegend": False, "legendgroup": name}
            plot.add_scatter(x=x.astype("f4"), y=y.astype("f4"), **band, **silent)
        told = f"{labels[name]}: %{{y:.0%}} of runs within × %{{x:.2f}}<extra></extra>"
        drawn = {"name": labels[name], "legendgroup": name, "line": line(look[name]), "mode": "lines"}
        plot.add_scatter(x=factors.astype("f4"), y=value.astype("f4"), hovertemplate=told, **drawn)
    if not shares:
        return None
    most = min(FURTHEST, 1.5 * float(reached))
    ticks = [1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16]
    plot.add_vline(1.0, line={"color": INK, "width": 1, "dash": "4px,3px"})
    names = ["1/16", "1/8", "1/4", "1/2", "1", "2", "4", "8", "16"]
    scale = {"type": "log", "tickvals": ticks, "ticktext": names, "range": [-1.21, np.log10(most)]}
    plot.update_layout(
        xaxis={**scale, "title": f"error, × that of {labels[suite.reference]} in the same run"},
        yaxis={"title": "share of runs with at most that", "tickformat": ".0%", "range": [0, 1.02]},
        hovermode="closest",
    )
    fair = [n for n in shares if np.isfinite(suite.summary.at[n, "rank"])]
    fair = [n for n in fair if n in suite.classes.get("sensor", fair)] or list(shares)
    often = max(fair, key=lambda n: shares[n])
    title = f"{labels[often]} is better than {labels[suite.reference]} in {percent(shares[often])} of single runs"
    caption = (
        f"For every seed of the {len(suite.scored)} scored scenarios the error is divided by that of "
        f"{labels[suite.reference]} on the same seed. A curve further left and higher is better; where it crosses the "
        "dashed line it tells how often a run is better than the reference's. Bands are 95 % intervals; there is none "
        "where all seeds agree."
    )
    return Figure(f"profile-{suite.name}", title, caption, {"": plot}, height=430)
