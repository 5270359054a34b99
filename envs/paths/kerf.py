"""Kerf compensation: the path lies half a kerf outside the part, and inside its holes.

What a kerf is too wide for is told in warnings that name the contour: a hole that vanishes is left out, one that falls
apart is cut in pieces, a gap that closes leaves what it encloses as a hole. Open contours have no side; they and those
that cross themselves stay as drawn.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from ..engine.quantity import InvalidInput
from . import geos as shapely
from .curve import Points
from .drawing import Drawing
from .naming import named
from .nesting import around_it, nested
from .profile import corners_of

_SHARE = 0.002
"""mm between an offset corner's arc and its chords."""


def compensated(drawing: Drawing, kerf: float) -> Drawing:
    """The drawing with every closed contour moved by half of ``kerf`` mm away from the part.

    Contours that lie within an odd number of others are holes. Loops are taken away; corners outside the part are
    rounded. The drawing's warnings tell what did not come out as drawn.

    Raises:
        InvalidInput: a negative kerf, or a programme.
    """
    if kerf < 0 or not np.isfinite(kerf):
        raise InvalidInput(f"kerf = {kerf} mm; it must be 0 or more")
    if kerf == 0:
        return drawing
    if drawing.programmed:
        raise InvalidInput(
            f"kerf = {kerf:g} mm: '{drawing.name}' is a programme and is cut as programmed; allowed: 0, with the kerf "
            "compensated by the CAM system that wrote it, or a drawing"
        )
    nesting = nested(drawing.pieces, drawing.closed)
    moved: list[Points] = []
    closed: list[bool] = []
    origin: list[int] = []
    told: dict[str, list[int]] = {}
    for i, (piece, shut) in enumerate(zip(drawing.pieces, drawing.closed, strict=True)):
        shape = shapely.polygons(piece) if nesting.area[i] else None
        if shape is None or not shape.is_valid:
            what = "is open" if not shut else "encloses nothing" if shape is None else "crosses itself"
            told.setdefault(f"{what}: it is cut as drawn, without compensation", []).append(i)
            rings = [piece]
        else:
            rings, trouble = _moved(shape, piece, -0.5 * kerf if nesting.hole[i] else 0.5 * kerf)
            if trouble:
                told.setdefault(f"{trouble} at a kerf of {kerf:g} mm", []).append(i)
        moved += rings
        closed += [shut] * len(rings)
        origin += [i] * len(rings)
    close = _meeting(moved, closed, origin)
    told.setdefault(f"is nearer to another than the kerf of {kerf:g} mm: one cuts into the other", []).extend(close)
    warnings = [line for what, those in told.items() for line in named(drawing, sorted(set(those)), what)]
    kept = [drawing.corners[i] if r is drawing.pieces[i] else corners_of(r) for i, r in zip(origin, moved, strict=True)]
    numbers, warnings = [drawing.number(i) for i in origin], [*drawing.warnings, *warnings]
    return replace(drawing, pieces=moved, closed=closed, corners=kept, warnings=warnings, numbers=numbers)


def _moved(shape: Any, piece: Points, away: float) -> tuple[list[Points], str]:
    """The outline of ``shape`` moved by ``away`` mm, in as many pieces as it has then, and what went wrong."""
    quarter = max(4, int(np.ceil(np.pi / 4 / np.arccos(max(1.0 - _SHARE / abs(away), 0.0)))))
    grown = shape.buffer(away, quad_segs=quarter)
    if grown.is_empty:
        return [], "vanishes: it is left out"
    parts = list(getattr(grown, "geoms", [grown]))
    # What a closing gap encloses is cut first: it lies within.
    inner = [np.array(ring.coords) for part in parts for ring in part.interiors]
    outer = [_begun(np.array(part.exterior.coords), piece) for part in parts]
    if len(parts) > 1:
        return [*inner, *outer], f"falls apart into {len(parts)} pieces"
    return [*inner, *outer], "has a gap that closes" if inner else ""


def _begun(ring: Points, piece: Points) -> Points:
    """A ring that begins near where the contour began, and runs in its direction."""
    if around_it(ring)[0] * around_it(piece)[0] < 0:
        ring = ring[::-1]
    first = int(np.hypot(*(ring - piece[0]).T).argmin())
    return np.concatenate([ring[first:-1], ring[: first + 1]])


def _meeting(moved: list[Points], closed: list[bool], origin: list[int]) -> list[int]:
    """Contours whose paths meet another's."""
    index = [k for k, shut in enumerate(closed) if shut]
    lines = [shapely.linestrings(moved[k]) for k in index]
    a, b = shapely.STRtree(lines).query(lines, predicate="intersects") if lines else ([], [])
    pairs = ((origin[index[i]], origin[index[j]]) for i, j in zip(a, b, strict=True))
    return [i for i, j in pairs if i != j]
