"""Cleaning: what a drawing has twice is cut once.

Lines that lie on one another become one; what of a line lies on a polyline goes; two closed contours that are the same,
wherever they begin, are one; a closed contour without area is a line there and back and becomes a line. Arcs that lie
on other curves are those of :mod:`.overlaps`. Two outlines that share an edge stay as they are: each part needs its
own.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from . import geos as shapely
from .curve import Curve, line
from .joining import together
from .nesting import even_odd

ON = 1e-3
"""mm, the largest distance of lines that lie on one another."""

SAME = 0.01
"""mm, the largest distance of two closed contours that are the same."""

BINS = 3000
"""Ranges of directions of which the lines are looked at together."""

MOST_PAIRS = 2_000_000
"""Of lines that lie on one another; a drawing that has more is not cleaned."""

CHUNK = 200

Legs = npt.NDArray[np.float64]
"""Straight pieces, shape (n, 2, 2): from point to point, mm."""


class TooMany(Exception):
    """More things lie on one another than a drawing can be meant to have."""


@dataclass(frozen=True)
class Cleaned:
    """What cleaning did: straight lines that lay on others, other open curves that did (:mod:`.overlaps`), contours
    that were there twice or had no area, and the mm that are not cut for it."""

    overlapping: int = 0
    curves: int = 0
    doubled: int = 0
    flat: int = 0
    length: float = 0.0


# Lines, before they are joined


def without_overlaps(curves: list[Curve]) -> tuple[list[Curve], Cleaned]:
    """The curves of a drawing, with lines that lie on one another made one; they keep a vertex where one ended.

    Raises:
        TooMany: beyond :data:`MOST_PAIRS`.
    """
    legs, owners = _legs(curves)
    alone = np.array([len(c.points) == 2 for c in curves], bool)
    if len(legs) < 2:
        return curves, Cleaned()
    groups = [np.array(g) for g in _groups(_touching(legs, owners), len(legs))]
    gone, new, count, length = set(), [], 0, 0.0
    for group in groups:
        mine, others = group[alone[owners[group]]], group[~alone[owners[group]]]
        if not len(mine) or _bent(legs[group]):
            continue
        pieces = _union(legs[mine], legs[others])
        saved = _length(legs[mine]) - sum(c.length for c in pieces)
        if saved > ON:
            gone |= set(owners[mine].tolist())
            new += pieces
            count, length = count + max(1, len(mine) - len(pieces)), length + saved
    kept = [c for i, c in enumerate(curves) if i not in gone]
    return kept + new, Cleaned(overlapping=count, length=length)


def _legs(curves: list[Curve]) -> tuple[Legs, npt.NDArray[np.int64]]:
    """Every straight piece of lines and polylines, and which curve it is of; the chords of smooth curves are none."""
    sizes = np.array([len(c.points) for c in curves], np.int64)
    first = np.cumsum(sizes) - sizes
    sharp = np.zeros(int(sizes.sum()), bool)
    sharp[first[sizes > 0]] = sharp[(first + sizes - 1)[sizes > 0]] = True
    for begin, curve in zip(first.tolist(), curves, strict=True):
        if len(curve.corners):
            sharp[begin + curve.corners] = True
    points = np.concatenate([np.zeros((0, 2)), *(c.points for c in curves)])
    owners = np.repeat(np.arange(len(curves)), sizes)
    # A leg next to a smooth vertex may be a chord.
    straight = np.flatnonzero(sharp[:-1] & sharp[1:] & (owners[:-1] == owners[1:]))
    return np.stack([points[straight], points[straight + 1]], axis=1), owners[straight]


def _touching(legs: Legs, owners: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Pairs of parallel legs of different curves, shape (n, 2), of which an end of the one lies on the other.

    Of two pieces of one line that overlap, an end of the one always lies on the other; so does all of the shorter.
    """
    way = legs[:, 1] - legs[:, 0]
    size, angle = np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0]) % np.pi
    found, looked = [np.zeros((0, 2), np.int64)], 0
    for which, direction in _parallel(angle):
        # Turned so that they lie along x, their boxes are thin and few of them meet.
        turn = np.array([[np.cos(direction), -np.sin(direction)], [np.sin(direction), np.cos(direction)]])
        turned = legs[which] @ turn
        tree = shapely.STRtree(shapely.linestrings(turned))
        ends = turned.reshape(-1, 2)
        for first in range(0, len(ends), CHUNK):
            asked, hit = tree.query(shapely.points(ends[first : first + CHUNK]), predicate="dwithin", distance=ON)
            i, j = which[(asked + first) // 2], which[hit]
            off = np.abs((angle[i] - angle[j] + np.pi / 2) % np.pi - np.pi / 2)
            same = (owners[i] != owners[j]) & (off * np.minimum(size[i], size[j]) <= ON)
            found.append(np.column_stack([i, j])[same])
            looked += len(i)
            if looked > MOST_PAIRS:
                raise TooMany
    return np.concatenate(found)


def _parallel(angle: npt.NDArray[np.float64]) -> Iterator[tuple[npt.NDArray[np.int64], float]]:
    """Legs of nearly one direction, and the direction; near the border of two ranges a leg is in both."""
    share = angle / np.pi * BINS
    home, part = np.floor(share).astype(np.int64), share % 1.0
    also = home + np.where(part < 0.2, -1, np.where(part > 0.8, 1, 0))
    members: dict[int, set[int]] = defaultdict(set)
    for i, (h, a) in enumerate(zip((home % BINS).tolist(), (also % BINS).tolist(), strict=True)):
        members[h].add(i)
        members[a].add(i)
    for h, some in members.items():
        if len(some) > 1:
            yield np.array(sorted(some)), (h + 0.5) * np.pi / BINS


def _groups(pairs: npt.NDArray[np.int64], count: int) -> list[list[int]]:
    """Legs that hang together by pairs."""
    label = together(pairs, count)
    groups: dict[int, list[int]] = defaultdict(list)
    for leg in np.unique(pairs).tolist():
        groups[int(label[leg])].append(leg)
    return list(groups.values())


def _union(mine: Legs, others: Legs) -> list[Curve]:
    """What lines cover and ``others`` do not, as lines from end to end."""
    origin, way = _axis(mine)
    ends = np.concatenate([mine, others]).reshape(-1, 2)
    place = (ends - origin) @ way
    order = np.argsort(place, kind="stable")
    ends, place = ends[order], place[order]
    apart = np.append(True, np.diff(place) > ON)
    ends, place = ends[apart], place[apart]
    middle = 0.5 * (place[1:] + place[:-1])
    kept = (_covered(mine, origin, way, middle) > 0) & (_covered(others, origin, way, middle) == 0)
    return [line(complex(*ends[i]), complex(*ends[i + 1])) for i in np.flatnonzero(kept)]


def _bent(legs: Legs) -> bool:
    """Whether the legs of a group do not lie on one line, as those of a flat bow that lie on their neighbours do."""
    origin, way = _axis(legs)
    return bool(np.abs((legs - origin) @ np.array([-way[1], way[0]])).max() > 2.0 * ON)


def _axis(legs: Legs) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """A point and the direction of the longest leg."""
    a, b = legs[np.hypot(*(legs[:, 1] - legs[:, 0]).T).argmax()]
    return a, (b - a) / np.hypot(*(b - a))


def _covered(
    legs: Legs, origin: npt.NDArray[np.float64], way: npt.NDArray[np.float64], at: npt.NDArray[np.float64]
) -> npt.NDArray[np.int64]:
    """How many legs cover each place along the axis."""
    spans = np.sort((legs - origin) @ way, axis=1).reshape(-1, 2)
    return np.searchsorted(np.sort(spans[:, 0]), at) - np.searchsorted(np.sort(spans[:, 1]), at)


def _length(legs: Legs) -> float:
    return float(np.hypot(*(legs[:, 1] - legs[:, 0]).T).sum())


# Contours, after they are joined


def without_doubles(contours: list[Curve]) -> tuple[list[Curve], Cleaned]:
    """Closed contours that are there twice once, and those without area as lines.

    Raises:
        TooMany: beyond :data:`MOST_PAIRS`.
    """
    from scipy.spatial import KDTree

    opened = [_opened(c) for c in contours]
    flat = sum(a is not b for a, b in zip(contours, opened, strict=True))
    length = sum(a.length - b.length for a, b in zip(contours, opened, strict=True))
    closed = [i for i, c in enumerate(opened) if c.closed]
    gone: set[int] = set()
    if len(closed) > 1:
        boxes = np.array([[*opened[i].points.min(axis=0), *opened[i].points.max(axis=0)] for i in closed])
        tree = KDTree(boxes)
        if tree.count_neighbors(tree, SAME) > MOST_PAIRS:
            raise TooMany
        for a, b in sorted(tree.query_pairs(SAME)):
            first, second = opened[closed[a]], opened[closed[b]]
            if closed[a] in gone or closed[b] in gone or abs(first.length - second.length) > 1e-3 * first.length:
                continue
            if _distance(first, second) <= SAME and _distance(second, first) <= SAME:
                gone.add(closed[b])
                length += second.length
    kept = [c for i, c in enumerate(opened) if i not in gone]
    return kept, Cleaned(doubled=len(gone), flat=flat, length=length)


def _distance(one: Curve, other: Curve) -> float:
    """mm, how far vertices of the one, 64 at most, lie from the other."""
    some = one.points[:: -(-len(one.points) // 64)]
    return float(shapely.distance(shapely.points(some), shapely.LineString(other.points)).max())


def _opened(contour: Curve) -> Curve:
    """A closed contour without area as the line that it is there and back, or, if it bends, as an open one."""
    if not contour.closed:
        return contour
    points = contour.points - contour.points[0]
    x, y = points.T
    least = 0.5 * ON * contour.length
    if abs(x[:-1] @ y[1:] - x[1:] @ y[:-1]) / 2.0 > least or even_odd(points) > least:
        return contour
    far = points[np.hypot(x, y).argmax()]
    way = far / np.hypot(*far)
    along, off = points @ way, points @ np.array([-way[1], way[0]])
    if np.abs(off).max() <= ON:
        low, high = contour.points[along.argmin()], contour.points[along.argmax()]
        return line(complex(*low), complex(*high))
    return replace(contour, closed=False)
