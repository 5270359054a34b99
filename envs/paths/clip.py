"""Clipping: the part of a curve that lies within a polygon, or outside of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import geos as shapely
from .curve import EXACT, Curve, Points, point_at, turns, way_along


@dataclass(frozen=True, eq=False)
class Clip:
    """A polygon of shapely, and whether what lies outside of it is kept."""

    area: Any
    inverted: bool

    @classmethod
    def of(cls, corners: Sequence[complex], inverted: bool) -> "Clip":
        """The polygon with ``corners``, mm."""
        shape = shapely.Polygon([(z.real, z.imag) for z in corners]) if len(corners) > 2 else shapely.Polygon()
        area = shapely.make_valid(shape)
        shapely.prepare(area)
        return cls(area, inverted)

    def inside(self, curve: Curve) -> list[Curve]:
        """The stretches of a curve that are kept, in its direction, with its corners."""
        if len(curve.points) < 2:
            return [curve]
        whole = shapely.LineString(curve.points)
        if self.area.covers(whole):
            return [] if self.inverted else [curve]
        if not self.area.intersects(whole):
            return [curve] if self.inverted else []
        places = way_along(curve.points)
        cuts = self._crossings(curve.points, places)
        kept: list[Curve] = []
        for begin, end in zip(cuts[:-1], cuts[1:], strict=True):
            if end - begin <= EXACT:
                continue
            middle = point_at(curve.points, places, 0.5 * (begin + end))
            if self.area.covers(shapely.Point(*middle)) != self.inverted:
                kept.append(_stretch(curve, places, begin, end))
        return kept

    def _crossings(self, points: Points, places: Points) -> Points:
        """Where along the polyline it meets the polygon's border, its ends included, mm, rising."""
        border, found = self.area.boundary, [places[0], places[-1]]
        legs = shapely.linestrings(np.stack([points[:-1], points[1:]], axis=1))
        for i in np.flatnonzero(shapely.intersects(legs, border)):
            for x, y in shapely.get_coordinates(shapely.intersection(legs[i], border)):
                found.append(places[i] + min(np.hypot(*((x, y) - points[i])), places[i + 1] - places[i]))
        return np.unique(found)


def _stretch(curve: Curve, places: Points, begin: float, end: float) -> Curve:
    """The part of a curve between two places along it, mm."""
    within = np.flatnonzero((places > begin + EXACT) & (places < end - EXACT))
    first, final = (point_at(curve.points, places, place) for place in (begin, end))
    points = np.array([first, *curve.points[within], final])
    corners = np.flatnonzero(np.isin(within, curve.corners)) + 1
    z = points[:, 0] + 1j * points[:, 1]
    ahead, behind = z[1] - z[0], z[-1] - z[-2]
    # At the curve's own ends its own tangents are truer than its chords.
    start = curve.start if begin <= EXACT and not turns(curve.start, ahead) else ahead
    last = curve.end if end >= places[-1] - EXACT and not turns(curve.end, behind) else behind
    return Curve(points, corners.astype(np.int64), complex(start), complex(last))
