"""DXF: what the model space of a drawing shows, as curves.

The third dimension is dropped. Arcs, bulges, ellipses and splines are evaluated here and not by the DXF reader, where
its own way would leave the tolerance (bulges through Bézier curves) or the curve (splines whose ends are not clamped),
and because it does not give the tangents.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..plant.quantity import InvalidInput
from .contours import joined, ordered
from .curve import Complex, Curve, arc, line, linked, polyline, smooth
from .drawing import UNITS, Collected, Drawing, chosen, drawing, unit

INSUNITS = {1: "inches", 4: "mm", 5: "cm", 6: "m"}
"""Code of $INSUNITS: name of the unit."""

CUT = ("LINE", "ARC", "CIRCLE", "LWPOLYLINE", "POLYLINE", "ELLIPSE", "SPLINE")
"""Entities that are cut; the contents of INSERT are looked into, everything else is skipped."""

NESTING = 16
"""Blocks within blocks; more means that a block contains itself."""


def read_dxf(
    path: str | Path, *, layers: tuple[str, ...] | list[str] | str | None = None, units: str | None = None
) -> Drawing:
    """The contours of a DXF drawing, inner ones before those that contain them, otherwise the nearest next.

    Cut are the lines, arcs, circles, ellipses, splines and 2D polylines of the model space, also inside blocks. Left
    out and counted are other entities, those on layers that are off or frozen, those of zero length and duplicates. The
    nozzle comes from the origin.

    Args:
        path: a DXF file, text or binary.
        layers: names of the layers that are cut, in any case; None: all.
        units: what the file's numbers are in, instead of what its header says.

    Raises:
        InvalidInput: not a DXF file, unknown units or layer, an entity that cannot be read, nothing to cut, or a
            journey whose length is out of range.
    """
    file = Path(path)
    document = _document(file)
    name, warnings = (unit(units)[0], []) if units is not None else _units(file, document)
    found = Collected()
    wanted = chosen(file, layers, _layers(document))
    hidden = {layer.dxf.name.casefold() for layer in document.layers if layer.is_off() or layer.is_frozen()}
    for entity, layer in _entities(file, document.modelspace(), hidden, wanted, found):
        found.add(entity.dxftype(), _curve(file, entity, UNITS[name]), layer)
    contours = ordered(joined(list(found.curves.values())))
    return drawing(
        file, file.stem, contours, name, list(found.layers), found.skipped, warnings=warnings, cuts=", ".join(CUT)
    )


def _document(file: Path) -> Any:
    """The file as the DXF reader's document."""
    import ezdxf  # slow

    try:
        return ezdxf.readfile(file)
    except Exception as error:  # damaged files raise whatever the damage leads to
        raise InvalidInput(f"{file}: cannot be read as DXF: {error}") from None


def _units(file: Path, document: Any) -> tuple[str, list[str]]:
    """Name of the drawing's unit, and a warning where the file names none."""
    code, measurement = _header(file, document, "$INSUNITS"), _header(file, document, "$MEASUREMENT")
    if code is None:
        also = ", although $MEASUREMENT says inches" if measurement == 0 else ""
        return "mm", [f"no unit in the header, read as mm{also}; units= reads it otherwise"]
    if code == 0:
        name = "inches" if measurement == 0 else "mm"
        return name, [f"no unit in the header, read as {name} by its $MEASUREMENT; units= reads it otherwise"]
    if code not in INSUNITS:
        allowed = ", ".join(f"{known} ({name})" for known, name in INSUNITS.items())
        raise InvalidInput(f"{file}: $INSUNITS = {code} is not supported; allowed: 0 (unitless), {allowed}")
    return INSUNITS[code], []


def _header(file: Path, document: Any, variable: str) -> int | None:
    """A header variable, if it is there; the reader makes up a header (in metres) for files that have none."""
    return document.header.get(variable, None) if variable.encode() in file.read_bytes() else None


def _layers(document: Any) -> list[str]:
    """Names of the layers that are declared or used."""
    declared = [layer.dxf.name for layer in document.layers]
    used = (entity.dxf.get("layer", "0") for entity in document.chain_layouts_and_blocks())
    return list({name.casefold(): name for name in (*used, *declared)}.values())


# Entities


def _entities(
    file: Path,
    entities: Iterable[Any],
    hidden: set[str],
    wanted: set[str] | None,
    found: Collected,
    block_layer: str = "0",
    depth: int = 0,
) -> Iterator[tuple[Any, str]]:
    """Every visible entity that is cut, with its layer; the rest is counted."""
    if depth > NESTING:
        raise InvalidInput(f"{file}: blocks are nested more than {NESTING} deep; does one contain itself?")
    for entity in entities:
        kind = entity.dxftype()
        layer = entity.dxf.get("layer", "0")
        if layer == "0":  # inside a block this means the layer on which the block was inserted
            layer = block_layer
        if layer.casefold() in hidden:
            found.skipped[f"{kind} on hidden layer '{layer}'"] += 1
        elif entity.dxf.get("invisible", 0):
            found.skipped[f"invisible {kind}"] += 1
        elif kind == "INSERT":
            yield from _entities(file, _exploded(file, entity), hidden, wanted, found, layer, depth + 1)
        elif wanted is not None and layer.casefold() not in wanted:
            found.skipped[f"{kind} on layer '{layer}'"] += 1
        elif kind not in CUT:
            found.skipped[kind] += 1
        elif kind == "POLYLINE" and (entity.is_polygon_mesh or entity.is_poly_face_mesh):
            found.skipped["POLYLINE (mesh)"] += 1
        else:
            yield entity, layer


def _exploded(file: Path, insert: Any) -> list[Any]:
    """What an inserted block consists of, in place; a grid of blocks gives its single blocks."""
    try:
        return list(insert.multi_insert() if insert.mcount > 1 else insert.virtual_entities())
    except Exception as error:
        raise InvalidInput(f"{file}: {insert} cannot be read: {error}") from None


def _curve(file: Path, entity: Any, scale: float) -> Curve:
    """An entity as curve; ``scale``: mm of the drawing's unit."""
    dxf = entity.dxf
    try:
        match entity.dxftype():
            case "LINE":
                curve = line(scale * _point(dxf.start), scale * _point(dxf.end))
            case "CIRCLE":
                curve = _placed(entity, _arc(scale, dxf, 0.0, 360.0))
            case "ARC":
                curve = _placed(entity, _arc(scale, dxf, dxf.start_angle, dxf.end_angle))
            case "LWPOLYLINE":
                curve = _placed(entity, _bulged(scale, entity.get_points("xyb"), entity.closed))
            case "POLYLINE":
                curve = _placed(entity, _bulged(scale, _vertices(entity), entity.is_closed))
            case "ELLIPSE":
                curve = _ellipse(scale, entity)
            case _:
                curve = _spline(scale, entity.construction_tool())
    except Exception as error:
        raise InvalidInput(f"{file}: {entity} cannot be read: {error}") from None
    if not np.isfinite(curve.points).all():
        raise InvalidInput(f"{file}: {entity} has coordinates that are not numbers")
    return curve


def _point(vector: Any) -> complex:
    """x and y of one of the reader's vectors."""
    return complex(vector.x, vector.y)


def _placed(entity: Any, curve: Curve) -> Curve:
    """A plane curve in the world, whose axes its own may not be: seen from below it is mirrored."""
    ocs = entity.ocs()
    if not ocs.transform:
        return curve

    def image(z: Complex) -> Complex:
        return np.array([_point(v) for v in ocs.points_to_wcs([(p.real, p.imag, 0.0) for p in z.tolist()])])

    return curve.mapped(image)


def _arc(scale: float, dxf: Any, begin: float, end: float) -> Curve:
    """Counter-clockwise from angle to angle, degrees."""
    from ezdxf.math import arc_angle_span_deg

    centre, radius = scale * _point(dxf.center), scale * abs(dxf.radius)
    span = arc_angle_span_deg(begin, end)
    first = centre + radius * np.exp(1j * np.radians(begin))
    last = first if span == 360.0 else centre + radius * np.exp(1j * np.radians(begin + span))
    return arc(centre, first, last, np.radians(span))


def _vertices(entity: Any) -> list[tuple[float, float, float]]:
    """x, y and bulge, without the control points from which CAD fitted a spline (flag 16)."""
    return [v.format("xyb") for v in entity.vertices if not v.dxf.flags & 16]


def _bulged(scale: float, vertices: list[tuple[float, float, float]], closed: bool) -> Curve:
    """Straight lines and arcs through ``vertices`` (x, y, bulge)."""
    z = np.array([complex(scale * x, scale * y) for x, y, _ in vertices], np.complex128)
    bulges = np.array([bulge for *_, bulge in vertices], float)
    if closed:
        z, bulges = np.append(z, z[:1]), np.append(bulges, 0.0)
    if not bulges[:-1].any():
        return polyline(z)
    legs = zip(z[:-1].tolist(), z[1:].tolist(), bulges[:-1].tolist(), strict=True)
    return linked(_bulge(a, b, bulge) for a, b, bulge in legs)


def _bulge(start: complex, end: complex, bulge: float) -> Curve:
    """An arc whose included angle is 4·atan(``bulge``), positive counter-clockwise; 0 is a straight line."""
    angle = 4.0 * np.arctan(bulge)
    if abs(angle) * abs(end - start) < 1e-12 or start == end:
        return line(start, end)
    centre = 0.5 * (start + end) + 0.5j * (end - start) / np.tan(0.5 * angle)
    return arc(centre, start, end, angle)


def _ellipse(scale: float, entity: Any) -> Curve:
    from ezdxf.math import arc_angle_span_rad

    begin = entity.dxf.start_param
    span = arc_angle_span_rad(begin, entity.dxf.end_param)
    centre, major, minor = (_point(v) * scale for v in (entity.dxf.center, entity.dxf.major_axis, entity.minor_axis))
    return smooth(lambda t: centre + major * np.cos(t) + minor * np.sin(t), begin + span * np.linspace(0.0, 1.0, 5))


def _spline(scale: float, tool: Any) -> Curve:
    """A (rational) B-spline over the knots where it is defined."""
    degree, knots = tool.order - 1, np.array(tool.knots(), float)

    def at(t: npt.NDArray[np.float64]) -> Complex:
        return scale * np.array([_point(v) for v in tool.points(t.tolist())], np.complex128)

    return smooth(at, np.unique(knots[degree : len(knots) - degree]))
