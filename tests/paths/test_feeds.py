"""Programmed feeds: a job is cut at the feed of each line, and nothing is added to what is programmed."""

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths import feeds, kerf, parts
from kerfgym.envs.paths.gcode import read_gcode
from kerfgym.envs.paths.job import CUT, LEAD_IN, Settings, plan
from kerfgym.envs.paths.profile import stretches

SETTINGS = Settings(feed=30.0, pierce=(), clearance=0.0)


@pytest.fixture
def drawing(tmp_path):
    """Reads the cuts of these lines."""

    def read(*lines):
        (tmp_path / "part.ngc").write_text("\n".join(["G21 G90", "M3", *lines]))
        return read_gcode(tmp_path / "part.ngc")

    return read


def speeds(job):
    """mm/s of what is cut, by x, in the middle of each 10 mm."""
    cut = job.phase == CUT
    return [float(np.median(job.feed[cut & (abs(job.x - x) < 1.0)])) for x in (25, 75, 125)]


def test_each_line_is_cut_at_its_own_feed(drawing):
    found = drawing("F600", "G1 X50", "G1 X100 F1200", "G1 X150 F300")
    assert speeds(plan(found, SETTINGS)) == pytest.approx([10, 20, 5], rel=1e-3)
    assert speeds(plan(found, Settings(feed=30.0, pierce=(), corners=False))) == pytest.approx([10, 20, 5], rel=1e-3)


def test_a_feed_is_not_exceeded_anywhere_on_its_line(drawing):
    job = plan(drawing("F600", "G1 X50", "G1 X100 F1200", "G1 X150 F300"), SETTINGS)
    cut = job.phase == CUT
    for low, high, most in ((0, 50, 10), (50, 100, 20), (100, 150, 5)):
        assert job.feed[cut & (job.x > low + 0.05) & (job.x < high - 0.05)].max() <= most * (1 + 1e-6)


def test_an_open_feed_is_that_of_the_scenario_and_one_beyond_the_machine_is_its_fastest(drawing):
    found = drawing("F#<_hal[x]>", "G1 X50", "G1 X100 F60000", "G1 X150 F1200")
    assert speeds(plan(found, SETTINGS)) == pytest.approx([30, SETTINGS.speed, 20], rel=0.02)


def test_a_programme_has_no_lead_in_and_its_path_is_the_programme(drawing):
    square = ["F1200", "G1 X50", "Y50", "X0", "Y0"]
    programmed = plan(drawing(*square), SETTINGS)
    assert not (programmed.phase == LEAD_IN).any()
    assert programmed.cut_length == pytest.approx(200, abs=0.05)
    assert (programmed.x.min(), programmed.y.min()) == pytest.approx((0, 0), abs=1e-9)
    assert (plan(parts.part("square"), SETTINGS).phase == LEAD_IN).any()


def test_arcs_are_cut_at_the_programmed_feed(drawing):
    job = plan(drawing("G0 X50", "F900", "G3 I-50"), SETTINGS)
    assert np.median(job.feed[job.phase == CUT]) == pytest.approx(15, rel=1e-3)
    assert job.feed[job.phase == CUT].max() <= 15 * (1 + 1e-4)


def test_the_feed_of_a_span_is_the_least_of_the_segments_it_touches():
    points = np.array([[0.0, 0], [10, 0], [20, 0], [20, 10]])
    legs = np.array([5.0, 9.0, 7.0])
    corners = feeds.breaks(points, np.array([2]), legs)
    assert corners.tolist() == [1, 2]
    assert feeds.breaks(points, np.array([2]), None).tolist() == [2]
    (curve,) = stretches(points, corners)
    assert feeds.of_spans(curve, legs).tolist() == [5, 9, 7]
    (smooth,) = stretches(points, np.array([2]))
    assert set(feeds.of_spans(smooth, legs)) <= {5.0, 9.0, 7.0}
    assert feeds.of_spans(smooth, legs)[0] == 5
    with pytest.raises(ValueError, match="2 feeds for 3 segments"):
        feeds.of_spans(curve, legs[:2])


def test_a_feed_that_takes_hours_is_refused(drawing):
    with pytest.raises(
        InvalidInput, match=r"a job of at least 30000000 s \(1 cuts, 0\.1 m\) is out of range; allowed: 5400 s"
    ):
        plan(drawing("F0.0001", "G1 X50"), SETTINGS)


def test_the_kerf_of_a_programme_is_not_compensated(drawing):
    with pytest.raises(InvalidInput, match="is a programme and is cut as programmed; allowed: 0"):
        kerf.compensated(drawing("F900", "G1 X50", "Y50", "X0", "Y0"), 0.3)
