"""S-curves against the textbook's formulas and numerical integration."""

import numpy as np
import pytest

from kerfgym.envs.paths import scurve


def textbook(way, v, a, j):
    """Time from rest to rest with seven segments, all four cases."""
    if v * j >= a * a:  # the acceleration reaches a if the speed may
        if way >= v * v / a + v * a / j:
            return way / v + v / a + a / j
        if way >= 2 * a**3 / j**2:
            return a / j + np.sqrt(a * a / j**2 + 4 * way / a)
    elif way >= 2 * v * np.sqrt(v / j):
        return way / v + 2 * np.sqrt(v / j)
    return np.cbrt(32 * way / j)


def move(way, v, a, j):
    """From rest to rest, as fast as the limits allow."""
    zero, one = np.zeros(1), np.ones(1)
    top = scurve.peak(zero, zero, v * one, way * one, a * one, j * one)
    return scurve.blocks(zero, zero, top, way * one, a * one, j * one)


CASES = [
    (100.0, 100.0, 1e3, 2e4),  # all seven
    (12.0, 100.0, 1e3, 2e4),  # the speed is not reached
    (1.0, 100.0, 1e3, 2e4),  # the acceleration neither
    (100.0, 10.0, 1e3, 2e4),  # the speed is, the acceleration is not
    (0.01, 10.0, 1e3, 2e4),
]


@pytest.mark.parametrize(("way", "v", "a", "j"), CASES)
def test_a_straight_move_takes_the_textbooks_time(way, v, a, j):
    motion = move(way, v, a, j)
    assert motion.duration == pytest.approx(textbook(way, v, a, j), rel=1e-9)


def test_without_a_limit_of_jerk_it_is_a_trapezoid():
    assert move(100.0, 50.0, 1e3, 1e12).duration == pytest.approx(100 / 50 + 50 / 1e3, rel=1e-6)
    assert move(1.0, 50.0, 1e3, 1e12).duration == pytest.approx(2 * np.sqrt(1 / 1e3), rel=1e-5)


@pytest.mark.parametrize(("way", "v", "a", "j"), CASES)
def test_the_jerk_integrates_to_acceleration_speed_and_distance(way, v, a, j):
    motion = move(way, v, a, j)
    t = np.linspace(0, motion.duration, 200001)
    s, speed, acceleration, jerk = motion.at(t)
    dt = t[1]
    np.testing.assert_allclose(np.cumsum(jerk)[:-1] * dt, acceleration[1:], atol=3 * j * dt)
    np.testing.assert_allclose(np.cumsum(acceleration)[:-1] * dt, speed[1:], atol=3 * a * dt)
    np.testing.assert_allclose(np.cumsum(speed)[:-1] * dt, s[1:], atol=3 * v * dt)
    assert s[-1] == way
    assert speed[-1] == 0.0
    assert speed.max() <= v * (1 + 1e-9)
    assert np.abs(acceleration).max() <= a * (1 + 1e-9)
    assert np.abs(jerk).max() <= j


@pytest.mark.parametrize("v0", [0.0, 1e-12, 5.0, 80.0])
@pytest.mark.parametrize("v1", [80.001, 90.0, 300.0])
def test_reachable_is_the_inverse_of_the_way(v0, v1):
    way = float(scurve.ramp_way(np.array(v0), np.array(v1), 1e3, 2e4))
    assert scurve.reachable(v0, way, 1e3, 2e4) == pytest.approx(v1, rel=1e-9)


def test_blocks_join_without_a_jump():
    v0, v1 = np.array([0.0, 20.0, 60.0]), np.array([20.0, 60.0, 0.0])
    ways, a, j = np.array([20.0, 30.0, 25.0]), np.array([1e3, 500.0, 1e3]), np.array([2e4, 1e4, 2e4])
    top = scurve.peak(v0, v1, np.array([70.0, 100.0, 80.0]), ways, a, j)
    motion = scurve.blocks(v0, v1, top, ways, a, j)
    t = np.linspace(0, motion.duration, 100001)
    s, speed, acceleration, _ = motion.at(t)
    assert (np.diff(s) >= 0).all()
    assert np.abs(np.diff(speed)).max() < 1.01 * 1e3 * t[1]
    assert np.abs(np.diff(acceleration)).max() < 1.01 * 2e4 * t[1]
    np.testing.assert_allclose(np.interp([20.0, 50.0], s, speed), [20.0, 60.0], atol=0.01)
    assert speed.max() == pytest.approx(top.max(), rel=1e-6)


def test_steady_motion_has_its_speed_from_the_first_moment():
    motion = scurve.steps(np.array([10.0]), np.array([5.0]))
    s, v, _, _ = motion.at(np.array([0.0, 1.0, 1.999, 2.0]))
    np.testing.assert_allclose(s, [0, 5, 9.995, 10])
    assert v.tolist() == [5, 5, 5, 0]
