"""The frozen suites, and scenarios by name."""

import functools
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..engine.quantity import InvalidInput, check_choice, did_you_mean
from ..safety import files
from .reading import read
from .schema import Scenario
from .section import Section, of_table

_SUITES = Path(__file__).parents[1] / "suites"


def suites() -> list[str]:
    """Names of the suites, in order."""
    return sorted(p.name for p in _SUITES.iterdir() if p.is_dir())


def suite(name: str) -> dict[str, Scenario]:
    """The scenarios of a suite by name, in the suite's order.

    Raises:
        InvalidInput: no suite of that name; the nearest is offered.
    """
    check_choice(name, suites(), "suite")
    return dict(_suite(name))


@functools.cache
def _suite(name: str) -> tuple[tuple[str, Scenario], ...]:
    order = rules(name)["scenarios"]
    return tuple((s, _shipped(name, s)) for s in order)


@functools.cache
def _shipped(group: str, name: str) -> Scenario:
    return read(_SUITES / group / f"{name}.toml")


@functools.cache
def rules(name: str) -> dict[str, Any]:
    """What a suite's file says beside its scenarios: ``score``, ``reference``, ``controllers``."""
    return checked_rules(_SUITES / f"{name}.toml")


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


@functools.cache
def core(name: str) -> tuple[str, ...]:
    """Names of the scenarios over which the suite's score is taken."""
    return rules(name)["core"]


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
