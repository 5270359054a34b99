"""What a table of a scenario is: frozen, every field of its kind, every number within its declared range."""

from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal, get_args, get_origin

from ..engine.quantity import InvalidInput
from .distributions import as_number, bounds


@dataclass(frozen=True, kw_only=True)
class Section:
    """A table of a scenario: frozen, no unknown keys, every field of its kind, every number within its declared range.

    Fields may be given as TOML has them: tables, arrays, whole numbers.
    """

    __pydantic_config__ = {"extra": "forbid"}  # unknown keys are errors

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, fitting(field.type, getattr(self, field.name), field.name))


def fitting(kind: Any, value: Any, name: str) -> Any:
    """``value`` as the field ``name`` of type ``kind`` holds it.

    Raises:
        InvalidInput: not of that kind, or out of its range.
    """
    inner = get_args(kind)
    if get_origin(kind) is Annotated:
        what, *_, quantity = inner
        if what in (int, float):
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
        return tuple(fitting(inner[0], each, name) for each in value)
    if isinstance(value, dict) and isinstance(kind, type) and issubclass(kind, Section):
        return kind(**value)
    literal, plain = get_origin(kind) is Literal, get_origin(kind) or kind
    if not (value in inner if literal else isinstance(value, plain)):
        allowed = " or ".join(map(repr, inner)) if literal else plain.__name__
        raise InvalidInput(f"{name} = {value!r} is not allowed; allowed: {allowed}")
    return value
