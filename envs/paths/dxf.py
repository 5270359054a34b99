"""DXF drawings.

The third dimension is dropped. Bulges and splines are evaluated here and not by the library where its own way would
leave the tolerance (bulges through Bézier curves) or the curve (splines whose ends are not clamped).
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..plant.quantity import InvalidInput, did_you_mean
from .drawing import CHORD, Curves, Drawing, Points, arc, assembled, without_repeats

UNITS = {1: ("inches", 25.4), 4: ("mm", 1.0), 5: ("cm", 10.0), 6: ("m", 1000.0)}
"""Code of $INSUNITS: name, mm."""

CUT = ("LINE", "ARC", "CIRCLE", "LWPOLYLINE", "POLYLINE", "ELLIPSE", "SPLINE")
"""Entities that are cut; the contents of INSERT are looked into, everything else is skipped."""

NESTING = 16
"""Blocks within blocks; more means that a block contains itself."""


def read_dxf(path: str | Path, layers: Sequence[str] | None = None, units: str | None = None) -> Drawing:
    """The contours of a DXF drawing, inner ones before those that contain them, otherwise the nearest next.

    Cut are the lines, arcs, circles, ellipses, splines and 2D polylines of the model space, also inside blocks. Left
    out and counted are other entities, those on layers that are off, frozen or not chosen, those of zero length and
    duplicates. The nozzle comes from the origin.

    Args:
        path: a file that ends in ``.dxf``, text or binary.
        layers: what is cut; None: all layers.
        units: ``"mm"``, ``"inches"`` …, whatever the header says; None: the header's, or mm if it names none.

    Raises:
        InvalidInput: no such file, not a DXF file, unknown units or layer, an entity that cannot be read, nothing to
            cut, or a journey whose length is out of range.
    """
    file = Path(path)
    document = _document(file)
    named, scale, warnings = _units(file, document, units)
    curves = _curves(file, document, scale, _chosen(file, document, layers))
    return assembled(file, curves, named, ", ".join(CUT), warnings)


def _chosen(file: Path, document: Any, layers: Sequence[str] | None) -> set[str] | None:
    known = {layer.dxf.name.casefold(): layer.dxf.name for layer in document.layers}
    for layer in layers or ():
        if layer.casefold() not in known:
            raise InvalidInput(f"{file}: no layer '{layer}'; {did_you_mean(layer, known.values())}")
    return {layer.casefold() for layer in layers} if layers else None


def _document(file: Path) -> Any:
    """The file as the DXF reader's document."""
    if not file.is_file():
        raise InvalidInput(f"{file}: no such file")
    import ezdxf  # slow

    try:
        return ezdxf.readfile(file)
    except Exception as error:  # damaged files raise whatever the damage leads to
        raise InvalidInput(f"{file}: cannot be read as DXF: {error}") from None


def _units(file: Path, document: Any, wanted: str | None) -> tuple[str, float, tuple[str, ...]]:
    """Name and size in mm of the drawing's unit; mm where the file names none, with a warning."""
    if wanted is not None:
        by_name = dict(UNITS.values())
        if wanted not in by_name:
            raise InvalidInput(f"{file}: unknown units '{wanted}'; {did_you_mean(wanted, by_name)}")
        return wanted, by_name[wanted], ()
    code, warnings = _header(file, document, "$INSUNITS", 0), ()
    if code == 0:
        metric = _header(file, document, "$MEASUREMENT", 1) != 0
        code = 4 if metric else 1
        warnings = (f"{file}: the header names no unit; read as {UNITS[code][0]}",)
    if code not in UNITS:
        allowed = ", ".join(f"{known} ({name})" for known, (name, _) in UNITS.items())
        raise InvalidInput(f"{file}: $INSUNITS = {code} is not supported; allowed: 0 (unitless), {allowed}")
    return *UNITS[code], warnings


def _header(file: Path, document: Any, variable: str, missing: int) -> int:
    """A header variable, or ``missing``; the reader makes up a header (in metres) for files that have none."""
    return document.header.get(variable, missing) if variable.encode() in file.read_bytes() else missing


# Entities to polylines


def _curves(file: Path, document: Any, scale: float, chosen: set[str] | None) -> Curves:
    """What is cut as polylines in mm."""
    hidden = {layer.dxf.name.casefold() for layer in document.layers if layer.is_off() or layer.is_frozen()}
    curves = Curves()
    for entity, layer in _entities(file, document.modelspace(), hidden, curves.skipped):
        if chosen is not None and layer.casefold() not in chosen:
            curves.skipped[f"{entity.dxftype()} on layer '{layer}', not chosen"] += 1
        else:
            curves.add(_flattened(file, entity, scale), entity.dxftype(), layer)
    return curves


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
    return without_repeats(points * scale)


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
    z = np.concatenate([corners[:1], *(arc(a, b, bulge, chord) for a, b, bulge in legs)])
    return _plane(entity.ocs().points_to_wcs([(p.real, p.imag, 0.0) for p in z.tolist()]))


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
