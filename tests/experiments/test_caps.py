"""Classical followers under caps on Ms: which rows are made, that they go on, and what they say."""

import math

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.figures import metrics
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.studies import caps

RECORD = {"ms": 1.9, "trials": 3, "sampler": "TPE", "tune_seeds": "0-1", "simulated_steps": 9, "cpu_seconds": 0.1,
          "git": "abc"}  # fmt: skip


def test_every_stack_is_searched_under_every_cap_and_what_is_there_is_not_made_again(tmp_path, monkeypatch):
    asked = []

    def searched(name, cap):
        asked.append((name, cap))
        return stack.get(name), RECORD

    monkeypatch.setattr(caps.protocol, "search", searched)
    monkeypatch.setattr(caps, "TEST_SEEDS", 2)
    file = tmp_path / "caps.csv"
    caps.table(["pid"], file)
    assert asked == [("pid", cap) for cap in (2.0, 3.3, math.inf)]
    found = caps.table(["pid", "observer"], file)
    assert asked[3:] == [("observer", cap) for cap in (2.0, 3.3, math.inf)]
    pd.testing.assert_frame_equal(found, pd.read_csv(file))
    assert set(found["cap"]) == {2.0, 3.3, math.inf}


def test_the_score_is_the_geometric_mean_of_the_rms_over_test_seeds(monkeypatch):
    monkeypatch.setattr(caps, "TEST_SEEDS", 3)
    mine, logs = caps.tested(stack.get("pid")), []
    for name in scenarios.core("following"):
        case = scenarios.load(name)
        recording = rollout.roll(case, stack.get("pid"), case.some(range(1000, 1003)))
        logs.append(0.5 * np.log(np.mean(metrics.evaluate(recording)["rms_true"] ** 2)))
    assert mine["score_test_um"] == pytest.approx(np.exp(np.mean(logs)), rel=1e-6)
    assert mine["collisions_test"] == 0
    assert 0.0 <= mine["overshoot_mm"] < 0.1


def test_an_unknown_stack_is_named(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["caps", "pidd"])
    with pytest.raises(SystemExit):
        caps.main()
    assert "unknown stack 'pidd'; known: xi2023-tuned, pid" in capsys.readouterr().err
