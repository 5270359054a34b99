"""The spectrum of a sheet: its strongest lines and what is continuous, so that others like it can be drawn.

Over the wavenumber a sheet without lines has a periodogram whose values scatter about the spectrum like exponential
random numbers, and the likelihood of that is simple (Whittle 1953). The continuous part is that of ``[sheet.random]``,
as the plate feels it, above the noise; its RMS, exponent and roll-off are those that are likeliest. Where the
periodogram stands above it by more than chance allows, there is a line; its sine is fitted to the surface itself and
taken out, and both steps are made again until no line is left.
"""

from dataclasses import dataclass

import numpy as np
from scipy import optimize, signal

from ...envs.plant import sheet

CHANCE = 1e-3
"""Of a line where there is none, over the whole log."""

FAINTEST = 2e-3
"""mm; weaker lines, and continuous parts of less RMS, are left out [A]."""

FEWEST_PERIODS, FELT = 4, 3.6
"""Periods of a line that a log must hold; wavenumber times radius up to which a plate feels enough of a sheet, a sixth
of it; at 4.49 it feels nothing."""

EXPONENTS, ROLLOFFS = (1.0, 5.0), (10.0, 5000.0)
"""Allowed in a scenario, 1 and mm."""


@dataclass(frozen=True)
class Line:
    """A sine of the sheet's shape: ``amplitude`` before any footprint, ``wavelength`` along the path, mm."""

    amplitude: float
    wavelength: float


@dataclass(frozen=True)
class Continuous:
    """A continuous spectrum, as ``[sheet.random]`` takes it: mm RMS under the tip, exponent, mm of roll-off."""

    rms: float
    exponent: float
    rolloff: float


@dataclass(frozen=True)
class Spectrum:
    """What a sheet's shape is made of; ``tilt`` is its slope along the path, mm/mm."""

    tilt: float
    lines: tuple[Line, ...]
    continuous: Continuous | None


def spectrum(position: np.ndarray, felt: np.ndarray, plate: float, noise: float) -> Spectrum:
    """The spectrum of what a plate felt.

    Args:
        position: mm along the path, even.
        felt: mm, shape of ``position``.
        plate: mm, radius of the plate's footprint.
        noise: mm RMS of a sample.
    """
    slopes = _slopes(position)
    spacing = float(position[1] - position[0])
    taper = signal.windows.hann(len(felt), sym=False)
    k = 2 * np.pi * np.fft.rfftfreq(len(felt), spacing)
    used = (k > 2 * np.pi * 3 / np.ptp(position)) & (k * plate < FELT)
    k = k[used]
    unit = spacing / (np.pi * np.sum(taper**2))  # one-sided density over k, mm²/(rad/mm)

    found: list[float] = []
    while True:
        columns = [*slopes, *(f(q * position) for q in found for f in (np.cos, np.sin))]
        basis = np.stack(columns, axis=1)
        weights = np.linalg.lstsq(basis, felt, rcond=None)[0]
        left = felt - basis @ weights
        density = unit * np.abs(np.fft.rfft(taper * left)[used]) ** 2
        rms, exponent, rolloff = fitted(k, density, plate, noise**2 * spacing / np.pi)
        model = expected(k, rms, exponent, rolloff, plate) + noise**2 * spacing / np.pi
        above = np.where(k > 2 * np.pi * FEWEST_PERIODS / np.ptp(position), density / model, 0.0)
        peak = int(np.argmax(above))
        if above[peak] < np.log(len(k) / CHANCE) or len(found) == sheet.WAVES:
            break
        found.append(_sharp(position, left * taper, k[peak], 2 * np.pi / np.ptp(position)))

    sizes = np.hypot(weights[len(slopes) :: 2], weights[len(slopes) + 1 :: 2])
    before = sizes / np.abs(sheet.attenuation(np.array(found or [1.0])[: len(sizes)], plate))
    lines = sorted(
        (Line(float(a), float(2 * np.pi / q)) for a, q in zip(before, found, strict=False) if a > FAINTEST),
        key=lambda line: -line.amplitude,
    )
    steepest = max(weights[1 : len(slopes)], key=abs)
    continuous = Continuous(rms, exponent, rolloff) if rms > FAINTEST else None
    return Spectrum(float(steepest), tuple(lines), continuous)


def _slopes(position: np.ndarray) -> list[np.ndarray]:
    """A level, a slope; or the slope of a long sheet, which the machine's sheets turn over so that they stay within
    the travel."""
    length = sheet.Params().length
    if np.ptp(position) < length - sheet.BEND:
        return [np.ones_like(position), position]
    p = sheet.Params()
    return [np.ones_like(position), position, np.array([float(sheet.sloped(p, float(x))) for x in position])]


def expected(k: np.ndarray, rms: float, exponent: float, rolloff: float, plate: float) -> np.ndarray:
    """One-sided density over wavenumber (rad/mm) of a random sheet under a plate, mm²/(rad/mm)."""
    shape = (k * k + (2 * np.pi / rolloff) ** 2) ** (-0.5 * exponent)
    made: np.ndarray = rms**2 / _area(exponent, rolloff) * shape * sheet.attenuation(k, plate) ** 2
    return made


def _area(exponent: float, rolloff: float) -> float:
    """What the shape of a density adds up to under the tip, over all wavelengths that a drawn sheet has."""
    k = np.geomspace(2 * np.pi / (sheet.RANDOM_ONE * sheet.RANDOM_SPACING), np.pi / sheet.RANDOM_SPACING, 4000)
    shape = (k * k + (2 * np.pi / rolloff) ** 2) ** (-0.5 * exponent) * sheet.attenuation(k) ** 2
    return float(np.trapezoid(shape, k))


def fitted(k: np.ndarray, density: np.ndarray, plate: float, noise: float) -> tuple[float, float, float]:
    """RMS (mm), exponent and roll-off (mm) that are likeliest for a periodogram, above a density of ``noise``."""
    low = np.log([1e-5, EXPONENTS[0], ROLLOFFS[0]])
    high = np.log([5.0, EXPONENTS[1], ROLLOFFS[1]])

    def unlikely(x: np.ndarray) -> float:
        rms, exponent, rolloff = np.exp(np.clip(x, low, high)).tolist()
        model = expected(k, rms, exponent, rolloff, plate) + noise
        return float(np.sum(np.log(model) + density / model) + 1e3 * np.sum((x - np.clip(x, low, high)) ** 2))

    best = min(
        (
            optimize.minimize(unlikely, np.log([rms, 2.5, rolloff]), method="Nelder-Mead", options={"maxiter": 400})
            for rms in (1e-3, 0.1)
            for rolloff in (100.0, 1000.0)
        ),
        key=lambda each: float(each.fun),
    )
    rms, exponent, rolloff = np.exp(np.clip(best.x, low, high)).tolist()
    return rms, exponent, rolloff


def _sharp(position: np.ndarray, tapered: np.ndarray, k: float, width: float) -> float:
    """The wavenumber near ``k`` at which a tapered surface has most power, rad/mm."""

    def weak(q: float) -> float:
        return -float(np.abs(np.sum(tapered * np.exp(-1j * q * position))) ** 2)

    return float(optimize.minimize_scalar(weak, bounds=(k - width, k + width), method="bounded",
                                          options={"xatol": 1e-4 * width}).x)  # fmt: skip
