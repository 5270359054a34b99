"""The X/Y half of the machine and the cut: a job travelled by axes with following error, once per control period.

It has a block of its own beside the machine's, so that a height follower on an ideal path pays nothing for it, and two
stages that the machine calls by address: :func:`travel` before the sheet is read, :func:`finish` at the end of a
period, with the cut.

Axes and path run ``AHEAD`` ms ahead of the machine, as the interpolator's buffer of a real control does, so that the
sheet under the *actual* path ahead is known to preview laws; a ring, the trail, holds what happened for the moment the
machine gets there. So a feed override comes into force 5 ms after it was decided; what concerns beam and spot, at once.

Where the programme stands still it waits for the axes (:data:`IN_POSITION`); once they are there, the place on the path
is the programme's, and beam, phase and set height with it. On the move it is the nearest point of the path.
"""

from typing import NamedTuple

import numpy as np

from ..engine.deck import places
from ..engine.kernels import Kernel
from ..engine.lanes import (
    U0,
    U1,
    UW,
    Layout,
    U,
    W,
    call,
    clip,
    doubles,
    load,
    part,
    row,
    rows,
    singles,
    stage,
    store,
    words,
)
from ..engine.quantity import in_order
from . import cut, machine, path, published, spot, supervisor, xy_axes
from .controller import (
    AHEAD,
    PERIOD,
    SLOTS,
    AxesSensed,
    Privileged,
    Process,
    ProcessPrivileged,
    Velocities,
)

RAPID, APPROACH, PIERCE, LEAD_IN, CUT, LIFT = range(6)
"""Phases of a job."""

JOB = ("x", "y", "s", "feed", "tx", "ty", "beam", "phase", "lift", "most", "cut_s")
"""What a job's table holds for each millisecond of nominal time, see :class:`paths.job.PlannedJob`."""


class Journey(NamedTuple):
    """Which job the machine does."""

    first: float = 0.0  # index of its first sample in the table of jobs
    samples: float = 2.0
    feed: float = 10.0  # mm/s of its cuts
    corrections: float = 0.5  # mm, largest correction of the reference
    patience: float = 500.0  # control periods that the programme waits at a standstill for the axes [A]


class Recipe(NamedTuple):
    """What the process is about: nominal settings of the material, and how far they may be changed."""

    period: float = 8.0  # control periods from decision to decision
    power: float = 1000.0  # W
    standoff: float = 1.0  # mm
    thickness: float = 1.0  # mm
    most_override: float = 2.0
    most_power: float = 1.2  # of the nominal power
    most_standoff: float = 1.0  # mm, ±
    offset: float = 0.0  # mm, by which the machine's standoff is set off the recipe's


class Hand(NamedTuple):
    """What an environment's action adds to the path and to the process' command."""

    dx: float = 0.0  # mm, added to the reference
    dy: float = 0.0
    keep: float = 1.0  # share of the law's command that stays; 0: the hand alone decides about the process
    process: Process = Process(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Progress(NamedTuple):
    """How far the job is; in the axes' time."""

    tau: float = 0.0  # ms of nominal time, at the latest interpolation
    override: float = 1.0
    near: float = 0.0  # sample of the job nearest to the axes
    aloft: float = 0.0  # ms of nominal time that the set height has reached; it follows `near` without its jumps
    servo_in: float = 0.0  # control periods until the next servo instant
    interpolation_in: float = 0.0
    velocity_x: float = 0.0  # mm/s of the increments being issued
    velocity_y: float = 0.0
    dx: float = 0.0  # mm, correction of the reference in force
    dy: float = 0.0
    waited: float = 0.0  # control periods for the axes to be in position
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


class Turn(NamedTuple):
    """When the process is decided next."""

    process_in: float = 0.0  # control periods
    fresh: bool = True


class Sums(NamedTuple):
    """What an episode adds up; lengths of cut as weights."""

    time: float = 0.0  # s, until the job was done
    cutting: float = 0.0  # s in the phases LEAD_IN and CUT
    length: float = 0.0  # mm cut
    contour2: float = 0.0  # mm²·mm of the contour error
    contour_worst: float = 0.0  # mm
    gap2: float = 0.0  # mm²·mm of the standoff error
    gap_worst: float = 0.0  # mm
    dross: float = 0.0  # mm·mm
    roughness: float = 0.0  # mm·mm
    through: float = 0.0  # mm cut through
    kerf: float = 0.0  # mm·mm, at the top
    taper: float = 0.0  # mm·mm, perpendicularity u
    energy: float = 0.0  # J of the beam
    power_most: float = 0.0  # W of the beam while cutting
    dither_most: float = 0.0  # mm, largest amplitude that the galvo realised while cutting
    outside: float = 0.0  # mm cut with settings outside the published ones


_layout = Layout()
P_JOURNEY, P_XY = _layout.part("journey", Journey), _layout.part("xy", xy_axes.Params)
G_XY = _layout.part("gains", xy_axes.Gains)
P_LAW, S_LAW = _layout.place(SLOTS["xy"].params), _layout.place(SLOTS["xy"].state)
SIGNALS, WISH = _layout.part("axes_signals", AxesSensed), _layout.part("velocities", Velocities)
DUE = _layout.place(1)
HAND, PROGRESS = _layout.part("hand", Hand), _layout.part("progress", Progress)
X, Y = _layout.part("x", xy_axes.Axis), _layout.part("y", xy_axes.Axis)
TRAIL, TRAIL_LAST = _layout.place(8 * rows(Trail)), U(7)
P_RECIPE, P_OPTICS = _layout.part("recipe", Recipe), _layout.part("optics", spot.Params)
P_CUT = _layout.part("cut", cut.Params)
P_PROCESS, S_PROCESS = _layout.place(SLOTS["process"].params), _layout.place(SLOTS["process"].state)
PROCESS_SIGNALS = _layout.part("process_signals", ProcessPrivileged)
PROCESS_WISH = _layout.part("wish", Process)
PROCESS_DUE, TURN = _layout.place(1), _layout.place(rows(Turn))
APPLIED, REALISED = _layout.part("applied", Process), _layout.part("realised", spot.Realised)
S_CUT = _layout.place(rows(cut.State))
FIGURES, SUMS = _layout.part("figures", cut.Figures), _layout.part("sums", Sums)
P_PUBLISHED = _layout.part("published", published.Range)
P_CALIBRATED = _layout.part("calibrated", published.Range)
EXCESS = _layout.part("excess", published.Excess)
WORST = _layout.part("worst", published.Excess)  # of the episode, while cutting
BEFORE = _layout.place(rows(Sums))  # the sums when an environment last looked
ROWS = _layout.rows
STRIDE = U(ROWS * W)
_TRAIL = U(rows(Trail)) * UW

_OF_A_LAW = in_order("params state signals wish due")
LAW_PLACES = {
    "xy": dict(zip(_OF_A_LAW, (P_LAW, S_LAW, SIGNALS, WISH, DUE), strict=True)),
    "process": dict(zip(_OF_A_LAW, (P_PROCESS, S_PROCESS, PROCESS_SIGNALS, PROCESS_WISH, PROCESS_DUE), strict=True)),
}

PLACES = _layout.parts
"""Offset and class of each part that Python reads or writes."""


class Entries(NamedTuple):
    """The deck of the gantries' stages; arrays are float64 unless another type is named."""

    block: int  # array of all columns
    machines: int
    jobs: int  # array of the samples of all jobs, see JOB
    law: int  # stage of the axes' law
    law_tables: int  # array (law_size,)
    law_size: int
    process: int  # stage of the process' law
    process_tables: int  # array (process_size,)
    process_size: int
    record: int  # float32 array (record_steps, channels, machines)
    record_tick: int  # its first tick
    record_steps: int


D = places(Entries)
DECK = U(len(D))

CHANNELS = (
    *Trail._fields,
    "gap_error",
    *(f"command_{name}" for name in Process._fields),
    *(f"dither_{name}" for name in spot.Realised._fields),
    *cut.Figures._fields,
)
"""What a recorder keeps of each control period, float32: the trail, the true standoff error (mm), the process' command,
the dither as the optics realise it, and the figures of the cut."""
_CHANNELS = U(len(CHANNELS))
_TRAIL_ROWS, _APPLIED_ROWS = U(rows(Trail)), U(rows(Process))
_EXCESS_ROWS = U(rows(published.Excess))
_REALISED_ROWS, _FIGURES_ROWS = U(rows(spot.Realised)), U(rows(cut.Figures))

_ANY = U(2**40)
_SET_HEIGHT = machine.JOB + row(supervisor.Orders, "set_height")
_SERVO_IN, _PROCESS_IN = PROGRESS + row(Progress, "servo_in"), TURN + row(Turn, "process_in")
_STANDOFF = P_RECIPE + row(Recipe, "standoff")
_X, _Y, _S, _FEED, _TX, _TY, _BEAM, _PHASE, _LIFT, _MOST = (U(JOB.index(name)) for name in JOB[:10])
_NOMINAL, _STEADY = Process(), spot.Realised()
_NONE, _INSIDE, _UNCUT = Sums(), published.Excess(), cut.Figures()
_UNTOUCHED, _BEGUN, _DECIDES = Hand(), Progress(), Turn()
_STRIDE_Z = machine.STRIDE
_JOB = U(len(JOB))
_AHEAD = U(AHEAD)
LEAST_OVERRIDE = 0.05
IN_POSITION = 0.01
"""mm: where the programme stands still it goes on when the axes are that near, or stand still because their D/A
converters resolve no less, or when its patience is over [A].
Without it the rapid would begin while the axes are still on their way to the end of the cut: they would cut its corner
off, and the set height would jump with the nearest point."""

_STILL = 1e-3
"""mm/s of both axes together: drives that are slower stand still."""
_SMOOTHING, _HURRY = 8.0, 2.0
"""ms, and ms per ms: how the set height follows the place. The place goes from interpolation to interpolation while the
axes stand, and jumps where they round a corner; a height follower would answer each of these steps [A]."""
_SLEW = 0.5
"""Share of the axes' acceleration that a change of the feed override may take."""
_FADE = 0.5
"""Share of a correction that is left at each interpolation once the cut is over."""


# ------------------------------------------------------------------------------------------------------- the job


@part
def _at(jobs, j, k):
    """Index of sample ``k`` of a journey in the table of jobs."""
    i = clip(j.first + k, j.first, j.first + j.samples - 1.0)
    return U(np.int64(i)) * _JOB


@part
def between(jobs, j, tau, field):
    """A field of the job at ``tau`` ms of nominal time, interpolated."""
    low = np.floor(clip(tau, 0.0, j.samples - 1.0))
    i, k = _at(jobs, j, low) + field, _at(jobs, j, low + 1.0) + field
    return jobs[i] + (tau - low) * (jobs[k] - jobs[i])


@part
def _distance2(jobs, j, k, x, y):
    i = _at(jobs, j, k)
    dx, dy = jobs[i + _X] - x, jobs[i + _Y] - y
    return dx * dx + dy * dy


@part
def _nearest(jobs, j, near, latest, x, y):
    """Sample nearest to (x, y), looked for from ``near`` on, not beyond ``latest``.

    Around a corner the nearest point jumps from one leg to the other, so the search goes on past a bump: as far along
    the path as eight times the present distance, which is enough down to corners of 30 degrees.
    """
    best = _distance2(jobs, j, near, x, y)
    limit = jobs[_at(jobs, j, near) + _S] + 8.0 * np.sqrt(best) + 0.05
    k = near + 1.0
    while k <= latest and jobs[_at(jobs, j, k) + _S] <= limit:
        there = _distance2(jobs, j, k, x, y)
        if there <= best:
            best, near = there, k
        k += 1.0
    return near


@part
def _still(ax, ay):
    """Whether the drives stand still and are told to."""
    return ax.command == 0.0 and ay.command == 0.0 and abs(xy_axes.velocity(ax)) + abs(xy_axes.velocity(ay)) < _STILL


@part
def _in_position(off_x, off_y, ax, ay):
    """Whether a programme that stands still goes on: the axes are near enough, or will not come nearer."""
    return off_x * off_x + off_y * off_y <= IN_POSITION * IN_POSITION or _still(ax, ay)


@part
def _arrived(jobs, j, near, latest, dx, dy, ax, ay):
    """``near``, or the sample at which the reference waits if the axes are in position there.

    Encoder and D/A converter let an axis rest some micrometres short, nearest to a sample before the end; the beam
    would never be switched off, and the set height would still be that of the rapid when the next cut begins.
    """
    if near < latest:
        i, k = _at(jobs, j, latest), _at(jobs, j, latest - 1.0)
        waits = jobs[i + _X] == jobs[k + _X] and jobs[i + _Y] == jobs[k + _Y]
        if waits and _in_position(jobs[i + _X] + dx - ax.position, jobs[i + _Y] + dy - ay.position, ax, ay):
            near = latest
    return near


# ------------------------------------------------------------------------------------------- stages of a period


@part
def _allowed(r, p, hand, u):
    """The law's command and the hand's, as far as recipe and optics allow."""
    k, h = hand.keep, hand.process
    return Process(
        override=clip(k * u.override + h.override, LEAST_OVERRIDE, r.most_override),
        power=clip(k * u.power + h.power, 0.0, r.most_power),
        frequency=clip(k * u.frequency + h.frequency, 0.0, p.highest),
        x=clip(k * u.x + h.x, 0.0, p.galvo_range),
        y=clip(k * u.y + h.y, 0.0, p.galvo_range),
        z=clip(k * u.z + h.z, 0.0, p.piezo_range),
        focus=clip(k * u.focus + h.focus, -p.piezo_range, p.piezo_range),
        standoff=clip(k * u.standoff + h.standoff, -r.most_standoff, r.most_standoff),
    )


@stage
def apply_all(g, base, n):
    """What was decided about the process comes into force: spot, beam, override."""
    for lane in range(n):
        a = base + lane
        if g[a + PROCESS_DUE] > 0.5:
            optics, hand = load(spot.Params, g, a + P_OPTICS), load(Hand, g, a + HAND)
            c = _allowed(load(Recipe, g, a + P_RECIPE), optics, hand, load(Process, g, a + PROCESS_WISH))
            r = load(published.Range, g, a + P_PUBLISHED)
            if r.bounded:
                c = published.bounded(r, load(Journey, g, a + P_JOURNEY).feed, c)
            before = load(spot.Realised, g, a + REALISED)
            store(g, a + APPLIED, c)
            command = spot.Command(c.frequency, c.x, c.y, c.z, c.focus)
            store(g, a + REALISED, spot.realised(optics, command, before.focus))
            g[a + PROCESS_DUE] = 0.0


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
        near = _arrived(jobs, j, near, np.floor(s.tau), s.dx, s.dy, ax, ay)
        aloft = s.aloft + clip((near - s.aloft) / _SMOOTHING, 0.0, _HURRY)
        i = _at(jobs, j, near)
        tx, ty = jobs[i + _TX], jobs[i + _TY]
        dx, dy = ax.position - jobs[i + _X], ay.position - jobs[i + _Y]
        along, beside = dx * tx + dy * ty, dy * tx - dx * ty
        # Beyond the ends of the segments around a corner the nearest point is the corner itself.
        outside = abs(along) > jobs[i + _FEED] * PERIOD + 1e-9
        distance = np.sqrt(dx * dx + dy * dy)
        error = (distance if beside >= 0.0 else -distance) if outside else beside
        vx, vy = xy_axes.velocity(ax), xy_axes.velocity(ay)
        trail = Trail(
            x=ax.position, y=ay.position, speed=np.sqrt(vx * vx + vy * vy), error=error,
            lag=(ax.issued - ax.position) * tx + (ay.issued - ay.position) * ty,
            s=jobs[i + _S] + (0.0 if outside else along), feed=jobs[i + _FEED] * s.override, tx=tx, ty=ty,
            phase=jobs[i + _PHASE], beam=jobs[i + _BEAM], lift=between(jobs, j, aloft, _LIFT), tau=near,
            override=s.override, over=1.0 if near >= j.samples - 1.0 else 0.0,
        )  # fmt: skip
        store(g, a + now, trail)
        store(g, a + PROGRESS, s._replace(near=near, aloft=aloft))


@stage
def hand_over(block, at, g, base, n, ahead, now):
    """The machine's path: where the slides are ahead, and what of the trail is now."""
    for lane in range(n):
        a, b = at + lane, base + lane
        before, there = load(path.State, block, a + machine.S_PATH), load(Trail, g, b + ahead)
        here, x, y = load(Trail, g, b + now), 0.5 * (before.x + there.x), 0.5 * (before.y + there.y)
        after = path.State(before.time + PERIOD, there.s, there.x, there.y, x, y, there.feed, here.s)
        store(block, a + machine.S_PATH, after)
        block[a + machine.BEAM] = 1.0 if here.phase == LEAD_IN or here.phase == CUT else 0.0


@part
def _interpolated(jobs, p, j, hand, applied, s, x, y):
    """:class:`Progress` at an interpolation instant: override, place in the programme, correction."""
    feed = between(jobs, j, s.tau, _FEED)
    most = _SLEW * p.acceleration * p.interpolation * PERIOD / max(feed, 1.0)
    # Override and corrections are about cuts. Rapids and piercing take the time they take, and begin and end where the
    # programme says, or the nozzle would never be seen to arrive; so do cuts.
    phase, stands = jobs[_at(jobs, j, np.rint(s.tau)) + _PHASE], feed == 0.0
    feeds = phase == LEAD_IN or phase == CUT
    wanted = clip(applied.override, LEAST_OVERRIDE, between(jobs, j, s.tau, _MOST)) if feeds else 1.0
    override = s.override + clip(wanted - s.override, -most, most)
    far_x = between(jobs, j, s.tau, _X) + s.dx - x.position
    far_y = between(jobs, j, s.tau, _Y) + s.dy - y.position
    halted, tau, waited = stands and not _in_position(far_x, far_y, x, y), s.tau, s.waited
    if halted and waited < j.patience:
        waited += p.interpolation
    else:
        waited = waited if halted else 0.0
        tau = min(tau + override * p.interpolation, j.samples - 1.0)
    corrects = feeds and not stands
    dx = clip(hand.dx, -j.corrections, j.corrections) if corrects else _FADE * s.dx
    dy = clip(hand.dy, -j.corrections, j.corrections) if corrects else _FADE * s.dy
    return s._replace(tau=tau, override=override, interpolation_in=p.interpolation, dx=dx, dy=dy, waited=waited)


@stage
def head_all(g, base, n, jobs):
    """Servo instants: where the path goes next, what the encoders say, and what the law sees."""
    for lane in range(n):
        a = base + lane
        s = load(Progress, g, a + PROGRESS)
        if s.servo_in > 1.0:
            g[a + _SERVO_IN] = s.servo_in - 1.0
        else:
            p, j = load(xy_axes.Params, g, a + P_XY), load(Journey, g, a + P_JOURNEY)
            x = xy_axes.sampled(p, load(xy_axes.Axis, g, a + X))
            y = xy_axes.sampled(p, load(xy_axes.Axis, g, a + Y))
            vx, vy = s.velocity_x, s.velocity_y
            if s.interpolation_in > p.servo:
                s = s._replace(interpolation_in=s.interpolation_in - p.servo)
            else:
                s = _interpolated(jobs, p, j, load(Hand, g, a + HAND), load(Process, g, a + APPLIED), s, x, y)
                x = xy_axes.headed(p, x, between(jobs, j, s.tau, _X) + s.dx)
                y = xy_axes.headed(p, y, between(jobs, j, s.tau, _Y) + s.dy)
            period = p.servo * PERIOD
            new_x, new_y = x.step / period, y.step / period
            ax, ay = (new_x - vx) / period, (new_y - vy) / period
            ex, ey = xy_axes.encoded(p, x), xy_axes.encoded(p, y)
            feed = between(jobs, j, s.tau, _FEED) * s.override
            lag_x, lag_y = x.issued - ex, y.issued - ey
            sensed = AxesSensed(lag_x, lag_y, ex, ey, new_x, new_y, ax, ay, period, feed, s.fresh)
            store(g, a + X, x)
            store(g, a + Y, y)
            store(g, a + SIGNALS, sensed)
            store(g, a + PROGRESS, s._replace(servo_in=p.servo, velocity_x=new_x, velocity_y=new_y, fresh=False))
            g[a + DUE] = 1.0


@part
def _added(s, trail, f, error, power, real, scored, outside):
    """:class:`Sums` after one more period: the trail, the figures of the cut, its standoff error, power and dither."""
    w, off, gap = trail.speed * PERIOD if scored else 0.0, abs(trail.error), abs(error)
    s = s._replace(
        time=s.time + (0.0 if trail.over > 0.5 else PERIOD),
        cutting=s.cutting + (PERIOD if scored else 0.0),
        energy=s.energy + trail.beam * power * PERIOD,
        contour_worst=max(s.contour_worst, off) if scored else s.contour_worst,
        gap_worst=max(s.gap_worst, gap) if scored else s.gap_worst,
        power_most=max(s.power_most, power) if scored else s.power_most,
        dither_most=max(s.dither_most, real.x, real.y) if scored else s.dither_most,
        outside=s.outside + (w if outside else 0.0),
    )
    return s._replace(
        length=s.length + w,
        contour2=s.contour2 + w * off * off,
        gap2=s.gap2 + w * error * error,
        dross=s.dross + w * f.dross,
        roughness=s.roughness + w * f.roughness,
        through=s.through + w * f.through,
        kerf=s.kerf + w * f.kerf_top,
        taper=s.taper + w * f.taper,
    )


@stage
def cut_all(block, at, g, base, n, now):
    """The cut of this period, and what the episode adds up."""
    for lane in range(n):
        a, b = at + lane, base + lane
        trail, sums = load(Trail, g, b + now), load(Sums, g, b + SUMS)
        x, recipe = load(Privileged, block, a + machine.SIGNALS), load(Recipe, g, b + P_RECIPE)
        applied, optics = load(Process, g, b + APPLIED), load(spot.Params, g, b + P_OPTICS)
        real, params = load(spot.Realised, g, b + REALISED), load(cut.Params, g, b + P_CUT)
        scored = load(machine.Course, block, a + machine.COURSE).scored
        along, across, up = spot.spread(optics, real, trail.tx, trail.ty)
        power = applied.power * recipe.power
        error = x.gap - recipe.standoff
        beam = cut.beam(params, power, along, across, up, real.focus, real.frequency)
        s, f = cut.step(params, beam, load(cut.State, g, b + S_CUT), trail.speed, error, trail.error, PERIOD)
        store(g, b + S_CUT, s)
        store(g, b + FIGURES, f)
        ranges, journey = load(published.Range, g, b + P_CALIBRATED), load(Journey, g, b + P_JOURNEY)
        excess = published.beyond(ranges, journey.feed, applied, optics.shape, recipe.offset, params.pressure)
        store(g, b + EXCESS, excess)
        if scored:
            for i in range(_EXCESS_ROWS):
                g[b + WORST + i * UW] = max(g[b + WORST + i * UW], g[b + EXCESS + i * UW])
        store(g, b + SUMS, _added(sums, trail, f, error, power, real, scored, published.outside(excess)))


@stage
def decide_all(block, at, g, base, n, jobs, now, after):
    """What the process control sees when its turn comes; the set height of the coming period."""
    for lane in range(n):
        a, b = at + lane, base + lane
        turn, recipe, applied = load(Turn, g, b + TURN), load(Recipe, g, b + P_RECIPE), load(Process, g, b + APPLIED)
        lift = load(Trail, g, b + after).lift
        block[a + _SET_HEIGHT] = recipe.standoff + recipe.offset + applied.standoff + lift
        if turn.process_in > 1.0:
            g[b + _PROCESS_IN] = turn.process_in - 1.0
        else:
            trail, j, f = load(Trail, g, b + now), load(Journey, g, b + P_JOURNEY), load(cut.Figures, g, b + FIGURES)
            x = load(Privileged, block, a + machine.SIGNALS)
            tau = trail.tau
            seen = ProcessPrivileged(
                planned=between(jobs, j, tau, _FEED), planned_50=between(jobs, j, tau + 50.0, _FEED),
                planned_100=between(jobs, j, tau + 100.0, _FEED), planned_200=between(jobs, j, tau + 200.0, _FEED),
                speed=trail.speed, override=trail.override, lag=trail.lag, contour_error=trail.error, height=x.height,
                set_height=x.set_height, phase=trail.phase, beam=trail.beam > 0.5, progress=tau / (j.samples - 1.0),
                thickness=recipe.thickness, nominal_power=recipe.power, standoff=recipe.standoff, feed=j.feed,
                tangent_x=trail.tx, tangent_y=trail.ty, fresh=turn.fresh, gap=x.gap, margin=f.margin, dross=f.dross,
                roughness=f.roughness,
            )  # fmt: skip
            store(g, b + PROCESS_SIGNALS, seen)
            store(g, b + TURN, Turn(recipe.period, False))
            g[b + PROCESS_DUE] = 1.0


@stage
def record_all(block, at, g, base, n, now, record, where, machines):
    """The channels of this period into the recorder, lanes side by side."""
    for lane in range(n):
        a, b = at + lane, base + lane
        o = copied(g, b + now, record, where + lane, machines, _TRAIL_ROWS)
        record[o] = load(Privileged, block, a + machine.SIGNALS).gap - g[b + _STANDOFF]
        o = copied(g, b + APPLIED, record, o + machines, machines, _APPLIED_ROWS)
        o = copied(g, b + REALISED, record, o, machines, _REALISED_ROWS)
        copied(g, b + FIGURES, record, o, machines, _FIGURES_ROWS)


@part
def copied(g, b, record, o, machines, count):
    """Copies ``count`` rows of a column into channels from ``o`` on; returns where the next channel lies."""
    for i in range(count):
        record[o + i * machines] = g[b + i * UW]
    return o + count * machines


# ------------------------------------------------------------------------------------ what the machine calls


@part
def column_of(at):
    """The column of the gantry's block that belongs to the machine's column at ``at``."""
    return (at // _STRIDE_Z) * STRIDE + at % _STRIDE_Z


def _start(block_address, at, n, deck_address, tick):
    """Starts a job: slides at rest at its first point, the whole trail there too, the first servo instant at hand."""
    deck, block = words(deck_address, DECK), doubles(block_address, _ANY)
    g, jobs = doubles(deck[D.block], _ANY), doubles(deck[D.jobs], _ANY)
    base = column_of(at)
    j = load(Journey, g, base + P_JOURNEY)
    x, y = between(jobs, j, 0.0, _X), between(jobs, j, 0.0, _Y)
    store(g, base + G_XY, xy_axes.gains(load(xy_axes.Params, g, base + P_XY), PERIOD))
    store(g, base + X, xy_axes.at_rest(x))
    store(g, base + Y, xy_axes.at_rest(y))
    store(g, base + HAND, _UNTOUCHED)
    store(g, base + APPLIED, _NOMINAL)
    store(g, base + REALISED, _STEADY)
    store(g, base + TURN, _DECIDES)
    store(g, base + PROGRESS, _BEGUN)
    locate_all(g, base, U1, jobs, TRAIL)
    first = load(Trail, g, base + TRAIL)
    for i in range(TRAIL_LAST + U1):
        store(g, base + TRAIL + i * _TRAIL, first)
    head_all(g, base, U1, jobs)
    call(deck[D.law], deck[D.block], base, U1, deck[D.law_tables], deck[D.law_size])
    store(block, at + machine.S_PATH, path.State(-PERIOD, first.s, x, y, x, y, 0.0, first.s))


def _travel(block_address, at, n, deck_address, tick):
    """Axes and path: one control period, ``AHEAD`` ms ahead of the machine."""
    deck, block = words(deck_address, DECK), doubles(block_address, _ANY)
    g, jobs = doubles(deck[D.block], _ANY), doubles(deck[D.jobs], _ANY)
    base = column_of(at)
    ahead, now = TRAIL + ((tick + _AHEAD) & TRAIL_LAST) * _TRAIL, TRAIL + (tick & TRAIL_LAST) * _TRAIL
    apply_all(g, base, n)
    issue_all(g, base, n)
    slide_all(g, base, n)
    locate_all(g, base, n, jobs, ahead)
    hand_over(block, at, g, base, n, ahead, now)
    head_all(g, base, n, jobs)
    call(deck[D.law], deck[D.block], base, n, deck[D.law_tables], deck[D.law_size])


def _finish(block_address, at, n, deck_address, tick):
    """The end of a period: the cut, the recorder, and what comes next."""
    deck, block = words(deck_address, DECK), doubles(block_address, _ANY)
    g, jobs = doubles(deck[D.block], _ANY), doubles(deck[D.jobs], _ANY)
    base = column_of(at)
    now, after = TRAIL + (tick & TRAIL_LAST) * _TRAIL, TRAIL + ((tick + U1) & TRAIL_LAST) * _TRAIL
    cut_all(block, at, g, base, n, now)
    if deck[D.record] > U0 and tick - deck[D.record_tick] < deck[D.record_steps]:
        first = (at // _STRIDE_Z) * UW
        where = (tick - deck[D.record_tick]) * _CHANNELS * deck[D.machines] + first
        record_all(block, at, g, base, n, now, singles(deck[D.record], _ANY), where, deck[D.machines])
    decide_all(block, at, g, base, n, jobs, now, after)
    call(deck[D.process], deck[D.block], base, n, deck[D.process_tables], deck[D.process_size])


def _ready(block_address, at, n, deck_address, tick):
    """The end of the beginning: sums are empty, the process is decided for the first time."""
    deck, block = words(deck_address, DECK), doubles(block_address, _ANY)
    g, jobs = doubles(deck[D.block], _ANY), doubles(deck[D.jobs], _ANY)
    base = column_of(at)
    store(g, base + S_CUT, cut.fresh())
    store(g, base + FIGURES, _UNCUT)
    store(g, base + EXCESS, _INSIDE)
    store(g, base + WORST, _INSIDE)
    store(g, base + SUMS, _NONE)
    store(g, base + BEFORE, _NONE)
    now, after = TRAIL + (tick & TRAIL_LAST) * _TRAIL, TRAIL + ((tick + U1) & TRAIL_LAST) * _TRAIL
    decide_all(block, at, g, base, n, jobs, now, after)
    call(deck[D.process], deck[D.block], base, n, deck[D.process_tables], deck[D.process_size])


start = Kernel(_start)
travel = Kernel(_travel).together_with(start)
finish = Kernel(_finish).together_with(start)
ready = Kernel(_ready).together_with(start)
