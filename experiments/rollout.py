"""Roll-outs: a controller on many seeds of a scenario, closed-loop at kernel speed, recorded."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..envs import scenarios
from ..envs.plant import heads, machine
from ..envs.plant.controller import INFORMATION
from ..envs.plant.fleet import Fleet
from ..envs.plant.lanes import unflat
from ..envs.plant.quantity import InvalidInput
from ..envs.scenarios import Scenario
from ..envs.stack import Stack

CHUNK = 256
"""Machines that are rolled out and recorded at a time."""


@dataclass(frozen=True)
class Recording:
    """What a roll-out recorded: ``data`` is float32 of shape (periods, channels, machines), see ``machine.CHANNELS``."""

    scenario: Scenario
    stack: Stack
    seeds: np.ndarray
    set_height: np.ndarray
    data: np.ndarray
    collided: np.ndarray
    lowest: np.ndarray

    def __getitem__(self, channel: str) -> np.ndarray:
        """One channel, shape (periods, machines)."""
        return self.data[:, machine.CHANNELS.index(channel)]

    @property
    def scored(self) -> np.ndarray:
        """Which periods count: beam on, over sheet, after the settling time; shape (periods, machines)."""
        mask = self["scored"] > 0.5
        mask[: self.scenario.settle_steps] = False
        return mask

    @property
    def error(self) -> np.ndarray:
        """True gap error, actual − set, mm, shape (periods, machines)."""
        return self["gap"] - self.set_height

    @property
    def reported_error(self) -> np.ndarray:
        """Error of the reported (filtered, measured) height, mm, shape (periods, machines)."""
        return self["height"] - self.set_height


def fleet_for(scenario: Scenario, stack: Stack, seeds: Any, threads: int = 1) -> Fleet:
    """A fleet with one machine per seed, prepared and begun."""
    seeds = np.atleast_1d(np.asarray(seeds, np.uint64))
    fleet = Fleet(len(seeds), stack.law, heads.POOL, threads)
    every = np.arange(len(seeds))
    scenarios.prepare(fleet, scenario, every, seeds)
    stack.install(fleet, every)
    fleet.begin(every, scenarios.noise_keys(seeds))
    return fleet


def roll(scenario: Scenario, stack: Stack, seeds: Any, threads: int = 1) -> Recording:
    """One episode of ``scenario`` per seed under ``stack``."""
    seeds = np.atleast_1d(np.asarray(seeds, np.uint64))
    return run(fleet_for(scenario, stack, seeds, threads), scenario, stack, seeds)


def run(fleet: Fleet, scenario: Scenario, stack: Stack, seeds: np.ndarray) -> Recording:
    """Rolls a fleet that has begun through one episode and records it."""
    record = fleet.start_recording(scenario.steps)
    if stack.python is None:
        fleet.advance(scenario.steps)
    else:
        _run_python(fleet, stack, scenario.steps)
    fleet.stop_recording()
    return Recording(
        scenario, stack, seeds, fleet.column("job.set_height"), record, fleet.column("tally.collided") > 0.5,
        fleet.column("tally.lowest"),
    )  # fmt: skip


def _run_python(fleet: Fleet, stack: Stack, steps: int) -> None:
    """Plain-Python controllers, one per machine, period by period."""
    assert stack.python is not None
    minds = [stack.python() for _ in range(fleet.size)]
    signals = INFORMATION[stack.information]
    views = [fleet.slots(machine.SIGNALS, len(signals._fields), i) for i in range(fleet.size)]
    hands = [fleet.row("hand.residual", i) for i in range(fleet.size)]
    for mind in minds:
        mind.reset()
    for _ in range(steps):
        for mind, view, hand in zip(minds, views, hands, strict=True):
            hand[0] = command_of(mind.control(unflat(signals, view.tolist())), stack.name)
        fleet.advance()


def command_of(answer: Any, name: str) -> float:
    """A plain-Python controller's answer as a number.

    Raises:
        InvalidInput: it is not one finite number.
    """
    try:
        array = np.asarray(answer, float)
    except (TypeError, ValueError):
        raise InvalidInput(f"controller '{name}' returned {answer!r}; control() must return one number, mm/s") from None
    if array.size != 1:
        raise InvalidInput(
            f"controller '{name}' returned an array of shape {array.shape}; control() must return one number, mm/s"
        )
    value = float(array.reshape(-1)[0])
    if not np.isfinite(value):
        raise InvalidInput(f"controller '{name}' returned {value}; control() must return a finite number, mm/s")
    return value


def chunks(seeds: Iterable[int], size: int = CHUNK) -> Iterator[np.ndarray]:
    """The seeds in groups of at most ``size``."""
    array = np.asarray(list(seeds), np.uint64)
    for start in range(0, len(array), size):
        yield array[start : start + size]
