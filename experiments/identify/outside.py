"""A controller on a machine that is not kerfgym's: hardware in the loop, or another simulator.

Each millisecond it is given the frequency that the sensor counted and the reading of the encoder, and says the command
for the next::

    controller = Outside("xi2023-improved", table="mine.table.csv", set_height=1.0)
    command = controller.begin(frequency, encoder)
    while True:
        command = controller.step(*your_machine(command))

Filter, table, law and supervisor are those of the simulated machine, stage by stage, so that what is compared is the
machine alone.
"""

from pathlib import Path
from typing import Any

import numpy as np

from ...envs.control.stack import Stack, resolve
from ...envs.engine.kernels import Kernel
from ...envs.engine.lanes import U0, U1, UW, U, call, doubles, load, store, unflat, words
from ...envs.engine.quantity import InvalidInput
from ...envs.plant import machine
from ...envs.plant.controller import INFORMATION
from ...envs.plant.machine import D, Moment
from ...envs.scenarios import Scenario, machines
from ..measure import rollout

_READINGS = U(2)
_FREQUENCY = machine.signal("frequency")


def _hear(deck_address, readings_address):
    """The second half of a period of the only machine, whose frequency and encoder are given."""
    deck, readings = words(deck_address, machine.DECK), doubles(readings_address, _READINGS)
    block, tick = doubles(deck[D.block], machine.STRIDE), deck[D.tick]
    machine.travel_all(block, U0, U1, tick, deck)
    store(block, machine.MOMENT, load(Moment, block, machine.MOMENT)._replace(gate_motor=readings[1]))
    f = readings[0]
    now = machine.SAMPLES + (tick & machine.SAMPLES_LAST) * UW
    last = machine.SAMPLES + ((tick - U1) & machine.SAMPLES_LAST) * UW
    block[_FREQUENCY] = f
    block[now] = f if f > 0.0 else block[last]
    machine.filter_all(block, U0, U1, tick, deck[D.window], deck[D.flags] & machine.F_RANKS)
    if deck[D.filtered] > U0:
        call(deck[D.filtered], deck[D.block], U0, U1, deck[D.filtered_io], tick)
    machine.look_up_all(block, U0, U1, tick, deck)
    machine.report_all(block, U0, U1, tick)
    call(deck[D.law], deck[D.block], U0, U1, deck[D.law_tables], deck[D.law_size])
    deck[D.tick] += U1


def _say(deck_address):
    """The first half of the next: the supervisor makes a command of the law's wish."""
    deck = words(deck_address, machine.DECK)
    machine.supervise_all(doubles(deck[D.block], machine.STRIDE), U0, U1, deck[D.tick])


_hearing = Kernel(_hear)
_saying = Kernel(_say)


class Outside:
    """A controller, period by period.

    Args:
        controller: its name, or a stack.
        machine: what of the machine its settings need, such as the limits of its travel.
        table: calibration of the head, a CSV file with ``frequency_Hz`` and ``height_mm``; None: that of ``machine``.
        set_height: mm.
        feed: mm/s, along the path.
        seed: draws ``machine``, if it has distributions.

    Raises:
        InvalidInput: the controller is not known, or a number is out of range.
    """

    def __init__(
        self,
        controller: str | Stack,
        machine: Any = "standard",
        table: str | Path | None = None,
        set_height: float = 1.0,
        feed: float = 200.0,
        seed: int = 0,
    ) -> None:
        self._stack = resolve(controller) if isinstance(controller, str) else controller
        cuts = machines.load(machine)
        if table is not None:
            cuts = machines.of_tables({**cuts.tables, "head": {**cuts.tables["head"], "table": str(table)}}, "machine")
        flat = Scenario(name="outside", duration=200.0, settle=0.0, feed=feed, set_height=set_height)
        self._scenario, self._seed = machines.put_on(flat, cuts), seed
        self._readings = np.zeros(2)
        self._begun = False

    def begin(self, frequency: float, encoder: float) -> float:
        """The head stands still: the first command, mm/s, from the frequency, Hz, and the encoder, mm."""
        first = np.array([self._checked(frequency, encoder)[0]])

        def change(fleet: Any) -> None:
            fleet.replay(first)
            fleet.set("start.gap", 0, encoder)
            fleet.set("z.encoder", 0, 0.0)  # what is given has been counted

        self._fleet = rollout.fleet_for(self._scenario, self._stack, [self._seed], change=change)
        self._fleet.replay(None)
        self._mind = self._stack.python() if self._stack.python else None
        if self._mind is not None:
            self._mind.reset()
        self._begun = True
        return self._said()

    def step(self, frequency: float, encoder: float) -> float:
        """The next command, mm/s, from the frequency, Hz (0: none that is valid), and the encoder, mm, of a period."""
        if not self._begun:
            raise InvalidInput("begin() comes before step()")
        self._readings[:] = self._checked(frequency, encoder)
        _hearing(self._fleet.deck, self._readings)
        return self._said()

    def signal(self, name: str) -> float:
        """What the controller has made of the readings, such as its ``height``, mm."""
        return float(self._fleet.column(f"signals.{name}")[0])

    def _said(self) -> float:
        if self._mind is not None:
            kind: Any = INFORMATION[self._stack.information]
            seen = unflat(kind, self._fleet.slots(machine.SIGNALS, len(kind._fields), 0).tolist())
            self._fleet.row("hand.residual", 0)[0] = rollout.command_of(self._mind.control(seen), self._stack.name)
        _saying(self._fleet.deck)
        return float(self._fleet.column("supervisor.command")[0])

    @staticmethod
    def _checked(frequency: float, encoder: float) -> tuple[float, float]:
        if not (np.isfinite(frequency) and frequency >= 0.0 and np.isfinite(encoder)):
            raise InvalidInput(f"frequency = {frequency} Hz, encoder = {encoder} mm; both must be finite numbers")
        return float(frequency), float(encoder)
