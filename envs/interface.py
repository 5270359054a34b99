"""What a policy does to the height-following machine and what it gets back: stages before and after each period.

The same stages serve one environment and thousands. Each fills arrays of the whole batch, one loop over the lanes for
each number, so that they cost little beside the machine.
"""

from typing import NamedTuple

import numpy as np

from .plant import filters, lanes, machine, supervisor
from .plant.controller import PERIOD, Privileged
from .plant.lanes import (
    U1,
    UW,
    U,
    clip,
    doubles,
    flags,
    load,
    logarithm,
    logarithm32,
    part,
    scratch,
    singles,
    stage,
    words,
)

CONTROLS = ("direct", "residual", "schedule")
OBSERVATIONS = ("features", "raw")

DIRECT_SPEED, RESIDUAL_SPEED = 200.0, 50.0
"""mm/s of head velocity that an action of 1 means."""

LONGEST_WINDOW, LARGEST_TRIM = 15, 3
LEAST_GAIN, LARGEST_GAIN = 0.2, 3.0
"""Limits of ``control="schedule"``."""

TOLERANCE = 0.002
"""mm; errors are felt in multiples of it."""
_PER_TOLERANCE = 1.0 / TOLERANCE  # multiplying is quicker than dividing

LIMIT = 10.0
"""Bound of every normalised feature."""

ERROR_LAGS = (0, 1, 2, 3, 5, 8)
SURFACE_LAGS = (0, 1, 2, 3, 5, 8, 13)
SPEED_LAGS = (0, 1, 2, 4)
COMMAND_LAGS = (0, 1, 2, 3)
RAW_HISTORY = 8

FEATURES = (
    *(f"error_{k}" for k in ERROR_LAGS),
    *(f"surface_step_{a}_{b}" for a, b in zip(SURFACE_LAGS[:-1], SURFACE_LAGS[1:], strict=True)),
    *(f"speed_{k}" for k in SPEED_LAGS),
    *(f"command_{k}" for k in COMMAND_LAGS),
    "base_command", "set_height", "override", "captured", "holding",
)  # fmt: skip
"""Names of the normalised features, in order."""

RAW = (
    *(f"height_{k}" for k in range(RAW_HISTORY)),
    *(f"raw_height_{k}" for k in range(RAW_HISTORY)),
    *(f"head_position_{k}" for k in range(RAW_HISTORY)),
    *(f"command_{k}" for k in range(RAW_HISTORY)),
    "base_command", "set_height", "feed", "override", "captured", "mode",
)  # fmt: skip
"""Names of the physical signals, in order: newest first; mm and mm/s."""

INFO = (
    "true_gap", "measured_height", "true_error", "reported_error", "cost", "scored", "mode", "override", "distance",
    "reward_error", "reward_rate", "reward_collision", "weighted_error", "weighted_rate", "weighted_collision",
)  # fmt: skip
"""What ``info`` holds, in order; mm, terms of the reward raw and weighted."""


class Reward(NamedTuple):
    """Weights of the reward's terms; 0 switches one off."""

    error: float = 0.3  # per unit of log(1 + |true error|/2 µm), while cutting
    rate: float = 0.3  # per (change of command/10 mm/s)²
    collision: float = 100.0  # once


class Io(NamedTuple):
    """Words that the stages share with Python: addresses of the batch's arrays, and what they hold."""

    actions: int  # float32, (machines, width)
    observations: int  # float32, (machines, size)
    rewards: int  # float64, (machines,)
    returns: int  # float64, (machines,), sums of the rewards of the episodes
    infos: int  # float64, (len(INFO), machines)
    weights: int  # float64, (3,)
    control: int
    raw: int
    size: int
    width: int
    machines: int
    left: int  # float64, (machines,), periods until the time is over
    terminated: int  # bool, (machines,)
    truncated: int  # bool, (machines,)


(_ACTIONS, _OBSERVATIONS, _REWARDS, _RETURNS, _INFOS, _WEIGHTS, _CONTROL, _RAW, _SIZE, _WIDTH, _MACHINES, _LEFT, _TERMINATED,
 _TRUNCATED) = range(len(Io._fields))  # fmt: skip
_IO = U(len(Io._fields))
_ANY = U(2**40)
_SPEED = 0.01 / PERIOD  # of a millimetre per period, in 100 mm/s
_ROWS = len(RAW) * lanes.W
_COLLIDED = machine.TALLY + U(machine.Tally._fields.index("collided") * lanes.W)
_SCORED = machine.COURSE + U(machine.Course._fields.index("scored") * lanes.W)
_DISTANCE = machine.S_PATH + U(machine.path.State._fields.index("distance") * lanes.W)
_GAP, _HEIGHT, _SET, _MODE, _OVERRIDE, _CAPTURED, _FEED = (
    machine.SIGNALS + U(Privileged._fields.index(name) * lanes.W)
    for name in ("gap", "height", "set_height", "mode", "override", "captured", "feed")
)


# --------------------------------------------------------------------------------------------------- the action


def act(block_address, at, n, io_address, first):
    """Stage before a period: the action becomes a change of the stack or of its command."""
    block, io = doubles(block_address, _ANY), words(io_address, _IO)
    actions, count = singles(io[_ACTIONS], _ANY), io[_WIDTH]
    if io[_CONTROL] == U(2):
        schedule(block, at, n, actions, first)
    else:
        speed = DIRECT_SPEED if io[_CONTROL] == U(0) else RESIDUAL_SPEED
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
        lanes.store(block, a + machine.P_FILTER, filters.Params(
            filters.IMPROVED, window, trim, p.ratio, p.tau, p.jump, p.hold, p.trust
        ))  # fmt: skip
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
def features(block, at, n, rows, tick):
    """Normalised features, one row of lanes each."""
    heights, raws = at + machine.HEIGHTS, at + machine.RAW_HEIGHTS
    positions, commands = at + machine.POSITIONS, at + machine.COMMANDS
    o = U(0)
    for k in ERROR_LAGS:
        then = heights + _back(tick, k)
        for lane in range(n):
            rows[o + lane] = _symlog(block[then + lane] - block[at + lane + _SET])
        o += UW
    newer = _back(tick, 0)
    for k in SURFACE_LAGS[1:]:
        older = _back(tick, k)
        for lane in range(n):
            a, b = newer + lane, older + lane
            rows[o + lane] = _symlog(block[positions + a] - block[raws + a] - (block[positions + b] - block[raws + b]))
        newer = older
        o += UW
    for k in SPEED_LAGS:
        now, before = positions + _back(tick, k), positions + _back(tick, k + 1)
        for lane in range(n):
            rows[o + lane] = clip(_SPEED * (block[now + lane] - block[before + lane]), -LIMIT, LIMIT)
        o += UW
    for k in COMMAND_LAGS:
        then = commands + _back(tick, k)
        for lane in range(n):
            rows[o + lane] = 0.01 * block[then + lane]
        o += UW
    for lane in range(n):
        rows[o + lane] = clip(0.01 * block[at + lane + machine.WISH], -LIMIT, LIMIT)
    _copy(block, at + _SET, n, rows, o + UW)
    _copy(block, at + _OVERRIDE, n, rows, o + U(2) * UW)
    _copy(block, at + _CAPTURED, n, rows, o + U(3) * UW)
    for lane in range(n):
        rows[o + U(4) * UW + lane] = 1.0 if block[at + lane + _MODE] == supervisor.HOLD else 0.0


@stage
def raw_signals(block, at, n, rows, tick):
    """Physical signals, one row of lanes each."""
    history = U(RAW_HISTORY) * UW
    for k in range(RAW_HISTORY):
        then, o = at + _back(tick, k), U(k) * UW
        _copy(block, then + machine.HEIGHTS, n, rows, o)
        _copy(block, then + machine.RAW_HEIGHTS, n, rows, o + history)
        for lane in range(n):
            moved = block[then + lane + machine.POSITIONS] - block[at + lane + machine.ORIGIN]
            rows[o + U(2) * history + lane] = clip(moved, -200.0, 200.0)
        _copy(block, then + machine.COMMANDS, n, rows, o + U(3) * history)
    o = U(4) * history
    for lane in range(n):
        rows[o + lane] = clip(block[at + lane + machine.WISH], -2000.0, 2000.0)
    _copy(block, at + _SET, n, rows, o + UW)
    _copy(block, at + _FEED, n, rows, o + U(2) * UW)
    _copy(block, at + _OVERRIDE, n, rows, o + U(3) * UW)
    _copy(block, at + _CAPTURED, n, rows, o + U(4) * UW)
    _copy(block, at + _MODE, n, rows, o + U(5) * UW)


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


@stage
def judge(block, at, n, rewards, returns, infos, weights, first, machines, tick):
    """Reward and info of each machine; ``infos`` has a row for each name of :data:`INFO`."""
    now, before = at + machine.COMMANDS + _back(tick, 0), at + machine.COMMANDS + _back(tick, 1)
    _copy(block, at + _GAP, n, infos, first)
    _copy(block, at + _HEIGHT, n, infos, first + machines)
    row = first + U(2) * machines
    for lane in range(n):
        infos[row + lane] = block[at + lane + _GAP] - block[at + lane + _SET]
    row += machines
    for lane in range(n):
        infos[row + lane] = block[at + lane + _HEIGHT] - block[at + lane + _SET]
    _copy(block, at + _COLLIDED, n, infos, row + machines)
    _copy(block, at + _SCORED, n, infos, row + U(2) * machines)
    _copy(block, at + _MODE, n, infos, row + U(3) * machines)
    _copy(block, at + _OVERRIDE, n, infos, row + U(4) * machines)
    row += U(5) * machines
    for lane in range(n):
        infos[row + lane] = block[at + lane + _DISTANCE] - block[at + lane + _FEED] * machine.AHEAD_S
    row += machines
    for lane in range(n):
        a = at + lane
        felt = logarithm(1.0 + abs(block[a + _GAP] - block[a + _SET]) * _PER_TOLERANCE)
        infos[row + lane] = felt if block[a + _SCORED] > 0.5 else 0.0
    row += machines
    for lane in range(n):
        change = 0.1 * (block[now + lane] - block[before + lane])
        infos[row + lane] = change * change
    row += machines
    _copy(block, at + _COLLIDED, n, infos, row)
    raw = row - U(2) * machines
    for term in range(3):
        row += machines
        weight = -weights[term]
        for lane in range(n):
            infos[row + lane] = weight * infos[raw + lane]
        raw += machines
    error, rate, collision = row - U(2) * machines, row - machines, row
    for lane in range(n):
        rewards[first + lane] = infos[error + lane] + infos[rate + lane] + infos[collision + lane]
    for lane in range(n):
        returns[first + lane] += rewards[first + lane]


@stage
def end(block, at, n, left, terminated, truncated):
    """Whether an episode is over: by contact, or because the time is."""
    one, none = np.uint8(1), np.uint8(0)
    for lane in range(n):
        left[lane] -= 1.0
        hit = block[at + lane + _COLLIDED] > 0.5
        terminated[lane] = one if hit else none
        truncated[lane] = one if left[lane] <= 0.0 and not hit else none


def observe(block_address, at, n, io_address, first):
    """Stage after a period: observation, reward and info of each machine, and whether its episode is over."""
    block, io = doubles(block_address, _ANY), words(io_address, _IO)
    tick = U(np.int64(block[at + machine.CLOCK]))  # the same in every lane
    rows = scratch(_ROWS)
    if io[_RAW] == U1:
        raw_signals(block, at, n, rows, tick)
    else:
        features(block, at, n, rows, tick)
    lay_out(rows, n, singles(io[_OBSERVATIONS], _ANY), first * io[_SIZE], io[_SIZE])
    judge(
        block, at, n, doubles(io[_REWARDS], _ANY), doubles(io[_RETURNS], _ANY), doubles(io[_INFOS], _ANY), doubles(io[_WEIGHTS], _ANY), first,
        io[_MACHINES], tick,
    )  # fmt: skip
    end(
        block, at, n, doubles(io[_LEFT] + first * U(8), n), flags(io[_TERMINATED] + first, n),
        flags(io[_TRUNCATED] + first, n),
    )  # fmt: skip
