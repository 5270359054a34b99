"""Which faults there are, and how they are drawn.

Fault ``i`` of a scenario is a function of the campaign's seed, the scenario's name and ``i`` alone: every controller
gets the same faults on the same sheets, and one of them can be run again by its number.
"""

import zlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ....envs import scenarios
from ....envs.plant.controller import PERIOD
from .inject import DELAYED, DROPOUT, FROZEN, IMPULSE, KINDS, RING, SATURATED, SCALED, SHOWER, SPIKES, STUCK, Fault

EARLIEST, LATEST = 500, 1900
"""Periods between which a fault begins: episodes last 3000, a law has settled, and a second is left afterwards."""

LONGEST = 20
"""Periods that a fault lasts at most; a shower of impulses lasts up to SHOWERS."""

SHOWERS = (100, 500)

TIMES = 10.0
"""Impulses of a fault are this much higher, those of a shower this much more frequent than those of ``impulses``."""

SIZES = tuple(10.0**k for k in range(2, 10))
"""mm/s, spikes of the command."""

ODD = (np.nan, np.inf, -np.inf)

LONGEST_IMPULSE = 5
"""Periods; docs/physics.md#disturbances: one sample to a few ms."""


class Drawn(NamedTuple):
    """A fault, and what it happens to."""

    scenario: str
    number: int
    seed: int  # of the scenario
    name: str  # of its class
    fault: Fault


def _length(r: np.random.Generator) -> float:
    return float(r.integers(1, LONGEST + 1))


def _sign(r: np.random.Generator) -> float:
    return float(r.choice((-1.0, 1.0)))


def _spike(r: np.random.Generator, start: float) -> Fault:
    sizes = [sign * size for size in SIZES for sign in (-1.0, 1.0)] + list(ODD)
    return Fault(SPIKES, start, 1.0, float(r.choice(sizes)))


def _pair(r: np.random.Generator, start: float) -> Fault:
    """A spike that a supervisor may pass, and right after it one of any size."""
    first, second = 10.0 ** r.uniform(2.0, 3.0), 10.0 ** r.uniform(2.0, 9.0)
    return Fault(SPIKES, start, 2.0, _sign(r) * first, _sign(r) * second)


def _scaled(factor: float) -> Callable[[np.random.Generator, float], Fault]:
    return lambda r, start: Fault(SCALED, start, _length(r), factor)


def _delayed(r: np.random.Generator, start: float) -> Fault:
    return Fault(DELAYED, start, _length(r), back=float(r.integers(1, min(LONGEST, RING - 1) + 1)))


def _highest(r: np.random.Generator, start: float) -> Fault:
    """The end of the head's table, which no supervisor can tell from a great height, or far beyond it."""
    return Fault(SATURATED, start, _length(r), float(r.choice((1.0, 10.0))), 1.0)


def _lowest(r: np.random.Generator, start: float) -> Fault:
    """The other end of the table, or a few periods in the gate."""
    return Fault(SATURATED, start, _length(r), float(r.choice((1.0, 1e-3))), 0.0)


def _impulse(r: np.random.Generator, start: float) -> Fault:
    height = TIMES * _sign(r) * r.uniform(0.7, 1.3)
    return Fault(IMPULSE, start, float(r.integers(1, LONGEST_IMPULSE + 1)), float(height))


def _shower(r: np.random.Generator, start: float) -> Fault:
    often = scenarios.load("impulses").head.impulses
    assert isinstance(often, int | float)
    length, longest = r.integers(SHOWERS[0], SHOWERS[1] + 1), r.integers(1, LONGEST_IMPULSE + 1)
    return Fault(SHOWER, start, float(length), TIMES * often * PERIOD, float(longest))


CLASSES: dict[str, tuple[str, Callable[[np.random.Generator, float], Fault]]] = {
    "spike": ("the command is ±1e2 … ±1e9 mm/s, NaN or ±inf for one period", _spike),
    "two spikes": ("±1e2 … ±1e3 mm/s for one period, ±1e2 … ±1e9 for the next", _pair),
    "frozen": ("the command stays what it was, 1–20 ms", lambda r, start: Fault(FROZEN, start, _length(r))),
    "delayed": ("commands come 1–20 ms late, for 1–20 ms", _delayed),
    "doubled": ("commands are doubled, 1–20 ms", _scaled(2.0)),
    "sign-flipped": ("commands have the wrong sign, 1–20 ms", _scaled(-1.0)),
    "zeroed": ("commands are 0, 1–20 ms", _scaled(0.0)),
    "dropout": ("the count is 0, as at contact, 1–20 ms", lambda r, start: Fault(DROPOUT, start, _length(r))),
    "stuck count": ("the count stays what it was, 1–20 ms", lambda r, start: Fault(STUCK, start, _length(r))),
    "highest count": ("the count is that of 10 mm, or ten times as high, 1–20 ms", _highest),
    "lowest count": ("the count is that of 0.01 mm, or a thousandth of it, 1–20 ms", _lowest),
    "high impulse": ("an impulse ten times as high as usual, 1–5 ms", _impulse),
    "shower": ("impulses of 1–5 ms, ten times as frequent as in `impulses`, for 100–500 ms", _shower),
}
"""Name: what happens, and how it is drawn: ``draw(generator, start)``."""

_ORDER = ("spike", "spike", *list(CLASSES)[1:], "spike", "two spikes")
"""Classes of faults 0, 1, 2, … over and over; spikes have many sizes, so they are more."""


def drawn(scenario: str, number: int, seed: int = 0) -> Drawn:
    """Fault ``number`` of a scenario; test seeds of the scenario are taken in turn."""
    r = np.random.default_rng([seed, zlib.crc32(scenario.encode()), number])
    name = _ORDER[number % len(_ORDER)]
    test = scenarios.SPLITS["test"]
    start = float(r.integers(EARLIEST, LATEST + 1))
    return Drawn(scenario, number, test[number % len(test)], name, CLASSES[name][1](r, start))


def words(fault: Fault) -> str:
    """A fault in a line."""
    end = "highest" if fault.second > 0.5 else "lowest"
    second = f" then {fault.second:g}" if fault.length > 1 else ""
    told = {
        SPIKES: f"{fault.value:g}{second} mm/s",
        DELAYED: f"by {fault.back:g} ms",
        SCALED: f"× {fault.value:g}",
        SATURATED: f"at {fault.value:g} × the {end} of the table",
        IMPULSE: f"× {fault.value:.1f}",
        SHOWER: f"of {fault.value / PERIOD:g} per second, up to {fault.second:g} ms long,",
    }.get(fault.kind, "")
    return f"{KINDS[int(fault.kind)]} {told}".strip() + f" from {fault.start:g} ms on for {fault.length:g} ms"
