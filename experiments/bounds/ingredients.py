"""What prepared machines say of their sheets, as ingredients of bounds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...envs import scenarios
from ...envs.plant import heads, idle, sheet
from ...envs.plant.controller import make_law
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from . import spectrum
from .spectrum import ENDLESS, NOTHING, Random, bands


def prepared(scenario: Scenario, seeds: Sequence[int]) -> Fleet:
    """One machine for each seed, prepared but not begun."""
    fleet = Fleet(len(seeds), make_law(idle, "idle"), heads.POOL)
    scenarios.prepare(fleet, scenario, np.arange(len(seeds)), np.asarray(seeds, np.uint64))
    return fleet


@dataclass(frozen=True)
class Lines:
    """Sines of a scenario's machines, waves then vibrations; arrays of shape (lines, machines)."""

    amplitude: np.ndarray  # µm, as the score sees it
    omega: np.ndarray  # rad/s
    phase: np.ndarray  # rad
    sensor: np.ndarray  # gain of the sensor's view over the score's

    @classmethod
    def of(cls, fleet: Fleet, scenario: Scenario) -> "Lines":
        """Of machines that are prepared for a scenario."""
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


def of_bands(fleet: Fleet, scenario: Scenario) -> np.ndarray:
    """Variance (µm²), rad/s and damping ratio of each band of each machine, shape (3, bands, machines)."""
    every = [fleet.listed(sheet.Vibration, i) for i in range(len(scenario.sheet.vibrations))]
    found = [(np.where(v.zeta > 0.0, (1e3 * v.amplitude) ** 2 / 2.0, 0.0), v.omega, v.zeta) for v in every]
    return np.array(found).reshape(len(found), 3, fleet.size).transpose(1, 0, 2)


def of_surface(scenario: Scenario) -> spectrum.Surface | None:
    """The ensemble of its sheets of continuous spectrum, of RMS 1."""
    rough = scenario.sheet.random
    return spectrum.surface(rough.exponent, rough.rolloff, scenario.head.plate) if rough else None


def of_sizes(fleet: Fleet) -> np.ndarray:
    """RMS of each machine's sheet of continuous spectrum, µm."""
    return np.asarray(1e3 * np.hypot(fleet.column("random.one"), fleet.column("random.two")))


def of_vibrations(fleet: Fleet, scenario: Scenario, i: int) -> Random:
    """The bands of vibration of machine ``i``."""
    variance, omega, zeta = of_bands(fleet, scenario)[:, :, i]
    return bands(variance, omega, zeta, ENDLESS) if variance.any() else NOTHING


def random_part(fleet: Fleet, scenario: Scenario, i: int) -> Random:
    """The stationary random part of machine ``i``'s sheet: its continuous spectrum and its bands of vibration."""
    found, rough = of_vibrations(fleet, scenario, i), of_surface(scenario)
    if not rough:
        return found
    along = rough.at(fleet.column("path.feed")[i], of_sizes(fleet)[i] ** 2, ENDLESS)
    return along + found if found.xx else along


def steps_of(fleet: Fleet, scenario: Scenario, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Heights (µm) and places (mm) of the steps of machine ``i``."""
    count = scenario.sheet.steps.count if scenario.sheet.steps else 0
    found = [fleet.listed(sheet.Feature, n) for n in range(count)]
    return 1e3 * np.array([f.rise[i] for f in found]), np.array([f.start[i] for f in found])
