"""Prediction of a sheet of continuous spectrum at a feed that changes, so that nothing is stationary in time.

In space it still is. The sheet is cut into cells along the path, of which each is predicted from those before
(autoregression), and a reading is a mean over the cells under the plate, the score one over those under the tip. So a
Kalman filter tells how well both are known, wherever the readings were taken; what it remembers are the cells that the
plate can touch. Its covariance does not depend on what is read.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_toeplitz, toeplitz

from ...envs.plant import sheet
from .ramps import share
from .spectrum import Surface

CELL = sheet.RANDOM_SPACING
"""mm, length of a cell: that of the samples of the machine's own sheets."""


class Cells:
    """What is known of the cells around the nozzle, for a sheet of RMS 1.

    Args:
        surface: the ensemble.
        front: mm along the path that the newest cell must reach at least.
        told: whether the sheet until here is known; otherwise nothing is.
    """

    def __init__(self, surface: Surface, front: float, told: bool = False) -> None:
        self.many = int(np.ceil(2.0 * surface.plate / CELL)) + 3
        r = surface.bare[: self.many + 1]
        self._from = solve_toeplitz(r[:-1], r[1:])  # Yule–Walker
        self._new = float(r[0] - self._from @ r[1:])
        self._newest = int(np.ceil(front / CELL))
        self.known = np.zeros((self.many, self.many)) if told else toeplitz(r[:-1])

    def copy(self) -> "Cells":
        """Another that goes on by itself."""
        other: Cells = object.__new__(Cells)
        other.__dict__.update(self.__dict__, known=self.known.copy())
        return other

    def reach(self, front: float) -> None:
        """New cells until ``front`` (mm); the oldest are forgotten."""
        while self._newest < front / CELL:
            new, self._newest = np.empty_like(self.known), self._newest + 1
            across = self._from @ self.known
            new[1:, 1:], new[0, 0] = self.known[:-1, :-1], across @ self._from + self._new
            new[0, 1:] = new[1:, 0] = across[:-1]
            self.known = new

    def weights(self, where: float, radius: float) -> np.ndarray:
        """Of the cells in what a footprint of ``radius`` mm has at the distance ``where``, newest first."""
        edges = (self._newest - np.arange(self.many + 1) + 0.5) * CELL - where
        passed = share(edges / radius)
        return passed[:-1] - passed[1:]

    def read(self, where: float, plate: float, variance: float) -> None:
        """A reading at the distance ``where``, of the noise ``variance``."""
        w = self.weights(where, plate)
        told = self.known @ w
        self.known -= np.outer(told, told / (w @ told + variance))

    def left(self, where: float) -> float:
        """Variance of the score's sheet at ``where``."""
        self.reach(where + sheet.FOOTPRINT)
        w = self.weights(where, sheet.FOOTPRINT)
        return float(w @ self.known @ w)


def errors(
    surface: Surface, size: float, noise: float, where: np.ndarray, horizons: Sequence[int], at: np.ndarray,
    told: bool = False,
) -> np.ndarray:  # fmt: skip
    """Error variances V, µm², shape (horizons, at).

    Args:
        surface: of RMS 1.
        size: µm, its RMS under the tip.
        noise: sigma of a reading, µm.
        where: mm along the path at the end of each control period; the first is that of the first reading.
        horizons: control periods from newest reading to prediction.
        at: control periods that are predicted, as indices of ``where``.
        told: whether all of the sheet before is known.
    """
    cells, variance = Cells(surface, where[0] + surface.plate, told), (noise / size) ** 2
    wanted: dict[int, list[tuple[int, int]]] = {}
    for i, horizon in enumerate(horizons):
        for j, n in enumerate(np.asarray(at).tolist()):
            wanted.setdefault(n - int(horizon), []).append((i, j))
    out = np.empty((len(horizons), len(at)))
    for n in range(max(wanted) + 1):
        cells.reach(where[n] + surface.plate)
        cells.read(where[n], surface.plate, variance)
        for i, j in wanted.get(n, ()):
            out[i, j] = size**2 * cells.copy().left(where[at[j]])
    return out
