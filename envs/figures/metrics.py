"""Metrics: plain functions of a recorded run, each with unit, direction and meaning, registered once.

Each takes a :class:`Recording` and returns one number per machine, shape (machines,). Following is measured on the
*true* gap, and beside it on the reported height. A run is scored until the nozzle touches the sheet, since afterwards
the head is retracted; that it touched is a figure of its own. A run with a value that is not finite shows as NaN. Both
are failures, which are counted and never dropped (:func:`failed`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..engine.quantity import InvalidInput, did_you_mean
from ..plant.controller import PERIOD
from .recording import Recording


@dataclass(frozen=True)
class Metric:
    """A registered metric; ``better`` is ``"lower"`` or ``"higher"``."""

    name: str
    unit: str
    better: str
    summary: str
    function: Callable[[Recording], np.ndarray]


METRICS: dict[str, Metric] = {}


def metric(unit: str, better: str = "lower") -> Callable:
    """Registers a function (recording → one number per machine) under its name; its docstring's first line is shown."""

    def register(function: Callable[[Recording], np.ndarray]) -> Callable[[Recording], np.ndarray]:
        name, doc = function.__name__, (function.__doc__ or "").split("\n")[0]
        METRICS[name] = Metric(name, unit, better, doc, function)
        return function

    return register


def get(name: str) -> Metric:
    """A metric by name; raises :class:`InvalidInput` with the nearest name."""
    if name not in METRICS:
        raise InvalidInput(f"unknown metric '{name}'; {did_you_mean(name, METRICS)}")
    return METRICS[name]


def evaluate(recording: Recording) -> dict[str, np.ndarray]:
    """Every metric of a recording, by name; a broken run has no figure but its collision."""
    lost = broken(recording)
    figures = {name: each.function(recording) for name, each in METRICS.items()}
    return {name: f if name == "collision" else np.where(lost, np.nan, f) for name, f in figures.items()}


def broken(recording: Recording) -> np.ndarray:
    """Whether a run holds anything that is not finite, or nothing to score."""
    finite = np.isfinite(recording.data).all(axis=(0, 1))
    return ~finite | (recording.scored.sum(axis=0) == 0)


def failed(recording: Recording) -> np.ndarray:
    """Whether a run is broken, or the nozzle touched the sheet in a scenario that is not built for that."""
    return broken(recording) | (recording.collided & (not recording.scenario.exempt))


def _rms(error: np.ndarray, mask: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return 1e3 * np.sqrt((np.where(mask, error, 0.0) ** 2).sum(axis=0) / mask.sum(axis=0))


def _largest(error: np.ndarray, mask: np.ndarray, share: float) -> np.ndarray:
    """The ``share`` quantile of |error| over the scored periods, µm: the smallest value not exceeded by that share."""
    magnitude = np.sort(np.where(mask, np.abs(error), np.inf), axis=0)
    count = mask.sum(axis=0)
    at = np.maximum(np.ceil(share * count).astype(int) - 1, 0)
    value = np.take_along_axis(magnitude, at[None], axis=0)[0]
    return np.where(count > 0, 1e3 * value, np.nan)


@metric("µm")
def rms_true(r: Recording) -> np.ndarray:
    """RMS of the true gap error while cutting"""
    return _rms(r.error, r.scored)


@metric("µm")
def p99_true(r: Recording) -> np.ndarray:
    """99th percentile of the true gap error's magnitude while cutting"""
    return _largest(r.error, r.scored, 0.99)


@metric("µm")
def max_true(r: Recording) -> np.ndarray:
    """Largest true gap error while cutting"""
    return _largest(r.error, r.scored, 1.0)


@metric("µm")
def rms_reported(r: Recording) -> np.ndarray:
    """RMS of the reported (measured, filtered) error while cutting"""
    return _rms(r.reported_error, r.scored)


@metric("µm")
def p99_reported(r: Recording) -> np.ndarray:
    """99th percentile of the reported error's magnitude while cutting"""
    return _largest(r.reported_error, r.scored, 0.99)


@metric("µm")
def max_reported(r: Recording) -> np.ndarray:
    """Largest reported error while cutting"""
    return _largest(r.reported_error, r.scored, 1.0)


def _settling(r: Recording, band: float) -> np.ndarray:
    outside = np.abs(r.error) > band
    last = len(outside) - np.argmax(outside[::-1], axis=0)
    last[~outside.any(axis=0)] = 0
    return np.where(last < len(outside), last * PERIOD, np.inf)


@metric("s")
def settling_20um(r: Recording) -> np.ndarray:
    """Time after which the true error stays within ±0.02 mm to the end; infinite if it never does"""
    return _settling(r, 0.02)


@metric("s")
def settling_10um(r: Recording) -> np.ndarray:
    """Time after which the true error stays within ±0.01 mm to the end; infinite if it never does"""
    return _settling(r, 0.01)


def _after_first_arrival(r: Recording) -> np.ndarray:
    """Periods from the first at which the set height is reached (within 0.01 mm) on."""
    return np.maximum.accumulate(r.error <= 0.01, axis=0)


@metric("mm")
def overshoot(r: Recording) -> np.ndarray:
    """Largest excursion below the set height after first reaching it"""
    return np.where(_after_first_arrival(r), np.maximum(-r.error, 0.0), 0.0).max(axis=0)


@metric("mm")
def undershoot(r: Recording) -> np.ndarray:
    """Largest excursion above the set height after first reaching it"""
    return np.where(_after_first_arrival(r), np.maximum(r.error, 0.0), 0.0).max(axis=0)


@metric("mm")
def dross(r: Recording) -> np.ndarray:
    """Height of the dross on thin sheet, mean along the cut (proxy, assumed coefficients)"""
    return r.thin_sheet["dross"]


@metric("µm")
def roughness(r: Recording) -> np.ndarray:
    """Roughness Rz on thin sheet, mean along the cut (proxy, assumed coefficients)"""
    return 1e3 * r.thin_sheet["roughness"]


@metric("1")
def collision(r: Recording) -> np.ndarray:
    """1 if the nozzle touched the sheet"""
    return r.collided.astype(float)


@metric("mm", "higher")
def min_gap(r: Recording) -> np.ndarray:
    """Smallest true gap over sheet"""
    return r.lowest


@metric("mm/s")
def z_travel(r: Recording) -> np.ndarray:
    """Z travel of the motor per second"""
    return np.abs(r["velocity"].astype(np.float64)).mean(axis=0)


@metric("mm/s per ms")
def jitter(r: Recording) -> np.ndarray:
    """RMS change of the command from period to period"""
    return np.sqrt(np.mean(np.diff(r["command"].astype(np.float64), axis=0) ** 2, axis=0))


@metric("mm/s²")
def rms_acceleration(r: Recording) -> np.ndarray:
    """RMS acceleration of the motor"""
    return np.sqrt(np.mean(r["acceleration"].astype(np.float64) ** 2, axis=0))


@metric("mm/s³")
def rms_jerk(r: Recording) -> np.ndarray:
    """RMS jerk of the motor, from its acceleration once per period"""
    return np.sqrt(np.mean((np.diff(r["acceleration"].astype(np.float64), axis=0) / PERIOD) ** 2, axis=0))


@metric("1")
def held(r: Recording) -> np.ndarray:
    """Share of the time in which the supervisor overrode the law"""
    return r["override"].astype(np.float64).mean(axis=0)
