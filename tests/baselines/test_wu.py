"""Wu's law: gains by direction."""

import numpy as np
import pytest

from kerfgym.baselines import wu
from kerfgym.envs.control.stack import get
from kerfgym.envs.plant import xy_axes
from kerfgym.envs.plant.controller import AxesSensed
from kerfgym.experiments.measure import axes
from kerfgym.experiments.reproduce.wu import distorted, harmonics
from kerfgym.experiments.tune import rules, study_file

DRIVE = {"x_plus": 1.08, "x_minus": 0.95, "y_plus": 1.02, "y_minus": 0.9}
MATCHED = {name: 1 / gain for name, gain in DRIVE.items()}


@pytest.mark.parametrize(("sign_x", "sign_y"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_the_gain_of_the_direction_that_is_asked_for_multiplies_error_and_feed_forward(sign_x, sign_y):
    p = wu.Params(kp=0.5, velocity=0.8, **DRIVE)
    signals = AxesSensed(error_x=0.3 * sign_x, velocity_x=5.0 * sign_x, error_y=0.1 * sign_y, velocity_y=2.0 * sign_y)
    _, v = wu.control(p, wu.init(p), signals, ())
    k = 0.5 * 0.2 / 4e-3
    assert v.x == pytest.approx(sign_x * (k * 0.3 + 0.8 * 5.0) * (1.08 if sign_x > 0 else 0.95))
    assert v.y == pytest.approx(sign_y * (k * 0.1 + 0.8 * 2.0) * (1.02 if sign_y > 0 else 0.9))


def test_matched_gains_restore_the_circle_of_a_drive_with_four_different_ones():
    even, uneven, mended = distorted(60.0, 30.0, [(1.0, {}, {}), (1.0, DRIVE, {}), (1.0, DRIVE, MATCHED)])
    assert np.ptp(uneven[1]) > 0.05
    assert np.ptp(mended[1]) < 1e-5
    assert mended[1].mean() == pytest.approx(even[1].mean(), abs=1e-6)
    assert harmonics(*uneven)[1:].max() > 1e3 * harmonics(*mended)[1:].max()


def test_matched_gains_give_all_directions_the_lag_v_over_kv():
    p = xy_axes.Params(**DRIVE, **axes.IDEAL)
    law, speeds = wu.Params(kp=axes.gain(30.0, p), **MATCHED), axes.from_rest(40.0, 300, 2000)
    ways = [(axes.line(speeds, angle), p, law) for angle in (np.pi / 4, -3 * np.pi / 4)]
    names = ["axes_signals.error_x", "axes_signals.error_y"]
    seen = axes.travelled(ways, names, every=4)
    for name in names:
        assert np.allclose(np.abs(seen[name][-1]), 40.0 / np.sqrt(2) / 30.0, rtol=1e-4)


def test_wu_matched_is_wu_with_the_reciprocals_of_the_mismatch_scenarios_mean():
    plain, matched = get("wu").part("law"), get("wu-matched").part("law")
    assert matched.kp == plain.kp
    assert matched.x_plus * np.mean([1.02, 1.05]) == pytest.approx(1.0, abs=1e-3)
    assert matched.y_minus * np.mean([0.95, 0.98]) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(("share", "grows"), [(0.98, False), (1.02, True)])
def test_the_loop_of_wu_stiff_bears_twice_its_gain_and_no_more(share, grows):
    """A step so small that no limit acts; the limits of speed and acceleration make a large one ring earlier."""
    ideal = xy_axes.Params(dac=0.0, encoder=0.0)
    seen = rules.step_response(share * 2.0 * get("wu-stiff").part("law").kp, ideal, 0.05, 2000)
    early, late = (np.abs(part - 0.05).max() for part in (seen[500:1000], seen[1500:]))
    assert (late > early) == grows


@pytest.mark.parametrize("name", ["wu-tuned", "wu-feedforward", "wu-stiff"])
def test_the_presets_of_the_axes_have_the_gains_that_their_rules_give(name):
    fixed = dict(study_file.read("axes", (name,)).searches[name].set)
    assert get(name).part("law").kp == fixed["law.kp"]


def test_a_step_at_the_largest_gain_overshoots_by_at_most_one_per_cent_and_at_a_larger_one_by_more():
    kp = get("wu-tuned").part("law").kp
    assert rules.step_response(kp).max() <= 1.01
    assert rules.step_response(1.01 * kp).max() > 1.01
