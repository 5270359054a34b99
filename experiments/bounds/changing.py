"""Prediction of a sheet of continuous spectrum at a feed that changes, so that nothing is stationary in time.

In space it still is. The sheet is cut into cells along the path; a reading is a mean over the cells under the plate,
the score one over those under the tip. All of the sheet more than :data:`SPAN` behind is given away, which can only
lower the error. What is still unknown of the cells after that is made of white noise by the causal factor of the
sheet's density, so its covariance is exact; the readings that touch these cells tell the rest.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_solve, cholesky, toeplitz

from ...envs.plant import sheet
from .lowering import Sight
from .ramps import share
from .spectrum import Surface

CELL = sheet.RANDOM_SPACING
"""mm, length of a cell: that of the samples of the machine's own sheets."""

SPAN = 60.0
"""mm behind the newest reading from which on the sheet is unknown."""


def weights(edges: np.ndarray, where: np.ndarray, radius: float) -> np.ndarray:
    """Of cells with these ``edges`` (mm) in what a footprint of ``radius`` mm has at each of ``where``, shape (where,
    cells)."""
    passed = share((where[:, None] - edges) / radius)
    return np.asarray(passed[:, :-1] - passed[:, 1:])


def errors(
    surface: Surface,
    size: float,
    sight: Sight,
    where: np.ndarray,
    horizons: Sequence[int],
    at: np.ndarray,
    scored: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Error variances V, µm², shape (horizons, at), and what lowering the head can save of each, µm², shape (at,).

    Args:
        surface: of RMS 1.
        size: µm, its RMS under the tip.
        sight: what a reading is worth.
        where: mm along the path at the end of each control period; the first is that of the first reading. All of the
            sheet before is given away.
        horizons: control periods from newest reading to prediction, rising.
        at: control periods that are predicted, as indices of ``where``, rising evenly.
        scored: the control period with which the score begins; readings before are of the least noise.
    """
    out, window = np.empty((len(horizons), len(at))), np.zeros(len(at))
    noise = np.where(np.arange(len(where)) < scored, sight.finest, sight.noise) / size
    sensitivity, apart = np.zeros(len(where)), int(np.diff(at).min(initial=len(where)))
    for j, n in enumerate(np.asarray(at).tolist()):
        newest = n - np.asarray(horizons)
        begin = max(where[max(newest[0], 0)] - SPAN, where[0] - surface.plate)
        ahead = max(where[max(newest[0], 0)] + surface.plate, where[n] + sheet.FOOTPRINT)
        edges = begin + CELL * np.arange(int(np.ceil((ahead - begin) / CELL)) + 2)
        news = np.tril(toeplitz(surface.news[: len(edges) - 1]))
        score = weights(edges, where[n : n + 1], sheet.FOOTPRINT)[0] @ news
        first = int(np.searchsorted(where, begin - surface.plate))
        # From the earliest news on, a few more readings each time.
        seen = slice(first, max(newest[0] + 1, first))
        read = (weights(edges, where[seen], surface.plate) @ news) / noise[seen, None]
        early = max(newest[-1] + 1, first) - first
        known = cholesky(np.eye(len(score)) + read[:early].T @ read[:early], lower=True, check_finite=False)
        late = np.vstack([score, read[early:]]).T
        whole = cho_solve((known, True), late, check_finite=False)
        both = late.T @ whole
        for i in range(len(horizons)):
            more = slice(1, 1 + max(newest[i] + 1 - first - early, 0))
            taken = np.linalg.solve(np.eye(more.stop - 1) + both[more, more], both[more, 0])
            out[i, j] = size**2 * max(both[0, 0] - both[0, more] @ taken, 0.0)
            if i == 0:
                told = read @ (whole[:, 0] - whole[:, more] @ taken)
        # Of the errors of all periods around this one; what readings before the score tell cannot be bettered.
        sensitivity[seen] += apart * size**2 * told**2
        window[j] = seen.stop - max(first, scored)
    counted = np.flatnonzero(np.arange(len(where)) >= max(scored, int(at[0]) - int(window[0])))
    gain = float(sight.gain(sensitivity[counted]).sum()) / max(len(counted), 1)
    deep = np.array([sight.pays(w, v) for w, v in zip(window, out[-1], strict=True)])
    return out, np.where(deep, out[0], gain)
