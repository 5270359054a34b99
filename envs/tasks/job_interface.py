"""What a policy does to a job and what it gets back: stages before and after each decision of 8 ms."""

from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np

from ..engine.lanes import U0, U1, UW, U, clip, doubles, load, logarithm, part, row, singles, store, words
from ..engine.quantity import in_order
from ..plant import cut, gantry, machine, published, xy_axes
from ..plant.controller import PERIOD, Privileged, Process
from ..plant.gantry import CUT, LEAD_IN, Hand, Journey, Progress, Recipe, Sums, Trail, between
from .task import ANY, IO, IO_SIZE, Actions, Signals, Task, end

PERIOD_MS = 8
"""From decision to decision."""

CORRECTION = 0.5
"""mm of the reference that an action of ±1 means: all that the machine lets a hand add (``gantry.Journey``)."""

OVERRIDE = 0.5
"""Of the planned feed that an action of ±1 adds in residual control."""

RESIDUAL = Process(override=OVERRIDE, power=0.2, frequency=2000.0, x=0.15, y=0.15, z=1.0, focus=1.0, standoff=0.3)
"""What an action of ±1 adds to the base's command."""

TOLERANCE = 0.01
"""mm; contour errors are seen and charged in multiples of it."""

AHEAD = (50.0, 100.0, 200.0)
"""ms of the plan at which the path ahead is shown."""

TURNS = tuple(range(-96, 80, 16))
"""ms from the reference at which the path's acceleration is shown: axes that follow with a delay need what lies behind
the reference, axes that follow closely what lies ahead of it."""

LIMIT = 10.0
"""Bound of every feature."""

_PATH = (
    *in_order("contour_error lag speed planned"),
    *(f"{what}_{k:.0f}" for what in ("planned", "bend", "ahead") for k in AHEAD),
    *in_order("override tangent_x tangent_y cutting beam progress"),
)
FEATURES = {
    "contour": (
        *_PATH,
        "correction_left",
        "correction_along",
        "contour_rate",
        "bend_reference",
        "ahead_reference",
        *(f"turn_{k:+d}" for k in TURNS),
        *(f"push_{k:+d}" for k in TURNS),
    ),
    "cutting": (
        *_PATH,
        "height_error",
        "set_height",
        *(f"command_{name}" for name in Process._fields),
        "axial",
        "diagonal",
    ),
}
"""Names of the features, in order; ``raw`` observations have the same in mm, mm/s, mm/s², W and Hz."""

_EITHER = in_order(
    "time x y phase progress contour_error lag speed override true_gap gap_error measured_height cost length "
    "step_contour_rms done"
)
INFO = {
    "contour": (
        *_EITHER,
        *in_order(
            "reward_contour reward_time reward_feed reward_collision weighted_contour weighted_time weighted_feed "
            "weighted_collision"
        ),
    ),
    "cutting": (
        *_EITHER,
        *in_order(
            "margin dross roughness kerf taper power frequency step_dross step_roughness step_through "
            "reward_quality reward_through reward_time reward_collision reward_outside weighted_quality "
            "weighted_through weighted_time weighted_collision weighted_outside extrapolated"
        ),
        *(f"beyond_{name}" for name in published.Excess._fields),
    ),
}
"""What ``info`` holds, in order: mm, mm/s, s, W, Hz; ``step_…`` are means over the cut of the last 8 ms."""

OBJECTIVES = {
    "contour": ("step_contour_rms", "time"),
    "cutting": ("step_dross", "step_roughness", "step_through", "time"),
}
"""Entries of ``info`` that make the vector of objectives, all but ``step_through`` the smaller the better."""


class ContourReward(NamedTuple):
    """Weights of the reward's terms in ContourFollowing; 0 switches one off."""

    contour: float = 0.3  # per 10 µm of the step's RMS contour error, while cutting
    time: float = 1.0  # per step that is lost against the plan
    feed: float = 50.0  # per square of the feed's relative deviation from the plan, for which the process is set
    collision: float = 100.0  # once


class CuttingReward(NamedTuple):
    """Weights of the reward's terms in Cutting; 0 switches one off."""

    quality: float = 1.0  # per mm cut times the mean of dross and roughness over the material's scales, less 1
    through: float = 5.0  # per mm that is not cut through
    time: float = 0.05  # per step that is lost against the plan
    collision: float = 100.0  # once
    outside: float = 0.0  # per mm cut with settings outside those that the material's figures were calibrated on


class Heading(NamedTuple):
    """A direction, of length 1."""

    x: float = 1.0
    y: float = 0.0


_TRAIL = U(len(Trail._fields)) * UW
_COLLIDED = machine.TALLY + row(machine.Tally, "collided")
_STEP = PERIOD_MS * PERIOD
_BACK = 2
"""ms that the trail reaches back."""
_TURNS = U(len(TURNS))
_EXCESSES = U(len(published.Excess._fields))
_CONTOUR_TERMS, _CUTTING_TERMS = U(len(ContourReward._fields)), U(len(CuttingReward._fields))


def _offsets(names):
    """Where each name stands, as compiled code counts; names that are no identifiers are left to loops."""
    make: Any = namedtuple
    return make("Offsets", names, rename=True)(*map(U, range(len(names))))


# The first of each serves both tasks where they are alike.
SEEN, SEEN_CONTOUR = _offsets(FEATURES["cutting"]), _offsets(FEATURES["contour"])
TOLD, TOLD_CUTTING = _offsets(INFO["contour"]), _offsets(INFO["cutting"])
_TURN, _PUSH = (U(FEATURES["contour"].index(f"{what}_{TURNS[0]:+d}")) for what in ("turn", "push"))


@part
def _ago(block, at, ms):
    """Offset of the trail's entry of ``ms`` (0 to :data:`_BACK`) ago."""
    entry = U(np.int64(block[at + machine.CLOCK])) - U(ms)
    return gantry.TRAIL + (entry & gantry.TRAIL_LAST) * _TRAIL


@part
def _symlog(x):
    """sign·ln(1 + |x|)."""
    y = logarithm(1.0 + abs(x))
    return y if x >= 0.0 else -y


# ------------------------------------------------------------------------------------------------ the reference


@part
def _coming(g, b):
    """ms of nominal time at which the reference will be at the coming interpolation, when a correction takes effect."""
    s, p = load(Progress, g, b + gantry.PROGRESS), load(xy_axes.Params, g, b + gantry.P_XY)
    return s.tau + s.override * p.interpolation


@part
def _heading(jobs, j, tau):
    """Direction of the path at the sample nearest to ``tau``: in a corner that of one leg, not a mean of both."""
    k = np.rint(clip(tau, 0.0, j.samples - 1.0))
    return Heading(between(jobs, j, k, U(4)), between(jobs, j, k, U(5)))


# --------------------------------------------------------------------------------------------------- the action


@part
def between_ends(low, high, u):
    """From ``low`` at u = −1 to ``high`` at 1."""
    return low + 0.5 * (u + 1.0) * (high - low)


def act(block_address, at, n, io_address, first):
    """Stage before a step: the action becomes what the hand adds to path and process."""
    io = words(io_address, IO_SIZE)
    deck = words(io[IO.gantry], gantry.DECK)
    g, jobs = doubles(deck[gantry.D.block], ANY), doubles(deck[gantry.D.jobs], ANY)
    base, actions, width = gantry.column_of(at), singles(io[IO.actions], ANY), io[IO.width]
    for lane in range(n):
        a, i = base + lane, (first + lane) * width
        if io[IO.task] == U0:
            left = CORRECTION * clip(np.float64(actions[i + U1]), -1.0, 1.0)
            along = CORRECTION * clip(np.float64(actions[i + U(2)]), -1.0, 1.0)
            t = _heading(jobs, load(Journey, g, a + gantry.P_JOURNEY), _coming(g, a))
            change = OVERRIDE * clip(np.float64(actions[i]), -1.0, 1.0)
            h = Process(change, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            store(g, a + gantry.HAND, Hand(along * t.x - left * t.y, along * t.y + left * t.x, 1.0, h))
        else:
            u0, u1 = clip(np.float64(actions[i]), -1.0, 1.0), clip(np.float64(actions[i + U(1)]), -1.0, 1.0)
            u2, u3 = clip(np.float64(actions[i + U(2)]), -1.0, 1.0), clip(np.float64(actions[i + U(3)]), -1.0, 1.0)
            u4, u5 = clip(np.float64(actions[i + U(4)]), -1.0, 1.0), clip(np.float64(actions[i + U(5)]), -1.0, 1.0)
            u6, u7 = clip(np.float64(actions[i + U(6)]), -1.0, 1.0), clip(np.float64(actions[i + U(7)]), -1.0, 1.0)
            if io[IO.control] == U1:
                r, p = load(Recipe, g, a + gantry.P_RECIPE), load(gantry.spot.Params, g, a + gantry.P_OPTICS)
                q, j = load(published.Range, g, a + gantry.P_PUBLISHED), load(Journey, g, a + gantry.P_JOURNEY)
                # From nothing to the most that the optics and the recipe allow; 0 is the middle.
                h = Process(
                    0.5 * (u0 + 1.0) * r.most_override,
                    0.5 * (u1 + 1.0) * r.most_power,
                    0.5 * (u2 + 1.0) * p.highest,
                    0.5 * (u3 + 1.0) * p.galvo_range,
                    0.5 * (u4 + 1.0) * p.galvo_range,
                    0.5 * (u5 + 1.0) * p.piezo_range,
                    u6 * p.piezo_range,
                    u7 * r.most_standoff,
                )
                if q.bounded:
                    # The same within the settings that were published of the material.
                    hertz = between_ends(q.frequency_low, min(q.frequency_high, p.highest), u2)
                    h = Process(
                        between_ends(q.feed_low / j.feed, min(q.feed_high / j.feed, r.most_override), u0),
                        between_ends(q.power_low, q.power_high, u1),
                        hertz,
                        between_ends(0.0, min(q.amplitude, p.galvo_range), u3),
                        between_ends(0.0, min(q.amplitude, p.galvo_range), u4),
                        between_ends(0.0, min(published.deepest(q, hertz), p.piezo_range), u5),
                        u6 * q.focus,
                        u7 * q.standoff,
                    )
            else:
                h = Process(
                    RESIDUAL.override * u0,
                    RESIDUAL.power * u1,
                    RESIDUAL.frequency * u2,
                    RESIDUAL.x * u3,
                    RESIDUAL.y * u4,
                    RESIDUAL.z * u5,
                    RESIDUAL.focus * u6,
                    RESIDUAL.standoff * u7,
                )
            store(g, a + gantry.HAND, Hand(0.0, 0.0, 0.0 if io[IO.control] == U1 else 1.0, h))


# ---------------------------------------------------------------------------------------------- the observation


@part
def _put(out, o, x, raw, scaled):
    """One entry of an observation: as it is, or scaled and bounded."""
    out[o] = np.float32(x) if raw else np.float32(clip(scaled, -LIMIT, LIMIT))


@part
def _see_reference(g, b, jobs, j, s, t, before, out, o, raw):
    """What a correction of the reference depends on, in the reference's own frame: the corrections in force, and how
    the path bends and speeds up around it."""
    p, tau = load(xy_axes.Params, g, b + gantry.P_XY), _coming(g, b)
    h = _heading(jobs, j, tau)
    left, along = s.dy * h.x - s.dx * h.y, s.dx * h.x + s.dy * h.y
    _put(out, o + SEEN_CONTOUR.correction_left, left, raw, left / CORRECTION)
    _put(out, o + SEEN_CONTOUR.correction_along, along, raw, along / CORRECTION)
    rate = (t.error - before.error) / (_BACK * PERIOD)
    _put(out, o + SEEN_CONTOUR.contour_rate, rate, raw, _symlog(rate * _STEP / TOLERANCE))
    bend, ahead = t.tx * h.y - t.ty * h.x, t.tx * h.x + t.ty * h.y
    _put(out, o + SEEN_CONTOUR.bend_reference, bend, raw, bend)
    _put(out, o + SEEN_CONTOUR.ahead_reference, ahead, raw, ahead)
    # Second differences of the path over time, as it will be travelled with the present override.
    ms = (TURNS[1] - TURNS[0]) * s.override
    at, over = tau + TURNS[0] * s.override, 1.0 / (1e-6 * (TURNS[1] - TURNS[0]) * (TURNS[1] - TURNS[0]))
    x0, y0 = between(jobs, j, at - ms, U0), between(jobs, j, at - ms, U1)
    x1, y1 = between(jobs, j, at, U0), between(jobs, j, at, U1)
    scale = 4.0 / p.acceleration
    for k in range(_TURNS):
        at += ms
        x2, y2 = between(jobs, j, at, U0), between(jobs, j, at, U1)
        ax, ay = (x2 - 2.0 * x1 + x0) * over, (y2 - 2.0 * y1 + y0) * over
        turn, push = ay * h.x - ax * h.y, ax * h.x + ay * h.y
        _put(out, o + _TURN + k, turn, raw, scale * turn)
        _put(out, o + _PUSH + k, push, raw, scale * push)
        x0, y0, x1, y1 = x1, y1, x2, y2


@part
def _see(block, a, g, b, jobs, out, o, raw, task, trail, earlier):
    """The observation of the machine at ``a`` and ``b`` into ``out`` from ``o`` on."""
    j, s = load(Journey, g, b + gantry.P_JOURNEY), load(Progress, g, b + gantry.PROGRESS)
    applied = load(Process, g, b + gantry.APPLIED)
    t, before, feed = load(Trail, g, b + trail), load(Trail, g, b + earlier), max(j.feed, 1e-3)
    planned = between(jobs, j, t.tau, U(3))
    _put(out, o + SEEN.contour_error, t.error, raw, _symlog(t.error / TOLERANCE))
    _put(out, o + SEEN.lag, t.lag, raw, _symlog(t.lag / (10.0 * TOLERANCE)))
    _put(out, o + SEEN.speed, t.speed, raw, t.speed / feed)
    _put(out, o + SEEN.planned, planned, raw, planned / feed)
    for k in range(U(3)):
        ms = AHEAD[0] if k == U0 else (AHEAD[1] if k == U1 else AHEAD[2])
        later = between(jobs, j, t.tau + ms, U(3))
        tx, ty = between(jobs, j, t.tau + ms, U(4)), between(jobs, j, t.tau + ms, U(5))
        bend, ahead = t.tx * ty - t.ty * tx, t.tx * tx + t.ty * ty
        _put(out, o + SEEN.planned_50 + k, later, raw, later / feed)
        _put(out, o + SEEN.bend_50 + k, bend, raw, bend)
        _put(out, o + SEEN.ahead_50 + k, ahead, raw, ahead)
    _put(out, o + SEEN.override, t.override, raw, t.override)
    _put(out, o + SEEN.tangent_x, t.tx, raw, t.tx)
    _put(out, o + SEEN.tangent_y, t.ty, raw, t.ty)
    cutting = 1.0 if t.phase == LEAD_IN or t.phase == CUT else 0.0
    _put(out, o + SEEN.cutting, cutting, raw, cutting)
    _put(out, o + SEEN.beam, t.beam, raw, t.beam)
    progress = s.near / (j.samples - 1.0)
    _put(out, o + SEEN.progress, progress, raw, progress)
    if task == U0:
        _see_reference(g, b, jobs, j, s, t, before, out, o, raw)
    else:
        x = load(Privileged, block, a + machine.SIGNALS)
        height, p = x.height - x.set_height, load(gantry.spot.Params, g, b + gantry.P_OPTICS)
        _put(out, o + SEEN.height_error, height, raw, _symlog(height / TOLERANCE))
        _put(out, o + SEEN.set_height, x.set_height, raw, x.set_height)
        _put(out, o + SEEN.command_override, applied.override, raw, applied.override)
        _put(out, o + SEEN.command_power, applied.power, raw, applied.power)
        _put(out, o + SEEN.command_frequency, applied.frequency, raw, applied.frequency / p.highest)
        _put(out, o + SEEN.command_x, applied.x, raw, applied.x / p.galvo_range)
        _put(out, o + SEEN.command_y, applied.y, raw, applied.y / p.galvo_range)
        _put(out, o + SEEN.command_z, applied.z, raw, applied.z / p.piezo_range)
        _put(out, o + SEEN.command_focus, applied.focus, raw, applied.focus / p.piezo_range)
        _put(out, o + SEEN.command_standoff, applied.standoff, raw, applied.standoff)
        # Cosines of two and four times the path's angle: what two axes do to a spot is the same forth and back.
        axial = t.tx * t.tx - t.ty * t.ty
        diagonal = 2.0 * axial * axial - 1.0
        _put(out, o + SEEN.axial, axial, raw, axial)
        _put(out, o + SEEN.diagonal, diagonal, raw, diagonal)


# ---------------------------------------------------------------------------------------- the reward and the info


@part
def _common(block, a, g, b, trail, infos, o, m):
    """The entries of INFO that both tasks have, from ``infos[o]`` on, ``m`` apart."""
    t, x, s = load(Trail, g, b + trail), load(Privileged, block, a + machine.SIGNALS), load(Sums, g, b + gantry.SUMS)
    r, was = load(Recipe, g, b + gantry.P_RECIPE), load(Sums, g, b + gantry.BEFORE)
    j, p = load(Journey, g, b + gantry.P_JOURNEY), load(Progress, g, b + gantry.PROGRESS)
    length = s.length - was.length
    infos[o + TOLD.time * m] = s.time
    infos[o + TOLD.x * m] = t.x
    infos[o + TOLD.y * m] = t.y
    infos[o + TOLD.phase * m] = t.phase
    infos[o + TOLD.progress * m] = p.near / (j.samples - 1.0)
    infos[o + TOLD.contour_error * m] = t.error
    infos[o + TOLD.lag * m] = t.lag
    infos[o + TOLD.speed * m] = t.speed
    infos[o + TOLD.override * m] = t.override
    infos[o + TOLD.true_gap * m] = x.gap
    infos[o + TOLD.gap_error * m] = x.gap - r.standoff
    infos[o + TOLD.measured_height * m] = x.height
    infos[o + TOLD.cost * m] = block[a + _COLLIDED]
    infos[o + TOLD.length * m] = s.length
    squares = max(s.contour2 - was.contour2, 0.0)
    infos[o + TOLD.step_contour_rms * m] = np.sqrt(squares / length) if length > 0.0 else 0.0
    infos[o + TOLD.done * m] = t.over


@part
def _lost(g, b):
    """Share of a step that is lost against the plan, negative if some is gained. Charged where it is lost: a charge per
    step would reach a discounting learner at the job's end alone."""
    s, j = load(Progress, g, b + gantry.PROGRESS), load(Journey, g, b + gantry.P_JOURNEY)
    waits = s.waited > 0.0 and s.waited < j.patience
    return 1.0 if s.tau >= j.samples - 1.0 or waits else 1.0 - s.override


@part
def _weigh(infos, o, m, weights, first, terms):
    """Weighs the reward's ``terms``, of which the first is entry ``first``, behind them; returns their sum."""
    total = 0.0
    for k in range(terms):
        weighted = -weights[k] * infos[o + (first + k) * m]
        infos[o + (first + terms + k) * m] = weighted
        total += weighted
    return total


@part
def _contour_reward(g, b, infos, o, m, weights):
    """The terms of ContourFollowing; returns their weighted sum."""
    lost = _lost(g, b)
    change = load(Progress, g, b + gantry.PROGRESS).override - 1.0
    infos[o + TOLD.reward_contour * m] = infos[o + TOLD.step_contour_rms * m] / TOLERANCE
    infos[o + TOLD.reward_time * m] = lost
    infos[o + TOLD.reward_feed * m] = change * change
    infos[o + TOLD.reward_collision * m] = infos[o + TOLD.cost * m]
    return _weigh(infos, o, m, weights, TOLD.reward_contour, _CONTOUR_TERMS)


@part
def _cutting_reward(g, b, infos, o, m, weights):
    """The cut and the terms of Cutting; returns their weighted sum."""
    f, p = load(cut.Figures, g, b + gantry.FIGURES), load(cut.Params, g, b + gantry.P_CUT)
    s, was = load(Sums, g, b + gantry.SUMS), load(Sums, g, b + gantry.BEFORE)
    r, applied = load(Recipe, g, b + gantry.P_RECIPE), load(Process, g, b + gantry.APPLIED)
    length = s.length - was.length
    over = 1.0 / length if length > 0.0 else 0.0
    dross, rough = (s.dross - was.dross) * over, (s.roughness - was.roughness) * over
    through = (s.through - was.through) * over if length > 0.0 else 1.0
    infos[o + TOLD_CUTTING.margin * m] = f.margin
    infos[o + TOLD_CUTTING.dross * m] = f.dross
    infos[o + TOLD_CUTTING.roughness * m] = f.roughness
    infos[o + TOLD_CUTTING.kerf * m] = f.kerf_top
    infos[o + TOLD_CUTTING.taper * m] = f.taper
    infos[o + TOLD_CUTTING.power * m] = applied.power * r.power
    infos[o + TOLD_CUTTING.frequency * m] = applied.frequency
    infos[o + TOLD_CUTTING.step_dross * m] = dross
    infos[o + TOLD_CUTTING.step_roughness * m] = rough
    infos[o + TOLD_CUTTING.step_through * m] = through
    # Less what a cut that just goes through costs: a charge on every mm would pay for putting off the cut.
    infos[o + TOLD_CUTTING.reward_quality * m] = length * (0.5 * (dross / p.dross + rough / p.rough) - 1.0)
    infos[o + TOLD_CUTTING.reward_through * m] = length * (1.0 - through)
    infos[o + TOLD_CUTTING.reward_time * m] = _lost(g, b)
    infos[o + TOLD_CUTTING.reward_collision * m] = infos[o + TOLD_CUTTING.cost * m]
    infos[o + TOLD_CUTTING.reward_outside * m] = s.outside - was.outside
    excess = load(published.Excess, g, b + gantry.EXCESS)
    infos[o + TOLD_CUTTING.extrapolated * m] = 1.0 if published.outside(excess) else 0.0
    for k in range(_EXCESSES):
        infos[o + (TOLD_CUTTING.extrapolated + U1 + k) * m] = g[b + gantry.EXCESS + k * UW]
    return _weigh(infos, o, m, weights, TOLD_CUTTING.reward_quality, _CUTTING_TERMS)


def observe(block_address, at, n, io_address, first):
    """Stage after a step: observation, reward and info of each machine, and whether its episode is over."""
    block, io = doubles(block_address, ANY), words(io_address, IO_SIZE)
    deck = words(io[IO.gantry], gantry.DECK)
    g, jobs, base = doubles(deck[gantry.D.block], ANY), doubles(deck[gantry.D.jobs], ANY), gantry.column_of(at)
    out, infos, weights = singles(io[IO.observations], ANY), doubles(io[IO.infos], ANY), doubles(io[IO.weights], ANY)
    m, trail, earlier = io[IO.machines], _ago(block, at, 0), _ago(block, at, _BACK)
    for lane in range(n):
        a, b, o = at + lane, base + lane, first + lane
        _see(block, a, g, b, jobs, out, o * io[IO.size], io[IO.observation] == U1, io[IO.task], trail, earlier)
        _common(block, a, g, b, trail, infos, o, m)
        if io[IO.task] == U0:
            reward = _contour_reward(g, b, infos, o, m, weights)
        else:
            reward = _cutting_reward(g, b, infos, o, m, weights)
        store(g, b + gantry.BEFORE, load(Sums, g, b + gantry.SUMS))
        end(io, first, lane, reward, infos[o + TOLD.cost * m] > 0.5 or infos[o + TOLD.done * m] > 0.5)


def _task(key, number, **declared):
    """What the tasks of jobs have in common."""
    features = FEATURES[key]
    return Task(
        number=number,
        period=PERIOD_MS,
        features=Signals(features, -LIMIT, LIMIT),
        raw=Signals(features, -np.inf, np.inf),
        scaling={"unit_mm": TOLERANCE, "limit": LIMIT, "ahead_ms": list(AHEAD)},
        info=INFO[key],
        act=act,
        observe=observe,
        objectives=OBJECTIVES[key],
        **declared,
    )


CONTOUR = _task(
    "contour",
    0,
    id="kerfgym/ContourFollowing-v0",
    name="contour-following",
    slot="xy",
    scenario="contour-square",
    base="wu",
    actions={
        "residual": Actions(
            ("override", "correction_left", "correction_along"), ("1", "mm", "mm"), (OVERRIDE, CORRECTION, CORRECTION)
        )
    },
    reward=ContourReward(),
)
"""Declares ContourFollowing."""

_UNITS = ("1", "1", "Hz", "mm", "mm", "mm", "mm", "mm")
CUTTING = _task(
    "cutting",
    1,
    id="kerfgym/Cutting-v0",
    name="cutting",
    slot="process",
    scenario="cut-square",
    base="recipe",
    actions={
        "residual": Actions(Process._fields, _UNITS, tuple(map(float, RESIDUAL))),
        "direct": Actions(Process._fields, _UNITS),
    },
    reward=CuttingReward(),
)
"""Declares Cutting."""
