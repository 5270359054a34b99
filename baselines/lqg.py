"""LQG: Kalman filters of drive and sheet, and a linear-quadratic regulator, on an identified model.

The model is :mod:`servo`'s. Two Kalman filters (Kalman 1960) estimate the drive (from the encoder and the commands that
were sent) and the sheet (from encoder − reading, as the surface observer does). The regulator minimises, over all
coming periods,

    Σ error² + (damping·relative speed)² + (effort·change of command)²

and returns the last command that went to the drive, plus a change. So it is bumpless after the supervisor has
overridden it, nothing winds up, and the sheet's speed is fed forward by itself. Gains follow from the variances and
weights by iterating the Riccati equations when an episode begins.

What an innovation of the sheet exceeds ``gate`` by is cut off, so impulses hardly move the estimate. Far from the sheet
it is taken to be where it is read; over a hole it is not read at all.

Defaults of bandwidth, damping and dead time are means over the following suite's plants, as identified by
``python -m kerfgym.experiments.studies.identify``.
"""

from typing import Annotated, NamedTuple

from kerfgym.baselines import riccati, servo
from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.plant.supervisor import HOLD


class Params(NamedTuple):
    """Model, variances (as standard deviations) and weights; of these only ratios matter.

    Default variances and weights are rounded from a first search of 160 trials on tune seeds.
    """

    bandwidth: Annotated[
        float,
        Quantity("Hz", 20.0, 250.0, "of the model's velocity loop", "[C] experiments/studies/identify.py", log=True),
    ] = 84.2
    zeta: Annotated[float, Quantity("1", 0.3, 3.0, "its damping ratio", "[C] experiments/studies/identify.py")] = 0.78
    dead_time: Annotated[
        float,
        Quantity("ms", 0.0, 3.0, "from reading to the command's first effect", "[C] experiments/studies/identify.py"),
    ] = 2.2
    encoder: Annotated[float, Quantity("mm", 1e-5, 0.1, "noise of the encoder; 1 µm/√12 by its counts", log=True)] = (
        3e-4
    )
    drift: Annotated[
        float, Quantity("mm/s²", 10.0, 1e4, "change of the drive's acceleration in a period", log=True)
    ] = 400.0
    reading: Annotated[float, Quantity("mm", 1e-5, 0.1, "noise of the reading", log=True)] = 2e-3
    shift: Annotated[float, Quantity("mm", 1e-5, 0.02, "random change of the sheet's level in a period", log=True)] = (
        2e-3
    )
    wander: Annotated[float, Quantity("mm/s", 1e-3, 10.0, "of its speed", log=True)] = 0.2
    bend: Annotated[float, Quantity("mm/s²", 0.1, 1e4, "of its acceleration", log=True)] = 1.0
    memory: Annotated[
        float, Quantity("ms", 0.1, 1000.0, "time constant with which its acceleration dies", log=True)
    ] = 20.0
    gate: Annotated[float, Quantity("mm", 0.005, 5.0, "largest innovation of the sheet that counts", log=True)] = 0.05
    effort: Annotated[
        float, Quantity("ms", 1.0, 200.0, "weight of a change of command over that of an error", log=True)
    ] = 16.0
    damping: Annotated[float, Quantity("ms", 0.0, 50.0, "weight of the speed relative to the sheet")] = 15.0


class State(NamedTuple):
    """The estimate, and commands on their way."""

    position: float = 0.0  # mm, of the head
    velocity: float = 0.0  # mm/s
    acceleration: float = 0.0  # mm/s²
    level: float = 0.0  # mm, of the sheet
    speed: float = 0.0  # mm/s
    bend: float = 0.0  # mm/s²
    sent_1: float = 0.0  # mm/s, the newest
    sent_2: float = 0.0
    sent_3: float = 0.0


_FIRST = State()

FOLLOWED = 30.0
"""mm/s, change of command that a drive still follows within the model's few periods, at 1 to 2 g [A]."""

# Places in the memory. LQR: model, weights, solution.
STATES = 7
A = 0
B = A + STATES * STATES
Q = B + STATES
P = Q + STATES
K = P + STATES * STATES
WORK = K + STATES
# A period of the drive: rows position, velocity, acceleration; columns velocity, acceleration, sent 1 to 3, command.
STEP = WORK + STATES * STATES
# Kalman filters of drive and sheet: gains.
DRIVE, SHEET = STEP + 18, STEP + 21
# What the above was made for.
MADE = SHEET + 3
NUMBERS = len(Params._fields)
MEMORY = MADE + NUMBERS


@part
def init(params):
    """The initial state."""
    return _FIRST


@part
def _unit(i, j):
    return 1.0 if i == j else 0.0


@part
def _filter(m, gains, q0, q1, q2, r):
    """Gains on the innovation of a Kalman filter of three states, the first of them measured.

    The transposed model lies at P; A, B, Q, K and WORK are overwritten.
    """
    for i in range(9):
        m[A + i] = m[P + i]
    m[B], m[B + 1], m[B + 2] = 1.0, 0.0, 0.0
    m[Q], m[Q + 1], m[Q + 2] = q0 * q0, q1 * q1, q2 * q2
    s = riccati.solve(m, 3, A, B, Q, r * r, P, K, WORK)
    for i in range(3):
        m[gains + i] = m[P + 3 * i] / s


@part
def prepare(p, m):
    """Model and gains for the parameters ``p`` into the memory ``m``."""
    drive, course = servo.Drive(p.bandwidth, p.zeta, p.dead_time), servo.sheet(p.memory * 1e-3)
    for j in range(6):
        given = _unit(j, 0), _unit(j, 1), _unit(j, 2), _unit(j, 3), _unit(j, 4), _unit(j, 5)
        m[STEP + j], m[STEP + 6 + j], m[STEP + 12 + j] = servo.period(drive, 0.0, *given)
    # Transposed: row 0 is what the position does to each.
    for i in range(3):
        m[P + i] = _unit(i, 0)
        m[P + 3 + i], m[P + 6 + i] = m[STEP + 6 * i], m[STEP + 6 * i + 1]
    _filter(m, DRIVE, 0.0, 0.0, p.drift, p.encoder)
    for i in range(9):
        m[P + i] = 0.0
    m[P], m[P + 3], m[P + 4] = 1.0, PERIOD, 1.0
    m[P + 6], m[P + 7], m[P + 8] = course.level_bend, course.speed_bend, course.keep
    _filter(m, SHEET, p.shift, p.wander, p.bend, p.reading)

    for j in range(STATES + 1):
        x = _unit(j, 0), _unit(j, 1), _unit(j, 2), _unit(j, 3), _unit(j, 4), _unit(j, 5), _unit(j, 6)
        column = servo.ahead(drive, course, servo.Relative(*x), _unit(j, STATES))
        for i in range(STATES):
            m[A + i * STATES + j if j < STATES else B + i] = column[i]
    for i in range(STATES):
        m[Q + i] = 0.0
    m[Q], m[Q + 1] = 1.0, (1e-3 * p.damping) ** 2
    riccati.solve(m, STATES, A, B, Q, (1e-3 * p.effort) ** 2, P, K, WORK)


@part
def is_made(p, m):
    """Whether the memory holds the gains for ``p``; marks it so."""
    same = True
    for i in range(NUMBERS):
        same = same and m[MADE + i] == p[i]
        m[MADE + i] = p[i]
    return same


@part
def _moved(m, row, s, command):
    """Row ``row`` of the drive's period, without the position."""
    at = STEP + 6 * row
    own = m[at] * s.velocity + m[at + 1] * s.acceleration
    return own + m[at + 2] * s.sent_1 + m[at + 3] * s.sent_2 + m[at + 4] * s.sent_3 + m[at + 5] * command


@part
def estimate(p, s, x, m):
    """The state after the signals ``x`` of this period."""
    measured = x.head_position - x.height
    # The command that the supervisor sent after the last reading has not been seen before. Of one that is far from the
    # one before a drive of limited acceleration makes little in a period, so the model gets no more than it can follow.
    sent = x.command if x.fresh else s.sent_1 + clip(x.command - s.sent_1, -FOLLOWED, FOLLOWED)
    position = s.position + _moved(m, 0, s, sent)
    velocity, acceleration = _moved(m, 1, s, sent), _moved(m, 2, s, sent)
    off = x.head_position - position
    position = x.head_position if x.fresh else position + m[DRIVE] * off
    velocity = 0.0 if x.fresh else velocity + m[DRIVE + 1] * off
    acceleration = 0.0 if x.fresh else acceleration + m[DRIVE + 2] * off

    course = servo.sheet(p.memory * 1e-3)
    level = s.level + PERIOD * s.speed + course.level_bend * s.bend
    missed = clip(measured - level, -p.gate, p.gate)
    blind, holds = not x.captured, x.mode == HOLD
    level = measured if blind else (s.level if holds else level + m[SHEET] * missed)
    speed = 0.0 if blind or holds else s.speed + course.speed_bend * s.bend + m[SHEET + 1] * missed
    bend = 0.0 if blind or holds else course.keep * s.bend + m[SHEET + 2] * missed
    return State(position, velocity, acceleration, level, speed, bend, sent, s.sent_1, s.sent_2)


@part
def relative(s, x):
    """The estimate as seen from the sheet."""
    error = s.position - s.level - x.set_height
    one, two, three = s.sent_1 - s.speed, s.sent_2 - s.speed, s.sent_3 - s.speed
    return servo.Relative(error, s.velocity - s.speed, s.acceleration, one, two, three, s.bend)


@part
def change(m, r):
    """The regulator's change of command, mm/s."""
    fed = m[K] * r[0]
    for i in range(1, STATES):
        fed += m[K + i] * r[i]
    return -fed


@part
def control(params, state, signals, tables, memory):
    """Head velocity, mm/s."""
    if signals.fresh and not is_made(params, memory):
        prepare(params, memory)
    after = estimate(params, state, signals, memory)
    return after, after.sent_1 + change(memory, relative(after, signals))
