"""Points whose coordinates are all the better the smaller: which are on the front, and how much they enclose."""

import numpy as np
from optuna._hypervolume import compute_hypervolume

METRICS = ("time", "dross", "roughness", "contour_rms")
"""What a front is of."""


def efficient(points: np.ndarray) -> list[int]:
    """Indices of the points, shape (n, d), that no other equals or betters in all coordinates; of equals the first.

    What is not finite is a failure and never on the front.
    """
    kept = []
    for i, mine in enumerate(points):
        if not np.isfinite(mine).all():
            continue
        others = (points <= mine).all(axis=1)
        beaten = others & (points < mine).any(axis=1)
        equal = others & ~beaten
        if not beaten.any() and np.flatnonzero(equal)[0] == i:
            kept.append(i)
    return kept


def hypervolume(points: np.ndarray, ideal: np.ndarray, reference: np.ndarray) -> float:
    """Share of the box from ``ideal`` to ``reference`` whose points some point of the front equals or betters."""
    scaled = (np.asarray(points, float) - ideal) / (reference - ideal)
    inside = scaled[np.isfinite(scaled).all(axis=1) & (scaled < 1.0).all(axis=1)]
    if not len(inside):
        return 0.0
    inside = np.maximum(inside, 0.0)
    inside = np.unique(inside[efficient(inside)], axis=0)
    return float(compute_hypervolume(inside, np.ones(inside.shape[1]), assume_pareto=True))
