"""A step of the sheet, recognised while the sensor's plate is getting over it.

The plate is wider than the nozzle's tip: it begins to see an edge some 6 mm before the tip's middle has come to it,
and the tip only moves for the last 2 mm. What the plate sees of a step is known but for its height and where it lies
(:func:`kerfgym.envs.plant.sheet.share`). So the latest 14 mm of readings, one each 0.4 mm, are compared with a line
plus such a ramp, for each place where it may have begun, by generalised likelihood ratio (Willsky and Jones 1976). It
is a step when this leaves far less than a cubic does, which has as many free numbers. Then the tip's way is known
before it begins.

Everything is counted in mm of travel, so a step looks the same at any feed up to 0.4 mm a period.
"""

import numpy as np

from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.plant.sheet import FOOTPRINT, PLATE, share

PITCH = 0.4
"""mm from sample to sample."""

SAMPLES = 36
"""In the window."""

FIRST, LAST = 5, 32
"""Samples ago at which a ramp may have begun: the first, and the one beyond the last."""

PLACES = LAST - FIRST

LOW, HIGH = 0.03, 0.6
"""mm; lower and higher steps are left to others."""

STEADY = 0.3
"""Of its height, that the next sample may change it by."""

REST = 0.04
"""Of its height, root mean square of what a step may leave: what leaves more is a ramp of another shape."""

APART = 0.3
"""Of its height, that the sheets under plate and tip can differ by at a step; it is 0.24 at most [C]."""

SAME, NEW = 0.8, 0.5
"""mm by which the place of a ramp may differ from the one before; share of the newest fit then."""

FAINT = 1e-7
"""mm², sum of squares of a fit that is as good as the readings' resolution."""


def _orthonormal(degree):
    """Polynomials on the window, newest sample first, shape (samples, degree + 1)."""
    place = np.arange(SAMPLES) / SAMPLES
    return np.linalg.qr(np.stack([place**k for k in range(degree + 1)], 1))[0]


_LINE, _CUBIC = _orthonormal(1), _orthonormal(3)
_BEGUN = PITCH * np.arange(FIRST, LAST)
_RAMPS = np.array([[share((b - PITCH * i) / PLATE - 1.0) for b in _BEGUN] for i in range(SAMPLES)])
_LEFT = _RAMPS - _LINE @ (_LINE.T @ _RAMPS)

TEMPLATES = np.ascontiguousarray(_LEFT)
"""Ramps less the line that fits them best, shape (samples, places)."""

POWER = np.sum(_LEFT**2, 0)
"""Their sums of squares."""

NULL = np.ascontiguousarray(np.concatenate([_LINE, _CUBIC], 1))
"""The line's and the cubic's polynomials, shape (samples, 6)."""

TAKEN = np.ascontiguousarray((_LINE.T @ _RAMPS).T)
"""What the line takes of each ramp, shape (places, 2)."""

AT = np.array([_LINE[0, 0], _LINE[0, 1], (_LINE[0, 0] - _LINE[1, 0]) / PITCH, (_LINE[0, 1] - _LINE[1, 1]) / PITCH])
"""The line's polynomials at the newest sample: values and slopes."""

# Places in the memory.
WINDOW = 0  # samples, mm, newest first
FIT = WINDOW + SAMPLES  # of each place; scratch
SCORES = FIT + PLACES  # sums of squares that each place explains
SINCE = SCORES + PLACES  # mm since the newest sample
FILLED = SINCE + 1  # samples
LATEST = FILLED + 1  # mm, the latest reading
LIKE = LATEST + 1  # what the ramp leaves over what the cubic leaves; 1: no ramp
HEIGHT = LIKE + 1  # mm
PASSED = HEIGHT + 1  # mm of travel since the plate began to see it
BASE = PASSED + 1  # mm, the sheet without it here
INCLINE = BASE + 1  # mm/mm, its slope
MEMORY = INCLINE + 1


@part
def _compare(m):
    """The likeliest ramp in the window."""
    newest = m[WINDOW]
    whole, n0, n1, c0, c1, c2, c3 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(PLACES):
        m[FIT + c] = 0.0
    for i in range(SAMPLES):
        w = m[WINDOW + i] - newest
        whole += w * w
        n0 += w * NULL[i, 0]
        n1 += w * NULL[i, 1]
        c0 += w * NULL[i, 2]
        c1 += w * NULL[i, 3]
        c2 += w * NULL[i, 4]
        c3 += w * NULL[i, 5]
        for c in range(PLACES):
            m[FIT + c] += w * TEMPLATES[i, c]
    line = whole - n0 * n0 - n1 * n1
    cubic = whole - c0 * c0 - c1 * c1 - c2 * c2 - c3 * c3
    best = 0
    for c in range(PLACES):
        m[SCORES + c] = m[FIT + c] * m[FIT + c] / POWER[c]
        if m[SCORES + c] > m[SCORES + best]:
            best = c
    height, place = m[FIT + best] / POWER[best], 0.0
    left = max(line - m[SCORES + best], 0.0)
    like = (left + FAINT) / (max(cubic, 0.0) + FAINT)
    steady = abs(height - m[HEIGHT]) < STEADY * abs(height)
    like = like if steady and left < SAMPLES * (REST * height) * (REST * height) else 1.0
    t0, t1 = TAKEN[best, 0], TAKEN[best, 1]
    if best > 0 and best < PLACES - 1:
        # The top of the parabola through three places lies between them.
        before, at, after = m[SCORES + best - 1], m[SCORES + best], m[SCORES + best + 1]
        place = clip(0.5 * (after - before) / (2.0 * at - before - after + 1e-12), -0.5, 0.5)
        beside = best + 1 if place > 0.0 else best - 1
        far = abs(place)
        height += far * (m[FIT + beside] / POWER[beside] - height)
        t0, t1 = t0 + far * (TAKEN[beside, 0] - t0), t1 + far * (TAKEN[beside, 1] - t1)
    passed = PITCH * (FIRST + best + place)
    # The same ramp again, a sample on: the mean of the latest few says where it is.
    same = abs(passed - m[PASSED] - PITCH) < SAME and height * m[HEIGHT] > 0.0
    m[LIKE] += (NEW if same else 1.0) * (like - m[LIKE]) if like < m[LIKE] else NEW * (like - m[LIKE])
    m[HEIGHT] = m[HEIGHT] + NEW * (height - m[HEIGHT]) if same else height
    m[PASSED] = m[PASSED] + PITCH + NEW * (passed - m[PASSED] - PITCH) if same else passed
    n0, n1 = n0 - height * t0, n1 - height * t1
    m[BASE], m[INCLINE] = newest + n0 * AT[0] + n1 * AT[1], n0 * AT[2] + n1 * AT[3]


@part
def update(m, lost, measured, feed):
    """Takes in a reading.

    Args:
        m: this module's memory.
        lost: what was read before says nothing of the sheet.
        measured: mm, the sheet, impulses bridged.
        feed: mm/s.
    """
    if lost:
        m[FILLED], m[SINCE], m[LIKE], m[HEIGHT], m[LATEST] = 0.0, PITCH, 1.0, 0.0, measured
    way = feed * 1e-3
    m[SINCE] += way
    if m[SINCE] > PITCH - 1e-9:
        # The reading at the sample's place, between the latest two.
        m[SINCE] = m[SINCE] - PITCH if m[SINCE] < 2.0 * PITCH else 0.0
        for i in range(SAMPLES - 1):
            m[WINDOW + SAMPLES - 1 - i] = m[WINDOW + SAMPLES - 2 - i]
        m[WINDOW] = measured + m[SINCE] / max(way, 1e-9) * (m[LATEST] - measured)
        m[FILLED] = min(m[FILLED] + 1.0, SAMPLES)
        if m[FILLED] >= SAMPLES:
            _compare(m)
    m[LATEST] = measured


@part
def tip(m, way):
    """mm, the sheet under the tip ``way`` mm from here."""
    on = m[SINCE] + way
    return m[BASE] + m[INCLINE] * on + m[HEIGHT] * share((m[PASSED] + on - PLATE) / FOOTPRINT)


@part
def likely(m, feed, alike):
    """Share to which a ramp is believed: 1 where it leaves less than 3/4 of ``alike`` times what a cubic does."""
    fits = clip(4.0 * (1.0 - m[LIKE] / alike), 0.0, 1.0)
    known = m[FILLED] >= SAMPLES and feed < 1e3 * PITCH * 1.05
    steps = abs(m[HEIGHT]) > LOW and abs(m[HEIGHT]) < HIGH
    return fits if known and steps and abs(tip(m, 0.0) - m[LATEST]) < APART * abs(m[HEIGHT]) else 0.0
