"""The sheet from a follow log: the surface under the nozzle along the path, and the scenario that it makes.

Surface = nozzle − measured height. The nozzle is where the encoder says, through the structural mode of the mounting.
The height is that of the newest count, through the calibration table, so no filter has delayed it; encoder and count
belong to the same gate. Impulses, contacts and heights beyond the table are left out and bridged.

What remains is the sheet as the sensor's plate feels it, and noise. An optimal linear smoother (Wiener 1949) separates
them: each wavenumber is weighed by the share of its power that is signal. The power is the log's own spectrum,
averaged over neighbours; the noise is what that has at wavelengths far below the plate, where no sheet can be felt. So
its bandwidth follows from both. The surface under the nozzle's tip is that divided by what the plate has weakened more
than the tip does.

The profile of the scenario is what the plate feels, since profiles have but one footprint there. So controllers see
what they would on the machine, and the reported error is that of the machine; :func:`under_tip` tells the gap under the
tip.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage, signal, stats

from ...envs.engine.quantity import InvalidInput
from ...envs.figures.recording import Recording
from ...envs.plant import calibration, sheet
from ...envs.plant.controller import PERIOD
from ...envs.scenarios.distributions import middle
from ...envs.scenarios.hardware import Axis
from .log import Log
from .roughness import FELT

SHORTEST = 100.0
"""mm that a follow log must travel."""

FILTERED = 2.0
"""ms by which a height is late where a log has no frequency: the mean of five samples (Xi2023)."""

AROUND, OFF = 15, 6.0
"""Samples of whose median an impulse is off, and by how many times their scatter."""

QUIET = (0.3, 0.6)
"""Shares of the highest wavenumber between which there is only noise."""

MOVES = 1e-3
"""mm RMS of what is no shape, from which on it is said [A]."""

SURE = 3.0
"""Standard errors by which smoothed power must be above the noise."""

CHI2 = float(stats.chi2.median(1))


@dataclass(frozen=True)
class Followed:
    """A sheet, as one journey found it.

    Attributes:
        position: mm along the path, even, from 0.
        height: mm, surface as the plate feels it, without the noise; 0 at the start.
        tip: mm, surface under the nozzle's tip, on the same level.
        felt: mm, what the plate felt, with the noise.
        noise: µm RMS, of one sample.
        feed: mm/s, median of the journey.
        slows: share of the time that the feed is over 10 % below that.
        set_height: mm.
        duration: s.
        plate: mm, radius of its footprint.
        left_out: share of the samples that are no surface: impulses, contacts, what the table does not reach.
        notes: what had to be assumed.
    """

    position: np.ndarray
    height: np.ndarray
    tip: np.ndarray
    felt: np.ndarray
    noise: float
    feed: float
    slows: float
    set_height: float
    duration: float
    plate: float
    left_out: float
    notes: tuple[str, ...] = ()

    @property
    def spacing(self) -> float:
        """mm."""
        return float(self.position[1] - self.position[0])


def along(log: Log) -> np.ndarray:
    """Distance travelled along the path, mm, of each sample.

    Raises:
        InvalidInput: the log does not say where the nozzle was, or it went nowhere.
    """
    if "x" not in log:
        raise InvalidInput(f"{log.name}: a sheet has places; the follow log needs a column x, and y if the path turns")
    way = [np.diff(log[name]) for name in ("x", "y") if name in log]
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(way[0], way[1] if len(way) > 1 else 0.0))])
    if distance[-1] < SHORTEST:
        raise InvalidInput(
            f"{log.name}, line {len(distance) + 1}, column x: ends a journey of {distance[-1]:.4g} mm; a sheet needs "
            f"{SHORTEST:g} mm"
        )
    return distance


def nozzle(encoder: np.ndarray, axis: Axis | None) -> np.ndarray:
    """Where the nozzle is for an encoder on the motor, mm: through the structural mode of an axis, if one is known.

    Gravity keeps the backlash closed. The mode is that of the machine's text, head/motor = (1 − c) + c·ω²/(s² + 2ζω·s
    + ω²), exactly integrated for an encoder that is a straight line between samples.
    """
    if axis is None or middle(axis.compliance) == 0.0:
        return encoder
    omega, zeta = 2 * np.pi * middle(axis.resonance), middle(axis.resonance_zeta)
    _, low, _ = signal.lsim(
        ([omega**2], [1.0, 2 * zeta * omega, omega**2]), encoder - encoder[0], np.arange(len(encoder)) * PERIOD
    )
    carried: np.ndarray = encoder + middle(axis.compliance) * (low + encoder[0] - encoder)
    return carried


def heights(log: Log, table: calibration.Table | None) -> tuple[np.ndarray, np.ndarray, str]:
    """Measured heights without the filter's delay, mm, which of them are some, and how they were found.

    With a table they are those of the frequency. Without, but with the reported height beside the frequency, the log
    makes its own: the height over the frequency after a moving mean, of that length which fits best.
    """
    if "frequency" in log:
        frequency = log["frequency"]
        if table is not None:
            inside = (frequency > 0) & (frequency < table.frequency[-2])
            return np.interp(frequency, table.frequency, table.height), inside, ""
        if "height" in log:
            return _own_table(log)
    if "height" not in log:
        raise InvalidInput(f"{log.name}: a sheet needs heights; give the sweep log, or a column height")
    late, known = log["height"], log["height"] > 0
    index = np.arange(len(late)) + FILTERED
    shifted = np.interp(index, np.flatnonzero(known), late[known])
    told = f"the height is taken to be {FILTERED:g} ms late; with a sweep log or frequency it would be known"
    return shifted, known & (index <= np.flatnonzero(known)[-1]), told


def _own_table(log: Log) -> tuple[np.ndarray, np.ndarray, str]:
    frequency, height = log["frequency"], log["height"]
    valid = frequency > 0
    bridged = np.interp(np.arange(len(frequency)), np.flatnonzero(valid), frequency[valid])
    x = (bridged - np.median(bridged)) / max(float(np.std(bridged)), 1e-9)
    low, high = np.percentile(x, [1, 99])
    best = (np.inf, 0, np.zeros(1))
    for window in range(1, 16):
        mean = ndimage.uniform_filter1d(x, window, origin=(window - 1) // 2)
        used = valid & (height > 0) & (mean > low) & (mean < high)
        used[: 2 * window] = False
        line = np.polyfit(mean[used], np.log(height[used]), 7)
        off = float(np.median(np.abs(np.polyval(line, mean[used]) - np.log(height[used]))))
        if off < 0.98 * best[0]:
            best = (off, window, line)
    inside = valid & (x > low - 1.0) & (x < high + 1.0)
    told = f"heights by the log's own frequency and height, which is late by {0.5 * (best[1] - 1):g} ms"
    return np.exp(np.polyval(best[2], np.where(inside, x, 0.0))), inside, told


def impulses(surface: np.ndarray, valid: np.ndarray, about: np.ndarray | None = None) -> np.ndarray:
    """Which samples jump off the surface ``about`` them, or at first off the median of their neighbours."""
    filled = np.interp(np.arange(len(surface)), np.flatnonzero(valid), surface[valid])
    off = filled - (ndimage.median_filter(filled, AROUND, mode="nearest") if about is None else about)
    scatter = float(np.median(np.abs(off)) / stats.norm.ppf(0.75))
    jumps: np.ndarray = np.abs(off) > max(OFF * scatter, 1e-3)
    return jumps


def followed(
    log: Log, table: calibration.Table | None = None, axis: Axis | None = None, plate: float = sheet.PLATE
) -> Followed:
    """The sheet of a follow log.

    Args:
        log: with ``encoder``, ``x``, and ``frequency`` or ``height``.
        table: of the sweep, without which the log's own height is taken.
        axis: whose mounting carries the head; of what is a distribution the middle counts.
        plate: mm, radius of the footprint of the sensor's plate.

    Raises:
        InvalidInput: what the log lacks.
    """
    distance = along(log)
    height, valid, told = heights(log, table)
    surface = nozzle(log["encoder"], axis) - height
    if valid.mean() < 0.5:
        raise InvalidInput(
            f"{log.name}, line {np.flatnonzero(~valid)[0] + 2}, column frequency: is the first of more than half that "
            "are none of the sheet's; is the sweep that of another head?"
        )
    steps = np.diff(distance)
    spacing = max(float(np.median(steps[steps > 0])), 0.05)
    jumps = impulses(surface, valid)
    for _ in range(3):  # a rough sheet jumps off its median, but not off what is found of it
        good = valid & ~jumps
        position, felt = _even(distance[good], surface[good], spacing, distance[-1])
        smooth, tip, noise, moves = smoothed(felt, spacing, plate)
        jumps = impulses(surface, valid, np.interp(distance, position, smooth))
    speeds = np.diff(distance) / np.diff(log["time"])
    feed = float(np.median(speeds[speeds > 0.02 * speeds.max()]))
    slows = float(np.mean(speeds < 0.9 * feed))
    notes = [told] if told else []
    if slows > 0.02:
        notes.append(f"the feed is lower for {slows:.0%} of the time; the scenarios have {feed:.4g} mm/s throughout")
    if moves > max(MOVES, 0.3 * noise):
        notes.append(
            f"{1e3 * moves:.2g} µm RMS are too short for the plate to be a shape: the sheet vibrates, or the head; the "
            "profile holds them for this feed alone"
        )
    wanted = log["set_height"] if "set_height" in log else height[good]
    return Followed(
        position=position,
        height=smooth - smooth[0],
        tip=tip - smooth[0],
        felt=felt - smooth[0],
        noise=1e3 * noise,
        feed=feed,
        slows=slows,
        set_height=float(np.median(wanted)),
        duration=log.duration,
        plate=plate,
        left_out=1.0 - float(good.mean()),
        notes=tuple(notes),
    )


def _even(distance: np.ndarray, surface: np.ndarray, spacing: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """The surface on an even grid: the mean of what lies around each place, a line where nothing does."""
    count = int(end / spacing + 1e-6) + 1
    cell = np.minimum(np.rint(distance / spacing).astype(int), count - 1)
    many = np.bincount(cell, minlength=count)
    some = many > 0
    where, value = (np.bincount(cell, each, count)[some] / many[some] for each in (distance, surface))
    grid = np.arange(count) * spacing
    return grid, np.interp(grid, where, value)


def smoothed(felt: np.ndarray, spacing: float, plate: float) -> tuple[np.ndarray, np.ndarray, float, float]:
    """The surface as a plate feels it and under the tip, mm, of what it felt with noise, mm; that noise, mm RMS; and
    what is left of it that is too short for the plate to be a shape, mm RMS.

    The line between the ends is taken out first, so that a series of sines holds the rest without a jump.
    """
    few = max(4, min(len(felt) // 20, round(5.0 / spacing)))
    first, last = (
        float(np.polynomial.Polynomial.fit(np.arange(few), part, 2)(0.0))
        for part in (felt[:few], felt[: -few - 1 : -1])
    )
    line = np.linspace(first, last, len(felt))
    wave = fft.dst((felt - line)[1:-1], type=1, norm="ortho")
    k = np.pi * np.arange(1, len(wave) + 1) / ((len(felt) - 1) * spacing)
    power = wave**2
    quiet = power[int(QUIET[0] * len(k)) : int(QUIET[1] * len(k))]
    noise = float(np.median(quiet)) / CHI2
    half = np.maximum(4, 0.03 * np.arange(len(k))).astype(int)
    sums = np.concatenate([[0.0], np.cumsum(power)])
    low, high = np.maximum(np.arange(len(k)) - half, 0), np.minimum(np.arange(len(k)) + half + 1, len(k))
    average = (sums[high] - sums[low]) / (high - low)
    sure = average > noise * (1.0 + SURE * np.sqrt(2.0 / (high - low)))
    heard = k * plate < FELT
    clean = np.where(sure, 1.0 - noise / np.maximum(average, 1e-300), 0.0) * wave
    # What is there beyond that is no shape but a motion, and the same for plate and tip.
    sharper = np.where(heard, sheet.attenuation(k) / sheet.attenuation(np.where(heard, k, 0.0), plate), 1.0)

    def back(series: np.ndarray) -> np.ndarray:
        out = line.copy()
        out[1:-1] += fft.idst(series, type=1, norm="ortho")
        out[[0, -1]] = 2 * out[[1, -2]] - out[[2, -3]]
        return out

    moves = float(np.sqrt(np.sum(clean[~heard] ** 2) / len(felt)))
    return back(clean), back(clean * sharper), float(np.sqrt(noise)), moves


def under_tip(found: Followed, recording: Recording) -> np.ndarray:
    """Error of the gap under the nozzle's tip, mm, shape (periods, machines), of a run on the profile's scenario."""
    made: np.ndarray = recording.error + np.interp(recording["distance"], found.position, found.height - found.tip)
    return made
