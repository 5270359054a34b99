"""What a value is in C, and how a value of one kind becomes one of another."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .. import lanes


@dataclass(frozen=True)
class Kind:
    """Of a value."""

    word: str = ""


REAL, INT, BOOL, BITS, NOTHING = (Kind(word) for word in ("real", "int", "bool", "bits", "void"))


@dataclass(frozen=True)
class Struct(Kind):
    """A NamedTuple of a part."""

    cls: Any = None


@dataclass(frozen=True)
class Row(Kind):
    """Reals one behind the other: a memory, a slice of it, or a table.

    Attributes:
        length: of it, if it is known.
        constant: whether it is a table of the program.
    """

    length: int | None = None
    constant: bool = False


@dataclass(frozen=True)
class Grid(Kind):
    """A table of rows and columns."""

    rows: int = 0
    columns: int = 0


@dataclass(frozen=True)
class Several(Kind):
    """A tuple without names, such as the answer of a function that gives two things."""

    kinds: tuple[Kind, ...] = ()


PRIMARY, UNARY, TIMES, PLUS, SHIFT, LESS, EQUAL, BIT_AND, BIT_XOR, BIT_OR, AND, OR, TERNARY = (
    16,
    14,
    13,
    12,
    11,
    10,
    9,
    8,
    7,
    6,
    5,
    4,
    3,
)
"""How tightly an expression of C holds together."""

UNKNOWN = object()

FARTHEST = float(np.finfo(np.float32).max)
"""Largest ``float``."""

LARGEST = 2**31 - 1
"""Whole number that is an ``int``; larger ones are 64 bits."""


@dataclass(frozen=True)
class Value:
    """An expression.

    Attributes:
        kind: of its value.
        code: in C.
        level: of what holds it together.
        known: its value, where that is known when it is translated.
        parts: of several.
        dirty: whether it is a whole number made of a real one, which may be anything.
    """

    kind: Kind
    code: str = ""
    level: int = PRIMARY
    known: Any = UNKNOWN
    parts: "tuple[Value, ...]" = field(default=())
    dirty: bool = False

    @property
    def is_known(self) -> bool:
        """Whether its value is."""
        return self.known is not UNKNOWN

    def at(self, level: int) -> str:
        """Its code, in brackets where something that holds more loosely would come apart."""
        return self.code if self.level >= level else f"({self.code})"


def kind_of(cls: Any) -> Kind:
    """The kind of a field of a NamedTuple."""
    if lanes.is_part(cls):
        return Struct("struct", cls)
    return BOOL if cls is bool else REAL


def fields_of(cls: Any) -> dict[str, Kind]:
    """Kinds of a NamedTuple's fields."""
    return {name: kind_of(kind) for name, kind in zip(cls._fields, lanes.kinds(cls), strict=True)}


def literal(number: Any, single: bool) -> Value:
    """A number as it is written in C."""
    if isinstance(number, bool | np.bool_):
        return Value(BOOL, "true" if number else "false", known=bool(number))
    if isinstance(number, int | np.integer) and int(number) > LARGEST:
        return Value(BITS, f"UINT64_C(0x{int(number):X})", known=int(number))
    if isinstance(number, int | np.integer):
        return Value(INT, str(int(number)), PRIMARY if number >= 0 else UNARY, known=int(number))
    real = float(number)
    if real != real:
        return Value(REAL, "NAN", known=real)
    if real in (float("inf"), -float("inf")):
        return Value(REAL, "INFINITY" if real > 0 else "-INFINITY", PRIMARY if real > 0 else UNARY, known=real)
    text = repr(real)
    if single:
        real = min(max(real, -FARTHEST), FARTHEST)  # very large stays very large
        text = np.format_float_scientific(np.float32(real)) if "e" in repr(real) else str(np.float32(real))
    text = text if any(c in text for c in ".e") else f"{text}.0"
    return Value(REAL, text + "f" * single, PRIMARY if real >= 0 else UNARY, known=real)


def joined(one: Kind | None, other: Kind) -> Kind | None:
    """The kind of a variable that is now this and now that; None if there is none."""
    if one is None or one == other:
        return other
    if {one, other} == {REAL, INT}:
        return REAL
    if {one, other} == {BITS, INT}:
        return BITS
    if isinstance(one, Row) and isinstance(other, Row):
        return Row("row", one.length if one.length == other.length else None, one.constant or other.constant)
    if isinstance(one, Several) and isinstance(other, Several) and len(one.kinds) == len(other.kinds):
        both = [joined(a, b) for a, b in zip(one.kinds, other.kinds, strict=True)]
        return None if None in both else Several("several", tuple(both))  # type: ignore[arg-type]
    return None


def as_kind(value: Value, kind: Kind, real: str) -> Value | None:
    """The value as one of another kind; None if it cannot be one.

    Args:
        value: what is wanted otherwise.
        kind: as what.
        real: the word for a real number, ``double`` or ``float``.
    """
    if value.kind == kind or (isinstance(value.kind, Row) and isinstance(kind, Row)):
        return value
    if kind == REAL and value.kind == INT:
        if value.is_known and value.code.lstrip("-").isdigit():
            return literal(float(value.known), real == "float")
        return Value(REAL, f"({real}){value.at(UNARY)}", UNARY, value.known, dirty=value.dirty)
    if kind == BITS and value.kind == INT:
        if value.is_known and value.code.isdigit():
            return Value(BITS, f"UINT64_C({value.code})", known=value.known)
        return Value(BITS, f"(uint64_t){value.at(UNARY)}", UNARY, value.known)
    if kind == REAL and value.kind == BOOL:
        one, none = literal(1.0, real == "float"), literal(0.0, real == "float")
        return Value(REAL, f"{value.at(OR)} ? {one.code} : {none.code}", TERNARY)
    if isinstance(kind, Several) and isinstance(value.kind, Several) and len(kind.kinds) == len(value.parts):
        parts = [as_kind(part, inner, real) for part, inner in zip(value.parts, kind.kinds, strict=True)]
        return None if None in parts else replace(value, kind=kind, parts=tuple(parts))  # type: ignore[arg-type]
    return None
