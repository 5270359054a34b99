"""The picture of ``kerfgym speed``: what a machine-step costs, against the number of machines."""

import pandas as pd
from matplotlib.figure import Figure

from ..plots.palette import COLOURS, GRID, INK, MARKERS, QUIET

CURVES = (
    "kernel, step by step",
    "kernel with action and observation",
    "VectorEnv.step",
    "stable-baselines3 VecEnv.step",
)
LEVELS = ("Pendulum-v1 unwrapped", "HalfCheetah-v5 unwrapped", "env.step", "plain NumPy model, batched")


def picture(costs: pd.DataFrame) -> Figure:
    """Nanoseconds of CPU time per machine-step against N, both logarithmic; bars span the rounds."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    one = costs[costs.threads == 1]
    for i, name in enumerate(CURVES):
        rows = one[one.name == name].sort_values("machines")
        if len(rows):
            span = [rows.ns_per_step - rows.ns_low, rows.ns_high - rows.ns_per_step]
            looks = {"color": COLOURS[i], "marker": MARKERS[i], "ms": 5, "lw": 1.8, "elinewidth": 1, "capsize": 2}
            axes.errorbar(rows.machines, rows.ns_per_step, span, label=name, **looks)
    for name in LEVELS:
        rows = one[one.name == name]
        if len(rows):
            level, n = float(rows.ns_per_step.iloc[0]), int(rows.machines.iloc[0])
            axes.axhline(level, color=QUIET, lw=0.9, ls=(0, (4, 2)))
            text = name if n == 1 else f"{name}, N = {n}"
            looks = {"ha": "right", "va": "bottom", "fontsize": 8.5, "color": QUIET}
            axes.annotate(f"{text}: {level:,.0f} ns", (0.99, level), xycoords=("axes fraction", "data"), **looks)
    axes.set(xscale="log", yscale="log", xlabel="machines, N")
    axes.set_ylabel("CPU time of a machine-step (1 ms of cutting), ns")
    axes.set_title("What one millisecond of one machine costs", loc="left", color=INK)
    axes.set_xticks([1, 8, 32, 128, 512, 1024, 4096], [1, 8, 32, 128, 512, 1024, 4096])
    axes.minorticks_off()
    axes.grid(color=GRID)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=9)
    return figure
