"""Random parts of what the nozzle meets: stationary, Gaussian, given by their covariances.

Sensor and score see a sheet through footprints of their own, so a part is three covariances: of what the sensor sees
(``yy``), of the score's sheet with what the sensor saw before (``xy``), and of the score's sheet (``xx``). Independent
parts add up. A sheet's covariances are functions of the distance along the path (:class:`Surface`); the feed makes
functions of time of them. A vibration's are functions of time, and the same for both (:func:`bands`).
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from ...envs.plant import sheet
from ...envs.plant.controller import PERIOD

MEMORY = 512
"""Control periods of the past that a controller of finite memory knows."""

ENDLESS = 16385
"""Control periods after which a random part is forgotten, whatever it is."""


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
        (variance * np.abs(sensor) ** 2) @ turn,
        (variance * sensor * score) @ turn,
        float(np.sum(variance * np.abs(score) ** 2)),
    )


def bands(variance: np.ndarray, omega: np.ndarray, zeta: np.ndarray, lags: int = MEMORY) -> Random:
    """Vibrations as bands, exactly as the machine makes them: two steps of :func:`sheet.shake` in a control period.

    They obey ``x(n+1) = (2 − a − b)·x(n) − (1 − a)·x(n−1) + noise``, hence their covariances do, too (Yule 1927).

    Args:
        variance: µm² of each, shape (n,).
        omega, zeta: rad/s and damping ratio of each, shape (n,).
        lags: control periods of which covariances are made.
    """
    dt = 0.5 * PERIOD
    a, b = 2.0 * zeta * omega * dt, (omega * dt) ** 2
    r = np.empty((2 * lags, len(omega)))
    for i in range(len(omega)):
        begin = np.zeros(2 * lags)
        begin[:2] = variance[i], -variance[i] * (2.0 - a[i] - b[i]) * (1.0 - a[i]) / (2.0 - a[i])
        r[:, i] = lfilter([1.0], [1.0, a[i] + b[i] - 2.0, 1.0 - a[i]], begin)
    total = r[::2].sum(axis=1)
    return Random(total, total, float(variance.sum()))


@dataclass(frozen=True)
class Surface:
    """A sheet of continuous spectrum, of RMS 1 under the nozzle's tip: covariances over the distance in mm.

    Attributes:
        plate: mm, radius of the plate's footprint.
        yy: of what the plate feels.
        xy: of what the tip has with what the plate feels.
        xx: variance under the tip; a little more than 1, since a table has no mean, and an ensemble of sheets has one.
        bare: of the sheet itself at multiples of :data:`sheet.RANDOM_SPACING`, without a footprint.
        news: weights that make the sheet itself, at those multiples, of white noise of variance 1: the causal factor of
            its density. All before being known, this is what is still unknown.
    """

    plate: float
    yy: CubicSpline
    xy: CubicSpline
    xx: float
    bare: np.ndarray
    news: np.ndarray

    def at(self, feed: float, variance: float, lags: int = MEMORY) -> Random:
        """Under a constant ``feed`` (mm/s), of ``variance`` µm² under the tip."""
        d = np.minimum(feed * PERIOD * np.arange(lags), self.yy.x[-1])
        return Random(variance * self.yy(d), variance * self.xy(d), variance * self.xx)


@functools.cache
def surface(exponent: float, rolloff: float, plate: float) -> Surface:
    """The ensemble of which :func:`sheet.random_tables` draws one sheet.

    Args:
        exponent: of the wavenumber beyond the roll-off.
        rolloff: mm, wavelength beyond which the density no longer rises.
        plate: mm, radius of the plate's footprint.
    """
    n = sheet.RANDOM_ONE
    k = 2.0 * np.pi * np.fft.rfftfreq(n, sheet.RANDOM_SPACING)
    density = (k * k + (2.0 * np.pi / rolloff) ** 2) ** (-0.5 * exponent)
    tip, felt = sheet.attenuation(k), sheet.attenuation(k, plate)
    variance, mean = np.fft.irfft(density * tip * tip, n)[0], density[0] / n
    whole = variance - mean

    def covariance(part: np.ndarray) -> np.ndarray:
        return np.asarray(np.fft.irfft(part, n)[: n // 2] / whole)

    def smooth(part: np.ndarray) -> CubicSpline:
        d = np.arange(n // 2) * sheet.RANDOM_SPACING
        return CubicSpline(d, covariance(part), bc_type=((1, 0.0), (1, 0.0)))  # even, hence level at 0

    seen, shown = smooth(density * felt * felt), smooth(density * tip * felt)
    found = causal(density / whole)[: n // 2]
    return Surface(plate, seen, shown, float(variance / whole), covariance(density), found)


def causal(density: np.ndarray) -> np.ndarray:
    """Weights, newest first, of the filter that makes a process of this ``density`` of white noise of variance 1.

    The causal half of the cepstrum; ``density`` is at the frequencies of ``rfft`` of an even number of samples.
    """
    n = 2 * (len(density) - 1)
    cepstrum = np.fft.irfft(np.log(density), n)
    cepstrum[0] *= 0.5
    cepstrum[n // 2] *= 0.5
    cepstrum[n // 2 + 1 :] = 0.0
    return np.asarray(np.fft.irfft(np.exp(np.fft.rfft(cepstrum)), n))
