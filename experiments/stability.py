"""Stability by injection: how much of a small sine on the sheet shows in the true gap, for any controller.

A sine of 20 µm on an otherwise level and undisturbed sheet, at 40 frequencies from 1 to 200 Hz, on 16 corner plants
(the extremes of loop bandwidth, damping, dead time and resonance). The ratio of the true gap's amplitude to the
sheet's is |S|, the sensitivity; its largest value is Ms. Nothing about the controller needs to be known, so a learned
policy is measured as a classical one is.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from ..envs import scenarios
from ..envs.plant import heads
from ..envs.plant.controller import PERIOD
from ..envs.plant.fleet import Fleet
from ..envs.scenarios import Head, Scenario
from ..envs.stack import Stack
from . import rollout

AMPLITUDE = 0.020
"""mm"""

FREQUENCIES = np.geomspace(1.0, 200.0, 40)
"""Hz"""

CORNERS = tuple(itertools.product((50.0, 120.0), (0.6, 1.0), (0.001, 0.002), (60.0, 150.0)))
"""Velocity-loop bandwidth (Hz), damping ratio, dead time (s), resonance (Hz) of each corner plant."""

SETTLE, WINDOW = 0.6, 2.0
"""s before and during which the response is taken."""


@dataclass(frozen=True)
class Sensitivity:
    """|S| of shape (corner plants, frequencies), Hz; ``steps`` were simulated to find it."""

    frequencies: np.ndarray
    magnitude: np.ndarray
    steps: int = 0

    @property
    def peak(self) -> float:
        """Worst |S| over frequencies and corner plants (Ms)."""
        return float(self.magnitude.max()) if np.isfinite(self.magnitude).all() else float("inf")

    @property
    def worst(self) -> np.ndarray:
        """Worst |S| over the corner plants at each frequency."""
        return self.magnitude.max(axis=0)


def _scenario(settle: float, window: float) -> Scenario:
    quiet = Head(noise=0.0, jitter=0.0, impulses=0.0, nominal=True)
    return Scenario(name="injection", duration=settle + window, settle=settle, feed=0.0, set_height=0.8, head=quiet)


def put_plants(fleet: Fleet, plants: np.ndarray) -> None:
    """Gives every machine its plant: shape (machines, 4), as in :data:`CORNERS`."""
    every = np.arange(fleet.size)
    fleet.set("z.omega", every, 2 * np.pi * plants[:, 0])
    fleet.set("z.zeta", every, plants[:, 1])
    fleet.set("z.dead_time", every, plants[:, 2] / PERIOD)
    fleet.set("z.omega_r", every, 2 * np.pi * plants[:, 3])
    fleet.set("z.acceleration", every, 14000.0)


class Injection:
    """The fleet of an injection, built once and used for many stacks of one law.

    Args:
        stack: any stack with the law.
        frequencies: Hz.
        settle, window: s.
        threads: worker threads.
    """

    def __init__(
        self, stack: Stack, frequencies: np.ndarray = FREQUENCIES, settle: float = SETTLE, window: float = WINDOW,
        threads: int = 1,
    ) -> None:  # fmt: skip
        self.frequencies, self.scenario = np.asarray(frequencies), _scenario(settle, window)
        corners, tones = np.meshgrid(np.arange(len(CORNERS)), self.frequencies, indexing="ij")
        self.corner, self.tone = corners.ravel(), tones.ravel()
        size = self.corner.size
        self.fleet = Fleet(size, stack.law, heads.ensure([0]), threads)
        every = np.arange(size)
        scenarios.prepare(self.fleet, self.scenario, every, np.zeros(size))
        put_plants(self.fleet, np.asarray(CORNERS)[self.corner])
        self.fleet.put_vibration(every, 0, AMPLITUDE, self.tone, 0.0)

    def measure(self, stack: Stack) -> Sensitivity:
        """|S| of ``stack``, whose law must be the fleet's."""
        every = np.arange(self.fleet.size)
        self.fleet.forget_filters()
        stack.install(self.fleet, every)
        self.fleet.begin(every, scenarios.noise_keys(np.zeros(self.fleet.size)))
        record = rollout.run(self.fleet, self.scenario, stack, np.zeros(self.fleet.size))
        gap = record["gap"][self.scenario.settle_steps :].astype(np.float64)
        magnitude = _amplitude(gap, self.tone, self.scenario.settle_steps) / AMPLITUDE
        magnitude[record.collided | ~np.isfinite(gap).all(axis=0)] = np.inf
        return Sensitivity(self.frequencies, magnitude.reshape(len(CORNERS), -1), self.fleet.size * self.scenario.steps)


def _amplitude(x: np.ndarray, tones: np.ndarray, first: int) -> np.ndarray:
    """Amplitude at each column's own frequency: least squares on sine, cosine and a constant."""
    t = (np.arange(len(x)) + 1 + first) * 1e-3
    out = np.empty(x.shape[1])
    for tone in np.unique(tones):
        columns = np.flatnonzero(tones == tone)
        basis = np.stack([np.sin(2 * np.pi * tone * t), np.cos(2 * np.pi * tone * t), np.ones_like(t)], axis=1)
        q, r = np.linalg.qr(basis)  # a tenth of the time of a general solver, whose threads get in each other's way
        a, b, _ = np.linalg.solve(r, q.T @ x[:, columns])
        out[columns] = np.hypot(a, b)
    return out


def sensitivity(stack: Stack, threads: int = 1) -> Sensitivity:
    """|S| of a stack at the suite's frequencies and corner plants."""
    return Injection(stack, threads=threads).measure(stack)
