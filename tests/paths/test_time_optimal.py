"""Is a planned motion the fastest that its limits allow? Against linear programs and search over corner speeds.

A linear program asks whether any jerk within its limit, constant over each of many equal steps of time, covers the way
in a given time without breaking a limit; bisection finds the shortest time. That allows a little less than the limits
do, so the answer lies above the best by what the steps lose, and no correct plan is faster than the best.
"""

import itertools

import numpy as np
import pytest
from scipy.optimize import brentq, linprog

from kerfgym.envs.paths import profile, scurve
from kerfgym.envs.paths.profile import Limits, stretches

STEPS = 48


def possible(time, way, v0, v1, speed, acceleration, jerk):
    """Whether a motion from ``v0`` to ``v1``, without acceleration at both ends, covers ``way`` in ``time``."""
    dt = time / STEPS
    k, i = np.arange(1, STEPS + 1)[:, None], np.arange(STEPS)[None, :]
    n = np.maximum(k - i, 0)  # steps since the jerk i began
    a = dt * (n > 0)
    v = dt**2 * np.where(n > 0, n - 0.5, 0.0)
    s = dt**3 * np.where(n > 0, n**2 / 2 - n / 2 + 1 / 6, 0.0)
    middle = dt**2 * np.where(n > 0, np.where(n == 1, 1 / 8, n - 1.0), 0.0)  # half a step earlier
    speeds = np.full(STEPS, speed - v0), np.full(STEPS, v0)
    unlimited = linprog(
        np.zeros(STEPS),
        A_ub=np.vstack([a, -a, v, -v, middle, -middle]),
        b_ub=np.concatenate([np.full(2 * STEPS, acceleration), *speeds, *speeds]),
        A_eq=np.vstack([a[-1], v[-1], s[-1]]),
        b_eq=[0.0, v1 - v0, way - v0 * time],
        bounds=[(-jerk, jerk)] * STEPS,
    )
    return unlimited.status == 0


def shortest(guess, *motion):
    """s, to 0.1 %, of the fastest motion that :func:`possible` finds."""
    low, high = 0.8 * guess, 1.2 * guess
    assert possible(high, *motion)
    while high - low > 1e-3 * guess:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if possible(middle, *motion) else (middle, high)
    return high


@pytest.mark.parametrize(
    ("way", "v0", "v1", "speed"),
    [
        (12.0, 0.0, 0.0, 100.0),
        (1.0, 0.0, 0.0, 100.0),
        (30.0, 0.0, 0.0, 60.0),
        (2.0, 0.0, 0.0, 10.0),
        (10.0, 30.0, 0.0, 80.0),
        (8.0, 10.0, 50.0, 70.0),
        (20.0, 60.0, 20.0, 60.0),
        (15.0, 20.0, 25.0, 200.0),
    ],
)
def test_no_motion_within_the_limits_is_faster_than_the_s_curve(way, v0, v1, speed):
    a, jerk = 1e3, 2e4
    each = [np.array([q]) for q in (v0, v1, speed, way, a, jerk)]
    top = scurve.peak(*each)
    motion = scurve.blocks(each[0], each[1], top, each[3], each[4], each[5])
    best = shortest(motion.duration, way, v0, v1, speed, a, jerk)
    assert motion.duration == pytest.approx(best, rel=0.012)
    s, v, along, _ = motion.at(np.linspace(0.0, motion.duration, 5001)[:-1])
    assert s[-1] == pytest.approx(way, rel=1e-3)
    assert (v[0], v[-1]) == pytest.approx((v0, v1), abs=0.05)
    assert v.max() <= speed * (1 + 1e-9)
    assert np.abs(along).max() <= a * (1 + 1e-9)
    assert np.abs(np.diff(along)).max() <= jerk * motion.duration / 5000 * (1 + 1e-6)


def ramp(dv, a, jerk):
    """s, of the fastest change of speed: the acceleration's trapezoid of area ``dv``."""
    rise = min(a / jerk, np.sqrt(dv / jerk))
    return 2.0 * rise + max(0.0, dv - jerk * rise**2) / a


def leg(v0, v1, way, limits):
    """s, from ``v0`` to ``v1`` over ``way`` with one top speed; infinite if the way is too short."""

    def time_and_way(top):
        up, down = ramp(top - v0, limits.acceleration, limits.jerk), ramp(top - v1, limits.acceleration, limits.jerk)
        return up + down, 0.5 * (v0 + top) * up + 0.5 * (top + v1) * down

    low = max(v0, v1)
    if time_and_way(low)[1] > way:
        return np.inf
    top = limits.speed
    if time_and_way(top)[1] > way:
        top = brentq(lambda v: time_and_way(v)[1] - way, low, top)
    time, used = time_and_way(top)
    return time + (way - used) / top


@pytest.mark.parametrize("seed", range(4))
def test_no_other_speeds_in_the_corners_are_faster(seed):
    rng, limits = np.random.default_rng(seed), Limits(80.0, 1e3, 2e4, 12.0)
    points = np.cumsum(
        np.vstack([[0.0, 0.0], rng.uniform(-1.0, 1.0, (3, 2)) * rng.choice([2.0, 20.0], (3, 1))]), axis=0
    )
    (path,) = stretches(points, np.array([1, 2]))
    duration = profile.plan(path, limits).duration
    legs = np.diff(points, axis=0)
    ways = np.hypot(*legs.T)
    units = legs / ways[:, None]
    most = [min(limits.speed, limits.jump / np.hypot(*(units[i + 1] - units[i]))) for i in (0, 1)]
    times = [
        leg(0.0, one, ways[0], limits) + leg(one, two, ways[1], limits) + leg(two, 0.0, ways[2], limits)
        for one, two in itertools.product(*(np.linspace(0.02 * v, v, 50) for v in most))
    ]
    assert duration <= min(times) * (1 + 1e-9)
    assert duration == pytest.approx(min(times), rel=0.02)  # what a grid of speeds misses
