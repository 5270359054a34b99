"""Scenarios as TOML that reads back to equal ones."""

from dataclasses import asdict
from typing import Any

from . import dead
from .travel import Reading


def text_of(scenario: Any) -> str:
    """The TOML text of a :class:`schema.Scenario`."""
    import tomli_w

    tables = asdict(scenario)
    for name in dead.reasons(scenario.job is not None):
        del tables[name]
    if scenario.drawing == Reading():
        del tables["drawing"]
    return tomli_w.dumps(_without_none(tables))


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value
