"""Lifts: as fast as the head may, and no faster."""

import numpy as np
import pytest

from kerfgym.envs.paths import job as jobs
from kerfgym.envs.paths import lift, parts

LIMITS = 60.0, 3000.0


@pytest.mark.parametrize("way", [0.01, -0.5, 1.4, 4.0])
def test_a_lift_meets_its_speed_or_its_acceleration_and_exceeds_neither(way):
    seconds = lift.duration(way, *LIMITS)
    count = 200_000
    heights = np.append(0.0, lift.rise(0.0, way, count))
    step = seconds / count
    speed, acceleration = np.abs(np.diff(heights)).max() / step, np.abs(np.diff(heights, 2)).max() / step**2
    assert heights[-1] == pytest.approx(way)
    assert max(speed / LIMITS[0], acceleration / LIMITS[1]) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(
    ("start", "end", "seconds", "roomy"),
    [(0.0, 2.0, 0.08, False), (0.0, 2.0, 0.4, True), (4.0, 2.0, 0.1, False), (0.0, 0.0, 0.03, True)],
)
def test_a_leap_keeps_both_limits_and_the_clearance_and_ends_where_it_should(start, end, seconds, roomy):
    count = 100_000
    heights = np.append(start, lift.leap(start, end, 4.0, seconds, count, LIMITS))
    step = seconds / count
    assert heights[-1] == pytest.approx(end)
    assert heights.max() <= 4.0 + 1e-9
    assert np.abs(np.diff(heights)).max() / step <= LIMITS[0] * (1 + 1e-3)
    assert np.abs(np.diff(heights, 2)).max() / step**2 <= LIMITS[1] * (1 + 1e-3)
    assert (heights.max() > max(start, end)) == roomy


@pytest.mark.parametrize("leap", [True, False])
@pytest.mark.parametrize("name", parts.PARTS)
def test_the_set_height_of_a_whole_job_keeps_both_limits(name, leap):
    job = jobs.plan(parts.part(name), jobs.Settings(frog_leap=leap))
    speed, acceleration = np.diff(job.lift) * 1e3, np.diff(job.lift, 2) * 1e6
    assert np.abs(speed).max() <= job.settings.lift_speed
    assert np.abs(acceleration).max() <= job.settings.lift_acceleration * (1 + 1e-6)
