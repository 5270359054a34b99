"""Scenarios as TOML that reads back to equal ones."""

from dataclasses import asdict
from typing import Any

from ..engine.quantity import InvalidInput
from ..safety import files
from . import dead
from .travel import Reading

STANDARD_MACHINE = "standard"
"""Name of the machine that a scenario is cut by unless it is put on another."""


def text_of(scenario: Any) -> str:
    """The TOML text of a :class:`schema.Scenario`."""
    import tomli_w

    tables = dead.without(asdict(scenario))
    if scenario.drawing == Reading():
        del tables["drawing"]
    if scenario.cut_by == STANDARD_MACHINE:
        del tables["cut_by"]
    return tomli_w.dumps(without_none(tables))


def living(text: str) -> str:
    """The text of a stored scenario without the keys that change nothing, which early runs have; as it is if it has
    none, or is damaged."""
    import tomli_w

    try:
        tables = files.toml_of(text, "")
    except InvalidInput:
        return text
    alive = dead.without(tables)
    return text if alive == tables else tomli_w.dumps(alive)


def without_none(value: Any) -> Any:
    """Tables without what is None, which TOML cannot say."""
    if isinstance(value, dict):
        return {k: without_none(v) for k, v in value.items() if v is not None}
    return [without_none(v) for v in value] if isinstance(value, list | tuple) else value
