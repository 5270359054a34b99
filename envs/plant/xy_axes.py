"""X and Y axes: sampled position loops around a drive with two time constants (Wu).

Every interpolation period the path gives a new position; the way there is issued to the loops in equal increments, one
per servo period (8 ms and 4 ms with Wu). At a servo instant i the position error is

    ``E_i = E_{i−1} − ΔA_i + ΔO_{i−1}``,

which is what was issued before, less what the encoder has moved. A law makes a velocity command of it, which passes
the D/A converter, the drive's gain of that direction, its limits of speed and acceleration, and the drive itself::

    V(s)/U(s) = (1 + τs)/((1 + T1·s)(1 + T2·s)) = c1/(1 + T1·s) + c2/(1 + T2·s),
    c1 = (T1 − τ)/(T1 − T2),  c2 = (τ − T2)/(T1 − T2)

which is integrated exactly over a control period. What happens to the velocity distinguishes two modes:

* *physical*: the slide moves by its integral;
* *literal*: Wu's difference equation sums the velocities sampled at the servo instants, ``z/(z − 1)``, and the position
  loop is ``G(z) = K·z·(A·z − B)/((z − 1)(z − C)(z − D))`` (:func:`z_domain`). Between the instants the slide is drawn
  moving evenly, one servo period late.
"""

from typing import Annotated, NamedTuple

import numpy as np

from ..engine.lanes import clip, fma, part
from ..engine.quantity import Quantity


class Params(NamedTuple):
    """A pair of axes. Defaults: Wu, with constants (a) of docs/physics.md#the-x-and-y-axes."""

    literal: bool = False
    servo: float = 4.0  # control periods of 1 ms from servo instant to servo instant [S] Wu
    interpolation: float = 8.0  # control periods, a multiple of ``servo`` [S] Wu
    t1: float = 0.020  # s, drive [C] puts the limit of stability at Kp = 4.5 together with the next three
    t2: float = 0.005  # s [C]
    tau: float = 0.0  # s, its zero [C]
    gain: float = 1.1116  # velocity per command, K_DA·Km·K_AD [C]
    x_plus: Annotated[float, Quantity("1", 0.2, 5, "gain of +x, of the nominal one")] = 1.0
    x_minus: Annotated[float, Quantity("1", 0.2, 5, "gain of −x")] = 1.0
    y_plus: Annotated[float, Quantity("1", 0.2, 5, "gain of +y")] = 1.0
    y_minus: Annotated[float, Quantity("1", 0.2, 5, "gain of −y")] = 1.0
    speed: float = 166.6667  # mm/s, limit of an axis: 10 m/min rapid [S] Wu
    acceleration: float = 2000.0  # mm/s², limit of an axis [A]
    dac: float = 166.6667 / 32768.0  # mm/s per step of a 16-bit D/A; 0: ideal [A]
    encoder: float = 1e-3  # mm per count; 0: ideal [A]


class Gains(NamedTuple):
    """What follows from :class:`Params` alone, for control periods of 1 ms."""

    keep_1: float = 0.0  # e^(−dt/T1)
    keep_2: float = 0.0
    feed_1: float = 0.0  # c1·(1 − e^(−dt/T1))
    feed_2: float = 0.0
    way_1: float = 0.0  # s, T1·(1 − e^(−dt/T1)): way of a velocity that dies away
    way_2: float = 0.0
    drag: float = 0.0  # s, way that a command is still short of after dt


class Axis(NamedTuple):
    """Motion of one axis."""

    issued: float = 0.0  # mm, what the loop has been asked for so far
    step: float = 0.0  # mm, issued at each servo instant until the next interpolation
    command: float = 0.0  # mm/s, behind D/A and gain
    part_1: float = 0.0  # mm/s, the drive's velocity in two parts
    part_2: float = 0.0
    position: float = 0.0  # mm, the slide
    summed: float = 0.0  # mm, literal: the sum of sampled speeds
    pace: float = 0.0  # mm, literal: by which the slide moves in each control period


@part
def _modes(p, dt):
    """What is left of the drive's two parts after ``dt`` seconds, and their weights c1 and c2."""
    c1, c2 = (p.t1 - p.tau) / (p.t1 - p.t2), (p.tau - p.t2) / (p.t1 - p.t2)
    return np.exp(-dt / p.t1), np.exp(-dt / p.t2), c1, c2


@part
def gains(p, dt):
    """The :class:`Gains` for control periods of ``dt`` seconds."""
    e1, e2, c1, c2 = _modes(p, dt)
    way_1, way_2 = p.t1 * (1.0 - e1), p.t2 * (1.0 - e2)
    return Gains(e1, e2, c1 * (1.0 - e1), c2 * (1.0 - e2), way_1, way_2, dt - c1 * way_1 - c2 * way_2)


@part
def at_rest(position):
    """An axis standing still, mm."""
    return Axis(position, 0.0, 0.0, 0.0, 0.0, position, position, 0.0)


@part
def velocity(a):
    """mm/s of the slide's drive."""
    return a.part_1 + a.part_2


@part
def encoded(p, a):
    """What the encoder reads, mm."""
    position = a.summed if p.literal else a.position
    return np.rint(position / p.encoder) * p.encoder if p.encoder > 0.0 else position


@part
def sampled(p, a):
    """The axis at a servo instant: the literal mode adds the sampled speed to its sum."""
    moved = velocity(a) * p.servo * 1e-3
    if p.literal:
        return a._replace(summed=a.summed + moved, pace=moved / p.servo)
    return a


@part
def headed(p, a, target):
    """The axis at an interpolation instant: the way to ``target`` (mm), in one increment per servo period."""
    return a._replace(step=(target - a.issued) * p.servo / p.interpolation)


@part
def commanded(p, a, command, plus, minus):
    """The axis takes the law's ``command`` (mm/s) and is issued the next increment."""
    u = np.rint(command / p.dac) * p.dac if p.dac > 0.0 else command
    u = clip(u * p.gain * (plus if u > 0.0 else minus), -p.speed, p.speed)
    return a._replace(issued=a.issued + a.step, command=u)


@part
def moved(p, g, a, dt):
    """The axis one control period of ``dt`` seconds later; what the motor cannot do at once, it does with the share
    ``f`` of what the drive asks for."""
    next_1, next_2 = fma(g.keep_1, a.part_1, g.feed_1 * a.command), fma(g.keep_2, a.part_2, g.feed_2 * a.command)
    now = a.part_1 + a.part_2
    change, most = next_1 + next_2 - now, p.acceleration * dt
    f = most / abs(change) if abs(change) > most else 1.0
    asked = fma(g.way_1, a.part_1, fma(g.way_2, a.part_2, g.drag * a.command))
    way = f * asked + (1.0 - f) * now * dt
    part_1, part_2 = a.part_1 + f * (next_1 - a.part_1), a.part_2 + f * (next_2 - a.part_2)
    position = a.position + (a.pace if p.literal else way)
    return a._replace(part_1=part_1, part_2=part_2, position=position)


# ------------------------------------------------------------------------------------------------- the z domain


def z_domain(p, period=None):
    """``(A, B, C, D)`` of Wu's open loop for a servo period in seconds (default: that of ``p``)."""
    t = p.servo * 1e-3 if period is None else period
    c, d, c1, c2 = _modes(p, t)
    return 1.0 - c1 * c - c2 * d, c1 * d + c2 * c - c * d, c, d


def characteristic(p, k):
    """Coefficients of Wu's characteristic equation z³ + (KA − C − D − 1)z² + (CD + C + D − KB)z − CD = 0."""
    a, b, c, d = z_domain(p)
    return np.array([1.0, k * a - c - d - 1.0, c * d + c + d - k * b, -c * d])


def physical_loop(p, k):
    """State matrix of the sampled loop whose slide moves by the integral of its velocity, K = ``k``.

    States at a servo instant: the two parts of the velocity (times the servo period) and the position error.
    """
    t = p.servo * 1e-3
    c, d, c1, c2 = _modes(p, t)
    w1, w2 = p.t1 * (1.0 - c) / t, p.t2 * (1.0 - d) / t
    error = 1.0 - k * (1.0 - c1 * w1 - c2 * w2)
    return np.array([[c, 0.0, k * c1 * (1.0 - c)], [0.0, d, k * c2 * (1.0 - d)], [-w1, -w2, error]])


def largest_gain(p):
    """The K at which the loop of ``p`` (literal or physical) begins to be unstable, by bisection."""

    def stable(k):
        roots = np.roots(characteristic(p, k)) if p.literal else np.linalg.eigvals(physical_loop(p, k))
        return np.abs(roots).max() < 1.0

    low, high = 0.0, 1.0
    while stable(high):
        high *= 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
