"""Tests of residuals: closed forms, false alarms, and words."""

import numpy as np
import pytest
from scipy import signal, stats

from kerfgym.experiments.identify import next_protocol, residuals


def ar(n, a, seed=0):
    return signal.lfilter([1.0], [1.0, -a], np.random.default_rng(seed).normal(size=n))


def test_the_autocorrelation_of_an_ar1_process_falls_as_its_powers_and_its_past_explains_the_square():
    white = residuals.whiteness(ar(200_000, 0.6))
    np.testing.assert_allclose(white.rho[:6], 0.6 ** np.arange(6), atol=0.01)
    assert white.effect == pytest.approx(0.36, abs=0.01)
    assert white.p < 1e-12


def test_ljung_and_boxs_statistic_is_the_sum_of_its_definition_and_follows_chi_square():
    r = ar(300, 0.3)
    e, n = r - r.mean(), 300
    rho = [np.sum(e[k:] * e[: n - k]) / np.sum(e * e) for k in range(1, 11)]
    q = n * (n + 2) * sum(c * c / (n - k) for k, c in enumerate(rho, 1))
    assert residuals.ljung_box(r, 10) == pytest.approx((q, stats.chi2.sf(q, 10)))
    p = [residuals.ljung_box(np.random.default_rng(s).normal(size=500), 10)[1] for s in range(400)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.03)


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_bounds_of_cross_correlation_hold_95_of_100_lags_of_independent_signals(colour):
    outside = []
    for seed in range(60):
        e, u = np.random.default_rng(1000 + seed).normal(size=2000), ar(2000, colour, seed)
        outside.append(residuals.crossed(e, u).outside)
    assert np.mean(outside) == pytest.approx(0.05, abs=0.012)
    # Both coloured: the bound is wider, and as seldom crossed.
    outside = [residuals.crossed(ar(4000, 0.8, 500 + s), ar(4000, 0.8, s)).outside for s in range(60)]
    assert np.mean(outside) == pytest.approx(0.05, abs=0.025)


def test_a_residual_that_follows_the_command_is_found_on_the_side_of_the_past():
    rng = np.random.default_rng(1)
    u = rng.normal(size=20_000)
    found = residuals.crossed(np.roll(u, 5) + rng.normal(size=20_000), u)
    assert found.lags[np.argmax(found.rho)] == 5
    assert found.effect == pytest.approx(0.5, abs=0.02)
    assert found.p_causal < 1e-6
    assert found.p_feedback > 0.001


def judged(residual, command):
    encoder = 20 + np.cumsum(command) * 1e-3
    return residuals.judged(residual, command, encoder, 1.0).verdict


def test_what_is_significant_and_tiny_is_not_called_wrong():
    u = 20 * ar(30_000, 0.9)
    tiny = 0.3 * ar(30_000, 0.7, 3)
    assert residuals.ljung_box(tiny)[1] < 1e-12
    assert judged(tiny, u).explains == "yes"
    assert "nothing of size" in judged(tiny, u).why


def test_what_is_large_is_called_wrong_and_its_direction_named():
    u = 20 * ar(30_000, 0.9)
    noise = np.random.default_rng(4).normal(size=30_000)
    missing = judged(20 * np.roll(u, 8) / np.std(u) + noise, u)
    assert missing.explains == "no"
    assert "missing linear dynamics" in missing.why
    encoder = 20 + np.cumsum(u) * 1e-3
    uneven = residuals.judged(20 * np.sin(encoder * 2) + noise, u, encoder, 1.0).verdict
    assert uneven.explains == "no"
    assert "uneven scale" in uneven.why
    assert judged(10 * noise, u).explains == "partly"
    assert "without a pattern" in judged(10 * noise, u).why


def test_first_order_indices_are_those_of_a_linear_gaussian_score():
    rng = np.random.default_rng(5)
    x = {name: rng.normal(size=5000) for name in "abc"}
    weights = {"a": 3.0, "b": 1.0, "c": 0.0}

    def score(which):
        return 7 + sum(w * x[name][which[name]] for name, w in weights.items())

    y, share = next_protocol.indices(score, dict.fromkeys("abc", 5000), 20_000, rng)
    assert np.std(y) == pytest.approx(np.sqrt(10), rel=0.03)
    assert [share[name] for name in "abc"] == pytest.approx([0.9, 0.1, 0.0], abs=0.03)


def test_a_group_that_acts_only_together_with_another_has_no_first_order_index():
    rng = np.random.default_rng(6)
    x = {name: rng.normal(size=5000) for name in "ab"}
    _, share = next_protocol.indices(lambda w: x["a"][w["a"]] * x["b"][w["b"]], dict.fromkeys("ab", 5000), 20_000, rng)
    assert list(share.values()) == pytest.approx([0.0, 0.0], abs=0.05)
