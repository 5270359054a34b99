"""Height-following machines of another make: what identification meets when the machine is not its own model.

They share no code with the machine, and no equation where another is as usual:

- time: fourth-order Runge and Kutta, steps of 10 µs;
- drive: a velocity controller with integral, weighted set point, filtered speed and a current loop behind it that has a
  lag, a limit and a slew rate of its own; anti-windup by holding the integral;
- friction: Stribeck's curve with an exponential and a viscous part, stuck after Karnopp, or smoothed by a tanh; torque
  ripple along the screw;
- play of a counterbalanced nut, which stays where it is until it is picked up; the head on a flexure that carries all
  of it;
- encoder latched at the end of a period, its own count; its own converter;
- sensor: a disc over a plane after Kirchhoff, with the thickness of its edge, counted by a reciprocal counter.

Every number was written down before anything was identified from it.
"""

from collections import namedtuple
from dataclasses import astuple, dataclass, fields, replace
from typing import Any

import numpy as np
from numba import njit

SUBSTEPS = 100
DT = 1e-5  # s
HELD = 32  # commands that are remembered
STATES = 7  # motor's place and speed, current, integral, filtered speed, head's place and speed


@dataclass(frozen=True)
class Foreign:
    """A machine of another make. Lengths in mm, accelerations are forces over mass."""

    natural: float = 70.0  # Hz, of the velocity loop without the current loop's lag
    damping: float = 0.75
    weight: float = 0.0  # of the set point in the proportional part
    current: float = 0.4e-3  # s, lag of the current loop
    filtered: float = 0.2e-3  # s, lag of the speed's filter
    delay: float = 2.3e-3  # s, from a command to the drive
    jitter: float = 0.0  # s, by which it is later at most, another time each period
    speed: float = 450.0
    force: float = 13e3  # mm/s², limit of the current
    slew: float = 4e6  # mm/s³, of the current
    coulomb: float = 700.0  # mm/s²
    static: float = 950.0
    stribeck: float = 3.0  # mm/s
    viscous: float = 1.5  # 1/s
    smooth: float = 0.0  # mm/s, width of tanh; 0: Karnopp
    ripple: float = 25.0  # mm/s²
    pitch: float = 5.0  # mm, of the ripple
    bits: float = 16.0  # of the converter
    count: float = 0.5e-3  # mm, of the encoder
    play: float = 0.0  # mm
    flexure: float = 170.0  # Hz
    flexure_damping: float = 0.04
    bent: float = 1.0  # exponent of the drive's gain, (u/speed)**bent
    load: float = 0.0  # share of the motor's inertia that hangs on it by a spring
    load_natural: float = 40.0  # Hz, of the load on a motor that stands still
    load_damping: float = 0.03
    face: float = 5.0  # mm, radius of the plate
    bore: float = 1.0  # mm, radius
    edge: float = 3.0  # mm, thickness of the plate
    body: float = 12.0  # pF
    inductance: float = 150.0  # µH
    noise: float = 1.5e-3  # pF
    clock: float = 200e6  # Hz
    impulses: float = 1.5  # 1/s
    impulse: float = 0.05  # mm


GOOD = {
    "screw": Foreign(),
    "old": Foreign(
        natural=45.0, damping=0.9, weight=0.15, current=0.8e-3, filtered=0.4e-3, delay=4.1e-3, speed=300.0, force=9e3,
        slew=2e6, coulomb=900.0, static=1200.0, stribeck=5.0, viscous=3.0, smooth=0.3, bits=12.0, count=1.25e-3,
        play=5e-3, flexure=110.0, flexure_damping=0.03, face=4.5, body=9.0, inductance=180.0, noise=3e-3,
    ),
    "direct": Foreign(
        natural=110.0, damping=0.7, weight=0.3, current=0.25e-3, filtered=0.1e-3, delay=1.2e-3, speed=700.0, force=18e3,
        slew=1e7, coulomb=250.0, static=320.0, stribeck=8.0, viscous=2.0, ripple=60.0, pitch=24.0, count=1e-4,
        flexure=210.0, flexure_damping=0.05, face=6.0, body=14.0, inductance=120.0, noise=8e-4,
    ),
}  # fmt: skip
"""Machines that the model should be able to stand for: a screw with a good drive, an old and slow one with play, a
direct drive."""

FRESH = {
    "rack": Foreign(
        natural=38.0, damping=0.65, weight=0.2, current=0.6e-3, filtered=0.3e-3, delay=3.2e-3, speed=380.0, force=11e3,
        slew=3e6, coulomb=500.0, static=640.0, stribeck=4.0, viscous=4.0, smooth=0.15, ripple=80.0, pitch=12.0,
        bits=14.0, count=2e-3, play=8e-3, flexure=95.0, flexure_damping=0.05, face=5.5, bore=0.75, edge=2.0, body=8.0,
        inductance=165.0, noise=2e-3, impulses=4.0,
    ),
    "linear motor": Foreign(
        natural=140.0, damping=0.85, weight=0.0, current=0.15e-3, filtered=0.15e-3, delay=0.8e-3, speed=900.0,
        force=25e3, slew=2e7, coulomb=150.0, static=180.0, stribeck=12.0, viscous=6.0, ripple=120.0, pitch=30.0,
        count=5e-5, flexure=260.0, flexure_damping=0.03, face=4.0, edge=4.0, body=16.0, inductance=200.0, noise=1e-3,
    ),
    "gear": Foreign(
        natural=60.0, damping=1.0, weight=0.4, current=0.5e-3, filtered=0.5e-3, delay=6.3e-3, speed=260.0, force=7.5e3,
        slew=1.5e6, coulomb=1100.0, static=1600.0, stribeck=2.0, viscous=0.5, ripple=10.0, pitch=2.0, bits=12.0,
        count=1e-3, play=1.5e-2, flexure=130.0, flexure_damping=0.06, body=11.0, inductance=140.0, noise=4e-3,
    ),
}  # fmt: skip
"""More of these, on which nobody looked while identification was made."""

WRONG = {
    "bent gain": replace(Foreign(), bent=0.85),
    "load at 40 Hz": replace(Foreign(), load=0.5),
    "late by turns": replace(Foreign(), jitter=2e-3),
}
"""Machines that it can't stand for."""

_Numbers = namedtuple("_Numbers", [f.name for f in fields(Foreign)])


@njit(cache=True)
def _friction(v, coulomb, static, stribeck, viscous):
    """Stribeck's curve at a speed that is not 0."""
    a = abs(v)
    return (coulomb + (static - coulomb) * np.exp(-((a / stribeck) ** 2)) + viscous * a) * np.sign(v)


@njit(cache=True)
def _slope(y, out, p, u, carried, carried_speed, load):
    """Time derivatives of the states; ``load``: acceleration by what hangs on the motor."""
    omega = 2 * np.pi * p.natural
    kp, ki = 2 * p.damping * omega, omega * omega
    asked = kp * (p.weight * u - y[4]) + y[3]
    given = min(max(asked, -p.force), p.force)
    winding = ki * (u - y[4])
    if asked != given and winding * asked > 0.0:
        winding = 0.0
    change = min(max((given - y[2]) / p.current, -p.slew), p.slew)
    pull = y[2] + p.ripple * np.sin(2 * np.pi * y[0] / p.pitch) + load
    if p.smooth > 0.0:
        push = np.tanh(y[1] / p.smooth) * abs(_friction(abs(y[1]) + 1e-9, p.coulomb, p.static, p.stribeck, p.viscous))
        acceleration = pull - push
    elif abs(y[1]) < 0.02:  # Karnopp: what is slow sticks up to the static force, and comes to rest
        acceleration = -y[1] / 2e-5 if abs(pull) <= p.static else pull - p.static * np.sign(pull)
    else:
        acceleration = pull - _friction(y[1], p.coulomb, p.static, p.stribeck, p.viscous)
    wr = 2 * np.pi * p.flexure
    out[0], out[1], out[2], out[3] = y[1], acceleration, change, winding
    out[4] = (y[1] - y[4]) / p.filtered
    out[5] = y[6]
    out[6] = wr * wr * (carried - y[5]) + 2 * p.flexure_damping * wr * (carried_speed - y[6])


@njit(cache=True)
def _frequency(gap, noise, face, bore, edge, body, inductance):
    """Hz: Kirchhoff's disc over a plane, its mirror image twice the gap away."""
    e0, d = 8.8541878128e-3, 2.0 * gap
    t = 2.0 * edge
    plate = e0 * np.pi * (face * face - bore * bore) / gap
    fringe = 2.0 * e0 * face * (np.log(16 * np.pi * face * (d + t) / (d * d)) + t / d * np.log(1.0 + d / t) - 1.0)
    c = body + plate + max(fringe, 0.0) + noise
    return 1e9 / (2 * np.pi * np.sqrt(inductance * c))


@njit(cache=True)
def _surface(sheet, spacing, x):
    at = x / spacing
    i = min(max(int(at), 0), len(sheet) - 2)
    return sheet[i] + (sheet[i + 1] - sheet[i]) * (at - i)


@njit(cache=True)
def _period(p, y, hang, held, arrives, sheet, spacing, x, feed, draws, seen):
    """A period. ``held`` and ``arrives``: commands, and from which step on they act, the newest first."""
    k = np.empty((4, STATES))
    z = np.empty(STATES)
    wl = 2 * np.pi * p.load_natural
    total, touched, gap = 0.0, False, 0.0
    for n in range(SUBSTEPS):
        u = 0.0
        for i in range(HELD):
            if arrives[i] <= n:
                u = held[i]
                break
        u = min(max(u, -p.speed), p.speed)
        step = p.speed / 2.0 ** (p.bits - 1.0)
        u = np.rint(u / step) * step
        if p.bent != 1.0:
            u = np.sign(u) * p.speed * (abs(u) / p.speed) ** p.bent
        before = hang[2]
        hang[2] = min(max(hang[2], y[0] - 0.5 * p.play), y[0] + 0.5 * p.play)
        picked = y[1] if p.play == 0.0 else (hang[2] - before) / DT
        spring = wl * wl * (hang[0] - y[0]) + 2 * p.load_damping * wl * (hang[1] - y[1])
        for r in range(4):
            c = 0.0 if r == 0 else (0.5 * DT if r < 3 else DT)
            for j in range(STATES):
                z[j] = y[j] if r == 0 else y[j] + c * k[r - 1, j]
            _slope(z, k[r], p, u, hang[2] + c * picked, picked, p.load * spring)
        for j in range(STATES):
            y[j] += DT / 6.0 * (k[0, j] + 2 * k[1, j] + 2 * k[2, j] + k[3, j])
        hang[1] -= DT * spring
        hang[0] += DT * hang[1]
        gap = y[5] - _surface(sheet, spacing, x + feed * DT * (n + 1))
        if gap <= 0.0:
            touched = True
        if n >= 75:
            total += gap
    felt = total / 25.0
    if draws[2] < p.impulses * 1e-3:
        felt += p.impulse * (2.0 * draws[3] - 1.0)
    f = _frequency(max(felt, 1e-3), p.noise * draws[0], p.face, p.bore, p.edge, p.body, p.inductance)
    periods = np.floor(0.25e-3 * f)
    f = periods * p.clock / np.floor(periods * p.clock / f + draws[1])
    seen[0] = np.rint(y[0] / p.count) * p.count
    seen[1] = 0.0 if touched else f
    seen[2] = gap
    for i in range(HELD):
        arrives[i] -= SUBSTEPS


class Running:
    """A machine of another make that runs over a sheet.

    Args:
        make: its numbers.
        start: mm above the sheet's first place.
        sheet, spacing: mm, heights of the sheet every ``spacing`` mm; none: a plate at 0.
        feed: mm/s.
        seed: of noise and impulses.
    """

    def __init__(
        self, make: Foreign, start: float, sheet: Any = (0.0, 0.0), spacing: float = 1e3, feed: float = 0.0,
        seed: int = 0,
    ) -> None:  # fmt: skip
        self.make, self.sheet, self.spacing, self.feed = make, np.asarray(sheet, float), spacing, feed
        self.rng = np.random.default_rng(seed)
        at = start + self.sheet[0]
        self.y = np.array([at, 0.0, 0.0, 0.0, 0.0, at, 0.0])
        self.hang = np.array([at, 0.0, at])
        self.held, self.arrives = np.zeros(HELD), np.full(HELD, -1e9)
        self.arrives[0] = -1.0
        self.x, self.seen, self.p = 0.0, np.zeros(3), _Numbers(*astuple(make))

    def step(self, command: float) -> tuple[float, float]:
        """A period under a command, mm/s: encoder, mm, and frequency, Hz (0: it touches)."""
        late = self.make.delay + self.make.jitter * (self.rng.random() if self.make.jitter else 0.0)
        self.held[1:], self.arrives[1:] = self.held[:-1].copy(), self.arrives[:-1].copy()
        self.held[0], self.arrives[0] = command, late / DT
        draws = np.array([self.rng.normal(), *self.rng.random(3)])
        _period(self.p, self.y, self.hang, self.held, self.arrives, self.sheet, self.spacing, self.x, self.feed,
                draws, self.seen)  # fmt: skip
        self.x += 1e-3 * self.feed
        return float(self.seen[0]), float(self.seen[1])

    def converted(self, command: float) -> float:
        """What the converter makes of a command, mm/s."""
        step = self.make.speed / 2.0 ** (self.make.bits - 1.0)
        return float(np.clip(np.rint(command / step) * step, -self.make.speed, self.make.speed))

    @property
    def gap(self) -> float:
        """mm, between nozzle and sheet at the end of the last period."""
        return float(self.seen[2])
