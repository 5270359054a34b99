"""One parameter 20 % off: what is moved, and that the change is what roll-outs on tune seeds say."""

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.figures import metrics
from kerfgym.experiments.benchmark import detuned
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.report.suite import Suite
from kerfgym.experiments.report.tuning import figure, presets
from kerfgym.experiments.tune.outcome import moves


def test_what_a_search_found_is_moved_within_its_range():
    found = list(moves(stack.get("xi2023-tuned"), detuned.searched("xi2023-tuned")))
    gain = stack.get("xi2023-tuned").parameters()["law.kv"].value
    assert ("law.kv", -1, pytest.approx(0.8 * gain)) in found
    assert ("law.kv", 1, pytest.approx(1.2 * gain)) in found
    assert [move for move in found if move[0] == "filter.window"] == [("filter.window", 1, 2.0)]  # whole, 1 or more
    lead = [
        value for name, _, value in moves(stack.get("observer"), detuned.searched("observer")) if name == "law.lead"
    ]
    assert max(lead) == 20.0  # the end of its range, not 20 % more
    assert not list(moves(stack.get("xi2023-improved"), detuned.searched("xi2023-improved")))  # nobody searched it


def test_the_change_is_that_of_roll_outs_on_tune_seeds(made_up, monkeypatch):
    monkeypatch.setattr(detuned, "SEEDS", 1)
    monkeypatch.setattr(detuned, "SHOWN", 0)
    told = []
    results = made_up.following()
    results.detuned = detuned.in_report(results, told=lambda *words: told.append(words))
    assert [words[:2] for words in told] == [(i + 1, len(told)) for i in range(len(told))]
    rows = results.detuned.set_index(["parameter", "side"])

    def score(controller):
        cases = [scenarios.suite("following")[name] for name in scenarios.core("following")]
        runs = [metrics.METRICS["rms_true"].function(rollout.roll(case, controller, [0]))[0] for case in cases]
        return np.exp(np.mean(np.log(runs)))

    plain = stack.get("xi2023-tuned")
    expected = score(plain.varied({"law.kv": rows.at[("law.kv", -1), "moved"]})) / score(plain)
    assert rows.at[("law.kv", -1), "rms_true"] == pytest.approx(expected, rel=1e-6)
    assert rows.at[("law.kv", -1), "rms_true"] > 1.05

    shown = figure(presets([Suite("following", results)]), {"xi2023-tuned": "reference"})
    assert shown.title.startswith("reference: law.kv 20 % off costs most, ")
    (view,) = shown.views.values()
    np.testing.assert_allclose(
        np.concatenate([np.asarray(bar.x, float) for bar in view.data]),
        pd.concat([results.detuned.query(f"side == {side}")["rms_true"] for side in (-1, 1)]) * 100 - 100,
    )
