"""Scenarios from TOML."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..safety import files
from . import dead
from .measured import height_map, measured_head, profile, signal
from .schema import Scenario, of_tables


def parse(text: str, where: str = "scenario") -> Scenario:
    """A scenario from TOML text.

    Raises:
        InvalidInput: file, line and key of the first mistake.
    """
    return of_tables(files.toml_of(text, where), where, text)


def read(path: str | Path, stored: bool = False) -> Scenario:
    """A scenario from a TOML file; files it names are taken relative to it.

    Args:
        path: the file.
        stored: a run keeps it, perhaps an early one's, so keys that change nothing are no mistake.

    Raises:
        InvalidInput: file, line and key of the first mistake.
    """
    text = files.text(path, files.SETTINGS)
    tables = files.toml_of(text, path)
    scenario = of_tables(dead.without(tables) if stored else tables, str(path), text)
    folder = Path(path).resolve().parent
    measured: tuple[tuple[str, Callable[..., Any]], ...] = (("profile", profile), ("map", height_map))
    for name, check in measured:
        if source := getattr(scenario.sheet, name):
            scenario = scenario.varied(sheet={name: {"file": str(folder / source.file)}})
            check(getattr(scenario.sheet, name))  # a bad file is an error now, not in the middle of a run
    for name, check in (("table", measured_head), ("signal", signal)):
        if given := getattr(scenario.head, name):
            scenario = scenario.varied(head={name: str(folder / given)})
            check(str(folder / given))
    if scenario.job and Path(scenario.job.part).suffix:
        scenario = scenario.varied(job={"part": str(folder / scenario.job.part)})
    if scenario.path:
        drawing, named = folder / scenario.path, scenario.name
        timed = scenario.varied(path=str(drawing))
        scenario = timed if "duration" in tables else scenario.along(drawing).varied(name=named)
    return scenario
