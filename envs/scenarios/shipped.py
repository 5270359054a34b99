"""The frozen suites, users' own suites in folders, and scenarios by name.

A user's suite is a folder with a TOML file for each scenario. ``suite.toml`` in it, if it is there, says what a suite's
file says; what it leaves out is as in :func:`_usual_rules`. Wherever a suite is asked for, its folder is taken, too.
"""

import functools
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..engine.quantity import InvalidInput, did_you_mean
from ..safety import files, names
from .reading import read
from .schema import Scenario
from .section import Section, line_of, of_table

_SUITES = Path(__file__).parents[1] / "suites"


def suites() -> list[str]:
    """Names of the suites, in order."""
    return sorted(p.name for p in _SUITES.iterdir() if p.is_dir())


def suite(name: str) -> dict[str, Scenario]:
    """The scenarios of a suite by name, in the suite's order.

    Args:
        name: of a shipped suite, or the folder of one's own.

    Raises:
        InvalidInput: no suite of that name (the nearest is offered) and no folder, or what is wrong in its files.
    """
    if is_own(name):
        return dict(_own(Path(name), _stamp(Path(name)))[1])
    if name not in suites():
        raise InvalidInput(f"unknown suite '{name}'; {did_you_mean(name, suites())}, or a folder of scenarios")
    return dict(_suite(name))


@functools.cache
def _suite(name: str) -> tuple[tuple[str, Scenario], ...]:
    order = rules(name)["scenarios"]
    return tuple((s, _shipped(name, s)) for s in order)


@functools.cache
def _shipped(group: str, name: str) -> Scenario:
    return read(_SUITES / group / f"{name}.toml")


def rules(name: str) -> dict[str, Any]:
    """What a suite's file says beside its scenarios: ``score``, ``reference``, ``controllers``."""
    return dict(_own(Path(name), _stamp(Path(name)))[0]) if is_own(name) else _rules(name)


@functools.cache
def _rules(name: str) -> dict[str, Any]:
    return checked_rules(_SUITES / f"{name}.toml")


def is_own(name: str | Path) -> bool:
    """Whether this is a user's suite: a folder, and no shipped suite's name."""
    return str(name) not in suites() and files.is_folder(name)


def called(name: str | Path) -> str:
    """The name of a suite in tables and folders: of one's own that of its folder.

    Raises:
        InvalidInput: the folder is called as a shipped suite is, or as no suite can be.
    """
    if not is_own(name):
        return str(name)
    own = names.checked(Path(name).resolve().name, "suite")
    if own in suites():
        raise InvalidInput(f"'{name}': suite '{own}' is shipped already; one's own needs another name")
    return own


OWN_RULES = "suite.toml"
"""File of a user's suite that says more than that there are scenarios."""


def _stamp(folder: Path) -> tuple[tuple[str, int], ...]:
    """What changes when a file of a folder does."""
    return tuple((file.name, file.stat().st_mtime_ns) for file in sorted(folder.glob("*.toml")))


@functools.lru_cache(maxsize=32)
def _own(folder: Path, stamp: tuple[tuple[str, int], ...]) -> tuple[dict[str, Any], tuple[tuple[str, Scenario], ...]]:
    """Rules and scenarios of a user's suite."""
    called(folder)
    found: dict[str, Scenario] = {}
    for name, _ in stamp:
        if name != OWN_RULES:
            scenario = read(folder / name)
            if scenario.name in found:
                raise InvalidInput(f"'{folder / name}': there are two scenarios '{scenario.name}' in this suite")
            found[scenario.name] = scenario
    if not found:
        raise InvalidInput(f"suite '{folder}' holds no scenario; it needs a TOML file for each")
    if len({s.job is None for s in found.values()}) > 1:
        raise InvalidInput(f"suite '{folder}': scenarios with a job and scenarios without one cannot share a suite")
    file, said = folder / OWN_RULES, {}
    if files.is_file(file):
        text = files.text(file, files.SETTINGS)
        try:
            said = asdict(of_table(OwnRules, files.toml_of(text, file)))
        except InvalidInput as error:
            raise InvalidInput(f"{file}{line_of(text, str(error))}: {error}") from None
        said = {key: value for key, value in said.items() if value is not None}
    whole = {**_usual_rules(found), **said}
    for key in ("scenarios", "core"):
        for name in whole[key]:
            if name not in found:
                raise InvalidInput(f"{file}: {key}: unknown scenario '{name}'; {did_you_mean(name, found)}")
    if extra := [name for name in whole["core"] if name not in whole["scenarios"]]:
        raise InvalidInput(f"{file}: core: '{extra[0]}' is none of the suite's scenarios")
    return whole, tuple((name, found[name]) for name in whole["scenarios"])


def _usual_rules(found: dict[str, Scenario]) -> dict[str, Any]:
    """Of a suite that says nothing: those of the suites following or contour, with all its scenarios in the core."""
    of = _rules("contour" if next(iter(found.values())).job else "following")
    kept = {key: value for key, value in of.items() if key not in ("along", "controllers")}
    return {**kept, "version": 1, "scenarios": tuple(found), "core": tuple(found)}


@dataclass(frozen=True, kw_only=True)
class OwnRules(Section):
    """The file of a user's suite; what is left out is as usual."""

    version: int | None = None
    scenarios: tuple[str, ...] | None = None
    core: tuple[str, ...] | None = None
    slot: str | None = None
    environment: str | None = None
    seeds: int | None = None
    score: str | None = None
    reference: str | None = None
    controllers: tuple[str, ...] | None = None


@dataclass(frozen=True, kw_only=True)
class Rules(Section):
    """The file of a suite."""

    version: int
    scenarios: tuple[str, ...]
    core: tuple[str, ...]
    slot: str
    environment: str
    seeds: int
    score: str | None = None
    reference: str | None = None
    controllers: tuple[str, ...] | None = None
    along: str | None = None


def checked_rules(file: Path) -> dict[str, Any]:
    """What the file of a suite says.

    Raises:
        InvalidInput: a key is missing, unknown or of the wrong kind.
    """
    try:
        given = asdict(of_table(Rules, files.toml(file)))
    except InvalidInput as error:
        raise InvalidInput(f"{file}: {error}") from None
    return {key: value for key, value in given.items() if value is not None}


def core(name: str) -> tuple[str, ...]:
    """Names of the scenarios over which the suite's score is taken."""
    found: tuple[str, ...] = rules(name)["core"]
    return found


def load(name: str | Path | Scenario) -> Scenario:
    """A scenario by name, from a TOML file, or as it is.

    Raises:
        InvalidInput: neither a known name (the nearest is offered) nor a readable file.
    """
    if isinstance(name, Scenario):
        return name
    for group in suites():
        for own in rules(group)["scenarios"]:
            if str(name) in (own, f"{group}/{own}"):
                return _shipped(group, own)
    if str(name).endswith(".toml") or files.is_file(name):
        return read(name)
    known = dict.fromkeys(s for group in suites() for s in suite(group))
    raise InvalidInput(f"unknown scenario '{name}'; {did_you_mean(str(name), known)}, or a path to a TOML file")
