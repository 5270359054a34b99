"""Drawings: contours in cutting order, whatever kind of file they come from.

Readers turn what a file draws into polylines (:class:`Curves`); here they are joined into contours and the contours are
put into cutting order. All lengths are mm.
"""

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..plant.path import SPACING, Contour, resample
from ..plant.quantity import InvalidInput

Points = npt.NDArray[np.float64]
"""A polyline: shape (n, 2), mm."""

CHORD = 0.01
"""mm, the largest distance between a curve and its chords."""

GAP = SPACING
"""mm, the largest gap between two ends that are still joined: what CAD rounds away, and one sample of the journey."""

EXACT = 1e-6
"""mm, below which two points are the same; ends are joined this closely first, across a gap only afterwards."""

LENGTH_RANGE = (1.0, 50e3)
"""mm, of a journey with its moves between contours."""


@dataclass(frozen=True)
class Drawing:
    """The contours of a drawing in cutting order.

    ``pieces`` are arrays of shape (n, 2) in mm, one contour each; ``closed`` tells for each whether it ends where it
    began; ``units`` is the name of the unit in which the file was drawn; ``layers`` are the layers that are cut, in
    order of appearance; ``skipped`` counts what was left out, such as ``{"TEXT": 2, "LINE of zero length": 1}``;
    ``warnings`` are what a user should know of how the file was read.
    """

    name: str
    pieces: list[Points]
    closed: list[bool]
    units: str
    layers: list[str]
    skipped: dict[str, int]
    warnings: tuple[str, ...] = ()

    @property
    def cut_length(self) -> float:
        """mm with the beam on."""
        return sum(map(length, self.pieces))

    @property
    def move_length(self) -> float:
        """mm between the end of one contour and the start of the next."""
        return float(sum(np.hypot(*(b[0] - a[-1])) for a, b in zip(self.pieces, self.pieces[1:], strict=False)))


@dataclass
class Curves:
    """What a reader has found so far: polylines in mm; duplicates and what has no length are counted and left out."""

    lines: dict[bytes, Points] = field(default_factory=dict)
    layers: dict[str, None] = field(default_factory=dict)
    skipped: Counter[str] = field(default_factory=Counter)

    def add(self, points: Points, kind: str, layer: str = "0", repeat: bool = False) -> None:
        """One more polyline; ``repeat``: it may run where another has run before."""
        points = without_repeats(points)
        key = _key(points) + (len(self.lines).to_bytes(8, "little") if repeat else b"")
        if length(points) < EXACT:
            self.skipped[f"{kind} of zero length"] += 1
        elif key in self.lines:
            self.skipped[f"duplicate {kind}"] += 1
        else:
            self.lines[key] = points
            self.layers[layer] = None


def assembled(file: Path, curves: Curves, units: str, cut: str, warnings: tuple[str, ...] = ()) -> Drawing:
    """The drawing that the curves of ``file`` make; ``cut`` says what is cut in such files.

    Raises:
        InvalidInput: nothing to cut, or a journey whose length is outside :data:`LENGTH_RANGE`.
    """
    contours = joined(list(curves.lines.values()))
    if not contours:
        left_out = ", ".join(f"{what} ({n})" for what, n in curves.skipped.items()) or "nothing"
        raise InvalidInput(f"{file}: nothing to cut in it; what is cut: {cut}; skipped: {left_out}")
    order = ordered(contours)
    drawing = Drawing(
        file.stem, [p for p, _ in order], [c for _, c in order], units, list(curves.layers), dict(curves.skipped),
        warnings,
    )  # fmt: skip
    check_length(file, drawing)
    return drawing


def check_travel(drawing: Drawing, travel: tuple[float, float]) -> None:
    """Raises :class:`InvalidInput` if the drawing is larger than the machine's travel, mm."""
    points = np.concatenate(drawing.pieces)
    size = np.ptp(points, axis=0)
    if (size > np.asarray(travel)).any():
        raise InvalidInput(
            f"drawing '{drawing.name}' is {size[0]:g} × {size[1]:g} mm, read in {drawing.units}; the machine's "
            f"travel is {travel[0]:g} × {travel[1]:g} mm"
        )


def check_closed(drawing: Drawing) -> None:
    """Raises :class:`InvalidInput` if a contour is open, where kerf compensation needs closed ones."""
    loose = [i for i, closed in enumerate(drawing.closed) if not closed]
    if loose:
        x, y = drawing.pieces[loose[0]][0]
        raise InvalidInput(
            f"drawing '{drawing.name}': contour {loose[0] + 1} of {len(drawing.closed)}, which begins at "
            f"({x:.3f}, {y:.3f}) mm, is open; kerf compensation needs closed contours, or kerf = 0"
        )


def journey(drawing: Drawing) -> Contour:
    """The whole drawing as one path, resampled, with the beam off between contours."""
    return resample(drawing.name, list(drawing.pieces))


def check_length(file: Path, drawing: Drawing) -> None:
    low, high = LENGTH_RANGE
    length = drawing.cut_length + drawing.move_length
    if not low <= length <= high:
        raise InvalidInput(
            f"{file}: a journey of {length:g} mm ({drawing.cut_length:g} mm of it cut) is out of range; "
            f"allowed: {low:g} to {high:g} mm; the drawing was read in {drawing.units}"
        )


def arc(start: complex, end: complex, bulge: float, chord: float) -> npt.NDArray[np.complex128]:
    """The points after ``start`` on an arc whose included angle is 4·atan(``bulge``), positive counter-clockwise."""
    angle = 4.0 * np.arctan(bulge)
    if abs(angle) * abs(end - start) < 1e-12 or start == end:
        return np.array([end])
    centre = 0.5 * (start + end) + 0.5j * (end - start) / np.tan(0.5 * angle)
    step = 2.0 * np.arccos(max(1.0 - chord / abs(start - centre), 0.0))
    turns = np.linspace(0.0, angle, int(np.ceil(abs(angle) / max(step, 1e-4))) + 1)[1:]
    return np.append(centre + (start - centre) * np.exp(1j * turns[:-1]), end)


def _key(points: Points) -> bytes:
    """The same for two polylines that run through the same points, in either direction."""
    grid = np.round(points / EXACT) + 0.0  # no −0, whose bytes differ
    return min(grid.tobytes(), grid[::-1].tobytes())


# Polylines to contours


def joined(curves: list[Points]) -> list[tuple[Points, bool]]:
    """Contours and whether they are closed: all that fits exactly, then what fits across a gap."""
    closed, loose = _chained(curves, EXACT)
    over_gaps, loose = _chained(loose, GAP)
    return [(p, True) for p in closed + over_gaps] + [(p, False) for p in loose if length(p) > GAP]


def _chained(curves: list[Points], tolerance: float) -> tuple[list[Points], list[Points]]:
    """Closed and open chains of ``curves`` whose ends lie within ``tolerance`` mm, in either direction.

    The ends are the nodes of a graph and the curves its edges. A walk along unused edges that comes back to a node
    cuts off the loop: it is a contour of its own, so that two shapes that touch in a corner, or a lead-in and its
    shape, stay apart. Walks begin at the nodes of odd degree, which is where open chains end.
    """
    if not curves:
        return [], []
    nodes = _clusters(np.array([end for curve in curves for end in (curve[0], curve[-1])]), tolerance).reshape(-1, 2)
    closed = [_assembled([c], True) for c, (a, b) in zip(curves, nodes, strict=True) if a == b and length(c) > GAP]
    edges: dict[int, list[int]] = defaultdict(list)
    for i, (a, b) in enumerate(nodes.tolist()):
        if a != b:
            edges[a].append(i)
            edges[b].append(i)
    loose: list[Points] = []
    unused = {i for at in edges.values() for i in at}
    for start in [n for n, at in edges.items() if len(at) % 2] + list(edges):
        loops, rest = _walk(start, edges, nodes, unused)
        for trail, shut in [*((loop, True) for loop in loops), (rest, False)]:
            if trail:
                run = [curves[i] if nodes[i, 0] == node else curves[i][::-1] for node, i in trail]
                (closed if shut else loose).append(_assembled(run, shut))
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
    from scipy.sparse import coo_matrix  # slow, as the DXF reader is
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    pairs = KDTree(points).query_pairs(tolerance, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), (len(points), len(points)))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _assembled(run: list[Points], closed: bool) -> Points:
    """Curves one after the other; a closed one ends in its first point."""
    return without_repeats(np.concatenate([*run, run[0][:1]] if closed else run))


def without_repeats(points: Points) -> Points:
    """``points`` without those that stand where the one before stands; both ends stay exactly."""
    if len(points) == 0:
        return points
    kept = points[np.append(True, np.hypot(*np.diff(points, axis=0).T) > EXACT)]
    kept[-1] = points[-1]
    return kept


def length(points: Points) -> float:
    """mm."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


# Contours to cutting order


def ordered(contours: list[tuple[Points, bool]]) -> list[tuple[Points, bool]]:
    """Each contour after all that it contains; among those possible the nearest, open ones from their nearer end.

    What has been cut loose may tip or shift: a hole must be cut while its part still hangs in the sheet.
    """
    inside = _containment(contours)
    waits_for = inside.sum(axis=0)
    left = np.ones(len(contours), bool)
    starts, ends = (np.array([p[i] for p, _ in contours]) for i in (0, -1))
    here, ordered = np.zeros(2), []
    while left.any():
        to_start, to_end = np.hypot(*(starts - here).T), np.hypot(*(ends - here).T)
        next_one = int(np.where(left & (waits_for == 0), np.minimum(to_start, to_end), np.inf).argmin())
        points, closed = contours[next_one]
        ordered.append((points if to_start[next_one] <= to_end[next_one] else points[::-1], closed))
        here = ordered[-1][0][-1]
        left[next_one] = False
        waits_for = waits_for - inside[next_one]
    return ordered


def holes(drawing: Drawing) -> list[bool]:
    """For each contour whether it is a hole: within an odd number of others."""
    inside = _containment(list(zip(drawing.pieces, drawing.closed, strict=True)))
    return (inside.sum(axis=1) % 2 == 1).tolist()


def _containment(contours: list[tuple[Points, bool]]) -> npt.NDArray[np.bool_]:
    """[i, j]: contour i lies within contour j, which is closed and larger; by most of its points, not by all."""
    area = np.array([_area(p) if closed else 0.0 for p, closed in contours])
    low, high = np.array([p.min(axis=0) for p, _ in contours]), np.array([p.max(axis=0) for p, _ in contours])
    inside = np.zeros((len(contours), len(contours)), bool)
    for j, (outline, _) in enumerate(contours):
        fits = (area < area[j]) & (low >= low[j] - GAP).all(axis=1) & (high <= high[j] + GAP).all(axis=1)
        for i in np.flatnonzero(fits):
            inside[i, j] = _within(_probes(contours[i][0]), outline).mean() > 0.5
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
