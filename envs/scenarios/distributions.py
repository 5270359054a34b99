"""Numbers of a scenario: fixed, or drawn anew for every seed.

In TOML: ``feed = 200``, ``amplitude = { uniform = [0.3, 0.7] }``, ``tilt = { uniform = [0.003, 0.012], sign = "±" }``,
``noise = { log_uniform = [5e-4, 5e-3] }``, ``set_height = { choice = [0.5, 0.8, 1.0] }``.

A draw depends on the seed and on the number's own name alone, so it is the same in whatever order or company it is
made, and a new number in a scenario leaves the others as they were.

Numbers that users write are validated by pydantic, which is imported only then: it takes 0.2 s.
"""

import functools
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

import numpy as np

from ..engine.lanes import mix
from ..engine.quantity import did_you_mean


@dataclass(frozen=True)
class _Checked:
    """Has pydantic call ``check`` on one field, so that an error names the field; called on construction as well."""

    check: Callable[[tuple[float, ...]], tuple[float, ...]]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(self.check, handler(source))


def _positive(ends: tuple[float, ...]) -> tuple[float, ...]:
    if not all(end > 0 for end in ends):
        raise ValueError("both ends must be greater than 0")
    return ends


def _some(values: tuple[float, ...]) -> tuple[float, ...]:
    if not values:
        raise ValueError("at least 1 item is needed")
    return values


@dataclass(frozen=True, kw_only=True)
class _Between:
    sign: Literal["+", "±"] = "+"

    __pydantic_config__ = {"extra": "forbid"}  # unknown keys are errors

    def __post_init__(self) -> None:
        if self.sign not in ("+", "±"):
            raise ValueError(f"sign = {self.sign!r} is not allowed; allowed: '+' or '±'")
        if len(self.ends()) != 2:
            raise ValueError(f"a range has two ends, not {len(self.ends())}")
        low, high = self.ends()
        if not low <= high:
            raise ValueError(f"the range [{low}, {high}] must rise")

    def ends(self) -> tuple[float, float]:
        """Least and greatest magnitude."""
        raise NotImplementedError

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value that can be drawn."""
        low, high = self.ends()
        return (-high, high) if self.sign == "±" else (low, high)


@dataclass(frozen=True, kw_only=True)
class Uniform(_Between):
    """Uniform between two ends; with ``sign = "±"`` either sign, equally likely."""

    uniform: tuple[float, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "uniform", _floats(self.uniform))
        super().__post_init__()

    def ends(self) -> tuple[float, float]:
        """Least and greatest magnitude."""
        return self.uniform


@dataclass(frozen=True, kw_only=True)
class LogUniform(_Between):
    """Uniform in the logarithm, between two positive ends."""

    log_uniform: Annotated[tuple[float, float], _Checked(_positive)]

    def __post_init__(self) -> None:
        object.__setattr__(self, "log_uniform", _positive(_floats(self.log_uniform)))
        super().__post_init__()

    def ends(self) -> tuple[float, float]:
        """Least and greatest magnitude."""
        return self.log_uniform


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One of a list, equally likely."""

    choice: Annotated[tuple[float, ...], _Checked(_some)]

    __pydantic_config__ = {"extra": "forbid"}  # unknown keys are errors

    def __post_init__(self) -> None:
        object.__setattr__(self, "choice", _some(_floats(self.choice)))

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value that can be drawn."""
        return min(self.choice), max(self.choice)


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


_KINDS = {"uniform": Uniform, "log_uniform": LogUniform, "choice": Choice}


def _plain(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("a number or a distribution is needed, not true or false")
    if isinstance(value, str):
        raise ValueError(f"a number or a distribution is needed, not '{value}'")
    if isinstance(value, dict):
        known = (*_KINDS, "sign")
        unknown = [key for key in value if key not in known]
        if unknown:
            raise ValueError(f"unknown distribution '{unknown[0]}'; {did_you_mean(unknown[0], known)}")
        if len(set(value) & set(_KINDS)) != 1:
            raise ValueError(f"a distribution has exactly one of {', '.join(_KINDS)}")
    return value


def _kind(value: object) -> str:
    kind = type(value)
    if isinstance(value, dict):
        kind = next(kind for key, kind in _KINDS.items() if key in value)
    return kind.__name__ if kind in _KINDS.values() else "float"


class _OneOf:
    """Tells pydantic the kinds of a :data:`Number` apart by key, so that an error is about the one that was meant."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        kinds = {kind.__name__: handler.generate_schema(kind) for kind in get_args(source)}
        return core_schema.no_info_before_validator_function(_plain, core_schema.tagged_union_schema(kinds, _kind))


Number = Annotated[float | Uniform | LogUniform | Choice, _OneOf()]
"""A fixed number or a distribution."""


def as_number(value: Any) -> Number:
    """A fixed number or a distribution from what stands for it in TOML, or from itself.

    Raises:
        ValueError: neither; says what is allowed.
    """
    value = _plain(value)
    try:
        if isinstance(value, dict):
            return next(kind for key, kind in _KINDS.items() if key in value)(**value)
        return value if isinstance(value, Uniform | LogUniform | Choice) else float(value)
    except TypeError:
        raise ValueError(f"a number or a distribution is needed, not {value!r}") from None


def bounds(number: Number) -> tuple[float, float]:
    """Least and greatest value of a number or distribution."""
    return (number, number) if isinstance(number, int | float) else number.bounds


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
    u = draws.fraction(label)
    if isinstance(number, Choice):
        return np.asarray(number.choice)[(u * len(number.choice)).astype(int)]
    low, high = number.ends()
    if isinstance(number, LogUniform):
        value = low * (high / low) ** u
    else:
        value = low + u * (high - low)
    if number.sign == "±":
        value = np.where(draws.fraction(label + ".sign") < 0.5, value, -value)
    return value
