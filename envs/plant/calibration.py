"""Calibration: a run of the machine → monotone frequency–height table → look-up (Xi2023 Fig. 7).

Why the table is fitted and made monotone, and how far that reaches: docs/physics.md#calibration.

The run itself is the supervisor's ``calibrate`` mode on the machine: touch the sheet, rise to 10 mm at 10 mm/s, one
count per 1 ms, each tagged with the encoder at the centre of its gate. :func:`build` makes the table from the samples:

1. samples far from the local trend (impulses) are set aside;
2. the oscillator's equations are fitted to the rest, and what they leave over is averaged over neighbours, so that
   counting noise does not end up in the table;
3. isotonic regression makes the table monotone, which the binary search needs;
4. the run is rated, and refused with a reason if it is not fit to use.
"""

import csv
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from ..engine.lanes import U0, U1, part
from ..engine.quantity import InvalidInput, Quantity

POINTS = 1000
"""Entries of a table (Xi2023: 10 mm at 10 mm/s, one sample per 1 ms)."""

SPAN = 10.0
"""mm, calibrated range (Xi2023)."""


FEWEST = 200
"""Samples with which a calibration is still fit to use [A]; fewer than 1000 mean lower accuracy (Xi2023)."""


class Params(NamedTuple):
    """How a height is read from the table."""

    look_up: Annotated[
        float, Quantity("", 0, 1, "reading between two entries", "Xi2023", choices=("interpolate", "nearest"))
    ] = 0.0  # nearest is the literal binary search, good to half an entry (5 µm)


class Table(NamedTuple):
    """A head's frequency–height table and how good the run was.

    ``frequency`` (Hz, ascending) and ``height`` (mm) have :data:`POINTS` entries.
    """

    frequency: np.ndarray
    height: np.ndarray
    usable: int  # raw samples that were used
    raw: int  # raw samples taken
    noise: float  # µm of height at 1 mm, scatter of the raw samples
    rating: str  # "A" (noise ≤ 5 µm), "B" (≤ 15 µm), "C" (≤ 50 µm)


class Pool:
    """Tables of several heads, one behind the other in two arrays, as the kernel reads them.

    ``frequencies`` (Hz) and ``heights`` (mm) have the shape (heads · :data:`POINTS`,). A head without a table reads a
    straight line, so that a machine can run before it is calibrated.

    Args:
        heads: that carry a straight line.
        more: places behind them, which cost no memory before :meth:`open` or a table fills them.
    """

    def __init__(self, heads: int, more: int = 0) -> None:
        self.frequencies, self.heights = np.zeros((2, (heads + more) * POINTS))
        self._tables: dict[int, Table] = {}
        self.open(0, heads)

    def open(self, first: int, heads: int) -> None:
        """Gives heads from ``first`` on a straight line."""
        place = slice(first * POINTS, (first + heads) * POINTS)
        self.frequencies[place] = np.tile(np.linspace(1e6, 5e6, POINTS), heads)
        self.heights[place] = np.tile(np.linspace(SPAN / POINTS, SPAN, POINTS), heads)

    def __contains__(self, head: int) -> bool:
        return head in self._tables

    def __getitem__(self, head: int) -> Table:
        return self._tables[head]

    def __setitem__(self, head: int, table: Table) -> None:
        self._tables[head] = table
        place = slice(head * POINTS, (head + 1) * POINTS)
        self.frequencies[place], self.heights[place] = table.frequency, table.height


class CalibrationRefused(InvalidInput):
    """A calibration run that must not be used; the message gives the reason."""


# ------------------------------------------------------------------------------------------------------ look-up


@part
def bracket(table, first, frequency):
    """Index of the table's last entry at or below ``frequency``, by binary search (Xi2023).

    Args:
        table: frequencies of all heads, ascending within each.
        first: index of this head's first entry.
        frequency: Hz.

    Returns:
        Index from ``first`` to ``first + POINTS − 2``.
    """
    low = first
    half = _HALF
    while half > U0:
        middle = low + half
        low = middle if middle < first + _LAST and table[middle] <= frequency else low
        half = half >> U1
    return low


_LAST, _HALF = np.uint64(POINTS - 1), np.uint64(512)


@part
def bracket_near(table, first, frequency, hint):
    """The same as :func:`bracket`, found at once where it is still the entry ``hint`` of the period before."""
    inside = table[hint] <= frequency and frequency < table[hint + U1]
    return hint if inside else bracket(table, first, frequency)


@part
def between(p, frequencies, heights, at, frequency):
    """Reading between the entry ``at`` and the next; outside the table it is the table's end.

    Returns:
        ``(height, slope)``: mm, and the table's slope there in Hz/mm.
    """
    f0, f1, h0, h1 = frequencies[at], frequencies[at + U1], heights[at], heights[at + U1]
    share = min(1.0, max(0.0, (frequency - f0) / (f1 - f0)))
    if p.look_up > 0.5:
        share = np.rint(share)
    return h0 + share * (h1 - h0), (f1 - f0) / (h1 - h0)


@part
def height(p, frequencies, heights, first, frequency):
    """Height in mm for a frequency in Hz, and the table's slope there in Hz/mm."""
    return between(p, frequencies, heights, bracket(frequencies, first, frequency), frequency)


# ---------------------------------------------------------------------------------------------------- the table


def isotonic(values: np.ndarray) -> np.ndarray:
    """The rising sequence nearest to ``values`` by least squares (pool adjacent violators, Ayer et al. 1955)."""
    means: list[float] = []
    counts: list[int] = []
    for value in values:
        mean, count = float(value), 1
        while means and means[-1] > mean:
            previous, n = means.pop(), counts.pop()
            mean, count = (previous * n + mean * count) / (n + count), n + count
        means.append(mean)
        counts.append(count)
    return np.repeat(means, counts)


def _smoothed(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Local straight-line fit of ``y`` over neighbours on each side: few near the sheet, where the trend bends."""
    half = np.clip(30.0 * x, 3, 60).astype(int)
    n, out = len(x), np.empty_like(y)
    sums = [np.concatenate([[0.0], np.cumsum(q)]) for q in (np.ones(n), x, y, x * x, x * y)]
    low, high = np.maximum(np.arange(n) - half, 0), np.minimum(np.arange(n) + half + 1, n)
    s1, sx, sy, sxx, sxy = (s[high] - s[low] for s in sums)
    slope = (s1 * sxy - sx * sy) / np.maximum(s1 * sxx - sx * sx, 1e-12)
    out[:] = (sy + slope * (x * s1 - sx)) / s1
    return out


def _basis(h: np.ndarray, radius: float) -> np.ndarray:
    """What 1/f² ∝ C is made of: body, plate and fringe of the head's equations, and a slow remainder."""
    g = np.maximum(h, 1e-3)
    fringe = np.maximum(np.log(8 * np.pi * radius / g) - 1.0, 0.0)
    return np.stack([np.ones_like(g), 1.0 / g, fringe, g], axis=1)


def build(
    frequency: np.ndarray, height: np.ndarray, radius: float = 5.0, span: float = SPAN, speed: float = 10.0
) -> Table:
    """The table from the samples of a calibration run.

    Args:
        frequency: counted frequencies, Hz, one per sample; 0 where the count was not valid.
        height: encoder height above the point of contact at the centre of each gate, mm.
        radius: of the nozzle, mm; only shapes the trend that is taken out before averaging.
        span: mm that the run was to cover; the table ends there.
        speed: mm/s of the run.

    Raises:
        CalibrationRefused: too few usable samples, no rise of frequency with height, or too much noise.
    """
    raw, expected = len(frequency), round(span / speed * 1e3)
    inside = (frequency > 0.0) & (height > 0.0) & (height <= span + 0.05)
    f, h = frequency[inside], height[inside]
    if len(f) < 0.9 * expected:
        raise CalibrationRefused(
            f"only {len(f)} of {expected} samples are valid; the head must rise from contact to {span:g} mm at "
            f"{speed:g} mm/s"
        )
    if expected < FEWEST:
        raise CalibrationRefused(
            f"{expected} samples over {span:g} mm are too few; at least {FEWEST}: rise more slowly"
        )
    order = np.argsort(h, kind="stable")
    f, h = f[order], h[order]
    if np.median(f[-50:]) <= np.median(f[:50]):
        raise CalibrationRefused("the frequency does not rise with height; is the sensor connected to the sheet?")

    # The trend: 1/f² is nearly linear in the head's capacitances. Points weigh by what an error of height does to them.
    good = np.ones(len(f), bool)
    basis, y = _basis(h, radius), (1e6 / f) ** 2
    scale = np.hypot(0.5e-3, 1e-3 * h * h)  # mm; scatter of a sample's height: encoder counts, then noise
    steep = 0.067 / (h * h + 0.067 * h)  # |d ln C/dh| of a first guess, 1/mm
    for _ in range(4):
        weight = good / (scale * steep)
        theta = np.linalg.lstsq(basis * (weight / y)[:, None], weight, rcond=None)[0]
        trend = 1e6 / np.sqrt(np.maximum(basis @ theta, 1e-6))
        slope = np.maximum(np.gradient(trend, h), 1e-3)  # Hz/mm
        steep = 2.0 * slope / trend
        residual = (f - trend) / slope  # mm of height
        local = residual - _smoothed(h, np.where(good, residual, 0.0))
        spread = 1.4826 * np.median(np.abs(local[good]) / scale[good]) + 1e-9
        good = np.abs(local) < np.maximum(6.0 * spread * scale, 2e-3)
    usable = int(good.sum())
    near = good & (h > 0.7) & (h < 1.3)
    if near.sum() < 20:  # a quick run
        near = good & (h > 0.4) & (h < 1.8)
    noise = 1e3 * float(np.std(local[near])) if near.sum() > 10 else np.inf
    if usable < 0.9 * expected:
        raise CalibrationRefused(f"{len(f) - usable} of {len(f)} samples lie off the curve; at most 10 % may")
    if not noise <= 50.0:
        raise CalibrationRefused(f"noise of {noise:.0f} µm at 1 mm; at most 50 µm is fit to use")

    grid = np.arange(1, POINTS + 1) * (span / POINTS)
    h, residual = h[good], residual[good]
    left = np.interp(grid, h, _smoothed(h, residual))
    clean = 1e6 / np.sqrt(np.maximum(_basis(grid, radius) @ theta, 1e-6))
    monotone = isotonic(clean + left * np.maximum(np.gradient(clean, grid), 1e-3))
    # Equal neighbours would make the interpolation divide by zero.
    monotone = monotone + np.arange(POINTS) * 1e-6
    rating = "A" if noise <= 5.0 else ("B" if noise <= 15.0 else "C")
    return Table(monotone, grid, usable, raw, noise, rating)


def literal(frequency: np.ndarray, height: np.ndarray) -> Table:
    """The table as the paper prints it: the first 1000 raw samples, sorted, nothing rejected or averaged.

    Raises:
        CalibrationRefused: fewer than 1000 valid samples.
    """
    valid = frequency > 0.0
    f, h = frequency[valid][:POINTS], height[valid][:POINTS]
    if len(f) < POINTS:
        raise CalibrationRefused(f"only {len(f)} of {POINTS} samples are valid")
    f = isotonic(f) + np.arange(POINTS) * 1e-6
    return Table(f, np.asarray(h, float), POINTS, len(frequency), np.nan, "-")


# -------------------------------------------------------------------------------------------------------- CSV


def write_csv(table: Table, path: str | Path) -> None:
    """Writes a table as CSV with the columns ``frequency_Hz`` and ``height_mm``."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["frequency_Hz", "height_mm"])
        writer.writerows(zip(table.frequency.tolist(), table.height.tolist(), strict=True))


def read_csv(path: str | Path) -> Table:
    """Reads a table that :func:`write_csv` or a machine wrote; it is brought to :data:`POINTS` entries.

    Raises:
        InvalidInput: file, row and column of the first thing that is not a monotone table.
    """
    columns = read_columns(path, ("frequency_Hz", "height_mm"))
    f, h = columns[:, 0], columns[:, 1]
    falls = np.flatnonzero((np.diff(f) <= 0) | (np.diff(h) <= 0))
    if len(falls):
        raise InvalidInput(f"{path}, row {falls[0] + 3}: frequency and height must both rise from row to row")
    if len(f) == POINTS:
        return Table(f, h, POINTS, POINTS, np.nan, "-")
    grid = np.linspace(h[0], h[-1], POINTS)
    return Table(np.interp(grid, h, f), grid, len(f), len(f), np.nan, "-")


def read_columns(path: str | Path, names: tuple[str, ...]) -> np.ndarray:
    """Columns of a CSV file with a header, as an array of shape (rows, columns).

    Raises:
        InvalidInput: missing file or column, text or an empty cell where a number should be, fewer than two rows.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            lines = list(csv.reader(file))
    except OSError as error:
        raise InvalidInput(f"cannot read {path}: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error):
        raise InvalidInput(f"cannot read {path}: it is not a text file in UTF-8") from None
    header = [cell.strip() for cell in lines[0]] if lines else []
    missing = [name for name in names if name not in header]
    if missing:
        raise InvalidInput(f"{path}, row 1: column {missing[0]} is missing; expected {', '.join(names)}")
    wanted = [header.index(name) for name in names]
    values = np.empty((len(lines) - 1, len(names)))
    for row, line in enumerate(lines[1:], start=2):
        for column, index in enumerate(wanted):
            cell = line[index].strip() if index < len(line) else ""
            try:
                values[row - 2, column] = float(cell)
            except ValueError:
                what = f"'{cell}' is not a number" if cell else "the cell is empty"
                raise InvalidInput(f"{path}, row {row}, column {names[column]}: {what}") from None
            if not np.isfinite(values[row - 2, column]):
                raise InvalidInput(f"{path}, row {row}, column {names[column]}: {cell} is not a finite number")
    if len(values) < 2:
        raise InvalidInput(f"{path}: needs at least two rows of numbers")
    return values
