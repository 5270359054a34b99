"""Spectra of the true error: at which frequencies a follower leaves what it leaves."""

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from scipy.signal import welch

from ...envs.plant import supervisor
from ...envs.plant.controller import PERIOD
from ..plots.palette import Look
from .figure import Figure, line, logarithmic
from .suite import Suite

SEGMENT = 512
"""Periods of a segment: 2 Hz apart."""

DECADES = 5.0
"""Below the largest density that are shown."""


def spectrum(error: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Frequencies (Hz) and density of the counted stretches (Welch 1967; Hann, half overlap), in the error's unit/√Hz.

    Stretches shorter than a segment are left out; None if all are.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], counted.astype(np.int8), [0]])))
    total, weight, frequency = 0.0, 0, None
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start >= SEGMENT:
            frequency, power = welch(error[start:stop], 1.0 / PERIOD, nperseg=SEGMENT)
            total, weight = total + power * (stop - start), weight + (stop - start)
    return None if frequency is None else (frequency[1:], np.sqrt(total / weight)[1:])


def figure(suites: list[Suite], look: dict[str, Look], labels: dict[str, str]) -> Figure | None:
    """A view for each traced scenario; None without traces long enough."""
    views = {}
    for suite, scenario in [(s, scenario) for s in suites for scenario in s.traced]:
        seeds = suite.traces[scenario].values()
        plot = go.Figure()
        for name in suite.ranked:
            one = _mean([runs[name] for runs in seeds if name in runs])
            if one is None:
                continue
            f, density = one
            drawn = {"name": labels[name], "line": line(look[name], 1.6), "mode": "lines"}
            told = "%{y:.3g} µm/√Hz at %{x:.0f} Hz"
            plot.add_scatter(x=f.astype("f4"), y=density.astype("f4"), hovertemplate=told, **drawn)
        if not plot.data:
            continue
        most = max(float(np.max(trace.y)) for trace in plot.data) or 1.0
        plot.update_layout(
            xaxis={**logarithmic(1.0 / (SEGMENT * PERIOD), 0.5 / PERIOD), "title": "frequency (Hz)"},
            yaxis={
                "type": "log",
                "title": "true gap error (µm/√Hz)",
                "exponentformat": "power",
                "dtick": 1,
                "range": [np.log10(most) - DECADES, np.log10(2 * most)],
            },
        )
        views[scenario] = plot
    if not views:
        return None
    caption = (
        f"Density of the true gap error in the traced runs (Welch, segments of {SEGMENT * PERIOD:.3g} s, Hann), where "
        "it is scored and before any alarm. The area under the square of a line is its mean-square error. The "
        "head follows what is slower than the peak of |S|. It cannot follow what is faster; a good loop does not make "
        "that worse."
    )
    return Figure("spectra", "Error spectra", caption, views, "scenario", height=440)


def _mean(runs: list[pd.DataFrame]) -> tuple[np.ndarray, np.ndarray] | None:
    """Root of the mean power over the seeds."""
    found = []
    for run in runs:
        error, counted = error_of(run)
        one = spectrum(error, counted)
        if one is not None:
            found.append(one)
    if not found:
        return None
    return found[0][0], np.sqrt(np.mean([density**2 for _, density in found], axis=0))


def error_of(run: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """True gap error of a traced run, µm, and where it counts: scored, before any alarm, finite."""
    if "gap_error" in run:
        from ...envs.plant.gantry import CUT, LEAD_IN

        error = 1e3 * run["gap_error"].to_numpy(float)
        return error, run["phase"].isin([LEAD_IN, CUT]).to_numpy() & np.isfinite(error)
    error = 1e3 * (run["gap"] - run["set_height"]).to_numpy(float)
    alarm = np.maximum.accumulate(run["mode"].to_numpy(float) == supervisor.ALARM)
    return error, (run["scored"].to_numpy(float) > 0.5) & ~alarm & np.isfinite(error)
