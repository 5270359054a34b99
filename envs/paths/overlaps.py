"""Overlaps of curves: an arc that lies on a circle, or any open curve that lies on another, is cut once.

Straight lines are cleaned before, exactly (:mod:`.cleaning`). Two curves of one arc have chords that begin elsewhere,
so of curves no more can be asked than that they stay within their chords' tolerance of each other.
"""

import numpy as np

from . import geos as shapely
from .cleaning import MOST_PAIRS, ON, Cleaned, TooMany
from .curve import CHORD, Curve, point_at, way_along
from .pieces import short_runs

NEAR = 2.0 * CHORD + ON
"""mm, the largest distance of two curves that lie on one another: either leaves its chords by :data:`.curve.CHORD`."""

SAMPLES = 65
"""Points of a curve, besides its vertices, that must lie on the other."""

ADVANCE = 0.05
"""Share of its length by which a curve may advance more or less along the one that it lies on: the short legs of a fine
polyline are near their neighbours, too, but do not advance along them."""

BLOCK = 64
"""Curves that are looked at together; of thousands through one point each meets all."""


def without_curves_on_others(curves: list[Curve]) -> tuple[list[Curve], Cleaned]:
    """The curves without the open ones that lie wholly on another, the shortest first; single straight lines stay.

    Raises:
        TooMany: more than :data:`.cleaning.MOST_PAIRS` lie on one another.
    """
    bent = np.array([i for i, c in enumerate(curves) if len(c.points) > 2], np.int64)
    opened = np.array([i for i in bent if (curves[i].points[0] != curves[i].points[-1]).any()], np.int64)
    if len(bent) < 2 or not len(opened):
        return curves, Cleaned()
    runs, owners = short_runs([curves[i].points for i in bent])
    tree = shapely.STRtree(runs)
    pairs: list[tuple[int, int]] = []
    for at in range(0, len(opened), BLOCK):
        some = opened[at : at + BLOCK]
        ways = [(curves[i].points, way_along(curves[i].points)) for i in some]
        middles = shapely.points(np.array([point_at(points, way, 0.5 * way[-1]) for points, way in ways]))
        which, run = tree.query(middles, predicate="dwithin", distance=NEAR)
        found = np.unique(np.column_stack([some[which], bent[owners[run]]]), axis=0)
        pairs += [(a, b) for a, b in found.tolist() if a != b]
        if len(pairs) > MOST_PAIRS // 20:  # each is looked at by itself
            raise TooMany
    gone: set[int] = set()
    for a, b in sorted(pairs, key=lambda pair: curves[pair[0]].length):
        if a not in gone and b not in gone and lies_on(curves[a], curves[b]):
            gone.add(a)
    length = sum(curves[i].length for i in gone)
    return [c for i, c in enumerate(curves) if i not in gone], Cleaned(curves=len(gone), length=length)


def lies_on(one: Curve, other: Curve) -> bool:
    """Whether all of the one lies on the other, and runs along it."""
    line, own = shapely.LineString(other.points), shapely.LineString(one.points)
    if own.length > line.length * (1.0 + ADVANCE):
        return False
    vertices = one.points[:: -(-len(one.points) // SAMPLES)]
    if shapely.distance(shapely.points(vertices), line).max() > NEAR:
        return False
    along = shapely.line_interpolate_point(own, np.linspace(0.0, 1.0, SAMPLES), normalized=True)
    if shapely.distance(along, line).max() > NEAR:
        return False
    steps = np.diff(shapely.line_locate_point(line, along))
    if (other.points[0] == other.points[-1]).all():  # it may pass where the other begins
        steps = (steps + 0.5 * line.length) % line.length - 0.5 * line.length
    return bool(abs(abs(steps.sum()) - own.length) <= ADVANCE * own.length)
