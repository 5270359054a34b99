"""A search's result in sentences, for the terminal and for its page: what it brings, or why that is not to be believed;
what speaks against it."""

import math

import pandas as pd

from ...envs.engine.quantity import Quantity
from ..measure.margins import DELAYS, GAINS, in_words
from ..measure.population import Population
from ..report.numbers import fixed, known, listed, number, span, times
from ..statistics.intervals import Interval
from . import goals
from .assessed import Assessed
from .study import Task
from .worth import Figure


def figure(interval: Interval, unit: str = "", ends: bool = False) -> str:
    """A figure with as many digits as are known, its unit, and its interval if wanted."""
    value, low, high = interval
    places = known(low, high, value)
    text = fixed(value, places) + (f" {unit}" if unit not in ("", "1") else "")
    return f"{text} ({span(low, high, places)})" if ends and math.isfinite(low + high) else text


def ratio(interval: Interval) -> str:
    """How many times, with its interval."""
    value, low, high = interval
    if not math.isfinite(value):
        return "–"
    return f"{times(value)} ({times(low)}–{times(high)})" if math.isfinite(low + high) else times(value)


def setting(value: float | str, quantity: Quantity) -> str:
    """A parameter's value as it is set: a choice by its name, a number with five digits."""
    if isinstance(value, str):
        return value
    return quantity.choices[int(value)] if quantity.choices else f"{value:.5g}"


def unit(quantity: Quantity) -> str:
    """Of a parameter; empty if it has none."""
    return "" if quantity.unit in ("", "1") else quantity.unit


def headline(task: Task, assessed: Assessed) -> str:
    """What the search brings, in a sentence."""
    first = assessed.worth.figures[0]
    name = f"The tuned {task.base.name if task.controller.endswith('.toml') else task.controller.split(':')[0]}"
    where = f" on {task.machine.name}" if task.machine else ""
    if len(assessed.worth.figures) > 1:  # better in one of them, worse in another
        both = (
            f"{_spoken(each, task)} {figure(each.after, each.unit)}, before {figure(each.before, each.unit)}"
            for each in assessed.worth.figures
        )
        return f"{name}, from the middle of the front{where}: {'; '.join(both)}."
    now, was = figure(first.after, first.unit), figure(first.before, first.unit)
    about = _spoken(first, task)
    if not math.isfinite(first.after.value):
        return f"{name} has no {about}{where}: its runs on test seeds failed."
    if not math.isfinite(first.gain.low):
        return f"{name} has a {about} of {now}{where}, before {was}."
    if first.gain.high < 1.0:
        return f"{name} is worse than before{where}: {about} {now}, before {was}."
    if not first.sure:
        return f"{name} cannot be told from what it was before{where}: {about} {now}, before {was}."
    by = times(first.gain.value)
    if first.metric == "rms_true":
        return f"{name} follows {by} times closer than before{where}: {now}, before {was}."
    return f"{name} is {by} times better than before{where}: {about} {now}, before {was}."


def _spoken(first: Figure, task: Task) -> str:
    about = goals.metric(first.metric, task.jobs)
    return about.spoken if first.metric == about.name and len(goals.joined(first.metric)) == 1 else first.metric


def warnings(task: Task, assessed: Assessed) -> list[str]:
    """Why what the search found is not to be believed; nothing, as a rule."""
    out, worth = [], assessed.worth
    before, after = worth.touched
    if after > 0:
        out.append(
            f"The nozzle touches the sheet in {after} of {worth.tried} runs on test seeds (before: {before}), and in "
            "none on the seeds of the search."
        )
    for each in worth.figures:
        if each.too_good:
            as_it_was = f"; that of the controller before the search is {ratio(each.flattered_before)} times as large"
            out.append(
                f"{_capital(_spoken(each, task))} is {ratio(each.flattered)} times as large on test seeds as on the "
                f"{worth.tune_seeds} seeds of the search{as_it_was}. Search on more --seeds, or fewer parameters."
            )
    return out


def cautions(task: Task, assessed: Assessed) -> list[str]:
    """What speaks against the result, and does not make it wrong."""
    out = []
    if broken := [each.words for each in assessed.worth.limits if not each.kept]:
        out.append(f"On test seeds it does not keep {listed(broken)}.")
    if assessed.margins and math.isfinite(task.limits.ms):
        kept, of = assessed.margins[1].within(task.limits.ms)
        if of and kept < of:
            out.append(f"On {of - kept} of {of} machines that may be meant Ms is above {task.limits.ms:g}.")
        settled = (assessed.margins[1].machines["gain"] == 0).sum()
        if settled:
            out.append(f"On {settled} of {of} machines the loop does not settle after a small step.")
    if assessed.margins and assessed.margins[1].reason:
        out.append(f"Margins are not measured: {assessed.margins[1].reason}.")
    return out


MARGINS = (
    ("ms", "Ms", "", "max"),
    ("gain", "gain margin", "×", "min"),
    ("delay_ms", "delay margin", "ms", "min"),
)
"""Column of a population, what it is, its unit, and how the worst machine is found."""


def margin(machines: Population, column: str, how: str) -> str:
    """A margin in words: its median over the machines, or the worst (``min``, ``max``)."""
    values = machines.machines[column].dropna()
    if not len(values):
        return "–"
    value = float(getattr(values, how)())
    if column == "ms":
        return f"{value:.2f}" if math.isfinite(value) else "∞"
    return in_words(value, float((GAINS if column == "gain" else DELAYS)[-1]))


def margins_in_words(task: Task, machines: Population) -> str:
    """Ms and margins over the machines, in a line."""
    count = len(machines.machines)
    parts = [
        f"{title} {margin(machines, column, 'median')}{f' {unit}' if unit == 'ms' else ''}"
        + (f", worst {margin(machines, column, how)}" if count > 1 else "")
        for column, title, unit, how in MARGINS
    ]
    kept, of = machines.within(task.limits.ms)
    share = f"; Ms is within {task.limits.ms:g} on {kept}" if math.isfinite(task.limits.ms) and of > 1 else ""
    return f"on {count} machine{'s' * (count != 1)}: {'; '.join(parts)}{share}"


FAILED = 100.0
"""Times a metric from which on a neighbour counts as failed."""


def off_costs(near: pd.DataFrame, task: Task, name: str) -> str:
    """By how much the metric changes at worst if one parameter is 20 % off, and which Ms it leads to."""
    metric, higher = task.metrics[0], task.directions[0] == "maximize"
    rows = near[near["parameter"] == name]
    if not len(rows):
        return "–"
    worst = float(rows[metric].min() if higher else rows[metric].max())
    if not worst < FAILED:
        return "fails"
    change = 100 * (worst - 1)
    text = f"{'+' * (change > 0)}{fixed(change, 0 if abs(change) >= 10 else 1)} %"
    peaks = rows["ms"].dropna()
    return f"{text}, Ms {number(float(peaks.max()))}" if len(peaks) and math.isfinite(peaks.max()) else text


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
