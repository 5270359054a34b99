"""Drive and loop, forwards and backwards: what a command costs later, exactly.

A height follower's law sees the sheet as encoder − reading, which does not depend on what it commands. So what it reads
can be recorded once, and only the drive and the loop through the encoder have to be simulated with derivatives. This
module does that for many machines: the same parts as the machine's kernel, so the same bits, and their adjoints
(:mod:`envs.engine.adjoint`). One control period::

    (state, command) = loop(params, state, felt, memory)     the law's part that depends on the head
    drive            = z_axis.accept(p, drive, sent)         sent: the command, or what the supervisor sent instead
    motion, head     = 20 × z_axis.step
    felt             = encoder over the gate, its speed, the command

Backwards, adjoints run from the last period to the first (back-propagation through time, Werbos 1990). What is kept of
a period is what it began with; its substeps are computed once more.

The dead time's fraction, the D/A and the encoder: see :mod:`envs.engine.adjoint` for what rounding passes on. A command
acts from a substep on, so a change of the dead time below a substep changes nothing, and there is no derivative by it.
"""

import hashlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..engine.adjoint import adjoint
from ..engine.columns import Columns
from ..engine.deck import Deck, places
from ..engine.kernels import Kernel, filled, specialise
from ..engine.lanes import (
    U0,
    U1,
    UW,
    Layout,
    U,
    W,
    call,
    column,
    copy,
    doubles,
    fields,
    flat,
    load,
    part,
    row,
    rows,
    scratch,
    stage,
    store,
    words,
)
from ..engine.quantity import InvalidInput
from . import machine, z_axis
from .controller import PERIOD, source_of
from .fleet import Fleet
from .machine import DT, SUBSTEPS, Course, Moment


class Felt(NamedTuple):
    """What a law's loop feels of the head, as ``controller.Sensed`` has it."""

    head_position: float = 0.0  # mm, encoder at the gate's centre
    head_velocity: float = 0.0  # mm/s, from the encoder over the last period
    set_height: float = 0.0  # mm
    command: float = 0.0  # mm/s, what was sent to the drive last


class Period(NamedTuple):
    """What is recorded of a period, whatever the law does."""

    surface: float = 0.0  # mm, at its start, and the two numbers of its course, see ``machine.Course``
    slope: float = 0.0
    bend: float = 0.0
    opens: float = 0.75  # share of the period at which the gate opens
    weight: float = 0.2  # of each substep within the gate
    sent: float = np.nan  # mm/s, what went to the drive in the law's place; NaN: the law's command did


class Made(NamedTuple):
    """What a period makes."""

    gap: float = 0.0  # mm, at its end
    command: float = 0.0  # mm/s, that was sent
    position: float = 0.0  # mm, encoder


PARAMS, STATE = 32, 16
"""Numbers that a loop's Params and State may have."""

LARGEST = 2**30
"""Numbers that may be recorded, 8 GiB."""

_layout = Layout()
P_Z, GAINS, LAW = _layout.part("z", z_axis.Params), _layout.place(rows(z_axis.Gains)), _layout.place(PARAMS)
OFFSET = _layout.place(1)
# What goes on from period to period, side by side because it is kept.
MOTION, DRIVE = _layout.part("motion", z_axis.State), _layout.part("drive", z_axis.Drive)
LOOP, FELT, ENCODER = _layout.place(STATE), _layout.part("felt", Felt), _layout.place(1)
KEPT = (int(ENCODER) - int(MOTION)) // W + 1
COMMAND, PACE, MOMENT = _layout.place(1), _layout.place(rows(z_axis.Pace)), _layout.place(rows(Moment))
COURSE = _layout.place(rows(Course))
STEPS = _layout.place(5 * rows(z_axis.State))
# Adjoints.
MOTION_, DRIVE_ = _layout.place(rows(z_axis.State)), _layout.place(rows(z_axis.Drive))
LOOP_, FELT_ = _layout.place(STATE), _layout.place(rows(Felt))
ENCODER_, COMMAND_, PACE_, HEAD_, GATE_ = (_layout.place(n) for n in (1, 1, rows(z_axis.Pace), 1, 1))
LAW_, LAW_NOW = _layout.place(PARAMS), _layout.place(PARAMS)
ROWS = _layout.rows
STRIDE = U(ROWS * W)

_COURSE, _MADE = U(rows(Period) * W), U(rows(Made) * W)
_KEPT = U(KEPT * W)
_ANY, _BYTES = U(2**40), U(8)
_SENT, _SURFACE = row(Period, "sent"), U((rows(Period) - 1) * W)
assert Period._fields[:-1] == Course._fields[: rows(Period) - 1]  # so a course is copied in one go
_OPENS, _WEIGHT = COURSE + row(Course, "opens"), COURSE + row(Course, "weight")
_GAP, _COMMAND, _POSITION = (row(Made, name) for name in Made._fields)


class Entries(NamedTuple):
    """The kernels' deck; arrays are float64, of blocks of ``W`` machines side by side."""

    block: int  # (blocks, ROWS, W)
    blocks: int
    periods: int
    recorded: int  # periods that are recorded, …
    first: int  # … and the first of them that counts
    course: int  # (blocks, recorded, Period, W)
    memory: int  # (blocks, recorded, size, W)
    size: int
    made: int  # (blocks, periods, Made, W)
    kept: int  # (blocks, periods, KEPT, W)
    made_: int  # adjoints, as `made`
    memory_: int  # (blocks, periods, wanted, W)
    wanted: int
    loop: int  # stages
    loop_back: int
    bristles: int


D = places(Entries)
_DECK = U(len(Entries._fields))


# -------------------------------------------------------------------------------------------------------- forwards


@stage
def _send(block, at, period):
    """A command goes to the drive: the loop's, or what was sent in its place."""
    for lane in range(UW):
        a = at + lane
        sent = period[_SENT + lane]
        command = block[a + COMMAND] if sent != sent else sent
        block[a + COMMAND] = command
        p = load(z_axis.Params, block, a + P_Z)
        drive = z_axis.accept(p, load(z_axis.Drive, block, a + DRIVE), command)
        store(block, a + DRIVE, drive)
        store(block, a + PACE, z_axis.pace(p, drive))
        store(block, a + MOMENT, Moment(0.0, 0.0, 0.0, 0.0, 1e9))


_move = stage(filled(
    machine.move_all, "derivatives", P_Z=P_Z, GAINS=GAINS, PACE=PACE, COURSE=COURSE, S_Z=MOTION, MOMENT=MOMENT,
))  # fmt: skip
"""The machine's own stage of five substeps, where these rows are."""


@part
def _felt(p, gate_motor, encoder_before, offset, set_height, command):
    """What is felt after a period, and the encoder alone."""
    encoder = z_axis.encoded(p, gate_motor)
    return Felt(encoder + offset, (encoder - encoder_before) / PERIOD, set_height, command), encoder


@stage
def _feel(block, at, made):
    """What a period has made, and what is felt of it."""
    for lane in range(UW):
        a = at + lane
        m, felt = load(Moment, block, a + MOMENT), load(Felt, block, a + FELT)
        p, command = load(z_axis.Params, block, a + P_Z), block[a + COMMAND]
        felt, encoder = _felt(p, m.gate_motor, block[a + ENCODER], block[a + OFFSET], felt.set_height, command)
        store(block, a + FELT, felt)
        block[a + ENCODER] = encoder
        made[_GAP + lane], made[_COMMAND + lane], made[_POSITION + lane] = m.gap, command, felt.head_position


@part
def _row(deck, array, block, period, width):
    """Address of a period of a block in an array."""
    return deck[array] + _BYTES * width * (block * deck[D.periods] + period)


@part
def _recorded(deck, array, block, period, width):
    """The same in an array of what is recorded."""
    return deck[array] + _BYTES * width * (block * deck[D.recorded] + deck[D.first] + period)


def _forward(address):
    """All periods of all machines."""
    deck = words(address, _DECK)
    block, size = doubles(deck[D.block], _ANY), deck[D.size]
    for b in range(deck[D.blocks]):
        at = b * STRIDE
        for t in range(deck[D.periods]):
            period = doubles(_recorded(deck, D.course, b, t, _COURSE), _ANY)
            copy(doubles(_row(deck, D.kept, b, t, _KEPT), _ANY), U0, block, at + MOTION, _KEPT)
            call(deck[D.loop], deck[D.block], at, UW, _recorded(deck, D.memory, b, t, UW * size), size)
            _send(block, at, period)
            copy(block, at + COURSE, period, U0, _SURFACE)
            for k in range(U0, U(SUBSTEPS), U(5)):
                _move(block, at, UW, k, deck[D.bristles] > U0)
            _feel(block, at, doubles(_row(deck, D.made, b, t, _MADE), _ANY))


# ------------------------------------------------------------------------------------------------------- backwards

_DRIVEN: dict[str, Any] = {"p": z_axis.Params, "g": z_axis.Gains, "r": z_axis.Pace, "s": z_axis.State}
_step_back = adjoint(z_axis.step, of=("r", "s"), **_DRIVEN, share=float, dt=DT, bristles=False)
_step_bristly_back = adjoint(z_axis.step, of=("r", "s"), **_DRIVEN, share=float, dt=DT, bristles=True)
_accept_back = adjoint(z_axis.accept, of=("d", "command"), p=z_axis.Params, d=z_axis.Drive, command=float)
_pace_back = adjoint(z_axis.pace, of=("d",), p=z_axis.Params, d=z_axis.Drive)
_felt_back = adjoint(
    _felt, of=("gate_motor", "encoder_before", "command"), p=z_axis.Params, gate_motor=float, encoder_before=float,
    offset=float, set_height=float, command=float,
)  # fmt: skip
_BRISTLES = False
_FIVE, _FIVES, _S_FIVE = U(5), U(SUBSTEPS // 5), U(5 * rows(z_axis.State) * W)
_STATES = SUBSTEPS * rows(z_axis.State) * W
_ONE, _TWO, _THREE, _FOUR = (U(k * rows(z_axis.State) * W) for k in (1, 2, 3, 4))


@stage
def _again(block, at, first):
    """Five substeps once more, and what each begins with."""
    k = np.float64(np.int64(first))
    for lane in range(UW):
        a = at + lane
        p, gains = load(z_axis.Params, block, a + P_Z), load(z_axis.Gains, block, a + GAINS)
        pace, z0 = load(z_axis.Pace, block, a + PACE), load(z_axis.State, block, a + MOTION)
        z1, _ = z_axis.step(p, gains, pace, z0, (k + 1.0) / SUBSTEPS, DT, _BRISTLES)
        z2, _ = z_axis.step(p, gains, pace, z1, (k + 2.0) / SUBSTEPS, DT, _BRISTLES)
        z3, _ = z_axis.step(p, gains, pace, z2, (k + 3.0) / SUBSTEPS, DT, _BRISTLES)
        z4, _ = z_axis.step(p, gains, pace, z3, (k + 4.0) / SUBSTEPS, DT, _BRISTLES)
        z5, _ = z_axis.step(p, gains, pace, z4, (k + 5.0) / SUBSTEPS, DT, _BRISTLES)
        store(block, a + STEPS, z0)
        store(block, a + STEPS + _ONE, z1)
        store(block, a + STEPS + _TWO, z2)
        store(block, a + STEPS + _THREE, z3)
        store(block, a + STEPS + _FOUR, z4)
        store(block, a + MOTION, z5)


@stage
def _unfeel(block, at, made_):
    """Adjoints at a period's end: of what it has made, and of what was felt."""
    for lane in range(UW):
        a = at + lane
        felt_ = load(Felt, block, a + FELT_)
        p = load(z_axis.Params, block, a + P_Z)
        felt_ = felt_._replace(head_position=felt_.head_position + made_[_POSITION + lane])
        gate_, before_, command_ = _felt_back(p, 0.0, 0.0, 0.0, 0.0, 0.0, felt_, block[a + ENCODER_])
        block[a + GATE_], block[a + ENCODER_] = gate_, before_
        block[a + COMMAND_] = command_ + made_[_COMMAND + lane]
        block[a + HEAD_] = made_[_GAP + lane]
        store(block, a + PACE_, z_axis.Pace(0.0, 0.0, 0.0))


@part
def _back(p, gains, pace, z, share, pace_, z_, head_, gate):
    """Adjoints at a substep's beginning from those at its end; ``gate``: opens at, adjoint of a position within."""
    z_ = z_._replace(position=z_.position + (gate.after if share > gate.before else 0.0))
    new_, z_ = _step_back(p, gains, pace, z, share, z_, head_)
    return z_axis.Pace(pace_.before + new_.before, pace_.after + new_.after, 0.0), z_


@stage
def _unmove(block, at, first):
    """Five substeps backwards."""
    k = np.float64(np.int64(first))
    for lane in range(UW):
        a = at + lane
        p, gains = load(z_axis.Params, block, a + P_Z), load(z_axis.Gains, block, a + GAINS)
        pace, pace_ = load(z_axis.Pace, block, a + PACE), load(z_axis.Pace, block, a + PACE_)
        z0, z1 = load(z_axis.State, block, a + STEPS), load(z_axis.State, block, a + STEPS + _ONE)
        z2, z3 = load(z_axis.State, block, a + STEPS + _TWO), load(z_axis.State, block, a + STEPS + _THREE)
        z4, z_ = load(z_axis.State, block, a + STEPS + _FOUR), load(z_axis.State, block, a + MOTION_)
        gate = z_axis.Pace(block[a + _OPENS], block[a + _WEIGHT] * block[a + GATE_], 0.0)
        pace_, z_ = _back(p, gains, pace, z4, (k + 5.0) / SUBSTEPS, pace_, z_, block[a + HEAD_], gate)
        pace_, z_ = _back(p, gains, pace, z3, (k + 4.0) / SUBSTEPS, pace_, z_, 0.0, gate)
        pace_, z_ = _back(p, gains, pace, z2, (k + 3.0) / SUBSTEPS, pace_, z_, 0.0, gate)
        pace_, z_ = _back(p, gains, pace, z1, (k + 2.0) / SUBSTEPS, pace_, z_, 0.0, gate)
        pace_, z_ = _back(p, gains, pace, z0, (k + 1.0) / SUBSTEPS, pace_, z_, 0.0, gate)
        block[a + HEAD_] = 0.0
        store(block, a + PACE_, pace_)
        store(block, a + MOTION_, z_)


# Where a drive has bristles. Two loops, because the vectoriser gives up on one with both ways in it.
_again_bristly = stage(filled(_again, "bristly", _BRISTLES=True))
_back_bristly = part(filled(_back, "bristly", _step_back=_step_bristly_back))
_unmove_bristly = stage(filled(_unmove, "bristly", _back=_back_bristly))


@stage
def _unsend(block, at, period):
    """Adjoints of the queue before the command entered it, and of the command."""
    for lane in range(UW):
        a = at + lane
        p, drive = load(z_axis.Params, block, a + P_Z), load(z_axis.Drive, block, a + DRIVE)
        seen_, drive_ = _pace_back(p, drive, load(z_axis.Pace, block, a + PACE_)), load(z_axis.Drive, block, a + DRIVE_)
        drive_ = z_axis.Drive(
            drive_.c0 + seen_.c0, drive_.c1 + seen_.c1, drive_.c2 + seen_.c2, drive_.c3 + seen_.c3,
            drive_.c4 + seen_.c4, drive_.c5 + seen_.c5, drive_.c6 + seen_.c6,
        )  # fmt: skip
        drive_, command_ = _accept_back(p, drive, block[a + COMMAND], drive_)  # of a queue, whatever it holds
        store(block, a + DRIVE_, drive_)
        sent = period[_SENT + lane]
        block[a + COMMAND_] = block[a + COMMAND_] + command_ if sent != sent else 0.0


def _backward(address):
    """Adjoints from the last period to the first."""
    deck = words(address, _DECK)
    block, size = doubles(deck[D.block], _ANY), deck[D.size]
    states = scratch(_STATES)
    for b in range(deck[D.blocks]):
        at = b * STRIDE
        for later in range(deck[D.periods]):
            t = deck[D.periods] - U1 - later
            period = doubles(_recorded(deck, D.course, b, t, _COURSE), _ANY)
            kept = doubles(_row(deck, D.kept, b, t, _KEPT), _ANY)
            made = doubles(_row(deck, D.made, b, t, _MADE), _ANY)
            copy(block, at + MOTION, kept, U0, _KEPT)
            for lane in range(UW):
                block[at + lane + COMMAND] = made[_COMMAND + lane]
            _send(block, at, period)
            _unfeel(block, at, doubles(_row(deck, D.made_, b, t, _MADE), _ANY))
            copy(block, at + COURSE, period, U0, _SURFACE)
            for i in range(_FIVES):
                if deck[D.bristles] > U0:
                    _again_bristly(block, at, i * _FIVE)
                else:
                    _again(block, at, i * _FIVE)
                copy(states, i * _S_FIVE, block, at + STEPS, _S_FIVE)
            for done in range(_FIVES):
                five = _FIVES - U1 - done
                copy(block, at + STEPS, states, five * _S_FIVE, _S_FIVE)
                if deck[D.bristles] > U0:
                    _unmove_bristly(block, at, five * _FIVE)
                else:
                    _unmove(block, at, five * _FIVE)
            _unsend(block, at, period)
            copy(block, at + MOTION, kept, U0, _KEPT)
            memory, memory_ = (
                _recorded(deck, D.memory, b, t, UW * size),
                _row(deck, D.memory_, b, t, UW * deck[D.wanted]),
            )
            call(deck[D.loop_back], deck[D.block], at, memory_, memory, size)


forward = Kernel(_forward)
backward = Kernel(_backward).together_with(forward)


# -------------------------------------------------------------------------------------------------- a law's loop

_loop: Any = None
_loop_back: Any = None
_Params: Any = None
_State: Any = None
_OWN = U0


def _close(block_address, at, n, memory_address, size):
    """The loop of a law: what it commands."""
    block, memories = doubles(block_address, _ANY), doubles(memory_address, _ANY)
    for lane in range(n):
        a = at + lane
        memory = column(memories, lane, size)
        params, state = load(_Params, block, a + LAW), load(_State, block, a + LOOP)
        state, command = _loop(params, state, load(Felt, block, a + FELT), memory)
        store(block, a + LOOP, state)
        block[a + COMMAND] = command


def _unclose(block_address, at, bars_address, memory_address, size):
    """Its adjoint."""
    block, memories, all_bars = doubles(block_address, _ANY), doubles(memory_address, _ANY), doubles(bars_address, _ANY)
    for lane in range(UW):
        a = at + lane
        memory, bars = column(memories, lane, size), column(all_bars, lane, size)
        params, state = load(_Params, block, a + LAW), load(_State, block, a + LOOP)
        felt, state_ = load(Felt, block, a + FELT), load(_State, block, a + LOOP_)
        params_, state_, felt_ = _loop_back(params, state, felt, memory, state_, block[a + COMMAND_], bars)
        store(block, a + LOOP_, state_)
        store(block, a + FELT_, felt_)
        store(block, a + LAW_NOW, params_)
    for i in range(_OWN):
        for lane in range(UW):
            block[at + lane + LAW_ + i * UW] += block[at + lane + LAW_NOW + i * UW]


class Rollout(Columns):
    """Drive and loop of some machines for some periods, forwards and backwards.

    Args:
        machines: how many.
        loop: a part, ``loop(params, state, felt, memory) -> (state, command)``: what of a law depends on the head.
            ``felt`` is a :class:`Felt`; ``memory`` holds the numbers of the period that do not.
        Params, State: its NamedTuples, of at most :data:`PARAMS` and :data:`STATE` numbers.
        memory: numbers of a period.
        wanted: of these, those whose adjoints are wanted; None: all.

    Attributes:
        course: fields of :class:`Period`, shape (blocks, periods, 6, W); see :meth:`lay`.
        memory: shape (blocks, periods, memory, W).

    Raises:
        InvalidInput: the loop holds something whose derivative is not known, or too many numbers.
    """

    def __init__(
        self, machines: int, loop: Callable[..., Any], Params: Any, State: Any, memory: int, wanted: range | None = None
    ) -> None:
        for cls, most in ((Params, PARAMS), (State, STATE)):
            if rows(cls) > most:
                raise InvalidInput(f"{cls.__name__} of a loop has {rows(cls)} numbers; at most {most}")
        super().__init__(machines, ROWS, _layout.parts)
        self.Params, self.State, self.size_of_memory = Params, State, memory
        self.wanted = wanted if wanted is not None else range(memory)
        kinds = {"params": Params, "state": State, "felt": Felt, "memory": np.ndarray}
        back: Any = adjoint(loop, of=kinds, only=self.wanted, **kinds)
        # The same loop may have other constants behind it, or other adjoints may be wanted of it: the text tells.
        digest = hashlib.sha256(back.text.encode()).hexdigest()[:12]
        name = f"{loop.__module__}.{loop.__qualname__}.{digest}".replace(".", "_").replace("<", "").replace(">", "")
        contract = {"_Params": Params, "_State": State, "_OWN": U(rows(Params))}
        self._close = specialise(_close, name, source_of(loop) + back.text, _loop=loop, **contract)
        self._unclose = specialise(_unclose, name, back.text, _loop_back=back, **contract)
        self.deck = Deck(Entries, block=self._block, blocks=self.blocks, size=memory)
        self.deck["loop"], self.deck["loop_back"] = self._close.address, self._unclose.address
        self.deck["wanted"] = len(self.wanted)
        self.course = self.memory = np.zeros(0)

    def put_drive(self, machines: Any, p: z_axis.Params) -> None:
        """Writes a drive, and what follows from it.

        Raises:
            InvalidInput: its dead time is one whose commands this does not keep.
        """
        _check_dead_time(p.dead_time)
        self.put("z", machines, p)
        self._put_rows(int(GAINS) // W, machines, flat(z_axis.gains(p, DT)))
        self.deck["bristles"] = int(self.deck["bristles"] or p.bristle > 0.0)

    def put_law(self, machines: Any, params: tuple, state: tuple) -> None:
        """Writes what the loop begins with."""
        self._put_rows(int(LAW) // W, machines, flat(params))
        self._put_rows(int(LOOP) // W, machines, flat(state))

    def put_loop(self, field: str, values: np.ndarray) -> None:
        """Writes one number of what the loop begins with, for all machines."""
        self._write(np.arange(self.size), {int(LOOP) // W + fields(self.State).index(field): values})

    def put_head(self, machines: Any, position: float, felt: Felt | None = None) -> None:
        """The heads stand still at ``position``, mm, with nothing on its way."""
        self.put("motion", machines, z_axis.at_rest(position))
        self.put("drive", machines, z_axis.Drive())
        self.put("felt", machines, felt or Felt(head_position=position))
        self._put_rows(int(OFFSET) // W, machines, [0.0])
        self._put_rows(int(ENCODER) // W, machines, [position])

    def put_state(self, fleet: Fleet) -> None:
        """Drives, heads and what is felt of them as the machines of a fleet have them now.

        Raises:
            InvalidInput: it has another number of machines, or a dead time whose commands this does not keep.
        """
        if fleet.size != self.size:
            raise InvalidInput(f"a fleet of {fleet.size} machines for a roll-out of {self.size}")
        every, read = np.arange(self.size), fleet.column
        _check_dead_time(float(read("z.dead_time").max()))
        for name in ("z", "motion", "drive"):
            for field in fleet.fields_of(name):
                self.set(f"{name}.{field}", every, read(f"{name}.{field}"))
        gains = fleet._view[:, int(machine.GAINS) // W :][:, : rows(z_axis.Gains)]
        self._view[:, int(GAINS) // W :][:, : rows(z_axis.Gains)] = gains
        for name in Felt._fields:
            self.set(f"felt.{name}", every, read(f"signals.{name}"))
        self._write(every, {int(OFFSET) // W: read("supervisor.offset"), int(ENCODER) // W: read("tally.encoder")})
        self.deck["bristles"] = int((read("z.bristle") > 0.0).any())

    def lay(self, periods: int) -> None:
        """Makes room for what is recorded of so many periods, in :attr:`course` and :attr:`memory`.

        Raises:
            InvalidInput: it would be more than :data:`LARGEST` numbers.
        """
        wanted = self.blocks * W * periods * self.size_of_memory
        if wanted > LARGEST:
            raise InvalidInput(
                f"{periods:,} periods of {self.size} machines with {self.size_of_memory} numbers each are more than "
                f"{LARGEST:,} numbers; fewer machines, or shorter episodes"
            )
        self.deck["periods"] = 0  # what was made of other periods is no more
        self.course = np.zeros((self.blocks, periods, len(Period._fields), W))
        self.memory = np.zeros((self.blocks, periods, self.size_of_memory, W))
        self.deck["course"], self.deck["memory"], self.deck["recorded"] = self.course, self.memory, periods

    def put_memory(self, period: int, values: np.ndarray) -> None:
        """The memory of a period, shape (machines, memory)."""
        _put_lanes(self.memory[:, period], values, (self.size, self.size_of_memory))

    def put_course(self, period: int, values: list[np.ndarray]) -> None:
        """The fields of :class:`Period` of a period, each of shape (machines,)."""
        _put_lanes(self.course[:, period], np.stack(values, axis=1), (self.size, len(Period._fields)))

    def put_wanted(self, first: int, values: np.ndarray) -> None:
        """What is wanted of the memory, from period ``first`` on, shape (machines, periods, wanted)."""
        if values.shape[::2] != (self.size, len(self.wanted)):
            raise InvalidInput(
                f"what is wanted has shape {values.shape}; it must be ({self.size}, n, {len(self.wanted)})"
            )
        where = slice(self.wanted.start, self.wanted.stop)
        self.memory[:, first : first + values.shape[1], where] = packed(values)

    def snapshot(self) -> np.ndarray:
        """Where the machines are, for :meth:`restore`."""
        return self._view.copy()

    def restore(self, snapshot: np.ndarray) -> None:
        """The machines are where they were."""
        self._view[:] = snapshot

    def put_recorded(self, course: np.ndarray, memory: np.ndarray) -> None:
        """What is recorded: fields of :class:`Period`, shape (machines, periods, 6); (machines, periods, memory)."""
        periods = course.shape[1] if course.ndim == 3 else 0
        shapes = {"course": (course, len(Period._fields)), "memory": (memory, self.size_of_memory)}
        for name, (array, width) in shapes.items():
            if array.shape != (self.size, periods, width):
                raise InvalidInput(f"{name} has shape {array.shape}; it must be {(self.size, periods, width)}")
        self.lay(periods)
        self.course[:], self.memory[:] = packed(course), packed(memory)

    def forward(self, first: int = 0, periods: int | None = None) -> np.ndarray:
        """Goes on from where the machines are, by ``periods`` recorded periods from ``first`` on; None: all.

        Returns:
            fields of :class:`Made`, shape (machines, periods, 3).

        Raises:
            InvalidInput: not so many are recorded.
        """
        recorded = self.deck["recorded"]
        count = recorded - first if periods is None else periods
        if not 0 <= first < first + count <= recorded:
            raise InvalidInput(f"periods {first} to {first + count} are asked for; {recorded} are recorded")
        self.deck["first"], self.deck["periods"] = first, count
        self.deck["kept"] = np.empty((self.blocks, count, KEPT, W))
        made = np.zeros((self.blocks, count, rows(Made), W))
        self.deck["made"] = made
        forward(self.deck)
        return unpacked(made, self.size)

    def backward(self, made_: np.ndarray) -> np.ndarray:
        """Adjoints of what is wanted of the memory, shape (machines, periods, wanted), from those of what
        :meth:`forward` returned last, shape (machines, periods, 3).

        The adjoints at the last period's end are 0. :meth:`law_adjoints` and :meth:`start_adjoints` then have those of
        the law's parameters and of what the machines began with. The machines stand where they stood.
        """
        periods = self.deck["periods"]
        wanted = (self.size, periods, rows(Made))
        if made_.shape != wanted:
            raise InvalidInput(f"the adjoints have shape {made_.shape}; they must be {wanted}")
        first = int(MOTION_) // W
        here = self._view[:, :first].copy()
        self._view[:, first:] = 0.0
        memory_ = np.zeros((self.blocks, periods, len(self.wanted), W))
        self.deck["made_"], self.deck["memory_"] = packed(made_), memory_
        backward(self.deck)
        self._view[:, :first] = here
        return unpacked(memory_, self.size)

    def law_adjoints(self) -> np.ndarray:
        """Adjoints of the loop's parameters, shape (machines, parameters)."""
        return self._rows(LAW_, rows(self.Params))

    def start_adjoints(self) -> dict[str, np.ndarray]:
        """Adjoints of what the machines began with: ``motion``, ``drive``, ``state``, ``felt``; (machines, fields)."""
        found = {"motion": (MOTION_, z_axis.State), "drive": (DRIVE_, z_axis.Drive), "felt": (FELT_, Felt)}
        found["state"] = (LOOP_, self.State)
        return {name: self._rows(place, rows(cls)) for name, (place, cls) in found.items()}

    def _rows(self, place: Any, count: int) -> np.ndarray:
        first = int(place) // W
        return self._view[:, first : first + count].transpose(0, 2, 1).reshape(-1, count)[: self.size].copy()


def _check_dead_time(periods: float) -> None:
    if periods > z_axis.QUEUE - 1:
        raise InvalidInput(
            f"dead time and latency of {periods:g} ms: gradients keep the commands of {z_axis.QUEUE - 1} ms; allowed: "
            "a machine with less, or an algorithm without gradients, such as ppo"
        )


def packed(array: np.ndarray) -> np.ndarray:
    """(machines, periods, width) to (blocks, periods, width, W)."""
    machines, periods, width = array.shape
    blocks = -(-machines // W)
    whole = np.zeros((blocks * W, periods, width))
    whole[:machines] = array
    return np.ascontiguousarray(whole.reshape(blocks, W, periods, width).transpose(0, 2, 3, 1))


def unpacked(array: np.ndarray, machines: int) -> np.ndarray:
    """The inverse of :func:`packed`."""
    blocks, periods, width, _ = array.shape
    return array.transpose(0, 3, 1, 2).reshape(blocks * W, periods, width)[:machines]


def _put_lanes(blocks: np.ndarray, values: np.ndarray, wanted: tuple[int, int]) -> None:
    """Writes (machines, width), which is ``wanted``, into (blocks, width, W)."""
    if values.shape != wanted:
        raise InvalidInput(f"what is recorded has shape {values.shape}; it must be {wanted}")
    whole, rest = divmod(len(values), W)
    blocks[:whole] = values[: whole * W].reshape(whole, W, values.shape[1]).transpose(0, 2, 1)
    if rest:
        blocks[whole, :, :rest] = values[whole * W :].T
