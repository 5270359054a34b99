"""In which order contours are cut: what lies within before what is around it, and else the short way.

What has been cut loose may tip or shift: a hole must be cut while its part still hangs in the sheet. Of the contours
that may come next the nearest is taken, and then the order is improved (:mod:`.tour`).
"""

import numpy as np

from .curve import Curve, Indices, Points
from .nesting import nested
from .tour import improved

_NEAR = 24
"""Ends that are looked at first; only if all of these are cut or must wait, all are."""

_THIN = 0.8
"""Share of contours left at which those that are cut are taken out of the tables."""


def ordered(contours: list[Curve], shorten: bool = True) -> list[Curve]:
    """Each contour after all that it contains, on a short way from the origin; open ones from the better end.

    Args:
        contours: closed or open.
        shorten: improve the order in which each is the nearest to the one before.
    """
    if not contours:
        return []
    around = nested([c.points for c in contours], [c.closed for c in contours]).around
    ends = np.array([[c.points[0], c.points[-1]] for c in contours])
    order, turned = nearest(ends, around)
    if shorten:
        order, turned = improved(order, turned, ends, around)
    return [contours[i].reversed() if t else contours[i] for i, t in zip(order.tolist(), turned.tolist(), strict=True)]


def nearest(ends: Points, around: list[list[int]]) -> tuple[Indices, Indices]:
    """Always the nearest of those that may come next, from the origin on; of two as near the first.

    Args:
        ends: first and last point of each contour, shape (n, 2, 2), mm.
        around: for each the contours that must come after it.

    Returns:
        the contours in order, and for each whether it is travelled backwards, 0 or 1.
    """
    from scipy.spatial import KDTree  # slow, as the readers of files are

    waits_for = np.zeros(len(ends), np.int64)
    for outer in around:
        waits_for[outer] += 1
    gone, here = np.zeros(len(ends), bool), np.zeros(2)
    order: list[int] = []
    turned: list[int] = []
    left, tree = np.zeros(0, np.int64), None
    while len(order) < len(ends):
        if tree is None or len(ends) - len(order) < _THIN * len(left):
            left = np.flatnonzero(~gone)
            tree = KDTree(ends[left].reshape(-1, 2))
        close = np.unique(left[tree.query(here, min(_NEAR, 2 * len(left)))[1] // 2])
        free = close[~gone[close] & (waits_for[close] == 0)]
        if not len(free):
            free = left[~gone[left] & (waits_for[left] == 0)]
        to_ends = np.hypot(*np.moveaxis(ends[free] - here, -1, 0))
        at = int(to_ends.min(axis=1).argmin())
        order.append(int(free[at]))
        turned.append(int(to_ends[at, 1] < to_ends[at, 0]))
        here = ends[order[-1], 1 - turned[-1]]
        gone[order[-1]] = True
        waits_for[around[order[-1]]] -= 1
    return np.array(order), np.array(turned)
