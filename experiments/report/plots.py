"""Pictures of a benchmark: each shows one idea and returns a :class:`matplotlib.figure.Figure` of its own.

A controller has the same colour (Okabe and Ito's palette), line style and marker in every picture, in the order in
which it was asked for. A picture for which the results hold nothing says so in words. Figures are made without
``pyplot``, so nothing is shared between them.
"""

import math
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator
from scipy.stats import binomtest

from ...envs.plant import supervisor
from ...envs.plant.controller import INFORMATION
from ..results import REFERENCE, Results

Floats = npt.NDArray[np.float64]

INK, QUIET, GRID, SHADE = "#1a1d20", "#5f666d", "#e1e4e8", "#eceef0"

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's palette without yellow, which does not show on white."""

LINES: tuple[Any, ...] = ("-", (0, (6, 1.5)), (0, (6, 1.5, 1.5, 1.5)), (0, (2, 1)), (0, (10, 1.5, 3, 1.5)))
"""Five, so that with seven colours the first 35 controllers differ in one or the other."""

MARKERS = "osD^vPX"

LIMIT_MS = 2.0
"""Largest Ms that tuning allows."""

WINDOW = 1.0
"""s shown by an oscilloscope, at most."""

SETTLE = 0.3
"""s at the start among which no oscilloscope's window is looked for, if there is more."""

PANELS = 4
"""Controllers that are shown on a drawing's contour, at most."""

SEGMENTS = 3000
"""Coloured pieces of a contour, at most; each takes the largest error of its periods."""

CROSSINGS = 25
"""How often the error may cross its middle in an oscilloscope's window before it is taken shorter."""

BEFORE_ALARM = 0.7
"""Share of the window before the first alarm."""

LOCATED = ("x", "y")

WIDTH, DPI = 9.0, 150
"""in, and dots per inch of the files"""

KNOWS = {
    "sensor": "sees only what the machine measures",
    "preview": "knows the sheet ahead, not ranked",
    "privileged": "knows the true gap, not ranked",
}
"""Information classes in words."""

HATCHES = {"sensor": "", "preview": "////", "privileged": "xxxx"}


class Look(NamedTuple):
    """How a controller is drawn."""

    colour: str
    line: Any
    marker: str


def looks(results: Results) -> dict[str, Look]:
    """The look of each controller, in order of appearance."""
    return {
        name: Look(COLOURS[i % len(COLOURS)], LINES[i % len(LINES)], MARKERS[i % len(MARKERS)])
        for i, name in enumerate(results.controllers)
    }


def ranked(results: Results, summary: pd.DataFrame | None = None) -> dict[str, list[str]]:
    """Controllers of each information class, least informed class first, best score first, without a score last."""
    summary = results.summary() if summary is None else summary
    known = [*INFORMATION, *dict.fromkeys(summary["information"])]
    out = {}
    for information in dict.fromkeys(known):
        group = summary[summary["information"] == information]
        if len(group):
            out[information] = list(group["score"].sort_values(kind="stable", na_position="last").index)
    return out


def scored_scenarios(results: Results) -> list[str]:
    """The scenarios that make the score: the core ones that were run, or all if none of them was."""
    ran = results.scenarios
    return [s for s in results.core if s in ran] or ran


def scored_in_words(results: Results) -> str:
    """Over what the score is taken: ``geometric mean over the 7 core scenarios``, ``in the scenario 'wavy'`` …"""
    names = scored_scenarios(results)
    if len(names) == 1:
        return f"in the scenario '{names[0]}'"
    return f"geometric mean over the {len(names)} {'core ' if set(names) <= set(results.core) else ''}scenarios"


def _error_label(results: Results, kind: str) -> str:
    words = scored_in_words(results)
    return f"RMS {kind}gap error{' ' if words.startswith('in ') else ', '}{_plain(words, 60)} (µm, log scale)"


def number(value: float) -> str:
    """Three significant digits in plain notation; a dash for what is missing."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    digits = 2 if abs(value) < 9.995 else 1 if abs(value) < 99.95 else 0
    return f"{value:.{digits}f}".replace("-", "−")


def shown_scenarios(results: Results) -> list[str]:
    """Scenarios of which there are traces, the core ones first."""
    if "scenario" not in results.traces:
        return []
    traced = set(results.traces["scenario"].unique())
    return [s for s in _core_first(results) if s in traced]


def located(results: Results) -> pd.DataFrame:
    """The traces that follow a drawing: those with a finite place; empty if there are none."""
    if not all(axis in results.traces for axis in LOCATED):
        return pd.DataFrame()
    return results.traces[np.isfinite(results.traces[list(LOCATED)].to_numpy(float)).all(axis=1)]


# --------------------------------------------------------------------------------------------------- conveniences


def _core_first(results: Results) -> list[str]:
    """Core scenarios, then the ordinary, then those in which collisions are expected."""
    names = results.scenarios
    first = [s for s in results.core if s in names]
    last = [s for s in names if s in results.exempt and s not in first]
    return first + [s for s in names if s not in first and s not in last] + last


def _plain(name: str, longest: int = 30) -> str:
    """A name as matplotlib shows it literally, shortened in the middle."""
    name = " ".join(str(name).split())
    if len(name) > longest:
        name = f"{name[: longest - 13]}…{name[-12:]}"
    return (" " if name.startswith("_") else "") + name.replace("$", r"\$")


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white", layout="constrained")
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.06)
    return figure


def _wrapped(figure: Figure, text: str) -> str:
    """A title in lines as long as the figure is wide."""
    return textwrap.fill(text, int(10.0 * figure.get_figwidth()))


def _title(figure: Figure, text: str) -> None:
    lines = _wrapped(figure, text)
    place = {} if figure.get_layout_engine() else {"y": 1 - 0.08 / figure.get_figheight()}
    figure.suptitle(lines, x=0.008, ha="left", va="top", fontsize=12, fontweight="bold", color=INK, **place)


def _dress(axes: Axes, x: str = "", y: str = "", grid: str = "both") -> None:
    """White, with the two axes that are read and a quiet grid."""
    axes.set_facecolor("white")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(QUIET)
    axes.tick_params(labelsize=9, colors=INK, color=QUIET, length=3)
    if grid:
        axes.grid(True, axis=grid, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.set_xlabel(x, fontsize=9.5, color=INK)
    axes.set_ylabel(y, fontsize=9.5, color=INK)


def _logarithmic(axis: Axis, low: float, high: float) -> None:
    """Ticks in plain numbers, as many as are legible."""
    decades = math.log10(high / low)
    subs: Sequence[float] = (1,)
    for least, choice in ((2.5, (1, 2, 5)), (1.5, (1, 2, 3, 5)), (0.7, (1, 1.5, 2, 3, 4, 5, 6, 8))):
        if decades < least:
            subs = choice
    axis.set_major_locator(LogLocator(base=10, subs=subs, numticks=40))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def _log_limits(values: Iterable[float], below: float = 1.3, above: float = 1.3) -> tuple[float, float]:
    """Limits around the finite positive values."""
    array = np.asarray(list(values), float)
    array = array[np.isfinite(array) & (array > 0)]
    if not len(array):
        return 1.0, 100.0
    return float(array.min() / below), float(array.max() * above)


def _nothing(text: str) -> Figure:
    """A picture that says in words why there is none."""
    figure = _figure(WIDTH, 1.2)
    figure.text(0.5, 0.5, _plain(text, 200), ha="center", va="center", fontsize=11, color=QUIET)
    return figure


def _rows(results: Results, summary: pd.DataFrame) -> tuple[dict[str, float], dict[str, float], float]:
    """Height of each controller's row and of each class's heading, best at the top, and the lowest edge."""
    at, headings, y = {}, {}, 0.0
    groups = ranked(results, summary)
    for information, names in groups.items():
        if len(groups) > 1 or information != "sensor":
            headings[information] = y
            y -= 0.85
        for name in names:
            at[name] = y
            y -= 1.0
        y -= 0.25
    return at, headings, y


def _class_headings(axes: Axes, headings: dict[str, float]) -> None:
    """Words above each class's rows, and a line that separates it from the class before."""
    across = axes.get_yaxis_transform()
    for i, (information, y) in enumerate(headings.items()):
        words = f"{information}: {KNOWS.get(information, 'not ranked')}"
        axes.text(
            0.006, y, words, transform=across, va="center", fontsize=8.5, color=QUIET, style="italic", zorder=5,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        )  # fmt: skip
        if i:
            axes.axhline(y + 0.62, color=QUIET, linewidth=0.8)


def _legend(figure: Figure, handles: Sequence[Any], labels: Sequence[str]) -> None:
    columns = 4 if max((len(label) for label in labels), default=0) < 24 else 3
    figure.legend(
        handles, labels, loc="outside lower center", ncols=min(columns, len(labels)), fontsize=9, frameon=False,
        handlelength=3.2, labelcolor=INK,
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------------- pictures


def scores(results: Results) -> Figure:
    """Geometric mean over the core scenarios of each controller's RMS true error, classes apart."""
    summary, style = results.summary(), looks(results)
    at, headings, bottom = _rows(results, summary)
    figure = _figure(WIDTH, 1.5 + 0.33 * (0.5 - bottom))
    axes = figure.add_subplot()
    low, high = _log_limits(summary["score"], below=1.6, above=1.7)
    _dress(
        axes,
        _error_label(results, "true "),
        grid="x",
    )
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.set_ylim(bottom + 0.4, 0.7)
    for name, y in at.items():
        score, information = float(summary.loc[name, "score"]), str(summary.loc[name, "information"])
        if not np.isfinite(score):
            words = f"no score: {int(summary.loc[name, 'failed'])} failed runs"
            axes.text(low * 1.02, y, words, va="center", fontsize=9, color=QUIET)
            continue
        ranks = information == "sensor"
        axes.barh(
            y, score - low, left=low, height=0.66, facecolor=style[name].colour if ranks else "white",
            edgecolor=style[name].colour, hatch=HATCHES.get(information, "...."), linewidth=1.2, zorder=2,
        )  # fmt: skip
        axes.annotate(
            f"{number(score)} µm", (score, y), (5, 0), textcoords="offset points", va="center", fontsize=9.5, color=INK,
            fontweight="bold" if ranks else "normal", zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        )  # fmt: skip
    reference = float(summary["score"].get(REFERENCE, np.nan))
    if np.isfinite(reference):
        axes.axvline(reference, color=INK, linewidth=1.1, linestyle=(0, (4, 2)), zorder=3)
        axes.text(
            reference, 1.01, f"reference {REFERENCE}", transform=axes.get_xaxis_transform(), ha="center", va="bottom",
            fontsize=8.5, color=INK,
        )  # fmt: skip
    _class_headings(axes, headings)
    axes.set_yticks(list(at.values()), [_plain(name) for name in at], fontsize=10)
    axes.tick_params(axis="y", length=0)
    _logarithmic(axes.xaxis, low, high)
    _title(figure, _scores_title(results, summary))
    return figure


def _scores_title(results: Results, summary: pd.DataFrame) -> str:
    sensor = [c for c in ranked(results, summary).get("sensor", []) if np.isfinite(summary.loc[c, "score"])]
    if not sensor:
        return "Score of each controller"
    best = f"{_plain(sensor[0])} {'follows closest' if len(sensor) > 1 else 'follows'}"
    others = " of the controllers that use the sensor only" if len(sensor) > 1 else ""
    return f"{best}{others}: {number(float(summary.loc[sensor[0], 'score']))} µm"


def heat(results: Results) -> Figure:
    """Pooled RMS true error of every controller in every scenario, as a map with its numbers."""
    summary, pooled, order = results.summary(), results.pooled(), _core_first(results)
    groups = ranked(results, summary)
    rows = [name for names in groups.values() for name in names]
    table = pooled.loc[rows, order].to_numpy(float)
    figure = _figure(max(WIDTH, 2.5 + 0.46 * len(order)), 2.5 + 0.36 * len(rows))
    axes = figure.add_subplot()
    ordinary = [s for s in order if s not in results.exempt] or order
    low, high = _log_limits(pooled.loc[rows, ordinary].to_numpy(float).ravel(), 1.0, 1.0)
    low = min(max(low, 0.1), 0.1 * high)  # one controller that is almost perfect must not wash out the others
    high = max(high, 1.01 * low)
    norm = LogNorm(low, high, clip=True)
    colours = colormaps["cividis"].reversed()
    image = axes.imshow(
        np.ma.masked_invalid(np.clip(table, low, high)), cmap=colours, norm=norm, aspect="auto", interpolation="nearest"
    )
    for i, j in np.ndindex(*table.shape):
        value = table[i, j]
        dark = np.isfinite(value) and sum(colours(norm(value))[:3]) < 1.45
        axes.text(
            j, i, _cell(value), ha="center", va="center", fontsize=8.5 if np.isfinite(value) else 7.5,
            color="white" if dark else INK,
        )  # fmt: skip
    axes.set_xticks(np.arange(len(order)), [_plain(s, 22) + ("*" if s in results.exempt else "") for s in order])
    axes.tick_params(axis="x", labelsize=9, rotation=40, length=0)
    for label in axes.get_xticklabels():
        label.set_ha("right")
        label.set_rotation_mode("anchor")
    classes = {name: information for information, names in groups.items() for name in names}
    words = [_plain(n) + ("" if classes[n] == "sensor" else f" ({classes[n]})") for n in rows]
    axes.set_yticks(np.arange(len(rows)), words, fontsize=9.5)
    axes.tick_params(axis="y", length=0)
    axes.spines[:].set_visible(False)
    axes.set_xticks(np.arange(len(order) - 1) + 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows) - 1) + 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1.5)
    axes.tick_params(which="minor", length=0)
    edge = -0.5
    for names in list(groups.values())[:-1]:
        edge += len(names)
        axes.axhline(edge, color=INK, linewidth=1.6)
    _brackets(axes, order, results)
    beyond = np.nanmax(table, initial=0.0) > high
    bar = figure.colorbar(image, ax=axes, pad=0.015, aspect=14, extend="max" if beyond else "neither")
    bar.set_label("RMS true gap error (µm, log scale)", fontsize=9)
    _logarithmic(bar.ax.yaxis, low, high)
    bar.ax.tick_params(labelsize=8.5)
    bar.outline.set_visible(False)
    _title(figure, _heat_title(results, pooled, groups))
    return figure


def _cell(value: float) -> str:
    if not np.isfinite(value):
        return "failed"
    return f"{value:.1f}" if value < 99.95 else f"{value:.0f}" if value < 99999.5 else f"{value:.0e}"


def _brackets(axes: Axes, order: list[str], results: Results) -> None:
    """Brackets above the core scenarios and those in which collisions are expected."""
    spans = ((results.core, "core: make the score"), (results.exempt, "* built to defeat followers"))
    for names, words in spans:
        at = [j for j, s in enumerate(order) if s in names and not (names is results.exempt and s in results.core)]
        if not at:
            continue
        first, last, across = at[0] - 0.45, at[-1] + 0.45, axes.get_xaxis_transform()
        axes.plot(
            [first, first, last, last],
            [1.01, 1.04, 1.04, 1.01],
            transform=across,
            color=INK,
            linewidth=1,
            clip_on=False,
        )
        short = len(at) < 4
        axes.text(
            last if short else (first + last) / 2, 1.06, words, transform=across, ha="right" if short else "center",
            va="bottom", fontsize=8.5, color=INK,
        )  # fmt: skip


def _heat_title(results: Results, pooled: pd.DataFrame, groups: dict[str, list[str]]) -> str:
    names = groups.get("sensor") or [name for group in groups.values() for name in group]
    means = np.log(pooled.loc[names, scored_scenarios(results)].replace(0, np.nan)).mean()
    if means.notna().sum() < 2:
        return "RMS true gap error of each controller in each scenario"
    most, least = _plain(str(means.idxmax())), _plain(str(means.idxmin()))
    kind = "core scenarios" if set(means.index) <= set(results.core) else "scenarios"
    return f"Of the {kind}, '{most}' leaves the largest error and '{least}' the smallest"


def true_and_reported(results: Results) -> Figure:
    """True error beside the error that the controller reports, over the core scenarios."""
    summary, style = results.summary(), looks(results)
    at, headings, bottom = _rows(results, summary)
    figure = _figure(WIDTH, 1.75 + 0.33 * (0.5 - bottom))
    axes = figure.add_subplot()
    pairs = summary[["score", "reported"]].to_numpy(float)
    low, high = _log_limits(pairs.ravel(), 1.35, 1.35)
    _dress(axes, _error_label(results, ""), grid="x")
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.set_ylim(bottom + 0.4, 0.7)
    for name, y in at.items():
        true, reported = float(summary.loc[name, "score"]), float(summary.loc[name, "reported"])
        colour = style[name].colour
        if not np.isfinite([true, reported]).all():
            axes.text(low * 1.02, y, "no score", va="center", fontsize=9, color=QUIET)
            continue
        axes.plot([true, reported], [y, y], color=colour, linewidth=2.2, zorder=2)
        axes.plot(true, y, "o", color=colour, markersize=9, zorder=3)
        axes.plot(
            reported, y, "o", markerfacecolor="white", markeredgecolor=colour, markeredgewidth=2, markersize=9, zorder=3
        )
        for value, other in ((true, reported), (reported, true)):
            right = value > other or (value == other and value is true)
            axes.annotate(
                number(value), (value, y), (9 if right else -9, 0), textcoords="offset points", va="center",
                ha="left" if right else "right", fontsize=9, color=INK,
            )  # fmt: skip
    _class_headings(axes, headings)
    axes.set_yticks(list(at.values()), [_plain(name) for name in at], fontsize=10)
    axes.tick_params(axis="y", length=0)
    _logarithmic(axes.xaxis, low, high)
    full = Line2D([], [], marker="o", linestyle="", color=QUIET, markersize=9)
    hollow = Line2D(
        [], [], marker="o", linestyle="", color=QUIET, markerfacecolor="white", markeredgewidth=2, markersize=9
    )
    _legend(figure, [full, hollow], ["true gap", "reported by the machine (measured, filtered)"])
    _title(figure, _reported_title(summary))
    return figure


def _reported_title(summary: pd.DataFrame) -> str:
    share = (summary["reported"] / summary["score"]).replace([np.inf, 0], np.nan).dropna()
    if not len(share):
        return "True error and the error that the machine reports"
    if len(share) == 1:
        return f"{_plain(str(share.index[0]))} reports {number(float(share.iloc[0]))} times its true error"
    least, most = share.idxmin(), share.idxmax()
    return (
        f"The reported error is {number(float(share[least]))} times ({_plain(str(least))}) to "
        f"{number(float(share[most]))} times ({_plain(str(most))}) the true one"
    )


def sensitivity(results: Results) -> Figure:
    """Worst ratio of gap amplitude to sheet amplitude over the corner plants, against frequency."""
    table, style = results.sensitivity, looks(results)
    if not len(table):
        return _nothing("The sensitivity was not measured.")
    figure = _figure(WIDTH, 5.2)
    axes = figure.add_subplot()
    _dress(axes, "frequency of the sheet's motion (Hz, log scale)", "worst |S| over the corner plants (1, log scale)")
    axes.set_xscale("log")
    axes.set_yscale("log")
    finite = table["magnitude"].to_numpy(float)
    low, high = _log_limits([*finite, 1.0, LIMIT_MS], 1.2, 1.25)
    peaks, handles, labels = {}, [], []
    for name in results.controllers:
        curve = table[table["controller"] == name].sort_values("frequency")
        if not len(curve):
            continue
        x, y = curve["frequency"].to_numpy(float), curve["magnitude"].to_numpy(float)
        peaks[name] = float(np.max(y))  # NaN and infinity stay visible
        look = style[name]
        (line,) = axes.plot(
            x, np.where(np.isfinite(y), y, np.nan), color=look.colour, linestyle=look.line, linewidth=1.9
        )
        if np.isfinite(y).any():
            top = int(np.nanargmax(np.where(np.isfinite(y), y, -1)))
            axes.plot(x[top], y[top], look.marker, color=look.colour, markersize=6.5, zorder=4)
        handles.append(Line2D([], [], color=line.get_color(), linestyle=look.line, linewidth=1.9, marker=look.marker))
        peak = f"Ms {number(peaks[name])}" if np.isfinite(peaks[name]) else "unstable or failed"
        labels.append(f"{_plain(name)}: {peak}")
    axes.set_ylim(low, high)
    axes.axhline(LIMIT_MS, color=INK, linewidth=1.2, linestyle=(0, (4, 2)), zorder=1)
    axes.axhline(1.0, color=QUIET, linewidth=0.9, zorder=1)
    for y, words in (
        (LIMIT_MS, f"Ms = {LIMIT_MS:g}, the limit for tuning"),
        (1.0, "below 1 the loop reduces the error"),
    ):
        axes.annotate(
            words, (0.006, y), (0, 3), xycoords=("axes fraction", "data"), textcoords="offset points", fontsize=8.5,
            color=INK, va="bottom",
        )  # fmt: skip
    axes.set_xlim(*_log_limits(table["frequency"], 1.04, 1.04))
    _logarithmic(axes.xaxis, *axes.get_xlim())
    _logarithmic(axes.yaxis, low, high)
    _legend(figure, handles, labels)
    over = [name for name, peak in peaks.items() if not peak <= LIMIT_MS]
    if not over:
        _title(figure, f"No controller amplifies the sheet's motion more than {LIMIT_MS:g} times")
    else:
        shown = ", ".join(_plain(name) for name in over[:3]) + (f" and {len(over) - 3} more" if len(over) > 3 else "")
        _title(figure, f"Over the limit of Ms = {LIMIT_MS:g}: {shown}")
    return figure


def collisions(results: Results) -> Figure:
    """Share of runs in which the nozzle touched the sheet, in the scenarios where that happened at all."""
    counts = results.runs.groupby(["controller", "scenario"], sort=False)["collision"].agg(["sum", "count"])
    rates = results.collision_rates()
    names = [s for s in _core_first(results) if (rates[s] > 0).any()]
    if not names:
        return _nothing("No run touched the sheet.")
    style = looks(results)
    rows = [name for group in ranked(results).values() for name in group]
    across = min(4, len(names))
    down = math.ceil(len(names) / across)
    figure = _figure(WIDTH, 1.15 + down * (0.75 + 0.26 * len(rows)))
    grid = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    for axes, scenario in zip(grid.flat, names, strict=False):
        _dress(axes, grid="x")
        exempt = scenario in results.exempt
        axes.set_title(
            _plain(scenario, 24) + ("*" if exempt else ""), loc="left", fontsize=10, fontweight="bold", color=INK
        )
        for y, name in enumerate(rows):
            if (name, scenario) not in counts.index:
                continue
            hits, runs = (int(v) for v in counts.loc[(name, scenario)])
            if not runs:
                continue
            interval = binomtest(hits, runs).proportion_ci(method="wilson")
            colour = style[name].colour
            axes.barh(
                y, 100 * hits / runs, height=0.62, facecolor="white" if exempt else colour, edgecolor=colour,
                hatch="////" if exempt else "", zorder=2,
            )  # fmt: skip
            axes.plot([100 * interval.low, 100 * interval.high], [y, y], color=QUIET, linewidth=1.0, zorder=3)
            axes.annotate(
                f"{hits}/{runs}", (100 * interval.high, y), (4, 0), textcoords="offset points", va="center",
                fontsize=8.5, color=INK,
            )  # fmt: skip
        axes.set_xlim(0, 125)
        axes.set_xticks([0, 50, 100])
    for axes in grid.flat[len(names) :]:
        axes.set_visible(False)
    for column in range(across):
        last = [row for row in range(down) if row * across + column < len(names)][-1]
        grid[last, column].tick_params(labelbottom=True)
    grid[0, 0].set_ylim(len(rows) - 0.4, -0.6)
    grid[0, 0].set_yticks(np.arange(len(rows)), [_plain(name) for name in rows])
    figure.supxlabel(
        "runs in which the nozzle touched the sheet (%); line: 95 % Wilson interval", fontsize=9.5, color=INK
    )
    unexpected = [s for s in names if s not in results.exempt]
    if unexpected:
        hits = int(counts["sum"].unstack()[unexpected].to_numpy(float).sum())
        where = ", ".join(_plain(s) for s in unexpected)
        text = f"The nozzle touched the sheet {hits} time{'s' * (hits != 1)} where it should not: {where}"
    else:
        text = "The nozzle touched the sheet only in scenarios built to defeat followers"
    _title(figure, text + (" (* not counted)" if len(unexpected) < len(names) else ""))
    return figure


# ------------------------------------------------------------------------------------------------------ over time


class _Run(NamedTuple):
    """A controller's trace; errors are NaN where they are not scored and while an alarm is latched."""

    time: Floats
    """s"""
    scored: npt.NDArray[np.bool_]
    alarm: npt.NDArray[np.bool_]
    true: Floats
    """µm"""
    reported: Floats
    """µm"""
    rms: float
    """µm, of the true error over everything scored, alarms included"""
    frame: pd.DataFrame


def _runs(traces: pd.DataFrame) -> dict[str, _Run]:
    """Each controller's trace of one scenario, in order of appearance."""
    out = {}
    for name, frame in traces.groupby("controller", sort=False):
        channel = {key: frame[key].to_numpy(float) for key in ("time", "scored", "mode", "gap", "height", "set_height")}
        scored, alarm = channel["scored"] > 0.5, channel["mode"] == supervisor.ALARM
        true, reported = (1e3 * (channel[key] - channel["set_height"]) for key in ("gap", "height"))
        rms = float(np.sqrt(np.mean(true[scored] ** 2))) if scored.any() else math.nan
        shown = scored & ~alarm
        true, reported = np.where(shown, true, np.nan), np.where(shown, reported, np.nan)
        out[str(name)] = _Run(channel["time"], scored, alarm, true, reported, rms, frame)
    return out


def _legible(errors: list[Floats], period: float) -> float:
    """Seconds that can be shown so that fast vibrations are still seen as curves."""
    rates = []
    for error in errors:
        known = error[np.isfinite(error)]
        if len(known) > 1:
            above = known > np.median(known)
            rates.append(np.count_nonzero(above[1:] != above[:-1]) / (len(known) * period))
    return float(np.clip(CROSSINGS / max(np.median(rates), 1e-9), WINDOW / 4, WINDOW)) if rates else WINDOW


def _interesting(runs: dict[str, _Run]) -> tuple[int, int]:
    """First and one past the last period of what an oscilloscope shows.

    It is the time around the first alarm, or if there is none, that in which the true errors differ most. The
    difference is cut off at its 95th percentile, so that one excursion does not choose the window.
    """
    shortest = min(len(run.time) for run in runs.values())
    time = next(iter(runs.values())).time[:shortest]
    if shortest < 3:
        return 0, shortest
    period = max(float(np.median(np.diff(time))), 1e-9)
    width = min(shortest, max(2, round(_legible([run.true for run in runs.values()], period) / period)))
    alarms = np.logical_or.reduce([run.alarm[:shortest] for run in runs.values()])
    if alarms.any():
        start = int(np.clip(int(np.argmax(alarms)) - round(BEFORE_ALARM * width), 0, shortest - width))
        return start, start + width
    errors = np.stack([run.true[:shortest] for run in runs.values()])
    bad = ~np.isfinite(errors)
    top, bottom = np.where(bad, -np.inf, errors).max(axis=0), np.where(bad, np.inf, errors).min(axis=0)
    if len(runs) == 1:
        top, bottom = np.maximum(top, 0.0), np.minimum(bottom, 0.0)
    spread = np.subtract(top, bottom, where=~bad.all(axis=0), out=np.zeros(shortest))
    positive = spread[spread > 0]
    if len(positive):
        spread = np.minimum(spread, np.quantile(positive, 0.95))
    total = np.concatenate([[0.0], np.cumsum(spread)])
    sums = total[width:] - total[:-width]
    first = int(np.searchsorted(time, SETTLE)) if time[-1] >= SETTLE + WINDOW else 0
    first = min(first, len(sums) - 1)
    start = first + int(np.argmax(sums[first:]))
    return start, start + width


def _robust(axes: Axes, curves: list[Floats], unit: str) -> None:
    """Limits that a few extreme values do not stretch much; says how far the curves go beyond."""
    values = np.concatenate(curves) if curves else np.zeros(0)
    values = values[np.isfinite(values)]
    if not len(values):
        axes.set_yticks([])
        axes.text(0.5, 0.7, "nothing to show here", transform=axes.transAxes, ha="center", fontsize=9, color=QUIET)
        return
    least, most = float(values.min()), float(values.max())
    low, high = (float(q) for q in np.quantile(values, (0.005, 0.995)))
    if most - least < 1.7 * (high - low):
        low, high = least, most
    room = 0.1 * max(high - low, 1e-3)
    axes.set_ylim(low - room, high + room)
    if least < low - room or most > high + room:
        ends = [number(end) for end, cut in ((least, least < low - room), (most, most > high + room)) if cut]
        axes.text(
            0.997, 0.97, f"cut off; goes to {' and '.join(ends)} {unit}", transform=axes.transAxes, ha="right",
            va="top", fontsize=8, color=QUIET, zorder=6, bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        )  # fmt: skip


def _crosses(axes: Axes, runs: dict[str, _Run], window: slice, style: dict[str, Look]) -> None:
    """A cross at the time of each controller's alarm, one above the other at the panel's foot."""
    ended = [name for name, run in runs.items() if run.alarm[window].any() and not run.alarm[: window.start].any()]
    for place, name in enumerate(ended):
        run = runs[name]
        axes.plot(
            run.time[int(np.argmax(run.alarm))], 0.08 + 0.84 * place / max(len(ended), 8), "X", markersize=8, zorder=5,
            transform=axes.get_xaxis_transform(), color=style[name].colour, markeredgecolor=INK, clip_on=False,
        )  # fmt: skip


def oscilloscope(results: Results, scenario: str) -> Figure:
    """Sheet, true error, reported error and command of every controller over the same time of a scenario."""
    traces = results.traces
    runs = _runs(traces[traces["scenario"] == scenario]) if "scenario" in traces else {}
    if not runs:
        return _nothing(f"There is no trace of '{scenario}'.")
    style = looks(results)
    first, last = _interesting(runs)
    title = _oscilloscope_title(results, scenario, runs, slice(first, last))
    figure = Figure(figsize=(WIDTH, 7.6), dpi=DPI, facecolor="white")  # laid out by hand, in half the time
    top = 0.17 + 0.21 * (_wrapped(figure, title).count("\n") + 1)
    bottom = 0.62 + 0.2 * math.ceil((len(runs) + 1) / 4)
    panels = figure.subplots(
        4, 1, sharex=True, gridspec_kw={
            "height_ratios": (0.8, 2.1, 1.4, 1.4), "left": 0.1, "right": 0.985, "top": 1 - top / 7.6,
            "bottom": bottom / 7.6, "hspace": 0.12,
        },
    )  # fmt: skip
    words = ("sheet\n(mm)", "true error\n(µm)", "reported error\n(µm)", "command\n(mm/s)")
    for axes, label in zip(panels, words, strict=True):
        _dress(axes, y=label)
        axes.yaxis.set_label_coords(-0.067, 0.5)
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.margins(x=0)
    curves: dict[int, list[Floats]] = {1: [], 2: [], 3: []}
    handles = []
    for name, run in runs.items():
        look, time = style[name], run.time[first:last]
        command = run.frame["command"].to_numpy(float)
        for panel, values in ((1, run.true), (2, run.reported), (3, command)):
            shown = values[first:last]
            panels[panel].plot(time, shown, color=look.colour, linestyle=look.line, linewidth=1.3)
            curves[panel].append(shown)
        handles.append(Line2D([], [], color=look.colour, linestyle=look.line, linewidth=2))
    _crosses(panels[1], runs, slice(first, last), style)
    for panel, unit in ((1, "µm"), (2, "µm"), (3, "mm/s")):
        panels[panel].axhline(0, color=QUIET, linewidth=0.8, zorder=1)
        _robust(panels[panel], curves[panel], unit)
    run = next(iter(runs.values()))
    time, counted = run.time[first:last], np.logical_or.reduce([r.scored[first:last] for r in runs.values()])
    panels[0].plot(
        time, np.where(counted, run.frame["surface"].to_numpy(float)[first:last], np.nan), color=INK, linewidth=1.4
    )
    for start, stop in _stretches(~counted):
        for axes in panels:
            axes.axvspan(time[start], time[min(stop, len(time) - 1)], color=SHADE, zorder=0, linewidth=0)
    labels = [_plain(name) for name in runs]
    if not counted.all():
        handles.append(Rectangle((0, 0), 1, 1, color=SHADE))
        labels.append("not scored")
    panels[-1].set_xlim(time[0], time[-1])
    panels[-1].set_xlabel("time (s)", fontsize=9.5, color=INK)
    figure.legend(
        handles, labels, loc="lower center", bbox_to_anchor=(0.5, 0.0), ncols=min(4, len(labels)), fontsize=9,
        frameon=False, handlelength=3.2, labelcolor=INK,
    )  # fmt: skip
    _title(figure, title)
    return figure


def _oscilloscope_title(results: Results, scenario: str, runs: dict[str, _Run], window: slice) -> str:
    alarms = [name for name, run in runs.items() if run.alarm[window].any()]
    if alarms:
        who = _plain(alarms[0]) if len(alarms) == 1 else f"{len(alarms)} of {len(runs)} controllers"
        return f"{_plain(scenario)}: {who} in alarm (cross), as after a touch"
    errors = {name: run.true[window] for name, run in runs.items()}
    largest = {name: np.abs(e[np.isfinite(e)]).max() for name, e in errors.items() if np.isfinite(e).any()}
    first = results.runs.drop_duplicates("controller").set_index("controller")["information"]
    ranks = {name: value for name, value in largest.items() if first.get(name) == "sensor"} or largest
    if not ranks:
        return f"{_plain(scenario)}: nothing is scored in this window"
    least, most = min(ranks, key=lambda n: ranks[n]), max(ranks, key=lambda n: ranks[n])
    if least == most:
        return f"{_plain(scenario)}: largest true error {number(ranks[least])} µm ({_plain(least)})"
    return (
        f"{_plain(scenario)}: largest true error from {number(ranks[least])} µm ({_plain(least)}) "
        f"to {number(ranks[most])} µm ({_plain(most)})"
    )


def _stretches(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one past the last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


# ------------------------------------------------------------------------------------------------- along a drawing


def contour_controllers(results: Results) -> list[str]:
    """Whom :func:`contour` shows: the best of the sensor class, the reference, then the others in order of score."""
    traces = located(results)
    traced = set(traces["controller"].unique()) if len(traces) else set()
    order = [name for group in ranked(results).values() for name in group if name in traced]
    first = [*order[:1], *(name for name in order[1:] if name == REFERENCE)]
    return (first + [name for name in order if name not in first])[:PANELS]


def contour(results: Results) -> Figure:
    """The drawing's contour coloured by the true error, and the error along the path."""
    chosen, traces, style = contour_controllers(results), located(results), looks(results)
    if not chosen:
        return _nothing("No trace follows a drawing.")
    scenario = str(traces["scenario"].iloc[0])
    runs = _runs(traces[traces["scenario"] == scenario])
    runs = {name: runs[name] for name in chosen if name in runs}
    errors = np.concatenate([run.true[np.isfinite(run.true)] for run in runs.values()])
    limit = float(np.quantile(np.abs(errors), 0.99)) if len(errors) else 1.0
    norm = Normalize(-max(limit, 1e-3), max(limit, 1e-3))

    across = 1 if len(runs) == 1 else 2
    down = math.ceil(len(runs) / across)
    size = np.ptp(traces[list(LOCATED)].to_numpy(float), axis=0) + 1.0
    tall = float(np.clip((WIDTH - 2.1) / across * size[1] / size[0], 1.3, 5.0 if across == 1 else 4.2))
    figure = _figure(WIDTH, 1.1 + down * (tall + 0.55) + 2.1)
    upper, lower = figure.subfigures(2, 1, height_ratios=[down * (tall + 0.55), 2.1])
    grid = upper.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    image: LineCollection | None = None
    for axes, (name, run) in zip(grid.flat, runs.items(), strict=False):
        _dress(axes, grid="")
        image = _draw_contour(axes, run, norm)
        axes.set_aspect("equal", adjustable="box")
        axes.autoscale_view()
        rms = 1.0 * np.sqrt(np.nanmean(run.true**2)) if run.scored.any() else np.nan
        axes.set_title(
            f"{_plain(name)}: RMS {number(float(rms))} µm", loc="left", fontsize=10, fontweight="bold", color=INK
        )
    for axes in grid.flat[len(runs) :]:
        axes.set_visible(False)
    for axes in grid[:, 0]:
        axes.set_ylabel("y (mm)", fontsize=9.5)
    for axes in grid[-1]:
        axes.set_xlabel("x (mm)", fontsize=9.5)
    assert image is not None
    bar = upper.colorbar(image, ax=list(grid.flat), extend="both", pad=0.015, aspect=24, shrink=0.9)
    bar.set_label("true gap error (µm): + too high, − too low", fontsize=9)
    bar.ax.tick_params(labelsize=8.5)

    strip = lower.subplots()
    _dress(strip, "distance along the path, rapid moves included (mm)", "true error (µm)")
    handles = []
    for name, run in runs.items():
        look, distance = style[name], run.frame["distance"].to_numpy(float)
        strip.plot(distance, run.true, color=look.colour, linestyle=look.line, linewidth=0.9)
        handles.append(Line2D([], [], color=look.colour, linestyle=look.line, linewidth=2))
    strip.axhline(0, color=QUIET, linewidth=0.8, zorder=1)
    strip.margins(x=0)
    _robust(strip, [run.true for run in runs.values()], "µm")
    columns = min(4, len(runs))
    lower.legend(
        handles, [_plain(n) for n in runs], loc="outside lower center", ncols=columns, fontsize=9, frameon=False,
        handlelength=3.2,
    )  # fmt: skip
    _title(figure, _contour_title(scenario, runs))
    return figure


def _contour_title(scenario: str, runs: dict[str, _Run]) -> str:
    within = {name: np.abs(run.true[np.isfinite(run.true)]) for name, run in runs.items()}
    limits = {name: float(np.quantile(error, 0.99)) for name, error in within.items() if len(error)}
    if not limits:
        return f"{_plain(scenario)}: nothing was cut"
    least, most = min(limits, key=lambda n: limits[n]), max(limits, key=lambda n: limits[n])
    words = f"{_plain(scenario)}: 99 % of the cut is within ±{number(limits[least])} µm ({_plain(least)})"
    return words if least == most else f"{words} to ±{number(limits[most])} µm ({_plain(most)})"


def _draw_contour(axes: Axes, run: _Run, norm: Normalize) -> LineCollection:
    """Rapid moves thin and grey, cuts coloured by their error over a dark edge, what follows an alarm black."""
    x, y = (run.frame[axis].to_numpy(float) for axis in LOCATED)
    shown = run.scored & ~run.alarm
    for mask, colour, width in ((~run.scored, "#a5abb1", 0.7), (run.scored & run.alarm, "black", 1.2)):
        for start, stop in _stretches(mask):
            piece = slice(max(start - 1, 0), stop + 1)
            axes.plot(x[piece], y[piece], color=colour, linewidth=width, zorder=1)
    step = max(1, math.ceil(shown.sum() / SEGMENTS))
    pieces, values = [], []
    for start, stop in _stretches(shown):
        axes.plot(x[start:stop], y[start:stop], color=QUIET, linewidth=4.2, solid_capstyle="butt", zorder=2)
        for a in range(start, stop, step):
            b = min(a + step, stop)
            chunk = run.true[a:b]
            pieces.append(np.column_stack([x[a : b + 1], y[a : b + 1]]))
            values.append(chunk[np.argmax(np.abs(chunk))] if np.isfinite(chunk).all() else np.nan)
    lines = LineCollection(pieces, cmap="PuOr", norm=norm, linewidths=3.0, capstyle="butt", zorder=3)
    lines.set_array(np.asarray(values, float))
    axes.add_collection(lines)
    return lines
