"""The sheet that a follow log went along, as far as its own height tells."""

import numpy as np

from ...envs.plant import calibration
from .log import PERIOD, Log

SMOOTH = 15
"""Samples of the running mean; sheets have nothing faster that a head follows [A]."""

SPACING = 0.1
"""mm between two heights of a profile."""


def surface_of(log: Log, table: calibration.Table | None = None) -> tuple[np.ndarray, float, float]:
    """Heights of the sheet along the path, mm, their spacing, mm, and the feed, mm/s.

    Encoder less height, smoothed; what was not valid is a line between its ends. Without ``x`` the feed is taken as
    100 mm/s. With a table, the height is that of the log's frequency, unfiltered.
    """
    encoder, height, frequency = log["encoder"], log["height"], None
    if table is not None and "frequency" in log:
        frequency = log["frequency"]
        order = np.argsort(table.frequency)
        height = np.where(frequency > 0, np.interp(frequency, table.frequency[order], table.height[order]), 0.0)
    valid = (log["height"] > 0) & (height > 0)
    at = np.arange(len(encoder))
    sheet = np.interp(at, at[valid], (encoder - height)[valid])
    kernel = np.ones(SMOOTH) / SMOOTH
    smooth = np.convolve(np.pad(sheet, SMOOTH // 2, mode="edge"), kernel, mode="valid")
    feed = float(np.median(np.diff(log["x"])) / PERIOD) if "x" in log else 100.0
    place = log["x"] - log["x"][0] if "x" in log and feed > 0 else at * PERIOD * 100.0
    feed = feed if feed > 0 else 100.0
    even = np.arange(0.0, max(float(place[-1]), SPACING), SPACING)
    made = np.interp(even, np.maximum.accumulate(place), smooth)
    return made - made[0], SPACING, feed
