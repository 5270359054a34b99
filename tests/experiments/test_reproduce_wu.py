"""Wu's studies: their instruments against closed forms and python-control, and what they conclude."""

import control
import numpy as np
import pytest

from kerfgym.baselines import wu as law
from kerfgym.envs.plant import xy_axes
from kerfgym.experiments.measure import axes
from kerfgym.experiments.reproduce import wu
from kerfgym.experiments.reproduce.claims import Trial

TRIAL = Trial(seeds=6)


def verdicts(findings):
    return {row.claim: row.verdict for row in findings.rows}


def test_the_frequency_response_is_python_controls():
    p, kp, hertz = xy_axes.Params(), 0.54, np.array([0.5, 3.0, 8.0, 20.0])
    k = kp * 0.2 * p.gain
    drive = control.tf([k / 4e-3], np.polymul(np.polymul([p.t1, 1], [p.t2, 1]), [1, 0]))
    closed = control.feedback(control.c2d(control.ss(drive), 4e-3, "zoh"), 1)
    expected = np.array([closed(np.exp(2j * np.pi * f * 4e-3)) for f in hertz])
    assert np.allclose(wu.frequency_response(p, kp, hertz), expected, rtol=1e-9)
    b = wu.bandwidth(p, kp)
    assert abs(closed(np.exp(2j * np.pi * b * 4e-3))) == pytest.approx(np.sqrt(0.5), abs=2e-3)


def test_the_limit_seen_in_time_is_that_of_the_poles():
    for literal, expected in ((True, 4.5), (False, 3.04)):
        assert wu.limit_in_time(xy_axes.Params(literal=literal)) == pytest.approx(expected, rel=5e-3)


def test_harmonics_are_found():
    angle = np.linspace(-np.pi, np.pi, 500, endpoint=False)
    found = wu.harmonics(angle, 0.4 - 0.3 * np.cos(2 * angle + 1.0) + 0.1 * np.sin(3 * angle))
    assert np.allclose(found, [0.4, 0.0, 0.3, 0.1, 0.0], atol=1e-12)


def test_a_journey_is_travelled_from_its_first_point_on():
    way = axes.circle(20.0, axes.from_rest(10.0, 200, 400), -1.0)
    seen = axes.travelled([(way, xy_axes.Params(), law.Params(kp=0.5))], ["x.position", "y.position"])
    assert seen["x.position"].shape == (380, 1)
    assert seen["x.position"][0, 0] == pytest.approx(20.0, abs=1e-3)
    assert seen["y.position"][-1, 0] < -0.5  # clockwise


def test_a_lag_of_v_k_is_not_reproducible_and_one_of_v_over_k_is():
    found = verdicts(wu.lag(TRIAL))
    assert [v for claim, v in found.items() if "v·K" in claim] == ["not reproducible as printed"]
    assert {v for claim, v in found.items() if "v·K" not in claim} == {"reproduced"}


def test_the_sum_in_b_is_a_misprint_and_everything_else_of_the_z_domain_holds():
    found = verdicts(wu.z_domain(TRIAL))
    assert found.pop("B of the open loop: … − C − D") == "not reproducible as printed"
    assert found.pop("B with their product, … − C·D, our correction") == "present"
    assert set(found.values()) == {"reproduced"}


def test_rates_and_recursion_hold():
    found = verdicts(wu.rates(TRIAL))
    assert [claim for claim, v in found.items() if v == "input"] == ["position servo every", "interpolation every"]
    assert sum(v == "reproduced" for v in found.values()) == 2


def test_an_8_bit_converter_leaves_half_a_step_and_a_16_bit_one_less_than_two_counts():
    p, b = xy_axes.Params(), wu.PRESETS["b"]
    coarse, fine = wu.approached([(b._replace(dac=wu.RAPID / 128), axes.gain(30.0, b)), (p, axes.gain(30.0, p))])
    half = 0.5 * wu.RAPID / 128 / (30.0 / b.gain)  # error at which the command rounds to 0, mm
    assert 0.01 < np.abs(coarse).max() < half + 1e-3
    assert np.ptp(coarse, axis=(0, 1)).max() / 2 > 0.01  # worse than Wu's repeatability
    assert np.abs(fine).max() < 1.5e-3


def test_a_drive_that_is_weak_one_way_distorts_one_half():
    drawn = wu.distorted(60.0, 30.0, [(1.0, {}, {}), *((s, d, {}) for s, d, _ in wu.CASES.values())])
    level = drawn[0][1].mean()
    for (sense, _, _), (angle, error) in zip((wu.CASES["a"], wu.CASES["c"]), (drawn[1], drawn[3]), strict=True):
        weak = sense * np.sin(angle) > 0.3
        strong = sense * np.sin(angle) < -0.3
        assert np.abs(error[weak] - level).max() > 0.02
        assert np.abs(error[strong] - level).max() < 1e-3


def test_a_drive_with_8_bits_crawls_within_a_step_of_its_converter_and_a_smooth_one_within_counts():
    # The loop rests while its command rounds to 0, so the slide is off by up to half a step over Kv on either side.
    step = 1e3 * wu.RAPID / 2**7 / 30.0  # µm
    coarse, fine = wu.out_of_round(0.2, (8, 16))
    assert 0.5 * step < coarse < 1.05 * step
    assert fine < 1.5  # µm, the encoder's counts


def test_the_steps_of_a_drive_cost_most_at_low_speed():
    coarse, smooth = np.array([wu.out_of_round(v, (8, 0)) for v in (0.2, 8.0)]).T
    assert coarse[0] > 3 * coarse[1]
    assert (smooth < 1.0).all()
    assert set(verdicts(wu.low_speed(TRIAL)).values()) == {"trend only"}


def test_a_drive_without_steps_is_not_said_to_be_limited_at_low_speed(monkeypatch):
    monkeypatch.setattr(wu, "out_of_round", lambda speed, bits: np.full(len(bits), 0.5))
    assert set(verdicts(wu.low_speed(TRIAL)).values()) == {"does not hold here"}
