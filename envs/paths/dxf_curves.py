"""DXF: what an entity is as a curve, seen from above.

Arcs, bulges, ellipses and splines are evaluated here and not by the DXF reader, where its own way would leave the
tolerance (bulges through Bézier curves) or the curve (splines whose ends are not clamped), and because it does not give
the tangents. An entity lies where its own axes (OCS), its elevation and the blocks around it put it; a circle that is
tilted is cut as the ellipse that one sees.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .curve import CHORD, Complex, Curve, arc, line, linked, polyline, rational, smooth, strokes

CUT = ("LINE", "ARC", "CIRCLE", "LWPOLYLINE", "POLYLINE", "ELLIPSE", "SPLINE", "MLINE")
"""Entities that are cut; the contents of INSERT are looked into, everything else is skipped."""


class Frame(NamedTuple):
    """Where the axes of some space lie on the sheet: x and y as complex numbers, mm; the height is dropped."""

    x: complex
    y: complex
    z: complex
    origin: complex

    def at(self, point: Any) -> complex:
        """A point, one of the reader's vectors."""
        return point.x * self.x + point.y * self.y + point.z * self.z + self.origin

    def along(self, vector: Any) -> complex:
        """A direction."""
        return vector.x * self.x + vector.y * self.y + vector.z * self.z

    def within(self, matrix: Any) -> "Frame":
        """The frame of a space that one of the reader's matrices puts into this one."""
        from ezdxf.math import Vec3

        x, y, z, origin = (Vec3(row[:3]) for row in matrix.rows())
        return Frame(self.along(x), self.along(y), self.along(z), self.at(origin))

    def of(self, entity: Any) -> "Frame":
        """The frame of an entity's own axes."""
        ocs = entity.ocs()
        if not ocs.transform:
            return self
        return Frame(self.along(ocs.ux), self.along(ocs.uy), self.along(ocs.uz), self.origin)

    @property
    def turn(self) -> int:
        """1 where a circle of the plane z = 0 stays a circle, −1 where it is mirrored besides, 0 where it does not."""
        for sign in (1, -1):
            if abs(self.y - sign * 1j * self.x) <= 1e-12 * abs(self.x):
                return sign
        return 0


def world(scale: float) -> Frame:
    """The model space; ``scale``: mm of the drawing's unit."""
    return Frame(complex(scale), 1j * scale, 0j, 0j)


def curve_of(entity: Any, frame: Frame) -> Curve:
    """An entity of a kind in :data:`CUT` except MLINE as curve, mm.

    Raises:
        ValueError: coordinates that are not numbers; others may come from the DXF reader.
    """
    with np.errstate(all="ignore"):  # what is not a number is found below
        curve = _curve(entity, frame)
    if not np.isfinite(curve.points).all():
        raise ValueError("coordinates that are not numbers")
    return curve


def _curve(entity: Any, frame: Frame) -> Curve:
    dxf = entity.dxf
    match entity.dxftype():
        case "LINE":
            return line(frame.at(dxf.start), frame.at(dxf.end))
        case "CIRCLE":
            return _round(frame.of(entity), dxf.center, dxf.radius, 0.0, 360.0)
        case "ARC":
            return _round(frame.of(entity), dxf.center, dxf.radius, dxf.start_angle, dxf.end_angle)
        case "LWPOLYLINE":
            return _bulged(frame.of(entity), entity.get_points("xyb"), dxf.get("elevation", 0.0), entity.closed)
        case "POLYLINE":
            return _polyline(entity, frame)
        case "ELLIPSE":
            return _ellipse(entity, frame)
        case _:
            return spline(entity.construction_tool(), frame)


def _round(frame: Frame, centre: Any, radius: float, begin: float, end: float) -> Curve:
    """Counter-clockwise from angle to angle, degrees."""
    from ezdxf.math import arc_angle_span_deg

    span = np.radians(arc_angle_span_deg(begin, end))
    middle, from_, radius = frame.at(centre), np.radians(begin), abs(radius)
    whole = bool(span >= 2.0 * np.pi * (1.0 - 1e-15))

    def at(angle: npt.NDArray[np.float64]) -> Complex:
        return middle + radius * (np.cos(angle) * frame.x + np.sin(angle) * frame.y)

    if not frame.turn:
        return smooth(at, from_ + span * np.linspace(0.0, 1.0, 5))
    first, last = at(np.array([from_, from_ + span]))
    return arc(middle, first, first if whole else last, frame.turn * span)


def _polyline(entity: Any, frame: Frame) -> Curve:
    """A polyline of the old kind, flat or in space, without the control points of a fitted spline (flag 16)."""
    vertices = [v for v in entity.vertices if not v.dxf.flags & 16]
    if entity.is_3d_polyline:
        z = [frame.at(v.dxf.location) for v in vertices]
        return polyline(z + z[:1] if entity.is_closed else z)
    height = entity.dxf.get("elevation")
    points = [v.format("xyb") for v in vertices]
    return _bulged(frame.of(entity), points, height.z if height is not None else 0.0, entity.is_closed)


def _bulged(frame: Frame, vertices: Iterable[Any], height: float, closed: bool) -> Curve:
    """Straight lines and arcs through ``vertices`` (x, y, bulge)."""
    rows = np.array([tuple(v) for v in vertices], float).reshape(-1, 3)
    own, bulges = rows[:, 0] + 1j * rows[:, 1], rows[:, 2]
    if closed:
        own, bulges = np.append(own, own[:1]), np.append(bulges, 0.0)
    lifted = frame._replace(origin=frame.origin + height * frame.z)
    if not bulges[:-1].any():
        return polyline(_image(lifted, own))
    seen, rows_ = _image(lifted, own).tolist(), list(zip(own.tolist(), bulges.tolist(), strict=True))
    return linked(
        _bulge(lifted, a, b, bulge, first, last)
        for (a, bulge), (b, _), first, last in zip(rows_, rows_[1:], seen, seen[1:], strict=False)
    )


def _image(frame: Frame, z: npt.ArrayLike) -> Complex:
    """Points x + jy of a frame's plane z = 0 on the sheet."""
    z = np.asarray(z, np.complex128)
    return np.asarray(z.real * frame.x + z.imag * frame.y + frame.origin)


def _bulge(frame: Frame, start: complex, end: complex, bulge: float, first: complex, last: complex) -> Curve:
    """An arc whose included angle is 4·atan(``bulge``), positive counter-clockwise; 0 is a straight line. ``first`` and
    ``last``: where its ends are on the sheet."""
    if bulge == 0.0:
        return line(first, last)
    angle = 4.0 * np.arctan(bulge)
    if abs(angle) * abs(end - start) < 1e-12 or start == end:
        return line(first, last)
    centre = 0.5 * (start + end) + 0.5j * (end - start) / np.tan(0.5 * angle)
    if frame.turn:
        return arc(complex(_image(frame, centre)), first, last, frame.turn * angle)

    def at(part: npt.NDArray[np.float64]) -> Complex:
        z = _image(frame, centre + (start - centre) * np.exp(1j * angle * part))
        return np.where(part == 0.0, first, np.where(part == 1.0, last, z))

    return smooth(at, np.linspace(0.0, 1.0, 3))


def _ellipse(entity: Any, frame: Frame) -> Curve:
    from ezdxf.math import arc_angle_span_rad

    begin = entity.dxf.start_param
    span = arc_angle_span_rad(begin, entity.dxf.end_param)
    centre, major, minor = (
        frame.at(entity.dxf.center),
        frame.along(entity.dxf.major_axis),
        frame.along(entity.minor_axis),
    )
    return smooth(lambda t: centre + major * np.cos(t) + minor * np.sin(t), begin + span * np.linspace(0.0, 1.0, 5))


def spline(tool: Any, frame: Frame) -> Curve:
    """A (rational) B-spline over the knots where it is defined."""
    degree, knots = tool.order - 1, np.array(tool.knots(), float)
    points = np.array([frame.at(p) for p in tool.control_points], np.complex128)
    given = tool.weights()
    weights = np.array(given, float) if len(given) else np.ones(len(points))
    return rational(knots, points, weights, degree, np.unique(knots[degree : len(knots) - degree]))


def outline(path: Any, frame: Frame, chord: float = CHORD) -> list[Curve]:
    """The single outlines of one of the reader's paths (of a letter or a filled area); each straight stretch a line."""
    found = []
    for single in path.sub_paths():
        steps = [tuple(map(frame.at, (*step[1:], step[0]))) for step in single.commands()]  # their ends come first
        if steps:
            found.append(linked(strokes(frame.at(single.start), steps, chord)))
    return found
