"""Micro-joints: bridges that hold a part in the sheet.

The simulated machine leaves the cut open: a contour with joints is cut in several runs, each pierced and led into in
the scrap like a contour of its own. What stays between the end of one kerf and the beginning of the next is the joint.
Only outlines have joints; what falls out of a hole is scrap.
"""

from dataclasses import dataclass

import numpy as np

from .curve import Floats, Indices, Points, point_at, way_along
from .starts import begun

SHARE = 0.25
"""Most of a contour that its joints may be; of more joints than that as many as fit are made."""

ASIDE = 0.3
"""Most of the distance between joints by which one is moved away from a corner."""


@dataclass(frozen=True)
class Run:
    """A part of a contour between two joints: shape (n, 2), mm, with the indices of its corners."""

    points: Points
    corners: Indices


def joints(length: float, count: int, spacing: float, gap: float) -> int:
    """How many joints a contour gets.

    Args:
        length: mm, of the contour.
        count: joints asked for.
        spacing: mm between them asked for; 0: ``count`` decides, else whichever gives more.
        gap: mm of path that one needs.
    """
    wanted = max(count, int(np.ceil(length / spacing)) if spacing > 0 else 0)
    return min(wanted, int(SHARE * length / gap))


def runs(piece: Points, corners: Indices, count: int, gap: float) -> list[Run]:
    """A closed contour in ``count`` runs with a gap before each start; the last gap ends where the contour begins.

    The gaps are evenly spaced, those near a corner moved to where the contour is straight: what a joint leaves is seen
    most in a corner.

    Args:
        piece: closed, shape (n, 2), mm.
        corners: indices of its corners.
        count: 1 or more.
        gap: mm along the contour.
    """
    way = way_along(piece)
    whole = way[-1]
    ends = [0.0]  # of the gaps
    sharp = np.sort(np.append(way[corners], [0.0, whole]))
    for k in range(1, count):
        ends.append(_aside(k * whole / count, sharp, gap, ASIDE * whole / count))
    starts = np.array(ends)
    stops = np.append(starts[1:], whole) - gap
    out = []
    for a, b in zip(starts, stops, strict=True):
        inner = np.flatnonzero((way > a + 1e-9) & (way < b - 1e-9))
        points = np.concatenate([[point_at(piece, way, a)], piece[inner], [point_at(piece, way, b)]])
        place = np.searchsorted(inner, corners)
        there = (place < len(inner)) & (np.append(inner, -1)[np.minimum(place, len(inner))] == corners)
        out.append(Run(points, place[there] + 1))
    return out


def away_from_corners(piece: Points, corners: Indices, gap: float) -> tuple[Points, Indices]:
    """A closed contour begun where the gap behind its start is clear of corners, as near as can be to its own start."""
    way = way_along(piece)
    sharp = np.sort(np.append(way[corners], [0.0, way[-1]]))
    whole = way[-1]
    at = _aside(0.0, np.concatenate([sharp - whole, sharp, sharp + whole]), gap, ASIDE * whole) % whole
    leg = int(np.clip(np.searchsorted(way, at, side="right") - 1, 0, len(piece) - 2))
    return begun(piece, corners, leg, point_at(piece, way, at))


def _aside(end: float, sharp: Floats, gap: float, most: float) -> float:
    """Where a gap ends that keeps its own width away from corners, as near to ``end`` as can be; ``end`` if there is no
    such place within ``most``."""
    steps = np.linspace(-most, most, 61)
    steps = steps[np.argsort(np.abs(steps), kind="stable")]
    middle = end + steps - 0.5 * gap
    apart = np.abs(middle[:, None] - sharp[None, :]).min(axis=1)
    free = np.flatnonzero(apart >= 1.5 * gap)
    return float(end + steps[free[0]]) if len(free) else end
