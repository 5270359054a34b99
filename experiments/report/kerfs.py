"""Kerf maps: the part as it was cut, coloured by what the reader asks for, a panel for each controller."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from ...envs.pictures.kerf_picture import DIVERGING, EVEN, QUANTITIES, limits_of
from ...envs.plant import cut, streamed
from ...envs.scenarios import material
from .pack import Channel, pack
from .scope import groups_of, telling
from .spectra import error_of
from .suite import Suite

Floats = npt.NDArray[np.float64]

PIECES = 2000
"""Coloured pieces of a kerf, at most; each shows the largest error or the mean quality of its periods."""

RESOLUTION = {"standoff": 0.05, "contour": 0.05, "dross": 1e-4, "roughness": 0.01}
"""To which values are kept, in the units of :data:`QUANTITIES`."""


def widget(suites: list[Suite], labels: dict[str, str]) -> dict[str, Any] | None:
    """What ``kerfs.js`` shows: one seed of each scenario that goes along a drawing; None if none does."""
    groups = groups_of(suites, _run)
    if not groups:
        return None
    quantities = {
        name: {"title": q.title, "unit": q.unit, "colours": (DIVERGING if q.signed else EVEN).astype(int).tolist()}
        for name, q in QUANTITIES.items()
    }
    return {"groups": groups, "labels": labels, "quantities": quantities, "first": telling(suites, groups)}


def _run(suite: Suite, seed: int, parts: dict[str, pd.DataFrame]) -> dict[str, Any] | None:
    parts = {name: run for name, run in parts.items() if {"x", "y"} <= set(run)}
    controllers: dict[str, Any] = {}
    seen: dict[str, list[Floats]] = {}
    for name, run in parts.items():
        found = coloured(run)
        if found is None:
            continue
        x, y, cutting, through, values = pieces(*found)
        for quantity, array in values.items():
            seen.setdefault(quantity, []).append(array[cutting > 0.5])
        channels = [Channel(x, 1e-3), Channel(y, 1e-3), Channel(cutting, 1.0), Channel(through, 1.0)]
        channels += [Channel(array, RESOLUTION[quantity]) for quantity, array in values.items()]
        controllers[name] = {"quantities": list(values), **pack(channels)}
    if not controllers:
        return None
    limits = {name: limits_of(np.concatenate(arrays), QUANTITIES[name]) for name, arrays in seen.items()}
    first = {"contour_rms": "contour"}.get(suite.metric, suite.metric if suite.metric in limits else "standoff")
    return {"seed": seed, "limits": limits, "controllers": controllers, "first": first}


def coloured(
    run: pd.DataFrame,
) -> tuple[Floats, Floats, npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Floats]] | None:
    """Place (mm), whether it is cut, whether it goes through, and the quantities of a traced run; None without place.

    A follower along a drawing is taken to cut thin sheet, as in its metrics.
    """
    x, y = (run[axis].to_numpy(float) for axis in ("x", "y"))
    there = np.isfinite(x) & np.isfinite(y)
    if there.sum() < 2:
        return None
    error, cutting = error_of(run)
    if "gap_error" in run:
        columns = {"standoff": "gap_error", "contour": "error", "dross": "dross", "roughness": "roughness"}
        values = {name: QUANTITIES[name].factor * run[column].to_numpy(float) for name, column in columns.items()}
        through = run["margin"].to_numpy(float)[there] >= 1.0
        return x[there], y[there], cutting[there], through, {name: array[there] for name, array in values.items()}
    steel = material.material("thin-sheet")
    beam = cut.beam(steel.params, steel.power, 0.0, 0.0, 0.0, 0.0, 0.0)
    values = {"standoff": error} | {name: np.full(len(error), np.nan) for name in ("dross", "roughness")}
    if cutting.any():
        figures = streamed.figures(steel.params, beam, steel.feed, 1e-3 * error[cutting])
        for name in ("dross", "roughness"):
            column = figures[:, cut.Figures._fields.index(name)]
            values[name][cutting] = QUANTITIES[name].factor * column
    return x[there], y[there], cutting[there], np.ones(int(there.sum()), bool), {n: v[there] for n, v in values.items()}


def pieces(
    x: Floats, y: Floats, cutting: npt.NDArray[np.bool_], through: npt.NDArray[np.bool_], values: dict[str, Floats]
) -> tuple[Floats, Floats, Floats, Floats, dict[str, Floats]]:
    """The same in pieces of equal length: their starts, and of what happened in each the worst error and the mean
    quality; a piece is cut if any of it is, and through if all of it is."""
    way = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    marks = np.searchsorted(way, np.linspace(0.0, way[-1], PIECES + 1)[:-1], "right") - 1
    marks = np.unique(np.concatenate([[0], marks, np.flatnonzero(np.diff(cutting.astype(int))) + 1]))
    out = {}
    for name, array in values.items():
        known = np.where(np.isfinite(array), array, 0.0)
        if QUANTITIES[name].signed:
            high, low = np.maximum.reduceat(known, marks), np.minimum.reduceat(known, marks)
            out[name] = np.where(-low > high, low, high)
        else:
            weight = np.isfinite(array).astype(float)
            out[name] = np.add.reduceat(known, marks) / np.maximum(np.add.reduceat(weight, marks), 1.0)
    cuts = np.logical_or.reduceat(cutting, marks).astype(float)
    return x[marks], y[marks], cuts, np.logical_and.reduceat(through | ~cutting, marks).astype(float), out
