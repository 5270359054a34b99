"""Drive and loop alone, with gradients: where the head goes under a law, and what the law should have done instead.

The sheet as the machine sees it (encoder − reading), noise, and what a law makes of them do not depend on the control.
Once they are recorded, what is left of a control period is::

    law → D/A, dead time → 20 × [Z axis] → encoder

This module runs that, for any number of machines and periods, with the parts of :mod:`machine`, and so with the same
bits; and it runs backwards: from the derivative of any number L by the gaps, commands and positions it finds that by
all that the law was given, by its parameters, by the state at the start, and by the axis. ``docs/gradients.md`` has the
equations and an example.

A *law* here is a namespace with ``Params``, ``State`` and ``Recorded`` (NamedTuples), and a part
``weigh(params, state, seen, recorded) -> (state, command)``, with ``seen`` a :class:`Seen`. It depends on the control
only by ``seen`` and ``state``; ``recorded`` holds that period's given numbers.
"""

import functools
import types
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..engine.adjoint import Fixed, adjoint
from ..engine.columns import aligned
from ..engine.deck import Deck, places
from ..engine.kernels import Kernel
from ..engine.lanes import (
    U0,
    U1,
    U2,
    U3,
    UW,
    Layout,
    U,
    W,
    doubles,
    is_part,
    kinds,
    load,
    part,
    rows,
    stage,
    store,
    take,
    words,
)
from ..engine.quantity import InvalidInput
from ..engine.workers import workers
from . import machine, sensor, weighed, z_axis
from .controller import PERIOD, source_of
from .machine import DT, SUBSTEPS, Course, Moment


class Sent(NamedTuple):
    """The law's last commands, mm/s, newest first."""

    u1: float = 0.0
    u2: float = 0.0
    u3: float = 0.0
    u4: float = 0.0
    u5: float = 0.0
    u6: float = 0.0
    u7: float = 0.0


class Seen(NamedTuple):
    """What a law sees of what it has done."""

    head_position: float = 0.0  # mm, encoder at the gate's centre
    head_velocity: float = 0.0  # mm/s, from the encoder over the last period
    sent: Sent = Sent()


class Motion(NamedTuple):
    """State of drive and loop between two periods, without the law's."""

    axis: z_axis.State = z_axis.State()
    drive: z_axis.Drive = z_axis.Drive()
    seen: Seen = Seen()


class Gate(NamedTuple):
    """When the sensor counts, see :class:`machine.Course`."""

    opens: float = 0.75
    weight: float = 0.2


class Surface(NamedTuple):
    """The sheet's course in a period, mm, see :class:`machine.Course`."""

    surface: float = 0.0
    slope: float = 0.0
    bend: float = 0.0


class Outputs(NamedTuple):
    """What comes out of a period."""

    gap: float = 0.0  # mm, true, at its end
    command: float = 0.0  # mm/s, the law's
    position: float = 0.0  # mm, encoder at the gate's centre


class Motor(NamedTuple):
    """What a period adds up."""

    position: float = 0.0  # mm, mean over the gate


# ----------------------------------------------------------------------------------------------- parts of a period


@part
def decide(axis, law, state, seen, recorded, drive):
    """The law's command enters the drive."""
    state, u = _weigh(law, state, seen, recorded)
    drive = z_axis.accept(axis, drive, u)
    old = seen.sent
    sent = Sent(u, old.u1, old.u2, old.u3, old.u4, old.u5, old.u6)
    return state, drive, sent, z_axis.pace(axis, drive), u


@part
def move(axis, gains, pace, gate, sheet, z, motor, first, bristles):
    """Substeps ``first + 1`` … ``first + 5``; returns the axis, the motor's mean over the gate so far, and the gap."""
    course = Course(sheet.surface, sheet.slope, sheet.bend, gate.opens, gate.weight, 1.0, 0.0, False, True)
    m = Moment(0.0, 0.0, 0.0, motor, 0.0)
    z, m = machine.substep(axis, gains, pace, course, z, m, (first + 1.0) / SUBSTEPS, bristles)
    z, m = machine.substep(axis, gains, pace, course, z, m, (first + 2.0) / SUBSTEPS, bristles)
    z, m = machine.substep(axis, gains, pace, course, z, m, (first + 3.0) / SUBSTEPS, bristles)
    z, m = machine.substep(axis, gains, pace, course, z, m, (first + 4.0) / SUBSTEPS, bristles)
    z, m = machine.substep(axis, gains, pace, course, z, m, (first + 5.0) / SUBSTEPS, bristles)
    return z, m.gate_motor, m.gap


@part
def move_far(axis, gains, pace, gate, sheet, z, motor, first, bristles):
    """Ten substeps: what the way back goes through at once."""
    z, motor, _ = move(axis, gains, pace, gate, sheet, z, motor, first, bristles)
    return move(axis, gains, pace, gate, sheet, z, motor, first + 5.0, bristles)


@part
def see(axis, motor, last, sent):
    """What the encoder has counted; ``last``: its position a period ago, mm."""
    position = z_axis.encoded(axis, motor)
    return Seen(position, (position - last) / PERIOD, sent)


# --------------------------------------------------------------------------------------------- stages, and kernels

# Templates: each law has them with globals of its own, see :func:`_kernel`.

_weigh: Any = None
_decide: Any = decide
_decide_back: Any = None
_move_back: Any = None
_see_back: Any = None
_gains_back: Any = None
_sum_axis: Any = None
_sum_gains: Any = None
_sum_law: Any = None
_Law: Any = None
_State: Any = None
_Recorded: Any = None
_P: Any = None  # places of the numbers in a block
_BRISTLES = False
_AXIS = False  # whether adjoints of the axis are asked for
_AT_ONCE = 5
_BACK_AT_ONCE = 10
_ANY = U(2**40)
_GATE = sensor.Gate().length
_LAST = np.float64(SUBSTEPS - _BACK_AT_ONCE)


class Entries(NamedTuple):
    """The deck of a roll-out. Arrays are float64."""

    block: int  # columns of all machines
    machines: int
    steps: int  # control periods
    next: int  # block that the next free thread takes
    surface: int  # array (steps, 3, machines): given
    recorded: int  # array (steps, numbers, machines): given
    outputs: int  # array (steps, 3, machines): results of the way there
    kept: int  # array (blocks, steps, rows, W): of the way there for the way back; 0: nothing is kept
    d_outputs: int  # array (steps, 3, machines): adjoints, given on the way back
    d_recorded: int  # array (steps, numbers, machines): adjoints, results of the way back


D = places(Entries)
_DECK = U(len(D))


class _Places(NamedTuple):
    """Where numbers lie in a block, and how many there are. The adjoint of what lies at x lies at d_x."""

    axis: Any
    gains: Any
    gate: Any
    law: Any
    z: Any
    drive: Any
    seen: Any
    state: Any
    surface: Any
    recorded: Any
    outputs: Any
    motor: Any
    z_first: Any  # what the way back needs of a period: the axis at its start, …
    z_second: Any  # … half-way, …
    pace: Any
    seen_before: Any  # … and what the law was given
    state_before: Any
    d_axis: Any
    d_gains: Any
    d_law: Any
    d_z: Any
    d_drive: Any
    d_seen: Any
    d_state: Any
    d_pace: Any
    d_motor: Any
    d_recorded: Any
    d_outputs: Any
    stride: Any
    kept: Any  # numbers that are kept of a period, from z_first on
    given: Any  # numbers of a record


def fetch(block, there, array, where, count, n, machines):
    """A period's numbers of an array into rows."""
    for i in range(count):
        for lane in range(n):
            block[there + i * UW + lane] = array[where + i * machines + lane]


def put(block, here, array, where, count, n, machines):
    """Rows into a period's numbers of an array."""
    for i in range(count):
        for lane in range(n):
            array[where + i * machines + lane] = block[here + i * UW + lane]


def keep_axis(block, at, n, there):
    """The axis as it is now, for the way back."""
    for lane in range(n):
        store(block, at + lane + there, load(z_axis.State, block, at + lane + _P.z))


def keep_loop(block, at, n):
    """What the law is given in this period, for the way back."""
    for lane in range(n):
        a = at + lane
        store(block, a + _P.seen_before, load(Seen, block, a + _P.seen))
        store(block, a + _P.state_before, load(_State, block, a + _P.state))


def copy(target, there, source, here, count):
    """Numbers in a row: memory is read and written fastest so."""
    for i in range(count):
        target[there + i] = source[here + i]


def prepare_all(block, at, n):
    """Coefficients of the substeps."""
    for lane in range(n):
        a = at + lane
        store(block, a + _P.gains, z_axis.gains(load(z_axis.Params, block, a + _P.axis), DT))


def decide_all(block, at, n):
    """Law and drive: the command of this period is on its way."""
    for lane in range(n):
        a = at + lane
        axis, law = load(z_axis.Params, block, a + _P.axis), load(_Law, block, a + _P.law)
        state, seen = load(_State, block, a + _P.state), load(Seen, block, a + _P.seen)
        recorded, drive = load(_Recorded, block, a + _P.recorded), load(z_axis.Drive, block, a + _P.drive)
        state, drive, sent, pace, u = _decide(axis, law, state, seen, recorded, drive)
        store(block, a + _P.state, state)
        store(block, a + _P.drive, drive)
        store(block, a + _P.pace, pace)
        store(block, a + _P.seen, Seen(seen.head_position, seen.head_velocity, sent))
        block[a + _P.outputs + UW] = u
        block[a + _P.motor] = 0.0


def move_all(block, at, n, k):
    """Substeps ``k`` … ``k + 4`` of the period."""
    first = np.float64(np.int64(k))
    for lane in range(n):
        a = at + lane
        axis, gains = load(z_axis.Params, block, a + _P.axis), load(z_axis.Gains, block, a + _P.gains)
        pace, gate = load(z_axis.Pace, block, a + _P.pace), load(Gate, block, a + _P.gate)
        sheet, z = load(Surface, block, a + _P.surface), load(z_axis.State, block, a + _P.z)
        z, motor, gap = move(axis, gains, pace, gate, sheet, z, block[a + _P.motor], first, _BRISTLES)
        store(block, a + _P.z, z)
        block[a + _P.motor] = motor
        block[a + _P.outputs] = gap


def see_all(block, at, n):
    """The encoder at the end of the period."""
    for lane in range(n):
        a = at + lane
        axis, seen = load(z_axis.Params, block, a + _P.axis), load(Seen, block, a + _P.seen)
        seen = see(axis, block[a + _P.motor], seen.head_position, seen.sent)
        store(block, a + _P.seen, seen)
        block[a + _P.outputs + U2 * UW] = seen.head_position


def forward_block(deck, b):
    """All periods of the machines of block ``b``."""
    machines, steps = deck[D.machines], deck[D.steps]
    block, at, n = doubles(deck[D.block], _ANY), b * _P.stride, min(UW, machines - b * UW)
    surface, recorded = doubles(deck[D.surface], _ANY), doubles(deck[D.recorded], _ANY)
    outputs, kept = doubles(deck[D.outputs], _ANY), doubles(deck[D.kept], _ANY)
    keeps = deck[D.kept] > U0
    prepare_all(block, at, n)
    for t in range(steps):
        fetch(block, at + _P.surface, surface, t * U3 * machines + b * UW, U3, n, machines)
        fetch(block, at + _P.recorded, recorded, t * _P.given * machines + b * UW, _P.given, n, machines)
        if keeps:
            keep_loop(block, at, n)
            keep_axis(block, at, n, _P.z_first)
        decide_all(block, at, n)
        for k in range(0, SUBSTEPS, _AT_ONCE):
            if keeps and k == _BACK_AT_ONCE:
                keep_axis(block, at, n, _P.z_second)
            move_all(block, at, n, k)
        see_all(block, at, n)
        put(block, at + _P.outputs, outputs, t * U3 * machines + b * UW, U3, n, machines)
        if keeps:
            copy(kept, (b * steps + t) * _P.kept, block, at + _P.z_first, _P.kept)


def see_back_all(block, at, n):
    """From what is seen after the period, and from the outputs."""
    for lane in range(n):
        a = at + lane
        axis, d = load(z_axis.Params, block, a + _P.axis), load(Seen, block, a + _P.d_seen)
        d = Seen(d.head_position + block[a + _P.d_outputs + U2 * UW], d.head_velocity, d.sent)
        if _AXIS:
            motor = block[a + _P.outputs + U2 * UW]  # the encoder's count, within its resolution
            more, d_motor, d_last, d_sent = _see_back(axis, motor, 0.0, d.sent, d)
            store(block, a + _P.d_axis, _sum_axis(load(z_axis.Params, block, a + _P.d_axis), more))
        else:
            d_motor, d_last, d_sent = _see_back(axis, 0.0, 0.0, d.sent, d)
        block[a + _P.d_motor] = d_motor
        store(block, a + _P.d_seen, Seen(d_last, 0.0, d_sent))
        store(block, a + _P.d_pace, z_axis.Pace(0.0, 0.0, 0.0))


def move_back_all(block, at, n, k):
    """Back through substeps ``k`` … ``k + 9`` of the period."""
    first, there = np.float64(np.int64(k)), _P.z_second if k == _BACK_AT_ONCE else _P.z_first
    for lane in range(n):
        a = at + lane
        axis, gains = load(z_axis.Params, block, a + _P.axis), load(z_axis.Gains, block, a + _P.gains)
        pace, gate = load(z_axis.Pace, block, a + _P.pace), load(Gate, block, a + _P.gate)
        sheet = Surface(0.0, 0.0, 0.0)  # moves no adjoint
        z = load(z_axis.State, block, a + there)
        d_z, d_motor = load(z_axis.State, block, a + _P.d_z), block[a + _P.d_motor]
        d_gap = block[a + _P.d_outputs] if first == _LAST else 0.0
        d_pace = load(z_axis.Pace, block, a + _P.d_pace)
        if _AXIS:
            d_axis, d_gains, more, d_z = _move_back(axis, gains, pace, gate, sheet, z, 0.0, first, d_z, d_motor, d_gap)
            store(block, a + _P.d_axis, _sum_axis(load(z_axis.Params, block, a + _P.d_axis), d_axis))
            store(block, a + _P.d_gains, _sum_gains(load(z_axis.Gains, block, a + _P.d_gains), d_gains))
        else:
            more, d_z = _move_back(axis, gains, pace, gate, sheet, z, 0.0, first, d_z, d_motor, d_gap)
        store(block, a + _P.d_z, d_z)
        store(block, a + _P.d_pace, z_axis.Pace(d_pace.before + more.before, d_pace.after + more.after, 0.0))


def decide_back_all(block, at, n):
    """Back through drive and law."""
    for lane in range(n):
        a = at + lane
        axis, law = load(z_axis.Params, block, a + _P.axis), load(_Law, block, a + _P.law)
        state, seen = load(_State, block, a + _P.state_before), load(Seen, block, a + _P.seen_before)
        recorded, drive = load(_Recorded, block, a + _P.recorded), z_axis.Drive()  # which only shifts
        d_state, d_drive = load(_State, block, a + _P.d_state), load(z_axis.Drive, block, a + _P.d_drive)
        d_seen, d_pace = load(Seen, block, a + _P.d_seen), load(z_axis.Pace, block, a + _P.d_pace)
        d_u = block[a + _P.d_outputs + UW]
        if _AXIS:
            d_axis, d_law, d_state, d_before, d_recorded, d_drive = _decide_back(
                axis, law, state, seen, recorded, drive, d_state, d_drive, d_seen.sent, d_pace, d_u
            )
            store(block, a + _P.d_axis, _sum_axis(load(z_axis.Params, block, a + _P.d_axis), d_axis))
        else:
            d_law, d_state, d_before, d_recorded, d_drive = _decide_back(
                axis, law, state, seen, recorded, drive, d_state, d_drive, d_seen.sent, d_pace, d_u
            )
        store(block, a + _P.d_law, _sum_law(load(_Law, block, a + _P.d_law), d_law))
        store(block, a + _P.d_state, d_state)
        position = d_before.head_position + d_seen.head_position
        store(block, a + _P.d_seen, Seen(position, d_before.head_velocity, d_before.sent))
        store(block, a + _P.d_recorded, d_recorded)
        store(block, a + _P.d_drive, d_drive)


def finish_all(block, at, n):
    """What the axis' coefficients are made of."""
    for lane in range(n):
        a = at + lane
        axis, d_gains = load(z_axis.Params, block, a + _P.axis), load(z_axis.Gains, block, a + _P.d_gains)
        (more,) = _gains_back(axis, DT, d_gains)
        store(block, a + _P.d_axis, _sum_axis(load(z_axis.Params, block, a + _P.d_axis), more))


def backward_block(deck, b):
    """All periods of the machines of block ``b``, the last first."""
    machines, steps = deck[D.machines], deck[D.steps]
    block, at, n = doubles(deck[D.block], _ANY), b * _P.stride, min(UW, machines - b * UW)
    recorded, outputs = doubles(deck[D.recorded], _ANY), doubles(deck[D.outputs], _ANY)
    d_outputs, d_recorded = doubles(deck[D.d_outputs], _ANY), doubles(deck[D.d_recorded], _ANY)
    kept = doubles(deck[D.kept], _ANY)
    for i in range(steps):
        t = steps - U1 - i
        three, record = t * U3 * machines + b * UW, t * _P.given * machines + b * UW
        copy(block, at + _P.z_first, kept, (b * steps + t) * _P.kept, _P.kept)
        fetch(block, at + _P.recorded, recorded, record, _P.given, n, machines)
        fetch(block, at + _P.outputs, outputs, three, U3, n, machines)
        fetch(block, at + _P.d_outputs, d_outputs, three, U3, n, machines)
        see_back_all(block, at, n)
        for j in range(0, SUBSTEPS, _BACK_AT_ONCE):
            move_back_all(block, at, n, SUBSTEPS - _BACK_AT_ONCE - j)
        decide_back_all(block, at, n)
        put(block, at + _P.d_recorded, d_recorded, record, _P.given, n, machines)
    if _AXIS:
        finish_all(block, at, n)


def _forward(deck_address):
    """Blocks until none is left; several threads may do so at once."""
    deck = words(deck_address, _DECK)
    blocks = (deck[D.machines] + UW - U1) // UW
    b = take(deck, D.next)
    while b < blocks:
        forward_block(deck, b)
        b = take(deck, D.next)


def _backward(deck_address):
    """Blocks until none is left; several threads may do so at once."""
    deck = words(deck_address, _DECK)
    blocks = (deck[D.machines] + UW - U1) // UW
    b = take(deck, D.next)
    while b < blocks:
        backward_block(deck, b)
        b = take(deck, D.next)


_THERE = (fetch, put, copy, keep_axis, keep_loop, prepare_all, decide_all, move_all, see_all)
_BACK = (fetch, put, copy, see_back_all, move_back_all, decide_back_all, finish_all)


def _sum_of(cls: Any) -> Any:
    """A part that adds two NamedTuples number by number."""
    names: dict[str, Any] = {"cls": cls}

    def text(kind: Any, a: str) -> str:
        inner = []
        for field, k in zip(kind._fields, kinds(kind), strict=True):
            if is_part(k):
                inner.append(text(k, f"{a}.{field}"))
            else:
                inner.append("False" if k is bool else f"x{a}.{field} + y{a}.{field}")
        name = next(n for i in range(99) if names.get(n := f"{kind.__name__}_{i}", kind) is kind)
        names[name] = kind
        return f"{name}({', '.join(inner)})"

    exec(f"def total(x, y):\n    return {text(cls, '')}\n", names)
    names["total"].__module__ = __name__
    return part(names["total"])


def _copy(function: Any, space: dict[str, Any], name: str) -> Any:
    """A function with other globals, under a name of its own."""
    made = types.FunctionType(function.__code__, space, function.__name__, function.__defaults__)
    made.__module__, made.__qualname__ = function.__module__, f"{function.__name__.lstrip('_')}.{name}"
    return made


def _kernel(entry: Any, stages: tuple[Any, ...], whole: Any, filled: dict[str, Any], name: str, text: str) -> Kernel:
    """A kernel of stages that have the globals of a law."""
    space = {**globals(), **filled}
    for function in stages:
        space[function.__name__] = stage(_copy(function, space, name))
    space[whole.__name__] = part(_copy(whole, space, name))
    return Kernel(_copy(entry, space, name), text)


# --------------------------------------------------------------------------------------------------- as Python sees it


@dataclass
class Start:
    """State between two periods; numbers, or arrays of shape (machines,)."""

    motion: Motion
    law: Any  # of the law's State


@dataclass
class Run:
    """What came of a roll-out."""

    gap: np.ndarray  # mm, shape (periods, machines): true gap at the end of each period
    command: np.ndarray  # mm/s, the law's
    position: np.ndarray  # mm, encoder at the gate's centre
    after: Start  # where the next roll-out goes on
    given: dict[str, Any]  # what the way back needs


@dataclass
class Gradients:
    """Derivatives of L by all that a roll-out was given; arrays of shape (machines,) where nothing else is said."""

    recorded: Any  # of the law's Recorded, shape (periods, machines)
    params: Any  # of the law's Params
    before: Start  # by the state at the start
    axis: z_axis.Params | None  # where asked for; those of dead time, D/A and encoder are 0


class Loop:
    """Drive and loop under a law.

    Args:
        law: a namespace with ``Params``, ``State``, ``Recorded`` and ``weigh``.
        threads: that share the machines.
        longest: turns of loops in the law whose count is not known beforehand, see :func:`adjoint`.

    Raises:
        InvalidInput: the law cannot be read; the message tells what, in which file and line.
    """

    def __init__(self, law: Any = weighed, threads: int = 1, longest: int = 0) -> None:
        self.law, self.threads, self.longest = law, threads, longest
        layout = Layout()
        kept = {
            "z_first": z_axis.State, "z_second": z_axis.State, "pace": z_axis.Pace, "seen_before": Seen,
            "state_before": law.State,
        }  # fmt: skip
        sizes = {
            "axis": z_axis.Params, "gains": z_axis.Gains, "gate": Gate, "law": law.Params, "z": z_axis.State,
            "drive": z_axis.Drive, "seen": Seen, "state": law.State, "surface": Surface, "recorded": law.Recorded,
            "outputs": Outputs, "motor": Motor, **kept,
        }  # fmt: skip
        adjoints = ("axis", "gains", "law", "z", "drive", "seen", "state", "pace", "motor", "recorded", "outputs")
        self._sizes = sizes | {f"d_{name}": sizes[name] for name in adjoints}
        self._places = _Places(
            **{name: layout.place(rows(cls)) for name, cls in self._sizes.items()},
            stride=U(layout.rows * W),
            kept=U(sum(map(rows, kept.values())) * W),
            given=U(rows(law.Recorded)),
        )
        self._rows = layout.rows
        weigh = part(getattr(law.weigh, "py_func", law.weigh))  # a user may have compiled it already
        decide_as = _copy(decide, {**globals(), "_weigh": weigh}, law.__name__)
        self._filled = {
            "_weigh": weigh, "_decide": part(decide_as), "_Law": law.Params, "_State": law.State,
            "_Recorded": law.Recorded, "_P": self._places, "_sum_law": _sum_of(law.Params),
            "_sum_axis": _sum_of(z_axis.Params), "_sum_gains": _sum_of(z_axis.Gains),
        }  # fmt: skip
        self._kernels: dict[tuple[bool, ...], Kernel] = {}
        self._text = source_of(law)
        self._adjoint_of_law()  # a law that cannot be read is refused at once

    # ----------------------------------------------------------------------------------------------------- kernels

    def _adjoint_of_law(self, axis: bool = False) -> Any:
        law = self.law
        given = (z_axis.Params, law.Params, law.State, Seen, law.Recorded, z_axis.Drive)
        wrt = (*(("axis",) if axis else ()), "law", "state", "seen", "recorded", "drive")
        return adjoint(self._filled["_decide"], *given, wrt=wrt, longest=self.longest)

    def _there(self, bristles: bool) -> Kernel:
        if (key := (bristles,)) not in self._kernels:
            filled = {**self._filled, "_BRISTLES": bristles}
            name = f"{_short(self.law)}.{bristles:d}"
            self._kernels[key] = _kernel(_forward, _THERE, forward_block, filled, name, self._text)
        return self._kernels[key]

    def _back(self, bristles: bool, axis: bool) -> Kernel:
        if (key := (bristles, axis)) not in self._kernels:
            parts = (z_axis.Params, z_axis.Gains, z_axis.Pace, Gate, Surface, z_axis.State)
            by = ("axis", "gains", "pace", "z") if axis else ("pace", "z")
            seen_by = ("axis", "motor", "last", "sent") if axis else ("motor", "last", "sent")
            back = {
                "_decide_back": self._adjoint_of_law(axis),
                "_move_back": adjoint(move_far, *parts, float, float, Fixed(bristles), wrt=by),
                "_see_back": adjoint(see, z_axis.Params, float, float, Sent, wrt=seen_by),
                "_gains_back": adjoint(z_axis.gains, z_axis.Params, float, wrt=("p",)),
            }
            filled = {**self._filled, "_BRISTLES": bristles, "_AXIS": axis, **back}
            name = f"{_short(self.law)}.{bristles:d}{axis:d}"
            text = self._text + str(self.longest) + back["_decide_back"].text
            self._kernels[key] = _kernel(_backward, _BACK, backward_block, filled, name, text)
        return self._kernels[key]

    def _run(self, kernel: Kernel, deck: Deck, blocks: int) -> None:
        deck["next"] = 0
        if self.threads == 1 or blocks == 1:
            kernel(deck)
        else:
            workers(self.threads).share(functools.partial(kernel, deck))

    # ----------------------------------------------------------------------------------------------------- columns

    def _write(self, view: np.ndarray, name: str, value: Any) -> None:
        """A part into the columns of all machines; its numbers may be arrays of shape (machines,)."""
        first, size = int(getattr(self._places, name)) // W, view.shape[0] * W
        for i, number in enumerate(_numbers(value)):
            row = np.zeros(size)
            row[: self._machines] = number
            row[self._machines :] = row[0]  # lanes without a machine repeat the first
            view[:, first + i] = row.reshape(-1, W)

    def _read(self, view: np.ndarray, name: str, cls: Any = None) -> Any:
        first, cls = int(getattr(self._places, name)) // W, cls or self._sizes[name]
        return _built(cls, iter([view[:, first + i].reshape(-1)[: self._machines].copy() for i in range(rows(cls))]))

    # ------------------------------------------------------------------------------------------------------ running

    def forward(
        self,
        axis: z_axis.Params,
        params: Any,
        recorded: Any,
        surface: Surface,
        start: Start | None = None,
        gate: Any = _GATE,
        keep: bool = True,
        into: Run | None = None,
    ) -> Run:
        """Runs periods of all machines.

        Args:
            axis: the axes; numbers, or arrays of shape (machines,).
            params: the law's ``Params``, in the same form.
            recorded: the law's ``Recorded`` of numbers and arrays that broadcast to (periods, machines).
            surface: the sheet's course, mm, in the same form.
            start: where it begins: a state that :attr:`Run.after` had, or None: at rest, 1 mm above the sheet.
            gate: length of the sensor's gate, ms.
            keep: whether the way back will be asked for; if not, less memory is needed.
            into: an earlier roll-out of as many periods and machines that is not needed any more. Its memory is used
                again, which saves the time to ask for new; all that it holds is overwritten.

        Raises:
            InvalidInput: arrays of other shapes.
        """
        given, sheet = _stacked(recorded, surface)
        steps, _, machines = given.shape
        self._machines, blocks = machines, -(-machines // W)
        block = aligned(blocks * self._rows * W)
        view = block.reshape(blocks, self._rows, W)
        if start is None:
            start = Start(at_rest(sheet[0, 0] + 1.0), self.law.State(*(0.0,) * len(self.law.State._fields)))
        counted = np.maximum(1.0, np.rint(np.asarray(gate) * (1e-3 / PERIOD) * SUBSTEPS))  # substeps within the gate
        parts = {
            "axis": axis, "law": params, "gate": (1.0 - counted / SUBSTEPS + 1e-9, 1.0 / counted),
            "z": start.motion.axis, "drive": start.motion.drive, "seen": start.motion.seen, "state": start.law,
        }  # fmt: skip
        for name, value in parts.items():
            self._write(view, name, value)
        outputs, kept = np.empty((steps, 3, machines)), None
        if into is not None and into.given["outputs"].shape == outputs.shape:
            outputs, kept = into.given["outputs"], into.given["kept"]
        if not keep:
            kept = None
        elif kept is None:
            kept = aligned(blocks * steps * int(self._places.kept))
        deck = Deck(
            Entries, block=block, machines=machines, steps=steps, surface=sheet, recorded=given, outputs=outputs,
            kept=kept,
        )  # fmt: skip
        bristles = bool(np.any(np.asarray(axis.bristle) > 0.0))
        self._run(self._there(bristles), deck, blocks)
        motion = Motion(self._read(view, "z"), self._read(view, "drive"), self._read(view, "seen"))
        after = Start(motion, self._read(view, "state"))
        keeps = {"block": block, "recorded": given, "outputs": outputs, "kept": kept, "bristles": bristles}
        return Run(outputs[:, 0], outputs[:, 1], outputs[:, 2], after, keeps)

    def backward(
        self, run: Run, gap: Any = 0.0, command: Any = 0.0, position: Any = 0.0, after: Start | None = None,
        axis: bool = False,
    ) -> Gradients:  # fmt: skip
        """Goes back through a roll-out.

        Args:
            run: that :meth:`forward` has kept.
            gap: derivatives of L by the gaps, 1/mm; broadcasts to (periods, machines).
            command: by the commands, s/mm.
            position: by the encoder's positions, 1/mm.
            after: by the state at its end, as :attr:`Gradients.before` of the roll-out behind it; None: 0, which cuts
                the gradient there.
            axis: whether the derivatives by the axes' parameters are asked for; they cost half as much again.

        Raises:
            InvalidInput: nothing has been kept.
        """
        given = run.given
        if given["kept"] is None:
            raise InvalidInput("this roll-out has kept nothing to go back by; run forward(…, keep=True)")
        steps, _, machines = given["outputs"].shape
        self._machines, blocks = machines, -(-machines // W)
        block = given["block"].copy()
        view = block.reshape(blocks, self._rows, W)
        first = int(self._places.d_axis) // W
        view[:, first:] = 0.0
        if after is not None:
            motion = after.motion
            for name, value in (("d_z", motion.axis), ("d_drive", motion.drive), ("d_seen", motion.seen)):
                self._write(view, name, value)
            self._write(view, "d_state", after.law)
        d_outputs, d_recorded = np.empty((steps, 3, machines)), np.empty(given["recorded"].shape)
        for i, value in enumerate((gap, command, position)):
            d_outputs[:, i] = value
        deck = Deck(
            Entries, block=block, machines=machines, steps=steps, recorded=given["recorded"],
            outputs=given["outputs"], kept=given["kept"], d_outputs=d_outputs, d_recorded=d_recorded,
        )  # fmt: skip
        self._run(self._back(given["bristles"], axis), deck, blocks)
        motion = Motion(self._read(view, "d_z"), self._read(view, "d_drive"), self._read(view, "d_seen"))
        return Gradients(
            recorded=_built(self.law.Recorded, iter(np.moveaxis(d_recorded, 1, 0))),
            params=self._read(view, "d_law"),
            before=Start(motion, self._read(view, "d_state")),
            axis=self._read(view, "d_axis")._replace(dead_time=0.0, dac=0.0, encoder=0.0) if axis else None,
        )


def at_rest(position: Any) -> Motion:
    """An axis that stands still at ``position``, mm."""
    return Motion(z_axis.at_rest(position), z_axis.Drive(), Seen(position, 0.0, Sent()))


def _short(law: Any) -> str:
    return str(law.__name__).split(".")[-1]


def _numbers(value: Any) -> list[Any]:
    """A part's numbers or arrays in row order."""
    return [x for v in value for x in (_numbers(v) if isinstance(v, tuple) else [v])]


def _built(cls: Any, stream: Any) -> Any:
    """A part of arrays in row order."""
    return cls(*(_built(kind, stream) if is_part(kind) else next(stream) for kind in kinds(cls)))


def _stacked(recorded: Any, surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Both as arrays (periods, numbers, machines)."""
    numbers = [np.asarray(x, float) for x in (*_numbers(recorded), *surface)]
    try:
        shape = np.broadcast_shapes(*(x.shape for x in numbers))
    except ValueError:
        shapes = ", ".join(str(x.shape) for x in numbers)
        raise InvalidInput(f"numbers of a roll-out of shapes {shapes}; all broadcast to (periods, machines)") from None
    if len(shape) != 2:
        raise InvalidInput(f"a roll-out of shape {shape}; (periods, machines) is needed")
    count = len(numbers) - len(surface)
    whole = [np.ascontiguousarray(np.stack([np.broadcast_to(x, shape) for x in some], axis=1))
             for some in (numbers[:count], numbers[count:])]  # fmt: skip
    return whole[0], whole[1]
