"""Corner plants: the machine that a scenario draws, at the ends of every number that it draws.

A *machine* is the part of a scenario that follows the sheet, :data:`MACHINE`, with a head that is nominal and
undisturbed. Nothing here names a number of the axis or knows how a scenario reaches the plant: each corner is a
scenario with fixed numbers, which :func:`envs.scenarios.prepare` writes as it writes any other. So a number that the
machine gains is there as well.

Every number that is drawn stands at its least and at its greatest value, in all combinations. From the seventh on it
takes them in a fractional design, in which any three numbers still meet in all combinations, so that there are never
more than :data:`MOST` corners. Limits of the drive and friction (:data:`LIMITS`) stay in the middle of their ranges.

Numbers of a ``joint`` are known together alone: their ends may belong to different machines, and the corner between
them to none. Of such a table each row is tried that holds the least or the greatest value of one of its numbers, as it
is, with the limits that it has.
"""

import functools
import itertools
import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from ...envs.scenarios.distributions import Choice, Joint, Number, as_number, bounds

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

_SEED = 0
"""Of the order in which factors meet that are too many to be tried in all combinations."""

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
    def _numbers(self) -> dict[str, Number]:
        """Every number that is drawn, by dotted name."""
        leaves = _leaves(json.loads(self.tables))
        return {name: as_number(value) for name, value in leaves.items() if isinstance(value, dict)}

    @functools.cached_property
    def drawn(self) -> dict[str, tuple[float, float]]:
        """Least and greatest value of every number that is drawn by itself, by dotted name, without the limits."""
        alone = {name: bounds(number) for name, number in self._numbers.items() if not isinstance(number, Joint)}
        return {name: ends for name, ends in alone.items() if name not in LIMITS and ends[0] < ends[1]}

    @functools.cached_property
    def together(self) -> dict[str, list[dict[str, float]]]:
        """Of the numbers that are drawn together, the rows with the ends of one of them, by the word of their joint."""
        tables: dict[str, dict[str, tuple[float, ...]]] = {}
        for name, number in self._numbers.items():
            if isinstance(number, Joint):
                tables.setdefault(number.joint, {})[name] = number.choice
        found = {}
        for word, columns in tables.items():
            telling = [np.array(values) for name, values in columns.items() if name not in LIMITS and np.ptp(values)]
            rows = [int(at) for values in telling for at in (values.argmin(), values.argmax())] or [0]
            found[word] = [{name: values[at] for name, values in columns.items()} for at in dict.fromkeys(rows)]
        return found

    @functools.cached_property
    def corners(self) -> tuple[dict[str, float], ...]:
        """What each corner plant has in place of the numbers that are drawn, by dotted name."""
        limits = {
            name: float(np.mean(bounds(number)))
            for name, number in self._numbers.items()
            if name in LIMITS and not isinstance(number, Joint)
        }
        alone = [
            {**limits, **{name: ends[level] for (name, ends), level in zip(self.drawn.items(), row, strict=True)}}
            for row in design(len(self.drawn))
        ]
        return tuple(functools.reduce(dict.__or__, each, {}) for each in crossed([alone, *self.together.values()]))

    @property
    def varies(self) -> bool:
        """Whether two machines of it may differ."""
        return any(low < high for low, high in map(bounds, self._numbers.values()))

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


@dataclass(frozen=True)
class Drawn:
    """Machines of a distribution as some seeds draw them, in place of its corner plants.

    Attributes:
        machine: the distribution.
        seeds: of the machines; one whose numbers are all fixed has a single one.
    """

    machine: Machine
    seeds: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of machines."""
        return len(self.seeds)

    def prepare(self, fleet: Fleet, scenario: Scenario, machine: np.ndarray) -> None:
        """See :meth:`Machine.prepare`."""
        seeds = np.array(self.seeds, np.uint64)[machine]
        tables = json.loads(self.machine.tables)
        scenarios.prepare(fleet, scenario.varied(**tables), np.arange(len(machine)), seeds)


def drawn(machine: Machine, seeds: Iterable[int]) -> Drawn:
    """The machines that these seeds draw; one, where nothing is drawn."""
    found = tuple(int(seed) for seed in seeds)
    return Drawn(machine, found if machine.varies else found[:1])


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


def crossed(factors: list[list[Any]]) -> list[tuple[Any, ...]]:
    """A level of each factor together: all combinations, or, if they are more than :data:`MOST`, so many in which each
    factor has each of its levels as often as any other, give or take one, in an order of its own.

    Raises:
        InvalidInput: a factor has more levels than that.
    """
    if math.prod(map(len, factors)) <= MOST:
        return list(itertools.product(*factors))
    if (most := max(map(len, factors))) > MOST:
        raise InvalidInput(f"numbers of one joint have {most} rows with ends; corner plants can be made of {MOST}")
    random = np.random.default_rng(_SEED)
    orders = [random.permutation(np.arange(MOST) % len(levels)) for levels in factors]
    return [tuple(levels[at] for levels, at in zip(factors, row, strict=True)) for row in zip(*orders, strict=True)]


def _leaves(tables: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Numbers and distributions by dotted name."""
    found: dict[str, Any] = {}
    for name, value in tables.items():
        inner = isinstance(value, dict) and (set(value) - {"sign", "joint"}) not in _DISTRIBUTIONS
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
    if isinstance(number, Choice) and not isinstance(number, Joint):
        return " or ".join(f"{each:g}" for each in number.choice)
    return "{:g} … {:g}".format(*bounds(number))
