"""Random parts of what the nozzle meets: stationary, Gaussian, given by a spectrum.

A spectrum is a one-sided density over frequency, µm²/Hz. A sheet's is one over wavenumber, which the feed v turns into
one over frequency: ``S(f) = S(k)·2π/v`` with ``k = 2πf/v``. Sensor and score see it through responses of their own,
their footprints and the sensor's gate, so a part is three covariances: of what the sensor sees (``yy``), of the score's
sheet with what the sensor saw before (``xy``), and of the score's sheet (``xx``). Independent parts add up.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...envs.plant import sheet
from ...envs.plant.controller import PERIOD

MEMORY = 512
"""Control periods of the past of which covariances are known."""

SPAN = 2**15
"""Control periods after which a spectrum's covariances repeat, because it is summed at discrete frequencies."""

FINER = 8
"""How many times finer than the control period time is resolved: content above half the control rate folds."""


@dataclass(frozen=True)
class Random:
    """A stationary Gaussian part.

    Attributes:
        yy: µm², covariance of the sensor's view at lags of 0, 1, … control periods, shape (n,).
        xy: µm², covariance of the score's sheet with the sensor's view that many periods earlier, shape (n,).
        xx: µm², variance of the score's sheet.
    """

    yy: np.ndarray
    xy: np.ndarray
    xx: float

    def __add__(self, other: "Random") -> "Random":
        return Random(self.yy + other.yy, self.xy + other.xy, self.xx + other.xx)


NOTHING = Random(np.zeros(MEMORY), np.zeros(MEMORY), 0.0)
"""A sheet that does not move."""


def frequencies() -> np.ndarray:
    """Hz at which a density is summed: up to half of :data:`FINER` times the control rate."""
    return np.fft.rfftfreq(SPAN * FINER, PERIOD / FINER)


def seen(density: np.ndarray, sensor: Any = 1.0, score: Any = 1.0, lags: int = MEMORY) -> Random:
    """A part from its density.

    Args:
        density: one-sided, µm²/Hz, at :func:`frequencies`.
        sensor, score: responses through which the two see it, complex, at the same frequencies.
        lags: control periods of which covariances are made.

    Returns:
        ``yy(τ) = ∫ S·|H_s|²·cos 2πfτ df``, ``xy(τ) = Re ∫ S·H_x·H_s*·exp(2πifτ) df``, ``xx = ∫ S·|H_x|² df``.
    """
    sensor, score = np.broadcast_to(sensor, density.shape), np.broadcast_to(score, density.shape)

    def covariance(part: np.ndarray) -> np.ndarray:
        # irfft halves all frequencies but the ends, as a one-sided density wants them.
        steps = SPAN * FINER
        out = np.fft.irfft(part, steps) * steps / 2.0 * (1.0 / (SPAN * PERIOD))
        return np.asarray(out[: lags * FINER : FINER])

    return Random(
        covariance(density * np.abs(sensor) ** 2),
        covariance(density * score * np.conj(sensor)),
        float(covariance(density * np.abs(score) ** 2)[0]),
    )


def tones(variance: np.ndarray, omega: np.ndarray, sensor: Any = 1.0, score: Any = 1.0, lags: int = MEMORY) -> Random:
    """The mean spectrum of an ensemble of sines: what a controller knows that does not look which ones were drawn.

    Args:
        variance: µm² of each, shape (n,); an ensemble's are divided by its size.
        omega: rad/s, shape (n,).
        sensor, score: gains with which the two see each.
        lags: control periods of which covariances are made.
    """
    turn = np.cos(omega[:, None] * np.arange(lags) * PERIOD)
    return Random(
        (variance * np.abs(sensor) ** 2) @ turn, (variance * sensor * score) @ turn,
        float(np.sum(variance * np.abs(score) ** 2)),
    )  # fmt: skip


def along(density: Any, feed: float) -> np.ndarray:
    """A sheet's density over frequency at a feed of ``feed`` mm/s; ``density(k)`` is in µm²·mm over rad/mm."""
    per_feed = 2.0 * np.pi / feed
    return np.asarray(density(per_feed * frequencies()) * per_feed)


def power_law(k: np.ndarray, rms: float, exponent: float, roll_off: float) -> np.ndarray:
    """One-sided density of a sheet, µm²·mm, ∝ ``(k₀² + k²)^(−p/2)``: k⁻ᵖ above ``roll_off``, level below.

    Args:
        k: rad/mm.
        rms: µm, over all k.
        exponent: p, above 1.
        roll_off: k₀, rad/mm.
    """
    from scipy.special import gammaln

    # ∫₀^∞ (k₀² + k²)^(−p/2) dk = k₀^(1−p)·√π·Γ((p−1)/2)/(2·Γ(p/2))
    log = gammaln((exponent - 1) / 2) - gammaln(exponent / 2)
    whole = roll_off ** (1 - exponent) * np.sqrt(np.pi) / 2 * np.exp(log)
    return np.asarray(rms**2 * (roll_off**2 + np.asarray(k) ** 2) ** (-exponent / 2) / whole)


def band(rms: float, frequency: float, zeta: float, lags: int = MEMORY) -> Random:
    """A vibration that moves the whole sheet: white noise behind a second-order resonance.

    ``r(τ) = rms²·exp(−ζω|τ|)·(cos ω_d τ + ζω/ω_d·sin ω_d |τ|)``, ω = 2π·``frequency``, ω_d = ω·√(1 − ζ²), ζ < 1. The
    sensor sees it as the score does, but for its gate, which is shorter than anything that such a band can do.
    """
    omega = 2.0 * np.pi * frequency
    damped, t = omega * np.sqrt(1.0 - zeta**2), np.arange(lags) * PERIOD
    r = rms**2 * np.exp(-zeta * omega * t) * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t))
    return Random(r, r, float(rms**2))


def footprint(k: np.ndarray, radius: float) -> np.ndarray:
    """Factor by which a footprint of ``radius`` mm reduces a wave of ``k`` rad/mm, see :func:`sheet.attenuation`."""
    return sheet.attenuation(np.asarray(k) * (radius / sheet.FOOTPRINT))


def gate(frequency: np.ndarray, length: float, substep: float) -> np.ndarray:
    """Response of the mean over the last ``length`` s of a period, sampled each ``substep`` s, to its end; complex."""
    ages = np.arange(max(1, round(length / substep))) * substep
    return np.asarray(np.exp(-2j * np.pi * np.asarray(frequency)[..., None] * ages).mean(axis=-1))
