"""Stability by injection: how much of a small motion of the sheet shows in the true gap, for any controller.

The sheet is level and undisturbed, and moves up and down as a whole by little. The ratio of the true gap's spectrum to
the sheet's is |S|, the sensitivity; its largest value over frequencies and corner plants (:mod:`plants`) is Ms. Nothing
about the controller needs to be known, so a learned policy is measured as a classical one is. Two signals are injected:

- **sines**, one at a time: 20 µm at 40 frequencies from 1 to 200 Hz, and then finer around the highest peak where the
  neighbours of a frequency show that the peak lies between two of them (a loop near its limit of stability has a narrow
  one). For a linear loop that is all there is to know.
- **noise**: all frequencies from 1 to 200 Hz at once, so that a controller that learns while it runs cannot learn the
  signal. A sine says little of such a one: it predicts the sine, and follows it better than anything else.

The noise is a random-phase multisine of 20 µm RMS with a period of a second, of which the amplitudes fall as 1/f from
:data:`KNEE` on, as those of sheets do, so that the drive can follow it at all frequencies. |S| is the cross-spectrum of
gap and sheet over the sheet's own spectrum. It is averaged over periods and over draws of the phases; how much it
scatters from one draw to the next gives its interval (Pintelon and Schoukens 2012, ch. 4: the best linear approximation
and its variance). What friction, thresholds and limits add scatters too. Its lines are 1 Hz apart; of the narrow peak
of a loop near its limit of stability the sines tell more.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import stats

from ...envs.control.stack import Stack
from ...envs.plant import heads
from ...envs.plant.controller import PERIOD
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from . import rollout
from .plants import STANDARD, Drawn, Machine

LIMIT_MS = 2.0
"""Largest Ms that tuning allows a follower unless told otherwise, as the following suite's ranking does."""

FEED = 0.0
"""mm/s: the sheet moves, the head need not travel. A law that learns over travel is another one at another feed."""

AMPLITUDE = 0.020
"""mm"""

FREQUENCIES = np.geomspace(1.0, 200.0, 40)
"""Hz"""

SETTLE, WINDOW = 0.6, 2.0
"""s before and during which the response is taken."""

NEARLY, NARROW, FINER = 0.7, 0.25, 12
"""A corner plant's peak that reaches this share of the highest, and beside which |S| falls by more than this (bend of
its logarithm from one frequency to the next), is measured at so many frequencies more."""

LINE = 1.0
"""Hz, distance of the noise's lines, and one over its period."""

LINES = np.arange(LINE, 200.0 + LINE / 2, LINE)
"""Hz"""

RMS, KNEE = 0.020, 20.0
"""mm of the noise; Hz above which its amplitudes fall."""

DRAWS, PERIODS, REST, FADE, SEED = 16, 2, 1.0, 0.1, 1
"""Draws of the phases on each corner plant, periods of each that are measured, s before them and s in which the signal
sets in, seed of the phases."""


@dataclass(frozen=True)
class Sensitivity:
    """|S| of shape (corner plants, frequencies), Hz; ``steps`` were simulated to find it.

    Attributes:
        low, high: 95 % interval of each |S|, of the same shape; empty where it was measured with sines, which leave
            nothing to chance.
    """

    frequencies: np.ndarray
    magnitude: np.ndarray
    steps: int = 0
    low: np.ndarray = field(default_factory=lambda: np.empty(0))
    high: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def peak(self) -> float:
        """Worst |S| over frequencies and corner plants (Ms)."""
        return float(self.magnitude.max()) if np.isfinite(self.magnitude).all() else float("inf")

    @property
    def worst(self) -> np.ndarray:
        """Worst |S| over the corner plants at each frequency."""
        return self.magnitude.max(axis=0)

    @property
    def interval(self) -> tuple[float, float]:
        """That of |S| at the peak; NaN where there is none."""
        if not self.low.size or not np.isfinite(self.peak):
            return float("nan"), float("nan")
        at = np.unravel_index(int(np.argmax(self.magnitude)), self.magnitude.shape)
        return float(self.low[at]), float(self.high[at])


def _scenario(settle: float, window: float, feed: float) -> Scenario:
    return Scenario(name="injection", duration=settle + window, settle=settle, feed=feed, set_height=0.8)


class Injection:
    """The fleet of an injection of sines, built once and used for many stacks of one law.

    Args:
        stack: any stack with the law.
        frequencies: Hz.
        settle, window: s.
        threads: worker threads.
        machine: whose corner plants are measured, or machines that it draws.
        feed: mm/s.
    """

    def __init__(
        self,
        stack: Stack,
        frequencies: np.ndarray = FREQUENCIES,
        settle: float = SETTLE,
        window: float = WINDOW,
        threads: int = 1,
        machine: Machine | Drawn = STANDARD,
        feed: float = FEED,
    ) -> None:
        self.frequencies, self.machine = np.asarray(frequencies), machine
        self.scenario = _scenario(settle, window, feed)
        corners, tones = np.meshgrid(np.arange(machine.size), self.frequencies, indexing="ij")
        self.corner, self.tone = corners.ravel(), tones.ravel()
        self.fleet = Fleet(self.corner.size, stack.law, heads.ensure([0]), threads)
        machine.prepare(self.fleet, self.scenario, self.corner)
        self.fleet.put_vibration(np.arange(self.fleet.size), 0, AMPLITUDE, self.tone, 0.0)
        self._slopes: Any = None

    def measure(self, stack: Stack) -> Sensitivity:
        """|S| of ``stack``, whose law must be the fleet's."""
        return self._measured(stack)[0]

    def measure_with_slopes(self, stack: Stack, names: tuple[str, ...]) -> tuple[Sensitivity, np.ndarray]:
        """The same, and slopes of the logarithm of |S| by parameters of the stack, per unit, at each frequency on the
        corner plant where it is highest, (frequencies, parameters).

        The steps are those of the machines and of their tangents, see :mod:`slopes`.

        Raises:
            InvalidInput: there is no slope by one of them.
        """
        from .slopes import Slopes  # makes its tangents when it is loaded

        if self._slopes is None or self._slopes.names != names:
            self._slopes = Slopes(self.fleet, stack, names, self.scenario.steps)
        with self._slopes:
            found, waves = self._measured(stack)
        found = replace(found, steps=found.steps * (1 + len(names)))
        if not np.isfinite(found.peak):
            return found, np.full((len(self.frequencies), len(names)), np.nan)
        highest = np.argmax(found.magnitude, axis=0) * len(self.frequencies) + np.arange(len(self.frequencies))
        wave, first = waves[:, highest], self.scenario.settle_steps
        gaps, tones = self._slopes.of_gap()[:, first:, highest], self.tone[highest]
        change = np.stack([_waves(gap, tones, first) for gap in gaps])  # (parameters, 2, frequencies)
        return found, ((change * wave).sum(axis=1) / (wave**2).sum(axis=0)).T

    def _measured(self, stack: Stack) -> tuple[Sensitivity, np.ndarray]:
        """|S|, and the sine and cosine of each machine's true gap, mm, (2, machines)."""
        record = rollout.anew(self.fleet, self.scenario, stack, np.zeros(self.fleet.size))
        gap = record["gap"][self.scenario.settle_steps :].astype(np.float64)
        waves = _waves(gap, self.tone, self.scenario.settle_steps)
        magnitude = np.hypot(*waves) / AMPLITUDE
        magnitude[record.collided | ~np.isfinite(gap).all(axis=0)] = np.inf
        shape, steps = (self.machine.size, len(self.frequencies)), self.fleet.size * self.scenario.steps
        return Sensitivity(self.frequencies, magnitude.reshape(shape), steps), waves


def _waves(x: np.ndarray, tones: np.ndarray, first: int) -> np.ndarray:
    """Sine and cosine at each column's own frequency, (2, columns): least squares, with a constant beside them."""
    t = (np.arange(len(x)) + 1 + first) * 1e-3
    out = np.empty((2, x.shape[1]))
    for tone in np.unique(tones):
        columns = np.flatnonzero(tones == tone)
        basis = np.stack([np.sin(2 * np.pi * tone * t), np.cos(2 * np.pi * tone * t), np.ones_like(t)], axis=1)
        q, r = np.linalg.qr(basis)  # a tenth of the time of a general solver, whose threads get in each other's way
        out[:, columns] = np.linalg.solve(r, q.T @ x[:, columns])[:2]
    return out


def sensitivity(stack: Stack, threads: int = 1, machine: Machine | Drawn = STANDARD, feed: float = FEED) -> Sensitivity:
    """|S| of a stack with sines, at the suite's frequencies and around its peak, on a machine's corner plants."""
    found = Injection(stack, threads=threads, machine=machine, feed=feed).measure(stack)
    around = _around(found)
    if not around.size:
        return found
    finer = Injection(stack, around, threads=threads, machine=machine, feed=feed).measure(stack)
    order = np.argsort(np.concatenate([found.frequencies, finer.frequencies]), kind="stable")
    return Sensitivity(
        np.concatenate([found.frequencies, finer.frequencies])[order],
        np.concatenate([found.magnitude, finer.magnitude], axis=1)[:, order],
        found.steps + finer.steps,
    )


def _around(found: Sensitivity) -> np.ndarray:
    """Frequencies at which narrow peaks must be looked at more closely; none if there is no narrow one."""
    if not np.isfinite(found.peak):
        return np.empty(0)
    log, wanted = np.log(found.magnitude), set()
    for corner, at in enumerate(np.argmax(found.magnitude, axis=1)):
        high = found.magnitude[corner, at] > NEARLY * found.peak
        if high and 0 < at < len(found.frequencies) - 1:
            left, top, right = log[corner, at - 1 : at + 2]
            if 2 * top - left - right > NARROW:
                wanted.add(int(at))
    ends = [(found.frequencies[at - 1], found.frequencies[at + 1]) for at in sorted(wanted)]
    each = [np.geomspace(low, high, FINER + 2)[1:-1] for low, high in ends]
    return np.setdiff1d(np.round(np.concatenate(each), 6), np.round(found.frequencies, 6)) if each else np.empty(0)


# ---------------------------------------------------------------------------------------------------------- with noise


class Noise:
    """The fleet of an injection of noise, built once and used for many stacks of one law.

    Args:
        stack: any stack with the law.
        threads: worker threads.
        machine: whose corner plants are measured.
        draws: of the phases, on each corner plant.
        feed: mm/s.
    """

    def __init__(
        self, stack: Stack, threads: int = 1, machine: Machine = STANDARD, draws: int = DRAWS, feed: float = FEED
    ) -> None:
        self.machine, self.draws = machine, draws
        self.scenario = _scenario(REST, PERIODS / LINE, feed)
        self.fleet = Fleet(machine.size * draws, stack.law, heads.ensure([0]), threads)
        machine.prepare(self.fleet, self.scenario, np.repeat(np.arange(machine.size), draws))
        phases = np.random.default_rng(SEED).uniform(0.0, 2 * np.pi, (self.fleet.size, LINES.size))
        self.course = _multisine(phases)

    def measure(self, stack: Stack) -> Sensitivity:
        """|S| of ``stack``, whose law must be the fleet's."""
        every, height = np.arange(self.fleet.size), self.course

        def move(period: int) -> None:
            """The sheet's height in the middle and at the end of the period that is travelled next.

            A vibration of 1 mm takes just these two values if its frequency and phase are chosen anew each period.
            """
            end = float(self.fleet.column("journey.time")[0]) + PERIOD
            at = round(2 * end / PERIOD)
            fade = min(1.0, period * PERIOD / FADE)
            middle, last = (np.arcsin(fade * height[i % len(height)]) for i in (at - 1, at))
            omega = 2 * (last - middle) / PERIOD
            self.fleet.put_vibration(every, 0, 1.0, omega / (2 * np.pi), last - omega * end)

        self.fleet.put_vibration(every, 0, 0.0, 0.0, 0.0)
        record = rollout.anew(self.fleet, self.scenario, stack, np.zeros(self.fleet.size), move)
        sheet, gap = (record[channel][self.scenario.settle_steps :].astype(float) for channel in ("surface", "gap"))
        lost = (record.collided | ~np.isfinite(gap).all(axis=0)).reshape(-1, self.draws).any(axis=1)
        value, low, high = _cross_spectral(sheet, gap, self.draws)
        for each in (value, low, high):
            each[lost] = np.inf
        return Sensitivity(LINES, value, self.fleet.size * self.scenario.steps, low, high)


def _multisine(phases: np.ndarray) -> np.ndarray:
    """Heights, mm, twice each control period over one period of the signal, shape (times, machines)."""
    time = np.arange(round(2 / (LINE * PERIOD))) * 0.5 * PERIOD
    amplitude = np.minimum(1.0, KNEE / LINES)
    angle = 2 * np.pi * time[:, None] * LINES
    waves = np.cos(angle) @ (amplitude * np.cos(phases)).T - np.sin(angle) @ (amplitude * np.sin(phases)).T
    return RMS * waves / np.sqrt(0.5 * np.sum(amplitude**2))


def _cross_spectral(x: np.ndarray, y: np.ndarray, draws: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """|Σ Y·conj(X)| / Σ |X|² over periods and draws with its 95 % interval, each of shape (corner plants, lines).

    Args:
        x, y: whole periods, shape (times, corner plants · draws).
        draws: of each corner plant, the independent ones.
    """
    size = round(1 / (LINE * PERIOD))
    at = np.round(LINES / LINE).astype(int)
    with np.errstate(invalid="ignore"):
        spectra = [np.fft.rfft(z.reshape(-1, size, x.shape[1]), axis=1)[:, at] for z in (x, y)]
    cross = (spectra[1] * spectra[0].conj()).sum(axis=0).T.reshape(-1, draws, LINES.size)
    power = (np.abs(spectra[0]) ** 2).sum(axis=0).T.reshape(-1, draws, LINES.size)
    value = cross.sum(axis=1) / power.sum(axis=1)
    size_of = np.abs(value)
    off = cross / power - value[:, None]
    along = (off * (value.conj() / np.maximum(size_of, 1e-12))[:, None]).real  # what of it changes the magnitude
    half = stats.t.ppf(0.975, draws - 1) * along.std(axis=1, ddof=1) / np.sqrt(draws)
    return size_of, np.maximum(size_of - half, 0.0), size_of + half


def broadband(stack: Stack, threads: int = 1, machine: Machine = STANDARD, feed: float = FEED) -> Sensitivity:
    """|S| of a stack with noise on a machine's corner plants."""
    return Noise(stack, threads, machine, feed=feed).measure(stack)
