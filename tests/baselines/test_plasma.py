"""The plasma style: what locks the height, and for how long."""

import numpy as np
import pytest

from kerfgym.baselines import pid, plasma
from kerfgym.envs.control.stack import resolve
from kerfgym.envs.figures import metrics
from kerfgym.envs.plant.controller import Sensed
from kerfgym.envs.scenarios import load
from kerfgym.experiments.measure.rollout import roll

P = plasma.Params(kp=50.0, ki=1500.0, kd=0.2, lag=4.0, limit=100.0, feed=0.9, slope=50.0, on=2.0, off=30.0)


def lived(heights, feeds=None, captured=True, params=P, law=plasma):
    """Commands over heights (mm) and feeds (mm/s)."""
    state, out = law.init(params), []
    for i, h in enumerate(heights):
        feed = 100.0 if feeds is None else feeds[i]
        x = Sensed(height=h, set_height=0.8, feed=feed, fresh=i == 0, captured=captured)
        state, wish = law.control(params, state, x, ())
        out.append(wish)
    return np.array(out)


def test_without_a_reason_to_lock_it_is_a_pid():
    heights = 0.8 + 0.02 * np.sin(np.arange(300) / 20)
    assert np.array_equal(lived(heights), lived(heights, params=pid.Params(*P[:5]), law=pid))


def test_a_feed_below_its_share_of_the_programmed_one_locks_the_height():
    feeds = np.concatenate([np.full(50, 100.0), np.full(50, 91.0), np.full(50, 89.0), np.full(50, 100.0)])
    wishes = lived(np.full(200, 0.85), feeds)
    assert np.all(wishes[:100] < 0.0)
    assert np.all(wishes[100:150] == 0.0)
    # Afterwards the integral starts from nothing.
    assert wishes[150] == pytest.approx(-(50.0 * 0.05 + 1500.0 * 0.05 * 1e-3))


def test_a_slower_programme_is_believed_when_the_faster_one_has_been_forgotten():
    feeds = np.concatenate([np.full(10, 100.0), np.full(400, 50.0)])
    wishes = lived(np.full(410, 0.85), feeds, params=P._replace(fade=0.2))
    free = np.flatnonzero(wishes[10:] != 0.0)[0]
    assert free == pytest.approx(200 * np.log(100 * 0.9 / 50), abs=2)  # e^(−t/fade)·100·0.9 = 50
    assert np.all(wishes[10 + free :] != 0.0)


def test_a_rise_faster_than_the_slope_locks_from_its_second_period_until_off_is_over():
    rise = np.concatenate([np.full(20, 0.8), 0.8 + 0.06 * np.arange(1, 11), np.full(60, 1.4)])
    wishes = lived(rise)
    assert wishes[20] < 0.0  # the first period of the rise
    assert np.all(wishes[21 : 29 + 30] == 0.0)
    assert np.all(wishes[29 + 30 :] < 0.0)
    slower = np.concatenate([np.full(20, 0.8), 0.8 + 0.049 * np.arange(1, 11), np.full(60, 1.29)])
    assert np.all(lived(slower)[21:] < 0.0)


def test_one_jump_is_no_void_and_neither_is_a_way_down():
    jump = np.concatenate([np.full(20, 0.8), np.full(30, 1.2)])
    assert np.all(lived(jump)[20:] < 0.0)
    assert np.all(lived(0.8 + 0.1 * np.arange(30), captured=False)[1:] < 0.0)


def test_over_holes_the_void_lock_holds_where_the_guard_is_off():
    case = load("holes").varied(guard=False, duration=1.5)
    locked, free = (
        metrics.min_gap(roll(case, resolve(f"plasma-style:law.slope={slope},law.on=2,law.off=30"), range(1000, 1010)))
        for slope in (50, 1000)
    )
    assert np.median(locked) > np.median(free) + 0.1
