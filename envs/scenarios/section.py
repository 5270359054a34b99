"""What a table of a scenario is: frozen, no unknown keys, every field of its kind, every number within its range."""

import re
from dataclasses import MISSING, dataclass, fields
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

from ..engine.quantity import InvalidInput, did_you_mean
from .distributions import as_number, bounds

Kind = TypeVar("Kind", bound="Section")


@dataclass(frozen=True, kw_only=True)
class Section:
    """A table of a scenario: frozen, every field of its kind, every number within its declared range.

    Fields may be given as TOML has them: tables, arrays, whole numbers.
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, fitting(field.type, getattr(self, field.name), field.name))


def of_table(kind: type[Kind], table: dict[str, Any], place: str = "") -> Kind:
    """The section of this kind that a table holds.

    Args:
        kind: a :class:`Section`.
        table: as TOML has it.
        place: the keys that lead to it, a dot behind each.

    Raises:
        InvalidInput: an unknown key (the nearest is offered), a missing one, or a value that is not allowed (what is).
    """
    known = {field.name: field for field in fields(kind)}
    for key in table:
        if key not in known:
            raise InvalidInput(f"unknown key '{place}{key}'; {did_you_mean(key, known)}")
    for key, field in known.items():
        if field.default is MISSING and key not in table:
            raise InvalidInput(f"{place}{key} is missing")
    held = {key: fitting(known[key].type, value, place + key) for key, value in table.items()}
    try:
        return kind(**held)
    except ValueError as error:
        about_a_key = not place or re.match(r"\w+ = ", str(error))
        raise InvalidInput(f"{place}{error}" if about_a_key else f"{place[:-1]}: {error}") from None


def fitting(kind: Any, value: Any, name: str) -> Any:
    """``value`` as the field ``name`` of type ``kind`` holds it.

    Raises:
        InvalidInput: not of that kind, or out of its range.
    """
    inner = get_args(kind)
    if get_origin(kind) is Annotated:
        what, *_, quantity = inner
        if what in (int, float):
            if isinstance(value, bool | str) and not quantity.choices:
                raise InvalidInput(f"{name} = {value!r} is not a number; allowed: {quantity.range}")
            return what(quantity.check(value, name))
        try:
            value = as_number(value)
        except ValueError as error:
            raise InvalidInput(f"{name}: {error}") from None
        for end in bounds(value):
            quantity.check(end, name)
        return value
    if type(None) in inner:
        return None if value is None else fitting(inner[0], value, name)
    if get_origin(kind) is tuple and isinstance(value, list | tuple):
        return tuple(fitting(inner[0], each, f"{name}.{i}") for i, each in enumerate(value))
    if isinstance(value, dict) and isinstance(kind, type) and issubclass(kind, Section):
        return of_table(kind, value, name + ".")
    literal, plain = get_origin(kind) is Literal, get_origin(kind) or kind
    if not (value in inner if literal else isinstance(value, plain) and (plain is bool or not isinstance(value, bool))):
        allowed = " or ".join(map(repr, inner)) if literal else _PLAIN.get(plain, f"a table ({plain.__name__})")
        raise InvalidInput(f"{name} = {value!r} is not allowed; allowed: {allowed}")
    return value


_PLAIN = {str: "text", bool: "true or false", int: "a whole number", float: "a number", tuple: "an array"}
"""What a value of such a kind is called where it is written."""


def line_of(text: str, message: str) -> str:
    """Where in TOML text the key stands that a message begins with, or the nearest table around it; else nothing."""
    location = re.sub("^unknown key '", "", message).split(" ")[0].strip("';:").split(".")
    best, found = 0, ""
    table: list[str] = []
    seen: dict[str, int] = {}
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        if line.startswith("["):
            name = line.split("]")[0].strip("[] ")
            table = name.split(".")
            if line.startswith("[["):
                seen[name] = seen.get(name, -1) + 1
                table.append(str(seen[name]))
            path = table
        elif "=" in line and not line.startswith("#"):
            path = [*table, *line.split("=")[0].strip().split(".")]
        else:
            continue
        if len(path) > best and location[: len(path)] == path:
            best, found = len(path), f", line {number}"
    return found
