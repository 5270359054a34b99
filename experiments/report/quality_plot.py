"""Quality of a cut against following error: how much better a follower must be before the cut shows it."""

import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ...envs.material import Material, material
from ...envs.plant import cut, streamed

ERRORS = np.array([0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0, 200.0, 300.0, 500.0])
"""µm, RMS of the standoff error."""

SHOWS = 0.01
"""Share by which dross or roughness must change to show: below it lies the scatter of any roughness measurement."""

_PERIODS = 40_000


def table(steel: Material, seed: int = 0) -> pd.DataFrame:
    """Dross (mm) and roughness (µm) by RMS standoff error (µm), at the recipe's feed, and relative to no error.

    The error is a Gaussian process with a correlation of 3 mm along the cut.
    """
    rng, p = np.random.default_rng(seed), steel.params
    way = steel.feed * 1e-3
    keep = np.exp(-way / 3.0)
    noise = rng.standard_normal(_PERIODS)
    process = np.empty(_PERIODS)
    value = noise[0]
    for i, x in enumerate(noise):
        value = keep * value + np.sqrt(1.0 - keep * keep) * x
        process[i] = value
    process /= np.sqrt(np.mean(process**2))
    beam = cut.beam(p, steel.power, 0.0, 0.0, 0.0, 0.0, 0.0)
    rows = []
    for error in ERRORS:
        figures = streamed.figures(p, beam, steel.feed, 1e-3 * error * process)[_PERIODS // 10 :]
        rows.append({"error": error, "dross": figures[:, 2].mean(), "roughness": 1e3 * figures[:, 1].mean()})
    frame = pd.DataFrame(rows)
    for name in ("dross", "roughness"):
        frame[f"{name}_change"] = frame[name] / frame[name].iloc[0] - 1.0
    return frame


def threshold(frame: pd.DataFrame) -> float:
    """Below this RMS standoff error a better follower changes neither dross nor roughness by 1 %."""
    change = frame[["dross_change", "roughness_change"]].abs().max(axis=1).to_numpy()
    if change.max() < SHOWS:
        return float("inf")
    return float(np.interp(SHOWS, change, frame["error"]))


def quality_against_error(name: str, thickness: float | None = None) -> tuple[np.ndarray, str]:
    """The picture, uint8 (height, width, 3), and what it says."""
    figure, words = drawn(name, thickness)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy(), words


def drawn(name: str, thickness: float | None = None) -> tuple[Figure, str]:
    """The figure, and what it says."""
    steel = material(name, thickness)
    frame = table(steel)
    limit = threshold(frame)
    figure = Figure(figsize=(8.0, 3.6), dpi=110, layout="constrained")
    axes = figure.subplots()
    for column, colour, label in (("dross", "#0072B2", "dross"), ("roughness", "#D55E00", "roughness Rz")):
        axes.plot(frame["error"], 100 * frame[f"{column}_change"], color=colour, marker="o", markersize=3, label=label)
    axes.set(xlabel="RMS standoff error (µm)", ylabel="change against no error (%)")
    axes.set_xscale("symlog", linthresh=1.0)
    axes.set_yscale("symlog", linthresh=0.1)
    axes.axhline(100 * SHOWS, color="#555c63", linewidth=0.8, linestyle=":")
    if np.isfinite(limit):
        axes.axvline(limit, color="#555c63", linewidth=0.8, linestyle="--")
    axes.grid(color="#d5d9dd", linewidth=0.6)
    axes.legend(frameon=False)
    title = f"{name}, {steel.thickness:g} mm: quality against following error"
    figure.suptitle(title, fontsize=11, fontweight="bold", x=0.01, ha="left")
    words = (
        f"{steel.label}. Below {limit:.0f} µm RMS a better follower changes neither dross nor roughness by 1 %."
        if np.isfinite(limit)
        else f"{steel.label}. Up to {ERRORS[-1]:.0f} µm RMS the following error does not show in this cut."
    )
    return figure, words
