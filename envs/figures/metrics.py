"""Metrics: plain functions of a recorded run, registered once with all that :class:`.registered.Metric` holds.

Each takes a :class:`Recording` and returns one number per machine, shape (machines,). Following is measured on the
*true* gap, and beside it on the reported height. A run is scored until the nozzle touches the sheet, since afterwards
the head is retracted; that it touched is a figure of its own. A run with a value that is not finite shows as NaN. Both
are failures, which are counted and never dropped (:func:`failed`).
"""

import numpy as np

from ..plant.controller import PERIOD
from .recording import Recording
from .registered import Called, Registry, Shown

METRICS = Registry()
metric, get = METRICS.metric, METRICS.named

ERROR, CUT = "true gap error", "cut of thin sheet"
P99 = Shown("P99", "{:.1f}", "p99", ERROR, brief=True, said="99th percentile of the true error's magnitude, {over}")
MAX = Shown("max", "{:.0f}", "max", ERROR, brief=True, said="largest true error of all scored runs that did not fail")
BELIEVED = "the same as the score, had one believed the measured and filtered height"
REPORTED = Shown("reported", "{:.2f}", "reported", "reported", "RMS", brief=True, compared=True, said=BELIEVED)
DROSS = Shown("dross", "{:.4f}", "", CUT, brief=True, said="height of the dross (proxy), {over}")
RANGED = "roughness (proxy), {over}, and its range after ISO 9013; 1 is the finest"
ROUGHNESS = Shown("Rz", "{:.2f}", "", CUT, brief=True, said=RANGED)
PLAIN = "{summary}, {over}"
JITTER = Shown("jitter", "{:.2f}", "", "command", brief=True, titled=False, manual=True, compared=True, said=PLAIN)


def evaluate(recording: Recording) -> dict[str, np.ndarray]:
    """Every metric of a recording, by name; a broken run has none but those that are always known."""
    lost = broken(recording)
    figures = {name: each.function(recording) for name, each in METRICS.items()}
    return {name: f if METRICS[name].always else np.where(lost, np.nan, f) for name, f in figures.items()}


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


@metric("µm", pooled="rms", shown=None, called=Called("following error", "closer", "true gap error, RMS"))
def rms_true(r: Recording) -> np.ndarray:
    """RMS of the true gap error while cutting"""
    return _rms(r.error, r.scored)


@metric("µm", shown=P99)
def p99_true(r: Recording) -> np.ndarray:
    """99th percentile of the true gap error's magnitude while cutting"""
    return _largest(r.error, r.scored, 0.99)


@metric("µm", pooled="largest", shown=MAX, called=Called(exact="true gap error, largest"))
def max_true(r: Recording) -> np.ndarray:
    """Largest true gap error while cutting"""
    return _largest(r.error, r.scored, 1.0)


@metric("µm", pooled="rms", shown=REPORTED, called=Called(exact="reported error, RMS"))
def rms_reported(r: Recording) -> np.ndarray:
    """RMS of the reported (measured, filtered) error while cutting"""
    return _rms(r.reported_error, r.scored)


@metric("µm", shown=None)
def p99_reported(r: Recording) -> np.ndarray:
    """99th percentile of the reported error's magnitude while cutting"""
    return _largest(r.reported_error, r.scored, 0.99)


@metric("µm", pooled="largest", shown=None)
def max_reported(r: Recording) -> np.ndarray:
    """Largest reported error while cutting"""
    return _largest(r.reported_error, r.scored, 1.0)


def _settling(r: Recording, band: float) -> np.ndarray:
    outside = np.abs(r.error) > band
    last = len(outside) - np.argmax(outside[::-1], axis=0)
    last[~outside.any(axis=0)] = 0
    return np.where(last < len(outside), last * PERIOD, np.inf)


@metric("s", zero=True, shown=None)
def settling_20um(r: Recording) -> np.ndarray:
    """Time after which the true error stays within ±0.02 mm to the end; infinite if it never does"""
    return _settling(r, 0.02)


@metric("s", zero=True, shown=None)
def settling_10um(r: Recording) -> np.ndarray:
    """Time after which the true error stays within ±0.01 mm to the end; infinite if it never does"""
    return _settling(r, 0.01)


def _after_first_arrival(r: Recording) -> np.ndarray:
    """Periods from the first at which the set height is reached (within 0.01 mm) on."""
    return np.maximum.accumulate(r.error <= 0.01, axis=0)


@metric("mm", pooled="largest", zero=True, shown=None)
def overshoot(r: Recording) -> np.ndarray:
    """Largest excursion below the set height after first reaching it"""
    return np.where(_after_first_arrival(r), np.maximum(-r.error, 0.0), 0.0).max(axis=0)


@metric("mm", pooled="largest", zero=True, shown=None)
def undershoot(r: Recording) -> np.ndarray:
    """Largest excursion above the set height after first reaching it"""
    return np.where(_after_first_arrival(r), np.maximum(r.error, 0.0), 0.0).max(axis=0)


@metric("mm", shown=DROSS, called=Called("dross", "less"))
def dross(r: Recording) -> np.ndarray:
    """Height of the dross on thin sheet, mean along the cut (proxy, assumed coefficients)"""
    return r.thin_sheet["dross"]


@metric("µm", shown=ROUGHNESS, called=Called("roughness Rz", "smoother"))
def roughness(r: Recording) -> np.ndarray:
    """Roughness Rz on thin sheet, mean along the cut (proxy, assumed coefficients)"""
    return 1e3 * r.thin_sheet["roughness"]


@metric("1", zero=True, always=True, shown=None)
def collision(r: Recording) -> np.ndarray:
    """1 if the nozzle touched the sheet"""
    return r.collided.astype(float)


@metric("mm", "higher", pooled="smallest", zero=True, shown=None)
def min_gap(r: Recording) -> np.ndarray:
    """Smallest true gap over sheet"""
    return r.lowest


@metric("mm/s", shown=None)
def z_travel(r: Recording) -> np.ndarray:
    """Z travel of the motor per second"""
    return np.abs(r["velocity"].astype(np.float64)).mean(axis=0)


@metric("mm/s per ms", shown=JITTER, called=Called("command jitter"))
def jitter(r: Recording) -> np.ndarray:
    """RMS change of the command from period to period"""
    return np.sqrt(np.mean(np.diff(r["command"].astype(np.float64), axis=0) ** 2, axis=0))


@metric("mm/s²", pooled="rms", shown=None)
def rms_acceleration(r: Recording) -> np.ndarray:
    """RMS acceleration of the motor"""
    return np.sqrt(np.mean(r["acceleration"].astype(np.float64) ** 2, axis=0))


@metric("mm/s³", pooled="rms", shown=None)
def rms_jerk(r: Recording) -> np.ndarray:
    """RMS jerk of the motor, from its acceleration once per period"""
    return np.sqrt(np.mean((np.diff(r["acceleration"].astype(np.float64), axis=0) / PERIOD) ** 2, axis=0))


@metric("1", zero=True, shown=None)
def held(r: Recording) -> np.ndarray:
    """Share of the time in which the supervisor overrode the law"""
    return r["override"].astype(np.float64).mean(axis=0)
