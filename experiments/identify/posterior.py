"""What errors say of the numbers that made them: the nearest point, and draws of all that are as likely.

1. :func:`nearest`: least squares by Levenberg and Marquardt with several damping factors at once;
2. :func:`sampled`: importance sampling around it with a proposal that adapts to what it has found (Cappé et al. 2004).
   It needs no bell-shaped posterior, only one that the heavy-tailed proposal covers.

The likelihood takes errors for independent, of the scale that the nearest point leaves. Where blocks of errors have
more in common than chance lets them, draws are spread by as much (the sandwich of Huber 1967, put on samples by Shaby
2014).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special, stats

STEP, FINE, LEAST = 1e-4, 0.3, 1e-8
"""Steps of a number, which is a logarithm, for derivatives: at most, in standard deviations of it alone, and at least.
One that is many deviations wide tells of jumps that errors have where nothing likely lies."""

BLOCK, ENOUGH = 500, 4
"""Samples of a block of errors, longer than they are correlated; blocks for each number that it takes to tell how their
scores scatter."""

DRAWS, ROUNDS = 160, 3
"""Points of each round of sampling, and rounds."""

KEPT = 1000
"""Draws that are returned."""

FEW = 4
"""Draws for each number that a sample must be worth to tell a shape."""

HOPELESS, FEWEST = 12.0, 60
"""Logarithm of a likelihood that is too small beside the best; points of each round in each of many valleys."""


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
        return slopes(lambda points: self.errors(points, np.full(len(points), cell)), x, self.high, self.worth)


def slopes(
    errors: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    high: np.ndarray,
    worth: float,
    chosen: Sequence[int] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Errors at a point and their derivatives by the chosen numbers, shape (chosen, samples): by wide steps, and again
    by those that what is known asks for, where those are finer.

    Args:
        errors: of points, shape (points, numbers).
        x: the point.
        high: ends of its numbers; a step that would lead beyond goes down.
        worth: samples that the errors are worth.
        chosen: numbers; all unless given.
    """
    numbers = list(range(len(x)) if chosen is None else chosen)
    steps = np.full(len(numbers), STEP)
    for _ in range(2):
        moved = steps * np.where(x[numbers] + steps > high[numbers], -1.0, 1.0)
        points = np.tile(x, (len(numbers) + 1, 1))
        points[np.arange(1, len(numbers) + 1), numbers] += moved
        made = errors(points)
        here, found = made[0], (made[1:] - made[0]) / moved[:, None]
        steps = fine_steps(found, float(here @ here) / worth)
        if np.all(steps >= 0.5 * STEP):
            break
    return here, found


def fine_steps(slopes: np.ndarray, unit: float) -> np.ndarray:
    """Steps of numbers by what wide ones told, where errors have the variance ``unit``."""
    known = np.sqrt(unit / np.maximum(np.sum(slopes**2, axis=1), 1e-300))
    steps: np.ndarray = np.clip(FINE * known, LEAST, STEP)
    return steps


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
    costs = np.array([cost for _, cost in refined])
    valley = _Valley.at(problem, refined[best][0], cells[best], costs.min() / problem.worth)
    return _merged(problem, cells, [valley], [_explored(problem, valley, cells, costs, rng)], rng)


def sampled_valleys(problem: Problem, points: list[tuple[np.ndarray, float]], rng: np.random.Generator) -> Sample:
    """The posterior around several points at once, where errors have several valleys that may be the right one.

    Args:
        problem: what is asked; its one cell is 0.
        points: the bottoms of valleys with their sums of squared errors. What lies within a standard deviation of a
            better one is taken for the same, and what is :data:`HOPELESS` is left out.
        rng: draws.
    """
    points = sorted(points, key=lambda each: each[1])
    unit, valleys = points[0][1] / problem.worth, list[_Valley]()
    for x, cost in points:
        there = any(np.all(np.abs(x - other.x) < other.deviations) for other in valleys)
        if not there and (cost - points[0][1]) / (2 * unit) < HOPELESS:
            valleys.append(_Valley.at(problem, x, 0.0, unit))
    least, cells = np.array([points[0][1]]), np.zeros(1)
    draws = max(DRAWS // len(valleys), FEWEST)
    return _merged(problem, cells, valleys, [_explored(problem, v, cells, least, rng, draws) for v in valleys], rng)


@dataclass(frozen=True)
class _Valley:
    """The bottom of one, what is known there, and what draws around it are multiplied by, and by how much at most."""

    x: np.ndarray
    informed: np.ndarray
    unit: float
    wider: np.ndarray
    spread: float

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations of the numbers."""
        return np.sqrt(np.diag(np.linalg.inv(self.informed)))

    @classmethod
    def at(cls, problem: Problem, x: np.ndarray, cell: float, unit: float) -> "_Valley":
        here, slopes = problem.slopes(x, cell)
        informed = slopes @ slopes.T / unit + np.diag(12 / (problem.high - problem.low) ** 2)
        return cls(x, informed, unit, *_sandwich(slopes, here, informed, unit))


@dataclass(frozen=True)
class _Explored:
    """Points, the index of the cell of each, logarithms of how likely they are, and what they were proposed from."""

    points: np.ndarray
    chosen: np.ndarray
    likely: np.ndarray
    proposed: list[tuple[Any, np.ndarray]]


def _explored(
    problem: Problem,
    valley: _Valley,
    cells: np.ndarray,
    costs: np.ndarray,
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> _Explored:
    """Points of a valley, by proposals that adapt; ``costs`` of the cells, of which the least counts as likely as 1."""
    least, size, unit = costs.min(), len(valley.x), valley.unit
    spread, middle = np.linalg.inv(valley.informed) * 1.3, valley.x
    odds = 0.9 * special.softmax(-(costs - least) / (2 * unit)) + 0.1 / len(cells)
    points, chosen, likely = np.zeros((0, size)), np.zeros(0, int), np.zeros(0)
    proposed: list[tuple[Any, np.ndarray]] = []
    for _ in range(ROUNDS):
        proposal = stats.multivariate_t(middle, spread, df=5, allow_singular=True, seed=rng)
        new, k = np.atleast_2d(proposal.rvs(draws)).reshape(draws, size), rng.choice(len(cells), draws, p=odds)
        inside = np.all((new > problem.low) & (new < problem.high), axis=1)
        fine = np.full(draws, -np.inf)
        if inside.any():
            fine[inside] = -(np.sum(problem.errors(new[inside], cells[k[inside]]) ** 2, axis=1) - least) / (2 * unit)
        points, chosen, likely = np.concatenate([points, new]), np.append(chosen, k), np.append(likely, fine)
        proposed.append((proposal, odds))
        weight, flat = _weights(likely - _density(proposed, points, chosen), size)
        middle, spread = flat @ points, 1.2 * np.atleast_2d(np.cov(points.T, aweights=flat))
        odds = np.array([weight[chosen == i].sum() for i in range(len(cells))])
        odds = 0.9 * odds / odds.sum() + 0.1 / len(cells)
    return _Explored(points, chosen, likely, proposed)


def _density(proposed: list[tuple[Any, np.ndarray]], points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Logarithm of the density of a mixture of proposals, but for a constant."""
    mixed: np.ndarray = special.logsumexp([p.logpdf(points) + np.log(o[chosen]) for p, o in proposed], axis=0)
    return mixed


def _weights(logarithms: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights, and the same flattened until there are enough draws with weight to tell a shape."""
    weight = special.softmax(logarithms)
    flat, power = weight, 1.0
    while 1 / np.sum(flat**2) < FEW * size and power > 1e-4:
        power *= 0.8
        flat = special.softmax(power * logarithms)
    return weight, flat


def _merged(
    problem: Problem, cells: np.ndarray, valleys: list[_Valley], explored: list[_Explored], rng: np.random.Generator
) -> Sample:
    """Draws from all valleys, each as often as it is likely."""
    points, chosen, likely = (np.concatenate([getattr(e, k) for e in explored]) for k in ("points", "chosen", "likely"))
    of = np.repeat(np.arange(len(valleys)), [len(e.points) for e in explored])
    size, proposed = points.shape[1], [p for e in explored for p in e.proposed]
    weight, flat = _weights(likely - _density(proposed, points, chosen), size)
    worth = float(1 / np.sum(weight**2))
    kept = rng.choice(len(points), KEPT, p=weight if worth > size else flat)  # one draw would claim to know everything
    draws = np.empty((KEPT, size))
    for i, valley in enumerate(valleys):
        mine = of[kept] == i
        draws[mine] = valley.x + (points[kept[mine]] - valley.x) @ valley.wider.T
    left, spread = float(np.sqrt(valleys[0].unit)), max(valley.spread for valley in valleys)
    return Sample(np.clip(draws, problem.low, problem.high), cells[chosen[kept]], left, spread, worth)


def _sandwich(slopes: np.ndarray, left: np.ndarray, informed: np.ndarray, unit: float) -> tuple[np.ndarray, float]:
    """What draws around the nearest point are multiplied by, and the largest factor in any direction.

    It is one where scores of blocks scatter by no more than those of independent errors. By chance some directions of
    those scatter more, too, by up to the square of 1 + sqrt(size / blocks) (Marchenko and Pastur 1967); that stays, so
    that the draws are rather too wide.
    """
    blocks, size = len(left) // BLOCK, len(slopes)
    if blocks < ENOUGH * size:
        return np.eye(size), 1.0
    cut = blocks * BLOCK
    scores = (slopes[:, :cut] * left[:cut]).reshape(size, blocks, BLOCK).sum(axis=2) / unit
    root = np.linalg.cholesky(informed)
    whitened = np.linalg.solve(root, scores)
    values, vectors = np.linalg.eigh(whitened @ whitened.T * blocks / (blocks - size))  # the fit took ``size`` of them
    values = np.maximum(values, 1.0)
    inner = (vectors * np.sqrt(values)) @ vectors.T
    return np.linalg.solve(root.T, inner @ root.T), float(np.sqrt(values.max()))
