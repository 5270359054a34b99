"""Plans of jobs: what a run's report shows before its results, and what ``kerfgym render --plan`` writes."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.paths.parts import PARTS
from ...envs.scenarios import Machine, Reading, Scenario, machines
from ...envs.tasks import workshop
from ..measure.grids import cut
from ..store.runs import atomic

SCENARIO = "contour-square"
"""Whose job a part is cut by that none is named for."""

FORMATS = (".png", ".svg", ".pdf")
"""Of pictures."""

COLUMNS = ("scenarios", "picture", "cuts", "warnings")
"""Of :func:`table`."""


def paint(
    out: Path,
    part: str,
    scenario: str,
    cut_as: Mapping[str, float],
    reading: Reading | None = None,
    machine: Machine | None = None,
) -> list[str]:
    """Writes the plan of a part; returns what a user should know, of a drawing with what is in it first.

    Args:
        out: file to write.
        part: drawing, programme, or name of a built-in part.
        scenario: as whose job it is cut; one without a job leaves :data:`SCENARIO`.
        cut_as: keys of the job that are set otherwise.
        reading: how a drawing is read; None: as the scenario says.
        machine: whose travel and rapids count; None: the scenario's.

    Raises:
        InvalidInput: unknown suffix, part or scenario, or a part that cannot be cut so.
    """
    from ..plots.png import png
    from .plan_picture import figure

    if out.suffix.lower() not in FORMATS:
        raise InvalidInput(f"cannot write '{out}'; {did_you_mean(out.suffix, FORMATS)}")
    if part not in PARTS and not Path(part).suffix:
        raise InvalidInput(f"unknown part '{part}'; {did_you_mean(part, PARTS)}, or a drawing's file")
    case = scenarios.load(scenario)
    case = (case if case.job else scenarios.load(SCENARIO)).along(part, reading)
    case = machines.put_on(case, machine) if machine else case
    route = workshop.route_of(cut(case, cut_as) if cut_as else case)
    page = figure(route)
    with atomic(out) as file:
        if out.suffix.lower() == ".png":
            file.write_bytes(png(page))
        else:
            page.savefig(file, format=out.suffix[1:].lower())
    summary = [] if part in PARTS else [scenarios.read_drawing(part, case.drawing).summary]
    return [*summary, *route.drawing.notes, *route.warnings]


def table(cases: Iterable[Scenario]) -> pd.DataFrame:
    """Plans of the scenarios' jobs, one row for each that differs: their names, the picture as PNG, how many cuts it
    has, warnings in lines."""
    from ..plots.png import png
    from .plan_picture import figure

    found: dict[int, dict[str, Any]] = {}
    for case in cases:
        route = workshop.route_of(case)
        if id(route) in found:
            found[id(route)]["scenarios"] += f", {case.name}"
            continue
        warnings = [*route.drawing.notes, *route.warnings]
        found[id(route)] = {
            "scenarios": case.name,
            "picture": png(figure(route, warnings=[], small=True)),
            "cuts": len(route.cuts),
            "warnings": "\n".join(warnings),
        }
    return pd.DataFrame(list(found.values()), columns=list(COLUMNS))
