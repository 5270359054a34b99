"""Curves to contours in cutting order.

Drawings know neither where a contour begins nor what comes first: their curves are joined where their ends meet, and
:mod:`.order` tells what is cut when.
"""

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from ..plant.path import SPACING
from .curve import EXACT, Curve, Points, linked
from .order import ordered

__all__ = ["GAP", "joined", "ordered"]

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
