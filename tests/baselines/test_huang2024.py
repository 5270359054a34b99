"""Huang2024's adjusting unit: each rule by hand, and the preset's record."""

import numpy as np
import pytest

from kerfgym.baselines import huang2024
from kerfgym.envs.control.stack import get, team
from kerfgym.envs.figures import job_metrics
from kerfgym.envs.plant import spot
from kerfgym.envs.plant.controller import ProcessSensed
from kerfgym.envs.scenarios import SPLITS, load
from kerfgym.experiments.results import jobs

PLAN = huang2024.Params(restore=0.0)
STEADY = ProcessSensed(
    planned=16.0,
    planned_50=16.0,
    planned_100=16.0,
    planned_200=16.0,
    speed=16.0,
    feed=16.0,
    height=1.0,
    set_height=1.0,
    phase=4.0,
)


def after(p, signals, decisions=400):
    """The command after so many decisions on the same signals."""
    state, command = huang2024.init(p), None
    for _ in range(decisions):
        state, command = huang2024.control(p, state, signals, ())
    return command


def test_a_cut_that_goes_as_planned_is_left_alone():
    c = after(PLAN, STEADY)
    assert c == pytest.approx((1.0, 1.0, 2000.0, 0.3, 0.3, 1.0, 0.0, 0.0), rel=1e-6)


def test_the_dither_is_an_ellipse_along_the_path_as_far_as_two_axes_can_make_one():
    p, half = PLAN._replace(narrow=0.5), np.sqrt(0.5)
    for angle in (0.0, 30.0, 90.0, 135.0, 180.0):
        tx, ty = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        c = after(p, STEADY._replace(tangent_x=tx, tangent_y=ty), 3)
        optics = spot.Params()
        wide = spot.realised(optics, spot.Command(c.frequency, c.x, c.y, c.z, c.focus), 0.0)
        along, across, _ = spot.spread(optics, wide, tx, ty)
        if angle % 90.0 == 0.0:
            assert along == pytest.approx(0.3 * spot.response(2000.0, optics.galvo, optics.galvo_zeta))
            assert across == pytest.approx(0.5 * along)
        # The mean square of the spot's way is the ellipse's in any direction.
        assert c.x**2 + c.y**2 == pytest.approx(0.3**2 * 1.25)
        if angle % 90.0 == 45.0:
            assert (tx, c.x) == pytest.approx((-half, c.y))


def test_between_the_axes_where_the_dither_cannot_be_narrow_the_feed_falls():
    p = PLAN._replace(override=1.4, diagonal=0.25)
    found = [
        after(p, STEADY._replace(tangent_x=np.cos(a), tangent_y=np.sin(a))).override
        for a in np.radians([0.0, 22.5, 45.0, 90.0])
    ]
    assert found == pytest.approx([1.4, 1.4 * (1.0 - 0.25 / 2), 1.4 * 0.75, 1.4])


def test_nothing_is_adjusted_outside_the_cut():
    wild = STEADY._replace(contour_error=1.0, speed=0.0, height=3.0)
    for phase in (0.0, 1.0, 2.0, 5.0):
        assert after(PLAN, wild._replace(phase=phase)).override == 1.0
        assert after(PLAN, wild._replace(phase=phase)).power == 1.0


@pytest.mark.parametrize("sign", [1, -1])
def test_the_feed_falls_with_the_contour_error_beyond_its_tolerance(sign):
    p = PLAN._replace(tolerance=0.02, slow=0.2, least=0.3)
    overrides = [after(p, STEADY._replace(contour_error=sign * e)).override for e in (0.01, 0.02, 0.04, 0.06, 1.0)]
    assert overrides == pytest.approx([1.0, 1.0, 0.8, 0.6, 0.3])


def test_the_feed_falls_before_a_corner_at_once_and_comes_back_at_its_rate():
    p = PLAN._replace(corner=0.4, recover=5.0)
    state, c = huang2024.control(p, huang2024.init(p), STEADY._replace(planned_100=4.0), ())
    assert c.override == pytest.approx(1.0 - 0.4 * 0.75)
    _, c = huang2024.control(p, state, STEADY, ())
    assert c.override == pytest.approx(0.7 + 5.0 * 8e-3)


def test_power_and_dither_follow_the_speed_with_their_exponents_and_bounds():
    p = PLAN._replace(match=0.5, least_power=0.4, overlap=1.0, least_frequency=0.3, amplitude=0.25)
    c = after(p, STEADY._replace(speed=4.0))  # a quarter
    assert c.power == pytest.approx(0.5, rel=1e-5)
    assert c.frequency == pytest.approx(600.0, rel=1e-5)  # the bound: 0.3 × 2 kHz
    assert c.x == pytest.approx(0.3 * 0.25**0.25, rel=1e-5)
    assert after(p, STEADY._replace(speed=0.1)).power == pytest.approx(0.4)
    # Line energy P/v and overlap f/v as planned, if the exponents are 1.
    c = after(PLAN._replace(match=1.0, least_power=0.05, overlap=1.0), STEADY._replace(speed=12.0))
    assert (c.power / 0.75, c.frequency / 0.75) == pytest.approx((1.0, 2000.0), rel=1e-5)


def test_focus_and_standoff_counter_the_height_error():
    high = STEADY._replace(height=1.05)
    assert after(PLAN._replace(refocus=1.0), high).focus == pytest.approx(-0.05, rel=1e-4)
    assert after(PLAN._replace(restore=1.0), high, 10).standoff < 0.0
    assert after(PLAN._replace(restore=5.0), high, 5000).standoff == pytest.approx(-huang2024.LARGEST_TRIM)


def test_the_preset_was_found_on_tune_seeds_and_keeps_the_planned_settings():
    plain, found = get("huang2024-dynamic"), get("huang2024-adjusting")
    shared = set(plain.part("law")._fields)
    assert {n: getattr(found.part("law"), n) for n in shared} == plain.part("law")._asdict()
    assert found.part("plan") == plain.part("plan")
    first, last = (int(seed) for seed in found.provenance["tune_seeds"].split("-"))
    assert first in SPLITS["tune"]
    assert last in SPLITS["tune"]
    assert found.provenance["relative"]["time"] <= 1.021


def test_the_tuned_preset_stays_within_the_published_settings_and_its_record_says_what_is_left():
    found = get("huang2024-tuned")
    fleet, job, _ = jobs.roll(load("cut-corners"), team("huang2024-tuned"), [0, 1])
    seen = job_metrics.evidence(job_metrics.Jobs.of(fleet, job))
    assert seen["extrapolated"].tolist() == [0.0, 0.0]
    assert found.part("law").power == 1.0
    assert found.provenance["trials"] == 400
    assert found.provenance["evidence"] == "within the calibrated settings"
    largest = max(found.provenance["relative"][name] for name in ("cutting_time", "dross", "roughness"))
    assert 0.9 < largest <= 1.001  # the plain method is one of its candidates
