"""Self-tuning predictor: learns while it runs how the sheet goes on, and feeds that forward.

The sheet under the nozzle is ``head position − height``. Its rise over the next 2, 4 and 6 periods is predicted as a
linear function of how it has just moved: differences to the last four readings and to six moving averages, from 2 to 64
periods long. The coefficients are not given; they are estimated by recursive least squares with forgetting, so a slope,
a wave, a vibrating sheet or several sines at once are each predicted once they have been seen for a few of their
periods. This is the direct self-tuning scheme (Åström and Wittenmark 1973) for a disturbance that can be measured;
drive and dead time enter through ``lead`` and ``sharpen`` alone.

The covariance of the coefficients is kept as factors U·D·Uᵀ (Bierman 1977), U unit upper triangular, D diagonal. It is
symmetric and positive definite by construction, however long the machine runs: a covariance that is updated as a plain
matrix loses both to rounding, and forgetting makes what is lost grow. Along a direction that is not excited D stops
growing at the variance known before learning.

A reading off what was predicted is bridged by the prediction, unless it goes on from the readings before; one that is
off for longer than ``hold`` is real. Then the readings of the bridge count after all, and until all that predictions
are made from lies behind the jump the trend is fed forward instead.

What an innovation exceeds ``gate`` times the usual one by is cut off, so a step hardly disturbs what has been learnt.
The command is the predicted speed, ``lead`` ahead, with a share of its change, and a proportional term on the error.
"""

from typing import Annotated, NamedTuple

import numpy as np

from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.plant.supervisor import HOLD

RECENT, AVERAGES = 4, 6
TERMS = RECENT + AVERAGES
NEAR, MIDDLE, FAR = 2, 4, 6
"""Periods ahead."""

RING = 8
"""Periods that are remembered; more than FAR."""

CENTRE = 4
"""Periods by which a command is delayed before it is compared with the head's velocity."""

# Places in the memory.
READINGS = 0
COMMANDS = READINGS + RING
SAID = COMMANDS + RING  # farthest predictions
SOON = SAID + RING  # predictions as readings, nearest and middle ones
LATER = SOON + RING
TAKEN = LATER + RING  # whether the reading was taken as it was
RAW = TAKEN + RING  # readings, bridged or not
MEANS = RAW + RING
BEFORE = MEANS + AVERAGES  # the averages when the bridge under way began
SEEN = BEFORE + AVERAGES  # what predictions were made from, a row a period
GAIN = SEEN + RING * TERMS
SPREAD = (
    GAIN + TERMS
)  # covariance of the coefficients over the variance of an innovation: D on the diagonal, U above it
NEARER = SPREAD + TERMS * TERMS  # coefficients, a row for each horizon
FARTHER = NEARER + 2 * TERMS
MEMORY = NEARER + 3 * TERMS

FADE = 0.98
"""Of the largest speed seen, per period."""

DOUBT = 6.0
"""How soon predictions that miss most of the motion are not trusted."""

SLIGHT = 0.015
"""mm in FAR periods; where the sheet moves less, predictions may miss so much."""

SWING, STRAY = 1.2, 0.05
"""An error that exceeds this multiple of what the sheet has moved by, and so many mm, is the loop's own."""

PROVED = 100.0
"""Periods of learning after which predictions tell what is off."""

FINE = 0.004
"""mm; what is less off is never bridged."""

LITTLE = 0.01
"""mm; a larger error is integrated as if it were this one."""

CALM = 1e-3
"""s²: the square of ``trust`` in (mm/s per period)², for a thousand periods."""

QUIET = 1e-4
"""mm; an innovation is never taken to be smaller, which the resolution of count and encoder would not support."""


class Params(NamedTuple):
    """Gains of loop and estimator."""

    kp: Annotated[float, Quantity("1/s", 20.0, 120.0, "proportional gain", log=True)] = 85.0
    ki: Annotated[float, Quantity("1/s²", 0.0, 5000.0, "integral gain")] = 0.0
    feed: Annotated[float, Quantity("1", 0.0, 1.2, "share of the predicted speed fed forward")] = 0.987
    lead: Annotated[float, Quantity("ms", -3.0, 3.0, "how far beyond the drive's lag the speed is taken")] = -1.5
    sharpen: Annotated[float, Quantity("ms", -3.0, 6.0, "share of its change, as a time")] = 2.2
    memory: Annotated[
        float, Quantity("ms", 40.0, 1000.0, "after which what was learnt is half forgotten", log=True)
    ] = 120.0
    prior: Annotated[
        float, Quantity("1", 0.1, 5.0, "standard deviation of a coefficient before learning", log=True)
    ] = 1.2
    gate: Annotated[float, Quantity("1", 4.0, 40.0, "largest innovation that counts, over the usual", log=True)] = 10.0
    jump: Annotated[float, Quantity("mm", 0.02, 0.1, "off the sheet's trend, that is bridged", log=True)] = 0.035
    rare: Annotated[
        float, Quantity("1", 3.0, 20.0, "a reading off its prediction, over the usual, that is bridged", log=True)
    ] = 5.0
    hold: Annotated[int, Quantity("ms", 0, 4, "longest bridge; what outlasts it is real")] = 4
    recall: Annotated[float, Quantity("ms", 20.0, 300.0, "over which predictions prove themselves", log=True)] = 100.0
    reach: Annotated[float, Quantity("1", 1.0, 2.0, "largest speed fed forward, over the largest seen of late")] = 1.5
    smith: Annotated[float, Quantity("1", 0.0, 1.0, "share of the commands on their way that counts as done")] = 0.35
    lag: Annotated[float, Quantity("ms", 3.0, 7.0, "of the drive, before it is known")] = 5.4
    trust: Annotated[
        float, Quantity("mm/s²", 10.0, 1000.0, "acceleration that makes the drive's lag known", log=True)
    ] = 50.0


class State(NamedTuple):
    """Clocks and slow quantities."""

    tick: float = 0.0  # of the rings
    known: float = 0.0  # periods since the readings are the sheet's
    usual: float = 4e-6  # mm², mean square of the farthest prediction's innovation
    grow: float = 1.0  # of the coefficients' variance per period
    late: float = 0.0  # covariance of the head's velocity and its command's acceleration, …
    power: float = 0.0  # … and the latter's variance, forgotten as slowly
    fastest: float = 0.0  # mm per period, largest speed of the sheet of late
    integral: float = 0.0  # mm/s
    wrong: float = 0.0  # mm², of late: square of what the farthest prediction missed, …
    plain: float = 0.0  # … and of what was missed had nothing been predicted
    swing: float = 0.0  # mm, largest motion of the sheet of late
    bridged: float = 0.0  # periods since a jump; below 0: periods until the trend is known again
    stray: float = 1e-4  # mm², mean square of what the nearest prediction missed
    calm: float = 0.0  # periods since a jump that was real
    trend: float = 0.0  # mm per period, of the readings that were taken
    held: bool = False  # the supervisor held the head


class Reading(NamedTuple):
    """What a reading is taken for."""

    measured: float  # mm, the sheet, bridged or not
    seen: float  # mm, the sheet as it was read
    far_off: float  # mm, from which on a reading is off
    off: bool  # it is off
    bridges: bool  # and bridged
    anew: bool  # what was read before counts no more
    lost: bool  # no reading of the sheet, or the first


_FIRST = State()


@part
def init(params):
    """The initial state."""
    return _FIRST._replace(grow=2.0 ** (1.0 / params.memory))


@part
def _slot(tick, back):
    """Ring index of ``back`` periods ago."""
    t = tick - back
    return np.int64(t - RING * np.floor(t / RING))


@part
def _weigh(m, row, noise, grow, most):
    """Bierman's update of the factors for one reading of the terms at ``row``; gains, times the result, at GAIN.

    Args:
        m: the law's memory.
        row: where the terms lie.
        noise: variance of an innovation that no coefficient explains.
        grow: of the variances, by forgetting.
        most: largest sum of the coefficients' variances.

    Returns:
        the innovation's whole variance.
    """
    whole = noise
    for j in range(TERMS):
        f = m[row + j]
        for i in range(j):
            f += m[SPREAD + i * TERMS + j] * m[row + i]
        d = SPREAD + j * TERMS + j
        v = m[d] * f
        before, whole = whole, whole + v * f
        m[d] *= grow * before / whole
        for i in range(j):
            u = m[SPREAD + i * TERMS + j]
            m[SPREAD + i * TERMS + j] = u - f / before * m[GAIN + i]
            m[GAIN + i] += v * u
        m[GAIN + j] = v
    # What is not excited must not grow for ever.
    trace = 0.0
    for j in range(TERMS):
        column = 1.0
        for i in range(j):
            u = m[SPREAD + i * TERMS + j]
            column += u * u
        trace += m[SPREAD + j * TERMS + j] * column
    if trace > most:
        for j in range(TERMS):
            m[SPREAD + j * TERMS + j] *= most / trace
    return whole


@part
def _learn(p, m, base, now, mid, far, usual, grow):
    """Recursive least squares: what was said ``FAR`` periods ago against what came; returns the cut innovation."""
    row = SEEN + base * TERMS
    scale = 1.0 / _weigh(m, row, usual / grow, grow, TERMS * p.prior * p.prior)
    limit = p.gate * np.sqrt(usual)
    last = 0.0
    for k in range(3):
        at = NEARER + k * TERMS
        said = 0.0
        for i in range(TERMS):
            said += m[at + i] * m[row + i]
        came = now if k == 0 else (mid if k == 1 else far)
        last = clip(came - m[READINGS + base] - said, -limit, limit)
        for i in range(TERMS):
            m[at + i] += scale * m[GAIN + i] * last
    return last


@part
def _forget(p, m):
    """Nothing is known of how the sheet goes on."""
    for i in range(TERMS * TERMS):
        m[SPREAD + i] = 0.0
    for i in range(TERMS):
        m[SPREAD + i * TERMS + i] = p.prior * p.prior
    for i in range(3 * TERMS):
        m[NEARER + i] = 0.0


@part
def _see(m, tick, back, reading):
    """Takes in the reading of ``back`` periods ago: what predictions are made from, and the moving averages."""
    m[READINGS + _slot(tick, back)] = reading
    row = SEEN + _slot(tick, back) * TERMS
    for k in range(RECENT):
        m[row + k] = reading - m[READINGS + _slot(tick, back + k + 1.0)]
    share = 0.5
    for k in range(AVERAGES):
        m[row + RECENT + k] = reading - m[MEANS + k]
        m[MEANS + k] += share * (reading - m[MEANS + k])
        share *= 0.5


@part
def _foretold(m, tick):
    """What this reading should be, by the latest prediction that rests on a reading, not on a bridge; whether one does.

    Bridges that rest on bridges could hold each other up without end.
    """
    two, four, six = _slot(tick, NEAR), _slot(tick, MIDDLE), _slot(tick, FAR)
    far = m[READINGS + six] + m[SAID + six]
    soon = m[SOON + two] if m[TAKEN + two] > 0.5 else (m[LATER + four] if m[TAKEN + four] > 0.5 else far)
    return soon, m[TAKEN + two] + m[TAKEN + four] + m[TAKEN + six] > 0.5


@part
def _leaves(m, tick, seen, bridged, far_off, proved):
    """Whether a reading lies off the last one that was taken, and off where that was going, so many periods ago."""
    if bridged > RING - RECENT:
        return True
    taken = m[READINGS + _slot(tick, bridged + 1.0)]
    pace = (taken - m[READINGS + _slot(tick, bridged + RECENT)]) / (RECENT - 1)
    # An impulse of the other sign may be where a moving sheet was; before that is known a bridge may rest on noise.
    stays = (bridged == 0.0 or not proved) and abs(seen - taken) <= far_off
    return not stays and abs(seen - taken - (bridged + 1.0) * pace) > far_off


@part
def _take_back(m, tick, bridged):
    """A bridge of so many periods has turned out to be wrong: what was read meanwhile counts after all."""
    for k in range(AVERAGES):
        m[MEANS + k] = m[BEFORE + k]
    for i in range(np.int64(bridged)):
        _see(m, tick, bridged - i, m[RAW + _slot(tick, bridged - i)])


@part
def _lag(p, late, power):
    """ms, from a reading to the drive's answer to it."""
    return clip(p.lag + (late - (p.lag - CENTRE) * power) / (power + CALM * p.trust * p.trust), 1.0, 9.0)


@part
def lag(params, state):
    """What the drive's lag is taken to be, ms."""
    return _lag(params, state.late * state.grow, state.power * state.grow)


@part
def _read(p, s, x, m):
    """Tells the sheet from what is off it; takes the reading in, bridged or not. Returns state and :class:`Reading`."""
    tick = s.tick
    # Far from the sheet and over a hole the reading says nothing of the sheet.
    blind, holds = not x.captured, x.mode == HOLD
    # Not the filtered height: what is off the trend is told apart in the sheet, where the head's motion does not count.
    seen, last = x.head_position - x.raw_height, m[READINGS + _slot(tick, 1.0)]
    expected = last + (last - m[READINGS + _slot(tick, RECENT)]) / (RECENT - 1)
    # What was predicted before the reading tells better than a trend what is off it, once it has proved itself.
    soon, based = _foretold(m, tick)
    proved = based and s.calm > PROVED
    expected = soon if proved else expected
    far_off = clip(p.rare * np.sqrt(s.stray), FINE, p.jump) if proved else p.jump
    # What goes on from a reading that was taken is the sheet, whatever was predicted: an impulse leaves it.
    leaves = _leaves(m, tick, seen, max(s.bridged, 0.0), far_off, proved)
    off = abs(seen - expected) > far_off and leaves
    bridges = off and s.bridged >= 0.0 and s.bridged < p.hold
    # Across the bridge the trend of more readings: what noise adds to it would be taken for motion.
    carried = soon if proved else last + (last - m[READINGS + _slot(tick, RING)]) / (RING - 1)
    missed = min((seen - soon) * (seen - soon), 9.0 * s.stray)
    stray = max(0.99 * s.stray + 0.01 * missed, QUIET * QUIET) if proved else s.stray
    # One that outlasts is real; then the trend is that of the jump for a while.
    bridged = s.bridged + 1.0 if bridges or s.bridged < 0.0 else (-float(RECENT) if off else 0.0)
    m[RAW + _slot(tick, 0.0)] = seen
    if bridges and s.bridged <= 0.0:
        for k in range(AVERAGES):
            m[BEFORE + k] = m[MEANS + k]
    outlasts = off and not bridges
    if outlasts and s.bridged > 0.0 and not holds:
        _take_back(m, tick, s.bridged)
    # What was read before a hold was of the hole, or of a fault.
    anew = x.fresh or blind or (s.held and not holds)
    if anew:
        _begin_at(m, seen)
    if x.fresh:
        for i in range(RING):
            m[COMMANDS + i] = 0.0
    m[COMMANDS + _slot(tick, 1.0)] = x.command
    measured = m[READINGS + _slot(tick, 1.0)] if holds else (carried if bridges and not anew else seen)
    _see(m, tick, 0.0, measured)
    # After what was taken to be a jump the readings tell no motion until all of them lie behind it.
    known = 0.0 if blind or x.fresh else (1.0 if holds or outlasts else min(s.known + 1.0, 1e6))
    calm, bridged = (0.0, 0.0) if anew or holds else (0.0 if outlasts else s.calm + 1.0, bridged)
    s = s._replace(known=known, bridged=bridged, stray=stray, calm=calm, held=holds)
    return s, Reading(measured, seen, far_off, off, bridges, anew, x.fresh or blind or holds)


@part
def _begin_at(m, reading):
    """All that has been read is this one reading."""
    for i in range(RING):
        m[READINGS + i] = reading
    for i in range(AVERAGES):
        m[MEANS + i] = reading


@part
def _watch(p, s, x, m, r):
    """An error that the sheet has not made is an oscillation: back to the proportional term, and learn anew.

    Returns state, what was measured, and whether it is one.
    """
    measured, swung = r.measured, abs(m[SEEN + _slot(s.tick, 0.0) * TERMS + TERMS - 1])
    swing = max(0.0 if r.anew else FADE * s.swing, swung)
    swings = s.known > 0.0 and abs(x.head_position - measured - x.set_height) > SWING * swing + STRAY
    known, bridged, calm = s.known, s.bridged, s.calm
    if swings:
        _forget(p, m)
        if known > 2.0:  # what bridges have made of the readings is no trend to go on from
            for back in range(RING):
                m[READINGS + _slot(s.tick, back)] = m[RAW + _slot(s.tick, back)]
            measured, bridged = r.seen, 0.0
        known, calm = 1.0, 0.0
    return s._replace(swing=swing, known=known, bridged=bridged, calm=calm), measured, swings


@part
def _taught(p, s, m, measured):
    """The state after what was said ``FAR`` periods ago has been compared with what came."""
    recall = 1.0 - 1.0 / p.recall
    usual, wrong, plain = s.usual, recall * s.wrong, recall * s.plain
    if s.known > FAR + 2.0:
        base = _slot(s.tick, FAR)
        rose = measured - m[READINGS + base]
        wrong += (rose - m[SAID + base]) * (rose - m[SAID + base])
        plain += rose * rose
        now, mid = m[READINGS + _slot(s.tick, FAR - NEAR)], m[READINGS + _slot(s.tick, FAR - MIDDLE)]
        missed = _learn(p, m, base, now, mid, measured, usual, s.grow)
        usual = max(0.99 * usual + 0.01 * missed * missed, QUIET * QUIET)
    return s._replace(usual=usual, wrong=wrong, plain=plain)


@part
def _foreseen(m, tick, measured, bridges):
    """How far the sheet will have risen ``NEAR``, ``MIDDLE`` and ``FAR`` periods from now, mm; it is kept."""
    here = _slot(tick, 0.0)
    row, near, middle, far = SEEN + here * TERMS, 0.0, 0.0, 0.0
    for i in range(TERMS):
        near += m[NEARER + i] * m[row + i]
        middle += m[NEARER + TERMS + i] * m[row + i]
        far += m[FARTHER + i] * m[row + i]
    m[SAID + here], m[SOON + here], m[LATER + here] = far, measured + near, measured + middle
    m[TAKEN + here] = 0.0 if bridges else 1.0
    return near, middle, far


@part
def _timed(s, x, m):
    """The state after one more period of the drive, of which the lag is learnt: the head's velocity is its command,
    later, to first order v(t) = u(t − c) − (lag − c)·u'(t − c)."""
    sent, before = m[COMMANDS + _slot(s.tick, CENTRE)], m[COMMANDS + _slot(s.tick, CENTRE + 1.0)]
    change = 0.5 * (m[COMMANDS + _slot(s.tick, CENTRE - 1.0)] - before)
    late = s.late + (-(x.head_velocity - sent) * change if s.known > 20.0 else 0.0)
    return s._replace(late=late, power=s.power + (change * change if s.known > 20.0 else 0.0))


@part
def under_way(m, tick, behind):
    """mm that the commands of the last ``behind`` ms are still to move the head by."""
    moving = 0.0
    for k in range(1, RING):
        moving += clip(behind - k + 0.5, 0.0, 1.0) * m[COMMANDS + _slot(tick, k)] * PERIOD
    return moving


class Outlook(NamedTuple):
    """What a period's reading says of the sheet: how it goes on, and what that is worth."""

    measured: float  # mm, the sheet, bridged or not
    near: float  # mm by which it will have risen in NEAR, …
    middle: float  # … MIDDLE …
    far: float  # … and FAR periods
    bend: float  # mm per period², of the parabola through the three
    slope: float  # mm per period, its slope in the middle
    behind: float  # ms, from a reading to the drive's answer to it
    moving: float  # mm that the commands of that time are still to move the head by
    ready: bool  # there are predictions
    trusted: float  # share of what is predicted that is believed
    most: float  # mm per period, the fastest that is believed
    coming: float  # mm/s, the sheet when a command acts
    rise: float  # mm until then


@part
def outlook(params, state, signals, memory):
    """Reads, learns, predicts; returns the state and the :class:`Outlook`. The integral is left to the caller."""
    p, x, m = params, signals, memory
    if x.fresh:
        for i in range(MEMORY):
            m[i] = 0.0
        _forget(p, m)
    s, r = _read(p, state._replace(tick=state.tick + 1.0), x, m)
    s, measured, swings = _watch(p, s, x, m, r)
    s = _taught(p, s, m, measured)
    near, middle, far = _foreseen(m, s.tick, measured, r.bridges)
    s = _timed(s, x, m)
    behind = _lag(p, s.late, s.power)
    # The parabola through the three: its value and slope where the command will act, and how that changes.
    bend = (far - 2.0 * middle + near) / ((MIDDLE - NEAR) * (MIDDLE - NEAR))
    slope = (far - near) / (FAR - NEAR)
    speed = slope + bend * (behind + p.lead - MIDDLE)
    ready = s.known > FAR + 2.0
    # A sheet hardly moves faster than it has just moved; an estimate that has gone astray says so.
    recent = m[SEEN + _slot(s.tick, 0.0) * TERMS + RECENT - 1]
    fastest = max(0.0 if r.anew else FADE * s.fastest, abs(recent) / RECENT if s.known > RECENT else 0.0)
    most = p.reach * fastest
    # What has not come true lately, such as how the first step goes on, is fed forward in part or not at all.
    trusted = clip(DOUBT * (1.0 - s.wrong / max(s.plain, SLIGHT * SLIGHT * p.recall)), 0.0, 1.0)
    coming = trusted * clip(speed + p.sharpen * bend, -most, most) / PERIOD if ready else 0.0
    # Until then, the trend: that of before a jump, and once it lies behind, the new one.
    trend = s.trend if r.bridges or r.off or s.known <= RECENT else recent / RECENT
    trend = 0.0 if r.lost or swings else trend
    if not ready and RECENT * abs(trend) > r.far_off:  # less may be noise
        coming = clip(trend, -most, most) / PERIOD
    ahead = behind - MIDDLE
    rise = middle + slope * ahead + 0.5 * bend * ahead * ahead if ready else 0.0
    moving = under_way(m, s.tick, behind)
    s = s._replace(late=s.late / s.grow, power=s.power / s.grow, fastest=fastest, trend=trend)
    return s, Outlook(measured, near, middle, far, bend, slope, behind, moving, ready, trusted, most, coming, rise)


@part
def control(params, state, signals, tables, memory):
    """Head velocity, mm/s."""
    p, x = params, signals
    s, o = outlook(p, state, x, memory)
    error = x.head_position - o.measured - x.set_height + p.smith * (o.moving - o.rise)
    # Nothing winds up while the supervisor moves the head. A step is over before summing it up could help.
    grown = s.integral + p.ki * PERIOD * clip(error, -LITTLE, LITTLE)
    integral = grown if o.ready and not x.override else 0.0
    return s._replace(integral=integral), p.feed * o.coming - p.kp * error - integral
