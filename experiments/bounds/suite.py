"""Bounds of scenarios: every number is read from machines that were prepared for the scenario, seed by seed.

Three figures for each scenario, all RMS of the true gap error over the benchmark's seeds, µm:

- ``bound``: for any causal controller with only the sensor. It is given the machine, the ensemble, and the frequencies
  that were drawn; it must learn phases, amplitudes, slopes and, of steps, when they come and which way.
- ``learned``: the same, but frequencies have to be learned in the episode too (Cramér–Rao, so an estimate of what is
  possible rather than a bound).
- ``linear``: for a controller that is linear and fixed and has half a second of memory, given the machine and the
  ensemble's mean spectrum (Wiener).

What is added when machines learn to do more: an ingredient of :mod:`spectrum` or :mod:`shapes` in :func:`random_part`,
:func:`drawn_part` or :func:`ensemble`, and its name in :mod:`known`. Where feed or sheet change meanwhile,
:mod:`moving` takes over.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...envs import scenarios
from ...envs.plant import heads, idle, sheet
from ...envs.plant.controller import PERIOD, make_law
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from . import moving, noise, prediction, shapes, spectrum
from .known import check
from .reach import WINDOW, Reach
from .record import Bound
from .shapes import Shapes
from .spectrum import ENDLESS, MEMORY, NOTHING, Random, bands, tones

ENSEMBLE = 1000
"""Seeds of the split *tune* whose sheets are the ensemble."""

EVERY = 100
"""Control periods between the moments at which an error is predicted."""

NEWEST = 6
"""Commands of which is asked how far they can move the head."""

AROUND = 2 * WINDOW
"""Control periods around a step of which only the step is counted."""


def prepared(scenario: Scenario, seeds: Sequence[int]) -> Fleet:
    """One machine for each seed, prepared but not begun."""
    fleet = Fleet(len(seeds), make_law(idle, "idle"), heads.POOL)
    scenarios.prepare(fleet, scenario, np.arange(len(seeds)), np.asarray(seeds, np.uint64))
    return fleet


@dataclass(frozen=True)
class _Lines:
    """Sines of a scenario's machines, waves then vibrations; arrays of shape (lines, machines)."""

    amplitude: np.ndarray  # µm, as the score sees it
    omega: np.ndarray  # rad/s
    phase: np.ndarray  # rad
    sensor: np.ndarray  # gain of the sensor's view over the score's

    @classmethod
    def of(cls, fleet: Fleet, scenario: Scenario) -> "_Lines":
        feed, rows = fleet.column("path.feed"), []
        for i in range(len(scenario.sheet.waves)):
            w = fleet.listed(sheet.Wave, i)
            gain = (w.amplitude + w.felt) / np.where(w.amplitude == 0.0, 1.0, w.amplitude)
            rows.append((1e3 * w.amplitude, w.kx * feed, w.phase, gain))
        for i in range(len(scenario.sheet.vibrations)):
            v = fleet.listed(sheet.Vibration, i)
            rows.append((np.where(v.zeta > 0.0, 0.0, 1e3 * v.amplitude), v.omega, v.phase, np.ones_like(feed)))
        parts = np.array(rows).reshape(len(rows), 4, fleet.size)
        return cls(*parts.transpose(1, 0, 2))


def drawn_part(lines: _Lines, i: int, fleet: Fleet, scenario: Scenario, spread: np.ndarray | None) -> Shapes:
    """Shapes of machine ``i``: its slope and its sines, with ``spread`` (rad²/s², one a line) of unknown frequency."""
    t = np.arange(1, scenario.steps + 1) * PERIOD
    parts = []
    ends = scenarios.bounds(scenario.sheet.tilt)
    if ends != (0.0, 0.0):
        # Uniform between −b and b; the sign of a slope is not known either.
        parts.append(shapes.ramp(1e3 * t * fleet.column("path.feed")[i], max(map(abs, ends)) ** 2 / 3.0))
    for line in range(len(lines.omega)):
        amplitude, omega, phase, gain = (
            float(each[line, i]) for each in (lines.amplitude, lines.omega, lines.phase, lines.sensor)
        )
        if amplitude == 0.0:  # a band
            continue
        parts.append(shapes.sine(omega * t, amplitude**2 / 2.0, gain))
        if spread is not None:
            parts.append(shapes.stretch(omega * t + phase, t, amplitude, float(spread[line]), gain))
    if scenario.sheet.bulge:
        low, high = scenarios.bounds(scenario.sheet.bulge.height)
        if high > low:  # uniform between them, or known
            parts.append(shapes.ramp(1e3 * _bulge(fleet, i, t), (high - low) ** 2 / 12.0))
    return shapes.joined(parts, scenario.steps)


def _bulge(fleet: Fleet, i: int, t: np.ndarray) -> np.ndarray:
    """Course of machine ``i``'s thermal bulge, for a height of 1, at the times ``t``, shape (periods,)."""
    p = fleet.get("sheet", i)
    grown = 1.0 - (1.0 - p.bulge_growth) ** (t / PERIOD)
    away = np.hypot(t * fleet.column("path.feed")[i] - p.bulge_x, p.bulge_y) / p.bulge_width
    return np.asarray(grown * (0.5 + 0.5 * np.cos(np.pi * np.minimum(away, 1.0))))


def _bands(fleet: Fleet, scenario: Scenario) -> np.ndarray:
    """Variance (µm²), rad/s and damping ratio of each band of each machine, shape (3, bands, machines)."""
    every = [fleet.listed(sheet.Vibration, i) for i in range(len(scenario.sheet.vibrations))]
    found = [(np.where(v.zeta > 0.0, (1e3 * v.amplitude) ** 2 / 2.0, 0.0), v.omega, v.zeta) for v in every]
    return np.array(found).reshape(len(found), 3, fleet.size).transpose(1, 0, 2)


def _surface(scenario: Scenario) -> spectrum.Surface | None:
    rough = scenario.sheet.random
    return spectrum.surface(rough.exponent, rough.rolloff, scenario.head.plate) if rough else None


def _sizes(fleet: Fleet) -> np.ndarray:
    """RMS of each machine's sheet of continuous spectrum, µm."""
    return np.asarray(1e3 * np.hypot(fleet.column("random.one"), fleet.column("random.two")))


def vibrating(fleet: Fleet, scenario: Scenario, i: int) -> Random:
    """The bands of vibration of machine ``i``."""
    variance, omega, zeta = _bands(fleet, scenario)[:, :, i]
    return bands(variance, omega, zeta, ENDLESS) if variance.any() else NOTHING


def random_part(fleet: Fleet, scenario: Scenario, i: int) -> Random:
    """The stationary random part of machine ``i``'s sheet: its continuous spectrum and its bands of vibration."""
    found, rough = vibrating(fleet, scenario, i), _surface(scenario)
    if not rough:
        return found
    along = rough.at(fleet.column("path.feed")[i], _sizes(fleet)[i] ** 2, ENDLESS)
    return along + found if found.xx else along


def ensemble(scenario: Scenario) -> tuple[Random, np.ndarray]:
    """The mean spectrum of a scenario's sheets, and the variance of each line's frequency, rad²/s²."""
    fleet = prepared(scenario, range(ENSEMBLE))
    lines, mean, rough = _Lines.of(fleet, scenario), NOTHING, _surface(scenario)
    if len(lines.omega):
        variance, omega, zeta = (each.ravel() for each in _bands(fleet, scenario))
        mean += tones(
            (lines.amplitude**2 / 2.0 / fleet.size).ravel(), lines.omega.ravel(), lines.sensor.ravel(),
        )  # fmt: skip
        mean += bands(variance / fleet.size, omega, zeta, MEMORY)
    if rough:
        mean += rough.at(float(fleet.column("path.feed").mean()), float(np.mean(_sizes(fleet) ** 2)))
    return mean, lines.omega.var(axis=1)


def of(scenario: Scenario, seeds: Sequence[int]) -> Bound:
    """The bounds of a scenario over ``seeds``.

    Raises:
        InvalidInput: no bound is known for it.
    """
    check(scenario)
    fleet = prepared(scenario, scenario.some(seeds))
    if scenario.corners or scenario.turns:
        return _moving(fleet, scenario)
    lines, sigma = _Lines.of(fleet, scenario), noise.gaussian(fleet)
    mean, spread = ensemble(scenario)
    # In the middle of each stretch: errors fall and ever more slowly, so their mean is rather under- than overstated.
    at = np.arange(scenario.settle_steps, scenario.steps - EVERY // 2, EVERY) + EVERY // 2
    squares = {name: np.zeros(fleet.size) for name in ("bound", "learned", "linear", "sheet", "steps")}
    for i in range(fleet.size):
        axis, random = Reach.of(fleet.get("z", i)), random_part(fleet, scenario, i)
        news = NEWEST if random.xx > 0.0 else 0  # of what was drawn once, the newest readings tell next to nothing
        horizons, reach = axis.horizon + np.arange(news + 1), axis.within(NEWEST)
        steps, calm = _steps(fleet, scenario, i, axis, float(sigma[i]))
        for name, width in (("bound", None), ("learned", spread)):
            drawn = drawn_part(lines, i, fleet, scenario, width)
            variances = prediction.errors(random, drawn, float(sigma[i]), horizons, at)
            known = prediction.held_back(variances, reach).mean()
            squares[name][i] = max(known, calm * known + steps)
            squares["sheet"][i] = known if width is None else squares["sheet"][i]
            if not len(lines.omega):  # no frequency to be learned
                squares["learned"][i] = squares["bound"][i]
                break
        squares["steps"][i] = steps
        if mean.xx > 0.0:
            least = [prediction.wiener(mean, float(sigma[i]), axis.horizon + k)[0] for k in range(NEWEST + 1)]
            known = float(prediction.held_back(np.array(least), reach))
            squares["linear"][i] = max(known, calm * known + steps)

    def rms(name: str) -> float:
        return float(np.sqrt(np.mean(squares[name])))

    return Bound(
        rms("bound"), rms("learned"), rms("linear") if mean.xx > 0.0 else None,
        {"prediction": rms("sheet"), "steps": rms("steps"), **noise.ingredients(fleet)},
    )  # fmt: skip


def _moving(fleet: Fleet, scenario: Scenario) -> Bound:
    """The bound where feed or sheet change meanwhile: of continuous spectrum and bands; the rest is given away."""
    rough, sigma, squares = _surface(scenario), noise.gaussian(fleet), np.zeros(fleet.size)
    for i in range(fleet.size):
        axis, journey = Reach.of(fleet.get("z", i)), fleet.get("path", i)
        horizons, reach = axis.horizon + np.arange(NEWEST + 1), axis.within(NEWEST)
        shaken = vibrating(fleet, scenario, i)
        trembling = 0.0
        if shaken.xx > 0.0:
            variances = prediction.errors(shaken, shapes.none(1), float(sigma[i]), horizons, np.zeros(1, int))
            trembling = float(prediction.held_back(variances, reach).mean())
        along = moving.Along(journey, rough, float(_sizes(fleet)[i]), float(sigma[i]), horizons, reach)
        squares[i] = moving.over_turns(scenario, along, trembling) if scenario.turns else np.mean(
            np.maximum(along.errors(0.0, scenario.steps, scenario.settle_steps, told=False), trembling)
        )  # fmt: skip
    found = float(np.sqrt(squares.mean()))
    return Bound(found, found, None, {"prediction": found, "steps": 0.0, **noise.ingredients(fleet)})


def _steps(fleet: Fleet, scenario: Scenario, i: int, axis: Reach, sigma: float) -> tuple[float, float]:
    """What the steps of machine ``i`` cost, mean square over the scored periods, µm², and the share of periods that
    are not near any of them."""
    if not scenario.sheet.steps:
        return 0.0, 1.0
    found = [fleet.listed(sheet.Feature, n) for n in range(scenario.sheet.steps.count)]
    heights, starts = (1e3 * np.array([f.rise[i] for f in found]), np.array([f.start[i] for f in found]))
    feed = float(fleet.column("path.feed")[i])
    scored = range(scenario.settle_steps, scenario.steps)
    costs = axis.cost_of_steps(heights, starts, feed, sigma, scenario.head.plate, sheet.FOOTPRINT, scored)
    return float(costs.sum()) / len(scored), max(1.0 - len(found) * AROUND / len(scored), 0.0)
