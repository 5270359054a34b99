"""The least mean-square error with which the score's sheet can be known some control periods ahead.

What the score will meet is ``x(n) = z_x(n) + F_x(n)·θ``: a random part and shapes of unknown size θ. A controller that
knows where its head is has, from each reading, ``y(n) = z_y(n) + F_y(n)·θ + v(n)`` with white noise v. Everything is
Gaussian, so the best causal estimate is linear (Wiener 1949, Kalman 1960), and its error at n from readings up to n − h
is (in geostatistics, universal kriging)::

    V(n) = r_xx − rᵀR⁻¹r + g·(Λ + Σ F̃ᵀF̃)⁻¹·gᵀ,    g = F_x(n) − wᵀF_y,   w = R⁻¹r

R is the covariance of random part and noise in the readings, r that of the readings with ``z_x(n)``, Λ the inverse of
the sizes' variances, and F̃ the shapes as whitened readings see them (by the prediction-error filter of R). Readings
before the episode are taken as known, where a random part is present, without end; they can only lower V.
"""

from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_toeplitz, solve_triangular, toeplitz
from scipy.signal import oaconvolve
from scipy.special import ndtr

from . import spectrum
from .shapes import Shapes
from .spectrum import Random

FARTHEST = 12
"""Control periods of horizon for which a random part's covariances are kept beside its memory."""


def wiener(
    random: Random, noise: float, horizon: int, shapes: Shapes | None = None, prior: np.ndarray | None = None
) -> tuple[float, np.ndarray]:
    """Error variance of the best fixed prediction with finite memory, and its weights on the readings, newest first.

    R⁻¹r by Levinson's recursion (Levinson 1946); R is Toeplitz because the random part is stationary.

    Args:
        random: µm²; its number of lags but :data:`FARTHEST` is the memory.
        noise: sigma of each reading, µm, above 0.
        horizon: control periods from the newest reading to what is predicted, 0 to :data:`FARTHEST`.
        shapes: over the horizon; their row k is for what lies k control periods before what is predicted.
        prior: covariance of the shapes' sizes; without it they are independent, of their variances.
    """
    memory = len(random.yy) - FARTHEST
    column, r = random.yy[:memory].copy(), random.xy[horizon : horizon + memory]
    column[0] += noise**2
    weights: np.ndarray
    if shapes is None or not len(shapes.variance):
        weights = solve_toeplitz(column, r, check_finite=False)
        return max(random.xx - float(r @ weights), 0.0), weights
    felt, score = shapes.sensor[horizon : horizon + memory], shapes.score[0]
    solved = solve_toeplitz(column, np.column_stack([r, felt]), check_finite=False)
    weights, through = solved[:, 0], solved[:, 1:]
    left = score - felt.T @ weights
    prior = np.diag(shapes.variance) if prior is None else prior
    # Sizes ``root·u`` with u of variance 1, so that a prior may be singular.
    values, vectors = np.linalg.eigh(prior)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    knowledge = np.eye(len(prior)) + root.T @ (felt.T @ through) @ root
    towards = np.linalg.solve(knowledge, root.T @ left)
    variance = random.xx - float(r @ weights) + float(root.T @ left @ towards)
    return max(variance, 0.0), weights + through @ root @ towards


class Endless:
    """The same with all readings there have ever been: Wiener's filter by spectral factorisation.

    The density of the readings is |H|², with H causal and its inverse too (the cepstrum's causal half); then the
    readings are white noise of variance 1 behind H. With γ_j the covariance of ``z_x(n)`` with that noise j periods
    before, ``V_h = r_xx − Σ_{j≥h} γ_j²``.

    Args:
        random: µm²; its covariances must have faded at its last lag.
        noise: sigma of each reading, µm, above 0.
    """

    def __init__(self, random: Random, noise: float) -> None:
        self._size = 2 * (len(random.yy) - 1)
        density = np.maximum(np.fft.rfft(np.concatenate([random.yy, random.yy[-2:0:-1]])).real, 0.0) + noise**2
        self._whole = np.fft.rfft(spectrum.causal(density))
        # The score's sheet and the sensor's view are alike to either side, so their covariance is even.
        cross = np.fft.rfft(np.concatenate([random.xy, random.xy[-2:0:-1]])).real
        self._gamma = np.fft.irfft(cross / np.conj(self._whole), self._size)[: self._size // 2]
        self._variance = random.xx

    def variance(self, horizon: int) -> float:
        """V of a horizon, µm²."""
        return float(max(self._variance - np.sum(self._gamma[horizon:] ** 2), 0.0))

    def weights(self, horizon: int) -> np.ndarray:
        """On the readings, newest first."""
        late = self._gamma[horizon:]
        return np.asarray(np.fft.irfft(np.fft.rfft(late, self._size) / self._whole, self._size)[: self._size // 2])

    @cached_property
    def whitener(self) -> np.ndarray:
        """Weights on the readings, newest first, that make white noise of variance 1 of them, 1/µm."""
        return np.asarray(np.fft.irfft(1.0 / self._whole, self._size)[: self._size // 2])

    @cached_property
    def shaper(self) -> np.ndarray:
        """H: weights on that white noise, newest first, that make the readings of it, µm."""
        return np.asarray(np.fft.irfft(self._whole, self._size)[: self._size // 2])

    def shared(self, first: int, many: int) -> np.ndarray:
        """γ_first and those after it, µm."""
        return self._gamma[first : first + many]


class Told:
    """The same if all readings until some moment, and endlessly before, have another, lower noise.

    Behind H of that lower noise they are white noise w. What later readings have of w from before the moment is known;
    their rest is ``B·w`` with B the lower triangular Toeplitz matrix of H's weights, and noise of the variance that is
    missing. The longer ago the moment, the larger V, since everything is stationary.

    Args:
        random: µm²; its covariances must have faded at its last lag.
        noise: sigma of each reading since, µm.
        before: sigma of each reading until then, µm, above 0, at most ``noise``.
        most: readings since then for which V may be asked.
    """

    def __init__(self, random: Random, noise: float, before: float, most: int) -> None:
        self._past = Endless(random, before)
        self._most = most
        self._news = np.tril(toeplitz(self._past.shaper[:most]))
        read = self._news @ self._news.T
        read[np.diag_indices(most)] += max(noise**2 - before**2, 0.0)
        self._root = cholesky(read, lower=True, overwrite_a=True, check_finite=False)

    def variance(self, horizon: int, since: int) -> float:
        """V of a horizon when the newest reading is the last of ``since``, 0 to ``most``, after the moment, µm²."""
        told = self._past.variance(horizon + since)
        if since == 0:
            return told
        cross = self._news[:since, :since] @ self._past.shared(horizon, since)[::-1]
        learnt = solve_triangular(self._root[:since, :since], cross, lower=True, check_finite=False)
        return float(max(told - learnt @ learnt, 0.0))


def _through(weights: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Columns over the control periods behind a filter."""
    return np.asarray(oaconvolve(columns, weights[: len(columns), None], axes=0)[: len(columns)])


def errors(random: Random, shapes: Shapes, noise: float, horizons: np.ndarray, at: np.ndarray) -> np.ndarray:
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
        endless = Endless(random, noise)
        white = _through(endless.whitener, shapes.sensor) if len(shapes.variance) else shapes.sensor
    out = np.empty((len(horizons), len(at)))
    for i, horizon in enumerate(horizons):
        newest = np.asarray(at) - int(horizon)
        out[i] = 0.0 if still else endless.variance(int(horizon))
        if not len(shapes.variance):
            continue
        left = shapes.score[at]
        if not still:
            left = left - _through(endless.weights(int(horizon)), shapes.sensor)[newest]
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
