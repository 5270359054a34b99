"""Pooling: how one number is made of a metric's many runs. Terminal, Markdown, CSV, page and searches all use this.

================  ==========================  ====================================
metric            over the seeds              over the scenarios
================  ==========================  ====================================
an RMS            root mean square            geometric mean
a largest value   largest                     largest
a smallest value  smallest                    smallest
a share, a time   mean                        mean, because it may be 0 or infinite
anything else     mean                        geometric mean
================  ==========================  ====================================

What is pooled are runs that did not fail; how many failed stands beside it (:mod:`comparison`).
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

RMS, MEAN, LARGEST, SMALLEST = "rms", "mean", "largest", "smallest"

ZERO = (
    "collision", "held", "overshoot", "undershoot", "settling_20um", "settling_10um", "min_gap", "through", "covered",
)  # fmt: skip
"""Metrics that may be zero or infinite in good runs, of which there is no geometric mean."""

RATES = ("collision", "covered")
"""Metrics that a failed run has as well: they are pooled over all runs."""


def kind(name: str) -> str:
    """How a metric is pooled over the seeds: :data:`RMS`, :data:`MEAN`, :data:`LARGEST` or :data:`SMALLEST`."""
    if name.startswith("rms_") or name.endswith("_rms"):
        return RMS
    if name.startswith("max_") or name.endswith("_max") or name in ("overshoot", "undershoot"):
        return LARGEST
    return SMALLEST if name.startswith("min_") else MEAN


def power(name: str) -> float:
    """Exponent of the mean over the seeds: 2 of an RMS, 1 of a mean; NaN of what is no mean."""
    return {RMS: 2.0, MEAN: 1.0}.get(kind(name), float("nan"))


def over_seeds(name: str, values: Any) -> float:
    """One number of a scenario's runs; NaN if one of them has none, or there is none."""
    array = np.asarray(values, float)
    if not array.size:
        return float("nan")
    match kind(name):
        case "rms":
            return float(np.sqrt(np.mean(np.square(array))))
        case "largest":
            return float(array.max())
        case "smallest":
            return float(array.min())
    return float(array.mean())


def over_scenarios(name: str, values: Iterable[float]) -> float:
    """One number of those of the scenarios; NaN if one of them has none, or there is none."""
    array = np.asarray(list(values), float)
    if not array.size:
        return float("nan")
    how = kind(name)
    if how in (LARGEST, SMALLEST):
        return float(array.max() if how == LARGEST else array.min())
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(array.mean() if name in ZERO else np.exp(np.log(array).mean()))
