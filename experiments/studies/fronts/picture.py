"""Two fronts and the bound as a picture."""

import numpy as np
from matplotlib.figure import Figure

from ...plots.palette import COLOURS, GRID, INK, MARKERS, QUIET
from .comparing import Member
from .points import METRICS

VIEWS = ((0, 2), (0, 3), (0, 1), (2, 3))
TITLES = {"time": "time, s", "dross": "dross, mm", "roughness": "Rz, µm", "contour_rms": "contour RMS, µm"}


def picture(fronts: dict[str, list[Member]], reference: np.ndarray, bound: np.ndarray) -> Figure:
    """Every pair of :data:`VIEWS`: all members, on test seeds; left and down is better in each.

    Args:
        fronts: by name.
        reference: the point of the plain method.
        bound: points of the bound, whose contour error says nothing.
    """
    figure = Figure(figsize=(10.0, 7.6), dpi=110, layout="constrained")
    grid = figure.subplots(2, 2).ravel()
    for axes, (x, y) in zip(grid, VIEWS, strict=True):
        if 3 not in (x, y):
            order = stairs(bound[:, [x, y]])
            axes.plot(bound[order, x], bound[order, y], color=QUIET, linewidth=1.0, label="bound")
        for k, (name, front) in enumerate(fronts.items()):
            points = np.array([m.figures() for m in front])
            axes.plot(
                points[:, x], points[:, y], MARKERS[k], color=COLOURS[k], markersize=4.5, alpha=0.75, label=name
            )  # fmt: skip
        axes.plot(*reference[[x, y]], "*", color=INK, markersize=9, label="huang2024-dynamic")
        if 3 in (x, y):
            axes.set_yscale("log")
        axes.set_xlabel(TITLES[METRICS[x]])
        axes.set_ylabel(TITLES[METRICS[y]])
        axes.grid(color=GRID, linewidth=0.8)
    grid[0].legend(frameon=False, fontsize=9)
    return figure


def stairs(points: np.ndarray) -> np.ndarray:
    """Indices of the points of two coordinates that no other betters in both, in order of the first."""
    order = np.lexsort((points[:, 1], points[:, 0]))
    least = np.minimum.accumulate(points[order, 1])
    return order[points[order, 1] <= np.concatenate([[np.inf], least[:-1]]) - 1e-12]
