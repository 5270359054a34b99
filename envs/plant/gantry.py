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
    U2,
    UW,
    Layout,
    U,
    W,
    call,
    clip,
    doubles,
    load,
    part,
    rows,
    singles,
    stage,
    store,
    words,
)
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
"""What a job's table holds for each millisecond of nominal time, see :class:`paths.job.Job`."""


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
P_JOURNEY, P_XY, G_XY = (_layout.place(rows(c)) for c in (Journey, xy_axes.Params, xy_axes.Gains))
P_LAW, S_LAW = _layout.place(SLOTS["xy"].params), _layout.place(SLOTS["xy"].state)
SIGNALS, WISH, DUE = _layout.place(rows(AxesSensed)), _layout.place(rows(Velocities)), _layout.place(1)
HAND, PROGRESS = _layout.place(rows(Hand)), _layout.place(rows(Progress))
X, Y = _layout.place(rows(xy_axes.Axis)), _layout.place(rows(xy_axes.Axis))
TRAIL, TRAIL_LAST = _layout.place(8 * rows(Trail)), U(7)
P_RECIPE, P_OPTICS, P_CUT = (_layout.place(rows(c)) for c in (Recipe, spot.Params, cut.Params))
P_PROCESS, S_PROCESS = _layout.place(SLOTS["process"].params), _layout.place(SLOTS["process"].state)
PROCESS_SIGNALS, PROCESS_WISH = _layout.place(rows(ProcessPrivileged)), _layout.place(rows(Process))
PROCESS_DUE, TURN, APPLIED = _layout.place(1), _layout.place(rows(Turn)), _layout.place(rows(Process))
REALISED, BEAM = _layout.place(rows(spot.Realised)), _layout.place(rows(cut.Beam))
S_CUT, FIGURES, SUMS = _layout.place(rows(cut.State)), _layout.place(rows(cut.Figures)), _layout.place(rows(Sums))
P_PUBLISHED, P_CALIBRATED = _layout.place(rows(published.Range)), _layout.place(rows(published.Range))
EXCESS = _layout.place(rows(published.Excess))
WORST = _layout.place(rows(published.Excess))  # of the episode, while cutting
BEFORE = _layout.place(rows(Sums))  # the sums when an environment last looked
ROWS = _layout.rows
STRIDE = U(ROWS * W)
_TRAIL = U(rows(Trail)) * UW

LAW_PLACES = {
    "xy": {"params": P_LAW, "state": S_LAW, "signals": SIGNALS, "wish": WISH, "due": DUE},
    "process": {
        "params": P_PROCESS, "state": S_PROCESS, "signals": PROCESS_SIGNALS, "wish": PROCESS_WISH, "due": PROCESS_DUE,
    },
}  # fmt: skip

PLACES = {
    "journey": (P_JOURNEY, Journey), "xy": (P_XY, xy_axes.Params), "gains": (G_XY, xy_axes.Gains),
    "axes_signals": (SIGNALS, AxesSensed), "velocities": (WISH, Velocities), "hand": (HAND, Hand),
    "progress": (PROGRESS, Progress), "x": (X, xy_axes.Axis), "y": (Y, xy_axes.Axis), "recipe": (P_RECIPE, Recipe),
    "optics": (P_OPTICS, spot.Params), "cut": (P_CUT, cut.Params), "wish": (PROCESS_WISH, Process),
    "process_signals": (PROCESS_SIGNALS, ProcessPrivileged), "applied": (APPLIED, Process),
    "realised": (REALISED, spot.Realised), "figures": (FIGURES, cut.Figures), "sums": (SUMS, Sums),
    "published": (P_PUBLISHED, published.Range), "calibrated": (P_CALIBRATED, published.Range),
    "excess": (EXCESS, published.Excess), "worst": (WORST, published.Excess),
}  # fmt: skip
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
    *Trail._fields, "gap_error", *(f"command_{name}" for name in Process._fields),
    *(f"dither_{name}" for name in spot.Realised._fields), *cut.Figures._fields,
)  # fmt: skip
"""What a recorder keeps of each control period, float32: the trail, the true standoff error (mm), the process' command,
the dither as the optics realise it, and the figures of the cut."""
_CHANNELS = U(len(CHANNELS))
_TRAIL_ROWS, _APPLIED_ROWS = U(rows(Trail)), U(rows(Process))
_EXCESS_ROWS = U(rows(published.Excess))
_REALISED_ROWS, _FIGURES_ROWS = U(rows(spot.Realised)), U(rows(cut.Figures))

_ANY = U(2**40)
_SET_HEIGHT = U(supervisor.Job._fields.index("set_height") * W)
_SERVO_IN = U(Progress._fields.index("servo_in"))
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
    dx, dy = jobs[i] - x, jobs[i + U1] - y
    return dx * dx + dy * dy


@part
def _nearest(jobs, j, near, latest, x, y):
    """Sample nearest to (x, y), looked for from ``near`` on, not beyond ``latest``.

    Around a corner the nearest point jumps from one leg to the other, so the search goes on past a bump: as far along
    the path as eight times the present distance, which is enough down to corners of 30 degrees.
    """
    best = _distance2(jobs, j, near, x, y)
    limit = jobs[_at(jobs, j, near) + U2] + 8.0 * np.sqrt(best) + 0.05
    k = near + 1.0
    while k <= latest and jobs[_at(jobs, j, k) + U2] <= limit:
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
        waits = jobs[i] == jobs[k] and jobs[i + U1] == jobs[k + U1]
        if waits and _in_position(jobs[i] + dx - ax.position, jobs[i + U1] + dy - ay.position, ax, ay):
            near = latest
    return near


# ------------------------------------------------------------------------------------------- stages of a period


@stage
def apply_all(g, base, n):
    """What was decided about the process comes into force: spot, beam, override."""
    for lane in range(n):
        a = base + lane
        if g[a + PROCESS_DUE] > 0.5:
            r, p, u = (
                load(Recipe, g, a + P_RECIPE),
                load(spot.Params, g, a + P_OPTICS),
                load(Process, g, a + PROCESS_WISH),
            )
            hand = load(Hand, g, a + HAND)
            k, h = hand.keep, hand.process
            c = Process(
                override=clip(k * u.override + h.override, LEAST_OVERRIDE, r.most_override),
                power=clip(k * u.power + h.power, 0.0, r.most_power),
                frequency=clip(k * u.frequency + h.frequency, 0.0, p.highest),
                x=clip(k * u.x + h.x, 0.0, p.galvo_range), y=clip(k * u.y + h.y, 0.0, p.galvo_range),
                z=clip(k * u.z + h.z, 0.0, p.piezo_range),
                focus=clip(k * u.focus + h.focus, -p.piezo_range, p.piezo_range),
                standoff=clip(k * u.standoff + h.standoff, -r.most_standoff, r.most_standoff),
            )  # fmt: skip
            r = load(published.Range, g, a + P_PUBLISHED)
            if r.bounded:
                c = published.bounded(r, load(Journey, g, a + P_JOURNEY).feed, c)
            before = load(spot.Realised, g, a + REALISED)
            real = spot.realised(p, spot.Command(c.frequency, c.x, c.y, c.z, c.focus), before.focus)
            store(g, a + APPLIED, c)
            store(g, a + REALISED, real)
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
            phase=jobs[i + U(7)], beam=jobs[i + U(6)], lift=between(jobs, j, aloft, U(8)), tau=near,
            override=s.override, over=1.0 if near >= j.samples - 1.0 else 0.0,
        ))  # fmt: skip
        store(g, a + PROGRESS, Progress(
            s.tau, s.override, near, aloft, s.servo_in, s.interpolation_in, s.velocity_x, s.velocity_y, s.dx, s.dy,
            s.waited, s.fresh,
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
            g[a + PROGRESS + _SERVO_IN * UW] = s.servo_in - 1.0
        else:
            p, j = load(xy_axes.Params, g, a + P_XY), load(Journey, g, a + P_JOURNEY)
            hand, applied = load(Hand, g, a + HAND), load(Process, g, a + APPLIED)
            x = xy_axes.sampled(p, load(xy_axes.Axis, g, a + X))
            y = xy_axes.sampled(p, load(xy_axes.Axis, g, a + Y))
            tau, override, dx, dy, waited = s.tau, s.override, s.dx, s.dy, s.waited
            vx, vy = s.velocity_x, s.velocity_y
            if s.interpolation_in > p.servo:
                interpolation_in = s.interpolation_in - p.servo
            else:
                interpolation_in = p.interpolation
                most = _SLEW * p.acceleration * p.interpolation * PERIOD / max(between(jobs, j, tau, U(3)), 1.0)
                # Override and corrections are about cuts. Rapids and piercing take the time they take, and begin and
                # end where the programme says, or the nozzle would never be seen to arrive; so do cuts.
                phase, stands = jobs[_at(jobs, j, np.rint(tau)) + U(7)], between(jobs, j, tau, U(3)) == 0.0
                feeds = phase == LEAD_IN or phase == CUT
                wanted = clip(applied.override, LEAST_OVERRIDE, between(jobs, j, tau, U(9))) if feeds else 1.0
                override += clip(wanted - override, -most, most)
                far_x, far_y = between(jobs, j, tau, U0) + dx - x.position, between(jobs, j, tau, U1) + dy - y.position
                halted = stands and not _in_position(far_x, far_y, x, y)
                if halted and waited < j.patience:
                    waited += p.interpolation
                else:
                    waited = waited if halted else 0.0
                    tau = min(tau + override * p.interpolation, j.samples - 1.0)
                corrects = feeds and not stands
                dx = clip(hand.dx, -j.corrections, j.corrections) if corrects else _FADE * dx
                dy = clip(hand.dy, -j.corrections, j.corrections) if corrects else _FADE * dy
                x = xy_axes.headed(p, x, between(jobs, j, tau, U0) + dx)
                y = xy_axes.headed(p, y, between(jobs, j, tau, U1) + dy)
            period = p.servo * PERIOD
            new_x, new_y = x.step / period, y.step / period
            ex, ey = xy_axes.encoded(p, x), xy_axes.encoded(p, y)
            store(g, a + X, x)
            store(g, a + Y, y)
            store(g, a + SIGNALS, AxesSensed(
                error_x=x.issued - ex, error_y=y.issued - ey, position_x=ex, position_y=ey,
                velocity_x=new_x, velocity_y=new_y, acceleration_x=(new_x - vx) / period,
                acceleration_y=(new_y - vy) / period, period=period,
                feed=between(jobs, j, tau, U(3)) * override, fresh=s.fresh,
            ))  # fmt: skip
            store(g, a + PROGRESS, Progress(
                tau, override, s.near, s.aloft, p.servo, interpolation_in, new_x, new_y, dx, dy, waited, False
            ))  # fmt: skip
            g[a + DUE] = 1.0


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
        w = trail.speed * PERIOD if scored else 0.0
        ranges, journey = load(published.Range, g, b + P_CALIBRATED), load(Journey, g, b + P_JOURNEY)
        excess = published.beyond(ranges, journey.feed, applied, optics.shape, recipe.offset, params.pressure)
        store(g, b + EXCESS, excess)
        if scored:
            for i in range(_EXCESS_ROWS):
                g[b + WORST + i * UW] = max(g[b + WORST + i * UW], g[b + EXCESS + i * UW])
        off, gap = abs(trail.error), abs(error)
        running = 0.0 if trail.over > 0.5 else PERIOD
        store(g, b + SUMS, Sums(
            sums.time + running, sums.cutting + (PERIOD if scored else 0.0), sums.length + w,
            sums.contour2 + w * off * off, max(sums.contour_worst, off) if scored else sums.contour_worst,
            sums.gap2 + w * error * error, max(sums.gap_worst, gap) if scored else sums.gap_worst,
            sums.dross + w * f.dross, sums.roughness + w * f.roughness, sums.through + w * f.through,
            sums.kerf + w * f.kerf_top, sums.taper + w * f.taper, sums.energy + trail.beam * power * PERIOD,
            max(sums.power_most, power) if scored else sums.power_most,
            max(sums.dither_most, real.x, real.y) if scored else sums.dither_most,
            sums.outside + (w if published.outside(excess) else 0.0),
        ))  # fmt: skip


@stage
def decide_all(block, at, g, base, n, jobs, now, after):
    """What the process control sees when its turn comes; the set height of the coming period."""
    for lane in range(n):
        a, b = at + lane, base + lane
        turn, recipe, applied = load(Turn, g, b + TURN), load(Recipe, g, b + P_RECIPE), load(Process, g, b + APPLIED)
        block[a + machine.JOB + _SET_HEIGHT] = (
            recipe.standoff + recipe.offset + applied.standoff + load(Trail, g, b + after).lift
        )
        if turn.process_in > 1.0:
            g[b + TURN] = turn.process_in - 1.0
        else:
            trail, j, f = load(Trail, g, b + now), load(Journey, g, b + P_JOURNEY), load(cut.Figures, g, b + FIGURES)
            x = load(Privileged, block, a + machine.SIGNALS)
            tau = trail.tau
            store(g, b + PROCESS_SIGNALS, ProcessPrivileged(
                planned=between(jobs, j, tau, U(3)), planned_50=between(jobs, j, tau + 50.0, U(3)),
                planned_100=between(jobs, j, tau + 100.0, U(3)), planned_200=between(jobs, j, tau + 200.0, U(3)),
                speed=trail.speed, override=trail.override, lag=trail.lag, contour_error=trail.error,
                height=x.height, set_height=x.set_height, phase=trail.phase, beam=trail.beam > 0.5,
                progress=tau / (j.samples - 1.0), thickness=recipe.thickness, nominal_power=recipe.power,
                standoff=recipe.standoff, feed=j.feed, tangent_x=trail.tx, tangent_y=trail.ty, fresh=turn.fresh,
                gap=x.gap, margin=f.margin, dross=f.dross,
                roughness=f.roughness,
            ))  # fmt: skip
            store(g, b + TURN, Turn(recipe.period, False))
            g[b + PROCESS_DUE] = 1.0


@stage
def record_all(block, at, g, base, n, now, record, where, machines):
    """The channels of this period into the recorder, lanes side by side."""
    for lane in range(n):
        a, b = at + lane, base + lane
        for i in range(_TRAIL_ROWS):
            record[where + lane + i * machines] = g[b + now + i * UW]
        x = load(Privileged, block, a + machine.SIGNALS)
        o = where + lane + _TRAIL_ROWS * machines
        record[o] = x.gap - g[b + P_RECIPE + U2 * UW]
        for i in range(_APPLIED_ROWS):
            record[o + (U1 + i) * machines] = g[b + APPLIED + i * UW]
        o += (U1 + _APPLIED_ROWS) * machines
        for i in range(_REALISED_ROWS):
            record[o + i * machines] = g[b + REALISED + i * UW]
        o += _REALISED_ROWS * machines
        for i in range(_FIGURES_ROWS):
            record[o + i * machines] = g[b + FIGURES + i * UW]


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
    x, y = between(jobs, j, 0.0, U0), between(jobs, j, 0.0, U1)
    store(g, base + G_XY, xy_axes.gains(load(xy_axes.Params, g, base + P_XY), PERIOD))
    store(g, base + X, xy_axes.at_rest(x))
    store(g, base + Y, xy_axes.at_rest(y))
    store(g, base + HAND, Hand(0.0, 0.0, 1.0, Process(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    store(g, base + APPLIED, Process(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    store(g, base + REALISED, spot.Realised(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    store(g, base + TURN, Turn(0.0, True))
    store(g, base + PROGRESS, Progress(0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, True))
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
    store(g, base + FIGURES, cut.nothing())
    none = Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    inside = published.Excess(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    store(g, base + EXCESS, inside)
    store(g, base + WORST, inside)
    store(g, base + SUMS, none)
    store(g, base + BEFORE, none)
    now, after = TRAIL + (tick & TRAIL_LAST) * _TRAIL, TRAIL + ((tick + U1) & TRAIL_LAST) * _TRAIL
    decide_all(block, at, g, base, n, jobs, now, after)
    call(deck[D.process], deck[D.block], base, n, deck[D.process_tables], deck[D.process_size])


start = Kernel(_start)
travel = Kernel(_travel).together_with(start)
finish = Kernel(_finish).together_with(start)
ready = Kernel(_ready).together_with(start)
