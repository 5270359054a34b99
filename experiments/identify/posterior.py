"""What errors say of the numbers that made them: the nearest point, and draws of all that are as likely.

1. :func:`nearest`: least squares by Levenberg and Marquardt with several damping factors at once;
2. :func:`sampled`: importance sampling around it with a proposal that adapts to what it has found (Cappé et al. 2004).
   It needs no bell-shaped posterior, only one that the heavy-tailed proposal covers.

The likelihood takes errors for independent, of the scale that the nearest point leaves. Where blocks of errors have
more in common than chance lets them, draws are spread by as much (the sandwich of Huber 1967, put on samples by Shaby
2014).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special, stats

STEP = 1e-4
"""Of a number, which is a logarithm, for derivatives."""

BLOCK = 1000
"""Samples of a block of errors, longer than they are correlated."""

DRAWS, ROUNDS = 160, 3
"""Points of each round of sampling, and rounds."""

KEPT = 1000
"""Draws that are returned."""


@dataclass(frozen=True)
class Problem:
    """Numbers and the errors that they leave.

    Attributes:
        errors: from points of shape (n, numbers) and the cell of each, shape (n,), to errors of shape (n, samples).
        low, high: ends of the prior, uniform in between, shape (numbers,).
        worth: how many independent errors of one scale there are.
    """

    errors: Callable[[np.ndarray, np.ndarray], np.ndarray]
    low: np.ndarray
    high: np.ndarray
    worth: float

    def slopes(self, x: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
        """Errors at a point and their derivatives, shape (numbers, samples)."""
        signs = np.where(x + STEP > self.high, -1.0, 1.0)
        points = np.concatenate([x[None], x + np.diag(STEP * signs)])
        made = self.errors(points, np.full(len(points), cell))
        return made[0], (made[1:] - made[0]) / (STEP * signs)[:, None]


@dataclass(frozen=True)
class Sample:
    """Draws of a posterior, shape (KEPT, numbers), their cells, RMS of what the nearest point leaves, what factor its
    blocks of errors spread the draws by at most, and how many independent draws they are worth."""

    draws: np.ndarray
    cells: np.ndarray
    left: float
    spread: float
    effective: float


def nearest(problem: Problem, x: np.ndarray, cell: float = 0.0, rounds: int = 20) -> tuple[np.ndarray, float]:
    """Least squares from a point on, with the cell held.

    Returns:
        The point, and the sum of its squared errors.
    """
    low, high = problem.low, problem.high
    damping, cost = 1e-2, np.inf
    for _ in range(rounds):
        here, slopes = problem.slopes(x, cell)
        cost = float(here @ here)
        weak = cost / problem.worth / (high - low) ** 2  # what the prior weighs, for directions that errors do not tell
        normal, push = slopes @ slopes.T, slopes @ here
        tries = np.array([
            np.clip(x - np.linalg.solve(normal + np.diag(factor * np.diag(normal) + weak), push), low, high)
            for factor in damping * 10.0 ** np.arange(-2.0, 5.0, 2.0)
        ])  # fmt: skip
        costs = np.sum(problem.errors(tries, np.full(len(tries), cell)) ** 2, axis=1)
        best = int(np.nanargmin(costs))
        if not costs[best] < cost * (1 - 1e-5):
            break
        x, cost, damping = tries[best], float(costs[best]), max(1e-9, damping * 10.0 ** (2.0 * best - 2.0))
    return x, cost


def sampled(problem: Problem, x: np.ndarray, cells: np.ndarray, rng: np.random.Generator) -> Sample:
    """The posterior around a point.

    Args:
        problem: what is asked.
        x: a point near the best, shape (numbers,).
        cells: that may be the true one, of which each has the same prior.
        rng: draws.
    """
    refined = [nearest(problem, x, cell, 2) for cell in cells]
    best = int(np.argmin([cost for _, cost in refined]))
    x, cost = refined[best]
    here, slopes = problem.slopes(x, cells[best])
    unit = cost / problem.worth
    prior = np.diag(12 / (problem.high - problem.low) ** 2)
    informed = slopes @ slopes.T / unit + prior
    chosen, points, worth, weight = _weighed(problem, x, cells, np.array([c for _, c in refined]), informed, unit, rng)
    kept = rng.choice(len(points), KEPT, p=weight)
    wider, spread = _sandwich(slopes, here, informed, unit)
    draws = np.clip(x + (points[kept] - x) @ wider.T, problem.low, problem.high)
    return Sample(draws, cells[chosen[kept]], float(np.sqrt(unit)), spread, worth)


def _weighed(
    problem: Problem, x: np.ndarray, cells: np.ndarray, costs: np.ndarray, informed: np.ndarray, unit: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:  # fmt: skip
    """Cells, points, what they are worth, and their weights."""
    least, size = costs.min(), len(x)
    spread, middle = np.linalg.inv(informed) * 1.3, x
    odds = 0.9 * special.softmax(-(costs - least) / (2 * unit)) + 0.1 / len(cells)
    points, chosen, likely = np.zeros((0, size)), np.zeros(0, int), np.zeros(0)
    proposed: list[tuple[Any, np.ndarray]] = []
    for _ in range(ROUNDS):
        proposal = stats.multivariate_t(middle, spread, df=5, allow_singular=True, seed=rng)
        new, k = np.atleast_2d(proposal.rvs(DRAWS)).reshape(DRAWS, size), rng.choice(len(cells), DRAWS, p=odds)
        inside = np.all((new > problem.low) & (new < problem.high), axis=1)
        fine = np.full(DRAWS, -np.inf)
        if inside.any():
            fine[inside] = -(np.sum(problem.errors(new[inside], cells[k[inside]]) ** 2, axis=1) - least) / (2 * unit)
        points, chosen, likely = np.concatenate([points, new]), np.append(chosen, k), np.append(likely, fine)
        proposed.append((proposal, odds))
        density = special.logsumexp([p.logpdf(points) + np.log(o[chosen]) for p, o in proposed], axis=0)
        weight = special.softmax(likely - density)
        # Too few draws with weight cannot tell a shape: weights are flattened until there are enough.
        flat, power = weight, 1.0
        while 1 / np.sum(flat**2) < 4 * size and power > 1e-4:
            power *= 0.8
            flat = special.softmax(power * (likely - density))
        middle, spread = flat @ points, 1.2 * np.atleast_2d(np.cov(points.T, aweights=flat))
        odds = np.array([weight[chosen == i].sum() for i in range(len(cells))])
        odds = 0.9 * odds / odds.sum() + 0.1 / len(cells)
    worth = float(1 / np.sum(weight**2))
    return chosen, points, worth, weight if worth > size else flat  # one draw would claim to know everything


def _sandwich(slopes: np.ndarray, left: np.ndarray, informed: np.ndarray, unit: float) -> tuple[np.ndarray, float]:
    """What draws around the nearest point are multiplied by: one but where scores of blocks scatter by more than those
    of independent errors can by chance (Marchenko and Pastur 1967); and the largest factor in any direction."""
    blocks, size = len(left) // BLOCK, len(slopes)
    if blocks < 2 * size:
        return np.eye(size), 1.0
    cut = blocks * BLOCK
    scores = (slopes[:, :cut] * left[:cut]).reshape(size, blocks, BLOCK).sum(axis=2) / unit
    root = np.linalg.cholesky(informed)
    whitened = np.linalg.solve(root, scores)
    values, vectors = np.linalg.eigh(whitened @ whitened.T)
    values[values < (1 + np.sqrt(size / blocks)) ** 2] = 1.0
    inner = (vectors * np.sqrt(values)) @ vectors.T
    return np.linalg.solve(root.T, inner @ root.T), float(np.sqrt(values.max()))
