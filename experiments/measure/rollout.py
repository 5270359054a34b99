"""Roll-outs: a controller on many seeds of a scenario, closed-loop at kernel speed, recorded."""

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.control.stack import Stack
from ...envs.engine.lanes import unflat
from ...envs.engine.quantity import InvalidInput
from ...envs.figures.recording import Recording
from ...envs.plant import machine
from ...envs.plant.controller import INFORMATION
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from ...envs.tasks import workshop

CHUNK = 256
"""Machines that are rolled out and recorded at a time."""


def fleet_for(
    scenario: Scenario, stack: Stack, seeds: Any, threads: int = 1, change: Callable[[Fleet], None] | None = None
) -> Fleet:
    """A fleet with one machine per seed, prepared, changed if wanted, and begun."""
    return workshop.fleet_for(scenario, stacks.asked(stack), seeds, threads, change)


def roll(
    scenario: Scenario, stack: Stack, seeds: Any, threads: int = 1, change: Callable[[Fleet], None] | None = None
) -> Recording:
    """One episode of ``scenario`` per seed under ``stack``; ``change`` is made to the machines before they begin."""
    seeds = np.atleast_1d(np.asarray(seeds, np.uint64))
    return run(fleet_for(scenario, stack, seeds, threads, change), scenario, stack, seeds)


def run(
    fleet: Fleet, scenario: Scenario, stack: Stack, seeds: np.ndarray, before: Callable[[int], None] | None = None
) -> Recording:
    """Rolls a fleet that has begun through one episode and records it.

    Args:
        fleet, scenario, stack, seeds: as for :func:`roll`.
        before: is told the number of each control period before it is simulated, and may change the machines.
    """
    record, broken = fleet.start_recording(scenario.steps), np.zeros(fleet.size, bool)
    go = advancing(fleet, stack, scenario.steps, broken)
    if before is None:
        go(scenario.steps)
    else:
        for period in range(scenario.steps):
            before(period)
            go(1)
    fleet.stop_recording()
    record[:, :, broken] = np.nan  # a failed run, whatever the machine did afterwards
    height, collided, lowest = (fleet.column(name) for name in ("job.set_height", "tally.collided", "tally.lowest"))
    return Recording(scenario, seeds, height, record, collided > 0.5, lowest)


def anew(
    fleet: Fleet, scenario: Scenario, stack: Stack, seeds: np.ndarray, before: Callable[[int], None] | None = None
) -> Recording:
    """:func:`run` of a fleet whose machines are prepared and may have had other parameters of the same law."""
    every = np.arange(fleet.size)
    fleet.forget_filters()
    stack.install(fleet, every)
    fleet.begin(every, scenarios.noise_keys(seeds))
    return run(fleet, scenario, stack, seeds, before)


def advancing(fleet: Fleet, stack: Stack, steps: int, broken: np.ndarray | None = None) -> Callable[[int], Any]:
    """A function that advances the fleet by so many periods, ``steps`` in all; see :func:`periods`."""
    if stack.python is None:
        return fleet.advance
    ahead = periods(fleet, stack, steps, broken)
    return lambda count: deque(itertools.islice(ahead, count), maxlen=0)


def periods(fleet: Fleet, stack: Stack, steps: int, broken: np.ndarray | None = None) -> Iterator[int]:
    """Advances a fleet that has begun period by period; a plain-Python controller gets one mind per machine.

    Args:
        fleet, stack: the machines, and what controls them.
        steps: periods.
        broken: bool, one for each machine; set where the controller's answer is not finite, after which it is not asked
            again. Without it such an answer is an error.
    """
    minds = [stack.python() for _ in range(fleet.size)] if stack.python else []
    signals: Any = INFORMATION[stack.information]
    views = [fleet.slots(machine.SIGNALS, len(signals._fields), i) for i in range(len(minds))]
    hands = [fleet.row("hand.residual", i) for i in range(len(minds))]
    for mind in minds:
        mind.reset()
    for step in range(steps):
        for i, (mind, view, hand) in enumerate(zip(minds, views, hands, strict=True)):
            if broken is not None and broken[i]:
                continue
            value = command_of(mind.control(unflat(signals, view.tolist())), stack.name)
            if not math.isfinite(value):
                if broken is None:
                    raise InvalidInput(
                        f"controller '{stack.name}' returned {value}; control() must return a finite number, mm/s"
                    )
                broken[i], value = True, 0.0
            hand[0] = value
        fleet.advance()
        yield step


def command_of(answer: Any, name: str) -> float:
    """A plain-Python controller's answer as a number, finite or not.

    Raises:
        InvalidInput: it is not one number.
    """
    try:
        array = np.asarray(answer, float)
    except (TypeError, ValueError):
        array = None
    if array is None or answer is None:
        raise InvalidInput(f"controller '{name}' returned {answer!r}; control() must return one number, mm/s")
    if array.size != 1:
        raise InvalidInput(
            f"controller '{name}' returned an array of shape {array.shape}; control() must return one number, mm/s"
        )
    return float(array.reshape(-1)[0])


def chunks(seeds: Iterable[int], size: int = CHUNK) -> Iterator[np.ndarray]:
    """The seeds in groups of at most ``size``."""
    array = np.asarray(list(seeds), np.uint64)
    for start in range(0, len(array), size):
        yield array[start : start + size]
