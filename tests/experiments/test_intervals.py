"""Statistics of comparisons: closed forms, hand-computed cases, published definitions, and intervals that hold."""

import numpy as np
import pytest
from scipy import stats

from kerfgym.experiments.statistics import bootstrap
from kerfgym.experiments.statistics.intervals import (
    Interval,
    Sample,
    cvar,
    iqm,
    performance_profile,
    probability_of_improvement,
    share,
    wilson,
)

INF = np.inf


def drawn(*shape, seed=0, spread=0.5):
    return np.exp(spread * np.random.default_rng(seed).normal(size=shape))


# ---------------------------------------------------------------------------------------------------------- figures


@pytest.mark.parametrize(
    ("values", "mean"),
    [
        ([1, 2, 3, 4, 5, 6, 7, 8], 4.5),  # 3 4 5 6
        ([8, 1, 100, 3, 2, 4, 5, -50], 3.5),  # 2 3 4 5: the ends do not matter
        ([1, 2, 3, 4, 5], 3.0),  # a quarter of five is one
        ([1, 2, 3], 2.0),  # of three none
        ([[1, 2], [3, 4]], 2.5),  # over everything
        ([1, 2, 3, INF], 2.5),
        ([1, 2, 3, np.nan], 2.5),  # a failed run is the worst
        ([1, 2, INF, INF], INF),
    ],
)
def test_the_interquartile_mean_is_that_of_the_middle_half(values, mean):
    assert iqm(values) == mean


def test_the_mean_of_the_worst_counts_the_last_in_part():
    assert cvar([1, 2, 3, 4], 0.5) == 3.5
    assert cvar([1, 2, 3, 4], 0.375) == pytest.approx((4 + 0.5 * 3) / 1.5)
    assert cvar([1, 2, np.nan], 0.1) == INF
    assert cvar([1, 2, 3], 1.0) == 2.0


def test_the_mean_of_the_worst_of_a_normal_variable_is_its_closed_form():
    values = stats.norm.ppf((np.arange(100_000) + 0.5) / 100_000, 5.0, 2.0)
    assert cvar(values, 0.05) == pytest.approx(5.0 + 2.0 * stats.norm.pdf(stats.norm.ppf(0.95)) / 0.05, rel=1e-4)


@pytest.mark.parametrize(("hits", "count"), [(0, 200), (3, 200), (50, 50), (1, 2)])
def test_wilsons_interval_is_its_closed_form(hits, count):
    z, p = stats.norm.ppf(0.975), hits / count
    middle = (p + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(p * (1 - p) / count + z**2 / (4 * count**2))
    assert wilson(hits, count) == pytest.approx((p, max(0, middle - half), min(1, middle + half)), abs=1e-12)


def test_the_interval_of_a_share_knows_what_is_independent():
    once = (np.random.default_rng(1).random(100) < 0.3).astype(float)
    single, same = share(once), share(np.repeat(once[:, None], 7, axis=1))
    assert single == pytest.approx(same)  # seven copies of a run are no more than one
    z, p, n = stats.t.ppf(0.975, 99), once.mean(), 99  # with the sample variance of 0 and 1: n - 1
    middle, scale = (p + z**2 / (2 * n)) / (1 + z**2 / n), z / (1 + z**2 / n)
    half = scale * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    assert single == pytest.approx((p, middle - half, middle + half))
    apart = share(np.random.default_rng(2).random((100, 7)) < 0.3)
    assert apart.high - apart.low < 0.5 * (single.high - single.low)
    assert share(np.ones((20, 7)))[:1] == (1.0,)
    assert 0.8 < share(np.ones((20, 7))).low < 0.85  # twenty draws, not 140
    assert np.isnan(share([[1.0, 0.0]]).low)


def test_the_probability_of_improvement_by_hand():
    x, y = [1.0, 2.0], [2.0, 3.0]
    assert probability_of_improvement(x, y, paired=False).value == 3.5 / 4  # 1<2 1<3 2=2 2<3
    assert probability_of_improvement(x, y).value == 1.0  # 1<2 2<3
    assert probability_of_improvement([2.0, 2.0], [2.0, 3.0]).value == 0.75
    assert probability_of_improvement([[1, 5], [1, 5]], [[2, 4], [2, 4]]).value == 0.5  # one scenario each
    assert probability_of_improvement([np.nan, INF], [1.0, INF]).value == 0.25  # a failed run loses; two are a tie


def test_the_performance_profile_by_hand():
    profile = performance_profile([[0.5, 1.0], [2.0, np.nan]], [0.4, 0.5, 1.0, 1e9])
    assert [point.value for point in profile] == [0.0, 0.25, 0.5, 0.75]  # the failed run is never counted
    assert all(point.low <= point.value <= point.high for point in profile)


def published(x, y, thresholds):
    """rliable 1.2.0's definitions, written anew; higher is better there."""
    scores, others = -np.asarray(x), -np.asarray(y)
    flat = np.sort(scores.ravel())
    cut = int(0.25 * flat.size)
    wins = [stats.mannwhitneyu(a, b, alternative="greater").statistic for a, b in zip(scores.T, others.T, strict=True)]
    above = [np.mean(scores > -t) for t in thresholds]
    return -flat[cut : flat.size - cut].mean(), np.mean(wins) / (len(scores) * len(others)), above


X, Y = drawn(23, 7, seed=3), drawn(31, 7, seed=4) * 1.1
X[2, 3] = Y[5, 3]  # a tie


def test_figures_are_rliables():
    middle, wins, above = published(X, Y, [0.5, 1.0, 2.0])
    assert iqm(X) == pytest.approx(middle, rel=1e-12)
    assert probability_of_improvement(X, Y, paired=False).value == pytest.approx(wins, rel=1e-12)
    assert [point.value for point in performance_profile(X, [0.5, 1.0, 2.0])] == pytest.approx(above)


def test_figures_are_those_of_rliable_itself():
    metrics = pytest.importorskip("rliable.metrics", reason="rliable is dormant and not among the dependencies")
    assert iqm(X) == pytest.approx(-metrics.aggregate_iqm(-X), rel=1e-12)
    wins = metrics.probability_of_improvement(-X, -Y)
    assert probability_of_improvement(X, Y, paired=False).value == pytest.approx(wins, rel=1e-12)


def test_the_unpaired_interval_is_that_of_a_u_statistic():
    values = [probability_of_improvement(drawn(20, seed=i), drawn(30, seed=900 + i), paired=False) for i in range(300)]
    assert 0.92 <= np.mean([v.low <= 0.5 <= v.high for v in values]) <= 0.98


# ------------------------------------------------------------------------------------------------------ resampling


def plain(statistic, values):
    return statistic(values, (None, None))[0][0]


STATISTICS = (bootstrap.log_score, bootstrap.pooled_mean, bootstrap.mean_of_middle)


def test_the_statistics_are_what_they_are_called():
    values = drawn(3, 40, 5)
    assert np.exp(plain(bootstrap.log_score, values)) == pytest.approx(
        stats.gmean(np.sqrt((values**2).mean(axis=1)), axis=None)
    )
    assert plain(bootstrap.mean_of_middle, values) == pytest.approx(iqm(values), rel=1e-12)
    assert plain(bootstrap.pooled_mean, values) == pytest.approx(values.mean(), rel=1e-12)


@pytest.mark.parametrize("statistic", STATISTICS)
def test_weights_are_repetitions(statistic):
    values, random = drawn(4, 24, 6, seed=5), np.random.default_rng(6)
    weights = [random.multinomial(n, np.full(n, 1 / n), size=3).astype(float) for n in values.shape[:2]]
    found, _ = statistic(values, tuple(weights))
    for b in range(3):
        index = [np.repeat(np.arange(len(w[b])), w[b].astype(int)) for w in weights]
        assert found[b] == pytest.approx(plain(statistic, values[np.ix_(*index, range(6))]), rel=1e-12)


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize("axis", [0, 1])
def test_influences_are_derivatives_by_the_weights(statistic, axis):
    values, step = drawn(4, 50, 6, seed=7), 1e-4
    n = values.shape[axis]
    weights = [None, None]
    weights[axis] = np.ones((2, n))
    weights[axis][1] += step * (n * np.eye(n)[1] - 1)  # more of the second member, less of all
    found, influences = statistic(values, tuple(weights))
    influence = influences[axis][0] - influences[axis][0].mean()
    assert (found[1] - found[0]) / step == pytest.approx(influence[1], rel=0.02, abs=0.003)


def test_the_pooled_mean_is_of_the_runs_that_did_not_fail_and_may_be_zero():
    values = np.array([[0.0, 4.0], [1.0, INF], [2.0, 6.0], [INF, 8.0], [3.0, 0.0], [0.0, 2.0]])
    found = bootstrap.replicate([Sample.of(values)], bootstrap.pooled_mean)
    columns = [column[np.isfinite(column)] for column in values.T]
    value, low, high = found.interval([1.0])
    assert value == pytest.approx(np.mean([column.mean() for column in columns]))
    assert low < value < high
    alone = bootstrap.replicate([Sample.of(np.arange(30.0))], bootstrap.pooled_mean)
    assert alone.spread[0, 0] == pytest.approx(stats.sem(np.arange(30.0)) ** 2)


@pytest.mark.parametrize("statistic", [bootstrap.log_score, bootstrap.pooled_mean])
def test_influences_are_derivatives_where_runs_failed_too(statistic):
    values, step = drawn(1, 50, 6, seed=7), 1e-4
    values[0, [0, 7, 9], [2, 2, 5]] = INF
    weights = np.ones((51, 50))
    weights[1:] += step * (50 * np.eye(50) - 1)
    found, influences = statistic(values, (None, weights))
    influence = influences[1][0] - influences[1][0].mean()
    assert (found[1:] - found[0]) / step == pytest.approx(influence, rel=0.02, abs=0.003)


def test_the_variance_of_a_mean_is_the_textbooks():
    values = np.random.default_rng(8).normal(size=(1, 50, 1))

    def mean(values, weights):
        w = np.ones((1, 50)) if weights[1] is None else weights[1]
        return np.einsum("bs,rsc->b", w, values) / 50, (None, np.broadcast_to(values[0, :, 0], w.shape))

    found = bootstrap.replicate([Sample.of(values)], mean)
    assert found.spread[0, 0] == pytest.approx(stats.sem(values.ravel()) ** 2)
    low, high = stats.t.interval(0.95, 49, values.mean(), stats.sem(values.ravel()))
    assert found.interval([1.0]) == pytest.approx((values.mean(), low, high), abs=0.1 * (high - low))


def test_of_two_to_four_seeds_the_interval_is_students_and_of_one_there_is_none():
    values = drawn(1, 3, 1)
    found = bootstrap.replicate([Sample.of(values)], bootstrap.log_score).interval([1.0])
    assert (found.high - found.value) == pytest.approx(found.value - found.low)
    assert found.high > found.value
    assert np.isnan(bootstrap.replicate([Sample.of(values[:, :1])], bootstrap.log_score).interval([1.0]).low)


def test_the_same_sample_gives_the_same_interval_to_the_last_digit_whoever_stands_beside_it():
    one, other = Sample.of(drawn(30, 5)), Sample.of(drawn(30, 5, seed=1))
    alone = bootstrap.replicate([one], bootstrap.log_score).interval([1.0])
    assert bootstrap.replicate([one], bootstrap.log_score).interval([1.0]) == alone
    assert bootstrap.replicate([one, other], bootstrap.log_score).interval([1.0, 0.0]) == alone


def test_pairs_on_common_seeds_are_told_apart_where_others_are_not():
    sheet, noise = drawn(40, 5, seed=2), np.exp(0.02 * np.random.default_rng(3).normal(size=(40, 5)))
    closer = 0.97 * sheet * noise
    paired = bootstrap.replicate([Sample.of(closer), Sample.of(sheet)], bootstrap.log_score)
    apart = bootstrap.replicate([Sample.of(closer), Sample.of(sheet, range(100, 140))], bootstrap.log_score)
    assert paired.better()[0, 1]
    assert not apart.better().any()
    assert paired.interval([1, -1]).high < 0 < apart.interval([1, -1]).high
    half = bootstrap.replicate([Sample.of(closer), Sample.of(sheet, range(20, 60))], bootstrap.log_score)
    assert half.spread[0, 0] == pytest.approx(apart.spread[0, 0])


def test_figures_that_hardly_scatter_are_told_apart_and_their_intervals_end():
    """The time of a job is the same on every seed for some controllers, and for others on all seeds but one."""
    same, rare, slow = np.full((20, 5), 4.28), np.full((20, 5), 5.94), np.full((20, 5), 12.9)
    rare[3] = 5.95
    slow *= 1.0 + 1e-15 * np.arange(20)[:, None]  # rounding
    found = bootstrap.replicate([Sample.of(x) for x in (same, rare, slow, same.copy())], bootstrap.log_score)
    assert found.better().astype(int).tolist() == [[0, 1, 1, 0], [0, 0, 1, 0], [0, 0, 0, 0], [0, 1, 1, 0]]
    assert found.interval([-1, 0, 1, 0]) == pytest.approx([np.log(12.9 / 4.28)] * 3)
    low, value, high = found.interval([-1, 1, 0, 0])[1], *found.interval([-1, 1, 0, 0])[::2]
    assert 0.32 < low < value < high < 0.34


def test_one_seed_of_one_sample_takes_no_interval_from_another():
    found = bootstrap.replicate([Sample.of(drawn(30, 5)), Sample.of(drawn(1, 5))], bootstrap.log_score)
    assert np.isfinite(found.interval([1, 0]).low)
    assert np.isnan(found.interval([0, 1]).low)
    assert np.isnan(found.interval([1, -1]).low)
    assert not found.better().any()


def test_a_share_of_failed_runs_below_a_quarter_leaves_the_middle_its_interval():
    values = np.log(drawn(40, 5))
    values[:4] = INF
    found = bootstrap.replicate([Sample.of(values)], bootstrap.mean_of_middle).interval([1.0])
    assert np.isfinite(found).all()
    assert found.value == pytest.approx(iqm(values))
    values[:9] = INF  # in many of the bootstrap samples more than a quarter
    assert bootstrap.replicate([Sample.of(values)], bootstrap.mean_of_middle).interval([1.0]).high == INF


def test_a_sample_counts_missing_figures_as_failed():
    assert Sample.of([1.0, np.nan]).values.tolist() == [[[1.0], [INF]]]


@pytest.mark.parametrize(
    ("values", "seeds", "words"),
    [
        (np.zeros((0, 2)), None, "shape"),
        (np.zeros((1, 1, 1, 1)), None, "shape"),
        ([1.0, 2.0], [3], "1 different labels for 2 seeds"),
        ([1.0, 2.0], [3, 3], "1 different labels for 2 seeds"),
    ],
)
def test_a_sample_refuses_nonsense(values, seeds, words):
    with pytest.raises(ValueError, match=words):
        Sample.of(values, seeds)


def test_an_interval_is_a_value_and_two_ends():
    assert Interval(1.0)[0] == 1.0
    assert np.isnan(Interval(1.0)[1:]).all()
