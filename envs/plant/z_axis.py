"""Z axis: velocity loop, its limits, friction, backlash, structural resonance, dead time, D/A and encoder.

The drive's velocity loop is of second order. Its motor obeys, with u the delayed and quantised command::

    da/dt = j − d(friction)/dt,   j = ω²·(u − v) − 2ζω·a,   |j| ≤ jerk,  |a| ≤ acceleration,  |v| ≤ speed,  z in travel

Speed and travel are kept by barriers rather than by stops, so that none of the others is ever broken: near the top
speed the acceleration is held below ``0.9·(speed − v)·jerk/acceleration``, near an end of travel the command below
``distance/τ``, where τ is the time to brake from top speed (with 0.8 of the acceleration) and three times what it takes
to get the braking going. An axis whose top speed is high for its acceleration feels its ends from far away.

The head hangs on the motor through a backlash that gravity closes (it opens only while the motor accelerates downward
faster than g), and through a structural mode that carries the share ``compliance`` of the load path::

    head/motor = (1 − c) + c·ωr²/(s² + 2·ζr·ωr·s + ωr²)

Friction is LuGre's (Canudas de Wit et al. 1995): bristles bend by z before they slide, at g(v) between static and
Coulomb friction F::

    dz/dt = v − σ·|v|·z/g(v),   friction = σ·z,   g(v) = F·(1 + (stiction − 1)/(1 + (v/stribeck)²)),   σ = F/bristle

So an axis that turns back sticks until its velocity loop has wound up enough to break it loose. The drop of friction
with speed is a Lorentzian (Hess and Soom 1990) instead of a Gaussian, which costs no exponential; the bristles' own
damping is left out, since the velocity loop's is far larger [A].

A command acts after the dead time, which holds the latency of computing and field bus as well. Both are drawn once for
an episode. They do not change from period to period: the jitter of a real bus is not in the model.
"""

from typing import Annotated, NamedTuple

import numpy as np

from ..engine.lanes import clip, fma, part
from ..engine.quantity import Quantity

GRAVITY = 9810.0
"""mm/s²"""

QUEUE, LONG_QUEUE = 7, 23
"""Commands that a dead time can hold back, and a long one; the longest is that many control periods less one."""

SHORTEST_BRISTLE = 1e-4
"""mm; what bends less under 1 g of friction is stiffer than substeps of 50 µs can follow."""


class Params(NamedTuple):
    """One Z axis."""

    omega: float = 502.65  # rad/s, velocity loop, 2π·80 Hz [A] 50–200 Hz
    zeta: Annotated[float, Quantity("1", 0.2, 2, "its damping ratio")] = 0.8
    speed: Annotated[float, Quantity("mm/s", 10, 2000, "limit", "lead 10 mm × 3000 rpm [S] Xi2023")] = 500.0
    acceleration: Annotated[float, Quantity("mm/s²", 500, 1e5, "limit", "[A] 1–2 g")] = 14000.0
    jerk: Annotated[float, Quantity("mm/s³", 1e4, 1e8, "limit of the drive", "[A] 1000–5000 m/s³")] = 2e6
    dead_time: float = 1.0  # control periods, up to LONG_QUEUE − 1 [A] 1–2
    dac: float = 500.0 / 32768.0  # mm/s per step of the 16-bit ±10 V D/A; 0: ideal [A]
    encoder: Annotated[float, Quantity("mm", 0, 0.1, "per count; 0: ideal", "[A] 10 000 per turn of 10 mm")] = 1e-3
    friction: Annotated[float, Quantity("mm/s²", 0, 1e4, "Coulomb friction over mass", "[A] 5–10 % of rated")] = 800.0
    creep: float = 1.0  # mm/s, speed at which friction has grown to its full value; of no use with bristles [A]
    bristle: Annotated[
        float, Quantity("mm", 0, 0.1, "that Coulomb friction bends before it slides (LuGre); 0: viscous below 1 mm/s")
    ] = 0.0
    stiction: Annotated[float, Quantity("1", 1, 3, "static over Coulomb friction", "[A] 1.2–1.6")] = 1.0
    stribeck: Annotated[float, Quantity("mm/s", 0.1, 100, "speed at which half that difference is gone")] = 2.0
    backlash: Annotated[float, Quantity("mm", 0, 0.2, "free play, closed by gravity", "[A] 2–10 µm")] = 0.005
    omega_r: float = 628.3  # rad/s, structural resonance, 2π·100 Hz [A] 60–150 Hz
    zeta_r: Annotated[float, Quantity("1", 0.005, 1, "its damping ratio")] = 0.05
    compliance: Annotated[float, Quantity("1", 0, 1, "its share of the load path")] = 0.1
    low: float = -40.0  # mm, lower end of travel [A]
    high: float = 110.0  # mm, upper end of travel [A]


class State(NamedTuple):
    """Motion of motor and head."""

    position: float = 0.0  # mm, motor
    velocity: float = 0.0  # mm/s, motor
    acceleration: float = 0.0  # mm/s², motor
    resist: float = 0.0  # mm/s², friction now
    play: float = 0.0  # mm by which the head has risen off its lower flank, 0 to backlash
    falling: float = 0.0  # mm/s, speed of the head within the backlash
    mode: float = 0.0  # mm, deflected end of the structural mode
    mode_velocity: float = 0.0  # mm/s
    bent: float = 0.0  # mm, deflection of the friction's bristles


class Drive(NamedTuple):
    """Commands on their way, mm/s: the newest first."""

    c0: float = 0.0
    c1: float = 0.0
    c2: float = 0.0
    c3: float = 0.0
    c4: float = 0.0
    c5: float = 0.0
    c6: float = 0.0


class Late(NamedTuple):
    """Commands on their way that are older than those of :class:`Drive`, mm/s: the newest first.

    Only dead times of more than ``QUEUE − 1`` periods have some, so that the others do not pay for them.
    """

    c7: float = 0.0
    c8: float = 0.0
    c9: float = 0.0
    c10: float = 0.0
    c11: float = 0.0
    c12: float = 0.0
    c13: float = 0.0
    c14: float = 0.0
    c15: float = 0.0
    c16: float = 0.0
    c17: float = 0.0
    c18: float = 0.0
    c19: float = 0.0
    c20: float = 0.0
    c21: float = 0.0
    c22: float = 0.0


class Gains(NamedTuple):
    """What follows from the parameters alone: coefficients of the substeps, made once per episode."""

    stiff: float = 0.0  # ω²·dt
    damp: float = 0.0  # 2ζω·dt
    near_end: float = 0.0  # 1/s
    near_low: float = 0.0  # mm/s, near_end·low
    near_high: float = 0.0  # mm/s, near_end·high
    soft: float = 0.0  # 1/s
    soft_speed: float = 0.0  # mm/s², soft·speed
    drag: float = 0.0  # 1/s, friction/creep
    jolt: float = 0.0  # mm/s², jerk·dt
    mode_stiff: float = 0.0
    mode_keep: float = 0.0  # what damping leaves of the mode's velocity
    spring: float = 0.0  # 1/s², stiffness of the bristles over mass; 0: no bristles
    extra: float = 0.0  # mm/s², static less Coulomb friction
    slow: float = 0.0  # s/mm, 1/stribeck


class Pace(NamedTuple):
    """The commands of a control period."""

    before: float = 0.0  # mm/s
    after: float = 0.0  # mm/s
    change: float = 0.0  # share of the period at which `after` takes over


@part
def accept(p, d, command):
    """A new command enters at the start of a control period: speed limit, D/A, queue."""
    u = clip(command, -p.speed, p.speed)
    u = np.rint(u / p.dac) * p.dac if p.dac > 0.0 else u
    return Drive(u, d.c0, d.c1, d.c2, d.c3, d.c4, d.c5)


@part
def passed_on(late, oldest):
    """The ``oldest`` command of a :class:`Drive` goes over to the late ones, before a new one enters there."""
    return Late(
        oldest, late.c7, late.c8, late.c9, late.c10, late.c11, late.c12, late.c13, late.c14, late.c15, late.c16,
        late.c17, late.c18, late.c19, late.c20, late.c21,
    )  # fmt: skip


@part
def gains(p, dt):
    """The :class:`Gains` of an axis for substeps of ``dt`` seconds."""
    x, xr = p.omega * dt, p.omega_r * dt
    near_end = 1.0 / (p.speed / (0.8 * p.acceleration) + 3.0 * (2.0 * p.zeta / p.omega + p.acceleration / p.jerk))
    soft = 0.9 * p.jerk / p.acceleration
    return Gains(
        stiff=p.omega * x * (1.0 - p.zeta * x),
        damp=2.0 * p.zeta * x - (2.0 * p.zeta * p.zeta - 0.5) * x * x,
        near_end=near_end,
        near_low=near_end * p.low,
        near_high=near_end * p.high,
        soft=soft,
        soft_speed=soft * p.speed,
        drag=p.friction / p.creep,
        jolt=p.jerk * dt,
        mode_stiff=p.omega_r * xr * (1.0 - p.zeta_r * xr),
        mode_keep=1.0 - 2.0 * p.zeta_r * xr * (1.0 - p.zeta_r * xr),
        spring=p.friction / p.bristle if p.bristle > 0.0 else 0.0,
        extra=p.friction * (p.stiction - 1.0),
        slow=1.0 / p.stribeck,
    )


@part
def _queued(d, n):
    """The command that entered ``n`` periods ago, mm/s."""
    recent = d.c0 if n < 1.0 else (d.c1 if n < 2.0 else (d.c2 if n < 3.0 else d.c3))
    return recent if n < 4.0 else (d.c4 if n < 5.0 else (d.c5 if n < 6.0 else d.c6))


@part
def pace(p, d):
    """The coming period's :class:`Pace` under the commands ``d``."""
    whole = np.floor(p.dead_time)
    older, newer = _queued(d, whole + 1.0), _queued(d, whole)
    return Pace(before=older, after=newer, change=p.dead_time - whole + 1e-9)


@part
def _waited(d, late, n):
    """The command that entered ``n`` periods ago, mm/s, among all of them."""
    second = late.c7 if n < 8.0 else (late.c8 if n < 9.0 else (late.c9 if n < 10.0 else late.c10))
    third = late.c11 if n < 12.0 else (late.c12 if n < 13.0 else (late.c13 if n < 14.0 else late.c14))
    fourth = late.c15 if n < 16.0 else (late.c16 if n < 17.0 else (late.c17 if n < 18.0 else late.c18))
    oldest = late.c19 if n < 20.0 else (late.c20 if n < 21.0 else (late.c21 if n < 22.0 else late.c22))
    early = _queued(d, n) if n < 7.0 else (second if n < 11.0 else third)
    return early if n < 15.0 else (fourth if n < 19.0 else oldest)


@part
def late_pace(p, d, late):
    """:func:`pace` of a drive that may have a long dead time, under the commands ``d`` and the older ones ``late``."""
    whole = np.floor(p.dead_time)
    older, newer = _waited(d, late, whole + 1.0), _waited(d, late, whole)
    return Pace(before=older, after=newer, change=p.dead_time - whole + 1e-9)


@part
def bend(p, g, s, dt):
    """Deflection of the bristles a substep later, mm (LuGre): they bend with the motion and slide at g(v).

    Implicit in their own deflection, so stable at any speed; with the speed in the middle of the substep, so that
    bristles that do not slide neither feed nor damp an oscillation. Of g(v) and 1 the multiple w is taken, which
    leaves one division.
    """
    v = fma(0.5 * dt, s.acceleration, s.velocity)
    w = fma(g.slow * v, g.slow * v, 1.0)
    sliding = fma(p.friction, w, g.extra)
    return fma(dt, v, s.bent) * (sliding / fma(abs(v) * dt * g.spring, w, sliding + 1e-300))


@part
def step(p, g, r, s, share, dt, bristles=True):
    """One substep of ``dt`` seconds that ends at ``share`` of the control period.

    Args:
        p, g, r, s: :class:`Params`, :class:`Gains`, :class:`Pace`, :class:`State`.
        bristles: whether the axis may have some; without, they cost nothing.

    Returns:
        ``(state, head)``: head is the position of the nozzle, mm.
    """
    command = r.before if share <= r.change else r.after
    u = clip(command, fma(-g.near_end, s.position, g.near_low), fma(-g.near_end, s.position, g.near_high))

    bent = bend(p, g, s, dt) if bristles else s.bent
    viscous = clip(g.drag * s.velocity, -p.friction, p.friction)
    lugre = bristles and g.spring > 0.0
    resist = g.spring * bent if lugre else viscous
    # Bristles pull at the axis past the drive's limits. The limits hold viscous friction as well, which is only there
    # for scenarios that were frozen with it.
    change = s.resist - resist
    pulled = change if lugre else 0.0
    wanted = fma(g.stiff, u - s.velocity, fma(-g.damp, s.acceleration, change - pulled))
    most = min(p.acceleration, fma(-g.soft, s.velocity, g.soft_speed))
    least = max(-p.acceleration, fma(-g.soft, s.velocity, -g.soft_speed))
    bounded = clip(s.acceleration + wanted, least, most)
    acceleration = s.acceleration + clip(bounded - s.acceleration, -g.jolt, g.jolt) + pulled
    velocity = fma(0.5 * dt, s.acceleration + acceleration, s.velocity)
    position = fma(0.5 * dt, s.velocity + velocity, s.position)

    # Free play: the head lies on the lower flank (play 0) and rises to the upper one (play = backlash) only while the
    # motor falls away from under it.
    falling = fma(-dt, acceleration + GRAVITY, s.falling)
    play = clip(fma(dt, falling, s.play), 0.0, p.backlash)
    carried = position + play

    mode_velocity = fma(g.mode_stiff, s.position + s.play - s.mode, g.mode_keep * s.mode_velocity)
    mode = fma(dt, mode_velocity, s.mode)
    head = fma(p.compliance, mode - carried, carried)
    free = play > 0.0 and play < p.backlash
    return State(
        position, velocity, acceleration, resist, play, falling if free else 0.0, mode, mode_velocity, bent
    ), head


@part
def at_rest(position):
    """The axis standing still at ``position``, mm."""
    return State(position, 0.0, 0.0, 0.0, 0.0, 0.0, position, 0.0, 0.0)


@part
def encoded(p, position):
    """What the encoder on the motor reads, mm."""
    return np.rint(position / p.encoder) * p.encoder if p.encoder > 0.0 else position
