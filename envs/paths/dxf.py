"""DXF: what the model space of a drawing shows, as contours in cutting order.

The third dimension is dropped: what is cut is what one sees from above.
"""

from pathlib import Path
from typing import Any

from ..engine.quantity import InvalidInput
from .choice import Choice, Reading
from .collected import Collected
from .colours import in_dxf
from .drawing import UNITS, Drawing, finished, unit
from .dxf_curves import CUT, world
from .dxf_file import document_of
from .dxf_fills import FILLS, TEXTS
from .dxf_walk import Place, Walk

INSUNITS = {
    **{1: "inches", 2: "feet", 3: "miles", 4: "mm", 5: "cm", 6: "m", 7: "km", 8: "microinches", 9: "mils"},
    **{10: "yards", 13: "microns", 14: "dm", 15: "dam", 16: "hm"},
    **{21: "US survey feet", 22: "US survey inches", 23: "US survey yards"},
}
"""Code of $INSUNITS: name of the unit."""


def read_dxf(path: str | Path, asked: Reading = Reading()) -> Drawing:  # noqa: B008
    """The contours of a DXF drawing, inner ones before those that contain them, otherwise the nearest next.

    Cut are the lines, arcs, circles, ellipses, splines, polylines and multilines of the model space, also inside
    blocks. Left out and counted are other entities, those on layers that are off, frozen or not plotted, those with a
    dashed line type, those of zero length and duplicates. A layer that a rule names is cut all the same. The nozzle
    comes from the origin.

    Args:
        path: a DXF file, text or binary.
        asked: how it is read; colours are 1 to 255, a name or #rrggbb.

    Raises:
        InvalidInput: not a DXF file, unknown units, layer or colour, nothing to cut, or more than a drawing may have.
    """
    file = Path(path)
    document, repaired = document_of(file)
    found = Collected(file)
    for line in repaired:
        found.warn(line)
    name = unit(asked.units)[0] if asked.units is not None else _units(file, document, found)
    layer_choice, colour_choice = Choice("layer", asked.layers), Choice("colour", asked.colours, in_dxf)
    walk = Walk(document, found, layer_choice, colour_choice, asked)
    layer_choice.check(file, walk.layers.names(document.chain_layouts_and_blocks()))
    walk.measure(document.modelspace())
    walk.space(document.modelspace(), Place(world(UNITS[name])))
    walk.finish()
    colour_choice.check(file, colour_choice.seen)
    for kinds, option in ((TEXTS, "--text cuts letters"), (FILLS, "--hatches cuts filled areas")):
        if not found.curves and any(kind in found.skipped for kind in kinds):
            found.warn(f"{option} as outlines")
    return finished(file, found, name, asked.join, ", ".join(CUT))


def _units(file: Path, document: Any, found: Collected) -> str:
    """Name of the drawing's unit; a warning where the file names none."""
    code, measurement = _header(file, document, "$INSUNITS"), _header(file, document, "$MEASUREMENT")
    if code is None:
        also = ", although $MEASUREMENT says inches" if measurement == 0 else ""
        found.warn(f"no unit in the header, read as mm{also}; --units reads it otherwise")
        return "mm"
    if code == 0:
        name = "inches" if measurement == 0 else "mm"
        found.warn(f"no unit in the header, read as {name} by its $MEASUREMENT; --units reads it otherwise")
        return name
    if code not in INSUNITS:
        allowed = ", ".join(f"{known} ({name})" for known, name in INSUNITS.items())
        raise InvalidInput(
            f"{file}: $INSUNITS = {code} is not supported; allowed: 0 (unitless), {allowed}; --units reads it otherwise"
        )
    return INSUNITS[code]


def _header(file: Path, document: Any, variable: str) -> int | None:
    """A header variable, if it is there; the reader makes up a header (in metres) for files that have none."""
    return document.header.get(variable, None) if variable.encode() in file.read_bytes() else None
