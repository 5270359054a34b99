"""Learns the policies of a front: one weighting of time, dross, Rz and contour error after the other.

Every figure of a job is a sum along its path, and what the settings do to a millimetre of it is nearly a fixed map. So a
policy needs few numbers, whole jobs are cheap, and CMA-ES on the figures themselves needs neither a reward that stands
for them nor a critic. Each weighting starts from the best policy for it that the ones before came across. The front is
of all that was tried, as a search for the front of rules keeps it (:func:`tune.outcome.front`).
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cmaes
import numpy as np

from ...envs.control import stack as stacks
from ..store import runs
from ..tune import goals
from ..tune.evaluate import Evaluator
from . import policies
from .points import METRICS, efficient

SUITE = "cutting"
PACES = (1.2, 1.0, 0.88, 0.76, 0.64, 0.54, 0.45, 0.38)
"""Feeds, of the planned one, at which time and Rz balance: their weights follow (:func:`weightings`)."""
CARES = (0.02, 0.1, 0.4)
"""Weights of the contour error, of the time's."""
DROSS = 1.0
"""Weight of the dross, of the roughness'."""
SPREAD = 0.15
POPULATION = 8
LEAST, MOST = -1.0, 2.0


@dataclass(frozen=True)
class Tried:
    """A policy that was tried: its numbers and its figures, in the order of :data:`points.METRICS`."""

    numbers: np.ndarray
    figures: np.ndarray


def weightings() -> list[np.ndarray]:
    """Weights of the ratios of :data:`points.METRICS` to the base's.

    Of a feed v the time is about 0.1 + 0.9/v and Rz about v^1.25; their weighted sum is least at v if 0.9·w_t/v² =
    1.25·w_r·v^0.25.
    """
    found = []
    for care in CARES:
        for pace in PACES:
            rough = 0.72 / pace**2.25
            found.append(np.array([1.0, DROSS / rough, 1.0 / rough, care]))
    return found


class Shop:
    """Runs policies on *tune* seeds and counts what that takes."""

    def __init__(self, seeds: int, threads: int = 1) -> None:
        self.base = policies.team(policies.policy(policies.START))
        self.evaluator = Evaluator(self.base, SUITE, range(seeds), threads)
        plain = Evaluator(stacks.asked(policies.BASE), SUITE, range(seeds), threads)
        self.reference = figures(plain, stacks.asked(policies.BASE))
        self.tried: list[Tried] = []

    def run(self, numbers: np.ndarray) -> np.ndarray:
        """The figures of a policy of these numbers, kept."""
        found = figures(self.evaluator, policies.team(policies.policy(numbers)))
        self.tried.append(Tried(np.array(numbers), found))
        return found

    def cost(self, figures: np.ndarray, weights: np.ndarray) -> float:
        """The weighted sum of the ratios to the base's; of a failed policy far above all others."""
        value = float(weights @ (figures / self.reference))
        return value if np.isfinite(value) else goals.FAILED


def figures(evaluator: Evaluator, team: Any) -> np.ndarray:
    """Time, dross, Rz and contour error over the suite's core; NaN if a run failed or did not cut through."""
    found = evaluator.whole(team, ("collision", "through", *METRICS))
    values = np.array([goals.score(m, found, evaluator.core) for m in METRICS])
    sound = all((of["collision"] == 0).all() and (of["through"] >= 1.0 - 1e-9).all() for of in found.values())
    return values if sound else np.full(len(METRICS), np.nan)


def learn(folder: Path, budget: int, seeds: int = 4, seed: int = 0) -> list[Tried]:
    """Learns a front within a budget of simulated steps, and writes its policies into ``folder/front``."""
    shop = Shop(seeds)
    shop.run(policies.START)
    wanted = weightings()
    for i, weights in enumerate(wanted):
        limit = budget * (i + 1) // len(wanted)
        start = min(shop.tried, key=lambda t: shop.cost(t.figures, weights)).numbers
        bounds = np.tile([LEAST, MOST], (policies.SIZE, 1))
        search = cmaes.CMA(
            mean=np.clip(start, LEAST + 0.01, MOST - 0.01), sigma=SPREAD, bounds=bounds, seed=seed + i,
            population_size=POPULATION,
        )  # fmt: skip
        while shop.evaluator.ledger.steps < limit:
            asked = [search.ask() for _ in range(search.population_size)]
            search.tell([(x, shop.cost(shop.run(x), weights)) for x in asked])
    table = np.array([t.figures for t in shop.tried])
    kept = [shop.tried[i] for i in efficient(table)]
    cost = shop.evaluator.ledger.entry()
    made = {"suite": SUITE, "tune_seeds": f"0-{seeds - 1}", "tried": len(shop.tried), "sampler_seed": seed}
    made |= {key: cost[key] for key in ("simulated_steps", "cpu_seconds")}
    for i, each in enumerate(kept, 1):
        tune = dict(zip(METRICS, each.figures.tolist(), strict=True))
        policies.policy(each.numbers, made | {"tune": tune}).save(folder / "front" / f"{i:03d}")
    runs.write_text(folder / "learned.json", json.dumps(made | {"front": len(kept)}, indent=1) + "\n")
    return kept
