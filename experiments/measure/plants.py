"""Corner plants: the machine that a scenario draws, at the ends of every number that it draws.

A *machine* is the part of a scenario that follows the sheet, :data:`MACHINE`, with a head that is nominal and
undisturbed. Nothing here names a number of the axis or knows how a scenario reaches the plant: each corner is a
scenario with fixed numbers, which :func:`envs.scenarios.prepare` writes as it writes any other. So a number that the
machine gains is there as well.

Every number that is drawn stands at its least and at its greatest value, in all combinations. From the seventh on it
takes them in a fractional design, in which any three numbers still meet in all combinations, so that there are never
more than :data:`MOST` corners. Limits of the drive and friction (:data:`LIMITS`) stay in the middle of their ranges.
"""

import functools
import itertools
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from ...envs.scenarios.distributions import Choice, LogUniform, Uniform, as_number, bounds

MACHINE = ("axis", "head")
"""Tables of a scenario that are the machine; the others are what is cut and how it is travelled."""

QUIET = ("noise", "jitter", "impulse", "burst", "table", "signal", "nominal")
"""First words of what is disturbance or recording in a head; the nominal head has none of it."""

_LIMITS = ("speed", "acceleration", "jerk", "friction", "bristle", "stiction", "stribeck")
LIMITS = tuple(f"axis.{name}" for name in _LIMITS)
"""Numbers that a small signal does not reach, or, of friction, hardly tells."""

FULL = 6
"""Numbers that are drawn of which all combinations are tried."""

MOST = 2**FULL
"""Corner plants, at most."""

_DISTRIBUTIONS = ({"uniform"}, {"log_uniform"}, {"choice"})
_SILENT = {"noise": 0.0, "jitter": 0.0, "impulses": 0.0, "bursts": 0.0, "nominal": True}


@dataclass(frozen=True)
class Machine:
    """A distribution of machines.

    Attributes:
        tables: the machine's part of a scenario, as TOML has it, in JSON.
    """

    tables: str

    @functools.cached_property
    def scenario(self) -> Scenario:
        """Level and undisturbed sheet, nominal and undisturbed head, and the machine as it is drawn."""
        return Scenario(**{"name": "corner", "feed": 0.0, "set_height": 0.8, **json.loads(self.tables)})

    @functools.cached_property
    def drawn(self) -> dict[str, tuple[float, float]]:
        """Least and greatest value of every number that is drawn, by dotted name, without the limits."""
        leaves = _leaves(json.loads(self.tables))
        found = {name: bounds(as_number(value)) for name, value in leaves.items() if isinstance(value, dict)}
        return {name: ends for name, ends in found.items() if name not in LIMITS and ends[0] < ends[1]}

    @functools.cached_property
    def corners(self) -> tuple[dict[str, float], ...]:
        """What each corner plant has in place of the numbers that are drawn, by dotted name."""
        leaves = _leaves(json.loads(self.tables))
        limits = {
            name: float(np.mean(bounds(as_number(leaves[name]))))
            for name in LIMITS
            if isinstance(leaves.get(name), dict)
        }
        levels = design(len(self.drawn))
        return tuple(
            {**limits, **{name: ends[level] for (name, ends), level in zip(self.drawn.items(), row, strict=True)}}
            for row in levels
        )

    @property
    def size(self) -> int:
        """Number of corner plants."""
        return len(self.corners)

    def prepare(self, fleet: Fleet, scenario: Scenario, corner: np.ndarray) -> None:
        """Writes corner plants into all machines of a fleet.

        Args:
            fleet: of any size.
            scenario: what they do there; its machine is not looked at.
            corner: index of each machine's corner plant, shape (machines,).
        """
        for index, values in enumerate(self.corners):
            mine = np.flatnonzero(corner == index)
            if len(mine):
                tables = json.loads(self.tables)
                for name, value in values.items():
                    _put(tables, name, value)
                scenarios.prepare(fleet, scenario.varied(**tables), mine, np.zeros(len(mine)))

    @property
    def label(self) -> str:
        """What differs from the standard machine, in a scenario's own words; ``standard`` if nothing does."""
        mine, usual = (_leaves(json.loads(each.tables)) for each in (self, STANDARD))
        parts = [f"{name} {_words(mine[name])}" for name in mine if mine[name] != usual.get(name)]
        return ", ".join(parts) or "standard"


def of(scenario: Scenario) -> Machine:
    """The machine of a scenario."""
    tables: dict[str, Any] = {name: asdict(getattr(scenario, name)) for name in MACHINE}
    own = {name: value for name, value in tables["head"].items() if not name.startswith(QUIET) and value is not None}
    tables["head"] = {**own, **_SILENT}
    return Machine(json.dumps(tables))


def machines(chosen: Iterable[Scenario]) -> dict[Machine, list[str]]:
    """The different machines of some scenarios, and the names of the scenarios that have them."""
    found: dict[Machine, list[str]] = {}
    for scenario in chosen:
        found.setdefault(of(scenario), []).append(scenario.name)
    return found


STANDARD = of(Scenario(name="standard"))
"""The machine of a scenario that says nothing about it."""


def design(factors: int) -> np.ndarray:
    """Two-level design: 0 or 1 of each factor, shape (runs, factors); full up to :data:`FULL` factors.

    Each further factor is the parity of three or five of the first ones (a fractional factorial design of resolution
    IV, Box and Hunter 1961), which keeps all combinations of any three factors.

    Raises:
        InvalidInput: more factors than there are such parities.
    """
    full = min(factors, FULL)
    base = np.array(list(itertools.product((0, 1), repeat=full)), int).reshape(2**full, full)
    words = [word for size in (3, 5) for word in itertools.combinations(range(FULL), size)]
    if factors - FULL > len(words):
        raise InvalidInput(
            f"the machine draws {factors} numbers; corner plants can be made of at most {FULL + len(words)}"
        )
    more = [base[:, list(word)].sum(axis=1) % 2 for word in words[: max(0, factors - FULL)]]
    return np.column_stack([base, *more])


def _leaves(tables: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Numbers and distributions by dotted name."""
    found: dict[str, Any] = {}
    for name, value in tables.items():
        inner = isinstance(value, dict) and (set(value) - {"sign"}) not in _DISTRIBUTIONS
        found |= _leaves(value, f"{prefix}{name}.") if inner else {prefix + name: value}
    return found


def _put(tables: dict[str, Any], name: str, value: float) -> None:
    *above, last = name.split(".")
    for key in above:
        tables = tables[key]
    tables[last] = value


def _words(value: Any) -> str:
    if not isinstance(value, dict):
        return f"{value:g}" if isinstance(value, int | float) else str(value)
    number = as_number(value)
    if isinstance(number, Choice):
        return " or ".join(f"{each:g}" for each in number.choice)
    assert isinstance(number, Uniform | LogUniform)
    return "{:g} … {:g}".format(*number.bounds)
