"""What was measured, from CSV files: profiles and maps of surfaces, calibration tables, recorded signals."""

import csv
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
    """Index of the head whose calibration table is in a CSV file, see :func:`heads.measured`.

    Raises:
        InvalidInput: file, row, column and value of the first thing that cannot be.
    """
    _check_table(file)
    return heads.measured(str(files.checked(file, files.TABLE)))


FREQUENCIES, HEIGHTS, LEAST_SPAN = (1e4, 1e8), (-1.0, 100.0), 0.5
"""Hz and mm that a calibration table may hold, and mm that it must reach [A]."""

_MEANT = {"frequency_Hz": ((1e6, "MHz"), (1e3, "kHz")), "height_mm": ((1e-3, "µm"),)}
"""Units in which a number would be in range."""


@functools.lru_cache(maxsize=32)
def _check_table(file: str) -> None:
    """Raises what a calibration table cannot be, whatever else :func:`calibration.read_csv` finds."""
    lines = list(csv.reader(files.text(file, files.TABLE).splitlines()))
    header = [cell.strip() for cell in lines[0]] if lines else []
    if len(header) == 1 and (";" in header[0] or "\t" in header[0]):
        raise InvalidInput(
            f"{file}, row 1: {files.shown(header[0])}; columns are separated by commas, and numbers have a point"
        )
    names = ("frequency_Hz", "height_mm")
    for name in names:
        if (count := header.count(name)) > 1:
            raise InvalidInput(f"{file}, row 1: column {name} is there {count} times")
    for row, line in enumerate(lines[1:], start=2):
        if any(cell.strip() for cell in line[len(header) :]):
            raise InvalidInput(
                f"{file}, row {row}, column {len(header) + 1}: '{line[len(header)]}' is one cell too many; the header "
                f"names {len(header)} columns; numbers have a point, not a comma"
            )
    columns = read_columns(file, names)
    for name, values, (low, high) in zip(names, columns.T, (FREQUENCIES, HEIGHTS), strict=True):
        if len(outside := np.flatnonzero((values < low) | (values > high))):
            value = float(values[outside[0]])
            meant = [unit for times, unit in _MEANT[name] if low <= value * times <= high]
            raise InvalidInput(
                f"{file}, row {outside[0] + 2}, column {name}: {value:.7g} is out of range; allowed: {low:g} to "
                f"{high:g} {name[-2:]}" + (f"; is it in {meant[0]}?" if meant else "")
            )
    _check_rise(file, names, columns)


def _check_rise(file: str, names: tuple[str, ...], columns: np.ndarray) -> None:
    """Raises where a table falls, and if it is too short."""
    steps = np.diff(columns, axis=0)
    if len(falls := np.flatnonzero((steps <= 0).any(axis=1))):
        i = int(falls[0])
        k = int(np.argmax(steps[i] <= 0))
        turned = "; is the table in the other order?" if np.all(steps < 0) else ""
        turned = "; does frequency fall with height?" if np.all(steps[:, 0] < 0) and np.all(steps[:, 1] > 0) else turned
        raise InvalidInput(
            f"{file}, row {i + 3}, column {names[k]}: {columns[i + 1, k]:.9g} after {columns[i, k]:.9g}; frequency and "
            f"height must both rise from row to row{turned}"
        )
    if (top := float(columns[-1, 1])) < LEAST_SPAN:
        raise InvalidInput(
            f"{file}, row {len(columns) + 1}, column height_mm: {top:.7g} is the highest; a table reaches "
            f"{LEAST_SPAN:g} mm or more; is it in m?"
        )


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
