"""Which contour lies within which: what is a part's outline, what a hole, and what waits for what.

A sheet has thousands of contours, and a frame has all of them within it; so the pairs worth asking come from a tree of
their boxes, and of the contours around one only the nearest are kept.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..plant.path import SPACING
from . import geos as shapely
from .curve import Indices, Points, lengths

GAP = SPACING
"""mm by which a contour may reach beyond the one that it lies within."""

SLIGHT = 1e-9
"""Share of its squared length below which what a closed contour encloses is nothing: there and back along a line."""

THIN = 1e-4
"""The same share below which a closed contour is a thin slit, or one whose lobes make up for each other."""

_LEGS, _CROSSINGS, _LINES = 16, 4000, 512
"""Segments looked at together, meetings of them beyond which a contour is a scribble, and lines across one."""

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
    count = len(pieces)
    area = np.array([enclosed(p) if c else 0.0 for p, c in zip(pieces, closed, strict=True)])
    around: list[list[int]] = [[] for _ in range(count)]
    depth = np.zeros(count, np.int64)
    solid = np.flatnonzero(area)
    if not len(solid):
        return Nesting(around, depth, area)
    outlines = np.full(count, None, object)
    outlines[solid] = [shapely.polygons(pieces[i]) for i in solid]
    shapely.prepare(outlines)
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
        which, outer = which[boxed], outer[boxed]
        rising = np.lexsort((rank[outer], which))
        which, outer = which[rising], outer[rising]
        first = np.flatnonzero(np.diff(which, prepend=-1))
        asked = [probes(pieces[i]) for i in block[which[first]].tolist()]
        every = np.split(outer, first[1:])
        for i, points, near, held in zip(
            block[which[first]].tolist(), asked, every, _hold(outlines[outer[first]], asked), strict=False
        ):
            around[i], depth[i] = _around(points, near, bool(held), outlines, around, depth)
    return Nesting(around, depth, area)


def _hold(outlines: npt.NDArray[np.object_], points: list[Points]) -> npt.NDArray[np.bool_]:
    """Whether each outline holds most of its points."""
    if not points:
        return np.zeros(0, bool)
    sizes = np.array([len(p) for p in points])
    inside = shapely.contains_xy(np.repeat(outlines, sizes), *np.concatenate(points).T)
    held = np.add.reduceat(inside.astype(np.int64), np.cumsum(sizes) - sizes)
    return np.asarray(held / sizes > 0.5)


def _around(
    points: Points,
    near: Indices,
    held: bool,
    outlines: npt.NDArray[np.object_],
    around: list[list[int]],
    depth: Indices,
) -> tuple[list[int], int]:
    """Of the contours ``near``, the smallest first, those next around ``points``, and how many are around them in all;
    ``held``: whether the smallest is."""
    smallest = int(near[0])
    if held and depth[smallest] + 1 == len(near):
        return [smallest], len(near)  # all others are around that one
    next_ones: list[int] = []
    known: set[int] = set()
    for j in near.tolist():
        if j not in known and (held if j == smallest else bool(shapely.contains_xy(outlines[j], points).mean() > 0.5)):
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
    area, way = around_it(points)
    return area if abs(area) > SLIGHT * way * way else 0.0


def enclosed(points: Points) -> float:
    """The same by the even-odd rule, where a polyline that crosses itself may enclose more than the difference of what
    it goes around one way and the other."""
    area, way = around_it(points)
    if abs(area) > THIN * way * way:
        return area
    both = even_odd(points) if len(points) > 4 else abs(area)  # of three corners none is a lobe
    return float(np.copysign(both, area)) if both > SLIGHT * way * way else 0.0


def around_it(points: Points) -> tuple[float, float]:
    """mm² that a closed polyline goes around, counter-clockwise less clockwise, and its length, mm."""
    x, y = (points - points[0]).T
    return float(x[:-1] @ y[1:] - x[1:] @ y[:-1]) / 2.0, float(lengths(points).sum())


def even_odd(points: Points) -> float:
    """mm² of all lobes of a closed polyline; of a scribble that crosses itself thousands of times about so many."""
    if len(points) <= 3:
        return 0.0
    return _scanned(points) if _is_scribble(points) else float(shapely.make_valid(shapely.polygons(points)).area)


def _is_scribble(points: Points) -> bool:
    """Whether a polyline crosses itself so often that to take its lobes apart would take minutes."""
    legs = shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1))
    tree, met = shapely.STRtree(legs), 0
    for at in range(0, len(legs), _LEGS):
        met += tree.query(legs[at : at + _LEGS], predicate="intersects").shape[1]
        if met > 3 * len(legs) + _CROSSINGS:  # itself and its neighbours meet every leg
            return True
    return False


def _scanned(points: Points) -> float:
    """mm² by the even-odd rule, from what lies within on :data:`_LINES` lines across."""
    (x0, y0), (x1, y1) = points[:-1].T, points[1:].T
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    step = (high - low) / _LINES
    total = 0.0
    for y in (low + step * (np.arange(_LINES) + 0.5)).tolist():
        cut = (y0 <= y) != (y1 <= y)
        x = np.sort(x0[cut] + (y - y0[cut]) / (y1[cut] - y0[cut]) * (x1[cut] - x0[cut]))
        total += float((x[1::2] - x[::2]).sum())
    return total * step


def probes(points: Points) -> Points:
    """Up to 9 points on a polyline, in the middle of its segments: corners may touch what is around them."""
    middles = 0.5 * (points[1:] + points[:-1])
    return middles[:: -(-len(middles) // 9)]
