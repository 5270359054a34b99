"""Patent2022: the cases, their constants, the planned descent, and what they do to the machine."""

import math

import numpy as np
import pytest

from kerfgym.baselines import patent2022 as law
from kerfgym.envs.control.stack import resolve
from kerfgym.envs.figures import metrics
from kerfgym.envs.plant.controller import PERIOD, Sensed
from kerfgym.envs.scenarios import load
from kerfgym.experiments.measure.rollout import roll

P = law.Params(s=20.0, r=4.0, accuracy=0.01, smallest=0.0, acceleration=5000.0, distance=2.25, fastest=150.0)
OPEN = "guard.capture=2,guard.plan=1,guard.acceleration=50000,guard.fastest=500,guard.delay=0"


def velocity(p, d, last=None, command=0.0):
    """The law's answer to a height difference, and that of the period before."""
    x = Sensed(height=1.0 + d, set_height=1.0, command=command)
    return law.control(p, law.State(d if last is None else last), x._replace(fresh=False), ())[1]


@pytest.mark.parametrize(
    ("d", "last", "factor"), [(-0.3, -0.2, 0.2), (0.3, 0.4, 0.01), (0.009, 0.008, 0.01), (-0.009, -0.004, 0.01)]
)
def test_displacements_are_the_printed_ones_in_all_three_cases(d, last, factor):
    kp = factor * math.sqrt(2 * 5000 * abs(d)) / math.sqrt(2 * 5000 * 2.25)
    displacement = kp * d + kp / 4.0 * last
    assert velocity(P, d, last) == pytest.approx(-displacement / PERIOD, rel=1e-12)


def test_s_acts_on_the_lift_alone_and_in_proportion():
    for d, ratio in ((-0.2, 10.0), (-0.005, 1.0), (0.005, 1.0), (0.2, 1.0)):
        assert velocity(P._replace(s=50.0), d) / velocity(P._replace(s=5.0), d) == pytest.approx(ratio)


def test_r_divides_the_share_of_the_last_difference():
    for r in (0.5, 1.0, 7.0):
        steady, fresh = velocity(P._replace(r=r), 0.2, 0.2), velocity(P._replace(r=r), 0.2, 0.0)
        assert steady / fresh == pytest.approx(1.0 + 1.0 / r)


def test_vs_grows_as_the_root_of_the_distance_until_it_is_as_fast_as_the_axis_may_be():
    for d in (0.01, 0.5, 2.0):
        assert law.allowed(P, -d) == law.allowed(P, d) == pytest.approx(math.sqrt(2 * 5000 * d))
        assert law.allowed(P, d) ** 2 / (2 * P.acceleration) == pytest.approx(d)  # the way it takes to stop
    assert law.allowed(P, 2.25) == law.allowed(P, 9.0) == 150.0


def test_a_longer_deceleration_distance_makes_vm_larger_and_the_loop_slower():
    near, far = P._replace(distance=0.25), P._replace(distance=1.0)
    assert velocity(near, 0.1) / velocity(far, 0.1) == pytest.approx(2.0)


def test_displacements_below_the_smallest_are_none_and_only_in_the_hold():
    p = P._replace(smallest=2e-6)
    edge = brink(lambda d: velocity(p, d) != 0.0, 1e-6, 0.009)
    assert 0.01 * math.sqrt(edge / 2.25) * edge * 1.25 == pytest.approx(p.smallest, rel=1e-6)
    assert velocity(p, -0.9 * edge) == 0.0
    coarse = P._replace(smallest=0.01)
    assert velocity(coarse, 0.0099) == velocity(coarse, -0.0099) == 0.0
    assert velocity(coarse, 0.0101) < 0.0 < velocity(coarse, -0.0101)


def brink(test, low, high):
    """Where a condition begins to hold, by halving."""
    assert test(high)
    assert not test(low)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if test(middle) else (middle, high)
    return high


def test_as_printed_the_gain_is_at_most_20_and_falls_to_0_with_the_root_of_the_error():
    printed = law.Params(r=1.0, accuracy=1e-4, smallest=0.0)
    gains = np.array([-velocity(printed, d) / d for d in np.geomspace(1e-3, 6.9, 60)])
    assert gains.max() == pytest.approx(20.0)
    assert gains[0] == pytest.approx(20.0 * math.sqrt(1e-3 / 2.25))
    assert np.all(np.diff(gains) > -1e-9)


def test_beyond_the_range_the_descent_speeds_up_by_the_acceleration_to_what_the_distance_allows():
    command, speeds = 0.0, []
    for _ in range(100):
        command = velocity(P, 8.5, 8.5, command)
        speeds.append(-command)
    assert speeds == pytest.approx(np.minimum(5.0 * np.arange(1, 101), 150.0))
    slow = P._replace(acceleration=500.0)
    assert -velocity(slow, 8.0, 8.0, command=-140.0) == pytest.approx(math.sqrt(2 * 500 * 8.0))
    assert velocity(P, 6.99, 6.99, command=-150.0) > velocity(P, 7.0, 7.0, command=-150.0)  # h_max 8 mm, set 1 mm


def test_a_descent_enters_the_range_without_overshoot_where_a_pid_hits_the_sheet():
    case, seeds = load("descent").varied(duration=1.5), range(1000, 1012)
    planned, plain = (roll(case, resolve(f"{name}:{OPEN}"), seeds) for name in ("patent2022", "pid"))
    assert planned["gap"][0].max() > law.Params().range + 3.0
    assert metrics.overshoot(planned).max() < 1e-3
    assert not planned.collided.any()
    assert np.abs(planned.error[-1]).max() < 0.02
    assert plain.collided.mean() > 0.5


def test_the_axis_chatters_less_than_under_a_pid():
    case, seeds = load("flat").varied(duration=1.0, head={"impulses": 20}), range(1000, 1010)
    own, pid = (metrics.jitter(roll(case, resolve(name), seeds)) for name in ("patent2022", "pid"))
    assert np.all(own < pid)
    assert np.median(pid) > 3.0 * np.median(own)


def test_a_sensitivity_that_acts_upwards_alone_rectifies_noise():
    case = load("flat").varied(duration=3.0, settle=1.5, head={"impulses": 20, "impulse_samples": 2})
    means = []
    for s in (1.0, 20.0):
        record = roll(case, resolve(f"patent2022:law.s={s}"), range(1000, 1010))
        means.append(1e3 * record.error[record.scored.all(axis=1)].mean())
    assert abs(means[0]) < 2.0 < 4.0 < means[1]
