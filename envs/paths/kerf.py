"""Kerf compensation: the path lies half a kerf outside the part, and inside its holes."""

from dataclasses import replace

import numpy as np

from ..plant.quantity import InvalidInput
from .checks import require_closed
from .curve import Points
from .drawing import Drawing
from .profile import corners_of

_SHARE = 0.002
"""mm between an offset corner's arc and its chords."""


def compensated(drawing: Drawing, kerf: float, mitre: bool = False) -> Drawing:
    """The drawing with every contour moved by half of ``kerf`` mm away from the part.

    Contours that lie within an odd number of others are holes. Loops are taken away; corners outside the part are
    rounded, or mitred.

    Raises:
        InvalidInput: a negative kerf, an open contour, or one that vanishes or falls apart.
    """
    if kerf < 0 or not np.isfinite(kerf):
        raise InvalidInput(f"kerf = {kerf} mm; it must be 0 or more")
    if kerf == 0:
        return drawing
    require_closed(drawing)
    from shapely import Point, Polygon  # type: ignore[import-untyped]

    shapes = [Polygon(piece) for piece in drawing.pieces]
    for i, shape in enumerate(shapes):
        if not shape.is_valid:
            raise InvalidInput(
                f"drawing '{drawing.name}': contour {i + 1} crosses itself; kerf compensation needs simple contours"
            )
    moved: list[Points] = []
    for i, shape in enumerate(shapes):
        inside = sum(other.contains(Point(drawing.pieces[i][0])) for j, other in enumerate(shapes) if j != i)
        away = -0.5 * kerf if inside % 2 else 0.5 * kerf
        quarter = max(4, int(np.ceil(np.pi / 4 / np.arccos(max(1.0 - _SHARE / abs(away), 0.0)))))
        grown = shape.buffer(away, quad_segs=quarter, join_style="mitre" if mitre else "round")
        if grown.is_empty or grown.geom_type != "Polygon":
            what = "vanishes" if grown.is_empty else "falls apart"
            x, y = drawing.pieces[i].mean(axis=0)
            raise InvalidInput(
                f"drawing '{drawing.name}': contour {i + 1} near ({x:.2f}, {y:.2f}) mm {what} at a kerf of {kerf:g} mm"
            )
        ring = np.array(grown.exterior.coords)
        # Begins near where the contour began, and runs in its direction.
        if Polygon(ring).exterior.is_ccw != shape.exterior.is_ccw:
            ring = ring[::-1]
        first = int(np.hypot(*(ring - drawing.pieces[i][0]).T).argmin())
        moved.append(np.concatenate([ring[first:-1], ring[: first + 1]]))
    return replace(drawing, pieces=moved, corners=[corners_of(piece) for piece in moved])
