"""The frozen suites, and scenarios by name."""

import functools
from pathlib import Path
from typing import Any

from ..engine.quantity import InvalidInput, did_you_mean
from ..safety import files
from .reading import read
from .schema import Scenario

_SUITES = Path(__file__).parents[1] / "suites"


def suites() -> list[str]:
    """Names of the suites, in order."""
    return sorted(p.name for p in _SUITES.iterdir() if p.is_dir())


def suite(name: str) -> dict[str, Scenario]:
    """The scenarios of a suite by name, in the suite's order.

    Raises:
        InvalidInput: no suite of that name; the nearest is offered.
    """
    if name not in suites():
        raise InvalidInput(f"unknown suite '{name}'; {did_you_mean(name, suites())}")
    return dict(_suite(name))


@functools.cache
def _suite(name: str) -> tuple[tuple[str, Scenario], ...]:
    order = rules(name)["scenarios"]
    return tuple((s, _shipped(name, s)) for s in order)


@functools.cache
def _shipped(group: str, name: str) -> Scenario:
    # Without pydantic, so that a start does without it; tests compare this with what :func:`read` makes of the file.
    return Scenario(**files.toml(_SUITES / group / f"{name}.toml"))


@functools.cache
def rules(name: str) -> dict[str, Any]:
    """What a suite's file says beside its scenarios: ``score``, ``reference``, ``controllers``."""
    return checked_rules(_SUITES / f"{name}.toml")


_RULES: dict[str, type] = {
    "version": int, "scenarios": list, "core": list, "slot": str, "environment": str, "seeds": int,
}  # fmt: skip
_MORE_RULES: dict[str, type] = {"score": str, "reference": str, "controllers": list, "along": str}


def checked_rules(file: Path) -> dict[str, Any]:
    """What the file of a suite says.

    Raises:
        InvalidInput: a key is missing, unknown or of the wrong kind.
    """
    found = files.toml(file)
    known = {**_RULES, **_MORE_RULES}
    for key, value in found.items():
        if key not in known:
            raise InvalidInput(f"{file}: unknown key '{key}'; {did_you_mean(key, known)}")
        texts = isinstance(value, list) and all(isinstance(each, str) for each in value)
        if type(value) is not known[key] or (known[key] is list and not texts):
            kind = "list of texts" if known[key] is list else known[key].__name__
            raise InvalidInput(f"{file}: {key} = {str(value)[:80]!r} is no {kind}")
    if missing := [key for key in _RULES if key not in found]:
        raise InvalidInput(f"{file}: '{missing[0]}' is missing")
    return found


@functools.cache
def core(name: str) -> tuple[str, ...]:
    """Names of the scenarios over which the suite's score is taken."""
    return tuple(rules(name)["core"])


def load(name: str | Path | Scenario) -> Scenario:
    """A scenario by name, from a TOML file, or as it is.

    Raises:
        InvalidInput: neither a known name (the nearest is offered) nor a readable file.
    """
    if isinstance(name, Scenario):
        return name
    group, _, own = str(name).partition("/")
    if own and group in suites() and own in rules(group)["scenarios"]:
        return _shipped(group, own)
    for group in suites():
        if str(name) in rules(group)["scenarios"]:
            return _shipped(group, str(name))
    if str(name).endswith(".toml") or files.is_file(name):
        return read(name)
    known = [s for group in suites() for s in suite(group)]
    raise InvalidInput(f"unknown scenario '{name}'; {did_you_mean(str(name), known)}, or a path to a TOML file")
