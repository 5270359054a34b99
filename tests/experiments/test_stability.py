"""Stability by injection against the linear loop, and the sensitivity peaks of the shipped controllers."""

import numpy as np
import pytest

from kerfgym.envs.control.stack import get, resolve
from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.scenarios import Scenario, rules
from kerfgym.experiments.measure import stability
from kerfgym.experiments.measure.plants import STANDARD, of
from kerfgym.experiments.measure.stability import (
    AMPLITUDE,
    FREQUENCIES,
    LINES,
    Injection,
    Noise,
    broadband,
    sensitivity,
)
from kerfgym.experiments.tune import study_file

NAMES = study_file.read("followers").searches
"""Followers with a preset, each with its search."""

PLAIN = {"friction": 0.0, "bristle": 0.0, "stiction": 1.0, "stribeck": 2.0, "latency": 0.0}
"""An axis without friction, with fixed dead times."""

DRAWN = ("axis.bandwidth", "axis.zeta", "axis.dead_time", "axis.resonance")
MACHINE = of(Scenario(name="plain", axis=PLAIN))
CORNERS = [tuple(corner[name] for name in DRAWN) for corner in MACHINE.corners]

T = PERIOD
CENTRE = 0.125e-3
"""s from the centre of a gate of 0.25 ms to the end of its period."""


def axis(s, bandwidth, zeta, resonance):
    """Head over velocity command, without dead time: docs/physics.md#the-z-axis."""
    w, wr = 2 * np.pi * bandwidth, 2 * np.pi * resonance
    loop = w**2 / (s**2 + 2 * zeta * w * s + w**2)
    mode = wr**2 / (s**2 + 2 * 0.05 * wr * s + wr**2)
    return loop * (0.9 + 0.1 * mode) / s


def sampled(hertz, delay, plant, images=400):
    """Head at the sampling instants over the held command, by summing the images of the sampled spectrum."""
    w = 2 * np.pi * (hertz + np.arange(-images, images + 1)[:, None] / T)
    s = 1j * w
    hold = (1 - np.exp(-s * T)) / s
    return (axis(s, *plant) * np.exp(-s * delay) * hold).sum(axis=0) / T


def closed(command, plant, hertz, dead_time):
    """|S| from the sheet to the true gap at the end of each period, of a law with the response ``command`` to the gap
    at the gate's centre."""
    seen = np.exp(-2j * np.pi * hertz * CENTRE)
    law = command * seen / (1 + command * sampled(hertz, dead_time + CENTRE, plant))
    return np.abs(sampled(hertz, dead_time, plant) * law - 1)


def pid(hertz, kp, ki, kd, lag):
    """Response of the shipped PID, written anew: sums for the integral, a first-order lag behind the difference."""
    z = np.exp(2j * np.pi * hertz * T)
    share = 1 / (lag + 1)
    return kp + ki * T / (1 - 1 / z) + kd * share * (1 - 1 / z) / T / (1 - (1 - share) / z)


def linear(kv, hertz, corner):
    """|S| from the sheet to the true gap at the end of each period, for u = −kv·(gap at the gate's centre)."""
    bandwidth, zeta, dead_time, resonance = corner
    return closed(kv, (bandwidth, zeta, resonance), hertz, dead_time)


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
    measured = ideal(Injection(p, machine=MACHINE)).measure(p)
    assert measured.magnitude.shape == (16, 40)
    expected = np.array([linear(kv, FREQUENCIES, corner) for corner in CORNERS])
    assert measured.magnitude == pytest.approx(expected, rel=0.03, abs=0.005)
    assert measured.peak == pytest.approx(expected.max(), rel=0.03)
    assert measured.worst == pytest.approx(expected.max(axis=0), rel=0.03, abs=0.005)


def test_a_moving_average_of_n_samples_adds_half_its_length_of_delay():
    kv, n = 50.0, 5
    p = resolve(f"xi2023-ma:filter.window={n},law.kv={kv}")
    measured = ideal(Injection(p, machine=MACHINE)).measure(p)
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
    measured = ideal(Injection(p, np.array([1.0, 2.0]), settle=0.5, window=2.0, machine=MACHINE)).measure(p)
    assert measured.magnitude == pytest.approx(np.tile(2 * np.pi * np.array([1.0, 2.0]) / 50, (16, 1)), rel=0.03)


def test_a_loop_that_is_too_tight_has_no_finite_claim_of_stability():
    wild = resolve("xi2023-improved:filter.kind=none,law.kv=400")
    assert sensitivity(wild).peak > 10.0


def test_no_law_leaves_the_sheets_motion_in_the_gap():
    idle = get("idle")
    measured = Injection(idle, np.array([5.0, 50.0]), settle=0.1, window=1.0).measure(idle)
    assert measured.magnitude == pytest.approx(1.0, rel=1e-6)


# ------------------------------------------------------------------------------------------ another machine


STIFF = "pid:law.kp=50.333,law.ki=3518.5,law.kd=0.75961,law.lag=8.1686"
"""On a drive of 25 Hz its sensitivity has a high, narrow peak."""


LEARNS = (
    "self-tuning:law.kp=85,law.ki=0,law.feed=0.987,law.lead=-1.5,law.sharpen=2.2,law.memory=120,law.prior=1.2,"
    "law.gate=10,law.jump=0.035,law.rare=5,law.hold=4,law.recall=100,law.reach=1.5,law.smith=0.35,law.lag=5.4,law.trust=50"
)
"""The law without an integral, which alone makes slow sines small."""


def gains_of(stack):
    known = stack.parameters()
    return {name: known[f"law.{name}"].value for name in ("kp", "ki", "kd", "lag")}


@pytest.mark.parametrize("latency", [0.0, 0.0007])
def test_ms_of_the_pid_is_that_of_a_frequency_response_on_a_weak_machine(latency):
    """25 Hz and 4 ms, without friction: what is shown against the transfer functions of law, hold, dead time, drive."""
    stack = resolve(STIFF)
    axis = {**PLAIN, "bandwidth": 25.0, "dead_time": 0.004 - latency, "latency": latency}
    machine = of(Scenario(name="weak", axis=axis))
    hertz = np.geomspace(1.0, 200.0, 2000)
    law = pid(hertz, **gains_of(stack))
    peaks = [closed(law, (25.0, zeta, f), hertz, 0.004).max() for zeta in (0.6, 1.0) for f in (60.0, 150.0)]
    measured = sensitivity(stack, machine=machine)
    assert measured.peak == pytest.approx(max(peaks), rel=0.05)
    assert measured.magnitude.shape[0] == 4  # damping and resonance are drawn, bandwidth and dead time are not
    assert sensitivity(stack).peak < 0.5 * measured.peak  # on the standard machine


def balanced(hertz, zeta, resonance, gains, drag_at, speed=8.0):
    """|S| by harmonic balance on a drive of 25 Hz and 4 ms; the images of the sampled spectrum feel no friction.

    ``drag_at(speed, f)`` is the fundamental of the friction over that of a sinusoidal speed, 1/s. From frequency to
    frequency the balance goes on from the last solution, as there may be two.
    """
    out, w = [], 2 * np.pi * 25.0
    for f in hertz:
        at, s = np.array([f]), 2j * np.pi * f
        law, hold = pid(at, **gains), (1 - np.exp(-s * T)) / s / T
        for _ in range(100):
            drag = drag_at(speed, f)
            drive = w**2 / (s**2 + (2 * zeta * w + drag) * s + w**2)
            plant = (25.0, zeta + drag / (2 * w), resonance)
            command = law * np.exp(-s * CENTRE) / (1 + law * sampled(at, 0.004 + CENTRE, plant, 20))
            change = AMPLITUDE * float(np.abs(command * hold * drive)[0]) - speed
            speed += 0.25 * change
        assert abs(change) < 1e-3 * speed  # it has settled
        out.append(np.abs(sampled(at, 0.004, plant, 20) * command - 1)[0])
    return np.array(out)


def viscous(speed, _, friction=800.0, creep=1.0):
    """Of a friction that grows up to 1 mm/s and then stays: its describing function."""
    ratio = min(1.0, creep / speed)
    return 2 * friction / creep / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1 - ratio**2))


def test_ms_of_the_pid_with_friction_is_that_of_a_harmonic_balance():
    stack = resolve(STIFF)
    machine = of(Scenario(name="weak", axis={**PLAIN, "bandwidth": 25.0, "dead_time": 0.004, "friction": 800.0}))
    hertz = np.arange(7.5, 10.5, 0.1)
    peaks = [balanced(hertz, zeta, 60.0, gains_of(stack), viscous).max() for zeta in (0.6, 1.0)]
    assert sensitivity(stack, machine=machine).peak == pytest.approx(max(peaks), rel=0.05)


def bristles(speed, hertz, friction=300.0, bristle=0.005, stiction=1.3, stribeck=3.0, steps=400):
    """Of LuGre's friction, by integrating the bristles."""
    dt, bent, out = 1.0 / (hertz * steps), 0.0, 0.0
    for n in range(3 * steps):
        v = speed * np.cos(2 * np.pi * (n + 0.5) / steps)
        most = friction * (1.0 + (stiction - 1.0) / (1.0 + (v / stribeck) ** 2))
        stiffness = friction / bristle
        bent = (bent + v * dt) / (1.0 + abs(v) * dt * stiffness / most)
        if n >= 2 * steps:
            out += 2.0 / steps * stiffness * bent * np.exp(-2j * np.pi * (n + 1.0) / steps)
    return out / speed


def test_ms_of_the_pid_with_bristles_is_that_of_a_harmonic_balance():
    stack = resolve(STIFF)
    # With more friction its harmonics count, which this balance leaves out.
    rubs = {"friction": 300.0, "bristle": 0.005, "stiction": 1.3, "stribeck": 3.0}
    machine = of(Scenario(name="weak", axis={**PLAIN, "bandwidth": 25.0, "dead_time": 0.004, **rubs}))
    peak = balanced(np.arange(8.5, 10.0, 0.1), 1.0, 60.0, gains_of(stack), bristles).max()
    assert sensitivity(stack, machine=machine).peak == pytest.approx(peak, rel=0.05)


def test_a_narrow_peak_between_two_frequencies_is_found():
    stack = resolve(STIFF)
    machine = of(Scenario(name="weak", axis={**PLAIN, "bandwidth": 25.0, "dead_time": 0.004, "friction": 800.0}))
    coarse = Injection(stack, machine=machine).measure(stack)
    found = sensitivity(stack, machine=machine)
    assert found.peak > 1.05 * coarse.peak
    assert len(found.frequencies) > len(FREQUENCIES)
    assert np.all(np.diff(found.frequencies) > 0)
    assert set(FREQUENCIES) <= set(found.frequencies)


# --------------------------------------------------------------------------------------------------------- with noise


@pytest.mark.parametrize("spec", ["xi2023-improved:filter.kind=none,law.kv=60", "xi2023-ma:filter.window=5,law.kv=50"])
def test_noise_and_sines_agree_on_a_linear_loop(spec):
    p = resolve(spec)
    noise = ideal(Noise(p, machine=MACHINE)).measure(p)
    assert noise.magnitude.shape == (16, 200)
    tones = LINES[2:180:8]
    sines = ideal(Injection(p, tones, machine=MACHINE)).measure(p)
    assert noise.magnitude[:, 2:180:8] == pytest.approx(sines.magnitude, rel=0.02, abs=0.002)
    assert np.all(noise.high - noise.low < 0.02)  # a linear loop leaves little to chance
    assert noise.peak == pytest.approx(ideal(Injection(p, machine=MACHINE)).measure(p).peak, rel=0.03)


def test_noise_is_the_motion_that_is_said():
    idle = get("idle")
    bench = Noise(idle)
    found = bench.measure(idle)
    assert found.magnitude == pytest.approx(1.0, rel=1e-3)  # nobody follows
    height = bench.course
    assert np.sqrt(np.mean(height**2, axis=0)) == pytest.approx(0.020, rel=1e-6)
    spectrum = np.abs(np.fft.rfft(height[:, 0]))
    assert spectrum[100] / spectrum[20] == pytest.approx(0.2, rel=1e-3)
    assert spectrum[201:].max() < 1e-6 * spectrum[20]


def test_of_a_controller_that_learns_noise_says_more_than_a_sine():
    """It predicts a sine, and makes it smaller; among others the same frequency becomes larger."""
    fixed, learns = get("observer"), resolve(LEARNS)
    grid = np.array([20.0, 26.0, 34.0])
    noise = [np.interp(grid, f.frequencies, f.worst) for f in (broadband(learns), broadband(fixed))]
    sine = [Injection(s, grid).measure(s).worst for s in (learns, fixed)]
    assert np.all(sine[0] < 0.9)
    assert np.all(noise[0] > 1.0)
    assert sine[1] == pytest.approx(noise[1], rel=0.15)


def test_the_interval_of_noise_holds_what_other_draws_give():
    pid_ = get("pid")
    found = Noise(pid_).measure(pid_)
    other = Noise(pid_, draws=48).measure(pid_)
    inside = (found.low <= other.magnitude) & (other.magnitude <= found.high)
    assert 0.8 < inside.mean() <= 1.0


def test_a_loop_that_collides_under_noise_has_no_finite_peak():
    wild = resolve("xi2023-improved:filter.kind=none,law.kv=400")
    assert broadband(wild).peak > 10.0


# ------------------------------------------------------------------------------------------------------- the standard


def test_the_injection_is_the_one_of_the_suite():
    assert AMPLITUDE == 0.020
    assert len(FREQUENCIES) == 40
    assert (FREQUENCIES[0], FREQUENCIES[-1]) == pytest.approx((1.0, 200.0))
    low, high = (np.min(STANDARD.drawn["axis.bandwidth"]), np.max(STANDARD.drawn["axis.bandwidth"]))
    assert (low, high) == (50.0, 120.0)
    assert STANDARD.drawn["axis.dead_time"] == (0.001, 0.002)
    assert STANDARD.drawn["axis.resonance"] == (60.0, 150.0)


def test_an_injection_used_again_gives_what_a_new_one_gives():
    frequencies = np.array([3.0, 30.0, 90.0])
    first, second = resolve("xi2023-ma:filter.window=40"), get("xi2023-improved")
    used = Injection(first, frequencies, settle=0.2, window=0.5)
    used.measure(first)
    new = Injection(second, frequencies, settle=0.2, window=0.5, threads=2)
    assert np.array_equal(used.measure(second).magnitude, new.measure(second).magnitude)


@pytest.mark.parametrize("name", NAMES)
def test_a_tuned_controllers_peak_is_the_one_it_claims_and_below_the_cap(name):
    stack = get(name)
    if stack.provenance["suite"] != f"following-{rules('following')['version']}":
        pytest.skip(f"{name} was tuned on {stack.provenance['suite']}, with other machines")
    measured = sensitivity(stack)
    assert measured.peak <= NAMES[name].limits.ms
    assert measured.peak == pytest.approx(stack.provenance["ms"], abs=2e-3)


def test_what_an_injection_costs_is_counted():
    stack = get("pid")
    steps = round((stability.SETTLE + stability.WINDOW) / PERIOD)
    assert Injection(stack).measure(stack).steps == STANDARD.size * len(FREQUENCIES) * steps
