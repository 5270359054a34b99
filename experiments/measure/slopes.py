"""How the true gap of a run changes with a law's parameters: exact derivatives, while the machine runs.

A law's parameters change its command, that moves the head, the sensor reads another gap, and so on through filter,
table and law. Beside every machine run the *tangents* of all these numbers, one set for each parameter (forward mode,
Griewank and Walther 2008): what the parts of a period hand on, by :func:`envs.engine.adjoint.tangent`. The machine
itself is the kernel, which calls this module in its law's place, so a run with slopes is the same run to the bit. Of
few parameters this is cheaper than going backwards, and nothing has to be kept.

What passes nothing on: comparisons, the sheet under the plate's edge, the place that a hold goes back to, and every
mode of the supervisor but following and holding. The encoder, the D/A and the counter pass all on, as if they did not
round. A sample's own noise is left out of the slope of f(h), of which it changes about 1e-4.
"""

import functools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...envs.control.stack import Stack
from ...envs.engine.adjoint import tangent
from ...envs.engine.deck import Deck, places
from ...envs.engine.kernels import filled, specialise
from ...envs.engine.lanes import (
    U0,
    U1,
    UW,
    Layout,
    U,
    W,
    call,
    doubles,
    fields,
    load,
    part,
    row,
    rows,
    stage,
    store,
    words,
)
from ...envs.engine.quantity import InvalidInput
from ...envs.plant import calibration, filters, machine, sensor, supervisor, z_axis
from ...envs.plant.controller import PERIOD, SLOTS, Law, Privileged
from ...envs.plant.fleet import Fleet
from ...envs.plant.machine import DT, SUBSTEPS, Course, Moment

FILTER = ("ratio", "tau", "trust")
"""Numbers of a filter that have a slope; the others are whole, or are only compared with."""

# Tangents of one parameter: those of what goes on from period to period, and of the parameters themselves.
_layout = Layout()
P_LAW, P_FILTER = _layout.place(SLOTS["z"].params), _layout.place(rows(filters.Params))
S_LAW, S_FILTER = _layout.place(SLOTS["z"].state), _layout.place(rows(filters.State))
S_Z, DRIVE, S_GUARD = (_layout.place(rows(cls)) for cls in (z_axis.State, z_axis.Drive, supervisor.State))
SIGNALS, MOMENT, FOLD = (_layout.place(rows(cls)) for cls in (Privileged, Moment, filters.Fold))
PACE, SAMPLES = _layout.place(rows(z_axis.Pace)), _layout.place(filters.LONGEST)
# The machine's own numbers once more, on the way through a period.
Z_NOW, PACE_NOW = _layout.place(rows(z_axis.State)), _layout.place(rows(z_axis.Pace))
FOLD_NOW = _layout.place(rows(filters.Fold))
ROWS, STRIDE = _layout.rows, U(_layout.rows * W)

# What the machine was at the period's start.
_kept = Layout()
K_Z, K_LAW, K_FILTER = (_kept.place(n) for n in (rows(z_axis.State), SLOTS["z"].state, rows(filters.State)))
K_SLOPE = _kept.place(1)
KEPT = U(_kept.rows * W)


class Entries(NamedTuple):
    """The deck that stands in the place of a law's tables; arrays are float64."""

    law: int  # stage of the law itself, its tables and their size
    tables: int
    size: int
    machine: int  # words of the machine's deck
    kept: int  # (blocks, rows, W)
    tangents: int  # (blocks, parameters, ROWS, W)
    parameters: int
    ticks: int  # uint64 array (blocks,), periods that each block has lived through
    first: int  # the first of them that is kept
    steps: int  # how many are
    gaps: int  # (blocks, steps, parameters, W): slopes of the true gap at each period's end


D = places(Entries)
_DECK, _MACHINE = U(len(Entries._fields)), machine.DECK
_M = machine.D
_ANY = U(2**40)
_FIVE, _RISE, _MEMORY = U(5), U(supervisor.RISE_WINDOW), U(supervisor.MEMORY)
_FRESH, _FREQUENCY = (machine.signal(name) for name in ("fresh", "frequency"))
_HEIGHT, _RAW, _HZ, _POSITION, _SPEED, _COMMAND, _GAP, _HEAD, _VELOCITY, _ACCELERATION = (
    SIGNALS + row(Privileged, name)
    for name in (
        "height", "raw_height", "frequency", "head_position", "head_velocity", "command", "gap", "head", "velocity",
        "acceleration",
    )
)  # fmt: skip
_SENT = S_GUARD + row(supervisor.State, "command")
_MOTOR, _GATE_GAP, _M_GAP = (MOMENT + row(Moment, name) for name in ("gate_motor", "gate_gap", "gap"))
_POINTS = float(calibration.POINTS)
_NOTHING = supervisor.State(0.0, 0.0, 0.0, False, False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

# -------------------------------------------------------------------------------------------- parts, and their tangents


@part
def _sensed(p, s, m, c):
    """Frequency at the gap over the gate, Hz, without its noise; ``s``: after the sample."""
    h = max(machine.sensed_gap(m, c), 0.0)
    pulse = s.hit * p.impulse / (1.0 + h / p.falloff) if s.remaining > -1.0 else 0.0
    c5 = sensor.capacitance(p, max(h + pulse, sensor.LEAST_GAP), c.cover) + p.plasma + s.offset
    return sensor.oscillator(p, c5, p.drift * s.warm)


@part
def _answered(p, s, job, x):
    """The supervisor's answer while it follows or holds."""
    s, u = supervisor.follow(p, s, job, x)
    s, _ = supervisor.join(p, s, job, x, u)
    return s


@part
def _slope(frequencies, heights, at, frequency):
    """mm/Hz of the table beyond the entry ``at``; 0 outside of the table."""
    f0, f1 = frequencies[at], frequencies[at + U1]
    inside = frequency >= f0 and frequency <= f1
    return (heights[at + U1] - heights[at]) / (f1 - f0) if inside else 0.0


_step_dot = tangent(
    z_axis.step, of=("r", "s"), p=z_axis.Params, g=z_axis.Gains, r=z_axis.Pace, s=z_axis.State, share=float, dt=DT,
    bristles=True,
)  # fmt: skip
_accept_dot = tangent(z_axis.accept, of=("d", "command"), p=z_axis.Params, d=z_axis.Drive, command=float)
_pace_dot = tangent(z_axis.pace, of=("d",), p=z_axis.Params, d=z_axis.Drive)
_sensed_dot = tangent(_sensed, of=("m",), p=sensor.Params, s=sensor.State, m=Moment, c=Course)
_take_dot = tangent(
    filters.take, of=("p", "fold", "sample"), p=filters.Params, fold=filters.Fold, sample=float, age=float
)
_mean_dot = tangent(filters.mean, of=("p", "fold"), p=filters.Params, fold=filters.Fold)
_finish_dot = tangent(
    filters.finish, of=("p", "s", "windowed", "sample"), p=filters.Params, s=filters.State, windowed=float,
    sample=float, slope=float,
)  # fmt: skip
_answered_dot = tangent(
    _answered, of=("s", "x"), p=supervisor.Params, s=supervisor.State, job=supervisor.Orders, x=supervisor.View
)
_DOTS: tuple[Any, ...] = (
    _step_dot, _accept_dot, _pace_dot, _sensed_dot, _take_dot, _mean_dot, _finish_dot, _answered_dot,
)  # fmt: skip
_TEXTS = "".join(each.text for each in _DOTS)

# --------------------------------------------------------------------------------------------------- stages of a period


@stage
def _send(block, at, n, dots, t, kept, k):
    """The command has gone to the drive; the substeps begin."""
    for lane in range(n):
        a, o = at + lane, t + lane
        p, drive = load(z_axis.Params, block, a + machine.P_Z), load(z_axis.Drive, block, a + machine.DRIVE)
        sent = load(supervisor.State, block, a + machine.S_GUARD).command
        drive_ = _accept_dot(p, drive, sent, load(z_axis.Drive, dots, o + DRIVE), dots[o + _SENT])
        store(dots, o + DRIVE, drive_)
        store(dots, o + PACE, _pace_dot(p, drive, drive_))
        store(dots, o + PACE_NOW, z_axis.pace(p, drive))
        store(dots, o + Z_NOW, load(z_axis.State, kept, k + lane + K_Z))
        store(dots, o + MOMENT, Moment(0.0, 0.0, 0.0, 0.0, 0.0))


@part
def _substep(p, gains, pace, course, z, share, pace_, z_, m_):
    """One substep of a machine and of its tangents."""
    z_, head_ = _step_dot(p, gains, pace, z, share, pace_, z_)
    z, _ = z_axis.step(p, gains, pace, z, share, DT, True)
    weight = course.weight if share > course.opens else 0.0
    m_ = Moment(head_, head_, m_.gate_gap + weight * head_, m_.gate_motor + weight * z_.position, 0.0)
    return z, z_, m_


@stage
def _move(block, at, n, dots, t, first):
    """Five substeps."""
    k = np.float64(np.int64(first))
    for lane in range(n):
        a, o = at + lane, t + lane
        p, gains = load(z_axis.Params, block, a + machine.P_Z), load(z_axis.Gains, block, a + machine.GAINS)
        course, pace = load(Course, block, a + machine.COURSE), load(z_axis.Pace, dots, o + PACE_NOW)
        z, z_ = load(z_axis.State, dots, o + Z_NOW), load(z_axis.State, dots, o + S_Z)
        pace_, m_ = load(z_axis.Pace, dots, o + PACE), load(Moment, dots, o + MOMENT)
        z, z_, m_ = _substep(p, gains, pace, course, z, (k + 1.0) / SUBSTEPS, pace_, z_, m_)
        z, z_, m_ = _substep(p, gains, pace, course, z, (k + 2.0) / SUBSTEPS, pace_, z_, m_)
        z, z_, m_ = _substep(p, gains, pace, course, z, (k + 3.0) / SUBSTEPS, pace_, z_, m_)
        z, z_, m_ = _substep(p, gains, pace, course, z, (k + 4.0) / SUBSTEPS, pace_, z_, m_)
        z, z_, m_ = _substep(p, gains, pace, course, z, (k + 5.0) / SUBSTEPS, pace_, z_, m_)
        store(dots, o + Z_NOW, z)
        store(dots, o + S_Z, z_)
        store(dots, o + MOMENT, m_)


@stage
def _sense(block, at, n, dots, t, tick):
    """The newest sample; one that is not valid leaves the last one there, as in the machine."""
    now, last = SAMPLES + (tick & machine.SAMPLES_LAST) * UW, SAMPLES + ((tick - U1) & machine.SAMPLES_LAST) * UW
    for lane in range(n):
        a, o = at + lane, t + lane
        p, s = load(sensor.Params, block, a + machine.P_SENSOR), load(sensor.State, block, a + machine.S_SENSOR)
        m, c = load(Moment, block, a + machine.MOMENT), load(Course, block, a + machine.COURSE)
        f_ = _sensed_dot(p, s, m, c, load(Moment, dots, o + MOMENT))
        dots[o + now] = f_ if block[a + _FREQUENCY] > 0.0 else dots[o + last]


@stage
def _filter(block, at, n, dots, t, kept, k, tick, window):
    """Filter over the ring of samples; the slope of the result lies in ``FOLD``'s first row."""
    for lane in range(n):
        store(dots, t + lane + FOLD, filters.Fold(0.0, 0.0, 0.0, 0.0, 0.0))
        store(dots, t + lane + FOLD_NOW, filters.begin())
    for age in range(window):
        then, old = ((tick - age) & machine.SAMPLES_LAST) * UW, np.float64(np.int64(age))
        for lane in range(n):
            a, o = at + lane, t + lane
            p, p_ = load(filters.Params, block, a + machine.P_FILTER), load(filters.Params, dots, o + P_FILTER)
            fold, fold_ = load(filters.Fold, dots, o + FOLD_NOW), load(filters.Fold, dots, o + FOLD)
            sample, sample_ = block[a + machine.SAMPLES + then], dots[o + SAMPLES + then]
            store(dots, o + FOLD, _take_dot(p, fold, sample, old, p_, fold_, sample_))
            store(dots, o + FOLD_NOW, filters.take(p, fold, sample, old))
    now = (tick & machine.SAMPLES_LAST) * UW
    for lane in range(n):
        a, o = at + lane, t + lane
        p, p_ = load(filters.Params, block, a + machine.P_FILTER), load(filters.Params, dots, o + P_FILTER)
        fold, fold_ = load(filters.Fold, dots, o + FOLD_NOW), load(filters.Fold, dots, o + FOLD)
        s, s_ = load(filters.State, kept, k + lane + K_FILTER), load(filters.State, dots, o + S_FILTER)
        sample, sample_ = block[a + machine.SAMPLES + now], dots[o + SAMPLES + now]
        windowed, windowed_ = filters.mean(p, fold), _mean_dot(p, fold, p_, fold_)
        slope = kept[k + lane + K_SLOPE]
        s_, f_ = _finish_dot(p, s, windowed, sample, slope, p_, s_, windowed_, sample_)
        store(dots, o + S_FILTER, s_)
        dots[o + FOLD] = f_


@stage
def _report(block, at, n, dots, t, tick, frequencies, heights):
    """Signals for the law, from table, encoder and machine."""
    now = (tick & machine.SAMPLES_LAST) * UW
    for lane in range(n):
        a, o = at + lane, t + lane
        first = U(np.int64(load(machine.Start, block, a + machine.START).head * _POINTS))
        i, j = first + U(np.int64(block[a + machine.HINT])), first + U(np.int64(block[a + machine.RAW_HINT]))
        f_, raw_ = dots[o + FOLD], dots[o + SAMPLES + now]
        dots[o + _HEIGHT] = f_ * _slope(frequencies, heights, i, block[a + machine.FOLD])
        dots[o + _RAW] = raw_ * _slope(frequencies, heights, j, block[a + machine.SAMPLES + now])
        dots[o + _HZ] = raw_
        dots[o + _SPEED] = (dots[o + _MOTOR] - dots[o + _POSITION]) / PERIOD
        dots[o + _POSITION] = dots[o + _MOTOR]
        dots[o + _COMMAND] = dots[o + _SENT]
        z_ = load(z_axis.State, dots, o + S_Z)
        dots[o + _GAP], dots[o + _HEAD] = dots[o + _M_GAP], dots[o + _M_GAP]
        dots[o + _VELOCITY], dots[o + _ACCELERATION] = z_.velocity, z_.acceleration


@stage
def _answer(block, at, n, dots, t):
    """What the supervisor will make of the law's wish, whose slope lies in ``FOLD``'s first row."""
    for lane in range(n):
        a, o = at + lane, t + lane
        p, s, job = machine._guard(block, a)
        clock = U(np.int64(block[a + machine.CLOCK]))
        past = a + ((clock - _RISE) & machine.HISTORY_LAST) * UW
        before = a + ((clock - _MEMORY) & machine.HISTORY_LAST) * UW
        surface = block[past + machine.POSITIONS] - block[past + machine.HEIGHTS]
        x = machine._view(block, a, surface, block[before + machine.POSITIONS])
        hand = load(machine.Hand, block, a + machine.HAND)
        position_, speed_ = dots[o + _POSITION], dots[o + _SPEED]
        x_ = supervisor.View(
            dots[o + _HEIGHT], 0.0, 0.0, False, position_, position_, position_ - PERIOD * speed_,
            hand.gain * dots[o + FOLD], 0.0,
        )  # fmt: skip
        s_ = load(supervisor.State, dots, o + S_GUARD)
        if supervisor.is_following(s, job):
            store(dots, o + S_GUARD, _answered_dot(p, s, job, x, s_, x_))
        else:
            store(dots, o + S_GUARD, _NOTHING)


@stage
def _keep(block, at, n, kept, k):
    """The machine as the next period finds it."""
    for lane in range(n):
        a, o = at + lane, k + lane
        store(kept, o + K_Z, load(z_axis.State, block, a + machine.S_Z))
        store(kept, o + K_FILTER, load(filters.State, block, a + machine.S_FILTER))
        kept[o + K_SLOPE] = block[a + machine.SLOPE]
        for i in range(_S_ROWS):
            kept[o + K_LAW + i * UW] = block[a + machine.S_LAW + i * UW]


_S_ROWS = U(SLOTS["z"].state)
_CLEARED = U(ROWS) * UW

# Filled in for each law.
_control_dot: Any = None
_init: Any = None
_init_dot: Any = None
_Params: Any = None
_State: Any = None
_Signals: Any = None


@part
def _decide(block, at, n, dots, t, kept, k, tables, fresh):
    """The law's tangents; that of its wish goes to ``FOLD``'s first row."""
    for lane in range(n):
        a, o = at + lane, t + lane
        params, params_ = load(_Params, block, a + machine.P_LAW), load(_Params, dots, o + P_LAW)
        signals, signals_ = load(_Signals, block, a + machine.SIGNALS), load(_Signals, dots, o + SIGNALS)
        state, state_ = load(_State, kept, k + lane + K_LAW), load(_State, dots, o + S_LAW)
        if fresh:
            state, state_ = _init(params), _init_dot(params, params_)
        state_, wish_ = _control_dot(params, state, signals, tables, params_, state_, signals_)
        store(dots, o + S_LAW, state_)
        dots[o + FOLD] = wish_


def _stage(block_address, at, n, deck_address, unused):
    """The law itself, and then the tangents of the period that ends with it; ``deck_address``: of :class:`Entries`."""
    deck = words(deck_address, _DECK)
    call(deck[D.law], block_address, at, n, deck[D.tables], deck[D.size])
    block, whole = doubles(block_address, _ANY), words(deck[D.machine], _MACHINE)
    b, lane = at // machine.STRIDE, at % machine.STRIDE
    kept, dots, gaps = doubles(deck[D.kept], _ANY), doubles(deck[D.tangents], _ANY), doubles(deck[D.gaps], _ANY)
    tables, ticks = doubles(deck[D.tables], deck[D.size]), words(deck[D.ticks], _ANY)
    frequencies, heights = doubles(whole[_M.frequencies], _ANY), doubles(whole[_M.heights], _ANY)
    fresh, tick, k = block[at + _FRESH] > 0.5, ticks[b], b * KEPT + lane
    for j in range(deck[D.parameters]):
        t = (b * deck[D.parameters] + j) * STRIDE + lane
        if fresh:
            for i in range(_CLEARED // UW):
                if i * UW < P_LAW or i * UW >= S_LAW:
                    dots[t + i * UW] = 0.0
        else:
            _send(block, at, n, dots, t, kept, k)
            for first in range(U0, U(SUBSTEPS), _FIVE):
                _move(block, at, n, dots, t, first)
            _sense(block, at, n, dots, t, tick)
            _filter(block, at, n, dots, t, kept, k, tick, whole[_M.window])
            _report(block, at, n, dots, t, tick, frequencies, heights)
            place = tick - deck[D.first]
            if place < deck[D.steps]:
                here = ((b * deck[D.steps] + place) * deck[D.parameters] + j) * UW
                for i in range(n):
                    gaps[here + i] = dots[t + i + _GAP]
        _decide(block, at, n, dots, t, kept, k, tables, fresh)
        _answer(block, at, n, dots, t)
    _keep(block, at, n, kept, k)
    if not fresh:
        ticks[b] = tick + U1


# ------------------------------------------------------------------------------------------------- as Python sees them


def refusal(stack: Stack, names: tuple[str, ...]) -> str:
    """Why there is no slope by these parameters of a stack; empty if there is."""
    law, p = stack.law, stack.part("filter") if stack.slot == "z" else None
    if stack.slot != "z" or stack.python is not None:
        return f"'{stack.name}' is no compiled law of the slot z"
    if stack.pilot is not None:
        return f"the pilot of '{stack.name}' has no derivative"
    if law.memory:
        return f"the law of '{stack.name}' keeps a memory, at places that are known only while it runs"
    assert p is not None
    if filters.validated(p).trim > 1.0:
        return "a filter that leaves out more than one sample at each end, such as a median, ranks them"
    for name in names:
        group, _, field = name.partition(".")
        if group == "filter" and field not in FILTER:
            return f"{name} is a choice, a whole number, or only compared with"
        if group not in ("law", "filter"):
            return f"{name} is outside of filter and law"
        quantity = stack.parameters()[name].quantity
        if quantity.whole or quantity.choices:
            return f"{name} is {'a choice' if quantity.choices else 'a whole number'}"
    try:
        _derived(law)
    except InvalidInput as error:
        return str(error)
    return ""


@functools.cache
def _derived(law: Law) -> tuple[Any, Any]:
    """Tangents of a law's ``init`` and ``control``."""
    names, (own,) = _names(law.control), _names(law.init)
    if len(names) != 4:
        raise InvalidInput(f"control of '{law.name}' takes {', '.join(names)}, not params, state, signals, tables")
    kinds = dict(zip(names, (law.Params, law.State, law.signals, np.ndarray), strict=True))
    return tangent(law.init, of=(own,), **{own: law.Params}), tangent(law.control, of=names[:3], **kinds)


def _names(function: Any) -> list[str]:
    code = getattr(function, "py_func", function).__code__
    return list(code.co_varnames[: code.co_argcount])


class Slopes:
    """The tangents of a fleet; as a context, within which its machines begin and run with them.

    Args:
        fleet: machines that share a law.
        stack: whose law it is.
        names: parameters of the stack by which the slopes are, such as ``law.kp``.
        steps: periods of which they are kept.

    Raises:
        InvalidInput: there is none by one of them, and why.
    """

    def __init__(self, fleet: Fleet, stack: Stack, names: tuple[str, ...], steps: int) -> None:
        if why := refusal(stack, names):
            raise InvalidInput(f"no slope of '{stack.name}' by {', '.join(names)}: {why}")
        self.fleet, self.names, law = fleet, names, stack.law
        init, control = _derived(law)
        text = Path(__file__).read_text(encoding="utf-8") + _TEXTS + init.text + control.text + law.source
        contract = {"_Params": law.Params, "_State": law.State, "_Signals": law.signals}
        made = _compiled(law.name, text, init, control, law.init, tuple(contract.items()))
        self.tangents = np.zeros((fleet.blocks, len(names), ROWS, W))
        for j, name in enumerate(names):
            group, _, field = name.partition(".")
            start, cls = (P_LAW, law.Params) if group == "law" else (P_FILTER, filters.Params)
            self.tangents[:, j, int(start) // W + fields(cls).index(field)] = 1.0
        self.gaps = np.zeros((fleet.blocks, steps, len(names), W))
        self._ticks = np.zeros(fleet.blocks, np.uint64)
        self._stage, tables = made.address, fleet.deck.owned("law_tables")
        self.deck = Deck(
            Entries, law=fleet.deck["law"], tables=tables, size=fleet.deck["law_size"], machine=fleet.deck.words,
            kept=np.zeros((fleet.blocks, _kept.rows, W)), tangents=self.tangents, parameters=len(names),
            ticks=self._ticks, steps=steps, gaps=self.gaps,
        )  # fmt: skip

    def __enter__(self) -> "Slopes":
        self._ticks[:] = self.fleet.tick
        self.deck["first"] = self.fleet.tick
        self.fleet.deck["law"], self.fleet.deck["law_tables"] = self._stage, self.deck
        return self

    def __exit__(self, *_: object) -> None:
        """The fleet runs its law alone again."""
        self.fleet.deck["law"], self.fleet.deck["law_tables"] = self.deck["law"], self.deck.owned("tables")

    def of_gap(self) -> np.ndarray:
        """Slopes of the true gap at the end of each period, mm per unit, shape (parameters, periods, machines)."""
        blocks, steps, count, _ = self.gaps.shape
        return self.gaps.transpose(2, 1, 0, 3).reshape(count, steps, blocks * W)[:, :, : self.fleet.size]


@functools.cache
def _compiled(name: str, text: str, init: Any, control: Any, law_init: Any, contract: tuple[Any, ...]) -> Any:
    contents = {"_control_dot": control, "_init": law_init, "_init_dot": init, **dict(contract)}
    decide = part(filled(_decide, name, **contents))
    return specialise(_stage, name.replace("-", "_").replace(":", "_"), text, _decide=decide)
