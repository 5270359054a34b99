"""Feed profiles: limits hold as vectors everywhere, corners and curves cost what closed forms say."""

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths import parts, profile, scurve
from kerfgym.envs.paths.profile import Limits, at_constant_feed, stretches, timed

WU = Limits(8000 / 60, 1e3, 2e4, 8.0)
SLOW = Limits(1000 / 60, 1e3, 2e4, 8.0)
MODERN = Limits(500.0, 15e3, 3e5, 15.0)


def full_stop(limits):
    return Limits(limits.speed, limits.acceleration, limits.jerk, 0.0)


def line(*points):
    """A curve with a corner at every vertex."""
    return stretches(np.array(points, float), np.arange(1, len(points) - 1))


def made(name, **sizes):
    drawing = parts.part(name, **sizes)
    return stretches(drawing.pieces[-1], drawing.corners[-1])


def straight(way, limits):
    zero, one = np.zeros(1), np.ones(1)
    a, j = limits.acceleration * one, limits.jerk * one
    top = scurve.peak(zero, zero, limits.speed * one, way * one, a, j)
    return scurve.blocks(zero, zero, top, way * one, a, j).duration


def planned(path, limits):
    return profile.plan(profile.joined(path), limits)


def derivatives(positions):
    """Largest speed, acceleration and jerk from differences alone, at rest before and after."""
    still = np.concatenate([np.repeat(positions[:1], 4, axis=0), positions, np.repeat(positions[-1:], 4, axis=0)])
    return [np.hypot(*np.diff(still, n=k, axis=0).T).max() * 1e3**k for k in (1, 2, 3)]


@pytest.mark.parametrize("limits", [WU, SLOW, MODERN])
@pytest.mark.parametrize("name", parts.PARTS)
def test_sampled_limits_hold_on_every_part(name, limits):
    path, limits = made(name), full_stop(limits)
    positions, tangents, way = timed(path, limits.speed, limits)
    speed, acceleration, jerk = derivatives(positions)
    assert speed <= 1.001 * limits.speed
    assert acceleration <= 1.05 * limits.acceleration
    assert jerk <= 1.05 * limits.jerk
    assert (np.diff(way) >= 0).all()
    assert way[-1] == pytest.approx(sum(c.length for c in path))
    np.testing.assert_allclose(np.hypot(*tangents.T), 1.0)


def test_limits_bind_so_that_no_time_is_given_away_on_lines():
    path = made("square", side=100.0)
    v, a, j = derivatives(timed(path, WU.speed, full_stop(WU))[0])
    assert v > 0.999 * WU.speed
    assert a > 0.99 * WU.acceleration
    assert j > 0.9 * WU.jerk
    assert planned(path, full_stop(WU)).duration == pytest.approx(4 * straight(100.0, WU), rel=1e-9)


def test_collinear_points_on_a_line_change_nothing():
    points = np.stack([np.sort(np.random.default_rng(0).uniform(0, 100, 50)), np.zeros(50)], axis=1)
    points[[0, -1], 0] = 0, 100
    assert planned(stretches(points), WU).duration == pytest.approx(straight(100.0, WU), rel=1e-6)


@pytest.mark.parametrize("angle", [10.0, 45.0, 90.0, 135.0])
def test_the_velocity_jumps_by_no_more_than_the_corner_jump(angle):
    turned = 100 + 100 * np.cos(np.radians(angle)), 100 * np.sin(np.radians(angle))
    motion = planned(line((0, 0), (100, 0), turned), WU)
    s, v, _, _ = motion.at(np.linspace(0, motion.duration, 200001))
    jump = 2 * np.sin(np.radians(angle) / 2)
    assert v[np.searchsorted(s, 100.0)] * jump == pytest.approx(min(8.0, WU.speed * jump), rel=1e-3)


def test_a_corner_costs_the_time_of_its_ramps():
    v, a, j = WU.speed, WU.acceleration, WU.jerk

    def ramp(dv):
        return dv / a + a / j

    vc = 8.0 / np.sqrt(2)
    ways = v / 2 * ramp(v) + (v + vc) / 2 * ramp(v - vc)
    expected = 2 * (ramp(v) + ramp(v - vc) + (200 - ways) / v)
    assert planned(line((0, 0), (200, 0), (200, 200)), WU).duration == pytest.approx(expected, rel=1e-9)


def test_the_feed_in_a_circle_is_what_its_limits_allow():
    radius, t = 20.0, np.linspace(0, 10, 100001)
    path = made("circle", diameter=2 * radius)
    top = planned(path, Limits(1e3, 2e3, 1e7, 0.0)).at(t)[1].max()
    assert top == pytest.approx(np.sqrt(profile.ACROSS * 2e3 * radius), rel=0.02)
    top = planned(path, Limits(1e3, 1e5, 2e4, 0.0)).at(t)[1].max()
    assert top == pytest.approx(np.cbrt(profile.TWIST[2] * 2e4 * radius**2), rel=0.02)


def test_a_slow_corner_is_prepared_on_many_short_legs():
    """The backward pass reaches over legs that are too short to brake on."""
    legs = np.concatenate([[(x, 0.02 * (-1) ** i) for i, x in enumerate(np.arange(0, 20, 0.5))], [(20, 0), (20, 30)]])
    (path,) = line(*legs)
    motion = profile.plan(path, MODERN)
    s, speed, along, _ = motion.at(np.arange(0, motion.duration, 1e-4))
    corner = path.starts[path.corners[-1]]
    assert np.interp(0.5 * corner, s, speed) > 60
    assert np.interp(corner, s, speed) < 17
    assert np.abs(np.diff(speed)).max() <= 1.01e-4 * MODERN.acceleration
    assert np.abs(along).max() <= 1.0001 * MODERN.acceleration


def test_pieces_one_after_the_other_are_one_path():
    points = np.array([(0, 0), (50, 0), (50, 50), (0, 80)], float)
    whole = timed(line(*points), 60.0, WU)
    split = timed([*line(*points[:2]), *line(*points[1:])], 60.0, WU)
    for a, b in zip(whole, split, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_constant_feed_goes_right_through_corners():
    path = made("corners")
    positions, _, way = at_constant_feed(path, 50.0, WU)
    np.testing.assert_allclose(np.diff(way)[:-1], 0.05)
    assert len(positions) == np.ceil(sum(c.length for c in path) / 0.05) + 1


def test_a_higher_limit_is_never_slower():
    path = made("slot-plate")
    times = [planned(path, Limits(v, 1e3, 2e4, 8.0)).duration for v in (10, 30, 60, 133)]
    assert times == sorted(times, reverse=True)
    times = [planned(path, Limits(133.0, a, j, 8.0)).duration for j, a in ((5e3, 300), (2e4, 1e3), (2e5, 5e3))]
    assert times == sorted(times, reverse=True)


def test_a_feed_above_the_limit_is_refused():
    with pytest.raises(InvalidInput, match=r"feed = 200.*at most 133.333"):
        timed(made("square"), 200.0, WU)


def test_a_gear_is_not_slower_for_a_feed_that_its_flanks_cannot_take():
    path = made("gear")
    times = [planned(path, Limits(v, 1e3, 5e4, 0.0)).duration for v in (15, 30, 60, 120)]
    assert times == sorted(times, reverse=True)
