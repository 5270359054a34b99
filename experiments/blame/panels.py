"""Picture of blame: each stage's share of the mean-square error, a panel for each scenario and error."""

from matplotlib.figure import Figure
from pandas import DataFrame

from ..plots.palette import COLOURS, GRID, INK, MARKERS
from .shares import REST


def picture(shares: DataFrame) -> Figure:
    """Shares with their 95 % intervals over seeds; those of a controller add up to its mean-square error."""
    panels = list(shares.groupby(["scenario", "error"], sort=False))
    controllers = list(dict.fromkeys(shares["controller"]))
    stages = list(dict.fromkeys(shares["stage"]))
    height = 1.3 + len(panels) * (0.5 + len(stages) * (0.12 + 0.13 * len(controllers)))
    figure = Figure(figsize=(8.0, height), dpi=110, layout="constrained")
    figure.suptitle("What the true error is made of", x=0.01, ha="left", fontsize=11, fontweight="bold", color=INK)
    grid = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for axes, ((scenario, error), rows) in zip(grid, panels, strict=True):
        for i, controller in enumerate(controllers):
            part = rows[rows["controller"] == controller]
            y = [stages.index(stage) + 0.6 * ((i + 0.5) / len(controllers) - 0.5) for stage in part["stage"]]
            colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
            axes.hlines(y, part["low"], part["high"], color=colour, linewidth=1.6)
            axes.plot(part["share"], y, marker, color=colour, markersize=4.5, label=controller)
        axes.set_yticks(range(len(stages)), [f"left to the {s}" if s == REST else s for s in stages])
        axes.set_ylim(len(stages) - 0.5, -0.5)
        axes.axvline(0.0, color=INK, linewidth=0.8)
        axes.grid(axis="x", color=GRID, linewidth=0.8)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_title(f"{scenario}, error of the {error}", loc="left", fontsize=9)
    grid[0].legend(frameon=False, fontsize=8)
    grid[-1].set_xlabel(f"share of the mean-square true error ({shares['unit'].iloc[0]}), 95 % interval over seeds")
    return figure
