"""Numbers of a scenario: fixed, or drawn anew for every seed.

In TOML: ``feed = 200``, ``amplitude = { uniform = [0.3, 0.7] }``, ``tilt = { uniform = [0.003, 0.012], sign = "±" }``,
``noise = { log_uniform = [5e-4, 5e-3] }``, ``set_height = { choice = [0.5, 0.8, 1.0] }``.

A draw depends on the seed and on the number's own name alone, so it is the same in whatever order or company it is
made, and a new number in a scenario leaves the others as they were.
"""

import hashlib
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from .plant.lanes import mix
from .plant.quantity import did_you_mean


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class _Between(_Frozen):
    sign: Literal["+", "±"] = "+"

    def ends(self) -> tuple[float, float]:
        """Least and greatest magnitude."""
        raise NotImplementedError

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value that can be drawn."""
        low, high = self.ends()
        return (-high, high) if self.sign == "±" else (low, high)

    @model_validator(mode="after")
    def _ordered(self) -> "_Between":
        low, high = self.ends()
        if not low <= high:
            raise ValueError(f"the range [{low}, {high}] must rise")
        return self


class Uniform(_Between):
    """Uniform between two ends; with ``sign = "±"`` either sign, equally likely."""

    uniform: tuple[float, float]

    def ends(self) -> tuple[float, float]:
        """Least and greatest magnitude."""
        return self.uniform


class LogUniform(_Between):
    """Uniform in the logarithm, between two positive ends."""

    log_uniform: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]]

    def ends(self) -> tuple[float, float]:
        """Least and greatest magnitude."""
        return self.log_uniform


class Choice(_Frozen):
    """One of a list, equally likely."""

    choice: Annotated[tuple[float, ...], Field(min_length=1)]

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value that can be drawn."""
        return min(self.choice), max(self.choice)


_KINDS = {"uniform": "Uniform", "log_uniform": "LogUniform", "choice": "Choice"}


def _plain(value: object) -> object:
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
    if isinstance(value, dict):
        return next(kind for key, kind in _KINDS.items() if key in value)
    return type(value).__name__ if isinstance(value, _Frozen) else "float"


Number = Annotated[
    Annotated[float, Tag("float")]
    | Annotated[Uniform, Tag("Uniform")]
    | Annotated[LogUniform, Tag("LogUniform")]
    | Annotated[Choice, Tag("Choice")],
    Discriminator(_kind),
    BeforeValidator(_plain),
]
"""A fixed number or a distribution."""


def bounds(number: Number) -> tuple[float, float]:
    """Least and greatest value of a number or distribution."""
    return (number, number) if isinstance(number, int | float) else number.bounds


def fraction(seeds: np.ndarray, label: str) -> np.ndarray:
    """Uniform numbers in [0, 1), one per seed, that belong to ``label``."""
    salt = int.from_bytes(hashlib.blake2b(label.encode(), digest_size=8).digest(), "little")
    return (mix(seeds, np.uint64(salt)) >> np.uint64(11)).astype(np.float64) / 2.0**53


def draw(number: Number, seeds: np.ndarray, label: str) -> np.ndarray:
    """One value per seed, shape (len(seeds),), for the number called ``label``."""
    if isinstance(number, int | float):
        return np.full(len(seeds), float(number))
    u = fraction(seeds, label)
    if isinstance(number, Choice):
        return np.asarray(number.choice)[(u * len(number.choice)).astype(int)]
    low, high = number.ends()
    if isinstance(number, LogUniform):
        value = low * (high / low) ** u
    else:
        value = low + u * (high - low)
    if number.sign == "±":
        value = np.where(fraction(seeds, label + ".sign") < 0.5, value, -value)
    return value
