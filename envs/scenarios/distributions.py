"""Numbers of a scenario: fixed, or drawn anew for every seed.

In TOML: ``feed = 200``, ``amplitude = { uniform = [0.3, 0.7] }``, ``tilt = { uniform = [0.003, 0.012], sign = "±" }``,
``noise = { log_uniform = [5e-4, 5e-3] }``, ``set_height = { choice = [0.5, 0.8, 1.0] }``.

A draw depends on the seed and on the number's own name alone, so it is the same in whatever order or company it is
made, and a new number in a scenario leaves the others as they were. What is only known together is drawn together:
lists with the same ``joint`` are the columns of one table, of which a seed takes a row::

    bandwidth = { choice = [24.1, 25.3, 26.0], joint = "motion" }
    zeta = { choice = [0.81, 0.78, 0.74], joint = "motion" }
"""

import functools
import hashlib
import math
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal

import numpy as np

from ..engine.columns import Columns
from ..engine.lanes import mix
from ..engine.quantity import did_you_mean


@dataclass(frozen=True, kw_only=True)
class _Between:
    key: ClassVar[str]
    sign: Literal["+", "±"] = "+"

    def __post_init__(self) -> None:
        object.__setattr__(self, self.key, _floats(self.ends))
        if self.sign not in ("+", "±"):
            raise ValueError(f"sign = {self.sign!r} is not allowed; allowed: '+' or '±'")
        if len(self.ends) != 2:
            raise ValueError(f"a range has two ends, not {len(self.ends)}")
        low, high = self.ends
        if not low <= high:
            raise ValueError(f"the range [{low}, {high}] must rise")

    @property
    def ends(self) -> tuple[float, float]:
        """Least and greatest magnitude."""
        return getattr(self, self.key)

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value that can be drawn."""
        low, high = self.ends
        return (-high, high) if self.sign == "±" else (low, high)


@dataclass(frozen=True, kw_only=True)
class Uniform(_Between):
    """Uniform between two ends; with ``sign = "±"`` either sign, equally likely."""

    key = "uniform"
    uniform: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class LogUniform(_Between):
    """Uniform in the logarithm, between two positive ends."""

    key = "log_uniform"
    log_uniform: tuple[float, float]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.log_uniform[0] > 0:
            raise ValueError("both ends must be greater than 0")


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One of a list, equally likely."""

    choice: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "choice", _floats(self.choice))
        if not self.choice:
            raise ValueError("at least 1 item is needed")

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value that can be drawn."""
        return min(self.choice), max(self.choice)


@dataclass(frozen=True, kw_only=True)
class Joint(Choice):
    """A list of which a seed takes the same place as of all other lists of that ``joint``."""

    joint: str

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (isinstance(self.joint, str) and self.joint.isidentifier()):
            raise ValueError(f"joint = {self.joint!r} is not allowed; allowed: a word, such as 'motion'")


def _floats(values: Any) -> tuple[float, ...]:
    for value in values:
        if isinstance(value, bool | str | list | tuple | dict):
            raise ValueError(f"{value!r} is not a number")
    numbers = tuple(float(value) for value in values)
    if any(math.isnan(number) for number in numbers):
        raise ValueError("nan is not a number")
    return numbers


_KINDS = {"uniform": Uniform, "log_uniform": LogUniform, "choice": Choice}


Number = float | Uniform | LogUniform | Choice
"""A fixed number or a distribution."""


def as_number(value: Any) -> Number:
    """A fixed number or a distribution from what stands for it in TOML, or from itself.

    Raises:
        ValueError: neither; says what is allowed.
    """
    if isinstance(value, Uniform | LogUniform | Choice):
        return value
    if isinstance(value, dict):
        known = (*_KINDS, "sign", "joint")
        for key in value:
            if key not in known:
                raise ValueError(f"unknown distribution '{key}'; {did_you_mean(key, known)}")
        if len(given := [kind for key, kind in _KINDS.items() if key in value]) != 1:
            raise ValueError(f"a distribution has exactly one of {', '.join(_KINDS)}")
    try:
        if isinstance(value, bool | str):
            raise TypeError
        if not isinstance(value, dict):
            return float(value)
        return (Joint if given[0] is Choice and "joint" in value else given[0])(**value)
    except TypeError:
        raise ValueError(f"a number or a distribution is needed, not {value!r}") from None


def check_joint(*sections: Any) -> None:
    """Refuses lists of one ``joint`` that differ in length, which are no table.

    Raises:
        ValueError: names both.
    """
    first: dict[str, tuple[str, int]] = {}
    for section in sections:
        for field in fields(section):
            number = getattr(section, field.name)
            if isinstance(number, Joint):
                name, rows = first.setdefault(number.joint, (field.name, len(number.choice)))
                if rows != len(number.choice):
                    raise ValueError(
                        f"{field.name} has {len(number.choice)} values and {name} has {rows}; lists of one joint, here "
                        f"'{number.joint}', are columns of one table"
                    )


def bounds(number: Number) -> tuple[float, float]:
    """Least and greatest value of a number or distribution."""
    return (number, number) if isinstance(number, int | float) else number.bounds


def middle(number: Number) -> float:
    """The number, or the middle of what can be drawn."""
    return sum(bounds(number)) / 2


class Draws:
    """The uniform numbers of some seeds, shape (n,) for each label.

    Args:
        seeds: uint64, shape (n,).
        labels: which have been asked for before, in order; their numbers are made all at once, which costs little more
            than those of one. New ones are added.
    """

    def __init__(self, seeds: np.ndarray, labels: dict[str, int]) -> None:
        self.seeds, self._labels, self._ready = seeds, labels, len(labels)
        self._fractions = _fractions(seeds, list(labels))

    def fraction(self, label: str) -> np.ndarray:
        """Uniform numbers in [0, 1), one per seed, that belong to ``label``."""
        row = self._labels.setdefault(label, len(self._labels))
        return self._fractions[row] if row < self._ready else _fractions(self.seeds, [label])[0]


@functools.cache
def _salt(label: str) -> int:
    return int.from_bytes(hashlib.blake2b(label.encode(), digest_size=8).digest(), "little")


def _fractions(seeds: np.ndarray, labels: list[str]) -> np.ndarray:
    salts = np.array([_salt(label) for label in labels], np.uint64)
    return (mix(seeds, salts[:, None]) >> np.uint64(11)).astype(np.float64) / 2.0**53


def draw(number: Number, draws: Draws, label: str) -> Any:
    """One value per seed, shape (n,), for the number called ``label``; the number itself if it is fixed."""
    if isinstance(number, int | float):
        return float(number)
    if isinstance(number, Choice):
        u = draws.fraction(f"joint.{number.joint}" if isinstance(number, Joint) else label)
        return np.asarray(number.choice)[(u * len(number.choice)).astype(int)]
    low, high = number.ends
    u = draws.fraction(label)
    if isinstance(number, LogUniform):
        value = low * (high / low) ** u
    else:
        value = low + u * (high - low)
    if number.sign == "±":
        value = np.where(draws.fraction(label + ".sign") < 0.5, value, -value)
    return value


class Drawn:
    """A section's numbers as drawn for some seeds: ``Drawn(scenario.axis, draws, "axis").zeta``, shape (n,), or one
    number if it is fixed."""

    def __init__(self, section: Any, draws: Draws, label: str) -> None:
        self._section, self._draws, self._place = section, draws, f"{label}." if label else ""

    def __getattr__(self, name: str) -> Any:
        number = getattr(self._section, name)
        value = number if type(number) is float else draw(number, self._draws, self._place + name)
        self.__dict__[name] = value  # the next time it is there
        return value

    def into(self, columns: Columns, place: str, machines: np.ndarray, **made: Any) -> None:
        """Writes a part.

        Args:
            columns: in which it lies.
            place: its name there; what section and part call the same, is written as it was drawn.
            machines: indices, shape (n,).
            made: fields that the part calls, or counts, otherwise.
        """
        kind: Any = type(self._section)
        for name in _shared(kind, columns.fields_of(place)):
            if name not in made:
                number = getattr(self._section, name)
                made[name] = number if type(number) is float else getattr(self, name)
        columns.set_some(place, machines, made)


@functools.cache
def _shared(section: Any, part: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in part if name in section.__dataclass_fields__)
