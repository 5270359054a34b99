"""Pictures of a study: history, importances, slices, Pareto front, and what 20 % off costs."""

import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..measure.population import Population
from ..plots.palette import COLOURS, GRID, INK, QUIET
from ..plots.png import png
from ..store import runs
from .goals import metric
from .outcome import Found
from .space import Axis
from .study import Task
from .verdict import MARGINS

WIDEST = 4
"""Slices side by side."""


def write(
    folder: Path,
    study: Any,
    trials: pd.DataFrame,
    near: pd.DataFrame,
    task: Task,
    front: list[Found],
    population: tuple[Population, Population] | None = None,
) -> list[str]:
    """Writes the pictures that there is something to show for; gives their names.

    ``population``: Ms and margins before and after.
    """
    made = list(_all(study, trials, near, task, front))
    if population and len(population[1].machines) > 1:
        made.append(("margins", margins(*population, task.limits.ms)))
    return written(folder, made)


def written(folder: Path, figures: Iterable[tuple[str, Figure]]) -> list[str]:
    """Writes pictures; gives their names."""
    made = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, figure in figures:
            with runs.atomic(folder / "plots" / f"{name}.png") as part:
                part.write_bytes(png(figure))
            made.append(name)
    return made


def _all(
    study: Any, trials: pd.DataFrame, near: pd.DataFrame, task: Task, front: list[Found]
) -> Iterator[tuple[str, Figure]]:
    quantities = {name: p.quantity for name, p in task.base.parameters().items()}
    units = {name: q.unit for name, q in quantities.items() if q.unit not in ("", "1")}
    for i, name in enumerate(task.metrics):
        suffix = f"-{name}" if len(task.metrics) > 1 else ""
        text, higher = label(name, task), task.directions[i] == "maximize"
        yield f"history{suffix}", history(trials, task.controller, name, text, higher)
        yield f"slices{suffix}", slices(trials, task.controller, task.space.axes, name, text, units)
        found = importances(study, task.controller, name, i if len(task.metrics) > 1 else None)
        if found is not None:
            yield f"importances{suffix}", found
    if len(task.metrics) > 1 and front:
        yield "front", pareto(trials, task, front)
    if len(near):
        yield "sensitivity", twenty_per_cent(near, task)


def label(name: str, task: Task) -> str:
    """A metric with its unit."""
    m = metric(name, task.jobs)
    return f"{name} ({m.unit})" if m.unit != "1" else name


def _figure(title: str, width: float = 8.0, height: float = 3.6) -> Figure:
    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold", color=INK)
    return figure


def _plain(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _window(values: Any, good: Any, by: Callable[[float, float], Any]) -> None:
    """Limits that leave the worst of the trials out, which would press the rest flat.

    Args:
        values: of all trials.
        good: of those that keep the limits; what is far beyond them is left out.
        by: sets the limits.
    """
    kept = np.asarray([v for v in values if math.isfinite(v) and abs(v) < 1e5], float)
    if len(kept) > 4:
        low, high = float(kept.min()), float(np.quantile(kept, 0.9))
        if len(good):
            least, most = float(np.min(good)), float(np.max(good))
            beyond = max(2 * (most - least), 0.5 * abs(most))
            low, high = max(low, least - beyond), min(high, most + beyond)
        by(low - 0.05 * (high - low or abs(low) or 1.0), high + 0.1 * (high - low or abs(high) or 1.0))


def history(trials: pd.DataFrame, title: str, name: str, text: str, higher: bool = False) -> Figure:
    """Value of each trial, and the best so far of those that keep the limits.

    Args:
        trials: a row each, with columns trial, state, feasible and ``name``.
        title: what was searched.
        name: of the value.
        text: of its axis.
        higher: whether higher is better.
    """
    figure = _figure(f"{title}: trials of the study")
    axes = figure.add_subplot()
    whole, good = trials[trials["state"] == "complete"], trials[trials["feasible"]]
    bad = whole[~whole["feasible"]]
    axes.plot(bad["trial"], bad[name], "x", color=QUIET, markersize=4, label="breaks a limit")
    axes.plot(good["trial"], good[name], "o", color=COLOURS[0], markersize=4, label="keeps the limits")
    if len(good):
        best = good[name].cummax() if higher else good[name].cummin()
        axes.step(good["trial"], best, where="post", color=COLOURS[1], label="best so far")
    for state, colour in (("pruned", GRID), ("failed", INK)):
        at = trials[trials["state"] == state]["trial"]
        if len(at) or state == "pruned":
            axes.plot(at, np.zeros(len(at)), "|", color=colour, transform=axes.get_xaxis_transform(), label=state)
    _window(whole[name], good[name], axes.set_ylim)
    _plain(axes, "trial", text)
    axes.legend(frameon=False, fontsize=8)
    return figure


def slices(
    trials: pd.DataFrame, title: str, searched: tuple[Axis, ...], name: str, text: str, units: dict[str, str]
) -> Figure:
    """Value against each parameter, the later the darker.

    Args:
        trials, title, name, text: as for :func:`history`.
        searched: the parameters; one that no finished trial has, such as a number of a filter that none of them is,
            is not shown.
        units: of those that have one.
    """
    whole = trials[(trials["state"] == "complete")]
    shown = [axis for axis in searched if axis.name in whole and whole[axis.name].notna().any()]
    rows = max(1, math.ceil(len(shown) / WIDEST))
    figure = _figure(f"{title}: slices, later trials darker", 11.0, 0.6 + 2.3 * rows)
    grid = figure.subplots(rows, min(WIDEST, max(1, len(shown))), squeeze=False)
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    for axes, axis in zip(grid.flat, shown, strict=False):
        mine = whole[whole[axis.name].notna()]
        for good, marker in ((False, "x"), (True, "o")):
            part = mine[mine["feasible"] == good]
            looks = {"marker": marker, "s": 14, "linewidths": 0.8 if good is False else 0}
            shades = {"c": part["trial"], "cmap": "Blues", "vmin": -0.4 * len(trials), "vmax": len(trials)}
            axes.scatter(part[axis.name], part[name], **shades, **looks)
        if axis.log:
            axes.set_xscale("log")
        if axis.choices:
            axes.tick_params(axis="x", rotation=40, labelsize=7)
        _plain(axes, axis.name + (f" ({units[axis.name]})" if axis.name in units else ""), "")
        _window(mine[name], mine[mine["feasible"]][name], axes.set_ylim)
    for row in grid:
        row[0].set_ylabel(text)
    return figure


def importances(study: Any, title: str, name: str, i: int | None = None) -> Figure | None:
    """What better trials have in common: each parameter's share (Watanabe et al. 2023), for value ``i`` of several."""
    try:
        shares = optuna.importance.get_param_importances(study, target=None if i is None else (lambda t: t.values[i]))
    except (ValueError, RuntimeError):  # too few trials
        return None
    if not shares or not all(map(math.isfinite, shares.values())):
        return None
    figure = _figure(f"{title}: importance for {name}", 8.0, 1.2 + 0.3 * len(shares))
    axes = figure.add_subplot()
    names = list(shares)[::-1]
    axes.barh(names, [shares[n] for n in names], color=COLOURS[0])
    _plain(axes, "share", "")
    axes.grid(axis="y", visible=False)
    return figure


def pareto(trials: pd.DataFrame, task: Task, front: list[Found]) -> Figure:
    """All trials and the front, for each pair of the first metric with another."""
    figure = _figure(f"{task.controller}: Pareto front", 4.6 * (len(task.metrics) - 1) + 1.0, 4.0)
    grid = figure.subplots(1, len(task.metrics) - 1, squeeze=False)[0]
    whole, first = trials[trials["state"] == "complete"], task.metrics[0]
    for i, (axes, other) in enumerate(zip(grid, task.metrics[1:], strict=True), 1):
        for good, marker, colour, text in (
            (False, "x", QUIET, "breaks a limit"),
            (True, "o", COLOURS[5], "keeps the limits"),
        ):
            part = whole[whole["feasible"] == good]
            axes.plot(part[first], part[other], marker, color=colour, markersize=4, label=text)
        points = sorted((f.values[0], f.values[i]) for f in front)
        axes.plot(*zip(*points, strict=True), "o-", color=COLOURS[1], markersize=5, label="front")
        kept = whole[whole["feasible"]]
        _window(whole[first], kept[first], axes.set_xlim)
        _window(whole[other], kept[other], axes.set_ylim)
        _plain(axes, label(first, task), label(other, task))
    grid[0].legend(frameon=False, fontsize=8)
    return figure


def margins(before: Population, after: Population, limit: float) -> Figure:
    """Share of the machines up to which Ms, gain and delay margin reach, before and after."""
    figure = _figure(f"Ms and margins on {len(after.machines)} machines that may be meant", 11.0, 2.9)
    for axes, (column, title, unit, _) in zip(figure.subplots(1, len(MARGINS)), MARGINS, strict=True):
        for population, colour, words in ((before, QUIET, "before"), (after, COLOURS[0], "tuned")):
            values = np.sort(population.machines[column].dropna().to_numpy(float))
            values = values[np.isfinite(values)]
            shares = 100.0 * (np.arange(len(values)) + 1) / max(1, len(population.machines))
            axes.step(values, shares, where="post", color=colour, label=words)
        if column == "ms" and math.isfinite(limit):
            axes.axvline(limit, color=INK, linewidth=1, linestyle="--", label="limit")
        axes.set_ylim(0, 102)
        _plain(axes, f"{title} ({unit})" if unit else title, "share of the machines (%)" if column == "ms" else "")
        axes.legend(frameon=False, fontsize=8)
    return figure


def twenty_per_cent(near: pd.DataFrame, task: Task) -> Figure:
    """Change of the first metric when a parameter is 20 % off."""
    name = task.metrics[0]
    names = list(dict.fromkeys(near["parameter"]))[::-1]
    figure = _figure(f"{task.controller}: one parameter 20 % off", 8.0, 1.4 + 0.36 * len(names))
    axes = figure.add_subplot()
    for side, colour, text, shift in ((-1, COLOURS[0], "20 % less", 0.18), (1, COLOURS[1], "20 % more", -0.18)):
        part = near[near["side"] == side].set_index("parameter")
        at = [i for i, n in enumerate(names) if n in part.index]
        change = [100.0 * (float(part.at[names[i], name]) - 1.0) for i in at]
        axes.barh([i + shift for i in at], change, 0.34, color=colour, label=text)
    axes.set_yticks(range(len(names)), names)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    _plain(axes, f"change of {name} (%), whole parameters at least by one", "")
    axes.grid(axis="y", visible=False)
    axes.legend(frameon=False, fontsize=8)
    return figure
