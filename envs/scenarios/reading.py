"""Scenarios from TOML."""

from pathlib import Path

from ..engine.quantity import InvalidInput
from ..safety import files
from . import dead
from .measured import height_map, measured_head, profile, signal
from .schema import Scenario
from .validation import line_of, validated


def parse(text: str, where: str = "scenario") -> Scenario:
    """A scenario from TOML text.

    Raises:
        InvalidInput: file, line and key of the first mistake.
    """
    data = files.toml_of(text, where)
    if refused := dead.refusal(data, data.get("job")):
        raise InvalidInput(f"{where}{line_of(text, refused[:1])}: {refused[1]}")
    return validated(Scenario, data, where, text)


def read(path: str | Path) -> Scenario:
    """A scenario from a TOML file; files it names are taken relative to it.

    Raises:
        InvalidInput: file, line and key of the first mistake.
    """
    text = files.text(path, files.SETTINGS)
    scenario = parse(text, str(path))
    folder = Path(path).resolve().parent
    if scenario.sheet.profile:
        scenario = scenario.varied(sheet={"profile": {"file": str(folder / scenario.sheet.profile.file)}})
        profile(scenario.sheet.profile)  # a bad file is an error now, not in the middle of a run
    if scenario.sheet.map:
        scenario = scenario.varied(sheet={"map": {"file": str(folder / scenario.sheet.map.file)}})
        height_map(scenario.sheet.map)
    for name in ("table", "signal"):
        given = getattr(scenario.head, name)
        if given:
            scenario = scenario.varied(head={name: str(folder / given)})
    if scenario.head.table:
        measured_head(scenario.head.table)
    if scenario.head.signal:
        signal(scenario.head.signal)
    if scenario.job and Path(scenario.job.part).suffix:
        scenario = scenario.varied(job={"part": str(folder / scenario.job.part)})
    if scenario.path:
        drawing, named = folder / scenario.path, scenario.name
        timed = "duration" in files.toml_of(text, path)
        scenario = scenario.varied(path=str(drawing)) if timed else scenario.along(drawing).varied(name=named)
    return scenario
