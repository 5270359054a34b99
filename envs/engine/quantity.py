"""What a number of the machine is: its unit, range, meaning and source, declared once beside the field."""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from .lanes import is_part


class InvalidInput(ValueError):
    """Bad input from a user; the message says what was wrong, where, and what is allowed."""


@dataclass(frozen=True)
class Quantity:
    """Metadata of one field of a part's ``Params``; stands inside ``Annotated[float, Quantity(…)]``.

    ``source`` is a document ("Xi2023"), or one of [P] published elsewhere, [C] computed, [A] assumed.
    """

    unit: str
    low: float
    high: float
    doc: str
    source: str = "[A]"
    whole: bool = False
    log: bool = False
    choices: tuple[str, ...] = ()

    @property
    def range(self) -> str:
        """The allowed values in words."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        return f"{self.low:g} to {self.high:g}{unit}" + (" (whole)" if self.whole else "")

    def check(self, value: Any, where: str) -> float:
        """``value`` as the number that the kernel takes.

        Raises:
            InvalidInput: not a number, not one of the choices, or out of range.
        """
        if self.choices and isinstance(value, str):
            if value not in self.choices:
                raise InvalidInput(f"{where} = '{value}' is not known; {did_you_mean(value, self.choices)}")
            return float(self.choices.index(value))
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise InvalidInput(f"{where} = {value!r} is not a number; allowed: {self.range}") from None
        if not self.low <= number <= self.high or (self.whole and number != round(number)):
            raise InvalidInput(f"{where} = {value} is out of range; allowed: {self.range}")
        return number


def quantities(cls: Any, prefix: str = "") -> dict[str, Quantity]:
    """The declared quantities of a part's ``Params`` by dotted name."""
    found: dict[str, Quantity] = {}
    for name, kind in get_type_hints(cls, include_extras=True).items():
        if get_origin(kind) is Annotated:
            found.update({prefix + name: m for m in get_args(kind)[1:] if isinstance(m, Quantity)})
        elif is_part(kind):
            found.update(quantities(kind, f"{prefix}{name}."))
    return found


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """«did you mean 'x'? (known: …)» for an unknown name."""
    known = list(allowed)
    lower = {k.lower(): k for k in known}
    near = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.5)
    hint = f"did you mean '{lower[near[0]]}'? " if near else ""
    return f"{hint}(known: {', '.join(known)})"


def in_order(text: str) -> tuple[str, ...]:
    """The words of a text: a long list of names without a quotation mark around each."""
    return tuple(text.split())


def check_choice(value: str, allowed: Iterable[str], what: str) -> None:
    """Raises :class:`InvalidInput` for a word that is not one of those allowed; the nearest is offered."""
    if value not in allowed:
        raise InvalidInput(f"unknown {what} '{value}'; {did_you_mean(str(value), allowed)}")


def checked(cls: Any, values: dict[str, Any], where: str) -> Any:
    """An instance of a part's ``Params`` with ``values`` in place of defaults, every one checked.

    Args:
        cls: a NamedTuple whose tunable fields are ``Annotated[float, Quantity(…)]``.
        values: field name to value; a choice may be given by name.
        where: put before the field's name in messages, such as ``"filter."``.

    Raises:
        InvalidInput: unknown field (the nearest is offered), or value out of range (range and unit named).
    """
    known = quantities(cls)
    for name in values:
        if name not in known:
            raise InvalidInput(f"unknown parameter '{where}{name}'; {did_you_mean(name, known)}")
    return cls(**{name: known[name].check(value, where + name) for name, value in values.items()})
