"""Studies: what is measured for the pages, with which command, at what cost, and what it depends on."""

import importlib
import inspect
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ... import __version__
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ..store import runs
from ..store.stamp import changed, said, with_imports
from . import recorded

MODULES = (
    *("suites", "at_work", "agreement", "other_parts", "stages", "small", "identified"),
    *("campaigns", "filter_search", "interval_coverage", "pace", "documents"),
)
"""Where studies are registered, in the order in which they are run."""

RUNS = Path("runs") / "figures"
"""Run folders of studies, where they need any; a study that was interrupted goes on there."""


@dataclass(frozen=True)
class Study:
    """A registered study.

    Attributes:
        name: of the study and of its file.
        about: what it measures, in a line.
        command: with which anybody makes the same.
        minutes: of CPU time, about.
        depends: patterns of files that are loaded by name, see :mod:`stamp`; what ``make``'s module imports counts too.
        make: measures; gives ``numbers``, a tree of dictionaries, and whatever else is stored beside them.
    """

    name: str
    about: str
    command: str
    minutes: float
    depends: tuple[str, ...]
    make: Callable[["Trial"], dict[str, Any]]

    def stamp(self) -> dict[str, str]:
        """Of what it depends on, as it stands now: its module with all that it imports, and files that it names."""
        own = Path(inspect.getfile(self.make))
        return with_imports([own], self.depends) | {"the study itself": said(self.make)}

    def outdated(self) -> list[str]:
        """Why its results are not today's: files that have changed; empty if they are."""
        found = recorded.read(self.name)
        if found is None:
            return ["never run"]
        return changed(found["depends"], self.stamp())


@dataclass(frozen=True)
class Trial:
    """How a study is run: its name, what it depends on, and how many processes it may use."""

    study: Study
    workers: int

    @property
    def folder(self) -> Path:
        """Of its run."""
        return RUNS / self.study.name


_studies: dict[str, Study] = {}


def study(
    name: str, about: str, command: str, minutes: float, depends: Sequence[str]
) -> Callable[[Callable[[Trial], dict[str, Any]]], Callable[[Trial], dict[str, Any]]]:
    """Registers a function as a study; arguments as the attributes of :class:`Study`."""

    def register(make: Callable[[Trial], dict[str, Any]]) -> Callable[[Trial], dict[str, Any]]:
        _studies[name] = Study(name, about, command, minutes, tuple(depends), make)
        return make

    return register


def studies(names: Sequence[str] = ()) -> list[Study]:
    """The studies asked for; all of them if none is.

    Raises:
        InvalidInput: no study of that name.
    """
    for module in MODULES:
        importlib.import_module(f"{__package__}.{module}")
    for name in names:
        if name not in _studies:
            raise InvalidInput(f"no study '{name}'; {did_you_mean(name, _studies)}")
    return [_studies[name] for name in dict.fromkeys(names or _studies)]


def run(chosen: Study, workers: int, origin: dict[str, Any] | None = None) -> str:
    """Runs a study and stores its results; gives a line about what has changed."""
    before, started, now = recorded.read(chosen.name), time.time(), chosen.stamp()
    found = chosen.make(Trial(chosen, workers))
    body = {key: found.pop(key, default) for key, default in (("command", chosen.command), ("seeds", None))}
    body = {"study": chosen.name, **body, "kerfgym": __version__, **(recorded.origin() if origin is None else origin)}
    body |= {"processor": runs.record()["machine"]["processor"], "workers": workers}
    body["wall_seconds"] = round(found.pop("wall_seconds", time.time() - started), 1)
    body |= {"depends": now, **found}
    body = recorded.plain(body)
    recorded.write(chosen.name, body)
    count, moved = recorded.differences(before, body)
    words = "all new" if before is None else f"{moved} differ by more than 1 % from before"
    return f"{count} numbers, {words}; {body['wall_seconds']:g} s of wall time"
