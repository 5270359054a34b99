"""How far two paths are from each other, in the order in which they are travelled."""

import math

import numpy as np

from .canonical import Complex

AHEAD = 0.05
"""mm along the path within which the place of a point is looked for, beside …"""

SHARE = 2e-4
"""… this share of the path's length: chords shorten arcs a little."""


def apart(ours: list[Complex], theirs: list[Complex]) -> float:
    """mm, the largest distance of a point of either from the same stretch of the other; inf for other pieces.

    Points are the vertices and the middles of segments of each piece.
    """
    if len(ours) != len(theirs):
        return math.inf
    return max((max(_off(a, b), _off(b, a)) for a, b in zip(ours, theirs, strict=True)), default=0.0)


def _off(points: Complex, path: Complex) -> float:
    """mm, the largest distance of ``points`` from the stretch of ``path`` where they should be."""
    probe = np.empty(2 * len(points) - 1, complex)
    probe[::2], probe[1::2] = points, 0.5 * (points[1:] + points[:-1])
    s, total = _way(probe)
    along, length = _way(path)
    if not total or not length:
        return float(abs(probe[0] - path[0]))
    reach = AHEAD / length + SHARE
    at, here = s / total, along / length
    first = np.clip(np.searchsorted(here, at - reach) - 1, 0, len(path) - 2)
    last = np.clip(np.searchsorted(here, at + reach), 1, len(path) - 1)
    best = np.full(len(probe), math.inf)
    for step in range(int((last - first).max())):
        i = np.minimum(first + step, last - 1)
        a, leg = path[i], path[i + 1] - path[i]
        size = np.abs(leg) ** 2
        part = np.clip(((probe - a) * leg.conj()).real / np.where(size > 0, size, 1.0), 0.0, 1.0)
        best = np.minimum(best, np.abs(probe - a - part * leg))
    ends = max(abs(points[0] - path[0]), abs(points[-1] - path[-1]))
    return float(max(best.max(), ends))


def _way(points: Complex) -> tuple[np.ndarray, float]:
    """The way to each point, mm, and all of it."""
    s = np.insert(np.cumsum(np.abs(np.diff(points))), 0, 0.0)
    return s, float(s[-1])
