"""What a sheet does, from its readings alone: whether it is bent, straight or shaken, and how it is bent.

**Trends.** Four fading-memory polynomials of second order follow the readings: α-β-γ filters with three equal poles
(Benedict and Bordner 1962 for the first order). They forget by the way that the head has travelled, not by time, so
what they hold of a sheet is the same at any feed: its level, slope and bend over 1.2 to 9.6 mm.

**Noise** is estimated from third differences of the readings, of which a sheet has little.

**Bent or shaken.** The sensor's plate is 11 mm wide and hardly sees shorter waves. So what differs between the two
shortest trends is mostly noise or vibration, and what differs between the second and the third is mostly the sheet's
shape. Their ratio tells.

**The straight line** is fitted by least squares to all readings since the sheet was last seen to leave it, at most
``LONGEST``. It is left when a mean of the newest innovations, or one of more of them, exceeds what noise makes of it.
"""

import numpy as np

from kerfgym.envs.engine.lanes import clip, part

LENGTHS = (1.2, 2.4, 4.8, 9.6)
"""mm of travel that the trends remember."""

TRENDS = len(LENGTHS)

SLOWEST = 20.0
"""mm/s; below, trends forget as if the head travelled so fast."""

LEAST = 0.3
"""Of the past, that a period leaves at any feed."""

LONGEST = 1000.0
"""Readings of which the line is a mean."""

QUICK, SLOW = 0.3, 0.05
"""Shares of the newest innovation in the two means that are tested."""

QUICK_SPREAD, SLOW_SPREAD = 0.42, 0.16
"""Their standard deviations over that of an innovation, sqrt(share/(2 − share)) [C]."""

STRAY = 3.57
"""Mean size of a third difference over the standard deviation of noise, sqrt(20)·sqrt(2/π) [C]."""

FAINT = 3e-4
"""mm; noise is never taken to be smaller, which the resolution of count and encoder would not support."""

OUTLIER, OUTLAST = 6.0, 4.0
"""An innovation of more than so many times the noise does not count, unless so many follow one another."""

PACE = 0.02
"""Share of the newest period in the estimate of noise."""

RECENT = 1.0 / 150.0
"""Share of the newest period in the mean squares that tell bent from shaken."""

# Places in the memory.
LEVEL = 0  # mm, of each trend
SLOPE = LEVEL + TRENDS  # mm/mm
BEND = SLOPE + TRENDS  # mm/mm²
BEFORE = BEND + TRENDS  # the last three readings, mm
NOISE = BEFORE + 3  # mm, standard deviation of a reading
AGE = NOISE + 1  # periods since the sheet is known
SHORT = AGE + 1  # mm², mean square of the difference of the shortest trends, …
LONG = SHORT + 1  # … and of the next two
LINE = LONG + 1  # mm, the line here
TILT = LINE + 1  # mm/mm
COUNT = TILT + 1  # readings in it
NEWEST = COUNT + 1  # the two means of innovations, in units of the noise
NEWER = NEWEST + 1
STRAIGHT = NEWER + 1  # periods since the line was left
APART = STRAIGHT + 1  # outliers that have followed one another
MEMORY = APART + 1


@part
def _begin(m, measured):
    """All that is known of the sheet is one reading."""
    for k in range(TRENDS):
        m[LEVEL + k], m[SLOPE + k], m[BEND + k] = measured, 0.0, 0.0
    for k in range(3):
        m[BEFORE + k] = measured
    m[AGE], m[SHORT], m[LONG] = 0.0, 0.0, 0.0
    _leave(m, measured, 1.0)
    m[TILT] = 0.0


@part
def _leave(m, measured, count):
    """The line begins anew, with the tilt that it had."""
    m[LINE], m[COUNT], m[NEWEST], m[NEWER], m[STRAIGHT], m[APART] = measured, count, 0.0, 0.0, 0.0, 0.0


@part
def _follow(m, measured, way):
    """The trends after one more reading, ``way`` mm on."""
    m[AGE] = min(m[AGE] + 1.0, 1e6)
    for k in range(TRENDS):
        # While they know fewer readings than they remember, they are a fit to all of them.
        newest = max(way / LENGTHS[k], 3.0 / (m[AGE] + 9.0))
        kept = max(1.0 - newest, LEAST)
        d = 1.0 - kept
        level = m[LEVEL + k] + way * (m[SLOPE + k] + 0.5 * way * m[BEND + k])
        slope = m[SLOPE + k] + way * m[BEND + k]
        missed = measured - level
        m[LEVEL + k] = level + (1.0 - kept * kept * kept) * missed
        m[SLOPE + k] = slope + 1.5 * d * d * (1.0 + kept) / way * missed
        m[BEND + k] += d * d * d / (way * way) * missed


@part
def _straighten(m, seen, measured, way, test):
    """The line after one more reading."""
    line = m[LINE] + way * m[TILT]
    missed = (seen - line) / m[NOISE]
    apart = m[APART] + 1.0 if abs(missed) > OUTLIER else 0.0
    m[LINE], m[APART] = line, apart
    if apart == 0.0:
        n = min(m[COUNT] + 1.0, LONGEST)
        m[COUNT] = n
        m[LINE] += 2.0 * (2.0 * n - 1.0) / (n * (n + 1.0)) * (seen - line)
        m[TILT] += 6.0 / (n * (n + 1.0)) * (seen - line) / way
        m[NEWEST] += QUICK * (missed - m[NEWEST])
        m[NEWER] += SLOW * (missed - m[NEWER])
        m[STRAIGHT] = min(m[STRAIGHT] + 1.0, 1e6)
    if abs(m[NEWEST]) > test * QUICK_SPREAD or abs(m[NEWER]) > test * SLOW_SPREAD or apart > OUTLAST:
        _leave(m, measured, 2.0)


@part
def update(m, fresh, lost, measured, seen, feed, test):
    """Takes in a reading.

    Args:
        m: this module's memory.
        fresh: an episode begins.
        lost: what was read before says nothing of the sheet.
        measured, seen: mm, the sheet: impulses bridged, and as it was read.
        feed: mm/s.
        test: standard deviations at which the line is left.
    """
    if fresh:
        m[NOISE] = 3e-3
    if fresh or lost:
        _begin(m, measured)
        return
    stray = abs(measured - 3.0 * m[BEFORE] + 3.0 * m[BEFORE + 1] - m[BEFORE + 2]) / STRAY
    m[BEFORE + 2], m[BEFORE + 1], m[BEFORE] = m[BEFORE + 1], m[BEFORE], measured
    if m[AGE] > 2.0:
        m[NOISE] = max(m[NOISE] + PACE * (min(stray, 4.0 * m[NOISE]) - m[NOISE]), FAINT)
    way = max(feed, SLOWEST) * 1e-3
    _follow(m, measured, way)
    short, long = m[LEVEL] - m[LEVEL + 1], m[LEVEL + 1] - m[LEVEL + 2]
    m[SHORT] += RECENT * (short * short - m[SHORT])
    m[LONG] += RECENT * (long * long - m[LONG])
    _straighten(m, seen, measured, way, test)


@part
def shaken(m):
    """Root mean square of what differs in the short over that in the long: 0.1 to 0.5 for a bent sheet, 0.5 to 1.5 for
    one that vibrates, about 1.4 for noise."""
    return np.sqrt((m[SHORT] + 1e-16) / (m[LONG] + 1e-16))


@part
def straight(m, wait):
    """Share to which the sheet counts as straight, ``wait`` periods after it last left a line."""
    return clip((m[STRAIGHT] - wait) / 20.0, 0.0, 1.0)
