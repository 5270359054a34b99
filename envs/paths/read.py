"""Reading a path, whatever its format."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from ..engine.quantity import InvalidInput, did_you_mean
from ..safety import files
from .choice import Reading, Rules
from .drawing import Drawing
from .joining import GAP

FORMATS = {".dxf": "dxf", ".svg": "svg", **dict.fromkeys((".ngc", ".nc", ".gcode", ".tap", ".cnc"), "gcode")}
"""Suffix: the module that reads it; they are imported when they are needed, for their libraries are slow."""

PROGRAMMES = ("gcode",)
"""What is cut as it was programmed."""


def read(
    path: str | Path,
    *,
    layers: Rules = None,
    units: str | None = None,
    colours: Rules = None,
    join: float = GAP,
    text: bool = False,
    hatches: bool = False,
) -> Drawing:
    """The drawing in a DXF, SVG or G-code file.

    Args:
        path: the file; its suffix tells the format.
        layers: what becomes of which layer, such as ``("cut=OUTLINE,HOLES", "ignore=DIM*")`` (:mod:`.choice`); None:
            all are cut.
        units: mm, cm, m, inches or another of :data:`.drawing.UNITS`, instead of what the file says or is taken to mean
            (G20 and G21 prevail).
        colours: the same for colours (DXF) and strokes (SVG).
        join: mm, the largest gap between two ends of a drawing that are joined.
        text: cut the letters of a drawing as outlines.
        hatches: cut the filled areas of a DXF as outlines.

    Returns:
        its contours in cutting order, with ``notes`` on everything that a user should know.

    Raises:
        InvalidInput: no such file, not a plain file or too large a one, an unknown suffix, or whatever is wrong in it,
            where, and what is allowed.
    """
    file = Path(path)
    if not files.exists(file):
        raise InvalidInput(f"{file}: no such file")
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        raise InvalidInput(f"{file}: '{file.suffix}' files cannot be read; {did_you_mean(suffix, FORMATS)}")
    files.checked(file, files.DRAWING)
    module = FORMATS[suffix]
    asked = Reading(units=units, layers=layers, colours=colours, join=join, text=text, hatches=hatches)
    with _keeping():
        return getattr(import_module(f".{module}", __package__), f"read_{module}")(file, asked)


@contextmanager
def _keeping() -> Iterator[None]:
    """Without the collector of garbage: of a file's million objects all are used to the end, and to look through them
    again and again takes a third of the time."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()
