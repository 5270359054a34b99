"""Drawings and programmes from files, by the ending of their names."""

from collections.abc import Sequence
from pathlib import Path

from ..plant.quantity import InvalidInput, did_you_mean
from .drawing import Drawing

PROGRAMMES = (".ngc", ".nc", ".gcode", ".tap", ".cnc")
ENDINGS = (".dxf", ".svg", *PROGRAMMES)


def read(path: str | Path, layers: Sequence[str] | None = None, units: str | None = None) -> Drawing:
    """The contours of a drawing (DXF, SVG) or of a programme (G-code), mm.

    Args:
        path: the file.
        layers: layers that are cut, of a DXF drawing; None: all.
        units: name of the unit the file is drawn in, if it does not say it or says it wrongly.

    Raises:
        InvalidInput: no such file, unknown kind of file, or what its reader finds wrong.
    """
    file = Path(path)
    ending = file.suffix.lower()
    if ending not in ENDINGS:
        raise InvalidInput(f"{file}: '{file.suffix}' files cannot be read; {did_you_mean(ending, ENDINGS)}")
    if not file.is_file():
        raise InvalidInput(f"{file}: no such file")
    if layers and ending != ".dxf":
        raise InvalidInput(f"{file}: only DXF drawings have layers to choose from")
    if ending == ".dxf":
        from .dxf import read_dxf

        return read_dxf(file, layers, units)
    if ending == ".svg":
        from .svg import read_svg

        return read_svg(file, units)
    from .gcode import read_gcode

    return read_gcode(file, units)
