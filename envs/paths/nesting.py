"""Which contour lies within which: what is a part's outline, what a hole, and what waits for what.

A sheet has thousands of contours, and a frame has all of them within it; so the pairs worth asking come from a tree of
their boxes, and of the contours around one only the nearest are kept.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..plant.path import SPACING
from .curve import Indices, Points

GAP = SPACING
"""mm by which a contour may reach beyond the one that it lies within."""

SLIGHT = 1e-9
"""Share of its squared length below which what a closed contour encloses is nothing: there and back along a line."""

THIN = 1e-4
"""The same share below which a closed contour is a thin slit, or one whose lobes make up for each other."""

_BLOCK = 256
"""Contours whose boxes are looked up at a time; all at once would fill the memory on a sheet of rings in rings."""


@dataclass(frozen=True)
class Nesting:
    """How contours lie within each other; what one encloses that crosses itself follows the even-odd rule.

    ``around[i]``: the contours next around contour i, the smallest first; mostly none or one. ``depth[i]``: how many
    are around it in all. ``area[i]``: mm² that it encloses, positive if it runs counter-clockwise; 0 if it is open or
    goes there and back.
    """

    around: list[list[int]]
    depth: Indices
    area: npt.NDArray[np.float64]

    @cached_property
    def hole(self) -> npt.NDArray[np.bool_]:
        """Whether a contour is a hole: within an odd number of others."""
        return self.depth % 2 == 1


def nested(pieces: list[Points], closed: list[bool]) -> Nesting:
    """How the contours ``pieces`` lie within each other; by most of their points, not by all.

    Args:
        pieces: arrays of shape (n, 2), mm.
        closed: whether each ends in its first point; open ones have nothing within them.
    """
    import shapely  # type: ignore[import-untyped]  # slow, as the readers of files are

    count = len(pieces)
    area = np.array([enclosed(p) if c else 0.0 for p, c in zip(pieces, closed, strict=True)])
    around: list[list[int]] = [[] for _ in range(count)]
    depth = np.zeros(count, np.int64)
    solid = np.flatnonzero(area)
    if not len(solid):
        return Nesting(around, depth, area)
    outlines = {int(i): shapely.polygons(pieces[i]) for i in solid}
    shapely.prepare(list(outlines.values()))
    first = np.cumsum([0, *map(len, pieces[:-1])])
    low, high = (f.reduceat(np.concatenate(pieces), first) for f in (np.minimum, np.maximum))
    boxes = shapely.box(*low.T, *high.T)
    tree = shapely.STRtree(shapely.box(*(low[solid] - GAP).T, *(high[solid] + GAP).T))
    size, rank = np.abs(area), np.zeros(count, np.int64)
    rank[np.argsort(size, kind="stable")] = np.arange(count)
    outside_in = np.argsort(-size, kind="stable")  # what is around a contour is known before the contour is asked for
    for block in np.array_split(outside_in, max(1, count // _BLOCK)):
        which, found = tree.query(boxes[block])
        inner, outer = block[which], solid[found]
        boxed = (low[inner] >= low[outer] - GAP).all(axis=1) & (high[inner] <= high[outer] + GAP).all(axis=1)
        boxed &= size[outer] > size[inner]
        each = np.split(outer[boxed], np.searchsorted(which[boxed], np.arange(1, len(block))))
        for i, near in zip(block.tolist(), each, strict=True):
            if len(near):
                around[i], depth[i] = _around(probes(pieces[i]), near, rank, outlines, around, depth)
    return Nesting(around, depth, area)


def _around(
    points: Points, near: Indices, rank: Indices, outlines: dict[int, Any], around: list[list[int]], depth: Indices
) -> tuple[list[int], int]:
    """Of the contours ``near`` those next around ``points``, the smallest first by ``rank``, and how many are around
    them in all."""
    import shapely

    def holds(j: int) -> bool:
        return bool(shapely.contains_xy(outlines[j], points).mean() > 0.5)

    smallest = int(near[rank[near].argmin()])
    if depth[smallest] + 1 == len(near) and holds(smallest):
        return [smallest], len(near)  # all others are around that one
    next_ones: list[int] = []
    known: set[int] = set()
    for j in near[np.argsort(rank[near])].tolist():
        if j not in known and holds(j):
            next_ones.append(j)
            front = [j]
            while front:
                k = front.pop()
                if k not in known:
                    known.add(k)
                    front += around[k]
    return next_ones, len(known)


def signed_area(points: Points) -> float:
    """mm² that a closed polyline encloses, positive if it runs counter-clockwise; 0 if it is next to nothing."""
    area, way = _around_it(points)
    return area if abs(area) > SLIGHT * way * way else 0.0


def enclosed(points: Points) -> float:
    """The same by the even-odd rule, where a polyline that crosses itself may enclose more than the difference of what
    it goes around one way and the other."""
    area, way = _around_it(points)
    if abs(area) > THIN * way * way:
        return area
    both = even_odd(points) if len(points) > 4 else abs(area)  # of three corners none is a lobe
    return float(np.copysign(both, area)) if both > SLIGHT * way * way else 0.0


def _around_it(points: Points) -> tuple[float, float]:
    """mm² that a closed polyline goes around, counter-clockwise less clockwise, and its length, mm."""
    x, y = (points - points[0]).T
    return float(x[:-1] @ y[1:] - x[1:] @ y[:-1]) / 2.0, float(np.hypot(*np.diff(points, axis=0).T).sum())


def even_odd(points: Points) -> float:
    """mm² of all lobes of a closed polyline."""
    import shapely

    return float(shapely.make_valid(shapely.polygons(points)).area) if len(points) > 3 else 0.0


def probes(points: Points) -> Points:
    """Up to 9 points on a polyline, in the middle of its segments: corners may touch what is around them."""
    middles = 0.5 * (points[1:] + points[:-1])
    return middles[:: -(-len(middles) // 9)]
