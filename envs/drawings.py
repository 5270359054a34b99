"""Drawings: from a DXF file to a journey of the nozzle.

The entities become polylines, the polylines are joined into contours, the contours are put into cutting order. All
lengths are mm; the third dimension is dropped. Bulges and splines are evaluated here and not by the DXF reader where
its own way would leave the tolerance (bulges through Bézier curves) or the curve (splines whose ends are not clamped).
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .plant.path import SPACING, Contour, resample
from .plant.quantity import InvalidInput

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

UNITS = {1: ("inches", 25.4), 4: ("mm", 1.0), 5: ("cm", 10.0), 6: ("m", 1000.0)}
"""Code of $INSUNITS: name, mm."""

CUT = ("LINE", "ARC", "CIRCLE", "LWPOLYLINE", "POLYLINE", "ELLIPSE", "SPLINE")
"""Entities that are cut; the contents of INSERT are looked into, everything else is skipped."""

NESTING = 16
"""Blocks within blocks; more means that a block contains itself."""


@dataclass(frozen=True)
class Drawing:
    """The contours of a drawing in cutting order.

    ``pieces`` are arrays of shape (n, 2) in mm, one contour each; ``closed`` tells for each whether it ends where it
    began; ``units`` is the name of the unit in which the file was drawn; ``layers`` are the layers that are cut, in
    order of appearance; ``skipped`` counts what was left out, such as ``{"TEXT": 2, "LINE of zero length": 1}``.
    """

    name: str
    pieces: list[Points]
    closed: list[bool]
    units: str
    layers: list[str]
    skipped: dict[str, int]

    @property
    def cut_length(self) -> float:
        """mm with the beam on."""
        return sum(map(_length, self.pieces))

    @property
    def move_length(self) -> float:
        """mm between the end of one contour and the start of the next."""
        return float(sum(np.hypot(*(b[0] - a[-1])) for a, b in zip(self.pieces, self.pieces[1:], strict=False)))


def read_dxf(path: str | Path) -> Drawing:
    """The contours of a DXF drawing, inner ones before those that contain them, otherwise the nearest next.

    Cut are the lines, arcs, circles, ellipses, splines and 2D polylines of the model space, also inside blocks. Left
    out and counted are other entities, those on layers that are off or frozen, those of zero length and duplicates. The
    nozzle comes from the origin.

    Args:
        path: a file that ends in ``.dxf``, text or binary.

    Raises:
        InvalidInput: no such file, not a DXF file, unknown units, an entity that cannot be read, nothing to cut, or
            a journey whose length is outside :data:`LENGTH_RANGE`.
    """
    file = Path(path)
    document = _document(file)
    units, scale = _units(file, document)
    curves, layers, skipped = _curves(file, document, scale)
    contours = _joined(curves)
    if not contours:
        left_out = ", ".join(f"{what} ({n})" for what, n in skipped.items()) or "nothing"
        raise InvalidInput(f"{file}: nothing to cut in it; what is cut: {', '.join(CUT)}; skipped: {left_out}")
    ordered = _ordered(contours)
    drawing = Drawing(file.stem, [p for p, _ in ordered], [c for _, c in ordered], units, layers, dict(skipped))
    _check_length(file, drawing)
    return drawing


def journey(drawing: Drawing) -> Contour:
    """The whole drawing as one path, resampled, with the beam off between contours."""
    return resample(drawing.name, list(drawing.pieces))


def _document(file: Path) -> Any:
    """The file as the DXF reader's document."""
    if not file.is_file():
        raise InvalidInput(f"{file}: no such file")
    if file.suffix.lower() != ".dxf":
        raise InvalidInput(f"{file}: '{file.suffix}' files cannot be read; only DXF is read so far")
    import ezdxf  # slow

    try:
        return ezdxf.readfile(file)
    except Exception as error:  # damaged files raise whatever the damage leads to
        raise InvalidInput(f"{file}: cannot be read as DXF: {error}") from None


def _units(file: Path, document: Any) -> tuple[str, float]:
    """Name and size in mm of the drawing's unit; mm where the file names none."""
    code = _header(file, document, "$INSUNITS", 4)
    if code == 0:
        code = 1 if _header(file, document, "$MEASUREMENT", 1) == 0 else 4
    if code not in UNITS:
        allowed = ", ".join(f"{known} ({name})" for known, (name, _) in UNITS.items())
        raise InvalidInput(f"{file}: $INSUNITS = {code} is not supported; allowed: 0 (unitless), {allowed}")
    return UNITS[code]


def _header(file: Path, document: Any, variable: str, missing: int) -> int:
    """A header variable, or ``missing``; the reader makes up a header (in metres) for files that have none."""
    return document.header.get(variable, missing) if variable.encode() in file.read_bytes() else missing


def _check_length(file: Path, drawing: Drawing) -> None:
    low, high = LENGTH_RANGE
    length = drawing.cut_length + drawing.move_length
    if not low <= length <= high:
        raise InvalidInput(
            f"{file}: a journey of {length:g} mm ({drawing.cut_length:g} mm of it cut) is out of range; "
            f"allowed: {low:g} to {high:g} mm; the drawing was read in {drawing.units}"
        )


# Entities to polylines


def _curves(file: Path, document: Any, scale: float) -> tuple[list[Points], list[str], Counter[str]]:
    """What is cut as polylines in mm, its layers, and what was skipped."""
    hidden = {layer.dxf.name.casefold() for layer in document.layers if layer.is_off() or layer.is_frozen()}
    curves: dict[bytes, Points] = {}
    layers: dict[str, None] = {}
    skipped: Counter[str] = Counter()
    for entity, layer in _entities(file, document.modelspace(), hidden, skipped):
        points = _flattened(file, entity, scale)
        key = _key(points)
        if _length(points) < EXACT:
            skipped[f"{entity.dxftype()} of zero length"] += 1
        elif key in curves:
            skipped[f"duplicate {entity.dxftype()}"] += 1
        else:
            curves[key] = points
            layers[layer] = None
    return list(curves.values()), list(layers), skipped


def _entities(
    file: Path, entities: Iterable[Any], hidden: set[str], skipped: Counter[str], block_layer: str = "0", depth: int = 0
) -> Iterator[tuple[Any, str]]:
    """Every visible entity that is cut, with its layer; the rest is counted in ``skipped``."""
    if depth > NESTING:
        raise InvalidInput(f"{file}: blocks are nested more than {NESTING} deep; does one contain itself?")
    for entity in entities:
        kind = entity.dxftype()
        layer = entity.dxf.get("layer", "0")
        if layer == "0":  # inside a block this means the layer on which the block was inserted
            layer = block_layer
        if layer.casefold() in hidden:
            skipped[f"{kind} on hidden layer '{layer}'"] += 1
        elif entity.dxf.get("invisible", 0):
            skipped[f"invisible {kind}"] += 1
        elif kind == "INSERT":
            yield from _entities(file, _exploded(file, entity), hidden, skipped, layer, depth + 1)
        elif kind not in CUT:
            skipped[kind] += 1
        elif kind == "POLYLINE" and (entity.is_polygon_mesh or entity.is_poly_face_mesh):
            skipped["POLYLINE (mesh)"] += 1
        else:
            yield entity, layer


def _exploded(file: Path, insert: Any) -> list[Any]:
    """What an inserted block consists of, in place; a grid of blocks gives its single blocks."""
    try:
        return list(insert.multi_insert() if insert.mcount > 1 else insert.virtual_entities())
    except Exception as error:
        raise InvalidInput(f"{file}: {insert} cannot be read: {error}") from None


def _flattened(file: Path, entity: Any, scale: float) -> Points:
    """An entity as polyline."""
    chord = CHORD / scale
    try:
        match entity.dxftype():
            case "LINE":
                points = _plane([entity.dxf.start, entity.dxf.end])
            case "SPLINE":
                points = _spline(entity.construction_tool(), chord)
            case "LWPOLYLINE":
                points = _polyline(entity, entity.get_points("xyb"), entity.closed, chord)
            case "POLYLINE":
                points = _polyline(entity, _vertices(entity), entity.is_closed, chord)
            case "ELLIPSE":
                points = _plane(entity.flattening(_bounded(chord, entity.dxf.major_axis.magnitude)))
            case _:
                points = _plane(entity.flattening(_bounded(chord, abs(entity.dxf.radius))))
    except Exception as error:
        raise InvalidInput(f"{file}: {entity} cannot be read: {error}") from None
    if not np.isfinite(points).all():
        raise InvalidInput(f"{file}: {entity} has coordinates that are not numbers")
    return _without_repeats(points * scale)


def _bounded(chord: float, radius: float) -> float:
    """A tolerance that the reader can work with: beyond the radius, or far below it, it makes points without end."""
    return float(np.clip(chord, 1e-9 * radius, 0.5 * radius))


def _plane(vertices: Iterable[Any]) -> Points:
    """x and y of the reader's vectors."""
    return np.array([(v.x, v.y) for v in vertices], float).reshape(-1, 2)


def _vertices(polyline: Any) -> list[tuple[float, float, float]]:
    """x, y and bulge, without the control points from which CAD fitted a spline (flag 16)."""
    return [v.format("xyb") for v in polyline.vertices if not v.dxf.flags & 16]


def _polyline(entity: Any, vertices: list[tuple[float, float, float]], closed: bool, chord: float) -> Points:
    """Straight lines and arcs through ``vertices`` (x, y, bulge)."""
    corners = [complex(x, y) for x, y, _ in vertices]
    bulges = [bulge for *_, bulge in vertices]
    legs = zip(corners, corners[1:] + (corners[:1] if closed else []), bulges, strict=False)
    z = np.concatenate([corners[:1], *(_arc(a, b, bulge, chord) for a, b, bulge in legs)])
    return _plane(entity.ocs().points_to_wcs([(p.real, p.imag, 0.0) for p in z.tolist()]))


def _arc(start: complex, end: complex, bulge: float, chord: float) -> npt.NDArray[np.complex128]:
    """The points after ``start`` on an arc whose included angle is 4·atan(``bulge``), positive counter-clockwise."""
    angle = 4.0 * np.arctan(bulge)
    if abs(angle) * abs(end - start) < 1e-12 or start == end:
        return np.array([end])
    centre = 0.5 * (start + end) + 0.5j * (end - start) / np.tan(0.5 * angle)
    step = 2.0 * np.arccos(max(1.0 - chord / abs(start - centre), 0.0))
    turns = np.linspace(0.0, angle, int(np.ceil(abs(angle) / max(step, 1e-4))) + 1)[1:]
    return np.append(centre + (start - centre) * np.exp(1j * turns[:-1]), end)


def _spline(tool: Any, chord: float) -> Points:
    """A (rational) B-spline over the knots where it is defined; halved until the chords are close enough."""
    degree, knots = tool.order - 1, np.array(tool.knots(), float)
    at = np.unique(knots[degree : len(knots) - degree])
    for _ in range(3):  # a chord may touch an S-shaped span in its middle
        at = _halved(at)
    while True:
        finer = _halved(at)
        points = _plane(tool.points(finer.tolist()))
        sagitta = points[1::2] - 0.5 * (points[:-2:2] + points[2::2])
        if np.hypot(*sagitta.T).max() <= chord or len(at) > 1e5:
            return points
        at = finer


def _halved(at: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The middle of every interval added."""
    return np.insert(at, range(1, len(at)), 0.5 * (at[1:] + at[:-1]))


def _key(points: Points) -> bytes:
    """The same for two polylines that run through the same points, in either direction."""
    grid = np.round(points / EXACT) + 0.0  # no −0, whose bytes differ
    return min(grid.tobytes(), grid[::-1].tobytes())


# Polylines to contours


def _joined(curves: list[Points]) -> list[tuple[Points, bool]]:
    """Contours and whether they are closed: all that fits exactly, then what fits across a gap."""
    closed, loose = _chained(curves, EXACT)
    over_gaps, loose = _chained(loose, GAP)
    return [(p, True) for p in closed + over_gaps] + [(p, False) for p in loose if _length(p) > GAP]


def _chained(curves: list[Points], tolerance: float) -> tuple[list[Points], list[Points]]:
    """Closed and open chains of ``curves`` whose ends lie within ``tolerance`` mm, in either direction.

    The ends are the nodes of a graph and the curves its edges. A walk along unused edges that comes back to a node
    cuts off the loop: it is a contour of its own, so that two shapes that touch in a corner, or a lead-in and its
    shape, stay apart. Walks begin at the nodes of odd degree, which is where open chains end.
    """
    if not curves:
        return [], []
    nodes = _clusters(np.array([end for curve in curves for end in (curve[0], curve[-1])]), tolerance).reshape(-1, 2)
    closed = [_assembled([c], True) for c, (a, b) in zip(curves, nodes, strict=True) if a == b and _length(c) > GAP]
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
    return _without_repeats(np.concatenate([*run, run[0][:1]] if closed else run))


def _without_repeats(points: Points) -> Points:
    """``points`` without those that stand where the one before stands; both ends stay exactly."""
    if len(points) == 0:
        return points
    kept = points[np.append(True, np.hypot(*np.diff(points, axis=0).T) > EXACT)]
    kept[-1] = points[-1]
    return kept


def _length(points: Points) -> float:
    """mm."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


# Contours to cutting order


def _ordered(contours: list[tuple[Points, bool]]) -> list[tuple[Points, bool]]:
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
