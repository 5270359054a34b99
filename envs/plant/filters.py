"""Digital filters on the counted frequency.

All window filters are one: a weighted mean of the last ``window`` samples, the ``trim`` smallest and largest left out.

=============  ===========================================================  ==================
kind           what it is                                                   source
=============  ===========================================================  ==================
none           the newest sample
mean           moving average, y = Σ x/N, causal: a delay of (N − 1)/2      Xi2023 eq. 6
improved       trimmed mean: without the extremes, divided by N − 2·trim    Xi2023 Fig. 9
weighted       weights fall by the factor ``ratio`` from sample to sample   Xi2023 (named)
median         all but the middle one (or two) trimmed
lag            first order, y += (x − y)·T/(tau + T)                        Xi2023 (named)
anti-impulse   a jump off the trend is bridged, for ``hold`` samples        Xi2023 (named)
kalman         scalar Kalman filter of a random walk
=============  ===========================================================  ==================

The window lives in a ring of 64 samples. Means and single trims are one pass over the window (:func:`take`); a trim of
two or more, and the median, count ranks (:func:`ranked`).
"""

from typing import Annotated, NamedTuple

import numpy as np

from ..engine.lanes import clip, part
from ..engine.quantity import InvalidInput, Quantity

LONGEST = 64
"""Largest window, samples."""

KINDS = ("none", "mean", "improved", "weighted", "median", "lag", "anti-impulse", "kalman")
NONE, MEAN, IMPROVED, WEIGHTED, MEDIAN, LAG, ANTI_IMPULSE, KALMAN = (float(i) for i in range(len(KINDS)))


TREND = 0.3
"""Share of the newest difference in the trend of the anti-impulse filter [A]."""

FASTEST = 0.5
"""mm per sample, steepest trend that the anti-impulse filter follows: the fastest drive, 500 mm/s (Xi2023)."""

OPEN = 20.0
"""Samples for which the anti-impulse filter passes everything after a jump that outlasted it: as long as faults of a
sensor last, so that its return is not bridged as well [A]."""


class Params(NamedTuple):
    """Choice and settings of the filter; each kind reads only its own."""

    kind: Annotated[float, Quantity("", 0, len(KINDS) - 1, "filter", "Xi2023", choices=KINDS)] = IMPROVED
    window: Annotated[float, Quantity("samples", 1, LONGEST, "length N of the queue", "Xi2023", whole=True)] = 5.0
    trim: Annotated[
        float, Quantity("samples", 0, LONGEST // 2 - 1, "left out at each end (improved)", "Xi2023", whole=True)
    ] = 1.0
    ratio: Annotated[float, Quantity("1", 0.1, 1.0, "weight of a sample over that of the next newer (weighted)")] = 0.8
    tau: Annotated[float, Quantity("ms", 0.0, 100.0, "time constant (lag)")] = 2.0
    jump: Annotated[float, Quantity("mm", 1e-3, 0.2, "apparent jump that is bridged (anti-impulse)", log=True)] = 0.04
    hold: Annotated[float, Quantity("samples", 0, 50, "most samples bridged in a row (anti-impulse)", whole=True)] = 2.0
    trust: Annotated[
        float, Quantity("1", 1e-6, 1e3, "process over measurement variance per sample (kalman)", log=True)
    ] = 0.3


class State(NamedTuple):
    """Memory of the recursive kinds."""

    value: float = 0.0  # Hz, last output
    variance: float = 1e6  # of the estimate over that of a measurement
    held: float = 0.0  # samples the current jump has been bridged; below 0: samples the filter stays open
    trend: float = 0.0  # Hz per sample


class Fold(NamedTuple):
    """A pass over the window."""

    total: float = 0.0
    weight: float = 0.0  # of the next sample
    weights: float = 0.0
    low: float = 0.0
    high: float = 0.0


def validated(p: Params) -> Params:
    """The settings as the kernel takes them: odd cases resolved, impossible ones refused.

    Raises:
        InvalidInput: the trim leaves nothing of the window.
    """
    if p.kind == NONE:
        return p._replace(window=1.0, trim=0.0)
    if p.kind in (MEAN, WEIGHTED):
        return p._replace(trim=0.0)
    if p.kind == MEDIAN:
        return p._replace(trim=float((int(p.window) - 1) // 2))
    if p.kind == IMPROVED:
        if p.window - 2 * p.trim < 1:
            raise InvalidInput(
                f"filter.trim = {p.trim:g} eats the whole window of {p.window:g} samples; "
                f"allowed: 0 to {(int(p.window) - 1) // 2} at this window"
            )
        return p
    return p._replace(window=1.0, trim=0.0)


@part
def begin():
    """An empty pass."""
    return Fold(0.0, 1.0, 0.0, np.inf, -np.inf)


@part
def take(p, fold, sample, age):
    """The pass with one more sample, ``age`` samples old; samples beyond the window change nothing."""
    inside = age < p.window
    ratio = p.ratio if p.kind == WEIGHTED else 1.0
    w = fold.weight if inside else 0.0
    return Fold(
        total=fold.total + w * sample,
        weight=fold.weight * ratio,
        weights=fold.weights + w,
        low=min(fold.low, sample if inside else fold.low),
        high=max(fold.high, sample if inside else fold.high),
    )


@part
def kept(p, rank, age):
    """1 for a sample of the window whose rank survives a trim, 0 otherwise."""
    inside = age < p.window and rank >= p.trim and rank < p.window - p.trim
    return 1.0 if inside else 0.0


@part
def mean(p, fold):
    """Result of a window filter with a trim of 0 or 1, Hz (Xi2023 eq. 6 and Fig. 9)."""
    cut = p.trim if p.kind != WEIGHTED else 0.0
    return (fold.total - cut * (fold.low + fold.high)) / (fold.weights - 2.0 * cut)


@part
def finish(p, s, windowed, sample, slope):
    """The filter's output.

    Args:
        p, s: :class:`Params`, :class:`State`.
        windowed: mean of the window, Hz.
        sample: newest sample, Hz.
        slope: of the calibration table at the last reading, Hz/mm; turns ``jump`` into a frequency.

    Returns:
        ``(state, frequency)``, Hz.
    """
    lag = s.value + (sample - s.value) / (p.tau + 1.0)  # T = 1 ms

    # A jump off the trend is bridged; one that outlasts `hold` is real. Then the filter stays open for a while, so that
    # it learns the new trend (from none: a lasting step must not be extrapolated). A head on its way down moves through
    # the curve of f(h); its trend bends, and must not be taken for a jump. All samples bridged in a row are together no
    # further from the last that was believed than a jump, or one sample's trend.
    trend = clip(s.trend, -FASTEST * slope, FASTEST * slope)
    farthest = max(p.jump * slope, abs(trend))
    expected = s.value + (trend if (s.held + 1.0) * abs(trend) <= farthest else 0.0)
    off = abs(sample - expected) > p.jump * slope + 0.5 * abs(trend)
    jumps = off and s.held >= 0.0 and s.held < p.hold
    outlasted = off and s.held >= p.hold
    anti = expected if jumps else sample
    learned = 0.0 if outlasted else trend + TREND * (sample - s.value - trend)
    trend = trend if jumps else learned
    opened = -OPEN if outlasted else min(s.held + 1.0, 0.0)
    held = s.held + 1.0 if jumps else (opened if off or s.held < 0.0 else 0.0)

    variance = s.variance + p.trust
    gain = variance / (variance + 1.0)
    kalman = s.value + gain * (sample - s.value)

    recursive = lag if p.kind == LAG else (anti if p.kind == ANTI_IMPULSE else kalman)
    value = recursive if p.kind >= LAG else windowed
    return State(value, (1.0 - gain) * variance, held, trend), value
