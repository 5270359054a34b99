"""Draws of a posterior against closed forms."""

import numpy as np
import pytest
from scipy import stats

from kerfgym.experiments.identify import posterior

N, LOW, HIGH = 20_000, np.full(3, -5.0), np.full(3, 5.0)


@pytest.fixture(scope="module")
def regressors():
    return np.random.default_rng(1).normal(size=(3, N)) + np.array([[0.0], [0.5], [1.0]])


def line(regressors, noise):
    """The problem whose errors are regressors times numbers, less what numbers of 1, −2 and 0.5 made of them."""
    made = np.array([1.0, -2.0, 0.5]) @ regressors + noise
    return posterior.Problem(lambda points, cells: points @ regressors - made, LOW, HIGH, float(N))


def test_draws_are_those_of_linear_regression(regressors):
    """Against the normal distribution that theory gives."""
    problem = line(regressors, np.random.default_rng(2).normal(0, 0.7, N))
    x, cost = posterior.nearest(problem, np.zeros(3))
    found = posterior.sampled(problem, x, np.zeros(1), np.random.default_rng(3))
    covariance = cost / N * np.linalg.inv(regressors @ regressors.T)
    expected = np.linalg.lstsq(regressors.T, problem.errors(np.zeros((1, 3)), np.zeros(1))[0], rcond=None)[0]
    assert x == pytest.approx(-expected, abs=0.1 * np.sqrt(covariance.diagonal().min()))
    chance = 1 + np.sqrt(3 / (N // posterior.BLOCK))  # of independent errors (Marchenko and Pastur 1967)
    assert 1.0 <= found.spread < chance
    assert found.left == pytest.approx(0.7, rel=0.02)
    for i, draws in enumerate(found.draws.T):
        sigma = np.sqrt(covariance[i, i])
        assert draws.mean() == pytest.approx(x[i], abs=0.15 * sigma)
        assert 0.9 * sigma < draws.std() < 1.1 * chance * sigma
    between = np.corrcoef(found.draws.T)[0, 1] - covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert abs(between) < 0.12


def test_intervals_of_independent_errors_hold_as_often_as_they_say(regressors):
    """95 of 100, from the numbers that made them; a little more, since scores that scatter by chance widen them."""
    held, rng = [], np.random.default_rng(20)
    for _ in range(60):
        problem = line(regressors, rng.normal(0, 0.7, N))
        x, _ = posterior.nearest(problem, np.array([1.0, -2.0, 0.5]))
        low, high = np.percentile(posterior.sampled(problem, x, np.zeros(1), rng).draws, [2.5, 97.5], axis=0)
        held.append((low < [1.0, -2.0, 0.5]) & (high > [1.0, -2.0, 0.5]))
    assert stats.binomtest(int(np.sum(held)), 180, 0.95).pvalue > 1e-3


def test_a_jump_beside_the_valley_is_no_knowledge(regressors):
    """Errors jump where the first number is 80 of its deviations off: least squares and draws see the valley alone."""
    fine = 1e-5 / np.sqrt(N)
    noise = np.random.default_rng(21).normal(0, 1e-5, N)
    smooth = line(regressors, noise)
    jump = 5e-3 * np.random.default_rng(22).normal(size=N)
    edge = 1.0 + 80 * fine

    def errors(points, cells):
        return smooth.errors(points, cells) + np.where(points[:, :1] > edge, 1.0, 0.0) * jump

    torn = posterior.Problem(errors, LOW, HIGH, float(N))
    begin = np.array([1.0, -2.0, 0.5]) + 20 * fine
    x, cost = posterior.nearest(torn, begin)
    whole, least = posterior.nearest(smooth, begin)
    assert cost == pytest.approx(least, rel=1e-4)
    found = posterior.sampled(torn, x, np.zeros(1), np.random.default_rng(23))
    sigma = np.sqrt(least / N * np.linalg.inv(regressors @ regressors.T)[0, 0])
    assert found.draws[:, 0].std() > 0.85 * sigma
    assert found.draws[:, 0].mean() == pytest.approx(whole[0], abs=0.3 * sigma)


def test_errors_in_common_widen_the_draws(regressors):
    """Errors and a regressor that both last 50 samples: the variance of the estimate is about 50 times that of
    independent errors (closed form for blocks: each is worth one sample)."""
    lasting = np.repeat(np.random.default_rng(4).normal(size=(1, N // 50)), 50, axis=1)
    noise = np.repeat(np.random.default_rng(5).normal(0, 0.7, N // 50), 50)
    problem = line(np.concatenate([lasting, regressors[1:]]), noise)
    x, cost = posterior.nearest(problem, np.zeros(3))
    found = posterior.sampled(problem, x, np.zeros(1), np.random.default_rng(6))
    alone = np.sqrt(cost / N / np.sum(lasting**2))
    assert found.draws[:, 0].std() / alone == pytest.approx(np.sqrt(50), rel=0.35)


def test_what_errors_do_not_tell_stays_as_wide_as_the_prior(regressors):
    silent = regressors * np.array([[1.0], [1.0], [0.0]])
    problem = line(silent, np.random.default_rng(7).normal(0, 0.7, N))
    x, _ = posterior.nearest(problem, np.zeros(3))
    found = posterior.sampled(problem, x, np.zeros(1), np.random.default_rng(8))
    low, high = np.percentile(found.draws[:, 2], [2.5, 97.5])
    assert high - low > 0.8 * 0.95 * 10.0


def test_cells_come_by_their_odds(regressors):
    """Two cells that fit alike come alike often, and one that does not never."""
    made = np.array([1.0, -2.0, 0.5]) @ regressors + np.random.default_rng(9).normal(0, 0.7, N)
    off = np.array([0.0, 0.0, 1.0])
    problem = posterior.Problem(lambda points, cells: points @ regressors - made + off[cells.astype(int), None],
                                LOW, HIGH, float(N))  # fmt: skip
    found = posterior.sampled(problem, np.array([1.0, -2.0, 0.5]), np.arange(3.0), np.random.default_rng(10))
    count = [int(np.sum(found.cells == cell)) for cell in range(3)]
    assert count[2] == 0
    assert stats.binomtest(count[0], count[0] + count[1]).pvalue > 1e-9
    assert min(count[:2]) > 300


def test_two_valleys_are_drawn_from_as_often_as_they_are_likely():
    # Errors of a quartic with two bottoms at ±1, of which one is less deep: its quadrature says how likely each is.
    def errors(points, cells):
        x = points[:, 0]
        return np.stack([8.0 * (x**2 - 1.0), 1.0 + 0.25 * x, np.zeros(len(x))], axis=1)

    problem = posterior.Problem(errors, np.array([-2.0]), np.array([2.0]), 2.0)
    at = [posterior.nearest(problem, np.array([x])) for x in (-0.9, 0.9, 0.95)]
    found = posterior.sampled_valleys(problem, at, np.random.default_rng(0))
    unit, grid = min(cost for _, cost in at) / 2.0, np.linspace(-2, 2, 20001)
    density = np.exp(-np.sum(errors(grid[:, None], None) ** 2, axis=1) / (2 * unit))
    density /= density.sum()
    left = float(density[grid < 0].sum())
    assert 0.55 < left < 0.95
    assert np.mean(found.draws[:, 0] < 0) == pytest.approx(left, abs=0.05)
    quantiles = np.interp([0.1, 0.3, 0.9], np.cumsum(density), grid)
    assert np.quantile(found.draws[:, 0], [0.1, 0.3, 0.9]) == pytest.approx(quantiles, abs=0.02)
