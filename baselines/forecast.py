"""Forecast: learns how the sheet goes on, knows what the sensor's plate makes of it, and which drive it commands.

``encoder − reading`` is the sheet under the *plate*, and does not depend on what the head does. The law makes linear
**signals** of it, which say where the sheet under the *nozzle* will be, and **features**, which say what kind of sheet
it is. Rules give each signal a weight from the features, and the command is::

    u = Σ wᵢ·bᵢ + G·(measured + Σ vⱼ·sⱼ + set height − encoder − H·moving)

with bᵢ in mm/s, sⱼ in mm, ``moving`` the mm that the commands on their way are still to move the head by. The rules
know four kinds of sheet, each with a share; the shares sum to one:

- **straight**: a line through all readings since the sheet was last seen to leave one (:mod:`trends`). Noise and
  impulses hardly move it, and its gain is lower.
- **a step** under the plate: the tip's way over it (:mod:`ramps`).
- **bent**: the plate sees short waves weakened, and edges before the tip does. What four trends of 1.2 to 9.6 mm hold
  is weighed such that the tip follows; the weights (:data:`BENT`) are a function of the drive's lag and of the feed.
- **shaken**, which is everything else: the speed and rise that :mod:`self_tuning` has learnt to predict.

The drive's dead time and lag come from a bank of models (:mod:`drive_bank`).

The weights of a bent sheet are those of least squares in closed loop [C]: with the drive as a linear model the error
is linear in the weights, so the sum of the logarithms of mean squares over recorded sheets, and of the command's
changes, has one minimum. Recorded were sheets of the suite's bent kinds at 100, 200 and 400 mm/s, and at more noise,
on tune seeds.

A **policy** adds to the rules: ``weight = rule + span·action`` with actions from −1 to 1 (:data:`WEIGHTS`), so that no
action at all is this law. Where there is no sheet below, or far from the set height, it has no say. :func:`weigh` makes
the command of what lies in the memory and changes nothing; whoever writes an action there may call it again.

Where there is **no sheet below**, the one that was last known is followed (:mod:`slots`).

A **shield** bounds every command, see :func:`shielded`.
"""

from typing import Annotated, NamedTuple

import numpy as np

from kerfgym.baselines import drive_bank, ramps, self_tuning, slots, trends
from kerfgym.envs.engine.lanes import clip, extended, logarithm, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD, Weight

TRENDS = trends.TRENDS

BENT = np.array([
    [21.4, 0.3464, -43.5, -17.9, 0.2629, 2.466, -2.022, -0.05944, -0.7047, -1.033, -0.03582, 0.5043],
    [-4.428, 0.1729, 18.06, 5.455, 0.3749, -4.702, -0.9406, 0.09433, 1.242, 0.6083, -0.04599, -0.1881],
    [-2.049, 0.05268, 2.732, 0.9737, 0.08171, 1.2, 0.9134, -0.03366, -0.4987, 0.003231, -0.004135, -0.01328],
    [-0.7156, -0.09451, 2.125, 0.9601, 0.1022, -0.8234, -0.1253, 0.007855, 0.1833, 0.08071, -0.01604, -0.006272],
    [0.7269, -0.2135, -0.6662, -2.765, -0.03143, 4.167, 1.473, 0.03024, 0.408, 0.54, 0.0159, -0.3309],
    [-0.9669, -0.02605, 0.1418, 0.9776, -0.2075, 0.4567, 0.06415, 0.04296, -0.2951, -0.1456, 0.02929, 0.05057],
])  # fmt: skip
"""Weights of a bent sheet's signals, level, slope and bend of each trend: of those in mm and those in mm/s at a lag of
``USUAL`` ms, a noise of ``HUSHED`` and a gain of ``AT_GAIN`` 1/s; what to add to both for each ms of lag more; and for
each factor e of noise more."""

USUAL, HUSHED, AT_GAIN = 5.5, 1.5e-3, 100.0

QUIETEST, LOUDEST = -1.5, 2.5
"""Bounds of the logarithm of noise over ``HUSHED`` in them."""

SLOW_FEED, QUICK_FEED, BEYOND = 20.0, 420.0, 480.0
"""mm/s; between the first two a bent sheet has its weights as they are, at rest and above the last none."""

PATIENCE = 100.0
"""ms that a sheet must be straight before it counts as such."""

GROWN = 25.0, 45.0
"""ms after which trends begin to count, and count in full."""

UNLEARNT = 1.0
"""``edge`` until there are predictions."""

FAR = 0.5
"""Off the set height, in shares of it, from which on an action has no say [A]."""

REGAINED = 0.005
"""Of an action's say, what comes back in a period once it may have one again [A]."""

KICKS = 1.0
"""mm/s, speed at which friction has grown to its full value."""


class Own(NamedTuple):
    """What the law has beside the parameters of the self-tuning one."""

    calm: Annotated[float, Quantity("1/s", 5.0, 120.0, "gain on a straight sheet", log=True)] = 30.0
    leave: Annotated[float, Quantity("1", 2.0, 12.0, "sigmas at which a line is left", log=True)] = 5.0
    edge: Annotated[float, Quantity("1", 0.1, 1.0, "short over long motion, above which a sheet is shaken")] = 0.6
    alike: Annotated[float, Quantity("1", 0.01, 1.0, "what a step leaves over what a cubic does", log=True)] = 0.2
    friction: Annotated[float, Quantity("mm/s²", 0.0, 2000.0, "Coulomb friction of the drive over mass")] = 600.0
    margin: Annotated[float, Quantity("mm", 0.0, 0.3, "that the shield keeps from the sheet")] = 0.05
    brake: Annotated[float, Quantity("mm/s²", 1000.0, 2e4, "the drive's acceleration, for the shield")] = 10000.0


Params = extended(
    "Params", self_tuning.Params, Own,
    kp=70.0, ki=0.0, feed=0.79, lead=-1.7, sharpen=1.7, memory=225.07, prior=0.37823, gate=8.4708,
    jump=0.022991, rare=11.943, hold=4, recall=71.937, reach=1.6635, smith=0.7, lag=5.4818, trust=17.986,
)  # fmt: skip
State = self_tuning.State

CONDITIONS = ("feed", "set height", "noise", "dead time", "lag", "tracking")
"""Features that describe the situation rather than the moment."""

_EACH = tuple(f"{what} {length:g} mm" for length in trends.LENGTHS for what in ("level", "slope", "bend"))

FEATURES = (
    *CONDITIONS,
    *_EACH,
    *(f"level {length:g} mm, of noise" for length in trends.LENGTHS),
    "drive's fit", "shaken", "straight for", "line", "line, of noise", "line's newest", "line's newer",
    "change 1", "change 2", "change 3", "near", "middle", "far", "rise", "bend ahead", "trusted", "usual miss",
    "fastest", "swing", "bridging", "step's fit", "step's height", "step's place", "step's way", "is straight",
    "is bent", "is a step",
)  # fmt: skip
"""What is known of the sheet and the drive, at the memory's start, within ±10 and mostly ±1. Lengths are compressed,
``sign(x)·ln(1 + |x|/µm)/4``. Those of trends are over mm of travel, so they are the same at any feed."""

SPEEDS = ("coming", "slope ahead", "bend ahead", *(f"{each}, by feed" for each in _EACH), "line", "step", "friction")
"""Signals b, mm/s."""

PLACES = ("rise", *_EACH, "line", "line's rise", "step")
"""Signals s, mm above what was measured."""

_SPANS = (
    1.0, 1.0, 1.0, *(3.0, 0.5, 3.0) * TRENDS, 1.0, 1.0, 1.0,
    1.0, *(3.0, 0.5, 3.0) * TRENDS, 1.0, 1.0, 1.0,
    30.0, 0.3,
)  # fmt: skip

_NAMES = (*(f"speed: {each}" for each in SPEEDS), *(f"place: {each}" for each in PLACES), "gain", "moving")
WEIGHTS = tuple(Weight(name, span, "1/s" if name == "gain" else "1") for name, span in zip(_NAMES, _SPANS, strict=True))
"""Names and spans of the weights: of speeds, of places, the gain (1/s) and the share of commands on their way."""

SPANS = np.array(_SPANS)
_SPEEDS, _PLACES, _WEIGHTS = len(SPEEDS), len(PLACES), len(WEIGHTS)
_FED, _OF, _TILT, _STEP, _FRICTION = 0, 3, 3 + 3 * TRENDS, 4 + 3 * TRENDS, 5 + 3 * TRENDS
_RISE, _IN, _LINE, _LINES, _STEPS = _SPEEDS, _SPEEDS + 1, _SPEEDS + 13, _SPEEDS + 14, _SPEEDS + 15
_GAIN, _MOVING = _SPEEDS + _PLACES, _SPEEDS + _PLACES + 1

# Places in the memory.
ACTION = len(FEATURES)
RULE = ACTION + _WEIGHTS
SIGNAL = RULE + _WEIGHTS  # b and s
MEASURED = SIGNAL + _SPEEDS + _PLACES  # mm, the sheet
WAY = MEASURED + 1  # mm that commands are still to move the head by
BEHIND = WAY + 1  # ms, the drive's dead time and lag
SHEET = BEHIND + 1  # mm, the highest that the sheet is predicted to be until the head could stop
SINKING = SHEET + 1  # mm/s, the speed at which it is predicted to sink, at most 0
INTEGRAL = SINKING + 1  # mm/s
SAY = INTEGRAL + 1  # 0 … 1, how much say an action has
BANK = SAY + 1
RAMP = BANK + drive_bank.MEMORY
TREND = RAMP + ramps.MEMORY
LEARNT = TREND + trends.MEMORY
GONE = LEARNT + self_tuning.MEMORY
MEMORY = GONE + slots.MEMORY


class Shares(NamedTuple):
    """Of the kinds of sheet; what is left is shaken."""

    straight: float
    bent: float
    step: float


@part
def init(params):
    """The initial state."""
    return self_tuning.init(params)


@part
def _small(x):
    """A length, compressed."""
    a = 0.25 * logarithm(1.0 + 1000.0 * abs(x))
    return a if x >= 0.0 else -a


@part
def _ln(x):
    """ln(x), bounded."""
    return clip(logarithm(x), -10.0, 10.0)


@part
def _kinds(p, x, m, ready):
    """The :class:`Shares`."""
    t, r = m[TREND:LEARNT], m[RAMP:TREND]
    step = ramps.likely(r, x.feed, p.alike)
    straight = (1.0 - step) * trends.straight(t, PATIENCE)
    grown = clip((t[trends.AGE] - GROWN[0]) / (GROWN[1] - GROWN[0]), 0.0, 1.0)
    # As long as nothing has been learnt of a shaken sheet, trends are the best there is.
    edge = p.edge if ready else max(p.edge, UNLEARNT)
    # What moves under a head that stands still is no shape; beyond the quickest feed the weights are not known.
    grown *= clip(x.feed / SLOW_FEED, 0.0, 1.0) * clip((BEYOND - x.feed) / (BEYOND - QUICK_FEED), 0.0, 1.0)
    bent = grown * clip(10.0 * (edge - trends.shaken(t)), 0.0, 1.0) * (1.0 - straight - step)
    return Shares(straight, bent, step)


@part
def _ahead(p, o, behind):
    """mm/s and mm: what has been learnt of the sheet, where a command acts."""
    coming, rise, ahead = o.coming, 0.0, behind - self_tuning.MIDDLE
    if o.ready:
        speed = o.slope + o.bend * (ahead + p.lead + p.sharpen)
        coming = o.trusted * clip(speed, -o.most, o.most) / PERIOD
        rise = o.middle + o.slope * ahead + 0.5 * o.bend * ahead * ahead
    return coming, rise


@part
def _kick(p, o, behind, lag):
    """mm/s, what overcomes friction as the axis turns back: it takes friction/ω² more way, fed as it changes."""
    slow = 1e-3 * lag / (2.0 * drive_bank.DAMPING)
    at = o.slope + o.bend * (behind - lag - self_tuning.MIDDLE)
    before, after = (at - 0.5 * o.bend) / PERIOD, (at + 0.5 * o.bend) / PERIOD
    turned = clip(after / KICKS, -1.0, 1.0) - clip(before / KICKS, -1.0, 1.0)
    return o.trusted * p.friction * slow * slow * turned / PERIOD if o.ready else 0.0


@part
def _signals(p, x, m, o, coming, rise):
    """Writes the signals, which do not depend on what the law commands but for what they know of the drive."""
    t, r, b = m[TREND:LEARNT], m[RAMP:TREND], m[SIGNAL:MEASURED]
    behind, travel = m[BEHIND], x.feed * PERIOD
    b[_FED] = coming
    b[_FED + 1] = o.trusted * o.slope / PERIOD if o.ready else 0.0
    b[_FED + 2] = o.trusted * o.bend / PERIOD if o.ready else 0.0
    fed = clip(x.feed, SLOW_FEED, QUICK_FEED)
    for k in range(TRENDS):
        length = trends.LENGTHS[k]
        level = t[trends.LEVEL + k] - o.measured
        slope, bend = t[trends.SLOPE + k] * length, t[trends.BEND + k] * length * length
        b[_OF + 3 * k], b[_OF + 3 * k + 1], b[_OF + 3 * k + 2] = fed * level, fed * slope, fed * bend
        b[_IN + 3 * k], b[_IN + 3 * k + 1], b[_IN + 3 * k + 2] = level, slope, bend
    b[_TILT] = t[trends.TILT] * x.feed
    b[_RISE] = rise
    b[_LINE] = t[trends.LINE] - o.measured
    b[_LINES] = t[trends.TILT] * travel * behind
    b[_STEP], b[_STEPS] = 0.0, 0.0
    if r[ramps.FILLED] >= ramps.SAMPLES:
        b[_STEP] = (ramps.tip(r, (behind + 0.5) * travel) - ramps.tip(r, (behind - 0.5) * travel)) / PERIOD
        b[_STEPS] = ramps.tip(r, p.smith * behind * travel) - o.measured
    b[_FRICTION] = _kick(p, o, behind, m[BANK + drive_bank.LAG])


@part
def _stay(m, plane):
    """No sheet below: the one that was last known counts as measured, and as straight; signals say nothing."""
    m[MEASURED] = plane
    for k in range(SIGNAL, MEASURED):
        m[k] = 0.0
    return Shares(1.0, 0.0, 0.0)


@part
def _say(x, away, before):
    """How much say an action has, 0 to 1: none where there is no sheet below, the supervisor moves the head, or the
    reading is far off the set height, as in and after a fault; trainings hardly ever get there."""
    if x.fresh:
        return 1.0
    follows = x.captured and not away and not x.override and abs(x.height - x.set_height) < FAR * x.set_height
    return min(before + REGAINED, 1.0) if follows else 0.0


@part
def _rules(p, m, kinds):
    """Writes the weights of the rules."""
    w, later = m[RULE:SIGNAL], m[BEHIND] - USUAL
    louder = clip(logarithm(m[TREND + trends.NOISE] / HUSHED), QUIETEST, LOUDEST)
    shaken = 1.0 - kinds.straight - kinds.bent - kinds.step
    for k in range(_WEIGHTS):
        w[k] = 0.0
    gain = shaken * p.kp + (kinds.bent + kinds.step) * AT_GAIN + kinds.straight * p.calm
    w[_FED] = shaken * p.feed
    for k in range(3 * TRENDS):
        w[_IN + k] = kinds.bent * AT_GAIN / gain * (BENT[0, k] + later * BENT[2, k] + louder * BENT[4, k])
        w[_OF + k] = kinds.bent * (BENT[1, k] + later * BENT[3, k] + louder * BENT[5, k])
    w[_TILT] = kinds.straight
    w[_STEP] = kinds.step
    w[_RISE] = shaken * p.smith
    w[_LINE] = kinds.straight
    w[_LINES] = kinds.straight * p.smith
    w[_STEPS] = kinds.step
    w[_GAIN], w[_MOVING] = gain, p.smith


@part
def _described(p, x, s, m, o, kinds, rise):
    """Writes the features."""
    t, r, d = m[TREND:LEARNT], m[RAMP:TREND], m[BANK:RAMP]
    noise = t[trends.NOISE]
    m[0] = _ln((x.feed + 1.0) / 200.0)
    m[1] = _ln((x.set_height + 0.01) / 0.7)
    m[2] = 0.5 * _ln(noise / 1.5e-3)
    m[3] = d[drive_bank.DEAD_TIME] - 2.0
    m[4] = 0.5 * (d[drive_bank.LAG] - 3.4)
    m[5] = min(s.known, 300.0) / 150.0 - 1.0 if x.captured else -1.0
    at = len(CONDITIONS)
    for k in range(TRENDS):
        length, level = trends.LENGTHS[k], t[trends.LEVEL + k] - o.measured
        m[at + 3 * k] = _small(level)
        m[at + 3 * k + 1] = _small(t[trends.SLOPE + k] * length)
        m[at + 3 * k + 2] = _small(t[trends.BEND + k] * length * length)
        m[at + 3 * TRENDS + k] = clip(level / (3.0 * noise), -3.0, 3.0)
    at += 4 * TRENDS
    off = t[trends.LINE] - o.measured
    m[at] = 0.3 * _ln(d[drive_bank.SURE]) - 0.5
    m[at + 1] = _ln(trends.shaken(t) + 1e-3) + 1.0
    m[at + 2] = 0.3 * _ln(t[trends.STRAIGHT] + 1.0) - 1.0
    m[at + 3] = _small(off)
    m[at + 4] = clip(off / (3.0 * noise), -3.0, 3.0)
    m[at + 5] = clip(0.5 * t[trends.NEWEST] / trends.QUICK_SPREAD, -10.0, 10.0)
    m[at + 6] = clip(0.5 * t[trends.NEWER] / trends.SLOW_SPREAD, -10.0, 10.0)
    m[at + 7] = _small(o.measured - t[trends.BEFORE + 1])
    m[at + 8] = _small(t[trends.BEFORE + 1] - t[trends.BEFORE + 2])
    m[at + 9] = _small(o.measured - t[trends.BEFORE + 2])
    m[at + 10], m[at + 11], m[at + 12] = _small(o.near), _small(o.middle), _small(o.far)
    m[at + 13], m[at + 14], m[at + 15] = _small(rise), _small(o.bend), o.trusted
    m[at + 16] = 0.5 * _ln(s.usual * 1e6 + 1e-3)
    m[at + 17], m[at + 18], m[at + 19] = _small(s.fastest), _small(s.swing), 0.25 * s.bridged
    full = r[ramps.FILLED] >= ramps.SAMPLES
    m[at + 20] = 0.5 * _ln(r[ramps.LIKE])
    m[at + 21] = _small(r[ramps.HEIGHT])
    m[at + 22] = r[ramps.PASSED] / ramps.PLATE - 1.0 if full else 0.0
    m[at + 23] = _small(m[SIGNAL + _STEPS])
    m[at + 24], m[at + 25], m[at + 26] = kinds.straight, kinds.bent, kinds.step
    for k in range(len(FEATURES)):
        m[k] = clip(m[k], -10.0, 10.0)


@part
def shielded(params, signals, memory, command):
    """The command, or a slower descent: the head closes in no faster than it can stop ``margin`` above the sheet.

    The promise: as long as the drive brakes with ``brake`` after its estimated dead time and lag, the sheet does not go
    higher than the rules predict for that time, and the encoder is right, the nozzle stays ``margin`` above the sheet.
    """
    p, m = params, memory
    room = max(signals.head_position + min(m[WAY], 0.0) - m[SHEET] - p.margin, 0.0)
    late = 1e-3 * (m[BEHIND] + 1.0)
    return max(command, m[SINKING] - p.brake * (np.sqrt(late * late + 2.0 * room / p.brake) - late))


@part
def weigh(params, state, signals, memory):
    """Head velocity, mm/s, of the signals, rules and action in the memory. Changes nothing."""
    m, x, say = memory, signals, memory[SAY]
    speed, place = 0.0, m[MEASURED]
    for k in range(_SPEEDS):
        speed += (m[RULE + k] + SPANS[k] * say * m[ACTION + k]) * m[SIGNAL + k]
    for k in range(_SPEEDS, _SPEEDS + _PLACES):
        place += (m[RULE + k] + SPANS[k] * say * m[ACTION + k]) * m[SIGNAL + k]
    gain = max(m[RULE + _GAIN] + SPANS[_GAIN] * say * m[ACTION + _GAIN], 0.0)
    share = m[RULE + _MOVING] + SPANS[_MOVING] * say * m[ACTION + _MOVING]
    command = speed - m[INTEGRAL] + gain * (place + x.set_height - x.head_position - share * m[WAY])
    return shielded(params, x, m, command)


@part
def control(params, state, signals, tables, memory):
    """Head velocity, mm/s: read, learn, predict; weigh by the rules alone."""
    p, x, m = params, signals, memory
    q, d, t, gone = m[LEARNT:GONE], m[BANK:RAMP], m[TREND:LEARNT], m[GONE:MEMORY]
    s, o = self_tuning.outlook(p, state, x, q)
    if x.fresh:
        for k in range(BANK):
            m[k] = 0.0
    drive_bank.update(d, x.fresh, x.head_position, x.command, p.friction)
    # What is no reading of the sheet, and the first that is one again.
    lost = x.fresh or not x.captured or s.held or state.held
    trends.update(t, x.fresh, lost, o.measured, x.head_position - x.raw_height, x.feed, p.leave)
    ramps.update(m[RAMP:TREND], lost, o.measured, x.feed)
    slots.update(gone, x)
    behind = d[drive_bank.DEAD_TIME] + d[drive_bank.LAG]
    m[MEASURED], m[BEHIND], m[WAY] = o.measured, behind, self_tuning.under_way(q, s.tick, behind)
    coming, rise = _ahead(p, o, behind)
    _signals(p, x, m, o, coming, rise)
    kinds = _kinds(p, x, m, o.ready)
    m[SAY] = _say(x, slots.is_away(gone), m[SAY])
    if slots.is_away(gone):
        kinds = _stay(m, gone[slots.PLANE])
    _rules(p, m, kinds)
    _described(p, x, s, m, o, kinds, rise)
    for k in range(_WEIGHTS):
        m[ACTION + k] = 0.0
    speed, place = 0.0, m[MEASURED]
    for k in range(_SPEEDS):
        speed += m[RULE + k] * m[SIGNAL + k]
    for k in range(_SPEEDS, _SPEEDS + _PLACES):
        place += m[RULE + k] * m[SIGNAL + k]
    m[SHEET], m[SINKING] = max(m[MEASURED], place), min(speed, 0.0)
    # Nothing winds up while the supervisor moves the head. A step is over before summing it up could help.
    error = x.head_position - place - x.set_height + p.smith * m[WAY]
    grown = s.integral + p.ki * PERIOD * clip(error, -self_tuning.LITTLE, self_tuning.LITTLE)
    m[INTEGRAL] = grown if o.ready and not x.override else 0.0
    s = s._replace(integral=m[INTEGRAL])
    return s, weigh(p, s, x, m)


# ------------------------------------------------------------------------------------------ for learning by gradients

READS = BANK
"""Numbers of the memory that :func:`loop` reads."""


class Loop(NamedTuple):
    """What of the law depends on the head: commands of two and more periods ago, mm/s. The integral does, too, but
    hardly over what a gradient reaches, so it is as it was recorded."""

    c2: float = 0.0
    c3: float = 0.0
    c4: float = 0.0
    c5: float = 0.0
    c6: float = 0.0
    c7: float = 0.0


@part
def loop(params, state, felt, memory):
    """:func:`weigh` where only the head and the commands on their way are not what was recorded."""
    s, m = state, memory
    sent = (felt.command, s.c2, s.c3, s.c4, s.c5, s.c6, s.c7)
    moving = 0.0
    for k in range(7):
        moving += clip(m[BEHIND] - k - 0.5, 0.0, 1.0) * sent[k] * PERIOD
    m[WAY] = moving
    return Loop(felt.command, s.c2, s.c3, s.c4, s.c5, s.c6), weigh(params, s, felt, m)
