"""Z axis: velocity loop, its limits, friction, backlash, structural resonance, dead time, D/A and encoder.

The drive's velocity loop is of second order. Its motor obeys, with u the delayed and quantised command::

    j = ω²·(u − v) − 2ζω·a − d(friction)/dt,   |j| ≤ jerk,  |a| ≤ acceleration,  |v| ≤ speed,  z inside the travel

Speed and travel are kept by barriers rather than by stops, so that none of the others is ever broken: near the top
speed the acceleration is held below ``(speed − v)·jerk/acceleration``, near an end of travel the command below
``distance/τ``, where τ is the time to brake from top speed and to get the braking going.

The head hangs on the motor through a backlash that gravity closes (it opens only while the motor accelerates downward
faster than g), and through a structural mode that carries the share ``compliance`` of the load path::

    head/motor = (1 − c) + c·ωr²/(s² + 2·ζr·ωr·s + ωr²)
"""

from typing import NamedTuple

import numpy as np

from .lanes import clip, part

GRAVITY = 9810.0
"""mm/s²"""

QUEUE = 5
"""Commands that the dead time can hold back; the longest dead time is ``QUEUE − 1`` control periods."""


class Params(NamedTuple):
    """One Z axis."""

    omega: float = 502.65  # rad/s, velocity loop, 2π·80 Hz [A] 50–200 Hz
    zeta: float = 0.8  # its damping ratio [A]
    speed: float = 500.0  # mm/s, lead 10 mm × 3000 rpm [S] Xi2023
    acceleration: float = 14000.0  # mm/s² [A] 1–2 g
    jerk: float = 2e6  # mm/s³, of the drive itself [A] 1000–5000 m/s³
    dead_time: float = 1.0  # control periods, up to QUEUE − 1 [A] 1–2
    dac: float = 500.0 / 32768.0  # mm/s per step of the 16-bit ±10 V D/A; 0: ideal [A]
    encoder: float = 1e-3  # mm per count, 10 000 counts per revolution of 10 mm; 0: ideal [A]
    friction: float = 800.0  # mm/s², Coulomb friction over mass, 5–10 % of the rated force [A]
    creep: float = 1.0  # mm/s, speed at which friction has grown to its full value [A]
    backlash: float = 0.005  # mm [A] 2–10 µm
    omega_r: float = 628.3  # rad/s, structural resonance, 2π·100 Hz [A] 60–150 Hz
    zeta_r: float = 0.05  # its damping ratio [A]
    compliance: float = 0.1  # its share of the load path's compliance [A]
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


class Drive(NamedTuple):
    """Commands on their way, mm/s: the newest first."""

    c0: float = 0.0
    c1: float = 0.0
    c2: float = 0.0
    c3: float = 0.0
    c4: float = 0.0


class Pace(NamedTuple):
    """What does not change within a control period: coefficients of the substeps, and the command before and after."""

    before: float = 0.0  # mm/s
    after: float = 0.0  # mm/s
    change: float = 0.0  # share of the period at which `after` takes over
    stiff: float = 0.0  # ω²·dt
    damp: float = 0.0  # 2ζω·dt
    near_end: float = 0.0  # 1/s
    soft: float = 0.0  # 1/s
    drag: float = 0.0  # 1/s, friction/creep
    jolt: float = 0.0  # mm/s², jerk·dt
    mode_stiff: float = 0.0
    mode_damp: float = 0.0


@part
def accept(p, d, command):
    """A new command enters at the start of a control period: speed limit, D/A, queue."""
    u = clip(command, -p.speed, p.speed)
    u = np.rint(u / p.dac) * p.dac if p.dac > 0.0 else u
    return Drive(u, d.c0, d.c1, d.c2, d.c3)


@part
def pace(p, d, dt):
    """The coming period's :class:`Pace` under the commands ``d``, for substeps of ``dt`` seconds."""
    whole = np.floor(p.dead_time)
    x, xr = p.omega * dt, p.omega_r * dt
    older = d.c1 if whole < 1.0 else (d.c2 if whole < 2.0 else (d.c3 if whole < 3.0 else d.c4))
    newer = (
        d.c0 if whole < 1.0 else (d.c1 if whole < 2.0 else (d.c2 if whole < 3.0 else (d.c3 if whole < 4.0 else d.c4)))
    )
    return Pace(
        before=older,
        after=newer,
        change=p.dead_time - whole + 1e-9,
        stiff=p.omega * x * (1.0 - p.zeta * x),
        damp=2.0 * p.zeta * x - (2.0 * p.zeta * p.zeta - 0.5) * x * x,
        near_end=1.0 / (p.speed / (0.8 * p.acceleration) + 3.0 * (2.0 * p.zeta / p.omega + p.acceleration / p.jerk)),
        soft=0.9 * p.jerk / p.acceleration,
        drag=p.friction / p.creep,
        jolt=p.jerk * dt,
        mode_stiff=p.omega_r * xr * (1.0 - p.zeta_r * xr),
        mode_damp=2.0 * p.zeta_r * xr * (1.0 - p.zeta_r * xr),
    )


@part
def step(p, r, s, share, dt):
    """One substep of ``dt`` seconds that ends at ``share`` of the control period.

    Args:
        p, r, s: :class:`Params`, :class:`Pace`, :class:`State`.

    Returns:
        ``(state, head)``: head is the position of the nozzle, mm.
    """
    command = r.before if share <= r.change else r.after
    u = clip(command, r.near_end * (p.low - s.position), r.near_end * (p.high - s.position))

    resist = clip(r.drag * s.velocity, -p.friction, p.friction)
    wanted = r.stiff * (u - s.velocity) - r.damp * s.acceleration - (resist - s.resist)
    most = min(p.acceleration, r.soft * (p.speed - s.velocity))
    least = max(-p.acceleration, -r.soft * (p.speed + s.velocity))
    bounded = clip(s.acceleration + wanted, least, most)
    acceleration = s.acceleration + clip(bounded - s.acceleration, -r.jolt, r.jolt)
    velocity = s.velocity + 0.5 * dt * (s.acceleration + acceleration)
    position = s.position + 0.5 * dt * (s.velocity + velocity)

    # Free play: the head lies on the lower flank (play 0) and rises to the upper one (play = backlash) only while the
    # motor falls away from under it.
    falling = s.falling - dt * (acceleration + GRAVITY)
    play = clip(s.play + dt * falling, 0.0, p.backlash)
    carried = position + play

    mode_velocity = s.mode_velocity + r.mode_stiff * (s.position + s.play - s.mode) - r.mode_damp * s.mode_velocity
    mode = s.mode + dt * mode_velocity
    head = carried + p.compliance * (mode - carried)
    free = play > 0.0 and play < p.backlash
    return State(position, velocity, acceleration, resist, play, falling if free else 0.0, mode, mode_velocity), head


@part
def at_rest(position):
    """The axis standing still at ``position``, mm."""
    return State(position, 0.0, 0.0, 0.0, 0.0, 0.0, position, 0.0)


@part
def encoded(p, position):
    """What the encoder on the motor reads, mm."""
    return np.rint(position / p.encoder) * p.encoder if p.encoder > 0.0 else position
