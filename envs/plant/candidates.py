"""Many Z axes under one series of commands: what each would do that may be the axis of a log.

The same parts as the machine's kernel, and so the same motion, without sheet, sensor and law. Of each period it keeps
what an encoder without counts would read, and where the nozzle is, both as means over the gate.
"""

from typing import Any, NamedTuple

import numpy as np

from ..engine.columns import Columns
from ..engine.deck import Deck, places
from ..engine.kernels import Kernel, filled
from ..engine.lanes import U0, UW, Layout, U, W, doubles, flat, load, rows, stage, store
from ..engine.lanes import words as words_of
from . import machine, z_axis
from .machine import DT, SUBSTEPS, Course, Moment

_layout = Layout()
P_Z, GAINS = _layout.part("z", z_axis.Params), _layout.place(rows(z_axis.Gains))
MOTION, DRIVE, LATE = (
    _layout.part("motion", z_axis.State),
    _layout.part("drive", z_axis.Drive),
    _layout.part("late", z_axis.Late),
)
PACE, MOMENT, COURSE = (_layout.place(rows(cls)) for cls in (z_axis.Pace, Moment, Course))
ROWS = _layout.rows
STRIDE = U(ROWS * W)
_ANY, _TWO, _FIVE = U(2**40), U(2 * W), U(5)


class Entries(NamedTuple):
    """The kernel's deck; arrays are float64."""

    block: int  # (blocks, ROWS, W)
    blocks: int
    commands: int  # (periods,), mm/s
    periods: int
    made: int  # (blocks, periods, 2, W), mm: motor and nozzle


D = places(Entries)
_DECK = U(len(Entries._fields))


@stage
def _send(block, at, command):
    """A command enters all drives; the substeps' pace follows from it."""
    for lane in range(UW):
        a = at + lane
        p, drive = load(z_axis.Params, block, a + P_Z), load(z_axis.Drive, block, a + DRIVE)
        late = z_axis.passed_on(load(z_axis.Late, block, a + LATE), drive.c6)
        drive = z_axis.accept(p, drive, command)
        store(block, a + DRIVE, drive)
        store(block, a + LATE, late)
        store(block, a + PACE, z_axis.late_pace(p, drive, late))
        store(block, a + MOMENT, Moment(0.0, 0.0, 0.0, 0.0, 1e9))


_move = stage(filled(
    machine.move_all, "candidates", P_Z=P_Z, GAINS=GAINS, PACE=PACE, COURSE=COURSE, S_Z=MOTION, MOMENT=MOMENT,
))  # fmt: skip
"""The machine's own stage of five substeps, where these rows are. Over a sheet at 0, the gap is the nozzle's place."""


@stage
def _keep(block, at, made, where):
    """What a period has made."""
    for lane in range(UW):
        m = load(Moment, block, at + lane + MOMENT)
        made[where + lane] = m.gate_motor
        made[where + lane + UW] = m.gate_gap


def _follow(address):
    """All periods of all axes."""
    deck = words_of(address, _DECK)
    block, commands, made = doubles(deck[D.block], _ANY), doubles(deck[D.commands], _ANY), doubles(deck[D.made], _ANY)
    for b in range(deck[D.blocks]):
        at = b * STRIDE
        for t in range(deck[D.periods]):
            _send(block, at, commands[t])
            for k in range(U0, U(SUBSTEPS), _FIVE):
                _move(block, at, UW, k, True)
            _keep(block, at, made, (b * deck[D.periods] + t) * _TWO)


follow = Kernel(_follow)


def courses(axes: list[z_axis.Params], commands: np.ndarray, start: float, gate: float = 0.25) -> np.ndarray:
    """What the axes do from rest at ``start``, mm, under ``commands``, mm/s.

    Args:
        axes: their parameters.
        commands: one each control period, as they were given to the drives, shape (periods,).
        start: mm.
        gate: ms at the end of a period over which is averaged, as the sensor's gate does.

    Returns:
        mm, shape (axes, periods, 2): motor, and nozzle.
    """
    columns = _Candidates(len(axes), ROWS, _layout.parts)
    every: Any = np.arange(columns.blocks * W)
    counted = max(1.0, np.rint(gate * SUBSTEPS))
    columns.lay(COURSE, every, Course(opens=1.0 - counted / SUBSTEPS + 1e-9, weight=1.0 / counted))
    columns.lay(MOTION, every, z_axis.at_rest(start))
    for i in range(columns.blocks * W):
        p = axes[min(i, len(axes) - 1)]
        columns.lay(P_Z, i, p)
        columns.lay(GAINS, i, z_axis.gains(p, DT))
    given = np.ascontiguousarray(commands, float)
    made = np.empty((columns.blocks, len(given), 2, W))
    deck = Deck(Entries, block=columns.block, blocks=columns.blocks, commands=given, periods=len(given), made=made)
    follow(deck)
    found: Any = made.transpose(0, 3, 1, 2).reshape(-1, len(given), 2)[: len(axes)]
    return np.asarray(found)


class _Candidates(Columns):
    """Columns that are filled to the last lane, so that idle lanes compute nothing odd."""

    @property
    def block(self) -> np.ndarray:
        """All numbers."""
        return self._block

    def lay(self, place: Any, machines: Any, part_of: tuple) -> None:
        """Writes a part by its offset."""
        self._put_rows(int(place) // W, machines, flat(part_of))
