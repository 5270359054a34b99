"""What was measured, from CSV files: profiles and maps of surfaces, calibration tables, recorded signals."""

import functools

import numpy as np

from ..engine.quantity import InvalidInput
from ..plant import heads
from ..plant.calibration import read_columns
from ..safety import files
from .surface import Map, Profile

MOST_POINTS = 5_000_000
"""Of a profile: 500 m at a tenth of a millimetre."""

MOST_HEIGHT = 1000.0
"""mm of a measured surface, up and down."""


def _columns(file: str, wanted: tuple[str, ...]) -> np.ndarray:
    """Columns of a CSV file, see :func:`read_columns`; surfaces are no mountains."""
    columns = read_columns(files.checked(file, files.TABLE), wanted)
    for name, values in zip(wanted, columns.T, strict=True):
        far = np.flatnonzero(np.abs(values) > MOST_HEIGHT)
        if name == "height_mm" and len(far):
            row, value = far[0] + 2, values[far[0]]
            raise InvalidInput(f"{file}, row {row}, column {name}: {value:g} mm; allowed: ±{MOST_HEIGHT:g} mm")
    return columns


@functools.lru_cache(maxsize=32)
def profile(source: Profile) -> np.ndarray:
    """Heights of a measured profile, resampled at ``source.spacing``, mm, starting at its first position.

    Raises:
        InvalidInput: gaps, text or positions that do not rise, with file, row and column.
    """
    columns = _columns(source.file, ("position_mm", "height_mm"))
    falls = np.flatnonzero(np.diff(columns[:, 0]) <= 0)
    if len(falls):
        raise InvalidInput(
            f"{source.file}, row {falls[0] + 3}, column position_mm: positions must rise from row to row"
        )
    if not (many := (columns[-1, 0] - columns[0, 0]) / source.spacing) <= MOST_POINTS:
        raise InvalidInput(
            f"{source.file}: {columns[0, 0]:g} to {columns[-1, 0]:g} mm every {source.spacing:g} mm are {many:.3g} "
            f"points; allowed: {MOST_POINTS:,}; are the positions in mm? Else give a wider spacing"
        )
    grid = np.arange(columns[0, 0], columns[-1, 0], source.spacing)
    return np.interp(grid, columns[:, 0], columns[:, 1])


@functools.lru_cache(maxsize=32)
def height_map(source: Map) -> tuple[np.ndarray, float, float, float]:
    """Heights (along y, along x), the corner they begin at, and their spacing, all in mm.

    Raises:
        InvalidInput: text, gaps, or points that are no regular grid, with file and row.
    """
    columns = _columns(source.file, ("x_mm", "y_mm", "height_mm"))
    x, y = (np.unique(columns[:, k]) for k in (0, 1))
    if len(x) < 2 or len(y) < 2 or len(x) * len(y) != len(columns):
        raise InvalidInput(
            f"{source.file}: {len(columns)} points at {len(x)} places along x and {len(y)} along y are no full grid"
        )
    spacing = float(np.diff(x)[0])
    uneven = np.abs(np.concatenate([np.diff(x), np.diff(y)]) - spacing) > 1e-6 * spacing
    if uneven.any():
        raise InvalidInput(f"{source.file}: the grid's spacing is not {spacing:g} mm throughout, along x and along y")
    order = np.lexsort((columns[:, 0], columns[:, 1]))
    doubled = np.flatnonzero(np.diff(columns[order, 0] + 1j * columns[order, 1]) == 0)
    if len(doubled):
        raise InvalidInput(f"{source.file}, row {order[doubled[0] + 1] + 2}: this point is there twice")
    return columns[order, 2].reshape(len(y), len(x)).copy(), float(x[0]), float(y[0]), spacing


def measured_head(file: str) -> int:
    """Index of the head whose calibration table is in a CSV file, see :func:`heads.measured`."""
    return heads.measured(str(files.checked(file, files.TABLE)))


@functools.lru_cache(maxsize=32)
def signal(file: str) -> np.ndarray:
    """A recorded signal, Hz, one number each millisecond.

    Raises:
        InvalidInput: text, gaps, or a frequency that is not above 0, with file and row.
    """
    values = _columns(file, ("frequency_Hz",))[:, 0]
    bad = np.flatnonzero(values <= 0)
    if len(bad):
        raise InvalidInput(f"{file}, row {bad[0] + 2}, column frequency_Hz: {values[bad[0]]:g} Hz; it must be above 0")
    return values
