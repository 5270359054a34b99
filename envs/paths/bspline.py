"""Uniform cubic B-splines (Huang2024 eqs. 3–8, with the misprints of eq. 5 corrected).

A segment has four control points C0 … C3 and runs from ``(C0 + 4C1 + C2)/6`` to ``(C1 + 4C2 + C3)/6`` with the end
tangents ``(C2 − C0)/2`` and ``(C3 − C1)/2`` (eqs. 7 and 8); the next segment shares three of them.
"""

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import splu

from ..engine.quantity import InvalidInput

Points = npt.NDArray[np.float64]

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


def through(points: Points, closed: bool = False) -> Points:
    """Control points of the curve that passes ``points`` where its segments meet.

    An open curve ends without curvature (C0 − 2C1 + C2 = 0).

    Raises:
        InvalidInput: fewer than 2 points, or 3 for a closed curve, or two that follow one another are the same.
    """
    p = np.asarray(points, float)
    least = 3 if closed else 2
    if len(p) < least:
        raise InvalidInput(f"{len(p)} points; at least {least}")
    gaps = np.hypot(*np.diff(np.concatenate([p, p[:1]]) if closed else p, axis=0).T)
    if (gaps < 1e-9).any():
        raise InvalidInput(f"points {np.argmin(gaps) + 1} and {np.argmin(gaps) + 2} are the same")
    n = len(p)
    if closed:
        # Segment k starts at (C_k + 4C_{k+1} + C_{k+2})/6.
        rows = sparse.diags_array([1.0, 4.0, 1.0, 1.0, 1.0], offsets=[0, 1, 2, 1 - n, 2 - n], shape=(n, n)).tolil()
        rows[n - 1, 0] = 4.0
        return splu(sparse.csc_matrix(rows) / 6.0).solve(p)
    rows = sparse.diags_array([1.0, 4.0, 1.0], offsets=[0, 1, 2], shape=(n, n + 2)).tolil() / 6.0
    ends = sparse.lil_matrix((2, n + 2))
    ends[0, :3], ends[1, -3:] = [1.0, -2.0, 1.0], [1.0, -2.0, 1.0]
    whole = sparse.csc_matrix(sparse.vstack([rows, ends]))
    return splu(whole).solve(np.concatenate([p, np.zeros((2, 2))]))


def fit(points: Points, tolerance: float, closed: bool = False) -> Points:
    """Control points of a curve that stays within ``tolerance`` mm of densely given points: as few as hold it.

    Least squares over the way along the points; the number of segments is doubled, then halved in between.

    Raises:
        InvalidInput: fewer than 4 points, or no number of segments holds the tolerance.
    """
    p = np.asarray(points, float)
    if len(p) < 4:
        raise InvalidInput(f"{len(p)} points; a fit needs at least 4")
    if closed:
        p = np.concatenate([p, p[:1]])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(p, axis=0).T))])

    def attempt(segments: int) -> tuple[Points, float]:
        at = way / way[-1] * segments
        k = np.minimum(at.astype(int), segments - 1)
        n, count = basis(at - k), segments if closed else segments + 3
        columns = (k[:, None] + np.arange(4)) % count
        design = sparse.csr_matrix((n.ravel(), (np.repeat(np.arange(len(p)), 4), columns.ravel())), (len(p), count))
        control = np.linalg.lstsq(design.toarray(), p, rcond=None)[0]
        return control, float(np.hypot(*(design @ control - p).T).max())

    low, high = 0, 3 if closed else 1
    control, error = attempt(high)
    while error > tolerance:
        low, high = high, 2 * high
        if high > len(p):
            raise InvalidInput(
                f"no B-spline through {len(p)} points stays within {tolerance:g} mm; the best misses {error:g}"
            )
        control, error = attempt(high)
    while high - low > 1:
        middle = (low + high) // 2
        between, error = attempt(middle)
        if error <= tolerance:
            control, high = between, middle
        else:
            low = middle
    return control
