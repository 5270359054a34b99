"""Bounds of scenarios: every number is read from machines that were prepared for the scenario, seed by seed.

Three figures for each scenario, all RMS of the true gap error over the benchmark's seeds, µm:

- ``bound``: for any causal controller with only the sensor. It is given the machine, the ensemble, and the frequencies
  that were drawn; it must learn phases, amplitudes, slopes and, of steps, when they come and which way.
- ``learned``: the same, but frequencies have to be learned in the episode too (Cramér–Rao, so an estimate of what is
  possible rather than a bound).
- ``linear``: for a controller that is linear and fixed and has half a second of memory, given the machine and the
  ensemble's mean spectrum (Wiener).

What is added when machines learn to do more: an ingredient of :mod:`spectrum` or :mod:`shapes` in :func:`random_part`,
:func:`drawn_part` or :func:`ensemble`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...envs import scenarios
from ...envs.plant import heads, idle, sheet
from ...envs.plant.controller import PERIOD, make_law
from ...envs.plant.fleet import Fleet
from ...envs.plant.quantity import InvalidInput
from ...envs.scenarios import Scenario
from . import noise, prediction, shapes
from .reach import Reach
from .record import Bound
from .shapes import Shapes
from .spectrum import NOTHING, Random, tones

ENSEMBLE = 1000
"""Seeds of the split *tune* whose sheets are the ensemble."""

EVERY = 100
"""Control periods between the moments at which an error is predicted."""

NEWEST = 6
"""Commands of which is asked how far they can move the head."""

UNKNOWN = ("holes", "bulge", "profile", "map")
"""Parts of a sheet for which there is no bound."""


def prepared(scenario: Scenario, seeds: Sequence[int]) -> Fleet:
    """One machine for each seed, prepared but not begun."""
    fleet = Fleet(len(seeds), make_law(idle, "idle"), heads.POOL)
    scenarios.prepare(fleet, scenario, np.arange(len(seeds)), np.asarray(seeds, np.uint64))
    return fleet


def check(scenario: Scenario) -> None:
    """Raises :class:`InvalidInput` for a scenario for which there is no bound."""
    there = [name for name in UNKNOWN if getattr(scenario.sheet, name) is not None]
    if scenario.job or scenario.path or scenario.circle:
        there.append("a path other than a straight line")
    if scenario.head.signal:
        there.append("a replayed signal")
    if scenarios.bounds(scenario.start_above) != (0.0, 0.0):
        there.append("a descent")
    if there:
        raise InvalidInput(f"no bound is known for scenario '{scenario.name}': it has {', '.join(there)}")


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
            rows.append((1e3 * w.amplitude, w.kx * feed, w.phase, np.ones_like(feed)))
        for i in range(len(scenario.sheet.vibrations)):
            v = fleet.listed(sheet.Vibration, i)
            rows.append((1e3 * v.amplitude, v.omega, v.phase, np.ones_like(feed)))
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
        parts.append(shapes.sine(omega * t, amplitude**2 / 2.0, gain))
        if spread is not None:
            parts.append(shapes.stretch(omega * t + phase, t, amplitude, float(spread[line]), gain))
    return shapes.joined(parts, scenario.steps)


def random_part(fleet: Fleet, scenario: Scenario, i: int) -> Random:
    """The stationary random part of machine ``i``'s sheet; in this version none has one."""
    return NOTHING


def ensemble(scenario: Scenario) -> tuple[Random, np.ndarray]:
    """The mean spectrum of a scenario's sines, and the variance of each one's frequency, rad²/s²."""
    fleet = prepared(scenario, range(ENSEMBLE))
    lines = _Lines.of(fleet, scenario)
    if not len(lines.omega):
        return NOTHING, np.zeros(0)
    every = tones(
        (lines.amplitude**2 / 2.0 / fleet.size).ravel(), lines.omega.ravel(), lines.sensor.ravel(),
    )  # fmt: skip
    return every, lines.omega.var(axis=1)


def of(scenario: Scenario, seeds: Sequence[int]) -> Bound:
    """The bounds of a scenario over ``seeds``.

    Raises:
        InvalidInput: no bound is known for it.
    """
    check(scenario)
    fleet = prepared(scenario, seeds)
    lines, sigma = _Lines.of(fleet, scenario), noise.gaussian(fleet)
    mean, spread = ensemble(scenario)
    # In the middle of each stretch: errors fall and ever more slowly, so their mean is rather under- than overstated.
    at = np.arange(scenario.settle_steps, scenario.steps - EVERY // 2, EVERY) + EVERY // 2
    squares = {name: np.zeros(fleet.size) for name in ("sheet", "learned", "linear", "steps")}
    for i in range(fleet.size):
        axis, random = Reach.of(fleet.get("z", i)), random_part(fleet, scenario, i)
        news = NEWEST if random.xx > 0.0 else 0  # of what was drawn once, the newest readings tell next to nothing
        horizons, reach = axis.horizon + np.arange(news + 1), axis.within(NEWEST)
        for name, width in (("sheet", None), ("learned", spread)):
            drawn = drawn_part(lines, i, fleet, scenario, width)
            variances = prediction.errors(random, drawn, float(sigma[i]), horizons, at)
            squares[name][i] = prediction.held_back(variances, reach).mean()
        if len(lines.omega):
            whole = random + mean
            squares["linear"][i] = prediction.wiener(whole, float(sigma[i]), axis.horizon)[0]
        if scenario.sheet.steps:
            squares["steps"][i] = _steps(fleet, scenario, i, axis, float(sigma[i]))

    def rms(*names: str) -> float:
        return float(np.sqrt(np.mean(sum(squares[name] for name in names))))

    return Bound(
        rms("sheet", "steps"), rms("learned", "steps"), rms("linear", "steps") if len(lines.omega) else None,
        {"prediction": rms("sheet"), "steps": rms("steps"), **noise.ingredients(fleet)},
    )  # fmt: skip


def _steps(fleet: Fleet, scenario: Scenario, i: int, axis: Reach, sigma: float) -> float:
    """What the steps of machine ``i`` cost, mean square over the scored periods, µm²."""
    assert scenario.sheet.steps
    found = [fleet.listed(sheet.Feature, n) for n in range(scenario.sheet.steps.count)]
    heights, starts = (1e3 * np.array([f.rise[i] for f in found]), np.array([f.start[i] for f in found]))
    feed = float(fleet.column("path.feed")[i])
    scored = range(scenario.settle_steps, scenario.steps)
    costs = axis.cost_of_steps(heights, starts, feed, sigma, sheet.FOOTPRINT, sheet.FOOTPRINT, scored)
    return float(costs.sum()) / len(scored)
