"""Uniform cubic B-splines (Huang2024 eqs. 3–8, with the misprints of eq. 5 corrected).

A segment has four control points C0 … C3 and runs from ``(C0 + 4C1 + C2)/6`` to ``(C1 + 4C2 + C3)/6`` with the end
tangents ``(C2 − C0)/2`` and ``(C3 − C1)/2`` (eqs. 7 and 8); the next segment shares three of them.
"""

import numpy as np
import numpy.typing as npt

from ..engine.quantity import InvalidInput
from .curve import Points

MATRIX = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
"""Eq. 6: rows for 1, t, t², t³; columns for C0 … C3."""


def basis(t: npt.ArrayLike) -> Points:
    """N0 … N3 (eq. 5) at t ∈ [0, 1], shape (len(t), 4); they sum to 1."""
    t = np.atleast_1d(np.asarray(t, float))
    return np.stack([np.ones_like(t), t, t**2, t**3], axis=1) @ MATRIX


def sampled(control: Points, per_segment: int, closed: bool = False) -> Points:
    """Points on the curve of control points, ``per_segment`` on each segment and the last one's end.

    Args:
        control: shape (n, 2), at least 4, or 3 for a closed curve.
        per_segment: at least 1.
        closed: the control points go around.

    Raises:
        InvalidInput: too few control points.
    """
    c = np.asarray(control, float)
    least = 3 if closed else 4
    if len(c) < least:
        raise InvalidInput(f"{len(c)} control points; a cubic B-spline needs at least {least}")
    c = np.concatenate([c, c[:3]]) if closed else c
    n = basis(np.arange(per_segment) / per_segment)
    windows = np.stack([c[k : len(c) - 3 + k] for k in range(4)], axis=1)  # (segments, 4, 2)
    inner = np.einsum("tk,skd->std", n, windows).reshape(-1, 2)
    return np.concatenate([inner, (basis(1.0) @ windows[-1])])
