"""A drawing of a corpus: read, and compared with an independent reading of the same file.

Of a DXF that is ezdxf's own: its explosion of blocks, its paths, its flattening. Of an SVG it is svgelements, which our
reader does not use. Which layers and line types are shown is decided here once more, from the file. Overlaps are taken
out of the other reading by shapely: what is cut may be as long as everything that is drawn, or as long as what is left
when it lies on something else, but no longer and no shorter.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ....envs.paths.drawing import UNITS, Drawing
from ....envs.paths.read import FORMATS, read
from .judged import ACCEPTED, FAILED, Verdict, seen

TOLERANCE = 0.005
"""Share by which length and box may differ."""

LEAST = 0.1
"""mm by which they may differ, whatever their size: two gaps of 0.05 mm, joined."""

SAMPLES = 4000
"""Vertices of each reading whose distance from the other one is measured."""

SOLID_ONLY = 300_000
"""Segments of which the overlaps are taken out; of more that would take too long, and all must be cut."""

GRID = 1e-3
"""mm, to which shapely rounds what it takes overlaps out of; else lines askew do not lie on one another for it."""

Polyline = npt.NDArray[np.float64]


def check(path: Path) -> Verdict:
    """The verdict on a drawing."""
    kind = FORMATS[path.suffix.lower()]
    drawing, verdict = seen(path, kind, read)
    if drawing is None:
        return verdict
    try:
        pieces = list(of_dxf(path, UNITS[drawing.units]) if kind == "dxf" else of_svg(path))
    except Exception as error:  # another library's failure is not ours
        return replace(verdict, reference=f"none: {type(error).__name__}: {error}"[:200])
    name = "ezdxf" if kind == "dxf" else "svgelements"
    if not pieces:
        return replace(verdict, reference=f"none: {name} finds nothing")
    deviation, problem = apart(drawing, pieces), compared(drawing, pieces)
    outcome = FAILED if problem else ACCEPTED
    return replace(verdict, outcome=outcome, reason=problem, reference=name, deviation_mm=deviation)


def compared(drawing: Drawing, pieces: list[Polyline]) -> str:
    """What differs from the other reading by more than :data:`TOLERANCE`; empty if nothing does."""
    import shapely  # type: ignore[import-untyped]

    most = sum(float(np.hypot(*np.diff(p, axis=0).T).sum()) for p in pieces)
    lines = shapely.multilinestrings([shapely.linestrings(p) for p in pieces if len(p) > 1])
    least = float(shapely.union_all(lines, grid_size=GRID).length) if sum(map(len, pieces)) < SOLID_ONLY else most
    length = drawing.cut_length
    if not least - max(TOLERANCE * least, LEAST) <= length <= most + max(TOLERANCE * most, LEAST):
        return f"{length:.3f} mm to cut; the other reading has {least:.3f} to {most:.3f} mm"
    points = np.concatenate(pieces)
    theirs = np.stack([points.min(axis=0), points.max(axis=0)])
    ours = np.stack(drawing.bounds)
    allowed = max(TOLERANCE * float(np.ptp(theirs, axis=0).max()), LEAST)
    if np.abs(theirs - ours).max() > allowed:
        return f"box {ours.round(3).tolist()} mm; that of the other reading is {theirs.round(3).tolist()} mm"
    return ""


def apart(drawing: Drawing, pieces: list[Polyline]) -> float:
    """mm, the largest distance of a vertex of one reading from the lines of the other, both ways."""
    return max(_distance(drawing.pieces, pieces), _distance(pieces, drawing.pieces))


def _distance(some: list[Polyline], others: list[Polyline]) -> float:
    import shapely

    points = np.concatenate(some)
    points = points[:: -(-len(points) // SAMPLES)]
    legs = np.concatenate([np.stack([p[:-1], p[1:]], axis=1) for p in others if len(p) > 1])
    tree = shapely.STRtree(shapely.linestrings(legs))
    _, far = tree.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
    return float(far.max())


# DXF


KINDS = ("LINE", "ARC", "CIRCLE", "LWPOLYLINE", "POLYLINE", "ELLIPSE", "SPLINE", "MLINE")


def of_dxf(path: Path, scale: float) -> Iterator[Polyline]:
    """What the model space shows, by ezdxf alone; ``scale``: mm of the drawing's unit.

    What stands in a block is flattened there and its points are moved by ezdxf's matrices: its own explosion goes wrong
    where a block that is turned stands in one that is stretched.
    """
    import ezdxf
    from ezdxf import recover
    from ezdxf.math import Matrix44

    try:
        document = ezdxf.readfile(path)
    except Exception:
        document, _ = recover.readfile(path)
    found: dict[bool, list[Polyline]] = {True: [], False: []}
    for entity, solid, matrix, clips in _shown(document, document.modelspace(), Matrix44(), ("0", "CONTINUOUS"), []):
        found[solid] += list(_flat(entity, scale, matrix, clips))
    yield from found[True] or found[False]


Shown = tuple[Any, bool, Any, list[Any]]
"""An entity, whether its line is drawn through, the matrix of its block, and the areas that it is clipped to."""


def _shown(
    document: Any, entities: Iterable[Any], matrix: Any, around: tuple[str, str], clips: list[Any]
) -> Iterator[Shown]:
    """Every entity that is cut; ``around``: layer and line type of the block that it stands in."""
    for entity in entities:
        kind, known = entity.dxftype(), entity.dxf.is_supported("layer")
        own = entity.dxf.get("layer", "0") if known else "0"
        name = around[0] if own == "0" else own
        layer = document.layers.get(name) if document.layers.has_entry(name) else None
        if (layer is not None and (layer.is_off() or layer.is_frozen())) or (known and entity.dxf.get("invisible", 0)):
            continue
        line = entity.dxf.get("linetype", "BYLAYER").upper() if known else "BYLAYER"
        if line == "BYLAYER":
            line = layer.dxf.get("linetype", "CONTINUOUS").upper() if layer is not None else "CONTINUOUS"
        line = around[1] if line == "BYBLOCK" else line
        if kind == "INSERT":
            if (block := entity.block()) is not None:
                more = _clip(entity, matrix)
                for each in entity.multi_insert() if entity.mcount > 1 else [entity]:
                    yield from _shown(document, block, each.matrix44() * matrix, (name, line), [*clips, *more])
        elif (layer is None or layer.dxf.plot) and name.lower() != "defpoints":
            if kind == "MLINE":
                yield from ((part, True, matrix, clips) for part in entity.virtual_entities())
            elif kind in KINDS and not (kind == "POLYLINE" and (entity.is_polygon_mesh or entity.is_poly_face_mesh)):
                yield entity, _solid(document, line), matrix, clips


def _clip(insert: Any, matrix: Any) -> list[Any]:
    """Area and sense of what an insert is clipped to, in the drawing's units."""
    import shapely
    from ezdxf.math import Vec3
    from ezdxf.xclip import XClip

    clip = XClip(insert)
    if not (clip.has_clipping_path and clip.is_clipping_enabled):
        return []
    path = clip.get_wcs_clipping_path()
    corners = matrix.transform_vertices([Vec3(v) for v in path.inner_polygon()])
    return [(shapely.make_valid(shapely.Polygon([(v.x, v.y) for v in corners])), path.is_inverted_clip)]


def _solid(document: Any, name: str) -> bool:
    """Whether a line type is drawn through."""
    if not document.linetypes.has_entry(name):
        return not name.startswith(("CENTER", "DASH", "HIDDEN", "PHANTOM", "DOT", "DIVIDE", "BORDER", "ACAD_ISO"))
    return not any(tag.code == 49 and tag.value <= 0 for tag in document.linetypes.get(name).pattern_tags.tags)


def _flat(entity: Any, scale: float, matrix: Any, clips: list[Any]) -> Iterator[Polyline]:
    import shapely
    from ezdxf import path as paths

    if entity.dxftype() in ("SPLINE", "ELLIPSE"):  # their paths are Bézier curves that leave a spline by 0.1 mm
        vertices = list(entity.flattening(0.002 / scale, segments=16))
    else:
        vertices = list(paths.make_path(entity).flattening(0.002 / scale, segments=16))
    if len(vertices) < 2:
        return
    points = np.array([(v.x, v.y) for v in matrix.transform_vertices(vertices)])
    shape = shapely.LineString(points)
    for area, inverted in clips:
        shape = shape.difference(area) if inverted else shape.intersection(area)
    for part in getattr(shape, "geoms", [shape]):
        if part.geom_type == "LineString" and part.length * scale > 1e-6:
            yield scale * shapely.get_coordinates(part)


# SVG


def of_svg(path: Path) -> Iterator[Polyline]:
    """What a picture shows, by svgelements alone: mm, y up from the lower edge of the page."""
    import svgelements

    if b"<switch" in path.read_bytes():
        raise NotImplementedError("svgelements draws every branch of a switch")
    picture = svgelements.SVG.parse(str(path), reify=True, ppi=96.0)
    pixel = 25.4 / 96.0
    height = float(picture.height or 0.0) if isinstance(picture.height, int | float) else 0.0
    for element in picture.elements():
        hidden = element.values.get("visibility") in ("hidden", "collapse") if hasattr(element, "values") else False
        if not isinstance(element, svgelements.Shape) or hidden or element.values.get("display") == "none":
            continue
        run: list[Polyline] = []
        for segment in svgelements.Path(element).segments():
            if isinstance(segment, svgelements.Move):
                yield from _run(run, pixel, height)
                run = []
            elif isinstance(segment, svgelements.Line | svgelements.Close):
                if segment.start is not None and segment.end is not None:
                    run.append(np.array([[*segment.start], [*segment.end]], float))
            else:
                run.append(np.array([[*segment.point(t)] for t in np.linspace(0.0, 1.0, 65)], float))
        yield from _run(run, pixel, height)


def _run(run: list[Polyline], pixel: float, height: float) -> Iterator[Polyline]:
    if run:
        points = np.concatenate(run)
        if float(np.hypot(*np.diff(points, axis=0).T).sum()) * pixel > 1e-6:
            yield np.column_stack([pixel * points[:, 0], pixel * (height - points[:, 1])])
