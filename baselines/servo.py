"""A model of Z drive and sheet for laws that predict: linear, in periods of the controller, from reading to reading.

Drive: a velocity loop of second order behind a dead time, ``v̈ = ω²·(u − v) − 2ζω·v̇``. Of the plant's parts it leaves
out limits, friction, backlash and the structural mode. ``dead_time`` counts from the instant that a reading belongs to
(the middle of its gate) to the first effect of the command that follows from it.

Sheet: its level has a speed, and its speed an acceleration that dies with the time constant τ (Singer 1970)::

    level' = speed,   speed' = acceleration,   acceleration' = −acceleration/τ        each with noise

What a law regulates are both together, seen from the sheet (:func:`ahead`): error, speed and commands relative to the
sheet's speed. In these a ramp is a place of rest, so feed-forward of the sheet's speed needs no term of its own.
"""

from typing import NamedTuple

import numpy as np

from kerfgym.envs.engine.lanes import exponential, part
from kerfgym.envs.plant.controller import PERIOD

TERMS = 26
"""Of the exponential's series; enough for rounding at ω·T up to 2."""


class Drive(NamedTuple):
    """What is identified (experiments/studies/identify.py)."""

    bandwidth: float = 80.0  # Hz
    zeta: float = 0.8
    dead_time: float = 1.6  # ms, 0 to 3


class SheetModel(NamedTuple):
    """One period of the sheet: ``level += T·speed + level_bend·a``, ``speed += speed_bend·a``, ``a *= keep``."""

    level_bend: float = 0.0  # s²
    speed_bend: float = 0.0  # s
    keep: float = 0.0


class Relative(NamedTuple):
    """Drive and sheet as seen from the sheet."""

    error: float = 0.0  # mm, head − sheet − set height
    speed: float = 0.0  # mm/s, head − sheet
    acceleration: float = 0.0  # mm/s², of the head
    sent_1: float = 0.0  # mm/s, commands of the last periods, less the sheet's speed; the newest first
    sent_2: float = 0.0
    sent_3: float = 0.0
    bend: float = 0.0  # mm/s², of the sheet


@part
def glide(omega, zeta, time, position, speed, acceleration, command):
    """Position, speed and acceleration of the drive after ``time`` seconds of a constant command: exact."""
    z, v, a, u = position, speed, acceleration, command
    stiff, damp = omega * omega, 2.0 * zeta * omega
    for i in range(1, TERMS):
        h = time / i
        z, v, a, u = h * v, h * a, h * (stiff * (u - v) - damp * a), 0.0
        position += z
        speed += v
        acceleration += a
    return position, speed, acceleration


@part
def period(drive, position, speed, acceleration, sent_1, sent_2, sent_3, command):
    """The drive one period on; ``command`` follows from the reading at its beginning, ``sent_…`` from those before."""
    omega, late = 6.283185307179586 * drive.bandwidth, drive.dead_time
    whole = np.floor(late)
    share = late - whole
    older = sent_1 if whole < 1.0 else (sent_2 if whole < 2.0 else sent_3)
    newer = command if whole < 1.0 else (sent_1 if whole < 2.0 else (sent_2 if whole < 3.0 else sent_3))
    z, v, a = glide(omega, drive.zeta, share * PERIOD, position, speed, acceleration, older)
    return glide(omega, drive.zeta, (1.0 - share) * PERIOD, z, v, a, newer)


@part
def sheet(tau):
    """The :class:`SheetModel` whose acceleration dies with the time constant ``tau``, s."""
    keep = exponential(-PERIOD / tau)
    speed_bend = tau * (1.0 - keep)
    return SheetModel(tau * (PERIOD - speed_bend), speed_bend, keep)


@part
def ahead(drive, course, x, change):
    """:class:`Relative` one period on, when the command changes by ``change`` (mm/s) and no noise acts."""
    command = x.sent_1 + change
    z, v, a = period(drive, x.error, x.speed, x.acceleration, x.sent_1, x.sent_2, x.sent_3, command)
    faster = course.speed_bend * x.bend
    error, bend = z - course.level_bend * x.bend, course.keep * x.bend
    return Relative(error, v - faster, a, command - faster, x.sent_1 - faster, x.sent_2 - faster, bend)
