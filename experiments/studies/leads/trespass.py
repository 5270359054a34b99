"""What is wrong with a lead-in, by shapely and the parts as they are; nothing here asks the planner's own check."""

import numpy as np
import shapely  # type: ignore[import-untyped]
from shapely import LineString, MultiPolygon, Point, Polygon
from shapely.geometry.base import BaseGeometry  # type: ignore[import-untyped]

from ....envs.paths.route import Cut

WRONG = ("in a part", "on an edge", "along an edge", "through a part", "in a neighbour")
"""Faults: the pierce point lies in a part; its hole, half a kerf wide, reaches an edge; half of the way or more runs
beside an edge; the way leads through a part; its kerf takes something from a part that the contour's does not take."""

NEAR = 1e-6
"""mm."""

BESIDE = 0.1
"""A lead-in runs beside an edge where it is nearer to it than this share of its pierce point's distance."""


class Material:
    """What must stay whole: the parts, prepared for many questions."""

    def __init__(self, parts: list[Polygon]) -> None:
        self.parts = [p for each in parts for p in getattr(each, "geoms", [each])]
        self.edges = [p.boundary for p in self.parts]
        self._tree, self._lines = shapely.STRtree(self.parts), shapely.STRtree(self.edges)
        shapely.prepare(self.parts)

    def near(self, what: BaseGeometry, reach: float = 0.0) -> list[Polygon]:
        """Parts within ``reach`` mm."""
        return [self.parts[i] for i in self._tree.query(what.buffer(reach + NEAR))]

    def gap(self, points: np.ndarray) -> np.ndarray:
        """mm from points to the nearest edge of any part."""
        return self._lines.query_nearest(shapely.points(points), all_matches=False, return_distance=True)[1]


def wrong(cut: Cut, material: Material, kerf: float) -> list[str]:
    """The faults of a cut's lead-in, of :data:`WRONG`; none if it has no lead-in."""
    if len(cut.way) < 2:
        return []
    way, start, half = LineString(cut.way), Point(cut.way[0]), 0.5 * kerf
    found = []
    beside = material.near(way, half)
    distance = float(material.gap(cut.way[:1])[0])
    if any(p.contains(start) for p in beside) and distance > NEAR:
        found.append("in a part")
    if distance < half - NEAR:
        found.append("on an edge")
    samples = shapely.get_coordinates(shapely.line_interpolate_point(way, np.linspace(0.0, 1.0, 201), normalized=True))
    if (material.gap(samples) < BESIDE * max(distance, NEAR)).mean() > 0.5:
        found.append("along an edge")
    if sum(way.intersection(p.buffer(-1e-3)).length for p in beside) > 1e-3:
        found.append("through a part")
    taken = way.buffer(half, quad_segs=16)
    here = LineString(cut.path).intersection(taken.buffer(4.0 * half + 1.0))
    corridor = here.buffer(half * (1.0 + 1e-3) + NEAR, quad_segs=32)
    extra = taken.difference(corridor)
    if sum(extra.intersection(p).area for p in beside) > 1e-4 * half:
        found.append("in a neighbour")
    return found


def parts_of(pieces: list[np.ndarray]) -> MultiPolygon:
    """The parts that closed contours enclose, holes left out, as GEOS builds areas of lines."""
    lines = shapely.union_all([LineString(p) for p in pieces])
    area = shapely.build_area(shapely.geometrycollections([lines]))
    return MultiPolygon([p for p in getattr(area, "geoms", [area]) if p.geom_type == "Polygon"])
