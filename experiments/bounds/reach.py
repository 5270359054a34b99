"""What the drive lets a controller do, however clever: the head's jerk is limited.

A linear drive hides nothing: who knows it can command what makes the head go where it should, so bandwidth, damping,
structural mode and friction bound nobody. Dead time does, since no command acts before it is over, and so does the
limit J of the jerk. The newest k commands, which have acted for a time τ, can move the head by at most::

    r(τ) = J·∫₀^τ |g(t)| dt,    g(t) = (1 − c)·t²/2 + c·m(t),    m" + 2ζω·m' + ω²·m = ω²·t²/2

to either side of where it would be without jerk. g is the head's answer to a pulse of jerk; m is the structural mode's,
which carries the share c of the load path. With c = 0 this is J·τ³/6. The limit of the acceleration is left out: within
the few ms that matter the jerk is the tighter one.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...envs.plant import machine, z_axis
from ...envs.plant.controller import PERIOD
from .ramps import share

FINE = 40
"""Points of time in a control period at which g is integrated."""

WINDOW = 24
"""Control periods of a step that are counted, from its first moment on; what comes later is left out."""

EARLY = 10
"""Control periods before the score's footprint touches a step: commands that act so early can follow it freely."""

PENALTY, ITERATIONS = 3000.0, 400
"""Of the search for the best jerks; a poor one can only lower a bound."""


@dataclass(frozen=True)
class Reach:
    """What one axis can do with its head.

    Attributes:
        jerk: µm/s³.
        omega, zeta, share: rad/s, damping ratio and share of the structural mode.
        backlash: µm.
        dead: control periods from a decision to its first effect, whole or not.
    """

    jerk: float
    omega: float
    zeta: float
    share: float
    backlash: float
    dead: float

    @classmethod
    def of(cls, p: z_axis.Params) -> "Reach":
        """From an axis' parameters."""
        jerk = 1e3 * p.jerk * (1.0 + 1.0 / machine.SUBSTEPS**2)  # by so much its substeps go further than g says
        return cls(jerk, p.omega_r, p.zeta_r, p.compliance, 1e3 * p.backlash, p.dead_time)

    @property
    def horizon(self) -> int:
        """Control periods from the newest reading that can matter to the end of the first that it can change.

        A reading ends a period, and the command that answers it begins the next; it acts after the dead time.
        """
        return int(np.floor(self.dead + 1e-9)) + 1

    def answer(self, t: np.ndarray) -> np.ndarray:
        """g at times ``t`` (s), s²: position of the head after a pulse of jerk of 1 mm/s³·s; 0 before it."""
        t = np.maximum(np.asarray(t, float), 0.0)
        w, z, c = self.omega, self.zeta, self.share
        damped, rest = w * np.sqrt(1.0 - z * z), (4.0 * z * z - 1.0) / w**2
        swing = -rest * np.cos(damped * t) + (2.0 * z / w - z * w * rest) / damped * np.sin(damped * t)
        mode = 0.5 * t * t - 2.0 * z / w * t + rest + np.exp(-z * w * t) * swing
        return np.asarray((1.0 - c) * 0.5 * t * t + c * mode)

    def within(self, commands: int) -> np.ndarray:
        """µm by which the newest 1, 2, … ``commands`` commands can move the head to either side."""
        late = self.dead + 1e-9 - np.floor(self.dead + 1e-9)  # of a period, in which the newest does not act yet
        step = PERIOD / FINE
        t = (np.arange(commands * FINE) + 0.5) * step
        moved = np.concatenate([[0.0], np.cumsum(np.abs(self.answer(t))) * step])
        ends = np.arange(1, commands + 1) - late
        return np.asarray(self.jerk * np.interp(ends * FINE, np.arange(len(moved)), moved))

    @cached_property
    def _pieces(self) -> np.ndarray:
        """What a jerk of 1 in each of the periods 0 … moves the head by at the ends of the periods 1 …, in ms³."""
        t = (np.arange(WINDOW * FINE) + 0.5) * PERIOD / FINE
        pulse = self.answer(t).reshape(WINDOW, FINE).sum(axis=1) * PERIOD / FINE
        after = np.arange(WINDOW)[:, None] - np.arange(WINDOW)
        return np.where(after >= 0, pulse[after], 0.0) / PERIOD**3

    @cached_property
    def _fine(self) -> np.ndarray:
        """g(t_n − τ) at the ends of the periods 1 … for the points of time τ of a fine grid, s²."""
        ends = np.arange(1, WINDOW + 1)[:, None] * PERIOD
        return self.answer(ends - (np.arange(WINDOW * FINE) + 0.5) * PERIOD / FINE)

    def cost(self, courses: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Lower bounds on the sums of squared errors of a head at rest that follows courses unawares at first.

        Commands act from the first period on. The least of ``Σ w·(h − s)²`` over all jerks within ±J is bounded from
        below by its dual, whatever λ is; here λ = w·(s − h) of the best jerk that is constant within each period::

            Σ w·(h − s)² ≥ (λᵀs − J·∫|Σ λ_n·g(t_n − τ)|dτ − b·Σ max(λ, 0))² / Σ λ²

        b is what the backlash can lift the head by (the mode can at most treble its share of it); it opens only once
        the motor has come to fall faster than gravity, which takes g/J.

        Args:
            courses: s at the ends of the periods 1 …, µm, shape (:data:`WINDOW`, courses).
            weights: w, 0 or 1, of the same shape.

        Returns:
            µm², shape (courses,).
        """
        size = self.jerk * PERIOD**3
        short = weights * (courses - size * self._pieces @ self._best(courses / size))
        whole = np.maximum((short**2).sum(axis=0), 1e-30)
        driven = self.jerk * np.abs(self._fine.T @ short).sum(axis=0) * PERIOD / FINE
        falls = np.arange(1, WINDOW + 1) * PERIOD > 1e3 * z_axis.GRAVITY / self.jerk
        lifted = (1.0 + 2.0 * self.share) * self.backlash * np.maximum(short, 0.0)[falls].sum(axis=0)
        dual = np.maximum((short * courses).sum(axis=0) - driven - lifted, 0.0)
        return np.asarray(dual**2 / whole)

    def _best(self, courses: np.ndarray) -> np.ndarray:
        """Nearly the best jerks within ±1, one for each period, by the alternating direction method of multipliers.

        For ``min ½|Bj − s|²`` (Boyd et al. 2011, section 5.2), all courses at once.
        """
        pieces = self._pieces
        inverse = np.linalg.inv(pieces.T @ pieces + PENALTY * np.eye(WINDOW))
        pulled, kept = inverse @ (pieces.T @ courses), PENALTY * inverse
        bounded = multiplier = np.zeros_like(courses)
        for _ in range(ITERATIONS):
            free = 1.7 * (pulled + kept @ (bounded - multiplier)) - 0.7 * bounded
            bounded = np.clip(free + multiplier, -1.0, 1.0)
            multiplier = multiplier + free - bounded
        return bounded

    def cost_of_steps(
        self, heights: np.ndarray, starts: np.ndarray, feed: float, sensor: float, score: float, scored: range
    ) -> np.ndarray:
        """Lower bounds on what steps of the sheet cost, as sums of squared errors, µm².

        Place, height and direction are given away with the first reading in which the sensor's footprint touches the
        step, so that no noise matters. Until then the head rests: up and down are equally likely, and the least cost is
        convex in the state of the head and the step together, so no state before it helps.

        Args:
            heights: µm, shape (steps,).
            starts: mm along the path, of the middle of each ramp.
            feed: mm/s.
            sensor, score: radii of the footprints, mm.
            scored: control periods of the episode that count.

        Returns:
            µm², shape (steps,).
        """
        pace = feed * PERIOD
        begins = np.floor((starts - score) / pace).astype(int)
        told = np.floor((starts - sensor) / pace).astype(int) + 1  # end of the first period with the step in it
        acts = told + self.horizon - 1  # the newest period that the news cannot change
        ends = np.arange(1, WINDOW + 1)[:, None] + acts
        counts = ((ends >= scored.start) & (ends < scored.stop)).astype(float)
        met = heights * share((ends * pace - starts) / score)
        worth = acts >= begins - EARLY  # who knows so early has all the time there is
        costs = np.zeros(len(starts))
        costs[worth] = self.cost(met[:, worth], counts[:, worth])
        unaware = np.arange(WINDOW)[:, None] + begins
        due = (unaware <= acts) & (unaware >= scored.start) & (unaware < scored.stop)
        paid = (due * (heights * share((unaware * pace - starts) / score)) ** 2).sum(axis=0)
        return np.asarray(paid + costs)
