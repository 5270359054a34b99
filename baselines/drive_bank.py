"""Which drive it is: sixteen models of the drive run side by side, weighted by how well each explains the encoder.

Each model is a velocity loop of second order behind a dead time, ``ω²·(u(t − dead) − v) − 2ζω·a``, with Coulomb
friction that the loop must overcome whenever the axis turns back. They differ in dead time and in lag 2ζ/ω. All get
the commands that were sent; each is drawn slowly to the encoder, so that it is judged by how the head has moved of
late, not by where it is. The estimate is the mean of the models, weighted with a power of the least mean square over
the model's own (multiple-model estimation: Bar-Shalom, Li and Kirubarajan 2001, ch. 11; the power stands in for a
likelihood, since what is left is friction and backlash rather than white noise).
"""

import numpy as np

from kerfgym.envs.engine.lanes import clip, part

DEAD = (1.2, 2.0, 2.8, 3.8)
"""ms, dead times, in steps of a substep."""

LAGS = (1.9, 2.9, 4.1, 5.7)
"""ms, lags 2ζ/ω."""

EACH = 4
MODELS = EACH * EACH

DAMPING = 0.8
"""ζ of all models."""

SUBSTEPS = 5
STEP = 1e-3 / SUBSTEPS
"""s"""

GATE = 0.625
"""Of the last substep, by which the encoder is read before its end: the gate's centre is an eighth of a period back."""

DRAWN = 0.03
"""Share of its error by which a model is drawn to the encoder in a period."""

RECALL = 0.997
"""Memory of the errors, per period."""

FAR = 4e-4
"""mm²; a larger square of an error counts as this one."""

LEAST = 3e-5
"""mm², sum of squares that the encoder's resolution leaves of a perfect model."""

SHARPNESS = 3
"""Times that the ratio of sums of squares is squared."""

CREEP = 1.0
"""mm/s, speed at which friction has grown to its full value."""

COMMANDS = 5
"""That are remembered."""

# Places in the memory: rows of a number for each model.
POSITION = 0
VELOCITY = POSITION + MODELS
ACCELERATION = VELOCITY + MODELS
ERROR = ACCELERATION + MODELS  # sum of squares, fading
FRICTION = ERROR + MODELS
SENT = FRICTION + MODELS  # commands, the newest first
DEAD_TIME = SENT + COMMANDS  # ms, estimated
LAG = DEAD_TIME + 1  # ms, estimated
SURE = LAG + 1  # models that are as good as the best, at least 1
MEMORY = SURE + 1


@part
def _begin(m, encoder):
    for k in range(MODELS):
        m[POSITION + k] = encoder
        m[VELOCITY + k], m[ACCELERATION + k], m[ERROR + k], m[FRICTION + k] = 0.0, 0.0, 0.0, 0.0
    for k in range(COMMANDS):
        m[SENT + k] = 0.0


@part
def _run(m, encoder, dead, first, friction):
    """One period of the models with a dead time."""
    whole = np.int64(np.floor(dead + 1e-9))
    older, newer, change = m[SENT + whole + 1], m[SENT + whole], dead - whole + 1e-6
    for j in range(EACH):
        k = first + j
        omega = 2e3 * DAMPING / LAGS[j]
        x = omega * STEP
        stiff, damp = omega * x * (1.0 - DAMPING * x), 2.0 * DAMPING * x - (2.0 * DAMPING * DAMPING - 0.5) * x * x
        p, v, a, r = m[POSITION + k], m[VELOCITY + k], m[ACCELERATION + k], m[FRICTION + k]
        last = p
        for i in range(SUBSTEPS):
            u = older if (i + 1.0) / SUBSTEPS <= change else newer
            resists = friction * clip(v / CREEP, -1.0, 1.0)
            after = a + stiff * (u - v) - damp * a + r - resists
            faster = v + 0.5 * STEP * (a + after)
            last = p
            p += 0.5 * STEP * (v + faster)
            v, a, r = faster, after, resists
        missed = encoder - (p - GATE * (p - last))
        m[POSITION + k], m[VELOCITY + k], m[ACCELERATION + k] = p + DRAWN * missed, v, a
        m[FRICTION + k] = r
        m[ERROR + k] = RECALL * m[ERROR + k] + min(missed * missed, FAR)


@part
def update(m, fresh, encoder, command, friction):
    """Runs the models through the period that is over.

    Args:
        m: this module's memory.
        fresh: an episode begins.
        encoder: mm, at the gate's centre.
        command: mm/s, what was sent at the period's start.
        friction: mm/s², Coulomb friction over mass.
    """
    if fresh:
        _begin(m, encoder)
    for k in range(COMMANDS - 1):
        m[SENT + COMMANDS - 1 - k] = m[SENT + COMMANDS - 2 - k]
    m[SENT] = command
    for d in range(EACH):
        _run(m, encoder, DEAD[d], EACH * d, friction)
    best = m[ERROR]
    for k in range(1, MODELS):
        best = min(best, m[ERROR + k])
    total, dead, lag = 0.0, 0.0, 0.0
    for d in range(EACH):
        for j in range(EACH):
            w = (best + LEAST) / (m[ERROR + EACH * d + j] + LEAST)
            for _ in range(SHARPNESS):
                w *= w
            total += w
            dead += w * DEAD[d]
            lag += w * LAGS[j]
    m[DEAD_TIME], m[LAG], m[SURE] = dead / total, lag / total, total
