"""Curves to contours: drawings do not know where a contour begins; their curves are joined where their ends meet.

Ends within :data:`.curve.EXACT` are joined first, across a gap only afterwards. What is shorter than :data:`GAP` is a
speck.
"""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..plant.path import SPACING
from .curve import EXACT, Curve, Indices, Points, linked

GAP = SPACING
"""mm, the largest gap between two ends that are joined unless a user says otherwise: what CAD rounds away, and one
sample of a journey."""

NEAR = 20.0
"""Times the tolerance, within which two ends that stay apart are worth telling."""

NEIGHBOURS = 8
"""Ends among which the nearest free one is looked for at a time."""

Gap = tuple[float, float, float]
"""x and y of an end and its distance from the one that it was, or was not, joined to; all in mm."""


@dataclass(frozen=True)
class Joints:
    """Gaps that were bridged, ends that nearly meet and stay open, and specks that were left out."""

    bridged: tuple[Gap, ...] = ()
    apart: tuple[Gap, ...] = ()
    specks: int = 0


def joined(curves: list[Curve], tolerance: float = GAP) -> tuple[list[Curve], Joints]:
    """Contours, closed or not: all that fits exactly, then what fits across a gap; specks are left out.

    Across a gap the nearest two ends go together, then the next nearest, each end once.
    """
    if not curves:
        return [], Joints()
    closed, loose = _chained(curves, _same(_ends(curves)).reshape(-1, 2))
    ends = _ends(loose)
    pairs = _matched(loose, ends, tolerance)
    nodes = np.arange(len(ends))
    for a, b, _ in pairs:
        nodes[b] = nodes[a]
    over_gaps, loose = _chained(loose, nodes.reshape(-1, 2))
    contours = [c for c in closed + over_gaps + loose if c.length > GAP]
    bridged = tuple((float(ends[a, 0]), float(ends[a, 1]), gap) for a, _, gap in pairs)
    return contours, Joints(bridged, _apart(loose, tolerance), len(closed + over_gaps + loose) - len(contours))


def _ends(curves: list[Curve]) -> Points:
    """First and last point of each curve, one after the other."""
    return np.array([end for c in curves for end in (*c.points[0], *c.points[-1])], float).reshape(-1, 2)


def _same(points: Points) -> Indices:
    """A number for each point, the same for points within :data:`EXACT` of each other."""
    from scipy.spatial import KDTree  # slow, as the readers of files are

    # Thousands of ends in one place are one point here, or their pairs would fill the memory.
    cells, which = np.unique(np.round(points / EXACT), axis=0, return_inverse=True)
    pairs = KDTree(cells).query_pairs(1.5, output_type="ndarray")
    return together(pairs, len(cells))[which.ravel()]


def together(pairs: Indices, count: int) -> Indices:
    """A number for each of ``count`` things, the same for those that hang together by ``pairs``, shape (n, 2)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), (count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _matched(curves: list[Curve], ends: Points, tolerance: float) -> list[tuple[int, int, float]]:
    """Pairs of ends within ``tolerance`` mm and their distance, the nearest first, each end once."""
    from scipy.spatial import KDTree

    free = np.arange(len(ends))
    found: list[tuple[int, int, float]] = []
    while len(free) > 1:
        near, which = KDTree(ends[free]).query(
            ends[free], k=min(NEIGHBOURS, len(free)), distance_upper_bound=tolerance * (1.0 + 1e-9)
        )
        i, k = np.nonzero(np.isfinite(near) & (which != np.arange(len(free))[:, None]) & (which < len(free)))
        order = np.argsort(near[i, k], kind="stable")
        taken: set[int] = set()
        before = len(found)
        for a, b, gap in zip(free[i[order]], free[which[i, k][order]], near[i, k][order], strict=True):
            if a in taken or b in taken or not _may_meet(curves, int(a), int(b), float(gap)):
                continue
            taken |= {int(a), int(b)}
            found.append((int(a), int(b), float(gap)))
        if len(found) == before:
            break
        free = free[~np.isin(free, list(taken))]
    return found


def _may_meet(curves: list[Curve], a: int, b: int, gap: float) -> bool:
    """Whether a curve may be closed; one that goes hardly farther than its ends lie apart encloses nothing."""
    own = curves[a // 2]
    return a // 2 != b // 2 or (len(own.points) > 2 and own.length > 3.0 * gap and own.length > GAP)


def _apart(loose: list[Curve], tolerance: float) -> tuple[Gap, ...]:
    """Open ends that another one lies near, the nearest first."""
    from scipy.spatial import KDTree

    ends = _ends(loose)
    if len(ends) < 2:
        return ()
    near, which = KDTree(ends).query(ends, k=2, distance_upper_bound=NEAR * tolerance)
    # The two ends of one short curve are not a gap.
    mine = np.array([c.length for c in loose]).repeat(2) <= 3.0 * near[:, 1]
    own = which[:, 1] // 2 == np.arange(len(ends)) // 2
    told = [
        (float(ends[i, 0]), float(ends[i, 1]), float(near[i, 1]))
        for i in np.argsort(near[:, 1], kind="stable")
        if np.isfinite(near[i, 1])
        and near[i, 1] > EXACT
        and not (own[i] and mine[i])
        and (which[which[i, 1], 1] != i or i < which[i, 1])
    ]
    return tuple(told)


# Chains


def _chained(curves: list[Curve], nodes: npt.NDArray[np.int64]) -> tuple[list[Curve], list[Curve]]:
    """Closed and open chains of ``curves`` in either direction; ``nodes``: where each begins and ends, shape (n, 2).

    The ends are the nodes of a graph and the curves its edges. A walk along unused edges that comes back to a node
    cuts off the loop: it is a contour of its own, so that two shapes that touch in a corner, or a lead-in and its
    shape, stay apart. Walks begin at the nodes of odd degree, which is where open chains end.
    """
    ends = nodes.tolist()
    closed = [linked([c], True) for c, (a, b) in zip(curves, ends, strict=True) if a == b]
    edges: dict[int, list[int]] = defaultdict(list)  # of each node, the first last
    for i, (a, b) in enumerate(ends):
        if a != b:
            edges[a].append(i)
            edges[b].append(i)
    for at in edges.values():
        at.reverse()
    loose: list[Curve] = []
    unused = {i for at in edges.values() for i in at}
    for start in [n for n, at in edges.items() if len(at) % 2] + list(edges):
        loops, rest = _walk(start, edges, ends, unused)
        for trail, shut in [*((loop, True) for loop in loops), (rest, False)]:
            if trail:
                run = [curves[i] if ends[i][0] == node else curves[i].reversed() for node, i in trail]
                (closed if shut else loose).append(linked(run, shut))
    return closed, loose


Trail = list[tuple[int, int]]
"""(node, edge that leaves it), in order."""


def _walk(
    start: int, edges: dict[int, list[int]], ends: list[list[int]], unused: set[int]
) -> tuple[list[Trail], Trail]:
    """The loops on a walk from ``start``, and what remains of it; takes its edges out of ``unused``."""
    loops: list[Trail] = []
    trail: Trail = []
    here = start
    passed: dict[int, int] = {}
    while True:
        while edges[here] and edges[here][-1] not in unused:
            edges[here].pop()
        if not edges[here]:
            return loops, trail
        edge = edges[here].pop()
        unused.remove(edge)
        passed[here] = len(trail)
        trail.append((here, edge))
        here = sum(ends[edge]) - here
        if here in passed:
            loop = trail[passed[here] :]
            del trail[passed[here] :]
            for node, _ in loop:
                del passed[node]
            loops.append(loop)
