"""The X/Y half of the machine: a job travelled by axes with following error, once per control period.

It has a block of its own beside the machine's, so that a height follower on an ideal path pays nothing for it, and two
stages that the machine calls by address: :func:`travel` before the sheet is read, :func:`cut` at the end of a period.

Axes and path run ``AHEAD`` ms ahead of the machine, as the interpolator's buffer of a real control does, so that the
sheet under the *actual* path ahead is known to preview laws; a ring, the trail, holds what happened for the moment the
machine gets there. So a feed override comes into force 5 ms after it was decided.
"""

from typing import NamedTuple

import numpy as np

from . import lanes, machine, path, supervisor, xy_axes
from .controller import AHEAD, PERIOD, SLOTS, AxesSensed, Velocities
from .kernels import Kernel
from .lanes import U0, U1, UW, Layout, U, W, call, clip, doubles, load, part, rows, stage, store, words

RAPID, APPROACH, PIERCE, LEAD_IN, CUT, LIFT = range(6)
"""Phases of a job."""

JOB = ("x", "y", "s", "feed", "tx", "ty", "beam", "phase", "lift", "most", "cut_s")
"""What a job's table holds for each millisecond of nominal time, see :class:`paths.job.Job`."""


class Journey(NamedTuple):
    """Which job the machine does."""

    first: float = 0.0  # index of its first sample in the table of jobs
    samples: float = 2.0
    feed: float = 10.0  # mm/s of its cuts
    corrections: float = 0.5  # mm, largest correction of the reference


class Hand(NamedTuple):
    """What an environment's action does to the path."""

    override: float = 1.0  # times the feed override
    dx: float = 0.0  # mm, added to the reference
    dy: float = 0.0


class Progress(NamedTuple):
    """How far the job is; in the axes' time."""

    tau: float = 0.0  # ms of nominal time, at the latest interpolation
    override: float = 1.0
    near: float = 0.0  # sample of the job nearest to the axes
    servo_in: float = 0.0  # control periods until the next servo instant
    interpolation_in: float = 0.0
    velocity_x: float = 0.0  # mm/s of the increments being issued
    velocity_y: float = 0.0
    fresh: bool = True


class Trail(NamedTuple):
    """What happened in one control period."""

    x: float = 0.0  # mm, the slides
    y: float = 0.0
    speed: float = 0.0  # mm/s
    error: float = 0.0  # mm beside the commanded path, left positive
    lag: float = 0.0  # mm along the path behind what was issued
    s: float = 0.0  # mm along the programme
    feed: float = 0.0  # mm/s commanded
    tx: float = 1.0  # direction of the path
    ty: float = 0.0
    phase: float = RAPID
    beam: float = 0.0
    lift: float = 0.0  # mm
    tau: float = 0.0  # ms of nominal time, of the nearest point
    override: float = 1.0
    over: float = 0.0  # the job is done


_layout = Layout()
P_JOURNEY, P_XY, G_XY = (_layout.place(rows(c)) for c in (Journey, xy_axes.Params, xy_axes.Gains))
P_LAW, S_LAW = _layout.place(SLOTS["xy"].params), _layout.place(SLOTS["xy"].state)
SIGNALS, WISH, DUE = _layout.place(rows(AxesSensed)), _layout.place(rows(Velocities)), _layout.place(1)
HAND, PROGRESS = _layout.place(rows(Hand)), _layout.place(rows(Progress))
X, Y = _layout.place(rows(xy_axes.Axis)), _layout.place(rows(xy_axes.Axis))
TRAIL, TRAIL_LAST = _layout.place(8 * rows(Trail)), U(7)
ROWS = _layout.rows
STRIDE = U(ROWS * W)
_TRAIL = U(rows(Trail)) * UW

LAW_PLACES = {"params": P_LAW, "state": S_LAW, "signals": SIGNALS, "wish": WISH, "due": DUE}

PLACES = {
    "journey": (P_JOURNEY, Journey), "xy": (P_XY, xy_axes.Params), "gains": (G_XY, xy_axes.Gains),
    "axes_signals": (SIGNALS, AxesSensed), "velocities": (WISH, Velocities), "hand": (HAND, Hand),
    "progress": (PROGRESS, Progress), "x": (X, xy_axes.Axis), "y": (Y, xy_axes.Axis),
}  # fmt: skip
"""Offset and class of each part that Python reads or writes."""

(D_BLOCK, D_JOBS, D_LAW, D_LAW_TABLES, D_LAW_SIZE, D_RECORD, D_RECORD_TICK, D_MACHINES) = range(8)
DECK = 8
_DECK = U(DECK)

CHANNELS = (*Trail._fields, "x_issued", "y_issued")
"""What a recorder keeps of each control period, float32."""
_CHANNELS = U(len(CHANNELS))

_ANY = U(2**40)
_STRIDE_Z = machine.STRIDE
_JOB = U(len(JOB))
_AHEAD = U(AHEAD)
_SLEW = 0.5
"""Share of the axes' acceleration that a change of the feed override may take."""


# ------------------------------------------------------------------------------------------------------- the job


@part
def _at(jobs, j, k):
    """Index of sample ``k`` of a journey in the table of jobs."""
    i = clip(j.first + k, j.first, j.first + j.samples - 1.0)
    return U(np.int64(i)) * _JOB


@part
def _between(jobs, j, tau, field):
    """A field of the job at ``tau`` ms of nominal time, interpolated."""
    low = np.floor(clip(tau, 0.0, j.samples - 1.0))
    i, k = _at(jobs, j, low) + field, _at(jobs, j, low + 1.0) + field
    return jobs[i] + (tau - low) * (jobs[k] - jobs[i])


@part
def _distance2(jobs, j, k, x, y):
    i = _at(jobs, j, k)
    dx, dy = jobs[i] - x, jobs[i + U1] - y
    return dx * dx + dy * dy


@part
def _nearest(jobs, j, near, latest, x, y):
    """Sample nearest to (x, y), looked for from ``near`` on, not beyond ``latest``."""
    here = _distance2(jobs, j, near, x, y)
    looking = near < latest
    while looking:
        there = _distance2(jobs, j, near + 1.0, x, y)
        looking = there <= here
        if looking:
            near += 1.0
            here = there
            looking = near < latest
    return near


# ------------------------------------------------------------------------------------------- stages of a period


@stage
def issue_all(g, base, n):
    """What the law decided at the last servo instant comes into force, and the next increment is issued."""
    for lane in range(n):
        a = base + lane
        if g[a + DUE] > 0.5:
            p, u = load(xy_axes.Params, g, a + P_XY), load(Velocities, g, a + WISH)
            store(g, a + X, xy_axes.commanded(p, load(xy_axes.Axis, g, a + X), u.x, p.x_plus, p.x_minus))
            store(g, a + Y, xy_axes.commanded(p, load(xy_axes.Axis, g, a + Y), u.y, p.y_plus, p.y_minus))
            g[a + DUE] = 0.0


@stage
def slide_all(g, base, n):
    """The slides move."""
    for lane in range(n):
        a = base + lane
        p, gains = load(xy_axes.Params, g, a + P_XY), load(xy_axes.Gains, g, a + G_XY)
        store(g, a + X, xy_axes.moved(p, gains, load(xy_axes.Axis, g, a + X), PERIOD))
        store(g, a + Y, xy_axes.moved(p, gains, load(xy_axes.Axis, g, a + Y), PERIOD))


@stage
def locate_all(g, base, n, jobs, now):
    """Where on the path the slides are; the entry of the trail at ``now``."""
    for lane in range(n):
        a = base + lane
        j, s = load(Journey, g, a + P_JOURNEY), load(Progress, g, a + PROGRESS)
        ax, ay = load(xy_axes.Axis, g, a + X), load(xy_axes.Axis, g, a + Y)
        near = _nearest(jobs, j, s.near, np.floor(s.tau), ax.position, ay.position)
        i = _at(jobs, j, near)
        tx, ty = jobs[i + U(4)], jobs[i + U(5)]
        dx, dy = ax.position - jobs[i], ay.position - jobs[i + U1]
        along, beside = dx * tx + dy * ty, dy * tx - dx * ty
        # Beyond the ends of the segments around a corner the nearest point is the corner itself.
        outside = abs(along) > jobs[i + U(3)] * PERIOD + 1e-9
        distance = np.sqrt(dx * dx + dy * dy)
        error = (distance if beside >= 0.0 else -distance) if outside else beside
        vx, vy = xy_axes.velocity(ax), xy_axes.velocity(ay)
        store(g, a + now, Trail(
            x=ax.position, y=ay.position, speed=np.sqrt(vx * vx + vy * vy), error=error,
            lag=(ax.issued - ax.position) * tx + (ay.issued - ay.position) * ty,
            s=jobs[i + U(2)] + (0.0 if outside else along), feed=jobs[i + U(3)] * s.override, tx=tx, ty=ty,
            phase=jobs[i + U(7)], beam=jobs[i + U(6)], lift=_between(jobs, j, near, U(8)), tau=near,
            override=s.override, over=1.0 if near >= j.samples - 1.0 else 0.0,
        ))  # fmt: skip
        store(g, a + PROGRESS, Progress(
            s.tau, s.override, near, s.servo_in, s.interpolation_in, s.velocity_x, s.velocity_y, s.fresh
        ))  # fmt: skip


@stage
def hand_over(block, at, g, base, n, ahead, now):
    """The machine's path: where the slides are ahead, and what of the trail is now."""
    for lane in range(n):
        a, b = at + lane, base + lane
        before, there = load(path.State, block, a + machine.S_PATH), load(Trail, g, b + ahead)
        here = load(Trail, g, b + now)
        store(block, a + machine.S_PATH, path.State(
            time=before.time + PERIOD, distance=there.s, x=there.x, y=there.y, middle_x=0.5 * (before.x + there.x),
            middle_y=0.5 * (before.y + there.y), feed=there.feed, here=here.s,
        ))  # fmt: skip
        block[a + machine.BEAM] = 1.0 if here.phase == LEAD_IN or here.phase == CUT else 0.0


@stage
def head_all(g, base, n, jobs):
    """Servo instants: where the path goes next, what the encoders say, and what the law sees."""
    for lane in range(n):
        a = base + lane
        s = load(Progress, g, a + PROGRESS)
        if s.servo_in > 1.0:
            g[a + PROGRESS + U(3) * UW] = s.servo_in - 1.0
        else:
            p, j, hand = load(xy_axes.Params, g, a + P_XY), load(Journey, g, a + P_JOURNEY), load(Hand, g, a + HAND)
            x = xy_axes.sampled(p, load(xy_axes.Axis, g, a + X))
            y = xy_axes.sampled(p, load(xy_axes.Axis, g, a + Y))
            tau, override = s.tau, s.override
            vx, vy = s.velocity_x, s.velocity_y
            if s.interpolation_in > p.servo:
                interpolation_in = s.interpolation_in - p.servo
            else:
                interpolation_in = p.interpolation
                most = _SLEW * p.acceleration * p.interpolation * PERIOD / max(_between(jobs, j, tau, U(3)), 1.0)
                wanted = clip(hand.override, 0.05, _between(jobs, j, tau, U(9)))
                override += clip(wanted - override, -most, most)
                tau = min(tau + override * p.interpolation, j.samples - 1.0)
                dx, dy = clip(hand.dx, -j.corrections, j.corrections), clip(hand.dy, -j.corrections, j.corrections)
                x = xy_axes.headed(p, x, _between(jobs, j, tau, U0) + dx)
                y = xy_axes.headed(p, y, _between(jobs, j, tau, U1) + dy)
            period = p.servo * PERIOD
            new_x, new_y = x.step / period, y.step / period
            ex, ey = xy_axes.encoded(p, x), xy_axes.encoded(p, y)
            store(g, a + X, x)
            store(g, a + Y, y)
            store(g, a + SIGNALS, AxesSensed(
                error_x=x.issued - ex, error_y=y.issued - ey, position_x=ex, position_y=ey,
                velocity_x=new_x, velocity_y=new_y, acceleration_x=(new_x - vx) / period,
                acceleration_y=(new_y - vy) / period, period=period,
                feed=_between(jobs, j, tau, U(3)) * override, fresh=s.fresh,
            ))  # fmt: skip
            store(g, a + PROGRESS, Progress(tau, override, s.near, p.servo, interpolation_in, new_x, new_y, False))
            g[a + DUE] = 1.0


# ------------------------------------------------------------------------------------ what the machine calls


@part
def _base(at):
    """The column of the gantry's block that belongs to the machine's column at ``at``."""
    return (at // _STRIDE_Z) * STRIDE + at % _STRIDE_Z


def _start(block_address, at, n, deck_address, tick):
    """Starts a job: slides at rest at its first point, the whole trail there too, the first servo instant at hand."""
    deck, block = words(deck_address, _DECK), doubles(block_address, _ANY)
    g, jobs = doubles(deck[D_BLOCK], _ANY), doubles(deck[D_JOBS], _ANY)
    base = _base(at)
    j = load(Journey, g, base + P_JOURNEY)
    x, y = _between(jobs, j, 0.0, U0), _between(jobs, j, 0.0, U1)
    store(g, base + G_XY, xy_axes.gains(load(xy_axes.Params, g, base + P_XY), PERIOD))
    store(g, base + X, xy_axes.at_rest(x))
    store(g, base + Y, xy_axes.at_rest(y))
    store(g, base + HAND, Hand(1.0, 0.0, 0.0))
    store(g, base + PROGRESS, Progress(0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, True))
    locate_all(g, base, U1, jobs, TRAIL)
    first = load(Trail, g, base + TRAIL)
    for i in range(TRAIL_LAST + U1):
        store(g, base + TRAIL + i * _TRAIL, first)
    head_all(g, base, U1, jobs)
    call(deck[D_LAW], deck[D_BLOCK], base, U1, deck[D_LAW_TABLES], deck[D_LAW_SIZE])
    store(block, at + machine.S_PATH, path.State(-PERIOD, first.s, x, y, x, y, 0.0, first.s))


def _travel(block_address, at, n, deck_address, tick):
    """Axes and path: one control period, ``AHEAD`` ms ahead of the machine."""
    deck, block = words(deck_address, _DECK), doubles(block_address, _ANY)
    g, jobs = doubles(deck[D_BLOCK], _ANY), doubles(deck[D_JOBS], _ANY)
    base = _base(at)
    ahead, now = TRAIL + ((tick + _AHEAD) & TRAIL_LAST) * _TRAIL, TRAIL + (tick & TRAIL_LAST) * _TRAIL
    issue_all(g, base, n)
    slide_all(g, base, n)
    locate_all(g, base, n, jobs, ahead)
    hand_over(block, at, g, base, n, ahead, now)
    head_all(g, base, n, jobs)
    call(deck[D_LAW], deck[D_BLOCK], base, n, deck[D_LAW_TABLES], deck[D_LAW_SIZE])


start = Kernel(_start)
travel = Kernel(_travel).together_with(start)
