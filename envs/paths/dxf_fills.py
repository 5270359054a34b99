"""DXF: the outlines of letters and of filled areas, for those who want them cut.

The outlines are the DXF reader's. Arcs of filled areas are Bézier curves there, which leave them by 0.03 % of their
radius. Letters come from a font of this computer, which may not be the drawing's own.
"""

from typing import Any

from .collected import Collected
from .curve import CHORD, Curve, linked, polyline
from .dxf_curves import Frame, outline

TEXTS = ("TEXT", "MTEXT", "ATTRIB")
FILLS = ("HATCH", "MPOLYGON", "SOLID", "TRACE", "3DFACE")


def filled(entity: Any, frame: Frame) -> list[Curve]:
    """The outlines of a filled area, those of its islands included."""
    from ezdxf import path

    if entity.dxftype() in ("HATCH", "MPOLYGON"):
        return [_shut(curve) for single in path.from_hatch(entity) for curve in outline(single, frame)]
    corners = [frame.at(v) for v in entity.wcs_vertices()]
    return [polyline([*corners, corners[0]])]


def written(entity: Any, document: Any, frame: Frame, found: Collected) -> list[Curve]:
    """The outlines of the letters of a text."""
    from ezdxf.addons import text2path
    from ezdxf.fonts import fonts

    style = entity.dxf.get("style", "Standard")
    if not document.styles.has_entry(style):
        document.styles.new(style)
    if entity.dxftype() == "MTEXT":
        return [curve for line in _lines(entity, document) for curve in written(line, document, frame, found)]
    font = fonts.font_manager.find_font_name(fonts.get_font_face(entity.font_name()))
    found.warn("letters are drawn with fonts of this computer", font)
    return [_shut(curve) for curve in outline(text2path.make_path_from_entity(entity), frame, CHORD)]


def _lines(entity: Any, document: Any) -> list[Any]:
    """The single lines of a text of several."""
    from ezdxf.addons import MTextExplode

    block = document.blocks.new_anonymous_block()
    try:
        with MTextExplode(block) as explode:
            explode.explode(entity, destroy=False)
        lines = [part for part in block if part.dxftype() == "TEXT"]
        for part in lines:
            block.unlink_entity(part)
        return lines
    finally:
        document.blocks.delete_block(block.name, safe=False)


def _shut(curve: Curve) -> Curve:
    """The curve, back to where it began."""
    first, last = curve.points[0], curve.points[-1]
    if (first == last).all():
        return curve
    return linked([curve, polyline([complex(*last), complex(*first)])])
