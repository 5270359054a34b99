"""What a policy does to the height-following machine and what it gets back: stages before and after each period.

The same stages serve one environment and thousands. Each fills arrays of the whole batch, one loop over the lanes for
each number, so that they cost little beside the machine.
"""

from typing import NamedTuple

import numpy as np

from ..engine import lanes
from ..engine.lanes import (
    U1,
    UW,
    U,
    clip,
    doubles,
    load,
    logarithm,
    logarithm32,
    part,
    scratch,
    singles,
    stage,
    words,
)
from ..engine.quantity import in_order
from ..plant import filters, machine, supervisor
from ..plant.controller import PERIOD
from . import weights
from .task import ANY, IO, IO_SIZE, LIMIT, OBSERVATIONS, SHEET, Actions, Signals, Task, end

DIRECT_SPEED, RESIDUAL_SPEED = 200.0, 50.0
"""mm/s of head velocity that an action of 1 means, alone or beside a base controller's (Johannink et al. 2019)."""

LONGEST_WINDOW, LARGEST_TRIM = 15, 3
LEAST_GAIN, LARGEST_GAIN = 0.2, 3.0
"""Limits of ``control="schedule"``."""

TOLERANCE = 0.002
"""mm; the unit of the observed errors, and of those that the reward charges unless it is told otherwise."""
_PER_TOLERANCE = 1.0 / TOLERANCE  # multiplying is quicker than dividing

ERROR_LAGS = (0, 1, 2, 3, 5, 8)
SURFACE_LAGS = (0, 1, 2, 3, 5, 8, 13)
SPEED_LAGS = (0, 1, 2, 4)
COMMAND_LAGS = (0, 1, 2, 3)
RAW_HISTORY = 8

SOON, LATE = 64.0, 256.0
"""Periods over which running means are taken."""

FEATURES = (
    *(f"error_{k}" for k in ERROR_LAGS),
    *(f"surface_step_{a}_{b}" for a, b in zip(SURFACE_LAGS[:-1], SURFACE_LAGS[1:], strict=True)),
    *(f"speed_{k}" for k in SPEED_LAGS),
    *(f"command_{k}" for k in COMMAND_LAGS),
    *in_order("base_command set_height override captured holding mean_motion_64 restless_64 restless_256"),
    *in_order("error_size_64 error_size_256 mean_error_64 mean_error_256"),
)
"""Names of the normalised features, in order."""

RAW = (
    *(f"height_{k}" for k in range(RAW_HISTORY)),
    *(f"raw_height_{k}" for k in range(RAW_HISTORY)),
    *(f"head_position_{k}" for k in range(RAW_HISTORY)),
    *(f"command_{k}" for k in range(RAW_HISTORY)),
    *in_order("base_command set_height feed override captured mode"),
)
"""Names of the physical signals, in order: newest first; mm and mm/s."""

INFO = in_order(
    "true_gap measured_height true_error reported_error cost scored mode override distance reward_error "
    "reward_rate reward_collision weighted_error weighted_rate weighted_collision"
)
"""What ``info`` holds, in order; mm, terms of the reward raw and weighted."""


class Reward(NamedTuple):
    """Weights of the reward's terms (0 switches one off), and the tolerance within which an error matters little."""

    error: float = 0.3  # per unit of log(1 + |true error|/tolerance), while cutting
    rate: float = 0.3  # per (change of command/10 mm/s)²
    collision: float = 100.0  # once
    tolerance: float = TOLERANCE  # mm; the unit of the error, which is felt logarithmically beyond it


class Memory(NamedTuple):
    """What the features remember of an episode: running means, over SOON or LATE periods."""

    motion_soon: float = 0.0  # mm in 8 periods, of the head
    restless_soon: float = 0.0  # compressed: size of how its motion differs from that
    restless_late: float = 0.0
    size_soon: float = 0.0  # compressed: size of the measured error
    size_late: float = 0.0
    error_soon: float = 0.0  # mm, measured
    error_late: float = 0.0


_RAW, _SHEET = U(OBSERVATIONS.index("raw")), U(OBSERVATIONS.index(SHEET))
_SPEED = 0.01 / PERIOD  # of a millimetre per period, in 100 mm/s
_ROWS = len(RAW) * lanes.W
_INFO = U(len(INFO))
_MEMORY_ROWS, _MEANS = U(FEATURES.index("mean_motion_64")), U(len(Memory._fields))
_MOTION, _ERROR_SOON, _ERROR_LATE = (
    U(FEATURES.index(name)) * UW for name in ("mean_motion_64", "mean_error_64", "mean_error_256")
)
_RAW_HEIGHTS, _POSITIONS, _COMMANDS, _BASE, _TO_SET, _TO_FEED, _TO_OVERRIDE, _TO_CAPTURED, _TO_MODE = (
    U(RAW.index(name)) * UW
    for name in ("raw_height_0", "head_position_0", "command_0", *RAW[RAW.index("base_command") :])
)
_COLLIDED = machine.TALLY + lanes.row(machine.Tally, "collided")
_SCORED = machine.COURSE + lanes.row(machine.Course, "scored")
_HERE = machine.S_PATH + lanes.row(machine.path.State, "here")
_GAP, _HEIGHT, _SET, _MODE, _OVERRIDE, _CAPTURED, _FEED, _FRESH = (
    machine.signal(name) for name in ("gap", "height", "set_height", "mode", "override", "captured", "feed", "fresh")
)


# --------------------------------------------------------------------------------------------------- the action


def act(block_address, at, n, io_address, first):
    """Stage before a period: the action becomes a change of the stack or of its command."""
    block, io = doubles(block_address, ANY), words(io_address, IO_SIZE)
    actions, count = singles(io[IO.actions], ANY), io[IO.width]
    if io[IO.control] == U(2):
        schedule(block, at, n, actions, first)
    else:
        speed = DIRECT_SPEED if io[IO.control] == U(0) else RESIDUAL_SPEED
        for lane in range(n):
            x = clip(np.float64(actions[(first + lane) * count]), -1.0, 1.0)
            lanes.store(block, at + lane + machine.HAND, machine.Hand(1.0, speed * x))


@stage
def schedule(block, at, n, actions, first):
    """The action sets the filter's window and trim, and the gain of the base controller."""
    for lane in range(n):
        a, i = at + lane, (first + lane) * U(3)
        x, y = clip(np.float64(actions[i]), -1.0, 1.0), clip(np.float64(actions[i + U1]), -1.0, 1.0)
        z = clip(np.float64(actions[i + U(2)]), -1.0, 1.0)
        window = np.rint(1.0 + 0.5 * (x + 1.0) * (LONGEST_WINDOW - 1))
        trim = min(np.rint(0.5 * (y + 1.0) * LARGEST_TRIM), np.floor(0.5 * (window - 1.0)))
        p = load(filters.Params, block, a + machine.P_FILTER)
        lanes.store(
            block,
            a + machine.P_FILTER,
            filters.Params(filters.IMPROVED, window, trim, p.ratio, p.tau, p.jump, p.hold, p.trust),
        )
        gain = LEAST_GAIN + 0.5 * (z + 1.0) * (LARGEST_GAIN - LEAST_GAIN)
        lanes.store(block, a + machine.HAND, machine.Hand(gain, 0.0))


# ---------------------------------------------------------------------------------------------- the observation


_FIFTH, _UNIT = np.float32(0.2), np.float32(1.0)


@part
def _symlog(x):
    """x in units of the tolerance, compressed: sign·ln(1 + |x|)/5; in single precision, as policies read it."""
    s = logarithm32(_UNIT + np.float32(abs(x) * _PER_TOLERANCE)) * _FIFTH
    return s if x >= 0.0 else -s


@part
def _back(tick, k):
    """Offset in a history ring of the entry ``k`` periods ago."""
    return ((tick - U(k)) & machine.HISTORY_LAST) * UW


# Numbers are gathered in rows of lanes, which vectorises, and then laid out machine by machine, as policies read them.


@stage
def sheets(block, at, n, rows, tick):
    """The sheet at each of SURFACE_LAGS as far as it is known now, in the rows that the memory has later.

    An impulse on the sensor does not last, a step does: a reading that has neighbours is the median of three, or of
    five, with those before and after it.
    """
    for lane in range(n):
        a = at + lane
        s0, s1, s2 = _read(block, a, tick, 0), _read(block, a, tick, 1), _read(block, a, tick, 2)
        s3, s4, s5 = _read(block, a, tick, 3), _read(block, a, tick, 4), _read(block, a, tick, 5)
        s6, s7, s8 = _read(block, a, tick, 6), _read(block, a, tick, 7), _read(block, a, tick, 8)
        s9, s10, s11 = _read(block, a, tick, 9), _read(block, a, tick, 10), _read(block, a, tick, 11)
        s12, s13, s14 = _read(block, a, tick, 12), _read(block, a, tick, 13), _read(block, a, tick, 14)
        s15 = _read(block, a, tick, 15)
        rows[_kept(0, lane)] = s0
        rows[_kept(1, lane)] = _middle(s0, s1, s2)
        rows[_kept(2, lane)] = _middle(s1, s2, s3)
        rows[_kept(3, lane)] = _median(s1, s2, s3, s4, s5)
        rows[_kept(4, lane)] = _median(s3, s4, s5, s6, s7)
        rows[_kept(5, lane)] = _median(s6, s7, s8, s9, s10)
        rows[_kept(6, lane)] = _median(s11, s12, s13, s14, s15)


@part
def _read(block, a, tick, k):
    """The sheet as the sensor saw it ``k`` periods ago: encoder − unfiltered height, mm."""
    then = a + _back(tick, k)
    return block[then + machine.POSITIONS] - block[then + machine.RAW_HEIGHTS]


@part
def _middle(a, b, c):
    """Median of three."""
    return max(min(a, b), min(max(a, b), c))


@part
def _median(a, b, c, d, e):
    """Median of five: that of the fifth and the two middle ones of the others."""
    return _middle(max(min(a, b), min(c, d)), min(max(a, b), max(c, d)), e)


@part
def _sheet(rows, j, lane):
    """The sheet at the j-th of SURFACE_LAGS."""
    return rows[_kept(j, lane)]


@part
def features(block, at, n, rows, tick):
    """Normalised features, one row of lanes each."""
    now, ago_1, ago_2, ago_3 = at + _back(tick, 0), at + _back(tick, 1), at + _back(tick, 2), at + _back(tick, 3)
    ago_4, ago_5, ago_8 = at + _back(tick, 4), at + _back(tick, 5), at + _back(tick, 8)
    for lane in range(n):  # written out, because the vectoriser does not look into inner loops
        height = block[at + _SET + lane]
        _put(rows, 0, lane, _symlog(block[now + machine.HEIGHTS + lane] - height))
        _put(rows, 1, lane, _symlog(block[ago_1 + machine.HEIGHTS + lane] - height))
        _put(rows, 2, lane, _symlog(block[ago_2 + machine.HEIGHTS + lane] - height))
        _put(rows, 3, lane, _symlog(block[ago_3 + machine.HEIGHTS + lane] - height))
        _put(rows, 4, lane, _symlog(block[ago_5 + machine.HEIGHTS + lane] - height))
        _put(rows, 5, lane, _symlog(block[ago_8 + machine.HEIGHTS + lane] - height))
        _put(rows, 6, lane, _symlog(_sheet(rows, 0, lane) - _sheet(rows, 1, lane)))
        _put(rows, 7, lane, _symlog(_sheet(rows, 1, lane) - _sheet(rows, 2, lane)))
        _put(rows, 8, lane, _symlog(_sheet(rows, 2, lane) - _sheet(rows, 3, lane)))
        _put(rows, 9, lane, _symlog(_sheet(rows, 3, lane) - _sheet(rows, 4, lane)))
        _put(rows, 10, lane, _symlog(_sheet(rows, 4, lane) - _sheet(rows, 5, lane)))
        _put(rows, 11, lane, _symlog(_sheet(rows, 5, lane) - _sheet(rows, 6, lane)))
        _put(rows, 12, lane, _speed(block, now + lane, ago_1 + lane))
        _put(rows, 13, lane, _speed(block, ago_1 + lane, ago_2 + lane))
        _put(rows, 14, lane, _speed(block, ago_2 + lane, ago_3 + lane))
        _put(rows, 15, lane, _speed(block, ago_4 + lane, ago_5 + lane))
        _put(rows, 16, lane, 0.01 * block[now + machine.COMMANDS + lane])
        _put(rows, 17, lane, 0.01 * block[ago_1 + machine.COMMANDS + lane])
        _put(rows, 18, lane, 0.01 * block[ago_2 + machine.COMMANDS + lane])
        _put(rows, 19, lane, 0.01 * block[ago_3 + machine.COMMANDS + lane])
        _put(rows, 20, lane, clip(0.01 * block[at + machine.WISH + lane], -LIMIT, LIMIT))
        _put(rows, 21, lane, height)
        _put(rows, 22, lane, block[at + _OVERRIDE + lane])
        _put(rows, 23, lane, block[at + _CAPTURED + lane])
        _put(rows, 24, lane, 1.0 if block[at + _MODE + lane] == supervisor.HOLD else 0.0)


@stage
def remember(block, at, n, rows, tick, memory, machines):
    """The features that need a memory: how the head has moved of late, how restlessly, and how large errors were."""
    now, ago_8 = at + _back(tick, 0), at + _back(tick, 8)
    for j in range(_MEANS):
        for lane in range(n):  # no memory where an episode begins
            rows[(_MEMORY_ROWS + j) * UW + lane] = (1.0 - block[at + _FRESH + lane]) * memory[j * machines + lane]
    for lane in range(n):
        moved = block[now + machine.POSITIONS + lane] - block[ago_8 + machine.POSITIONS + lane]
        error = block[now + machine.HEIGHTS + lane] - block[at + _SET + lane]
        size = abs(_symlog(error))
        motion = _mean(rows, 0, lane, moved, 1.0 / SOON)
        restless = abs(_symlog(moved - motion))
        _mean(rows, 1, lane, restless, 1.0 / SOON)
        _mean(rows, 2, lane, restless, 1.0 / LATE)
        _mean(rows, 3, lane, size, 1.0 / SOON)
        _mean(rows, 4, lane, size, 1.0 / LATE)
        _mean(rows, 5, lane, error, 1.0 / SOON)
        _mean(rows, 6, lane, error, 1.0 / LATE)
    for j in range(_MEANS):
        for lane in range(n):
            memory[j * machines + lane] = rows[(_MEMORY_ROWS + j) * UW + lane]
    for lane in range(n):
        rows[_MOTION + lane] = _symlog(rows[_MOTION + lane])
        rows[_ERROR_SOON + lane] = _symlog(rows[_ERROR_SOON + lane])
        rows[_ERROR_LATE + lane] = _symlog(rows[_ERROR_LATE + lane])


@part
def _mean(rows, j, lane, now, share):
    """Takes one more into a running mean: y += share·(x − y)."""
    at = _kept(j, lane)
    mean = rows[at] + share * (now - rows[at])
    rows[at] = mean
    return mean


@part
def _kept(j, lane):
    """Place of the j-th row for what an environment remembers; until it is needed, of surfaces in between."""
    return (_MEMORY_ROWS + U(j)) * UW + lane


@part
def _put(rows, j, lane, x):
    rows[U(j) * UW + lane] = x


@part
def _speed(block, then, before):
    """Head velocity from the encoder, normalised."""
    moved = block[then + machine.POSITIONS] - block[before + machine.POSITIONS]
    return clip(_SPEED * moved, -LIMIT, LIMIT)


@stage
def raw_signals(block, at, n, rows, tick):
    """Physical signals, one row of lanes each."""
    for k in range(RAW_HISTORY):
        then, o = at + _back(tick, k), U(k) * UW
        _copy(block, then + machine.HEIGHTS, n, rows, o)
        _copy(block, then + machine.RAW_HEIGHTS, n, rows, o + _RAW_HEIGHTS)
        for lane in range(n):
            moved = block[then + lane + machine.POSITIONS] - block[at + lane + machine.ORIGIN]
            rows[o + _POSITIONS + lane] = clip(moved, -200.0, 200.0)
        _copy(block, then + machine.COMMANDS, n, rows, o + _COMMANDS)
    for lane in range(n):
        rows[_BASE + lane] = clip(block[at + lane + machine.WISH], -2000.0, 2000.0)
    _copy(block, at + _SET, n, rows, _TO_SET)
    _copy(block, at + _FEED, n, rows, _TO_FEED)
    _copy(block, at + _OVERRIDE, n, rows, _TO_OVERRIDE)
    _copy(block, at + _CAPTURED, n, rows, _TO_CAPTURED)
    _copy(block, at + _MODE, n, rows, _TO_MODE)


@part
def _copy(block, row, n, out, o):
    for lane in range(n):
        out[o + lane] = block[row + lane]


@stage
def lay_out(rows, n, out, o, size):
    """Rows of lanes to one machine after the other, from ``out[o]`` on."""
    for j in range(size):
        for lane in range(n):
            out[o + j + lane * size] = rows[j * UW + lane]


# ---------------------------------------------------------------------------------------- the reward and the info


@part
def judge(block, at, n, rows, worth, tick):
    """The entries of :data:`INFO`, one row of lanes each."""
    now, before = at + machine.COMMANDS + _back(tick, 0), at + machine.COMMANDS + _back(tick, 1)
    error_weight, rate_weight, collision_weight = -worth[0], -worth[1], -worth[2]
    per_tolerance = 1.0 / worth[3]
    for lane in range(n):
        a = at + lane
        gap, height, wanted, collided = block[a + _GAP], block[a + _HEIGHT], block[a + _SET], block[a + _COLLIDED]
        scored = block[a + _SCORED]
        felt = logarithm(1.0 + abs(gap - wanted) * per_tolerance) if scored > 0.5 else 0.0
        change = 0.1 * (block[now + lane] - block[before + lane])
        _put(rows, 0, lane, gap)
        _put(rows, 1, lane, height)
        _put(rows, 2, lane, gap - wanted)
        _put(rows, 3, lane, height - wanted)
        _put(rows, 4, lane, collided)
        _put(rows, 5, lane, scored)
        _put(rows, 6, lane, block[a + _MODE])
        _put(rows, 7, lane, block[a + _OVERRIDE])
        _put(rows, 8, lane, block[a + _HERE])
        _put(rows, 9, lane, felt)
        _put(rows, 10, lane, change * change)
        _put(rows, 11, lane, collided)
        _put(rows, 12, lane, error_weight * felt)
        _put(rows, 13, lane, rate_weight * (change * change))
        _put(rows, 14, lane, collision_weight * collided)


@stage
def put_infos(rows, n, infos, o, machines):
    """Rows of lanes into the rows of all machines, from ``infos[o]`` on."""
    for j in range(_INFO):
        for lane in range(n):
            infos[o + lane] = rows[j * UW + lane]
        o += machines


@stage
def conclude(rows, n, io, first):
    """The reward, and whether an episode is over: by contact, or because the time is."""
    for lane in range(n):
        reward = rows[U(12) * UW + lane] + rows[U(13) * UW + lane] + rows[U(14) * UW + lane]
        end(io, first, lane, reward, rows[U(4) * UW + lane] > 0.5)


def observe(block_address, at, n, io_address, first):
    """Stage after a period: observation, reward and info of each machine, and whether its episode is over."""
    block, io = doubles(block_address, ANY), words(io_address, IO_SIZE)
    tick = U(np.int64(block[at + machine.CLOCK]))  # the same in every lane
    rows = scratch(_ROWS)
    if io[IO.observation] == _SHEET:
        weights.look(n, io, first)
    else:
        if io[IO.observation] == _RAW:
            raw_signals(block, at, n, rows, tick)
        else:
            sheets(block, at, n, rows, tick)
            features(block, at, n, rows, tick)
            remember(block, at, n, rows, tick, doubles(io[IO.memory] + first * U(8), ANY), io[IO.machines])
        lay_out(rows, n, singles(io[IO.observations], ANY), first * io[IO.size], io[IO.size])
    judge(block, at, n, rows, doubles(io[IO.weights], ANY), tick)
    put_infos(rows, n, doubles(io[IO.infos], ANY), first, io[IO.machines])
    conclude(rows, n, io, first)


TASK = Task(
    id="kerfgym/HeightFollowing-v0",
    name="height-following",
    slot="z",
    period=1,
    scenario="wavy",
    base="xi2023-improved",
    actions={
        "direct": Actions(("velocity",), ("mm/s",), (DIRECT_SPEED,)),
        "residual": Actions(("velocity",), ("mm/s",), (RESIDUAL_SPEED,)),
        "schedule": Actions(
            ("window", "trim", "gain"),
            ("samples", "samples", "1"),
            (float(LONGEST_WINDOW), float(LARGEST_TRIM), LARGEST_GAIN),
            (1.0, 0.0, LEAST_GAIN),
        ),
    },
    features=Signals(FEATURES, -LIMIT, LIMIT),
    raw=Signals(
        RAW,
        [0.0] * 2 * RAW_HISTORY + [-200.0] * RAW_HISTORY + [-2000.0] * (RAW_HISTORY + 1) + [0.0] * 5,
        [10.1] * 2 * RAW_HISTORY + [200.0] * RAW_HISTORY + [2000.0] * (RAW_HISTORY + 1) + [10.0, 2000.0, 1.0, 1.0, 6.0],
    ),
    scaling={"unit_mm": TOLERANCE, "compressed": 0.2, "limit": LIMIT},
    info=INFO,
    reward=Reward(),
    act=act,
    observe=observe,
    memory=len(Memory._fields),
    with_job=False,
    put_weights=weights.stage_of,
)
"""Declares HeightFollowing."""
