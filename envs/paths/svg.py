"""SVG drawings: paths and basic shapes with their transforms, y upward."""

from pathlib import Path
from typing import Any

import numpy as np

from ..plant.quantity import InvalidInput, did_you_mean
from .drawing import CHORD, Curves, Drawing, Points, assembled

PIXEL = 25.4 / 96.0
"""mm, of a CSS pixel."""

UNITS = {"mm": 1.0, "cm": 10.0, "in": 25.4, "inches": 25.4, "px": PIXEL, "pt": 25.4 / 72}
CUT = "path, line, polyline, polygon, rect, circle, ellipse"


def read_svg(path: str | Path, units: str | None = None) -> Drawing:
    """The contours of an SVG drawing.

    ``width``, ``height`` and ``viewBox`` give the size; a drawing without absolute units is read in pixels of 1/96
    inch, with a warning. Text, images and whatever is not drawn are left out and counted.

    Args:
        path: the file.
        units: what one user unit is, whatever the file says.

    Raises:
        InvalidInput: not an SVG file, unknown units, a coordinate that is not a number, or nothing to cut.
    """
    import svgelements

    file = Path(path)
    if units is not None and units not in UNITS:
        raise InvalidInput(f"{file}: unknown units '{units}'; {did_you_mean(units, UNITS)}")
    try:
        # The library works in pixels of 1/96 inch; physical sizes and viewBox are allowed for by it.
        document = svgelements.SVG.parse(str(file), reify=True, ppi=96.0)
    except Exception as error:  # damaged files raise whatever the damage leads to
        raise InvalidInput(f"{file}: cannot be read as SVG: {error}") from None
    sides = [str(document.values.get(side) or "").strip() for side in ("width", "height")]
    absolute = any(side.endswith(("mm", "cm", "in", "pt", "pc")) for side in sides)
    named, scale, warnings = ("px", PIXEL, ())
    if units is not None:
        named, scale = units, UNITS[units]
    elif absolute:
        named = "mm"
    else:
        warnings = (f"{file}: no width or height in mm or inches; read in pixels of 1/96 inch",)
    curves = Curves()
    for element in document.elements():
        kind = type(element).__name__.lower()
        if isinstance(element, svgelements.Shape):
            for points in _polylines(file, element, scale, kind):
                curves.add(points * np.array([1.0, -1.0]), kind)
        elif not isinstance(element, svgelements.Group | svgelements.SVG | svgelements.Use):
            curves.skipped[kind] += 1
    return assembled(file, curves, named, CUT, warnings)


def _polylines(file: Path, shape: Any, scale: float, kind: str) -> list[Points]:
    """The subpaths of a shape as polylines, mm, y downward."""
    import svgelements

    found: list[list[complex]] = []
    for segment in svgelements.Path(shape):
        if isinstance(segment, svgelements.Move):
            found.append([complex(segment.end)])
            continue
        if not found:
            found.append([complex(segment.start)])
        if isinstance(segment, svgelements.Line | svgelements.Close):
            if segment.end is not None:
                found[-1].append(complex(segment.end))
        else:
            found[-1] += _curve(segment, CHORD / scale)
    lines = [scale * np.array([(z.real, z.imag) for z in line]) for line in found if len(line) > 1]
    for line in lines:
        if not np.isfinite(line).all():
            raise InvalidInput(f"{file}: a {kind} has coordinates that are not numbers")
    return lines


def _curve(segment: Any, chord: float) -> list[complex]:
    """Points after the start of a curved segment, so many that chords stay within ``chord`` of it."""
    count = 8
    while True:
        z = np.array([complex(*segment.point(t)) for t in np.linspace(0.0, 1.0, 2 * count + 1)])
        sagitta = np.abs(z[1::2] - 0.5 * (z[:-2:2] + z[2::2])).max()
        if sagitta <= chord or count >= 4096 or not np.isfinite(sagitta):
            return z[1:].tolist()
        count *= 2
