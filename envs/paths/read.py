"""Reading a path, whatever its format."""

from importlib import import_module
from pathlib import Path

from ..plant.quantity import InvalidInput, did_you_mean
from .drawing import Drawing

FORMATS = {
    ".dxf": "dxf", ".svg": "svg", ".ngc": "gcode", ".nc": "gcode", ".gcode": "gcode", ".tap": "gcode", ".cnc": "gcode",
}  # fmt: skip
"""Suffix: the module that reads it; they are imported when they are needed, for their libraries are slow."""


def read(
    path: str | Path, *, layers: tuple[str, ...] | list[str] | str | None = None, units: str | None = None
) -> Drawing:
    """The drawing in a DXF, SVG or G-code file.

    Args:
        path: the file; its suffix tells the format.
        layers: names of the layers that are cut; None: all.
        units: mm, cm, m or inches, instead of what the file says or is taken to mean (G20 and G21 prevail).

    Returns:
        its contours in cutting order, with ``warnings`` and ``skipped`` for everything that a user should know.

    Raises:
        InvalidInput: no such file, an unknown suffix, or whatever is wrong in it, where, and what is allowed.
    """
    file = Path(path)
    if not file.is_file():
        raise InvalidInput(f"{file}: no such file")
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        raise InvalidInput(f"{file}: '{file.suffix}' files cannot be read; {did_you_mean(suffix, FORMATS)}")
    module = FORMATS[suffix]
    return getattr(import_module(f".{module}", __package__), f"read_{module}")(file, layers=layers, units=units)
