"""A follower alone, as it stands on a machine's own control: from a count to a command, once a millisecond.

The kernel does this for blocks of machines, stage by stage (:mod:`machine`); here one function does it for one, from
the same parts: filter, look-up, signals, law, supervisor. C code is made of it (:mod:`kerfgym.envs.engine.c99`), and it
runs in Python as well. What an input may be that no machine should give is settled here, too:

- a frequency that is no number, negative or endless is none at all, which is contact: the supervisor retracts;
- any other input that is no number or endless is that of the period before;
- a law whose wish is no number begins anew in the next period; in this one the supervisor stands still.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..engine.lanes import part
from ..engine.quantity import InvalidInput
from ..plant import calibration, filters, supervisor
from ..plant.controller import PERIOD, Law, Preview, Privileged, Sensed, SheetAhead, Truth
from ..plant.machine import HISTORY

SAMPLES = filters.LONGEST
"""Counts that are kept for the filter."""

POINTS = calibration.POINTS
"""Entries of the calibration table."""

SEARCHED = 10
"""Halvings after which the table's entry is found: 2^10 > POINTS."""

UNKNOWN_SLOPE = 1e9
"""Hz/mm before the first reading: nothing is a jump."""


class Input(NamedTuple):
    """What the control knows each millisecond."""

    frequency: float = 0.0  # Hz, newest count; 0 at contact
    encoder: float = 0.0  # mm, height of the head at the centre of the gate, up positive
    feed: float = 0.0  # mm/s along the path
    place: float = 0.0  # mm along the path, of the lap where it is travelled again and again
    lap: float = 0.0  # laps that are over
    orders: supervisor.Orders = supervisor.Orders()  # what the operator and the set-up ask for


class State(NamedTuple):
    """What is kept from period to period, beside the law's own."""

    sample: float = 0.0  # place of the newest count
    moment: float = 0.0  # place of the newest height
    begins: bool = True  # the next period is the first
    lost: bool = False  # the law's last wish was no number
    slope: float = UNKNOWN_SLOPE  # Hz/mm, of the table at the last reading
    filter: filters.State = filters.State()
    guard: supervisor.State = supervisor.State()
    last: Input = Input()  # of the period before


class Ahead(NamedTuple):
    """What a law that knows the sheet ahead is told beside."""

    input: Input = Input()
    ahead: SheetAhead = SheetAhead()


class Known(NamedTuple):
    """What a law that knows the truth is told beside."""

    input: Input = Input()
    ahead: SheetAhead = SheetAhead()
    truth: Truth = Truth()


@part
def finite(x, otherwise):
    """``x``, or something else where it is no number or endless."""
    return x if abs(x) < np.inf else otherwise


@part
def sane(given, last):
    """The input with what no machine should give replaced."""
    frequency, orders, before = finite(given.frequency, 0.0), given.orders, last.orders
    return Input(
        frequency=frequency if frequency > 0.0 else 0.0,
        encoder=finite(given.encoder, last.encoder),
        feed=finite(given.feed, last.feed),
        place=finite(given.place, last.place),
        lap=finite(given.lap, last.lap),
        orders=supervisor.Orders(
            request=finite(orders.request, before.request),
            target=finite(orders.target, before.target),
            set_height=finite(orders.set_height, before.set_height),
            hole_guard=orders.hole_guard,
            switch=finite(orders.switch, before.switch),
            low=finite(orders.low, before.low),
            high=finite(orders.high, before.high),
            protect=finite(orders.protect, before.protect),
            rise=finite(orders.rise, before.rise),
            rise_speed=finite(orders.rise_speed, before.rise_speed),
            indexed=orders.indexed,
            most_frequency=finite(orders.most_frequency, before.most_frequency),
        ),
    )


@part
def behind(place, by, size):
    """The place in a ring of ``size`` that lies ``by`` behind another."""
    there = place - by
    return there + size if there < 0 else there


@part
def length(p):
    """Counts in the filter's window, whatever it was set to."""
    return min(max(int(p.window), 1), SAMPLES)


@part
def ranked(p, samples, now):
    """Mean of the window without the smallest and largest, by rank; the median among them, Hz."""
    total, window = 0.0, length(p)
    for age in range(window):
        rank, x = 0.0, samples[behind(now, age, SAMPLES)]
        for other in range(window):
            y = samples[behind(now, other, SAMPLES)]
            rank += 1.0 if y < x or (y == x and other < age) else 0.0
        total += filters.kept(p, rank, np.float64(age)) * x
    return total / (p.window - 2.0 * p.trim)


@part
def filtered(p, s, samples, now, slope):
    """The filter's state and output, Hz."""
    fold = filters.begin()
    for age in range(length(p)):
        fold = filters.take(p, fold, samples[behind(now, age, SAMPLES)], np.float64(age))
    many = p.trim > 1.0 and (p.kind == filters.IMPROVED or p.kind == filters.MEDIAN)
    windowed = ranked(p, samples, now) if many else filters.mean(p, fold)
    return filters.finish(p, s, windowed, samples[now], slope)


@part
def entry(frequencies, frequency):
    """The last entry of the table at or below a frequency, but for the table's last."""
    low, half = 0, 512
    for _ in range(SEARCHED):
        middle = low + half
        if middle < POINTS - 1 and frequencies[middle] <= frequency:
            low = middle
        half = half // 2
    return low


@part
def viewed(x, guard, fall, refuge, wish):
    """What the supervisor reads."""
    encoder = x.head_position - guard.offset
    return supervisor.View(
        height=x.height,
        fall=fall,
        refuge=refuge,
        valid=x.valid,
        head_position=x.head_position,
        encoder=encoder,
        last_encoder=encoder - x.head_velocity * PERIOD,
        wish=wish,
        frequency=x.frequency,
    )


@part
def supervised(p, guard, orders, x, fall, refuge, wish):
    """The supervisor's state and command, mm/s."""
    guard, u = supervisor.follow(p, guard, orders, viewed(x, guard, fall, refuge, wish))
    if not supervisor.is_following(guard, orders):
        guard, u = supervisor.errand(p, guard, orders, viewed(x, guard, 0.0, 0.0, wish), u)
    return supervisor.join(p, guard, orders, viewed(x, guard, 0.0, 0.0, wish), u)


@part
def begun(state, given, samples):
    """The state in the first period: the ring and the recursive filters start from its count."""
    for i in range(SAMPLES):
        samples[i] = given.frequency
    mode = supervisor.FOLLOW if given.orders.request == supervisor.FOLLOW else supervisor.STOP
    guard = supervisor.State()._replace(mode=mode, offset=state.guard.offset)
    return State(0.0, 0.0, True, False, UNKNOWN_SLOPE, filters.State(given.frequency, 1e6, 0.0, 0.0), guard, given)


@part
def read(filter_settings, table_settings, state, given, samples, frequencies, heights):
    """Counts to heights: the state, and the signals of this period."""
    if state.begins:
        state = begun(state, given, samples)
    now = min(max(int(state.sample), 0), SAMPLES - 1)
    now = now if state.begins else (now + 1 if now < SAMPLES - 1 else 0)
    before = samples[behind(now, 1, SAMPLES)]
    samples[now] = given.frequency if given.frequency > 0.0 else before
    after, frequency = filtered(filter_settings, state.filter, samples, now, state.slope)
    at, raw_at = entry(frequencies, frequency), entry(frequencies, samples[now])
    height, slope = calibration.between(table_settings, frequencies, heights, at, frequency)
    raw_height, _ = calibration.between(table_settings, frequencies, heights, raw_at, samples[now])
    # As in the kernel, a new set height acts on the law one period after the supervisor has it.
    s, orders = state.guard, state.last.orders
    x = Sensed(
        height=height,
        raw_height=raw_height,
        frequency=given.frequency,
        valid=given.frequency > 0.0,
        set_height=orders.protect if s.mode == supervisor.PROTECT else orders.set_height,
        head_position=given.encoder + s.offset,
        head_velocity=(given.encoder - state.last.encoder) / PERIOD,
        command=s.command,
        mode=s.mode,
        override=s.override,
        captured=s.captured,
        fresh=state.begins or state.lost,
        feed=given.feed,
        place=given.place,
        lap=given.lap,
    )
    return state._replace(sample=np.float64(now), slope=slope, filter=after), x


@part
def guarded(p, state, given, x, wish, heights, positions):
    """Law's wish to command: the state, and what goes to the drive, mm/s."""
    now = min(max(int(state.moment), 0), HISTORY - 1)
    now = now if state.begins else (now + 1 if now < HISTORY - 1 else 0)
    if state.begins:
        for i in range(HISTORY):
            heights[i], positions[i] = x.height, x.head_position
    heights[now], positions[now] = x.height, x.head_position
    past = behind(now, supervisor.RISE_WINDOW, HISTORY)
    fall = (positions[past] - heights[past]) - (x.head_position - x.height)
    refuge = positions[behind(now, supervisor.MEMORY, HISTORY)]
    guard, command = supervised(p, state.guard, given.orders, x, fall, refuge, wish)
    lost = not abs(wish) < np.inf
    return state._replace(moment=np.float64(now), begins=False, lost=lost, guard=guard, last=given), command


class Firmware(NamedTuple):
    """A follower alone.

    ``step(settings, state, law_state, input, samples, heights, positions, frequencies, table, tables, memory)`` gives
    state, law's state and command, mm/s.
    """

    Settings: Any
    Input: Any
    step: Callable[..., Any]


@part
def _sensor(x, more):
    return x


@part
def _preview(x, more):
    return Preview(*x, *more.ahead)


@part
def _privileged(x, more):
    return Privileged(*x, *more.ahead, *more.truth)


@part
def _plainly(more):
    return more


@part
def _within(more):
    return more.input


INPUTS = {
    "sensor": (Input, _sensor, _plainly),
    "preview": (Ahead, _preview, _within),
    "privileged": (Known, _privileged, _within),
}
"""By information class what a law is told, its signals, and the machine's part of it."""


def of(law: Law) -> Firmware:
    """The follower with a law.

    Raises:
        InvalidInput: a law of another slot.
    """
    if law.slot != "z":
        raise InvalidInput(f"law '{law.name}' drives slot '{law.slot}', not z")
    told, see, inner = INPUTS[law.information]
    init, control, own = law.init, law.control, law.Params

    class Settings(NamedTuple):
        """All that can be set."""

        filter: filters.Params
        table: calibration.Params
        guard: supervisor.Params
        law: own  # type: ignore[valid-type]

    @part
    def step(settings, state, law_state, given, samples, past_heights, past_positions, frequencies, heights, tables):
        """One millisecond: from what is measured now to the command that goes to the drive, mm/s."""
        sensed = sane(inner(given), state.last)
        state, x = read(settings.filter, settings.table, state, sensed, samples, frequencies, heights)
        law_state = init(settings.law) if x.fresh else law_state
        law_state, wish = control(settings.law, law_state, see(x, given), tables)
        state, command = guarded(settings.guard, state, sensed, x, wish, past_heights, past_positions)
        return state, law_state, command

    @part
    def step_with_memory(
        settings, state, law_state, given, samples, past_heights, past_positions, frequencies, heights, tables, memory
    ):
        """One millisecond: from what is measured now to the command that goes to the drive, mm/s."""
        sensed = sane(inner(given), state.last)
        state, x = read(settings.filter, settings.table, state, sensed, samples, frequencies, heights)
        law_state = init(settings.law) if x.fresh else law_state
        law_state, wish = control(settings.law, law_state, see(x, given), tables, memory)
        state, command = guarded(settings.guard, state, sensed, x, wish, past_heights, past_positions)
        return state, law_state, command

    return Firmware(Settings, told, step_with_memory if law.memory else step)
