"""What a fixed linear predictor can do that is tuned to a scenario's sheets, and does not look which one it has met.

Its mean-square error over an ensemble depends only on the ensemble's mean covariances, whatever is random in it and
however (Wiener). So sines, bands, sheets of continuous spectrum and steps are one mean spectrum, weighted with how
often the feed is what and with how long each of them is on; a slope is two shapes, level and rise. Nothing in it is
Gaussian by assumption, and neither the drive nor a nonlinear law's insight is in it: it is the least error of a fixed
linear prediction from half a second of readings at the set height, at which impulses are recognised.
"""

import functools
from dataclasses import dataclass

import numpy as np

from ...envs import scenarios
from ...envs.plant import sheet
from ...envs.plant.controller import PERIOD
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from . import moving, prediction, shapes, spectrum
from .ingredients import Lines, of_bands, of_sizes, of_surface, prepared
from .spectrum import MEMORY, NOTHING, Random

ENSEMBLE = 1000
"""Seeds of the split *tune* whose sheets are the ensemble."""

JOURNEYS, STRETCH, PACES = 20, 3000, 24
"""Of how many machines, over how many control periods, feeds are looked at that change, and in how many classes."""

ENDLESS_STEPS = 5000.0
"""mm, roll-off of the spectrum that stands for steps; many times an episode's way."""


@dataclass(frozen=True)
class Ensemble:
    """Second moments of a scenario's sheets.

    Attributes:
        random: mean spectrum.
        slope: variances and covariance of level (µm) and rise (µm a control period), shape (2, 2).
        spread: variance of each line's frequency, rad²/s², shape (lines,).
    """

    random: Random
    slope: np.ndarray
    spread: np.ndarray

    def error(self, noise: float, horizon: int) -> float:
        """Least mean-square error of a fixed prediction from readings with the sigma ``noise`` (µm), µm²."""
        if not self.slope.any():
            return prediction.wiener(self.random, noise, horizon)[0]
        since = np.arange(MEMORY)
        both = shapes.ramp(np.ones(MEMORY), 1.0) + shapes.ramp(-since.astype(float), 1.0)
        return prediction.wiener(self.random, noise, horizon, both, self.slope)[0]

    @property
    def empty(self) -> bool:
        """Whether nothing has to be predicted."""
        return self.random.xx == 0.0 and not self.slope.any()


@functools.lru_cache(maxsize=64)
def ensemble(scenario: Scenario) -> Ensemble:
    """Of a scenario's sheets; a bulge is given away."""
    fleet = prepared(scenario, range(ENSEMBLE))
    lines, mean, rough = Lines.of(fleet, scenario), NOTHING, of_surface(scenario)
    paces = _paces(fleet, scenario)
    on = {name: _share(scenario, name) for name in ("waves", "vibrations", "random")}
    waves = len(scenario.sheet.waves)
    for part, share, ratios in ((slice(0, waves), on["waves"], paces), (slice(waves, None), on["vibrations"], [1.0])):
        power = lines.amplitude**2 / 2.0 / fleet.size
        variance, omega, sensor = (each[part].ravel() for each in (power, lines.omega, lines.sensor))
        for ratio in ratios if variance.any() else ():
            mean += spectrum.tones(share * variance / len(ratios), ratio * omega, sensor)
    if scenario.sheet.vibrations:
        variance, omega, zeta = (each.ravel() for each in of_bands(fleet, scenario))
        mean += spectrum.bands(on["vibrations"] * variance / fleet.size, omega, zeta, MEMORY)
    feed, steps = float(fleet.column("path.feed").mean()), scenario.sheet.steps
    for ratio in paces:
        if rough:
            size = on["random"] * float(np.mean(of_sizes(fleet) ** 2)) / len(paces)
            mean += rough.at(ratio * feed, size)
        if steps:
            jumps = spectrum.surface(2.0, ENDLESS_STEPS, scenario.head.plate)
            mean += jumps.at(ratio * feed, _size_of_steps(jumps, fleet, scenario) / len(paces))
    return Ensemble(mean, _slope(fleet, scenario, feed * np.asarray(paces)), lines.omega.var(axis=1))


def _paces(fleet: Fleet, scenario: Scenario) -> list[float]:
    """Feeds over the nominal one, each as frequent as any other."""
    if not scenario.corners:
        return [1.0]
    periods = min(scenario.steps, STRETCH)
    found = []
    for i in range(JOURNEYS):
        journey = fleet.get("path", i)
        where = moving.places(journey, 0.0, periods)[scenario.settle_steps :]
        found.append(np.diff(where) / PERIOD / journey.feed)
    return [float(part.mean()) for part in np.array_split(np.sort(np.concatenate(found)), PACES)]


def _share(scenario: Scenario, name: str) -> float:
    """Of the time in which something is on."""
    return len(set(getattr(scenario.turns, name))) / scenario.turns.count if scenario.turns else 1.0


def _size_of_steps(jumps: spectrum.Surface, fleet: Fleet, scenario: Scenario) -> float:
    """Variance (µm²) of a surface that rises over a short way, in the mean square, as the steps do."""
    assert scenario.sheet.steps
    found = [fleet.listed(sheet.Feature, i) for i in range(scenario.sheet.steps.count)]
    rises = np.mean([np.square(1e3 * each.rise) for each in found])
    apart = np.mean(found[-1].start) / len(found)
    few = 4
    return float(rises / apart * few * sheet.RANDOM_SPACING / (2.0 * (jumps.bare[0] - jumps.bare[few])))


def _slope(fleet: Fleet, scenario: Scenario, feeds: np.ndarray) -> np.ndarray:
    """Variances and covariance of the level and the rise of a slope, over machines and time, shape (2, 2)."""
    if scenarios.bounds(scenario.sheet.tilt) == (0.0, 0.0):
        return np.zeros((2, 2))
    tilt = 1e3 * fleet.column("sheet.tilt_x")  # µm/mm
    way, mean = scenario.duration * feeds.mean(), PERIOD * feeds.mean()
    turns = way > scenario.sheet.length  # then it goes to and fro
    level = min(way, scenario.sheet.length) ** 2 / 3.0
    both = 0.0 if turns else 0.5 * way * mean
    return np.asarray(np.mean(tilt**2) * np.array([[level, both], [both, PERIOD**2 * np.mean(feeds**2)]]))
