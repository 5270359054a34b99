"""The study of Patent2022: its verdicts follow from the law and from the run."""

import numpy as np
import pytest

from kerfgym.baselines import patent2022 as law
from kerfgym.experiments.reproduce import patent2022
from kerfgym.experiments.reproduce.claims import Trial
from kerfgym.experiments.reproduce.verdicts import FAILS, REPRODUCED

SIX = Trial(seeds=6)


def rows(study):
    return {row.claim: row for row in study(SIX).rows}


def test_the_gain_as_printed_is_20_and_goes_to_0_with_the_root():
    found = rows(patent2022.gain)
    follows = found["the printed factor 0.01 follows a sheet"]
    assert follows.simulation.value == pytest.approx((0.01 / 1e-3) * 2)
    assert follows.verdict == FAILS
    assert found["the coefficients adapt with vs/vm"].simulation.value == pytest.approx(0.5)
    rectified = found["s in the lift only: more noise up than down"].simulation
    assert 4.0 < rectified.low < rectified.value < rectified.high < 20.0


def test_the_descent_does_not_overshoot_and_a_pid_does():
    found = rows(patent2022.descent)
    assert found["no overshoot on entering the range"].simulation.value < 1.0  # µm
    assert found["a PID alone overshoots on entering the range"].simulation.value > 100.0
    assert all(row.verdict != FAILS for row in found.values())


def test_a_law_without_vs_over_vm_is_not_said_to_agree(monkeypatch):
    assert rows(patent2022.three_cases)["the nearer the target, the smaller the displacement"].verdict == REPRODUCED
    monkeypatch.setattr(law, "displacement", lambda p, d, last: 0.01 * d)
    changed = rows(patent2022.three_cases)["the nearer the target, the smaller the displacement"]
    assert changed.simulation.value == pytest.approx(1.0)
    assert changed.verdict == FAILS


def test_a_smallest_displacement_of_none_is_not_said_to_keep_the_axis_still(monkeypatch):
    claim = "in the hold a displacement below the smallest one is none"
    assert rows(patent2022.chatter)[claim].verdict == REPRODUCED
    plain = patent2022._run
    monkeypatch.setattr(
        patent2022, "_run", lambda t, s, c: plain(t, s, "patent2022:law.smallest=0" if c == "patent2022" else c)
    )
    changed = rows(patent2022.chatter)[claim]
    assert changed.verdict == FAILS
    assert np.isclose(changed.simulation.value, 0.0, atol=5.0)
