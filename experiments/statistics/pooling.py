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

Each metric says which it is (:class:`envs.figures.registered.Metric`). What is pooled are runs that did not fail;
how many failed stands beside it (:mod:`comparison`).
"""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from ...envs.figures import job_metrics, metrics
from ...envs.figures.registered import Metric

OF: dict[str, Callable[[np.ndarray], Any]] = {
    "rms": lambda values: np.sqrt(np.mean(np.square(values))),
    "mean": np.mean,
    "largest": np.max,
    "smallest": np.min,
}
"""What a metric's pooling makes of its values."""


def declared(name: str) -> Metric:
    """What a metric of followers or of jobs says about itself."""
    return metrics.METRICS.get(name) or job_metrics.METRICS[name]


def power(name: str) -> float:
    """Exponent of the mean over the seeds: 2 of an RMS, 1 of a mean; NaN of what is no mean."""
    return {"rms": 2.0, "mean": 1.0}.get(declared(name).pooled, float("nan"))


def over_seeds(name: str, values: Any) -> float:
    """One number of a scenario's runs; NaN if one of them has none, or there is none."""
    array = np.asarray(values, float)
    return float(OF[declared(name).pooled](array)) if array.size else float("nan")


def over_scenarios(name: str, values: Iterable[float]) -> float:
    """One number of those of the scenarios; NaN if one of them has none, or there is none."""
    array, metric = np.asarray(list(values), float), declared(name)
    if metric.pooled in ("largest", "smallest") or not array.size:
        return over_seeds(name, array)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(array.mean() if metric.zero else np.exp(np.log(array).mean()))
