"""The page of an identification: what it says of good logs, of bad models, and of names that are not meant well."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import candidates
from kerfgym.envs.scenarios import machines
from kerfgym.experiments.identify import check_log, drive, identified_page, identifying, next_protocol, protocols
from kerfgym.experiments.identify.identifying import Identified, Number
from kerfgym.experiments.identify.log import Log

AXIS = {"bandwidth": 60.0, "zeta": 0.7, "speed": 400.0, "acceleration": 12000.0, "jerk": 2e6, "friction": 800.0,
        "bristle": 0.005, "stiction": 1.4, "stribeck": 3.0, "dead_time": 0.00433}  # fmt: skip


def found(like=None, **changes):
    """A drive that is known to a thousandth, on the machine that it is like."""
    rng = np.random.default_rng(0)
    numbers = []
    for key, value in (AXIS | changes).items():
        ends = drive.PRIOR.get(key, (0.0, 0.022))
        numbers.append(
            Number(f"axis.{key}", value * (1 + 1e-3 * rng.normal(size=1000)), ends, key != "stribeck", "motion")
        )
    base = machines.load({"name": "mine", **(like or {})})
    return Identified(identifying._machine(base, "mine", numbers, [], rng), tuple(numbers), None, ("no rest log",))


@pytest.fixture(scope="module")
def moved():
    """Motion of that axis, read by an encoder with counts of 1 µm."""
    rng, made = np.random.default_rng(1), []
    for level in (10.0, 60.0, 20.0):
        made.append(np.repeat(level * rng.uniform(-1, 1, 400), rng.integers(5, 25, 400))[:4000])
    command = np.concatenate(made)
    command -= command.mean()
    axis = drive.axis(np.log([AXIS[key] for key in drive.NAMES]), np.floor(AXIS["dead_time"] * 1e3 * 20))
    course = candidates.courses([axis], command, 30.0)[0, :, 0]
    encoder = 1e-3 * np.round(1e3 * course)
    return Log("motion.csv", "motion", {"time": np.arange(len(command)) * 1e-3, "encoder": encoder, "command": command})


def test_what_speaks_against_a_machine_stands_in_its_summary_which_every_page_shows():
    base, rng = machines.load("standard"), np.random.default_rng(0)
    said = identifying._machine(base, "mine", [], ["motion.csv"], rng, ["the model does not explain its drive"]).summary
    assert said == (
        "identified from motion.csv; like standard where they say nothing; the model does not explain its drive"
    )


def verdict(page):
    return re.search(r"<dt>motion.csv \(motion\): (\w+( \w+)?)</dt><dd>(.*?)</dd>", page, re.S).group(1, 3)


def test_a_good_log_is_explained_and_what_was_not_excited_is_said(moved):
    page = identified_page.page(found(), [moved], foresee=False)
    word, why = verdict(page)
    assert word == "yes", why
    assert "The model explains what mine did" in page
    assert page.count("not excited: interval as wide as the prior") == 1
    assert not re.search(r'(src|href)="(?!#|data:)', page.split("<script>")[0])


def test_an_uneven_scale_of_the_encoder_is_called_wrong_and_named(moved):
    uneven = moved["encoder"] + 0.02 * np.sin(2 * np.pi * moved["encoder"] / 0.5)
    log = Log("motion.csv", "motion", {**moved.columns, "encoder": uneven})
    word, why = verdict(identified_page.page(found(), [log], foresee=False))
    assert word == "no", why
    assert "uneven scale" in why


def test_a_resonance_that_the_model_does_not_have_is_called_wrong_and_named(moved):
    from scipy import signal

    omega, zeta, ts = 2 * np.pi * 40.0, 0.05, 1e-3
    b, a = signal.bilinear([omega**2], [1, 2 * zeta * omega, omega**2], 1 / ts)
    swung = 30.0 + signal.lfilter(b, a, moved["encoder"] - 30.0)
    log = Log("motion.csv", "motion", {**moved.columns, "encoder": swung})
    word, why = verdict(identified_page.page(found(), [log], foresee=False))
    assert word == "no", why
    assert "missing linear dynamics" in why


@pytest.mark.parametrize("count", [1e-5, 0.01, 0.02])
def test_coarse_and_fine_scales_of_the_encoder_are_no_mistake_of_the_model(moved, count):
    rounded = count * np.round(moved["encoder"] / count + 0.2)
    log = Log("motion.csv", "motion", {**moved.columns, "encoder": rounded})
    word, why = verdict(identified_page.page(found(), [log], foresee=False))
    assert word == "yes", why


def test_what_no_log_told_near_the_plate_may_be_recorded_next():
    gains = next_protocol.gains(found(), "standard", n=24)
    assert {gain.protocol for gain in gains} == {"sweep", "rest", "motion", "motion near the plate"}
    (near,) = (gain for gain in gains if gain.protocol == "motion near the plate")
    assert 0.0 < near.after <= near.now
    assert not near.recorded


def test_names_in_logs_are_text_on_the_page_and_no_markup(moved):
    hostile = "<script>alert(1)</script>\"'&.csv"
    page = identified_page.page(found(), [Log(hostile, "motion", moved.columns)], foresee=False)
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)" in page


def test_a_known_machine_is_predicted_on_a_log_that_was_not_used():
    known = {"name": "known", "head": {"nominal": True}, "axis": {**AXIS, "dead_time": 0.004, "latency": 0.0003}}
    unseen = protocols.record(known, "follow", 3)
    checked = check_log.check(found({"head": {"nominal": True}}), unseen, "xi2023-improved", draws=16)
    assert np.median(checked.predicted["RMS"]) == pytest.approx(checked.measured["RMS"], rel=0.1)
    slow = check_log.check(found(bandwidth=20.0), unseen, "xi2023-improved", draws=16)
    assert abs(np.median(slow.predicted["RMS"]) / slow.measured["RMS"] - 1) > 0.1


def test_only_a_follow_log_can_be_checked(moved):
    with pytest.raises(InvalidInput, match=r"motion.csv: --check takes a follow log"):
        check_log.fit_for(moved)


def test_thinned_lines_keep_their_peaks():
    y = np.random.default_rng(0).normal(size=100_001)
    y[777] = 50.0
    x, thinned = identified_page.thin(np.arange(len(y)), y)
    assert len(x) <= identified_page.DRAWN + 2
    assert x[np.argmax(thinned)] == 777
    assert np.all(np.diff(x) >= 0)


def test_the_advice_is_that_which_leaves_least():
    gain = SimpleNamespace
    rows = [gain(protocol="motion", now=20.0, after=5.0, recorded=False)]
    assert identified_page._advice(rows).startswith("motion. The following error is uncertain by 20.0 µm")
