"""What users write, checked by pydantic: the first mistake with its line, its key, and what is allowed.

pydantic is imported only when something is checked: it takes 0.2 s.
"""

import functools
from dataclasses import fields
from typing import Any, TypeVar, get_args

from ..engine.quantity import InvalidInput, did_you_mean
from .section import Section

Checked = TypeVar("Checked", bound=Section)


def _section_at(kind: type[Section], location: tuple) -> type[Section] | None:
    """The section whose key an error is about; None: it is a distribution's."""
    section: type[Section] | None = kind
    for key in location:
        held = next((f.type for f in fields(section) if f.name == key), None) if section else None
        if held is not None:
            kinds = [k for k in (held, *get_args(held)) if isinstance(k, type) and issubclass(k, Section)]
            section = kinds[0] if kinds else None
    return section


@functools.cache
def _validator(kind: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def validated(kind: type[Checked], data: dict, where: str, text: str = "") -> Checked:
    """A section of this kind from tables.

    Args:
        kind: a :class:`Section`.
        data: as TOML has it.
        where: what they come from, such as a file.
        text: their TOML, so that an error can name its line.

    Raises:
        InvalidInput: where, line and key of the first mistake, and what is allowed.
    """
    from pydantic import ValidationError

    plain: Any = kind
    try:
        return _validator(plain).validate_python(data)
    except ValidationError as error:
        # A misspelt key explains the missing one that usually comes with it.
        first = min(error.errors(), key=lambda e: e["type"] != "unexpected_keyword_argument")
        location = tuple(k for k in first["loc"] if k not in ("float", "Uniform", "LogUniform", "Choice"))
        key = ".".join(str(k) for k in location)
        said = first["msg"].removeprefix("Value error, ")
        about = (said.split(" = ")[0],) if " = " in said else ()  # a range error names its own key
        line = line_of(text, location + about)
        if first["type"] == "unexpected_keyword_argument":
            section = _section_at(kind, location[:-1])
            known = [f.name for f in fields(section)] if section else ["uniform", "log_uniform", "choice", "sign"]
            message = f"unknown key '{key}'; {did_you_mean(str(location[-1]), known)}"
        else:
            message = f"{key}: {said}" if key else said
        raise InvalidInput(f"{where}{line}: {message}") from None


def line_of(text: str, location: tuple) -> str:
    """Line of the key, or of the nearest table around it, in TOML text."""
    best, found = 0, ""
    table: tuple = ()
    seen: dict[tuple, int] = {}
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        if line.startswith("["):
            table = tuple(line.split("]")[0].strip("[] ").split("."))
            if line.startswith("[["):
                seen[table] = seen.get(table, -1) + 1
                table = (*table, seen[table])
            path = table
        elif "=" in line and not line.startswith("#"):
            path = (*table, *line.split("=")[0].strip().split("."))
        else:
            continue
        if len(path) > best and location[: len(path)] == path:
            best, found = len(path), f", line {number}"
    return found
