"""Crossings: contours that cut into each other or into themselves, and those that lie on one another for a stretch.

What is a part and what is scrap is then not what the drawing says, or something is cut twice; a user must be told
where. Only runs of contours whose boxes meet are looked at.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import geos as shapely
from .curve import Indices, Points, way_along
from .joining import GAP
from .overlaps import NEAR
from .pieces import short_runs

LONG = 4.0
"""Times :data:`.overlaps.NEAR` at which a stretch is measured again: curves that only touch are near each other over
twice the length then, those that lie on one another over the same."""

GROWTH = 1.5
"""Most of that growth."""

SHORTEST = 2.0 * GAP
"""mm, of a stretch, and of the loop of a contour that crosses itself."""

MOST = 300_000
"""Pairs of runs whose boxes meet; a drawing that has more is not looked through to its end."""

MOST_NEAR = 20_000
"""Pairs of runs that come near each other; the same."""

MOST_POINTS = 200_000
"""Points of contours that meet and may cross, counted for each pair; the same."""

MOST_HITS = 1000
"""Legs of one contour that meet, of which the first place is looked for."""

BLOCK, RUN_OF_LEGS = 128, 16
"""Runs, and segments of one contour, that are looked at together."""


@dataclass(frozen=True)
class Meeting:
    """Contours ``first`` and ``second``, indices, meet at x and y, mm; the same twice: it crosses itself.

    ``along``: mm over which they lie on one another; 0: they cross.
    """

    first: int
    second: int
    x: float
    y: float
    along: float = 0.0


@dataclass(frozen=True)
class Meetings:
    """Where contours meet; ``cut_short``: there are too many to look for all."""

    found: tuple[Meeting, ...] = ()
    cut_short: bool = False


def meetings(pieces: Sequence[Points], closed: Sequence[bool]) -> Meetings:
    """All contours that cross themselves, that cross others, of which one is closed, or that lie on others.

    Open contours may cross one another: nothing lies within them.

    Args:
        pieces: arrays of shape (n, 2), mm.
        closed: whether each ends in its first point.
    """
    runs, owners = short_runs(pieces)
    pairs, cut_short = _near(runs, owners)
    crossing, stopped = _crossing(runs, owners, pairs, pieces, closed)
    found = [*_with_themselves(pieces, closed), *crossing, *_stretches(runs, owners, pairs)]
    return Meetings(tuple(found), cut_short or stopped)


def _near(runs: npt.NDArray[np.object_], owners: Indices) -> tuple[npt.NDArray[np.int64], bool]:
    """Pairs of runs of different contours that come near each other, shape (n, 2), and whether that are not all."""
    reach = LONG * NEAR
    tree = shapely.STRtree(runs)
    low, high = np.split(shapely.bounds(runs), 2, axis=1)
    boxes = shapely.box(*(low - reach).T, *(high + reach).T)
    found, looked, count = [np.zeros((0, 2), np.int64)], 0, 0
    for at in range(0, len(runs), BLOCK):
        which, other = tree.query(boxes[at : at + BLOCK])
        which += at
        apart = owners[which] < owners[other]
        which, other = (q[apart][: MOST - looked] for q in (which, other))
        near = shapely.dwithin(runs[which], runs[other], reach)
        found.append(np.column_stack([which[near], other[near]]))
        looked, count = looked + len(which), count + int(near.sum())
        if looked >= MOST or count > MOST_NEAR:
            return np.concatenate(found)[:MOST_NEAR], True
    return np.concatenate(found), False


def _stretches(runs: npt.NDArray[np.object_], owners: Indices, pairs: npt.NDArray[np.int64]) -> list[Meeting]:
    """Contours that lie on one another; the place is the middle of the longest stretch within a run."""
    if not len(pairs):
        return []
    one, other = runs[pairs[:, 0]], runs[pairs[:, 1]]
    near = shapely.intersection(one, shapely.buffer(other, NEAR, quad_segs=4))
    short, long = (
        shapely.length(near),
        shapely.length(shapely.intersection(one, shapely.buffer(other, LONG * NEAR, quad_segs=4))),
    )
    contours, which = np.unique(owners[pairs], axis=0, return_inverse=True)
    which = which.ravel()
    length = np.bincount(which, short)
    lying = (length > SHORTEST) & (np.bincount(which, long) <= GROWTH * length)
    found = []
    for k in np.flatnonzero(lying).tolist():
        mine = np.flatnonzero(which == k)
        x, y = _middle(near[mine[short[mine].argmax()]])
        # At the ends of runs they lie on two; and what is near reaches beyond the stretch at either end.
        along = shapely.union_all(near[mine]).length - 2.0 * NEAR
        found.append(Meeting(int(contours[k, 0]), int(contours[k, 1]), x, y, float(along)))
    return found


def _middle(line: object) -> tuple[float, float]:
    """Halfway along the longest part of what an intersection left."""
    parts = shapely.get_parts(line)
    point = shapely.line_interpolate_point(parts[shapely.length(parts).argmax()], 0.5, normalized=True)
    return float(point.x), float(point.y)


def _crossing(
    runs: npt.NDArray[np.object_],
    owners: Indices,
    pairs: npt.NDArray[np.int64],
    pieces: Sequence[Points],
    closed: Sequence[bool],
) -> tuple[list[Meeting], bool]:
    """Contours that reach farther than :data:`.overlaps.NEAR` to both sides of a closed one, and whether it was given
    up to look for all."""
    shut = np.array(closed, bool)
    pairs = pairs[shut[owners[pairs]].any(axis=1)] if len(pairs) else pairs
    meet = shapely.intersects(runs[pairs[:, 0]], runs[pairs[:, 1]])
    found: list[Meeting] = []
    points = 0
    for a, b in np.unique(owners[pairs[meet]], axis=0).tolist():
        points += len(pieces[a]) + len(pieces[b])
        if points > MOST_POINTS:
            return found, True
        line, around = (a, b) if shut[b] else (b, a)
        if (place := _through(pieces[line], pieces[around])) is not None:
            found.append(Meeting(a, b, *place))
    return found, False


def _through(line: Points, ring: Points) -> tuple[float, float] | None:
    """Where a line crosses a ring; None if it stays within :data:`.overlaps.NEAR` of the one side."""
    path, edge = shapely.LineString(line), shapely.LineString(ring)
    places = shapely.points(shapely.get_coordinates(path.intersection(edge)))
    if not len(places):
        return None
    # From place to place it stays on one side; its vertices tell how far it goes there, and the middle between places.
    along = np.sort(np.concatenate([[0.0, path.length], shapely.line_locate_point(path, places)]))
    middles = shapely.get_coordinates(shapely.line_interpolate_point(path, 0.5 * (along[1:] + along[:-1])))
    asked = np.concatenate([line, middles])
    shapely.prepare(edge)
    asked = asked[~shapely.dwithin(edge, shapely.points(asked), NEAR)]
    inside = shapely.contains_xy(shapely.Polygon(ring), asked)
    if inside.all() or not inside.any():
        return None
    place = places[shapely.distance(places, shapely.MultiPoint(asked[inside])).argmin()]
    return float(place.x), float(place.y)


def _with_themselves(pieces: Sequence[Points], closed: Sequence[bool]) -> list[Meeting]:
    """Closed contours that cross themselves, or touch themselves in a point, each with one place."""
    shut = [i for i, c in enumerate(closed) if c]
    rings = [shapely.linestrings(pieces[i]) for i in shut]
    found = []
    for k in np.flatnonzero(~shapely.is_simple(rings)).tolist() if rings else []:
        if (place := _own_crossing(pieces[shut[k]])) is not None:
            found.append(Meeting(shut[k], shut[k], *place))
    return found


def _own_crossing(ring: Points) -> tuple[float, float] | None:
    """Where a closed polyline first meets itself after more than :data:`SHORTEST` on either way round."""
    legs = np.stack([ring[:-1], ring[1:]], axis=1)
    way = way_along(ring)
    lines = shapely.linestrings(legs)
    tree = shapely.STRtree(lines)
    for at in range(0, len(lines), RUN_OF_LEGS):
        one, other = tree.query(lines[at : at + RUN_OF_LEGS], predicate="intersects")
        one += at
        one, other = (q[one < other - 1][:MOST_HITS] for q in (one, other))
        hits = shapely.intersection(lines[one], lines[other])
        for i, j, hit in zip(one.tolist(), other.tolist(), hits, strict=True):
            point = shapely.get_coordinates(hit)[0]
            loop = way[j] - way[i] + np.hypot(*(point - ring[j])) - np.hypot(*(point - ring[i]))
            if min(loop, way[-1] - loop) > SHORTEST:
                return float(point[0]), float(point[1])
    return None
