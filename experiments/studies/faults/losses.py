"""What a campaign says: by controller, by fault, and what remains with its cause and an example."""

import shlex
from typing import Any

import pandas as pd

from ...report.terminal import TextTable
from .culprits import CAUSES, EXCESS, EXCESSES, FLOOR, MENDABLE
from .drawn import CLASSES

MODULE = "kerfgym.experiments.studies.faults"


def sheets(frame: pd.DataFrame, seed: int = 0) -> list[TextTable]:
    """The campaign's tables.

    Args:
        frame: of :func:`culprits.judged`, of all controllers and scenarios.
        seed: the campaign's.
    """
    return [_by_controller(frame), _by_fault(frame), _remaining(frame, seed)]


def harmed(frame: pd.DataFrame) -> pd.DataFrame:
    """Faults that were lost because of the supervisor or a filter."""
    return frame[frame["cause"].isin(MENDABLE)]


_TITLES = ["faults", "lost", *CAUSES, "prevented", "stopped", "excess by supervisor", "excess by filter"]


def _cells(part: pd.DataFrame) -> list[str]:
    causes, excesses = part["cause"].value_counts(), part["excess"].value_counts()
    prevented = int((part["lost_no_supervisor"] & ~part["lost"]).sum())
    counts = [len(part), int(part["lost"].sum()), *(causes.get(name, 0) for name in CAUSES)]
    return [*map(str, counts), str(prevented), *(str(excesses.get(name, 0)) for name in EXCESSES)]


def _grouped(frame: pd.DataFrame, column: str, names: list[str]) -> list[list[list[str]]]:
    rows = [[name, *_cells(frame[frame[column] == name])] for name in names]
    return [rows, [["all", *_cells(frame)]]]


def _by_controller(frame: pd.DataFrame) -> TextTable:
    sheet = TextTable("Faults by controller", ["controller", *_TITLES])
    sheet.sections = _grouped(frame, "controller", list(frame["controller"].unique()))
    bad, count = len(harmed(frame)), len(frame)
    broken = int(frame["broken"].sum())
    sheet.notes = [
        f"lost: the nozzle touched the sheet{f', or the state was no number any more ({broken})' if broken else ''}.",
        "Its cause is what can be taken out and the run is not lost; each of these columns counts lost runs.",
        f"Supervisor, filter, or both: {bad} of {count} faults, {bad / count:.2%}.",
        "prevented: not lost, but it would be without the supervisor. stopped: not lost, but an alarm ended the run.",
        f"excess: the fault moves the gap by more than {1e3 * FLOOR:g} µm and more than {EXCESS:g} times what it does "
        "without supervisor or filter.",
    ]
    return sheet


def _by_fault(frame: pd.DataFrame) -> TextTable:
    sheet = TextTable("Faults by kind", ["fault", *_TITLES])
    present = set(frame["fault"])
    sheet.sections = _grouped(frame, "fault", [name for name in CLASSES if name in present])
    sheet.notes = [f"{name}: {what}." for name, (what, _) in CLASSES.items() if name in present]
    return sheet


def _remaining(frame: pd.DataFrame, seed: int) -> TextTable:
    """Each kind of lost run with its cause, whom it befalls, and a command that shows one."""
    sheet = TextTable("What is lost, and why", ["fault", "cause", "lost", "lowest gap, mm", "controllers", "example"])
    lost = frame[frame["lost"]]
    rows = []
    for cause in CAUSES:
        for name in CLASSES:
            part = lost[(lost["cause"] == cause) & (lost["fault"] == name)]
            if len(part):
                who = part["controller"].value_counts()
                told = ", ".join(f"{controller} {count}" for controller, count in who.items())
                first = part.sort_values("lowest_mm").iloc[0]
                rows.append([name, cause, str(len(part)), f"{part['lowest_mm'].min():.2f}", told, command(first, seed)])
    sheet.sections = [rows] if rows else []
    sheet.notes = [] if rows else ["No run was lost."]
    return sheet


def command(row: Any, seed: int) -> str:
    """What shows one fault again."""
    case = f"{row['controller']}/{row['scenario']}/{row['number']}"
    return shlex.join(["python", "-m", MODULE, "--case", case, *(["--seed", str(seed)] if seed else [])])
