"""The headline table: controllers × everything that is asked about them, in groups of columns."""

from dataclasses import dataclass, field
from typing import Any

from ..measure.stability import LIMIT_MS
from ..statistics import comparison
from . import cells, headings
from .numbers import ends, fixed, known, listed, number, span
from .standing import Standing
from .suite import Suite
from .terminal import RANGED

FOLLOWERS = {"score": True, "true gap error": True, "reported": False, "cut of thin sheet": False, "command": False}
JOBS = {"ranked by": True, "contour error": True, "true gap error": False, "cut": True, "time": True}
"""Groups of columns in the page's order; whether each is also on a narrow screen. Others follow, and :data:`LAST`."""

LAST = ("stability", "safety", "decision", "budget")


@dataclass(frozen=True)
class Column:
    """A column: title, unit or direction under it, its cells by controller; ``meaning`` stands below the table.
    ``shows`` names the column of ``summary.csv`` with the same figures."""

    title: str
    under: str
    cells: cells.Cells
    meaning: str = ""
    shows: str = ""


@dataclass(frozen=True)
class Group:
    """Columns under one heading, shown and hidden together; ``first``: also on a narrow screen."""

    title: str
    columns: list[Column] = field(default_factory=list)
    first: bool = False


def groups(suite: Suite, standings: dict[str, Standing]) -> list[Group]:
    """The columns of a suite, without those that hold nothing."""
    first = JOBS if suite.jobs else FOLLOWERS
    found: dict[str, list[Column]] = {title: [] for title in first}
    listed_ = [(column.page, column.shows) for column in headings.of(suite.results) if column.page]
    for page, shows in sorted(listed_, key=lambda each: each[0].place):
        made = page.cells(suite, standings)
        told = {cell.text for cell in made.values()} - {"–"}
        if told and not (page.place > 0 and told == {"1.00"}):
            found.setdefault(page.group, []).append(Column(page.head, page.under, made, page.meaning, shows))
    order = [*(title for title in found if title not in LAST), *LAST]
    return [Group(title, found[title], first.get(title, False)) for title in order if found.get(title)]


def methods(suite: Suite) -> list[dict[str, str]]:
    """Rows of the methods that were trained or tuned several times, with all their trainings together."""
    rows = []
    for row in comparison.methods(suite.results).to_dict("records"):
        shown = {}
        for name in ("score", "ratio"):
            low, value, high = ends(row, name)
            places = known(low, high, value)
            shown[name], shown[f"{name}_span"] = fixed(value, places), span(low, high, places)
        extremes = {"best": number(row["best"]), "worst": number(row["worst"])}
        rows.append({"method": str(row["method"]), "members": str(len(row["members"])), **shown, **extremes})
    return rows


def unmeasured(suite: Suite) -> list[str]:
    """Why some have no Ms or no margins, in sentences."""
    found = suite.results.unmeasured
    return [f"{', '.join(names)} on the machine {machine}: {why}" for (machine, why), names in found]


def ranged(suite: Suite) -> str:
    """Whose Ms and margins may be its base's, in a sentence; empty if nobody's are."""
    names = suite.results.ranged if len(suite.results.stability) else []
    return f"{', '.join(names)}: {RANGED}" if names else ""


def by_machine(suite: Suite) -> list[dict[str, Any]]:
    """Rows of Ms and margins machine by machine, where there are several."""
    scenarios = suite.results.machines
    rows = []
    for _, row in suite.results.apart.iterrows():
        one = {"machine": str(row["machine"]), "scenarios": listed(scenarios.get(row["machine"], []))}
        one |= {"name": str(row["controller"]), "ms": number(row["ms"]), "noise": number(row["ms_noise"])}
        one |= {"span": span(row["ms_noise_low"], row["ms_noise_high"], 2), "gain": headings.gain(row["gain_margin"])}
        one |= {"delay": headings.delay(row["delay_margin"]), "reason": str(row["reason"])}
        rows.append(one | {"high": bool(row["ms"] > LIMIT_MS), "high_noise": bool(row["ms_noise"] > LIMIT_MS)})
    return rows
