"""Impulses and drift of a rest log: against the log without them, closed forms, and what cannot be told."""

import numpy as np
import pytest
from scipy import ndimage, stats

from kerfgym.experiments.identify import disturbances, head, identifying, protocols
from kerfgym.experiments.identify.log import PERIOD, Log
from kerfgym.experiments.studies import identified_disturbances

QUIET = {
    "noise": 1e-3, "nominal": True, "impulses": 12.0, "impulse_samples": 3.0, "impulse_height": 0.15,
    "impulse_falloff": 0.9, "impulse_spread": 0.3,
}  # fmt: skip


def of(**head_numbers):
    return {"name": "known", "head": {**QUIET, **head_numbers}}


@pytest.fixture(scope="module")
def swept():
    return head.swept(protocols.record(of(impulses=0.0), "sweep", 4))


@pytest.fixture(scope="module")
def rest():
    return protocols.record(of(), "rest", 4)


def interval(draws):
    return np.percentile(draws, [2.5, 97.5])


def identify(log, swept, usual=None):
    return disturbances.identify(log, swept, np.random.default_rng(0), usual)


def test_impulses_are_those_by_which_the_same_log_without_them_differs(rest, swept):
    calm = protocols.record(of(impulses=0.0), "rest", 4)
    where = sorted(head.rests(rest), key=lambda each: each[1])[0][0]
    differs = np.abs(rest["frequency"] - calm["frequency"])[where] > 100.0
    _, found = disturbances._impulses([(where, rest["frequency"][where])], swept)
    assert found.length.sum() == differs.sum()
    assert len(found.off) == pytest.approx(ndimage.label(differs)[1], abs=3)  # some follow at once on others
    # The apparent height of each: 0.15 mm/(1 + h/0.9) by 30 % more or less.
    at_zero = 0.15 / (1 + found.gap / 0.9)
    assert np.all(np.abs(np.abs(found.off) / at_zero - 1) < 0.33)


def test_all_numbers_of_the_impulses_are_within_their_intervals(rest, swept):
    draws = identify(rest, swept).draws
    for key in ("impulses", "impulse_samples", "impulse_height", "impulse_falloff", "impulse_spread"):
        low, high = np.percentile(draws[key], [0.5, 99.5])
        assert low <= QUIET[key] <= high, key
    assert np.ptp(interval(draws["impulses"])) < 0.35 * QUIET["impulses"]


def test_without_impulses_the_rate_has_the_upper_end_of_an_empty_binomial(swept):
    log = protocols.record(of(impulses=0.0), "rest", 4)
    found = identify(log, swept)
    samples = sum(w.stop - w.start for w, h in head.rests(log) if h < 2.0 + min(log["encoder"]))
    # Of the quiet heights; the highest is none of them.
    end = stats.beta.ppf(0.975, 0.5, samples + 0.5) / PERIOD
    assert interval(found.draws["impulses"])[1] == pytest.approx(end, rel=0.15)
    assert "impulse_height" not in found.draws
    assert "impulse_samples" not in found.draws


@pytest.mark.parametrize("longest", [1.0, 2.0, 8.0])
def test_the_longest_is_found_as_a_whole_number(longest, swept):
    draws = identify(protocols.record(of(impulse_samples=longest, impulses=30.0), "rest", 6), swept).draws
    low, high = interval(draws["impulse_samples"])
    assert low <= longest <= high
    assert high - low <= 1


def test_so_many_impulses_that_they_run_into_each_other_are_not_counted(swept):
    log = protocols.record(of(impulses=400.0, impulse_samples=10.0), "rest", 4)
    found = identify(log, swept)
    assert "impulses" not in found.draws
    assert any("cannot be told apart" in note for note in found.notes)


def cooled(rest, drift, warming):
    """A rest log whose L·C changes by drift·(1 − exp(−t/warming))."""
    warm = 1 - np.exp(-rest["time"] / warming)
    return Log("rest.csv", "rest", {**rest.columns, "frequency": rest["frequency"] / np.sqrt(1 + drift * warm)})


@pytest.mark.parametrize(("drift", "warming"), [(-0.002, 60.0)])
def test_a_drift_that_warms_within_the_log_is_told(drift, warming, rest, swept):
    draws = identify(cooled(rest, drift, warming), swept, 600.0).draws
    for key, true in (("drift", drift), ("warming", warming)):
        low, high = np.percentile(draws[key], [0.5, 99.5])
        assert low <= true <= high, key
    assert np.ptp(interval(draws["drift"])) < 0.5 * abs(drift)


def test_of_a_drift_of_ten_minutes_a_log_tells_the_rate_alone_and_says_so(rest, swept):
    found = identify(cooled(rest, 0.0008, 600.0), swept, 600.0)
    assert any("head.warming is not told" in note for note in found.notes)
    assert "warming" not in found.draws
    low, high = np.percentile(found.draws["drift"], [0.5, 99.5])
    assert low < 0.0008 < high
    assert high - low < 1e-3
    # A head that warms half as fast, by twice as much, does nearly the same in that time.
    slower = identify(cooled(rest, 0.0016, 1200.0), swept, 600.0)
    assert np.median(slower.draws["drift"]) == pytest.approx(np.median(found.draws["drift"]), rel=0.08)


def test_without_drift_none_is_found(rest, swept):
    draws = identify(rest, swept, 600.0).draws
    low, high = np.percentile(draws["drift"], [0.5, 99.5])
    assert low < 0.0 < high
    assert high - low < 1e-3


def test_the_sampler_of_walkers_draws_from_what_it_is_given():
    rng = np.random.default_rng(1)
    mean, covariance = np.array([1.0, -2.0]), np.array([[4.0, 1.9], [1.9, 1.0]])
    law = stats.multivariate_normal(mean, covariance)
    chain = disturbances.stretched(law.logpdf, rng.normal(size=(64, 2)), rng, 3000)[500:].reshape(-1, 2)
    np.testing.assert_allclose(chain.mean(axis=0), mean, atol=0.06)
    np.testing.assert_allclose(np.cov(chain.T), covariance, rtol=0.06)


def test_the_machines_file_draws_impulses_and_keeps_what_was_not_told(rest, swept):
    made = identifying.identify([protocols.record(of(), "sweep", 4), rest])
    numbers = {number.key: number for number in made.numbers}
    assert numbers["head.impulses"].found
    assert "head.warming" not in numbers
    assert made.machine.head.warming == 600.0
    low, high = min(made.machine.head.impulses.choice), max(made.machine.head.impulses.choice)
    assert low < QUIET["impulses"] < high


def test_the_count_of_the_study_is_of_machines_and_intervals():
    held = identified_disturbances.covered(2, 3)
    assert all(len(each) <= 2 for each in held.values())
    assert len(held["drift"]) == 2
