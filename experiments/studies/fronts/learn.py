"""Learns the policies of a front, all of them together, on the figures of whole jobs.

Every figure of a job is a sum along its path, and what the settings do to a millimetre of it is nearly a fixed map. So
a policy needs few numbers, whole jobs are cheap, and the figures themselves are the aim: neither a reward that stands
for them nor a critic is needed. Each trial draws a weighting at random, takes the policies that are best for it so far,
and tries a variation of one of them. Weightings are drawn as *random hypervolume scalarisations* (Golovin and Zhang
2020): the mean over them of the best value is the hypervolume, so every trial is asked to enlarge that. Variations are
differences between two other good policies (differential evolution, Storn and Price 1997) and a little noise. The front
is of all that was tried, as a search for the front of rules keeps it (``tune.outcome.front``).
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

from ....envs.control import stack as stacks
from ...store import runs
from ...tune import goals
from ...tune.evaluate import Evaluator
from . import policies
from .comparing import REFERENCE, WORST
from .points import METRICS, efficient

SUITE = "cutting"
RECORD = "learned.json"

FIRST = 64
"""Trials at the start, spread evenly over general feed, dither, and how much is slowed down before corners."""

ELITES = 12
"""Of how many of the best for a weighting one is varied, by the difference of two others."""

NOISE = 0.04
LEAST, MOST = -1.5, 3.0
"""Standard deviation of the noise, and the bounds of a policy's numbers."""


@dataclass(frozen=True)
class Tried:
    """A policy that was tried: its numbers, and its figures in the order of :data:`points.METRICS`."""

    numbers: np.ndarray
    figures: np.ndarray


def figures(evaluator: Evaluator, team: Any) -> np.ndarray:
    """Time, dross, Rz and contour error over the suite's core; NaN if a run failed or did not cut through."""
    found = evaluator.whole(team, ("collision", "through", *METRICS))
    values = np.array([goals.score(m, found, evaluator.core) for m in METRICS])
    sound = all((of["collision"] == 0).all() and (of["through"] >= 1.0 - 1e-9).all() for of in found.values())
    return values if sound else np.full(len(METRICS), np.nan)


def starts(seed: int) -> list[np.ndarray]:
    """The first trials."""
    found = [policies.START]
    for u in qmc.Sobol(3, seed=seed).random(FIRST)[:-1]:
        numbers = policies.START.copy()
        numbers[0] = -0.75 + 1.75 * u[0]
        numbers[1] = u[1]
        numbers[2:-1] *= 5.0 * u[2]
        found.append(numbers)
    return found


def values(points: np.ndarray, weights: np.ndarray, worst: np.ndarray) -> np.ndarray:
    """The hypervolume scalarisation of points (n, d), the more the better; of failed ones −∞."""
    sound = np.isfinite(points).all(axis=1)
    span = worst - points[sound].min(axis=0)
    return np.where(sound, ((worst - points) / span / weights).min(axis=1), -np.inf)


def varied(tried: list[Tried], worst: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The numbers of the next trial."""
    weights = np.abs(random.normal(size=len(METRICS))) + 1e-3
    worth = values(np.array([t.figures for t in tried]), weights / np.linalg.norm(weights), worst)
    elite = np.argsort(-worth)[:ELITES]
    at = elite[int(len(elite) * random.random() ** 2)]
    one, other = random.choice(elite, 2, replace=False)
    step = random.choice([0.5, 1.0]) * (tried[one].numbers - tried[other].numbers)
    kept = random.random(policies.SIZE) < 0.7
    numbers = tried[at].numbers + np.where(kept, step, 0.0) + NOISE * random.normal(size=policies.SIZE)
    return np.clip(numbers, LEAST, MOST)


def learn(folder: Path, budget: int, seeds: int = 4, seed: int = 0) -> list[Tried]:
    """Learns a front within a budget of simulated steps, and writes its policies into ``folder/front``."""
    evaluator = Evaluator(policies.team(policies.policy(policies.START)), SUITE, range(seeds))
    plain = stacks.asked(REFERENCE)
    worst = figures(Evaluator(plain, SUITE, range(seeds)), plain) * WORST
    random, tried, first = np.random.default_rng(seed), list[Tried](), starts(seed)
    while evaluator.ledger.steps < budget:
        numbers = first[len(tried)] if len(tried) < len(first) else varied(tried, worst, random)
        tried.append(Tried(numbers, figures(evaluator, policies.team(policies.policy(numbers)))))
    kept = [tried[i] for i in efficient(np.array([t.figures for t in tried]))]
    cost = evaluator.ledger.entry()
    made = {"suite": SUITE, "tune_seeds": f"0-{seeds - 1}", "tried": len(tried), "sampler_seed": seed}
    made |= {key: cost[key] for key in ("simulated_steps", "cpu_seconds")}
    for i, each in enumerate(kept, 1):
        tune = dict(zip(METRICS, each.figures.tolist(), strict=True))
        policies.policy(each.numbers, made | {"tune": tune}).save(folder / "front" / f"{i:03d}")
    runs.write_text(folder / RECORD, json.dumps(made | {"front": len(kept)}, indent=1) + "\n")
    return kept
