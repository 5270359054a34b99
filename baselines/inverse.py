"""Inverse: position loops that ask the drive for what the path needs, and learn on the way which drive it is.

A delay that both axes share leaves no contour error, so the loop follows the path a little late: points issued after
that are its preview. A quartic through five of them gives velocity v, acceleration a and jerk j of the reference, and
the drive with two time constants T1 and T2 (Wu) follows if it is told

    ``u = (v + (T1 + T2)·a + T1·T2·j)/gain``,

for half a servo period later than the position error is taken, because a command is held for a whole one. What is left
of the error is what is not known: the gains of the drives in the four directions, and how much slower they are than the
nominal one. A model of each drive runs beside it on the same commands; these five numbers are drawn to what the encoder
says, the gains by recursive least squares (Åström and Wittenmark 1973), the time constants by a gradient. A direction
that was never travelled shares what is learnt of the opposite one.
"""

from typing import Annotated, NamedTuple

import numpy as np

from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import Velocities

SLOT = "xy"

ALIKE = 0.9
"""Of what is learnt of one direction, the share that holds for the opposite one until it is travelled [A]."""

WEAKEST, STRONGEST = 0.5, 2.0
"""Gains of the drives, of the nominal one: bounds of what is believed."""

QUICKEST, SLOWEST = 0.5, 2.0
"""The same of their time constants."""


class Params(NamedTuple):
    """The nominal drive, the loop's gain, and how quickly it learns."""

    kv: Annotated[float, Quantity("1/s", 1.0, 85.0, "velocity per position error", "[A]", log=True)] = 60.0
    t1: Annotated[float, Quantity("ms", 0.5, 100.0, "nominal time constant of the drive", "Wu (a)", log=True)] = 20.0
    t2: Annotated[float, Quantity("ms", 0.1, 50.0, "its second one", "Wu (a)", log=True)] = 5.0
    gain: Annotated[float, Quantity("1", 0.1, 10.0, "its velocity per command", "Wu (a)", log=True)] = 1.1116
    instants: Annotated[float, Quantity("1", 1, 16, "servo instants per interpolation", "Wu", whole=True)] = 2.0
    recall: Annotated[float, Quantity("1", 0.9, 1.0, "memory of gains, per servo instant", "[A]")] = 0.99
    doubt: Annotated[float, Quantity("mm", 1e-4, 0.1, "way per servo period that is too little to learn a gain from",
                                     "[A]", log=True)] = 0.067  # fmt: skip
    slow: Annotated[float, Quantity("mm/s", 0.1, 50.0, "speed below which no gain is learnt", "[A]", log=True)] = 3.0
    learn: Annotated[float, Quantity("1/mm²", 0.0, 100.0, "rate at which the time constants are learnt", "[A]")] = 15.0


class State(NamedTuple):
    """What the path was, and what is known of the drives."""

    phase: float = 0.0  # servo instants since the last interpolation
    x_0: float = 0.0  # mm/s of the increments of x from interpolation to interpolation, the newest first
    x_1: float = 0.0
    x_2: float = 0.0
    x_3: float = 0.0
    y_0: float = 0.0
    y_1: float = 0.0
    y_2: float = 0.0
    y_3: float = 0.0
    x_slow: float = 0.0  # mm/s, the models' velocities in two parts
    x_quick: float = 0.0
    y_slow: float = 0.0
    y_quick: float = 0.0
    x_next: float = 0.0  # mm, where the models say that the encoders will be
    y_next: float = 0.0
    x_plus: float = 1.0  # gains of the drives, of the nominal one
    x_minus: float = 1.0
    y_plus: float = 1.0
    y_minus: float = 1.0
    known_x_plus: float = 0.0  # mm², squares of the way that they were learnt from
    known_x_minus: float = 0.0
    known_y_plus: float = 0.0
    known_y_minus: float = 0.0
    slower: float = 1.0  # time constants of the drives, of the nominal ones


class Reference(NamedTuple):
    """What the loop of an axis is asked for."""

    behind: float = 0.0  # mm that it lies behind what is issued
    v: float = 0.0  # mm/s
    a: float = 0.0  # mm/s²
    j: float = 0.0  # mm/s³


class Gains(NamedTuple):
    """What is known of the gains of an axis."""

    plus: float = 1.0
    minus: float = 1.0
    known_plus: float = 0.0
    known_minus: float = 0.0


class Model(NamedTuple):
    """Motion of a modelled drive."""

    slow: float = 0.0  # mm/s
    quick: float = 0.0
    next: float = 0.0  # mm


_FIRST = State()


@part
def init(params):
    """Nominal drives at rest."""
    return _FIRST


@part
def reference(w0, w1, w2, w3, phase, instants, period):
    """The reference from the last four increments, mm/s: ``phase`` servo instants after an interpolation."""
    h = instants * period
    # A quartic through five points; places count in interpolations from the middle one.
    up_1, up_2, down_1, down_2 = w1 * h, (w1 + w0) * h, -w2 * h, -(w2 + w3) * h
    c1 = (8.0 * (up_1 - down_1) - (up_2 - down_2)) / 12.0
    c2 = (16.0 * (up_1 + down_1) - (up_2 + down_2)) / 24.0
    c3 = ((up_2 - down_2) - 2.0 * (up_1 - down_1)) / 12.0
    c4 = ((up_2 + down_2) - 4.0 * (up_1 + down_1)) / 24.0
    p = phase / instants
    q = p - 0.5 / instants  # the command is held for a servo period, so on average it acts half of one later
    return Reference(
        behind=up_1 + p * w0 * h - q * (c1 + q * (c2 + q * (c3 + q * c4))),
        v=(c1 + p * (2.0 * c2 + p * (3.0 * c3 + p * 4.0 * c4))) / h,
        a=(2.0 * c2 + p * (6.0 * c3 + p * 12.0 * c4)) / (h * h),
        j=(6.0 * c3 + p * 24.0 * c4) / (h * h * h),
    )


@part
def learnt(p, g, m, position, t1, t2, period):
    """Gains after the encoder's ``position``, mm, where the model expected it at ``m.next``."""
    v = m.slow + m.quick
    asked = v - (t1 + t2) * (m.slow / t1 + m.quick / t2)  # the command behind the velocity; its sign is what counts
    way, off, least = v * period, position - m.next, p.doubt * p.doubt
    if v > p.slow and asked > 0.0:
        known = p.recall * g.known_plus + way * way
        change = way * off / (known + least)
        other = ALIKE * change if g.known_minus == 0.0 else 0.0
        return Gains(clip(g.plus + change, WEAKEST, STRONGEST), g.minus + other, known, g.known_minus)
    if v < -p.slow and asked < 0.0:
        known = p.recall * g.known_minus + way * way
        change = way * off / (known + least)
        other = ALIKE * change if g.known_plus == 0.0 else 0.0
        return Gains(g.plus + other, clip(g.minus + change, WEAKEST, STRONGEST), g.known_plus, known)
    return g


@part
def driven(p, g, m, u, position, t1, t2, period):
    """The model a servo period later: of a drive at ``position`` that is told ``u``, mm/s."""
    c = u * p.gain * (g.plus if u > 0.0 else g.minus)
    keep_1, keep_2 = np.exp(-period / t1), np.exp(-period / t2)
    c1, c2 = t1 / (t1 - t2), -t2 / (t1 - t2)
    way_1, way_2 = t1 * (1.0 - keep_1), t2 * (1.0 - keep_2)
    ahead = way_1 * m.slow + way_2 * m.quick + (period - c1 * way_1 - c2 * way_2) * c
    slow, quick = keep_1 * m.slow + c1 * (1.0 - keep_1) * c, keep_2 * m.quick + c2 * (1.0 - keep_2) * c
    return Model(slow, quick, position + ahead)


@part
def told(p, g, r, error, t1, t2):
    """The command to a drive, mm/s."""
    u = (r.v + (t1 + t2) * r.a + t1 * t2 * r.j) / p.gain
    return u / (g.plus if u > 0.0 else g.minus) + p.kv * (error - r.behind)


@part
def control(params, state, signals, tables):
    """Velocities of the axes, mm/s."""
    p, s, period = params, state, signals.period
    x, y = Model(s.x_slow, s.x_quick, s.x_next), Model(s.y_slow, s.y_quick, s.y_next)
    gx = Gains(s.x_plus, s.x_minus, s.known_x_plus, s.known_x_minus)
    gy = Gains(s.y_plus, s.y_minus, s.known_y_plus, s.known_y_minus)
    slower = s.slower
    if not signals.fresh:
        t1, t2 = 1e-3 * p.t1 * slower, 1e-3 * p.t2 * slower
        # A drive that is slower by ds is (T1 + T2)·ds later.
        late_x, late_y = x.slow / t1 + x.quick / t2, y.slow / t1 + y.quick / t2
        late = 1e-3 * (p.t1 + p.t2) * period
        wrong = late * (late_x * (signals.position_x - x.next) + late_y * (signals.position_y - y.next))
        gx = learnt(p, gx, x, signals.position_x, t1, t2, period)
        gy = learnt(p, gy, y, signals.position_y, t1, t2, period)
        slower = clip(slower + p.learn * wrong, QUICKEST, SLOWEST)
    if s.phase == 0.0:
        s = s._replace(
            x_0=signals.velocity_x, x_1=s.x_0, x_2=s.x_1, x_3=s.x_2,
            y_0=signals.velocity_y, y_1=s.y_0, y_2=s.y_1, y_3=s.y_2,
        )  # fmt: skip
    t1, t2 = 1e-3 * p.t1 * slower, 1e-3 * p.t2 * slower
    to_x = reference(s.x_0, s.x_1, s.x_2, s.x_3, s.phase, p.instants, period)
    to_y = reference(s.y_0, s.y_1, s.y_2, s.y_3, s.phase, p.instants, period)
    u, v = told(p, gx, to_x, signals.error_x, t1, t2), told(p, gy, to_y, signals.error_y, t1, t2)
    x = driven(p, gx, x, u, signals.position_x, t1, t2, period)
    y = driven(p, gy, y, v, signals.position_y, t1, t2, period)
    phase = s.phase + 1.0 if s.phase + 1.0 < p.instants else 0.0
    return s._replace(
        phase=phase, x_slow=x.slow, x_quick=x.quick, x_next=x.next, y_slow=y.slow, y_quick=y.quick, y_next=y.next,
        x_plus=gx.plus, x_minus=gx.minus, known_x_plus=gx.known_plus, known_x_minus=gx.known_minus,
        y_plus=gy.plus, y_minus=gy.minus, known_y_plus=gy.known_plus, known_y_minus=gy.known_minus, slower=slower,
    ), Velocities(u, v)  # fmt: skip
