"""The pool of calibrated heads: capacitive heads that differ a little, each with the table of its own calibration run.

Machines that carry the same head share its table, so a machine needs no memory for one. A head is calibrated, on the
machine, when it is first used.
"""

import functools
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from ..engine.lanes import mix
from ..engine.quantity import InvalidInput
from . import calibration, idle, sensor, supervisor
from .controller import make_law
from .fleet import Fleet

HEADS = 16
"""Heads of each oscillator preset in the pool; the first of each is the nominal one."""

OSCILLATORS = tuple(sensor.PRESETS)
"""Oscillator presets in the order of their heads: the first ``HEADS`` heads are those of the first, and so on."""

MEASURED = 16
"""Places for tables that users bring."""

FAMILIES = 512
"""Kinds of heads of users' own that a process may know, of :data:`HEADS` heads each; a kind takes memory when it is
first used."""

_EXACT = HEADS * len(OSCILLATORS) + MEASURED
_OWN = _EXACT + HEADS * len(OSCILLATORS)
_EXACT_OWN = _OWN + HEADS * FAMILIES

POOL = calibration.Pool(_OWN, 2 * HEADS * FAMILIES)
"""Tables of the heads that have been calibrated so far, those that users brought, and exact ones."""

_families: list[tuple[sensor.Params, ...]] = []
_indices: dict[tuple[sensor.Params, ...], int] = {}

LONGEST_RUN = 2500
"""Control periods after which a calibration run is given up."""


@functools.cache
def head(index: int) -> sensor.Params:
    """Head ``index``: body capacitance ±5 %, inductance ±2 %, nozzle radius ±2 % of nominal [A]; or of a family."""
    if index >= _OWN:
        which, number = divmod(index - _OWN, HEADS)
        return _families[which][number]
    preset, number = divmod(index, HEADS)
    nominal = sensor.PRESETS[OSCILLATORS[preset]]
    if number == 0:
        return nominal
    draw = np.random.default_rng(number).uniform(-1.0, 1.0, 3)
    return nominal._replace(
        body=nominal.body * (1 + 0.05 * draw[0]),
        inductance=nominal.inductance * (1 + 0.02 * draw[1]),
        radius=nominal.radius * (1 + 0.02 * draw[2]),
    )


def family(members: tuple[sensor.Params, ...]) -> int:
    """Index of the first of :data:`HEADS` heads of a user's own; their others follow it.

    Raises:
        InvalidInput: there are too many kinds of heads.
    """
    if members not in _indices:
        if len(_families) == FAMILIES:
            raise InvalidInput(f"more than {FAMILIES} kinds of heads that say nozzle or oscillator in one process")
        _indices[members] = first = _OWN + HEADS * len(_families)
        _families.append(members)
        POOL.open(first, HEADS)
    return _indices[members]


FIELDS = ("body", "inductance", "series", "radius", "bore")
"""What differs from head to head and preset to preset; the rest of :class:`sensor.Params` are disturbances."""


def fields(indices: np.ndarray) -> np.ndarray:
    """:data:`FIELDS` of the heads with these indices, shape (fields, n)."""
    different, which = np.unique(indices, return_inverse=True)
    return np.array([[getattr(head(int(i)), name) for i in different] for name in FIELDS])[:, which]


@functools.lru_cache(maxsize=1)
def _known(families: int) -> dict[tuple[float, ...], int]:
    """The first head with each set of :data:`FIELDS`."""
    indices = (*range(HEADS * len(OSCILLATORS)), *range(_OWN, _OWN + HEADS * families))
    return {tuple(getattr(head(i), name) for name in FIELDS): i for i in reversed(indices)}


def run(params: sensor.Params, seed: int = 0, gate: sensor.Gate | None = None) -> tuple[np.ndarray, np.ndarray]:
    """A calibration run on the machine: touch the sheet, rise to 10 mm at 10 mm/s (Xi2023).

    Returns:
        Counted frequency (Hz) and encoder height above the contact at the centre of the gate (mm), one per ms.
    """
    fleet = Fleet(1, make_law(idle, "idle"), calibration.Pool(1))
    fleet.put("sensor", 0, params)
    fleet.put("gate", 0, gate or sensor.Gate())
    fleet.set("path.feed", 0, 0.0)
    fleet.set("start.gap", 0, 0.2)
    fleet.set("job.request", 0, supervisor.CALIBRATE)
    fleet.begin(0, mix(seed, 1))
    return samples_of(fleet, fleet.stepper())


def samples_of(fleet: Fleet, advance: Callable[[], Any], longest: int = LONGEST_RUN) -> tuple[np.ndarray, np.ndarray]:
    """What the first machine of a fleet, asked to calibrate, counts on its way up; see :func:`run`.

    Args:
        fleet: whose job's request is ``calibrate``.
        advance: one control period.
        longest: control periods after which the run is given up.
    """
    phase, frequency, position = (
        fleet.row("supervisor.phase"),
        fleet.row("signals.frequency"),
        fleet.row("signals.head_position"),
    )
    mode, samples = fleet.row("supervisor.mode"), []
    for _ in range(longest):
        advance()
        if phase[0] == 2.0 or mode[0] == supervisor.ALARM:
            break
        if phase[0] == 1.0 and mode[0] == supervisor.CALIBRATE:
            samples.append((frequency[0], position[0]))
    zero = fleet.column("supervisor.zero")[0]
    taken = np.asarray(samples).reshape(-1, 2)
    return taken[:, 0], taken[:, 1] - zero


def calibrate(params: sensor.Params, seed: int = 0, gate: sensor.Gate | None = None) -> calibration.Table:
    """Runs a calibration and makes the table.

    Raises:
        CalibrationRefused: the run is not fit to use; the message gives the reason.
    """
    frequency, height = run(params, seed, gate)
    return calibration.build(frequency, height, params.radius)


def table(index: int) -> calibration.Table:
    """The table of head ``index``, calibrated now if it has not been yet."""
    if index not in POOL:
        POOL[index] = calibrate(head(index), seed=index)
    return POOL[index]


def carried(params: np.ndarray) -> np.ndarray:
    """Indices of the heads with these :data:`FIELDS`, shape (fields, n); 0 for those that are in no pool."""
    known = _known(len(_families))
    return np.array([known.get(tuple(one), 0) for one in params.T.tolist()], dtype=int)


def exact(index: int) -> int:
    """Index of the table that head ``index`` would have, if its calibration made no error."""
    place = _EXACT_OWN + index - _OWN if index >= _OWN else _EXACT + index
    if place not in POOL:
        params, height = head(index), np.arange(1, calibration.POINTS + 1) * (calibration.SPAN / calibration.POINTS)
        frequency = [sensor.oscillator(params, sensor.capacitance(params, h, 1.0), 0.0) for h in height]
        POOL[place] = calibration.Table(np.asarray(frequency), height, 0, 0, 0.0, "-")
    return place


def beyond(indices: np.ndarray) -> np.ndarray:
    """Hz above which each of these calibrated heads must have lost its sensor: 5 % over its table's end, where the
    body capacitance leaves less than 1 % [C]; a cable that is off takes that with it."""
    tops: np.ndarray = POOL.frequencies[(np.asarray(indices) + 1) * calibration.POINTS - 1]
    return 1.05 * tops


@functools.cache
def measured(path: str) -> int:
    """Index of the table in a CSV file.

    Raises:
        InvalidInput: the file cannot be read, or there are too many.
    """
    index = HEADS * len(OSCILLATORS) + measured.cache_info().currsize
    if index >= HEADS * len(OSCILLATORS) + MEASURED:
        raise InvalidInput(f"{path}: more than {MEASURED} measured calibration tables in one process")
    POOL[index] = calibration.read_csv(path)
    return index


def ensure(indices: Iterable[int]) -> calibration.Pool:
    """The pool, with these heads calibrated."""
    for index in indices:
        table(int(index))
    return POOL
