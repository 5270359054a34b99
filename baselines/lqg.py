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

_IDENTIFIED = "[C] experiments/studies/identify.py"

Bandwidth = Annotated[float, Quantity("Hz", 20.0, 250.0, "of the model's velocity loop", _IDENTIFIED, log=True)]
Zeta = Annotated[float, Quantity("1", 0.3, 3.0, "its damping ratio", _IDENTIFIED)]
DeadTime = Annotated[float, Quantity("ms", 0.0, 3.0, "from reading to the command's first effect", _IDENTIFIED)]
Encoder = Annotated[float, Quantity("mm", 1e-5, 0.1, "noise of the encoder; 1 µm/√12 by its counts", log=True)]
Drift = Annotated[float, Quantity("mm/s²", 10.0, 1e4, "change of the drive's acceleration in a period", log=True)]
Reading = Annotated[float, Quantity("mm", 1e-5, 0.1, "noise of the reading", log=True)]
Shift = Annotated[float, Quantity("mm", 1e-5, 0.02, "random change of the sheet's level in a period", log=True)]
Wander = Annotated[float, Quantity("mm/s", 1e-3, 10.0, "of its speed", log=True)]
Bend = Annotated[float, Quantity("mm/s²", 0.1, 1e4, "of its acceleration", log=True)]
Memory = Annotated[float, Quantity("ms", 0.1, 1000.0, "time constant with which its acceleration dies", log=True)]
Gate = Annotated[float, Quantity("mm", 0.005, 5.0, "largest innovation of the sheet that counts", log=True)]
Effort = Annotated[float, Quantity("ms", 1.0, 200.0, "weight of a change of command over that of an error", log=True)]
Damping = Annotated[float, Quantity("ms", 0.0, 50.0, "weight of the speed relative to the sheet")]


class Params(NamedTuple):
    """Model, variances (as standard deviations) and weights; of these only ratios matter.

    Default variances and weights are rounded from a first search of 160 trials on tune seeds.
    """

    bandwidth: Bandwidth = 84.2
    zeta: Zeta = 0.78
    dead_time: DeadTime = 2.2
    encoder: Encoder = 3e-4
    drift: Drift = 400.0
    reading: Reading = 2e-3
    shift: Shift = 2e-3
    wander: Wander = 0.2
    bend: Bend = 1.0
    memory: Memory = 20.0
    gate: Gate = 0.05
    effort: Effort = 16.0
    damping: Damping = 15.0


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
MEMORY = MADE + len(Params._fields)


@part
def init(params):
    """The initial state."""
    return State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@part
def _unit(i, j):
    return 1.0 if i == j else 0.0


@part
def _column(m, at, width, j, x, y, z):
    """Three numbers into column ``j`` of a matrix of three rows."""
    m[at + j], m[at + width + j], m[at + 2 * width + j] = x, y, z


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
        z, v, a = servo.period(drive, 0.0, _unit(j, 0), _unit(j, 1), _unit(j, 2), _unit(j, 3), _unit(j, 4), _unit(j, 5))
        _column(m, STEP, 6, j, z, v, a)
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
        x = servo.Relative(
            _unit(j, 0), _unit(j, 1), _unit(j, 2), _unit(j, 3), _unit(j, 4), _unit(j, 5), _unit(j, 6)
        )  # fmt: skip
        y = servo.ahead(drive, course, x, _unit(j, STATES))
        if j < STATES:
            _column(m, A, STATES, j, y.error, y.speed, y.acceleration)
            _column(m, A + 3 * STATES, STATES, j, y.sent_1, y.sent_2, y.sent_3)
            m[A + 6 * STATES + j] = y.bend
        else:
            _column(m, B, 1, 0, y.error, y.speed, y.acceleration)
            _column(m, B + 3, 1, 0, y.sent_1, y.sent_2, y.sent_3)
            m[B + 6] = y.bend
    for i in range(STATES):
        m[Q + i] = 0.0
    m[Q], m[Q + 1] = 1.0, (1e-3 * p.damping) ** 2
    riccati.solve(m, STATES, A, B, Q, (1e-3 * p.effort) ** 2, P, K, WORK)


@part
def is_made(p, m):
    """Whether the memory holds the gains for ``p``; marks it so."""
    same = (
        m[MADE] == p.bandwidth and m[MADE + 1] == p.zeta and m[MADE + 2] == p.dead_time and m[MADE + 3] == p.encoder
        and m[MADE + 4] == p.drift and m[MADE + 5] == p.reading and m[MADE + 6] == p.shift and m[MADE + 7] == p.wander
        and m[MADE + 8] == p.bend and m[MADE + 9] == p.memory and m[MADE + 10] == p.effort and m[MADE + 11] == p.damping
    )  # fmt: skip
    m[MADE], m[MADE + 1], m[MADE + 2], m[MADE + 3] = p.bandwidth, p.zeta, p.dead_time, p.encoder
    m[MADE + 4], m[MADE + 5], m[MADE + 6], m[MADE + 7] = p.drift, p.reading, p.shift, p.wander
    m[MADE + 8], m[MADE + 9], m[MADE + 10], m[MADE + 11] = p.bend, p.memory, p.effort, p.damping
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
    return servo.Relative(
        s.position - s.level - x.set_height, s.velocity - s.speed, s.acceleration,
        s.sent_1 - s.speed, s.sent_2 - s.speed, s.sent_3 - s.speed, s.bend,
    )  # fmt: skip


@part
def change(m, r):
    """The regulator's change of command, mm/s."""
    fed = m[K] * r.error + m[K + 1] * r.speed + m[K + 2] * r.acceleration + m[K + 3] * r.sent_1
    return -(fed + m[K + 4] * r.sent_2 + m[K + 5] * r.sent_3 + m[K + 6] * r.bend)


@part
def control(params, state, signals, tables, memory):
    """Head velocity, mm/s."""
    if signals.fresh and not is_made(params, memory):
        prepare(params, memory)
    after = estimate(params, state, signals, memory)
    return after, after.sent_1 + change(memory, relative(after, signals))
