"""Faults in running machines: stages at three hooks of the kernel.

- After the law (a pilot): the command is spoilt before the supervisor sees it.
- After the sensor: the count is spoilt before the filter sees it. Here the filter can be taken out as well.
- After the supervisor: the law's command goes to the drive, whatever the supervisor made of it. The law is told what
  the drive got, as ever, and that it is in charge.

What takes a part out acts from the first period of the fault on, so all repetitions of a run are the same to the bit
until then.
"""

from typing import NamedTuple

import numpy as np

from ....envs.control.stack import Stack
from ....envs.engine.columns import Columns
from ....envs.engine.deck import Deck, places
from ....envs.engine.lanes import U0, U1, U2, UW, Layout, U, W, call, doubles, load, row, rows, store, words
from ....envs.engine.quantity import InvalidInput
from ....envs.plant import filters, heads, machine, sensor, supervisor, z_axis
from ....envs.plant.calibration import POINTS
from ....envs.plant.controller import stage_address
from ....envs.plant.fleet import Fleet

KINDS = ("none", "spikes", "frozen", "delayed", "scaled", "dropout", "stuck", "saturated", "impulse", "shower")
_CODES = (float(i) for i in range(len(KINDS)))
NONE, SPIKES, FROZEN, DELAYED, SCALED, DROPOUT, STUCK, SATURATED, IMPULSE, SHOWER = _CODES

NEVER = 1e18
"""Start of a fault that does not come."""


class Fault(NamedTuple):
    """One fault of one machine. Times are control periods of an episode, from 1 on."""

    kind: float = NONE
    start: float = NEVER  # the first period that is spoilt
    length: float = 0.0  # periods
    value: float = 0.0  # spikes: mm/s; scaled: factor; impulse: its relative height; shower: probability per sample;
    # saturated: factor on the frequency at an end of the head's table
    second: float = 0.0  # spikes: mm/s from the second period on; saturated: which end, 1 is the upper one; shower:
    # longest impulse, periods
    back: float = 0.0  # delayed: periods, at most RING − 1


class Without(NamedTuple):
    """What is taken out of a machine from the start of its fault on."""

    supervisor: float = 0.0  # 1: every command passes, with the drive's own limit of speed alone
    filter: float = 0.0  # 1: the newest count counts
    memory: float = 0.0  # 1: the law begins anew in the first period after the fault, told the last sound command


class _Kept(NamedTuple):
    held: float = 0.0  # mm/s, the last sound command
    rate: float = 0.0  # of the sensor's impulses before the shower
    longest: float = 0.0  # of them, periods


class _Ends(NamedTuple):
    low: float = 0.0  # Hz, frequencies at the ends of the head's table
    high: float = 0.0


RING = 32
"""Commands that are remembered for a delay."""

_layout = Layout()
_FAULT, _WITHOUT, _KEPT = _layout.place(rows(Fault)), _layout.place(rows(Without)), _layout.place(rows(_Kept))
_RING, _LAST = _layout.place(RING), U(RING - 1)
_ENDS = _layout.place(rows(_Ends))
_ROWS = _layout.rows
_STRIDE = U(_ROWS * W)


class Io(NamedTuple):
    """The deck of the three stages."""

    next: int  # stage and deck of the next pilot; 0: none
    next_io: int
    faults: int  # array of all columns
    machine: int  # the words of the machine's deck


IO = places(Io)
_ANY, _IO = U(2**40), U(len(IO))
_TICKS = machine.TALLY
_COUNT, _TOLD, _FRESH = map(machine.signal, ("frequency", "command", "fresh"))
_FILTER_KIND, _FILTER_WINDOW, _FILTER_TRIM = (
    machine.P_FILTER + row(filters.Params, name) for name in ("kind", "window", "trim")
)
_RATE, _LONGEST = (machine.P_SENSOR + row(sensor.Params, name) for name in ("impulses", "longest"))
_MODE, _ALARM, _OVERRIDE, _CAPTURED, _SENT = (
    machine.S_GUARD + row(supervisor.State, name) for name in ("mode", "alarm", "override", "captured", "command")
)


def spoil_commands(block_address, at, n, io_address, first):
    """Pilot: the law's command, with whatever a policy has added, becomes that of the fault."""
    block, io = doubles(block_address, _ANY), words(io_address, _IO)
    faults, deck = doubles(io[IO.faults], _ANY), words(io[IO.machine], machine.DECK)
    mine = at // machine.STRIDE * _STRIDE + at % machine.STRIDE
    for lane in range(n):
        a, b = at + lane, mine + lane
        p, without = load(Fault, faults, b + _FAULT), load(Without, faults, b + _WITHOUT)
        since = block[a + _TICKS] - p.start
        if without.memory > 0.5 and since == p.length:
            told = block[a + _TOLD]
            block[a + _FRESH], block[a + _TOLD] = 1.0, faults[b + _KEPT]
            law = deck[machine.D.law]
            call(law, block_address, a, U1, deck[machine.D.law_tables], deck[machine.D.law_size])
            block[a + _FRESH], block[a + _TOLD] = 0.0, told
        hand = load(machine.Hand, block, a + machine.HAND)
        wish = hand.gain * block[a + machine.WISH] + hand.residual
        now = U(np.int64(block[a + _TICKS]))
        faults[b + _RING + (now & _LAST) * UW] = wish
        if since < 0.0 or since >= p.length or p.kind == NONE or p.kind > SCALED:
            faults[b + _KEPT] = wish
        else:
            spoilt = p.value * wish
            if p.kind == SPIKES:
                spoilt = p.value if since < 1.0 else p.second
            elif p.kind == FROZEN:
                spoilt = faults[b + _KEPT]
            elif p.kind == DELAYED:
                spoilt = faults[b + _RING + ((now - U(np.int64(p.back))) & _LAST) * UW]
            block[a + machine.WISH] = spoilt
            store(block, a + machine.HAND, machine.Hand(1.0, 0.0))
    if io[IO.next] > U0:
        call(io[IO.next], block_address, at, n, io[IO.next_io], first)


def spoil_counts(block_address, at, n, io_address, tick):
    """Stage after the sensor: count and ring of samples become those of the fault."""
    block, io = doubles(block_address, _ANY), words(io_address, _IO)
    faults = doubles(io[IO.faults], _ANY)
    mine = at // machine.STRIDE * _STRIDE + at % machine.STRIDE
    now = machine.SAMPLES + (tick & machine.SAMPLES_LAST) * UW
    last = machine.SAMPLES + ((tick - U1) & machine.SAMPLES_LAST) * UW
    for lane in range(n):
        a, b = at + lane, mine + lane
        p = load(Fault, faults, b + _FAULT)
        since = block[a + _TICKS] - p.start
        if p.kind == SHOWER:  # the sensor has counted already, so its parameters change one period ahead
            if since == -1.0:
                faults[b + _KEPT + UW], faults[b + _KEPT + U2 * UW] = block[a + _RATE], block[a + _LONGEST]
                block[a + _RATE], block[a + _LONGEST] = p.value, p.second
            elif since == p.length - 1.0:
                block[a + _RATE], block[a + _LONGEST] = faults[b + _KEPT + UW], faults[b + _KEPT + U2 * UW]
        touches = block[a + _COUNT] <= 0.0  # contact is no fault of the sensor's
        if since >= 0.0 and since < p.length and not touches:
            if p.kind == DROPOUT:
                block[a + _COUNT] = 0.0
                block[a + now] = block[a + last]
            elif p.kind == STUCK:
                block[a + _COUNT] = block[a + last]
                block[a + now] = block[a + last]
            elif p.kind == SATURATED:
                f = p.value * (faults[b + _ENDS + UW] if p.second > 0.5 else faults[b + _ENDS])
                block[a + _COUNT] = f
                block[a + now] = f
            elif p.kind == IMPULSE:
                head, course = (
                    load(sensor.Params, block, a + machine.P_SENSOR),
                    load(machine.Course, block, a + machine.COURSE),
                )
                gap = machine.sensed_gap(load(machine.Moment, block, a + machine.MOMENT), course)
                raised = gap + p.value * head.impulse / (1.0 + gap / head.falloff)
                plain = sensor.oscillator(head, sensor.capacitance(head, gap, course.cover), 0.0)
                hit = sensor.oscillator(
                    head, sensor.capacitance(head, max(raised, sensor.LEAST_GAP), course.cover), 0.0
                )
                block[a + _COUNT] += hit - plain
                block[a + now] += hit - plain
        if since >= 0.0 and load(Without, faults, b + _WITHOUT).filter > 0.5:
            block[a + _FILTER_KIND], block[a + _FILTER_WINDOW], block[a + _FILTER_TRIM] = filters.NONE, 1.0, 0.0


def pass_commands(block_address, at, n, io_address, tick):
    """Stage after the supervisor: the command that it was given goes to the drive. NaN goes as 0 mm/s."""
    block, io = doubles(block_address, _ANY), words(io_address, _IO)
    faults = doubles(io[IO.faults], _ANY)
    mine = at // machine.STRIDE * _STRIDE + at % machine.STRIDE
    now = machine.COMMANDS + (tick & machine.HISTORY_LAST) * UW
    for lane in range(n):
        a, b = at + lane, mine + lane
        p, without = load(Fault, faults, b + _FAULT), load(Without, faults, b + _WITHOUT)
        if without.supervisor > 0.5 and block[a + _TICKS] >= p.start:
            hand = load(machine.Hand, block, a + machine.HAND)
            wish = hand.gain * block[a + machine.WISH] + hand.residual
            wish = wish if wish == wish else 0.0
            z, d = load(z_axis.Params, block, a + machine.P_Z), load(z_axis.Drive, block, a + machine.DRIVE)
            d = z_axis.accept(z, z_axis.Drive(d.c1, d.c2, d.c3, d.c4, d.c5, d.c6, 0.0), wish)
            store(block, a + machine.DRIVE, d)
            sent = max(-z.speed, min(z.speed, wish))
            block[a + now] = sent
            block[a + _SENT] = sent
            block[a + _MODE], block[a + _ALARM] = supervisor.FOLLOW, supervisor.NO_ALARM
            block[a + _OVERRIDE], block[a + _CAPTURED] = 0.0, 1.0


class Faults(Columns):
    """Faults of a fleet's machines, and what is taken out of these; :meth:`put` writes ``fault`` and ``without``."""

    def __init__(self, size: int) -> None:
        places = {"fault": (_FAULT, Fault), "without": (_WITHOUT, Without), "ends": (_ENDS, _Ends)}
        super().__init__(size, _ROWS, places)

    def install(self, fleet: Fleet) -> None:
        """Puts the faults into a fleet that has its law, its heads and pilots, and has not begun."""
        first, every = fleet.column("start.head").astype(int) * POINTS, np.arange(fleet.size)
        self.set("ends.low", every, heads.POOL.frequencies[first])
        self.set("ends.high", every, heads.POOL.frequencies[first + POINTS - 1])
        io = Deck(Io, faults=self._block, machine=fleet.deck.words)
        # The last pilot: a policy's share of the command is spoilt with it.
        fleet.pilot("faults", stage_address(spoil_commands), io)
        fleet.after_sensor(stage_address(spoil_counts), io)
        fleet.after_supervisor(stage_address(pass_commands), io)


def check(stack: Stack) -> Stack:
    """The stack, if faults can be put into its command.

    Raises:
        InvalidInput: it is plain Python, or drives another slot.
    """
    if stack.slot != "z":
        raise InvalidInput(f"controller '{stack.name}' drives slot '{stack.slot}'; faults are those of slot 'z'")
    if stack.python is not None:
        raise InvalidInput(f"controller '{stack.name}' is plain Python; faults reach compiled laws and policies alone")
    if stack.sealed:
        raise InvalidInput(f"controller '{stack.name}' is C; faults reach compiled laws and policies alone")
    return stack
