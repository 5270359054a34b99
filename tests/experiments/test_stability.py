"""Stability by injection against the linear loop, and the sensitivity peaks of the shipped controllers."""

import numpy as np
import pytest

from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.stack import get, resolve
from kerfgym.experiments import stability
from kerfgym.experiments.search import CAP, SPACES
from kerfgym.experiments.stability import AMPLITUDE, CORNERS, FREQUENCIES, Injection, sensitivity

T = PERIOD
CENTRE = 0.125e-3
"""s from the centre of a gate of 0.25 ms to the end of its period."""


def axis(s, bandwidth, zeta, resonance):
    """Head over velocity command, without dead time: PHYSICS §2."""
    w, wr = 2 * np.pi * bandwidth, 2 * np.pi * resonance
    loop = w**2 / (s**2 + 2 * zeta * w * s + w**2)
    mode = wr**2 / (s**2 + 2 * 0.05 * wr * s + wr**2)
    return loop * (0.9 + 0.1 * mode) / s


def sampled(hertz, delay, plant):
    """Head at the sampling instants over the held command, by summing the images of the sampled spectrum."""
    w = 2 * np.pi * (hertz + np.arange(-400, 401)[:, None] / T)
    s = 1j * w
    hold = (1 - np.exp(-s * T)) / s
    return (axis(s, *plant) * np.exp(-s * delay) * hold).sum(axis=0) / T


def linear(kv, hertz, corner):
    """|S| from the sheet to the true gap at the end of each period, for u = −kv·(gap at the gate's centre)."""
    bandwidth, zeta, dead_time, resonance = corner
    plant = (bandwidth, zeta, resonance)
    at_gate = sampled(hertz, dead_time + CENTRE, plant)
    at_end = sampled(hertz, dead_time, plant)
    seen = np.exp(-2j * np.pi * hertz * CENTRE)  # the sheet at the gate's centre
    command = kv * seen / (1 + kv * at_gate)
    return np.abs(at_end * command - 1)


def ideal(injection):
    """Takes friction, backlash, quantisation and limits out of an injection's machines."""
    every = np.arange(injection.fleet.size)
    for name in ("friction", "backlash", "dac", "encoder"):
        injection.fleet.set(f"z.{name}", every, 0.0)
    for name in ("speed", "acceleration", "jerk"):
        injection.fleet.set(f"z.{name}", every, 1e12)
    return injection


@pytest.mark.parametrize("kv", [20.0, 60.0, 90.0])
def test_the_sensitivity_of_a_p_law_is_that_of_the_linear_loop(kv):
    p = resolve(f"xi2023-improved:filter.kind=none,law.kv={kv}")
    measured = ideal(Injection(p)).measure(p)
    assert measured.magnitude.shape == (16, 40)
    expected = np.array([linear(kv, FREQUENCIES, corner) for corner in CORNERS])
    assert measured.magnitude == pytest.approx(expected, rel=0.03, abs=0.005)
    assert measured.peak == pytest.approx(expected.max(), rel=0.03)
    assert measured.worst == pytest.approx(expected.max(axis=0), rel=0.03, abs=0.005)


def test_a_moving_average_of_n_samples_adds_half_its_length_of_delay():
    kv, n = 50.0, 5
    p = resolve(f"xi2023-ma:filter.window={n},law.kv={kv}")
    measured = ideal(Injection(p)).measure(p)
    mean = np.exp(-2j * np.pi * FREQUENCIES[:, None] * T * np.arange(n)).mean(axis=1)
    expected = []
    for corner in CORNERS:
        bandwidth, zeta, dead_time, resonance = corner
        gate = sampled(FREQUENCIES, dead_time + CENTRE, (bandwidth, zeta, resonance))
        end = sampled(FREQUENCIES, dead_time, (bandwidth, zeta, resonance))
        command = kv * mean * np.exp(-2j * np.pi * FREQUENCIES * CENTRE) / (1 + kv * mean * gate)
        expected.append(np.abs(end * command - 1))
    assert measured.magnitude == pytest.approx(np.array(expected), rel=0.03, abs=0.005)


def test_a_slow_sine_is_followed_as_an_integrator_does():
    p = resolve("xi2023-improved:filter.kind=none,law.kv=50")
    measured = ideal(Injection(p, np.array([1.0, 2.0]), settle=0.5, window=2.0)).measure(p)
    assert measured.magnitude == pytest.approx(np.tile(2 * np.pi * np.array([1.0, 2.0]) / 50, (16, 1)), rel=0.03)


def test_a_loop_that_is_too_tight_has_no_finite_claim_of_stability():
    wild = resolve("xi2023-improved:filter.kind=none,law.kv=400")
    assert sensitivity(wild).peak > 10.0


def test_no_law_leaves_the_sheets_motion_in_the_gap():
    idle = get("idle")
    measured = Injection(idle, np.array([5.0, 50.0]), settle=0.1, window=1.0).measure(idle)
    assert measured.magnitude == pytest.approx(1.0, rel=1e-6)


def test_the_injection_is_the_one_of_the_suite():
    assert AMPLITUDE == 0.020
    assert len(FREQUENCIES) == 40
    assert (FREQUENCIES[0], FREQUENCIES[-1]) == pytest.approx((1.0, 200.0))
    assert len(set(CORNERS)) == 16
    low, high = np.min(CORNERS, axis=0), np.max(CORNERS, axis=0)
    assert low.tolist() == [50.0, 0.6, 0.001, 60.0]
    assert high.tolist() == [120.0, 1.0, 0.002, 150.0]


def test_an_injection_used_again_gives_what_a_new_one_gives():
    frequencies = np.array([3.0, 30.0, 90.0])
    first, second = resolve("xi2023-ma:filter.window=40"), get("xi2023-improved")
    used = Injection(first, frequencies, settle=0.2, window=0.5)
    used.measure(first)
    new = Injection(second, frequencies, settle=0.2, window=0.5, threads=2)
    assert np.array_equal(used.measure(second).magnitude, new.measure(second).magnitude)


@pytest.mark.parametrize("name", SPACES)
def test_a_tuned_controllers_peak_is_the_one_it_claims_and_below_the_cap(name):
    measured = sensitivity(get(name))
    assert measured.peak <= CAP
    assert measured.peak == pytest.approx(get(name).provenance["ms"], abs=2e-3)
    assert measured.steps == 640 * round((stability.SETTLE + stability.WINDOW) / PERIOD)
