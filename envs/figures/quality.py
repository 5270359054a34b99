"""Quality of a cut from its whole trajectory: the full form of the model whose streaming form is :mod:`plant.cut`.

The beam's energy is deposited along the simulated way of the spot, ``S_a = S_e + S_r`` (Huang2024 eq. 13), with a
Gaussian whose radius follows from the depth and the momentary focus, on a grid of cells along the path, layers over the
thickness and places across it. Its lateral density gives ∫p², effective width and kerf at each cell and depth, its edge
what path and dither write on the wall; melt margin, film, gas, roughness and dross follow as in the streaming form,
from the kerf of every layer.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from ..engine.quantity import InvalidInput
from ..plant import cut, gantry, spot
from ..plant.cut import CUTOFF, FILM, FLOW, LENGTH, WIDTH

Floats = npt.NDArray[np.float64]

CELL = 0.025
"""mm along the path."""

LAYERS = 10
BINS = 0.25
"""Rayleigh lengths of focus that are deposited together."""


@dataclass(frozen=True)
class Trajectory:
    """The way of the spot, sampled evenly in time and finely enough for the dither (20 samples a period).

    Arrays of equal length: ``along`` and ``across``, mm, of the spot, dither included, from the commanded path, left
    positive; ``carrier``, mm/s, speed of the axes along the path; ``standoff``, mm, standoff error; ``focus``, mm, of
    the spot above its nominal depth, dither included, standoff not; ``power``, W. ``dt`` in s.
    """

    dt: float
    along: Floats
    across: Floats
    carrier: Floats
    standoff: Floats
    focus: Floats
    power: Floats
    dithered: Floats  # mm, along the path: the dither's share of ``along``

    def __post_init__(self) -> None:
        size = len(self.along)
        for name in ("across", "carrier", "standoff", "focus", "power", "dithered"):
            array = getattr(self, name)
            if len(array) != size:
                raise InvalidInput(f"trajectory.{name} has {len(array)} samples; 'along' has {size}")
            if not np.isfinite(array).all():
                raise InvalidInput(f"trajectory.{name} holds a number that is not finite")


def travelled(channels: npt.NDArray[np.float32], optics: spot.Params, power: float, focus: float = 0.0) -> Trajectory:
    """The way of the spot in a recorded run, from the first to the last millisecond of its cut (one contour).

    The carrier is interpolated between milliseconds, the dither added to it as the optics realised it.

    Args:
        channels: of one machine, shape (periods, ``gantry.CHANNELS``).
        optics: its galvo and piezo.
        power: nominal, W.
        focus: added to the recorded focus, mm.

    Raises:
        InvalidInput: nothing was cut.
    """
    c = {name: channels[:, i].astype(float) for i, name in enumerate(gantry.CHANNELS)}
    cutting = np.flatnonzero((c["phase"] == gantry.LEAD_IN) | (c["phase"] == gantry.CUT))
    if len(cutting) < 2:
        raise InvalidInput("nothing was cut in this recording")
    part = slice(cutting[0], cutting[-1] + 1)
    c = {name: values[part] for name, values in c.items()}
    fastest = float(c["dither_frequency"].max())
    per = max(5, int(np.ceil(40.0 * fastest * 1e-3)))  # samples a millisecond
    ms = np.arange(len(c["s"]), dtype=float)
    t = np.arange((len(ms) - 1) * per + 1) / per

    def at(name: str) -> Floats:
        return np.asarray(np.interp(t, ms, c[name]), np.float64)

    real: Any = spot.Realised._make(at(f"dither_{name}") for name in spot.Realised._fields)
    turn = np.cumsum(np.append(0.0, real.frequency[1:])) * 1e-3 / per  # of the dither so far
    x, y, z = spot.offsets(optics, real, turn)
    tx, ty = at("tx"), at("ty")
    bent = np.maximum(np.hypot(tx, ty), 1e-9)  # around a corner the mean of two directions is shorter than either
    tx, ty = tx / bent, ty / bent
    if optics.along:
        dx, dy = x, y
    else:
        dx, dy = x * tx + y * ty, y * tx - x * ty
    along, across, watts = at("s") + dx, at("error") + dy, power * at("command_power")
    return Trajectory(1e-3 / per, along, across, at("speed"), at("gap_error"), z + focus, watts, dx)


@dataclass(frozen=True)
class Quality:
    """The cut, cell by cell along the path; lengths in mm. ``margin``: (cells, layers)."""

    place: Floats  # mm along the path
    margin: Floats
    roughness: Floats
    dross: Floats
    kerf_top: Floats
    kerf_bottom: Floats
    taper: Floats

    @property
    def through(self) -> npt.NDArray[np.bool_]:
        """Where the beam cuts through."""
        return self.margin.mean(axis=1) >= 1.0

    def means(self) -> dict[str, float]:
        """Means along the path, and the share that is cut through."""
        names = ("roughness", "dross", "kerf_top", "kerf_bottom", "taper")
        return {**{n: float(getattr(self, n).mean()) for n in names}, "through": float(self.through.mean())}


def evaluate(trajectory: Trajectory, p: cut.Params, span: float = 0.6) -> Quality:
    """The quality along a trajectory of constant direction or with ``along`` and ``across`` unrolled along its path.

    Args:
        trajectory: the way of the spot.
        p: material and coefficients.
        span: mm, how far the energy is followed to either side.

    Raises:
        InvalidInput: the spot leaves ``span``, or the way is shorter than 5 sampling lengths.
    """
    t = trajectory
    start, stop = float(t.along.min()), float(t.along.max())
    if stop - start < 5 * LENGTH:
        raise InvalidInput(f"the cut is {stop - start:.2f} mm long; at least {5 * LENGTH} mm are needed for Rz")
    if np.abs(t.across).max() > span:
        raise InvalidInput(f"the spot is up to {np.abs(t.across).max():.2f} mm beside the path; at most {span} mm")
    pitch = p.w0 / 12
    cells, places = int((stop - start) / CELL) + 1, 2 * int(span / pitch) + 1
    row, column = (t.along - start) / CELL, (t.across + span) / pitch
    depth = p.focus - t.standoff - t.focus
    which, levels = _bins(depth, BINS * p.zr)

    # Energy by place and focus, each sample shared by its four neighbours.
    maps = np.zeros((len(levels), cells + 1, places + 1))
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    u, w = row - i, column - j
    energy = t.power * t.dt
    for di, dj, share in ((0, 0, (1 - u) * (1 - w)), (1, 0, u * (1 - w)), (0, 1, (1 - u) * w), (1, 1, u * w)):
        np.add.at(maps, (which, np.minimum(i + di, cells), np.minimum(j + dj, places)), energy * share)

    layers = (np.arange(LAYERS) + 0.5) / LAYERS * p.thickness
    spread = t.dithered - t.dithered.mean()
    length = 4.0 * np.sqrt(0.25 * p.w0**2 + spread.var())
    absorbed = cut.absorptivity(p, length)
    front = length / CELL / np.sqrt(12.0)  # σ of a box as long as the front
    densities, edges, fields = [], [], []
    for depth_of in (*layers, 0.0, p.thickness):
        field = np.zeros((cells + 1, places + 1))
        for level, single in zip(levels, maps, strict=True):
            sigma = 0.5 * p.w0 * np.sqrt(1.0 + ((depth_of - level) / p.zr) ** 2)
            field += ndimage.gaussian_filter(single, (sigma / CELL, sigma / pitch), mode="nearest", truncate=5.0)
        smooth = ndimage.gaussian_filter1d(field, front, axis=0, mode="nearest")
        fields.append(smooth[:cells])
        if depth_of == 0.0:
            edges = [_edge(field, pitch, side) for side in (-1, 1)]
        elif depth_of < p.thickness:
            density = smooth / np.maximum(smooth.sum(axis=1, keepdims=True) * pitch, 1e-300)
            densities.append((density**2).sum(axis=1) * pitch)
    density = np.array(densities).T[:cells]
    v = np.maximum(_cellwise(t.carrier, i, cells), 0.05)
    power, error = _cellwise(t.power, i, cells), _cellwise(t.standoff, i, cells)
    margin = _margins(p, absorbed * power / p.thickness, v, density)
    log_g = np.log(np.where(error > 0, 1 / (1 + (error / p.gas_above) ** 2), 1 / (1 + (error / p.gas_below) ** 2)))
    log_g = log_g + float(np.log(p.pressure))
    mean = margin.mean(axis=1)
    each = [*margin.T, margin[:, 0], margin[:, -1]]  # of the layers, the top and the bottom
    *inner, top, low = (_kerf(field, m, pitch) for field, m in zip(fields, each, strict=True))
    kerf = np.array(inner).T
    thick, flow = _blown(p, v, margin, kerf, np.maximum(0.0, low / top - 1.0) ** 2)
    melted = p.rough * (thick / FILM) ** p.rough_power * np.exp(-p.rough_gas * log_g)
    ends = int((np.ptp(spread) + 2 * length) / CELL)  # where the dither has not been everywhere yet
    written = np.mean([_geometric(_interior(edge[:cells], ends)) for edge in edges], axis=0)
    felt = np.sqrt(ndimage.uniform_filter1d(error**2, int(5 * LENGTH / CELL), mode="nearest"))
    burnt = p.upturn * np.maximum(0.0, mean - p.upturn_from)
    rough = np.sqrt(melted**2 + written**2 + (p.follow * felt) ** 2 + burnt**2)
    dross = p.dross * np.cbrt(kerf.mean(axis=1) / WIDTH) * np.sqrt(FLOW / flow) * np.exp(-0.5 * log_g)
    place = np.asarray(start + CELL * np.arange(cells), np.float64)
    return Quality(place, margin, np.maximum(rough, p.floor), dross, top, low, 0.5 * np.abs(top - low))


def _blown(p: cut.Params, v: Floats, margin: Floats, kerf: Floats, widening: Floats) -> tuple[Floats, Floats]:
    """Melt film at the bottom (mm) and flow K, per cell, from melt margin and kerf, (cells, layers)."""
    u = (np.arange(LAYERS) + 0.5) / LAYERS
    cold = ((1.0 + p.carry * (1.0 - 2.0 * u)) / np.maximum(margin, 0.02)).mean(axis=1)

    def flow(film: Floats) -> Floats:
        gap = np.maximum(kerf - 2.0 * film[:, None] * np.sqrt(u), cut.OPEN * kerf)
        return 1.0 / (1.0 + widening + p.slot * p.thickness * (1.0 / gap).mean(axis=1))

    def film(flow: Floats) -> Floats:
        return np.sqrt(p.film * v * p.thickness * np.minimum(cold, 50.0) / flow)

    found = flow(film(flow(np.zeros(len(v)))))
    return film(found), found


def _bins(values: Floats, width: float) -> tuple[npt.NDArray[np.int64], Floats]:
    """Index of each value's bin, and the bins' middles."""
    low = float(values.min())
    count = max(1, int(np.ceil((values.max() - low) / width)))
    size = (float(values.max()) - low) / count
    if size == 0.0:
        return np.zeros(len(values), np.int64), np.array([low])
    which = np.minimum((values - low) / size, count - 1).astype(np.int64)
    return which, np.asarray(low + (np.arange(count) + 0.5) * size, np.float64)


def _cellwise(values: Floats, cell: npt.NDArray[np.int64], cells: int) -> Floats:
    """Mean of the samples in each cell; cells without any take their neighbours'."""
    count = np.bincount(cell, minlength=cells)[:cells]
    total = np.bincount(cell, values, minlength=cells)[:cells]
    known = np.flatnonzero(count)
    return np.interp(np.arange(cells), known, total[known] / count[known])


def _margins(p: cut.Params, absorbed: Floats, v: Floats, density: Floats) -> Floats:
    """Melt margin, (cells, layers), from absorbed W/mm and ∫p² in 1/mm."""
    width, v = 1.0 / density, v[:, None]
    needed = v * width * p.melt + p.conduct * (0.25 * v * width / p.diffusivity) ** 0.36
    share = density / density.mean(axis=1, keepdims=True)
    return (absorbed[:, None] * share + v * width * p.burn) / needed


def _edge(field: Floats, pitch: float, side: int) -> Floats:
    """Where the energy falls to half its usual maximum on one side of the kerf, mm, per cell."""
    level = 0.5 * np.median(field.max(axis=1))
    rows = field if side > 0 else field[:, ::-1]
    inside = rows >= level
    last = rows.shape[1] - 1 - np.argmax(inside[:, ::-1], axis=1)
    last = np.clip(last, 0, rows.shape[1] - 2)
    every = np.arange(len(rows))
    a, b = rows[every, last], rows[every, last + 1]
    place = last + np.clip((a - level) / np.maximum(a - b, 1e-300), 0.0, 1.0)
    return side * (place - 0.5 * (rows.shape[1] - 1)) * pitch


def _interior(edge: Floats, ends: int) -> Floats:
    """The edge with its first and last cells as their neighbours further in."""
    inner = edge[ends:-ends]
    return np.concatenate([np.full(ends, inner[0]), inner, np.full(ends, inner[-1])])


def _geometric(edge: Floats) -> Floats:
    """Mean of the five last peak-to-valleys of an edge behind the high-pass of CUTOFF, per cell."""
    passed = 2 * np.pi * CELL / CUTOFF
    keep = 1.0 / (1.0 + passed)
    base = np.empty_like(edge)
    value = edge[0]
    for i, x in enumerate(edge):
        value = keep * value + (1.0 - keep) * x
        base[i] = value
    rest, size = edge - base, round(LENGTH / CELL)
    count = len(rest) // size
    swing = np.ptp(rest[: count * size].reshape(count, size), axis=1)
    mean = np.array([swing[max(0, k - 4) : k + 1].mean() for k in range(count)])
    return (
        np.repeat(np.append(mean, mean[-1]), size)[: len(edge)] if len(rest) > count * size else np.repeat(mean, size)
    )


def _kerf(field: Floats, margin: Floats, pitch: float) -> Floats:
    """Width over which the energy exceeds what is needed; without dither and at m = 1 four σ, the paper's 2·ω0."""
    peak = field.max(axis=1, keepdims=True)
    wide = (field >= peak * np.exp(-2.0) / np.maximum(margin, 1e-6)[:, None]).sum(axis=1)
    return np.maximum(wide, 1) * pitch


def iso_range(roughness: float, thickness: float) -> str:
    """Range of ISO 9013 of a mean height of the profile Rz5, both in mm: ``"1"`` … ``"4"`` or ``"outside"``."""
    limits = [(10 + 0.6 * thickness), (40 + 0.8 * thickness), (70 + 1.2 * thickness), (110 + 1.8 * thickness)]
    return _range(1e3 * roughness, limits)


def iso_taper(u: float, thickness: float) -> str:
    """Range of ISO 9013 of a perpendicularity tolerance u, both in mm: ``"1"`` … ``"5"`` or ``"outside"``."""
    limits = [
        0.05 + 0.003 * thickness,
        0.15 + 0.007 * thickness,
        0.4 + 0.01 * thickness,
        0.8 + 0.02 * thickness,
        1.2 + 0.035 * thickness,
    ]
    return _range(u, limits)


def _range(value: float, limits: list[float]) -> str:
    return next((str(i) for i, limit in enumerate(limits, start=1) if value <= limit), "outside")
