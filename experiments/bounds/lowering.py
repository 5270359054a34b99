"""What a controller can gain by lowering the head: near the sheet the sensor has much less noise.

Before the score begins that costs nothing. So every reading before it counts as one of the least noise that there is
(:func:`noise.finest`). Afterwards each reading at a gap of h − d costs d². Let r be its information over that of a
reading at the set height. Error variances are convex in the information of the readings (a posterior covariance is, and
the inequality of van Trees 1968 needs no more of a sensor that is not linear), so all readings together gain at most::

    Σ_k max_d [S_k·(r(d) − 1) − d²],    S_k = −Σ_n ∂V_n/∂ln I_k,    Σ_k −∂V_n/∂ln I_k ≤ V_n

A deep dip, beyond :data:`DEEP` of the set height, is left out of this maximum: it costs more than to be told the whole
sheet for as long as that is counted (:meth:`Sight.pays`).
"""

from dataclasses import dataclass

import numpy as np

DEEP = 0.5
"""Share of the set height."""

DIPS = 200
"""Depths that are tried."""


@dataclass(frozen=True)
class Sight:
    """What one machine's readings are worth.

    Attributes:
        noise: sigma of a reading at the set height, µm.
        finest: at the least gap that the sensor resolves, µm.
        depth: µm by which the head is lowered, rising from 0 to :data:`DEEP` of the set height, shape (n,).
        worth: information of a reading there over that of one at the set height, less 1, shape (n,).
    """

    noise: float
    finest: float
    depth: np.ndarray
    worth: np.ndarray

    def gain(self, sensitivity: np.ndarray) -> np.ndarray:
        """The most that a reading of each ``sensitivity`` S_k (µm², any shape) can gain, µm²."""
        s = np.asarray(sensitivity, float)
        return np.asarray((s[..., None] * self.worth - self.depth**2).max(axis=-1))

    def pays(self, lasting: float, variance: float) -> bool:
        """Whether a deep dip could pay that saved all of an error ``variance`` (µm²) for ``lasting`` periods."""
        return lasting * variance > float(self.depth[-1]) ** 2
