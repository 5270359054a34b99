"""The least mean-square error with which the score's sheet can be known some control periods ahead.

What the score will meet is ``x(n) = z_x(n) + F_x(n)·θ``: a random part and shapes of unknown size θ. A controller that
knows where its head is has, from each reading, ``y(n) = z_y(n) + F_y(n)·θ + v(n)`` with white noise v. Everything is
Gaussian, so the best causal estimate is linear (Wiener 1949, Kalman 1960), and its error at n from readings up to n − h
is (in geostatistics, universal kriging)::

    V(n) = r_xx − rᵀR⁻¹r + g·(Λ + Σ F̃ᵀF̃)⁻¹·gᵀ,    g = F_x(n) − wᵀF_y,   w = R⁻¹r

R is the covariance of random part and noise in the readings, r that of the readings with ``z_x(n)``, Λ the inverse of
the sizes' variances, and F̃ the shapes as whitened readings see them (by the prediction-error filter of R). Readings
before the episode are taken as known, where a random part is present; they can only lower V.
"""

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.special import ndtr

from .shapes import Shapes
from .spectrum import Random

FARTHEST = 12
"""Control periods of horizon for which a random part's covariances are kept beside its memory."""


def _solved(random: Random, noise: float, right: np.ndarray) -> np.ndarray:
    """R⁻¹·right by Levinson's recursion; R is Toeplitz because everything is stationary."""
    column = random.yy[: len(right)].copy()
    column[0] += noise**2
    found: np.ndarray = solve_toeplitz(column, right, check_finite=False)
    return found


def wiener(random: Random, noise: float, horizon: int) -> tuple[float, np.ndarray]:
    """Error variance of the best prediction of a random part, and its weights on the readings, newest first.

    Args:
        random: µm².
        noise: sigma of each reading, µm, above 0.
        horizon: control periods from the newest reading to what is predicted, 0 to :data:`FARTHEST`.
    """
    memory = len(random.yy) - FARTHEST
    r = random.xy[horizon : horizon + memory]
    weights = _solved(random, noise, r)
    return max(random.xx - float(r @ weights), 0.0), weights


def whitener(random: Random, noise: float) -> np.ndarray:
    """Prediction-error filter of the readings, divided by the sigma of its error, 1/µm; newest reading first."""
    memory = len(random.yy) - FARTHEST
    unit = np.zeros(memory)
    unit[0] = 1.0
    # R·a = σ²·e₀ makes a[0] = 1 (Yule–Walker).
    column = _solved(random, noise, unit)
    return column / np.sqrt(column[0])


def errors(
    random: Random, shapes: Shapes, noise: float, horizons: np.ndarray, at: np.ndarray
) -> np.ndarray:  # fmt: skip
    """Error variances V, µm², shape (horizons, at).

    Args:
        random: stationary part.
        shapes: of unknown size.
        noise: sigma of each reading, µm, above 0.
        horizons: control periods between newest reading and prediction, rising.
        at: control periods that are predicted, rising.
    """
    still = random.xx == 0.0
    if still:
        white = shapes.sensor / noise
    else:
        white = lfilter(whitener(random, noise), [1.0], shapes.sensor, axis=0)
    out = np.empty((len(horizons), len(at)))
    for i, horizon in enumerate(horizons):
        newest = np.asarray(at) - int(horizon)
        base, weights = (0.0, np.zeros(1)) if still else wiener(random, noise, int(horizon))
        out[i] = base
        if not len(shapes.variance):
            continue
        left = shapes.score[at]
        if not still:
            left = left - lfilter(weights, [1.0], shapes.sensor, axis=0)[newest]
        knowledge = _information(white, newest) + np.diag(1.0 / shapes.variance)
        # Scaled, because sizes have units of their own.
        scale = 1.0 / np.sqrt(np.einsum("nii->ni", knowledge))
        solved = np.linalg.solve(knowledge * scale[:, :, None] * scale[:, None, :], (left * scale)[:, :, None])
        out[i] += np.einsum("ni,ni->n", left * scale, solved[:, :, 0])
    return out


def _information(white: np.ndarray, newest: np.ndarray) -> np.ndarray:
    """Σ F̃ᵀF̃ over all readings up to each of ``newest``, shape (newest, shapes, shapes)."""
    total, before = np.zeros((white.shape[1], white.shape[1])), 0
    out = np.empty((len(newest), *total.shape))
    for i, last in enumerate(newest):
        part = white[before : last + 1]
        total = total + part.T @ part
        out[i], before = total, last + 1
    return out


def beyond(sigma: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """``E[max(|σZ| − r, 0)²]`` of a normal Z: what a correction of σ leaves that cannot be larger than ``reach``."""
    sigma = np.maximum(sigma, 1e-12)
    u = reach / sigma
    return np.asarray(2.0 * sigma**2 * ((1.0 + u**2) * ndtr(-u) - u * np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi)))


def held_back(variances: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Error variances when what was learnt late can only move the head so far.

    Between the readings up to n − h − k and those up to n − h the estimate of ``x(n)`` moves by a normal number of
    variance ``V_{h+k} − V_h``. The k commands that can answer move the head by ``reach[k−1]`` at most, to either side
    of where it would be anyway. So the error is at least ``V_h + E[max(|δ_k| − r_k, 0)²]`` for every k.

    Args:
        variances: of horizons h, h + 1, …, shape (1 + k, …), µm².
        reach: µm, of 1, 2, … k commands.
    """
    learnt = np.sqrt(np.maximum(variances[1:] - variances[0], 0.0))
    more = beyond(learnt, reach[: len(learnt)].reshape(-1, *[1] * (learnt.ndim - 1)))
    return np.asarray(variances[0] + more.max(axis=0, initial=0.0))
