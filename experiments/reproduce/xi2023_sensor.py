"""Xi2023 §2.2 and §3.1–3.2: oscillator, calibration run, look-up by binary search."""

import functools

import numpy as np
from matplotlib.axes import Axes

from ...envs.plant import calibration, heads, sensor
from ..plots.palette import COLOURS, QUIET
from .claims import Rows, Trial, study
from .pictures import Drawing, illustrated
from .verdicts import FAILS, TREND

LOW, HIGH = 1.665, 4.053
"""MHz, the printed band."""

C_LEAST, C_MOST = 10.0, 50.0
"""pF, the printed range of C5."""

LARGEST = 1000.0
"""pF; "capacitances below 1000 pF"."""

TABLES = (1000, 500, 200, 100)
"""Entries of tables whose accuracy is compared."""


pictured = functools.partial(illustrated, grid={"alpha": 0.3}, spines=False)
"""As this document's pictures are."""


def inductance(megahertz: float, c5: float) -> float:
    """L1 in µH that eq. 3 asks for."""
    return 1e6 / ((2 * np.pi * megahertz) ** 2 * c5)


def megahertz(p: sensor.Params, c5: float) -> float:
    """Frequency of a head's oscillator at C5 in pF."""
    return float(sensor.oscillator(p, c5, 0.0)) / 1e6


def capacitance(p: sensor.Params, height: float) -> float:
    """C5 of a head in pF at a height in mm."""
    return float(sensor.capacitance(p, height, 1.0))


def c5_of(p: sensor.Params, frequency: float) -> float:
    """C5 in pF at which a head's oscillator has this frequency in MHz (eq. 1)."""
    return 1.0 / (p.inductance * (2 * np.pi * frequency) ** 2 * 1e-6 - p.series)


def exact(heights: np.ndarray) -> np.ndarray:
    """Frequencies of the nominal head in Hz, without noise, at heights in mm."""
    return np.array([1e6 * megahertz(sensor.EQ3, capacitance(sensor.EQ3, h)) for h in heights.tolist()])


def exponent(p: sensor.Params, height: float) -> float:
    """d ln f / d ln h at a height in mm."""
    a, b = (megahertz(p, capacitance(p, height * s)) for s in (0.999, 1.001))
    return float(np.log(b / a) / np.log(1.001 / 0.999))


@study("xi2023", "Oscillator: eqs. 1–5 and the printed band")
def oscillator(trial: Trial, rows: Rows) -> list[Drawing]:
    """What band the equations give, and whether any components give the printed one."""
    eq3, eq1 = sensor.PRESETS["eq3"], sensor.PRESETS["eq1"]
    short = [1 / (1 + c * 3 / LARGEST) - 1 for c in (C_LEAST, C_MOST)]
    top, bottom = inductance(HIGH, C_LEAST), inductance(LOW, C_MOST)
    ratio, most = HIGH / LOW, float(np.sqrt(C_MOST / C_LEAST))
    series = (1 / C_LEAST - ratio**2 / C_MOST) / (ratio**2 - 1)  # 1/pF, from f² ∝ series + 1/C5 at both ends
    band = [megahertz(eq3, c) for c in (C_MOST, C_LEAST)]
    miss = max(abs(band[0] / LOW - 1), abs(band[1] / HIGH - 1))
    ends = [c5_of(eq1, f) for f in (LOW, HIGH)]
    full = [megahertz(eq1, c) for c in (C_MOST, C_LEAST)]
    off = max(abs(full[0] / LOW - 1), abs(full[1] / HIGH - 1))
    slopes = {h: exponent(eq3, h) for h in (0.1, 1.0)}
    span = [capacitance(eq3, h) for h in (10.0, 0.1)]
    heights = np.geomspace(1e-3, 10, 2000)
    touch = heights[np.argmin([abs(capacitance(eq3, float(h)) - C_MOST) for h in heights])]
    rows("near-plates", (_percent(short[0]), _percent(short[1])), holds=max(map(abs, short)) < 0.2)
    holds = abs(bottom / top - 1) < 0.01
    rows("one-inductance", (top, bottom, most, ratio, c5_of(eq3._replace(inductance=top), LOW)), holds)
    rows("series-capacitors", f"1/(C3+C1) + 1/(C2+C0) + 1/C4 = {series:.5f} 1/pF".replace("-", "−"), holds=series >= 0)
    rows("band-eq3", (band, 100 * miss), holds=miss < 0.01)
    rows("band-eq1", (full, ends), holds=off < 0.01)
    rows(
        "exponent",
        (slopes[0.1], slopes[1.0]),
        error=0.5 - min(slopes.values()),
        guess=0.5,
        otherwise=TREND if min(slopes.values()) > 0 else FAILS,
    )
    rows("capacitance-in-use", (span, 1e3 * touch), holds=span[1] > 45)
    return [_band(top, bottom)]


def _percent(share: float) -> str:
    return f"{100 * share:+.1f} %".replace("-", "−")


@pictured("Xi2023 eqs. 1–3 and §2.2")
def _band(ax: Axes, top: float, bottom: float) -> None:
    """Frequency over the sensed capacitance. No curve passes through both printed ends: an inductance that meets one
    misses the other, and capacitors in series only flatten the curve."""
    c5 = np.linspace(8, 80, 300)
    ax.fill_between([C_LEAST, C_MOST], LOW, HIGH, color=QUIET, alpha=0.15, lw=0, label="printed: C5 and band")
    lines = {
        f"eq. 3, {top:.1f} µH": sensor.EQ3._replace(inductance=top),
        f"eq. 3, {bottom:.1f} µH": sensor.EQ3._replace(inductance=bottom),
        "preset eq3: eq. 3, 168 µH": sensor.EQ3,
        "preset eq1: eq. 1, 150 µH, 3 × 1000 pF": sensor.EQ1,
    }
    for (label, p), colour, line in zip(lines.items(), COLOURS, (":", "--", "-", "-"), strict=False):
        ax.plot(c5, [megahertz(p, float(c)) for c in c5], line, color=colour, label=label)
    ax.plot([C_MOST, C_LEAST], [LOW, HIGH], "k^", ms=6, label="printed ends")
    ax.set(xlabel="C5 (pF)", ylabel="frequency (MHz)", xlim=(8, 80), ylim=(1.4, 4.6))
    ax.legend(fontsize=8)


# -------------------------------------------------------------------------------------------------- calibration


@study("xi2023", "Calibration from 0 to 10 mm at 10 mm/s")
def calibration_run(trial: Trial, rows: Rows) -> list[Drawing]:
    """The machine's calibration runs: points, spacing, and what fewer points cost."""
    found = [heads.run(sensor.EQ3, seed) for seed in range(trial.seeds)]
    counts = [int(((f > 0) & (h > 0) & (h <= calibration.SPAN)).sum()) for f, h in found]
    gaps = [float(np.polyfit(np.arange((h > 0.5).sum()), h[h > 0.5], 1)[0]) for _, h in found]
    coarse = {n: _nearest_error(n) for n in TABLES}
    tables = [calibration.build(f, h) for f, h in found]
    falls = [float((np.diff(f[h > 0]) < 0).sum()) for f, h in found]
    risen = all((np.diff(t.frequency) > 0).all() for t in tables)
    refused = _refused(*found[0])
    rows("calibration-points", counts, holds=abs(np.median(counts) - 1000) <= 10)
    rows("calibration-spacing", gaps, holds=abs(np.median(gaps) / 0.01 - 1) < 0.01)
    holds = list(coarse.values()) == sorted(coarse.values())
    rows("more-points", (", ".join(f"{n}: {1e3 * e:.1f} µm" for n, e in coarse.items()), refused), holds)
    rows("rising-curve", falls, holds=risen)
    return [_calibration(*found[0], tables[0])]


def _nearest_error(entries: int) -> float:
    """Largest error in mm of the nearest of evenly spaced entries over 0.1–10 mm, on the exact curve."""
    grid = np.linspace(calibration.SPAN / entries, calibration.SPAN, entries)
    wanted = np.linspace(0.1, calibration.SPAN, 1999)
    place = np.interp(exact(wanted), exact(grid), np.arange(entries))
    return float(np.abs(grid[np.rint(place).astype(int)] - wanted).max())


def _refused(frequency: np.ndarray, height: np.ndarray) -> str:
    try:
        calibration.build(frequency[::2], height[::2])
    except calibration.CalibrationRefused as error:
        return f"the machine refuses half a run: {error}"
    return "the machine takes half a run"


@pictured("Xi2023 Fig. 7", 2)
def _calibration(left: Axes, right: Axes, frequency: np.ndarray, height: np.ndarray, table: calibration.Table) -> None:
    """A calibration run of the machine: contact, then up to 10 mm at 10 mm/s. Left the samples and the table made
    of them; right what a sample is off in height. The curve flattens upwards, so noise weighs more there."""
    inside = (frequency > 0) & (height > 0)
    f, h = frequency[inside], height[inside]
    left.plot(h, f / 1e6, ".", ms=3, color=COLOURS[4], label=f"samples, one per ms ({len(h)})")
    left.plot(table.height, table.frequency / 1e6, color=COLOURS[0], lw=1, zorder=3, label="table (1000 entries)")
    left.set(xlabel="height (mm)", ylabel="frequency (MHz)")
    left.legend(fontsize=8)
    off = 1e3 * (np.interp(f, table.frequency, table.height) - h)
    right.plot(h, off, ".", ms=3, color=COLOURS[4])
    right.set(xlabel="height (mm)", ylabel="sample's height − encoder (µm)")
    right.axhline(0, color=COLOURS[0], lw=1)


# ----------------------------------------------------------------------------------------------------- look-up


@study("xi2023", "Look-up by binary search")
def look_up(trial: Trial, rows: Rows) -> list[Drawing]:
    """The search against numpy's, and what is read between two entries."""
    table = heads.table(0)
    rng = np.random.default_rng(0)
    wanted = rng.uniform(table.frequency[0], table.frequency[-1], 4000)
    found = np.array([calibration.bracket(table.frequency, np.uint64(0), f) for f in wanted.tolist()]).astype(int)
    right = np.clip(np.searchsorted(table.frequency, wanted, side="right") - 1, 0, calibration.POINTS - 2)
    same = float((found == right).mean())
    heights = rng.uniform(0.1, 9.9, 1000)
    grid = table.height
    curve, f = exact(grid), exact(heights)
    first = np.uint64(0)
    # Where the entry lies if the curve were straight between the table's ends.
    straight = (wanted - table.frequency[0]) / (table.frequency[-1] - table.frequency[0]) * (calibration.POINTS - 1)
    errors = [
        float(max(abs(calibration.height(p, curve, grid, first, x)[0] - h) for x, h in zip(f, heights, strict=True)))
        for p in (calibration.Params(look_up=1.0), calibration.Params(look_up=0.0))
    ]
    rows("binary-search", 100 * same, error=1 - same, guess=float((straight.astype(int) != right).mean()))
    rows("nearest-entry", 1e3 * errors[0], holds=abs(errors[0] - 0.005) < 3e-4)
    rows("interpolation", 1e3 * errors[1], holds=errors[1] < 1e-3)
    return [_look_up(curve, grid)]


@pictured("Xi2023 §3.2")
def _look_up(ax: Axes, frequency: np.ndarray, grid: np.ndarray) -> None:
    """What the look-up alone adds, on an exact table: the nearest entry is off by up to 5 µm, a straight line
    between two entries by far less than 1 µm."""
    heights = np.linspace(0.48, 0.54, 601)
    f = exact(heights)
    for look, label, colour in ((1.0, "nearest entry", COLOURS[1]), (0.0, "interpolated", COLOURS[0])):
        p = calibration.Params(look_up=look)
        read = np.array([calibration.height(p, frequency, grid, np.uint64(0), x)[0] for x in f])
        ax.plot(heights, 1e3 * (read - heights), color=colour, label=label)
    ax.axhspan(-1, 1, color=QUIET, alpha=0.15, lw=0, label="claimed static accuracy ±0.001 mm")
    ax.set(xlabel="height (mm)", ylabel="reading − height (µm)", ylim=(-7, 9))
    ax.legend(fontsize=8, ncols=3, loc="upper center")
