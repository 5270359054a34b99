"""What a model leaves of a log: is it white, does it go with the command, and is it large enough to matter.

Tests of long logs find the smallest of mistakes. So every test here has an effect beside its p-value: the share of the
residual that its own past, or the command, explains, and its size in counts of the encoder («Ljung 1999», ch. 16).
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

LAGS = 60
"""Samples up to which correlations are shown and tested; longer than any dead time that is searched."""

LEVEL = 0.05
"""Of every test; bounds hold 95 %."""

SMALL = 2.0
"""Encoder counts of RMS residual below which no model is called wrong: a count alone leaves 0.3, two of them (model's
and machine's) with the converter's steps between up to one [A]."""

LARGE = 5.0
"""Encoder counts of RMS residual from which on a model that leaves something to explain does not explain the drive
[A]."""

FINEST = 1.0
"""µm that a count is taken for if it is smaller: what matters to a follower, whose error is some tens of µm, does not
become less with a finer scale [A]."""

SHARE = 0.2
"""Share of the residual's variance that past, command, speed or place must explain to be named as a cause [A]; a
fifth of the variance is a tenth of the RMS."""

BINS, FINE = 24, 240
"""Of speed and of place in a correlation ratio; a screw's error comes back at each turn."""


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation at lags 0 to :data:`LAGS`, its 95 % bound, Ljung and Box's statistic with its p-value, and the
    share of the variance that the past explains."""

    rho: np.ndarray
    bound: float
    statistic: float
    p: float
    effect: float


@dataclass(frozen=True)
class Crossing:
    """Correlation of the residual with an input ``lags`` samples before it, its 95 % bound, the share of lags outside,
    p-values of the two sides, and the share of the variance that the input's past explains."""

    lags: np.ndarray
    rho: np.ndarray
    bound: float
    outside: float
    p_causal: float
    p_feedback: float
    effect: float


def autocorrelation(residual: np.ndarray, lags: int = LAGS) -> np.ndarray:
    """At lags 0 to ``lags``, of shape (lags + 1,)."""
    r = np.asarray(residual, float) - np.mean(residual)
    power = np.abs(np.fft.rfft(r, 2 * len(r))) ** 2
    rho: np.ndarray = np.fft.irfft(power)[: lags + 1]
    return rho / max(float(rho[0]), 1e-300)


def ljung_box(residual: np.ndarray, lags: int = 20) -> tuple[float, float]:
    """Statistic and p-value of «Ljung and Box 1978»: are the first ``lags`` autocorrelations those of white noise?"""
    n, rho = len(residual), autocorrelation(residual, lags)[1:]
    q = n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    return q, float(stats.chi2.sf(q, lags))


def whiteness(residual: np.ndarray, order: int = 20) -> Whiteness:
    """How white a residual is; the effect is that of the best linear prediction from ``order`` samples (Yule,
    Walker)."""
    rho = autocorrelation(residual)
    toeplitz = rho[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
    weights = np.linalg.lstsq(toeplitz, rho[1 : order + 1], rcond=1e-10)[0]
    effect = float(np.clip(weights @ rho[1 : order + 1], 0.0, 1.0))
    return Whiteness(rho, float(stats.norm.ppf(1 - LEVEL / 2)) / np.sqrt(len(residual)), *ljung_box(residual), effect)


def crossed(residual: np.ndarray, driver: np.ndarray, lags: int = LAGS) -> Crossing:
    """Correlation of a residual with what may have driven it, at lags −``lags`` to ``lags``.

    The bound is Ljung's: the variance of the estimate for independent signals is Σ ρ_e(k) ρ_u(k) / N.
    """
    e, u = residual - np.mean(residual), driver - np.mean(driver)
    n, size = len(e), max(float(np.sqrt(np.sum(e * e) * np.sum(u * u))), 1e-300)
    both = np.fft.irfft(np.fft.rfft(e, 2 * n) * np.conj(np.fft.rfft(u, 2 * n)), 2 * n) / size
    rho = np.concatenate([both[-lags:], both[: lags + 1]])
    wide = min(n - 1, 10 * lags)
    of_e, of_u = autocorrelation(e, wide), autocorrelation(u, wide)
    taper = 1.0 - np.arange(wide + 1) / (wide + 1.0)
    variance = max((1.0 + 2.0 * float(np.sum((taper * of_e * of_u)[1:]))) / n, 0.1 / n)
    bound = float(stats.norm.ppf(1 - LEVEL / 2)) * np.sqrt(variance)
    # The largest of correlated lags, as if they were independent (Šidák): no side is found too often.
    sides = [np.max(np.abs(rho[lags:])), np.max(np.abs(rho[:lags]))]
    alone = [2 * stats.norm.sf(top / np.sqrt(variance)) for top in sides]
    p = [float(-np.expm1(lags * np.log1p(-min(a, 1 - 1e-12)))) for a in alone]
    outside = float(np.mean(np.abs(rho) > bound))
    return Crossing(np.arange(-lags, lags + 1), rho, bound, outside, p[0], p[1], _explained(e, u, lags))


def _explained(e: np.ndarray, u: np.ndarray, lags: int) -> float:
    """Share of ``e`` that ``u`` up to ``lags`` samples before explains; found in one half, counted in the other."""
    past = np.stack([u[lags - k : len(u) - k] for k in range(lags)], axis=1)
    late, half = e[lags:], (len(e) - lags) // 2
    shares = []
    for fit, test in ((slice(None, half), slice(half, None)), (slice(half, None), slice(None, half))):
        weights = np.linalg.lstsq(past[fit], late[fit], rcond=1e-8)[0]
        rest = late[test] - past[test] @ weights
        shares.append(1.0 - float(np.sum(rest**2)) / max(float(np.sum(late[test] ** 2)), 1e-300))
    return float(np.clip(np.mean(shares), 0.0, 1.0))


def ratio(residual: np.ndarray, by: np.ndarray, bins: int = BINS) -> float:
    """Share of a residual that its mean over bins of ``by`` explains, whatever the shape (correlation ratio), found in
    every other second and counted in those between."""
    edges = np.unique(np.quantile(by, np.linspace(0, 1, bins + 1)[1:-1]))
    at, turn = np.searchsorted(edges, by), np.arange(len(by)) // 1000 % 2
    shares = []
    for fit in (0, 1):
        a, b = turn == fit, turn != fit
        if not a.any() or not b.any():
            return 0.0
        count = np.bincount(at[a], minlength=len(edges) + 1)
        means = np.bincount(at[a], residual[a], minlength=len(edges) + 1) / np.maximum(count, 1)
        shares.append(1 - np.sum((residual[b] - means[at[b]]) ** 2) / max(float(np.sum(residual[b] ** 2)), 1e-300))
    return float(np.clip(np.mean(shares), 0.0, 1.0))


@dataclass(frozen=True)
class Verdict:
    """Whether a model explains a log: ``yes``, ``no`` or ``partly``, and why, in a plain sentence."""

    explains: str
    why: str


@dataclass(frozen=True)
class Judged:
    """A residual, µm, with its tests and the verdict."""

    rms: float
    counts: float
    white: Whiteness
    crossing: Crossing
    verdict: Verdict


def judged(residual: np.ndarray, command: np.ndarray, encoder: np.ndarray, count: float) -> Judged:
    """Judges what a model of the drive leaves of a motion log.

    Args:
        residual: µm, at the samples that count.
        command: mm/s, there.
        encoder: mm, there.
        count: µm of the encoder.
    """
    rms = float(np.sqrt(np.mean(residual**2)))
    white, crossing = whiteness(residual), crossed(residual, command)
    counts, speed = rms / max(count, 1e-9), np.gradient(encoder)
    causes = {
        "goes with the command before it: missing linear dynamics, such as a resonance": crossing.effect,
        "goes with the speed: missing friction, play or a limit": ratio(residual, speed),
        "goes with the place: an uneven scale or screw": ratio(residual, encoder, FINE),
    }
    named = [f"{why} ({share:.0%} of its variance)" for why, share in causes.items() if share >= SHARE]
    size = f"it leaves {rms:.2g} µm RMS, {counts:.2g} counts of the encoder"
    large = rms / max(count, FINEST)
    if large <= SMALL:
        also = "" if white.p > LEVEL and not named else (
            "; tests find a pattern in it, as they do in any log so long, but there is nothing of size to explain"
        )  # fmt: skip
        return Judged(rms, counts, white, crossing, Verdict("yes", size + also))
    if named or white.effect >= SHARE:
        if not named:
            named = [f"follows from its own past by {white.effect:.0%}, yet neither from command, speed nor place: "
                     "missing dynamics that the command does not drive linearly, or a disturbance"]  # fmt: skip
        sides = [w for w, p in (("before", crossing.p_causal), ("after", crossing.p_feedback)) if p < LEVEL]
        told = f"; correlation with the command {' and '.join(sides)} it is outside of the bounds" if sides else ""
        word = "no" if large > LARGE else "partly"
        return Judged(rms, counts, white, crossing, Verdict(word, f"{size}; the rest {'; '.join(named)}{told}"))
    return Judged(rms, counts, white, crossing,
                  Verdict("partly", f"{size}, and that is noise without a pattern: the encoder or the drive is noisier "
                                    "than the model's"))  # fmt: skip


def count_of(encoder: np.ndarray) -> float:
    """µm of one count: the smallest step, or difference of steps, that a log shows more than by rounding."""
    steps = np.abs(np.concatenate([np.diff(encoder), np.diff(encoder, 2)]))
    steps = steps[steps > 5e-6]
    return 1e3 * float(np.quantile(steps, 0.001)) if len(steps) else 1.0
