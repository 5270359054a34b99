"""Sheets made at random: parts as polygons with holes, which contours then lose."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from shapely import MultiPoint, Point, Polygon, affinity, box, unary_union, voronoi_polygons  # type: ignore[import-untyped]

from ....envs.paths.curve import Curve, Points
from ....envs.paths.drawing import Drawing, drawing
from ....envs.paths.order import ordered
from ....envs.paths.profile import corners_of

Random = np.random.Generator


@dataclass(frozen=True)
class RandomSheet:
    """A sheet: its parts as they are, the drawing that a file would give of it, and how it is to be cut.

    ``kind``: of :data:`KINDS`; ``kerf`` and ``lead_in``: mm.
    """

    kind: str
    parts: list[Polygon]
    drawing: Drawing
    kerf: float
    lead_in: float


def sheets(seed: int, contours: int) -> Iterator[RandomSheet]:
    """Sheets of all kinds in turn, with at least so many contours together."""
    count = number = 0
    while count < contours:
        kind = list(KINDS)[number % len(KINDS)]
        rng = np.random.default_rng([seed, number])
        parts = [p for p in KINDS[kind](rng) if not p.is_empty]
        turned = unary_union(parts).centroid
        angle = rng.choice([0.0, rng.uniform(0.0, 360.0)])
        parts = [affinity.rotate(p, angle, origin=turned) for p in parts]
        yield (sheet := of(kind, parts, rng))
        count += len(sheet.drawing.pieces)
        number += 1


def of(kind: str, parts: list[Polygon], rng: Random) -> RandomSheet:
    """A sheet of these parts, each contour begun anywhere and in either direction."""
    curves = [_curve(np.array(ring.coords), rng) for p in parts for ring in (p.exterior, *p.interiors)]
    made = drawing(kind, kind, ordered(curves))
    return RandomSheet(kind, parts, made, float(rng.uniform(0.1, 0.35)), float(rng.uniform(1.0, 6.0)))


def _curve(points: Points, rng: Random) -> Curve:
    """Mostly from a vertex, as CAD systems begin; sometimes from within an edge."""
    k = int(rng.integers(len(points) - 1))
    points = np.roll(points[:-1], -k, axis=0)
    if rng.random() < 0.2:
        points = np.concatenate([[points[0] + rng.uniform(0.1, 0.9) * (points[1] - points[0])], np.roll(points, -1, 0)])
    points = np.concatenate([points, points[:1]])
    points = points[::-1] if rng.random() < 0.5 else points
    legs = np.diff(points, axis=0)
    return Curve(points.copy(), corners_of(points), complex(*legs[0]), complex(*legs[-1]), closed=True)


# The kinds


def _holes(rng: Random) -> list[Polygon]:
    """A plate with round, square and many-cornered holes of 0.6 to 30 mm, at least 0.8 mm apart."""
    width, height = rng.uniform(40.0, 250.0, 2)
    return [_perforated(box(0.0, 0.0, width, height), rng, int(rng.integers(3, 25)), 0.3, 15.0)]


def _slots(rng: Random) -> list[Polygon]:
    """A plate with slots of 0.35 to 4 mm, round and square at their ends, 1 to 5 mm apart."""
    length, y, holes = rng.uniform(8.0, 60.0), 3.0, []
    for _ in range(int(rng.integers(3, 14))):
        wide = float(np.exp(rng.uniform(np.log(0.35), np.log(4.0))))
        middle = box(3.0 + wide, y + 0.4999 * wide, 3.0 + wide + length * rng.uniform(0.3, 1.0), y + 0.5001 * wide)
        holes.append(middle.buffer(0.5 * wide, cap_style="round" if rng.random() < 0.6 else "square", quad_segs=12))
        y += wide + rng.uniform(1.0, 5.0)
    return [box(0.0, 0.0, length + 12.0, y).difference(unary_union(holes))]


def _acute(rng: Random) -> list[Polygon]:
    """Stars and triangles with corners of 6° and more, as parts and as holes."""
    parts = []
    for k in range(int(rng.integers(4, 10))):
        shape = _spiky(rng, rng.uniform(10.0, 50.0))
        if rng.random() < 0.6:
            hole = _spiky(rng, rng.uniform(2.0, 10.0)).intersection(shape.buffer(-1.0))
            pieces = [p for p in getattr(hole, "geoms", [hole]) if p.geom_type == "Polygon" and p.area > 0.2]
            shape = shape.difference(unary_union(pieces)) if pieces else shape
        parts.append(affinity.translate(shape, 120.0 * k))
    return parts


def _nest(rng: Random) -> list[Polygon]:
    """A sheet filled with parts 1 mm apart: cells, or rectangles, some with holes."""
    width, height = rng.uniform(60.0, 200.0, 2)
    whole = box(0.0, 0.0, width, height)
    if rng.random() < 0.5:
        points = MultiPoint(rng.uniform([0.0, 0.0], [width, height], (int(rng.integers(4, 16)), 2)))
        cells = [cell.intersection(whole) for cell in voronoi_polygons(points, extend_to=whole).geoms]
    else:
        cells = _guillotine(whole, rng, 4)
    parts = [cell.buffer(-0.5, join_style="mitre") for cell in cells]
    parts = [p for p in parts if p.geom_type == "Polygon" and p.area > 20.0]
    return [_perforated(p, rng, int(rng.integers(1, 5)), 0.5, 4.0) if rng.random() < 0.4 else p for p in parts]


def _bridges(rng: Random) -> list[Polygon]:
    """Pairs of combs whose teeth stand between each other's, with 0.4 to 2 mm of scrap around them."""
    pairs = [affinity.translate(part, 0.0, 120.0 * k) for k in range(4) for part in _combs(rng)]
    return [p for p in pairs if p.area > 1.0]


def _combs(rng: Random) -> list[Polygon]:
    gap, teeth = rng.uniform(0.4, 2.0), int(rng.integers(2, 8))
    tooth, deep = rng.uniform(1.5, 6.0), rng.uniform(5.0, 25.0)
    pitch = 2.0 * (tooth + gap)
    back = [box(0.0, 0.0, teeth * pitch, 4.0)]
    comb = unary_union([*back, *(box(k * pitch, 3.0, k * pitch + tooth, 4.0 + deep) for k in range(teeth))])
    upper = affinity.rotate(comb, 180.0, origin=(0.5 * teeth * pitch, 0.5 * (8.0 + deep + gap)))
    upper = affinity.translate(upper, -(pitch - 2.0 * tooth - 2 * gap) + tooth + gap - (pitch - tooth))
    free = upper.difference(comb.buffer(gap, join_style="mitre"))
    largest = max(getattr(free, "geoms", [free]), key=lambda p: p.area)
    return [comb, largest.simplify(1e-6)]


def _islands(rng: Random) -> list[Polygon]:
    """Parts cut from the scrap of other parts' holes, with a ring of 1 to 4 mm between them."""
    outer = Point(0.0, 0.0).buffer(rng.uniform(25.0, 60.0), quad_segs=48)
    hole = affinity.scale(Point(0.0, 0.0).buffer(20.0, quad_segs=32), 1.0, rng.uniform(0.5, 1.0))
    part = hole.buffer(-rng.uniform(1.0, 4.0))
    inner = part.buffer(-rng.uniform(2.0, 5.0))
    small = [inner.buffer(-rng.uniform(1.0, 2.0))] if inner.area > 60.0 else []
    rest = part.difference(inner) if inner.area > 10.0 else part
    return [outer.difference(hole), rest, *(p for p in small if not p.is_empty and p.area > 3.0)]


KINDS: dict[str, Callable[[Random], list[Polygon]]] = {
    "holes": _holes,
    "slots": _slots,
    "acute corners": _acute,
    "nests with 1 mm gaps": _nest,
    "thin bridges of scrap": _bridges,
    "parts in holes": _islands,
}
"""What sheets are made of."""


# Shapes


def _spiky(rng: Random, radius: float) -> Polygon:
    if rng.random() < 0.3:
        angle = rng.uniform(np.radians(6.0), np.radians(35.0))
        return Polygon([(0, 0), (2 * radius, 0), (2 * radius * np.cos(angle), 2 * radius * np.sin(angle))])
    spikes = int(rng.integers(3, 11))
    turn = np.pi * np.arange(2 * spikes) / spikes
    r = np.where(np.arange(2 * spikes) % 2, radius * rng.uniform(0.15, 0.7), radius)
    return Polygon(np.stack([r * np.cos(turn), r * np.sin(turn)], axis=1))


def _perforated(plate: Polygon, rng: Random, count: int, small: float, large: float) -> Polygon:
    holes: list[Polygon] = []
    low_x, low_y, high_x, high_y = plate.bounds
    for _ in range(count):
        r = float(np.exp(rng.uniform(np.log(small), np.log(large))))
        x, y = rng.uniform(low_x, high_x), rng.uniform(low_y, high_y)
        kind = rng.integers(4)
        if kind == 0:
            hole = Point(x, y).buffer(r, quad_segs=int(rng.integers(6, 40)))
        elif kind == 1:
            hole = box(x - r, y - r * rng.uniform(0.2, 1.0), x + r, y + r)
        elif kind == 2:
            angle = np.sort(rng.uniform(0.0, 2 * np.pi, int(rng.integers(3, 9))))
            hole = Polygon(np.stack([x + r * np.cos(angle), y + r * np.sin(angle)], axis=1))
        else:  # a D, round on one side
            hole = Point(x, y).buffer(r, quad_segs=16).intersection(box(x - r, y - r, x + 0.4 * r, y + r))
        if hole.area > 0.1 and plate.buffer(-0.8).contains(hole) and all(hole.distance(o) > 0.8 for o in holes):
            holes.append(hole)
    return plate.difference(unary_union(holes)) if holes else plate


def _guillotine(cell: Polygon, rng: Random, depth: int) -> list[Polygon]:
    low_x, low_y, high_x, high_y = cell.bounds
    if depth == 0 or min(high_x - low_x, high_y - low_y) < 12.0:
        return [cell]
    share = rng.uniform(0.25, 0.75)
    if high_x - low_x > high_y - low_y:
        at = low_x + share * (high_x - low_x)
        halves = [box(low_x, low_y, at, high_y), box(at, low_y, high_x, high_y)]
    else:
        at = low_y + share * (high_y - low_y)
        halves = [box(low_x, low_y, high_x, at), box(low_x, at, high_x, high_y)]
    return [each for half in halves for each in _guillotine(half, rng, depth - 1)]
