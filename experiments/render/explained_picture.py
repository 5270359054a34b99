"""The picture of :mod:`explained`: a column for each scenario; actions, what they add, sheet and error below."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ...envs.scenarios import Machine, machines
from ..plots.palette import COLOURS, GRID, INK, QUIET, SHADE
from ..plots.png import png
from ..store.runs import atomic
from .explained import SCENARIOS, Explained, explained, largest, meanings, policy_of

SERIES = 6
"""Actions that have a colour; the others are grey."""

DASHES = ("-", (0, (6, 1.5)), "-", (0, (4, 1.5, 1, 1.5)), "-", (0, (1.5, 1.2)))
"""Of the six, so that they are told apart without colours."""

OTHERS, BASE, POLICY, ADDED = "#c3c8cd", "#6b727a", COLOURS[0], INK

TITLES = {"step": "a step", "wavy": "a wave", "holes": "a hole"}

WIDTH, LEFT, LEGEND, HEIGHT, DPI = 3.9, 1.05, 3.1, 9.0, 130
"""Inches of a column, of the words at the left and at the right of it and of the whole; dots per inch."""

LETTER, SMALL_LETTER = 0.125, 0.078
"""Inches of a letter of the title, and of the line below, on average."""


def paint(out: Path, policy: str, chosen: Sequence[str], seed: int, on: Machine | None = None) -> list[str]:
    """Writes the picture of a policy as PNG; returns what a reader must know. ``on``: the machine that both drive, in
    place of what the scenarios say of one.

    Raises:
        InvalidInput: another suffix, no such policy, scenario or seed, or a scenario with a job.
    """
    if out.suffix != ".png":
        raise InvalidInput(f"cannot write '{out}'; the actions of a policy are a picture: .png")
    if seed < 0:
        raise InvalidInput(f"--seed {seed} is out of range; 0 and up")
    stack, cases = policy_of(policy), [scenarios.load(name) for name in chosen or SCENARIOS]
    for case in cases:
        if case.job:
            raise InvalidInput(f"scenario '{case.name}' has a job; actions are drawn of height followers only")
    replaced = machines.warnings(cases, on) if on else []
    cases = [machines.put_on(case, on) for case in cases] if on else cases
    found = [explained(stack, case, seed) for case in cases]
    names = [policy if len(policy) < 40 else Path(policy).name, stack.pilot.policy.document.base["z"].name]  # type: ignore[union-attr]
    with atomic(out) as part:
        part.write_bytes(png(draw(found, meanings(stack), names[0], names[1], seed, on.name if on else "")))
    return replaced + [f"in {each.scenario} it hands over to its base {names[1]}" for each in found if each.alone]


def draw(
    found: Sequence[Explained], names: Sequence[str], policy: str, base: str, seed: int, machine: str = ""
) -> Figure:
    """The figure.

    Args:
        found: scenarios, a column each.
        names: what the actions are.
        policy, base: what the two are called.
        seed: of the scenarios.
        machine: on which they were put; empty if the scenarios say what it is.
    """
    weighs = all(each.effects is not None for each in found)
    tall = [2.2, *([1.7] if weighs else []), 1.0, 1.9]
    width, height = LEFT + WIDTH * len(found) + LEGEND, HEIGHT - (0.0 if weighs else 1.9)
    figure = Figure((width, height), dpi=DPI, facecolor="white")
    grid = figure.subplots(len(tall), len(found), sharex="col", squeeze=False, height_ratios=tall)
    shown = largest(found, SERIES)
    for column, each in enumerate(found):
        _column(list(grid[:, column]), each, shown, weighs)
        grid[0, column].set_title(TITLES.get(each.scenario, each.scenario), loc="left", fontsize=11.5, color=INK, pad=7)
    for axes, words in zip(grid[:, 0], _axes(weighs), strict=True):
        axes.set_ylabel(words, fontsize=9, color=INK)
    idle = not any(each.actions[each.window].any() for each in found)
    for row in grid[: 2 if weighs else 1]:  # what is decided has one scale for all scenarios, what comes of it has not
        ends = np.array([axes.get_ylim() for axes in row])
        for number, axes in enumerate(row):
            axes.set_ylim(*((-1.0, 1.0) if idle else (ends[:, 0].min(), ends[:, 1].max())))
            axes.tick_params(labelleft=number == 0)
    figure.align_ylabels(grid[:, 0])
    title = f"What {policy} adds to the weights of its base, {base}"
    if not weighs:
        title = f"What {policy} decides, beside its base, {base}"
    lines = textwrap.wrap(title, int((width - LEFT) / LETTER))
    below_it = textwrap.wrap(_told(len(names), len(shown), weighs, seed, machine), int((width - LEFT) / SMALL_LETTER))
    below = 0.25 * len(lines) + 0.19 * len(below_it)
    figure.subplots_adjust(
        LEFT / width, 0.6 / height, 1 - LEGEND / width, 1 - (0.62 + below) / height, wspace=0.15, hspace=0.16
    )
    top = {"color": INK, "va": "top", "linespacing": 1.25}
    figure.text(LEFT / width, 1 - 0.15 / height, "\n".join(lines), fontsize=14, weight="bold", **top)
    at = 1 - (0.2 + 0.25 * len(lines)) / height
    figure.text(LEFT / width, at, "\n".join(below_it), fontsize=9.5, **{**top, "color": QUIET})
    _legends(grid, [names[i] for i in shown], len(names) > len(shown), policy, base, weighs)
    return figure


def _told(count: int, shown: int, weighs: bool, seed: int, machine: str) -> str:
    """What stands below the title."""
    seeded = f"Machine {machine}, seed {seed}" if machine else f"Seed {seed}"
    drawn = f"Of {count} actions the {shown} that matter most here have a colour. " if count > shown > 0 else ""
    if not weighs:
        return f"{drawn}{seeded}; both met the same sheet, machine and noise."
    return f"0: as its base; 1 and −1: the whole span of a weight. {drawn}{seeded}, the same for both."


def _axes(weighs: bool) -> list[str]:
    added = ["adds to the\ncommand, mm/s"] if weighs else []
    return ["change of weight,\nshare of its span" if weighs else "action", *added, "sheet, mm", "gap error, µm"]


def _column(axes: list[Axes], each: Explained, shown: Sequence[int], weighs: bool) -> None:
    at, time = each.window, each.time
    for one in axes:
        one.grid(True, color=GRID, lw=0.7)
        one.set_axisbelow(True)
        one.tick_params(labelsize=8.5, colors=QUIET, length=0)
        for side in one.spines.values():
            side.set_visible(False)
        _shaded(one, time, np.isnan(each.sheet[at]), SHADE)
        one.axhline(0.0, color=QUIET, lw=0.8, zorder=1)
    _lines(axes[0], time, each.actions[at], shown)
    if weighs and each.effects is not None and each.added is not None:
        _lines(axes[1], time, each.effects[at], shown)
        axes[1].plot(time, each.added[at], color=ADDED, lw=2.2, alpha=0.9, zorder=4)
    axes[-2].plot(time, each.sheet[at], color=INK, lw=1.6)
    axes[-1].plot(time, each.error[at], color=POLICY, lw=1.9)
    axes[-1].plot(time, each.base_error[at], color=BASE, lw=1.4, ls=(0, (4, 1.5)))
    axes[-1].set_xlabel(f"ms, from {1e-3 * at.start:.2f} s", fontsize=9, color=QUIET)
    axes[-1].set_xlim(time[0], time[-1])
    both = [1e6 * np.nanmean(1e-6 * e[at] ** 2) for e in (each.base_error, each.error)]
    words = f"RMS here {np.sqrt(both[1]):.1f} against {np.sqrt(both[0]):.1f} µm"
    axes[-1].set_title(words, loc="right", fontsize=8.5, color=QUIET, pad=3)
    if np.isnan(each.sheet[at]).any():
        gone = time[np.isnan(each.sheet[at])]
        axes[-2].margins(y=0.3)
        axes[-2].annotate("no sheet", (gone.mean(), 0.5), xycoords=("data", "axes fraction"), rotation=90, fontsize=8,
                          color=QUIET, ha="center", va="center")  # fmt: skip
    little = each.trust[at] < 0.995
    if each.alone:
        middle = {"transform": axes[0].transAxes, "ha": "center", "va": "center", "fontsize": 11, "color": INK}
        axes[0].text(0.5, 0.72, "hands over to its base:\noutside of the range of its training", **middle)
    elif little.any():
        kept = f"keeps {100 * float(each.trust[at].min()):.0f} % of its action at least: it hands over to its base"
        if each.trust[at].min() < 0.9:
            axes[0].text(0.02, 0.03, kept, transform=axes[0].transAxes, fontsize=8, color=QUIET)


def _lines(axes: Axes, time: Any, values: Any, shown: Sequence[int]) -> None:
    for i in (i for i in range(values.shape[1]) if i not in shown):
        axes.plot(time, values[:, i], color=OTHERS, lw=0.7, zorder=2)
    for rank, i in reversed(list(enumerate(shown))):
        axes.plot(time, values[:, i], color=COLOURS[rank], ls=DASHES[rank], lw=1.7, zorder=3)


def _shaded(axes: Axes, time: Any, where: Any, colour: str) -> None:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(time[start] - 0.5, time[min(stop, len(time)) - 1] + 0.5, color=colour, lw=0, zorder=0)


def _legends(grid: Any, names: Sequence[str], grey: bool, policy: str, base: str, weighs: bool) -> None:
    """Words at the right of the last column."""
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.02, 1.0), "frameon": False, "fontsize": 9}
    place |= {"borderaxespad": 0.0, "handlelength": 2.6, "labelcolor": INK}
    line = grid[0, -1].plot
    handles = [line([], [], color=COLOURS[i], ls=DASHES[i], lw=2.0, label=name)[0] for i, name in enumerate(names)]
    handles += [line([], [], color=OTHERS, lw=1.0, label="others")[0]] if grey else []
    title = "weight, ± its span" if weighs else "action, its range"
    legend = grid[0, -1].legend(handles=handles, title=title, title_fontsize=9, alignment="left", **place)
    legend.get_title().set_color(QUIET)
    if weighs:
        grid[1, -1].legend(handles=[line([], [], color=ADDED, lw=2.2, label="all together")[0]], **place)
    lines = ((base, BASE, (0, (4, 1.5))), (policy, POLICY, "-"))
    handles = [line([], [], color=colour, ls=style, lw=1.8, label=name)[0] for name, colour, style in lines]
    grid[-1, -1].legend(handles=handles, **place)
