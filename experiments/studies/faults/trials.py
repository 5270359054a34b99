"""Runs of machines with faults: the same episodes again and again, with other parts taken out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....envs.control.stack import Stack
from ....envs.plant import supervisor
from ....envs.plant.fleet import Fleet
from ....envs.scenarios import Scenario
from ...measure import rollout
from .drawn import Drawn
from .inject import Fault, Faults, Without, check

FAULTLESS = "faultless"

REPEATS: dict[str, Without | None] = {
    FAULTLESS: None,
    "shipped": Without(),
    "no supervisor": Without(supervisor=1.0),
    "no filter": Without(filter=1.0),
    "neither": Without(supervisor=1.0, filter=1.0),
    "forgetful": Without(supervisor=1.0, filter=1.0, memory=1.0),
}
"""How each run is repeated, and what is taken out; without a fault nothing is."""

ALWAYS = (FAULTLESS, "shipped", "no supervisor")
"""Repetitions of every run; the others are those of runs that end badly."""

_CHUNK = 128


@dataclass(frozen=True)
class Repeat:
    """What came of some faults in one way; arrays of shape (faults,).

    Attributes:
        lost: the nozzle touched the sheet, or the machine's state is no number any more.
        broken: the latter.
        lowest: mm, smallest true gap.
        apart: mm, largest distance of the true gap from that of the faultless run, from the fault on; infinite for a
            broken run.
        alarm: the supervisor's alarm at the end, see ``supervisor.ALARMS``.
    """

    lost: np.ndarray
    broken: np.ndarray
    lowest: np.ndarray
    apart: np.ndarray
    alarm: np.ndarray


def repeats(
    scenario: Scenario, stack: Stack, given: Sequence[Drawn], names: Sequence[str] = ALWAYS, threads: int = 1
) -> dict[str, Repeat]:
    """The faults of a scenario under ``stack``, repeated in some ways of :data:`REPEATS`.

    Raises:
        InvalidInput: faults cannot be put into the stack's command.
    """
    check(stack)
    found: dict[str, list[Repeat]] = {name: [] for name in names}
    for first in range(0, len(given), _CHUNK):
        some = given[first : first + _CHUNK]
        plain, faultless = _run(scenario, stack, some, None, None, threads)
        for name in names:
            without = REPEATS[name]
            ran = faultless if without is None else _run(scenario, stack, some, without, plain, threads)[1]
            found[name].append(ran)
    return {
        name: Repeat(*(np.concatenate([getattr(p, f) for p in parts]) for f in Repeat.__dataclass_fields__))
        for name, parts in found.items()
    }


def fleet_for(
    scenario: Scenario, stack: Stack, given: Sequence[Drawn], without: Without | None, threads: int = 1
) -> Fleet:
    """A fleet that has begun, one machine a fault; without ``without`` nothing happens to it."""
    faults = Faults(len(given))
    for i, each in enumerate(given):
        faults.put("fault", [i], each.fault if without else Fault())
        faults.put("without", [i], without or Without())
    return rollout.fleet_for(scenario, stack, [each.seed for each in given], threads, faults.install)


def _run(
    scenario: Scenario,
    stack: Stack,
    given: Sequence[Drawn],
    without: Without | None,
    plain: np.ndarray | None,
    threads: int,
) -> tuple[np.ndarray, Repeat]:
    """True gaps, mm, shape (periods, faults), and what came of it."""
    fleet = fleet_for(scenario, stack, given, without, threads)
    record = fleet.start_recording(scenario.steps)
    fleet.advance(scenario.steps)
    gap = record[:, 0].astype(np.float64)
    broken = ~np.isfinite(record).all(axis=(0, 1))
    fleet.stop_recording()
    since = np.arange(1, scenario.steps + 1)[:, None] >= [each.fault.start for each in given]
    apart = np.zeros(len(given)) if plain is None else np.where(since, np.abs(gap - plain), 0.0).max(axis=0)
    collided, lowest = (fleet.column(f"tally.{name}") for name in ("collided", "lowest"))
    apart = np.where(broken | ~np.isfinite(apart), np.inf, apart)
    return gap, Repeat(lost=(collided > 0.5) | broken, broken=broken, lowest=lowest, apart=apart, alarm=_alarms(fleet))


def _alarms(fleet: Fleet) -> np.ndarray:
    alarmed = fleet.column("supervisor.mode") == supervisor.ALARM
    return np.where(alarmed, fleet.column("supervisor.alarm"), supervisor.NO_ALARM)
