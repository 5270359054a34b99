"""Curves to contours in cutting order.

Drawings know neither where a contour begins nor what comes first: their curves are joined where their ends meet, and
what lies inside is cut before what is around it.
"""

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from ..plant.path import SPACING
from .curve import EXACT, Curve, Points, linked

GAP = SPACING
"""mm, the largest gap between two ends that are still joined: what CAD rounds away, and one sample of the journey.
Ends within :data:`EXACT` are joined first, across a gap only afterwards."""


# Joining


def joined(curves: list[Curve]) -> list[Curve]:
    """Contours, closed or not: all that fits exactly, then what fits across a gap; specks are left out."""
    closed, loose = _chained(curves, EXACT)
    over_gaps, loose = _chained(loose, GAP)
    return closed + over_gaps + [c for c in loose if c.length > GAP]


def _chained(curves: list[Curve], tolerance: float) -> tuple[list[Curve], list[Curve]]:
    """Closed and open chains of ``curves`` whose ends lie within ``tolerance`` mm, in either direction.

    The ends are the nodes of a graph and the curves its edges. A walk along unused edges that comes back to a node
    cuts off the loop: it is a contour of its own, so that two shapes that touch in a corner, or a lead-in and its
    shape, stay apart. Walks begin at the nodes of odd degree, which is where open chains end.
    """
    if not curves:
        return [], []
    ends = np.array([end for curve in curves for end in (curve.points[0], curve.points[-1])])
    nodes = _clusters(ends, tolerance).reshape(-1, 2)
    closed = [linked([c], True) for c, (a, b) in zip(curves, nodes, strict=True) if a == b and c.length > GAP]
    edges: dict[int, list[int]] = defaultdict(list)
    for i, (a, b) in enumerate(nodes.tolist()):
        if a != b:
            edges[a].append(i)
            edges[b].append(i)
    loose: list[Curve] = []
    unused = {i for at in edges.values() for i in at}
    for start in [n for n, at in edges.items() if len(at) % 2] + list(edges):
        loops, rest = _walk(start, edges, nodes, unused)
        for trail, shut in [*((loop, True) for loop in loops), (rest, False)]:
            if trail:
                run = [curves[i] if nodes[i, 0] == node else curves[i].reversed() for node, i in trail]
                (closed if shut else loose).append(linked(run, shut))
    return closed, loose


Trail = list[tuple[int, int]]
"""(node, edge that leaves it), in order."""


def _walk(
    start: int, edges: dict[int, list[int]], nodes: npt.NDArray[np.int64], unused: set[int]
) -> tuple[list[Trail], Trail]:
    """The loops on a walk from ``start``, and what remains of it; takes its edges out of ``unused``."""
    loops: list[Trail] = []
    trail: Trail = []
    here = start
    passed: dict[int, int] = {}
    while True:
        while edges[here] and edges[here][0] not in unused:
            edges[here].pop(0)
        if not edges[here]:
            return loops, trail
        edge = edges[here].pop(0)
        unused.remove(edge)
        passed[here] = len(trail)
        trail.append((here, edge))
        here = int(nodes[edge].sum()) - here
        if here in passed:
            loop = trail[passed[here] :]
            del trail[passed[here] :]
            for node, _ in loop:
                del passed[node]
            loops.append(loop)


def _clusters(points: Points, tolerance: float) -> npt.NDArray[np.int64]:
    """A number for each point, the same for points within ``tolerance`` of each other."""
    from scipy.sparse import coo_matrix  # slow, as the readers of files are
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    pairs = KDTree(points).query_pairs(tolerance, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), (len(points), len(points)))
    return connected_components(graph, directed=False)[1].astype(np.int64)


# Cutting order


def ordered(contours: list[Curve]) -> list[Curve]:
    """Each contour after all that it contains; among those possible the nearest, open ones from their nearer end.

    What has been cut loose may tip or shift: a hole must be cut while its part still hangs in the sheet. The nozzle
    comes from the origin.
    """
    if not contours:
        return []
    inside = _containment(contours)
    waits_for = inside.sum(axis=0)
    left = np.ones(len(contours), bool)
    starts, ends = (np.array([c.points[i] for c in contours]) for i in (0, -1))
    here, in_order = np.zeros(2), []
    while left.any():
        to_start, to_end = np.hypot(*(starts - here).T), np.hypot(*(ends - here).T)
        next_one = int(np.where(left & (waits_for == 0), np.minimum(to_start, to_end), np.inf).argmin())
        contour = contours[next_one]
        in_order.append(contour if to_start[next_one] <= to_end[next_one] else contour.reversed())
        here = in_order[-1].points[-1]
        left[next_one] = False
        waits_for = waits_for - inside[next_one]
    return in_order


def _containment(contours: list[Curve]) -> npt.NDArray[np.bool_]:
    """[i, j]: contour i lies within contour j, which is closed and larger; by most of its points, not by all."""
    area = np.array([_area(c.points) if c.closed else 0.0 for c in contours])
    low, high = (np.array([f(c.points, axis=0) for c in contours]) for f in (np.min, np.max))
    inside = np.zeros((len(contours), len(contours)), bool)
    for j, outline in enumerate(contours):
        fits = (area < area[j]) & (low >= low[j] - GAP).all(axis=1) & (high <= high[j] + GAP).all(axis=1)
        for i in np.flatnonzero(fits):
            inside[i, j] = _within(_probes(contours[i].points), outline.points).mean() > 0.5
    return inside


def _area(points: Points) -> float:
    """mm², of a closed polyline."""
    x, y = (points - points[0]).T
    return float(abs(x[:-1] @ y[1:] - x[1:] @ y[:-1]) / 2.0)


def _probes(points: Points) -> Points:
    """Up to 9 points on a polyline, in the middle of its segments: corners may touch what is around them."""
    middles = 0.5 * (points[1:] + points[:-1])
    return middles[:: -(-len(middles) // 9)]


def _within(points: Points, outline: Points) -> npt.NDArray[np.bool_]:
    """Even–odd rule: whether a ray from each point crosses the closed ``outline`` an odd number of times."""
    x, y = points.T[:, :, None]
    (x1, y1), (x2, y2) = outline[:-1].T, outline[1:].T
    straddles = (y1 > y) != (y2 > y)
    rise = np.where(y1 == y2, 1.0, y2 - y1)
    return (straddles & (x < x1 + (y - y1) * (x2 - x1) / rise)).sum(axis=1) % 2 == 1


def holes(pieces: list[Points], closed: list[bool]) -> list[bool]:
    """For each contour whether it is a hole: within an odd number of closed others."""
    none = np.zeros(0, np.int64)
    curves = [Curve(p, none, 0j, 0j, c) for p, c in zip(pieces, closed, strict=True)]
    return (_containment(curves).sum(axis=1) % 2 == 1).tolist()
