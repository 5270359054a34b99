"""The full grid that a search of filters is measured against."""

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.plant.filters import KINDS
from kerfgym.experiments.studies import filter_grid
from kerfgym.experiments.studies.filter_grid import best, grid, ratio_of_scores, search_grid, with_impulses
from kerfgym.experiments.tune.goals import Limits
from kerfgym.experiments.tune.study import Task


def test_the_grid_holds_every_kind_window_and_trim_once():
    points = list(grid())
    plain = [point for finer, point in points if not finer]
    assert len({str(point) for _, point in points}) == len(points)
    assert {point["filter.kind"] for point in plain} == set(KINDS)
    trimmed = {(p["filter.window"], p["filter.trim"]) for p in plain if p["filter.kind"] == "improved"}
    assert trimmed == {(w, t) for w in range(1, 16) for t in range(w) if w - 2 * t >= 1}
    assert len(plain) == 1 + 15 + 64 + 15 + 15 + 3  # none, mean, improved, weighted, median, and those without a window
    base = stacks.get("xi2023-improved")
    for _, point in points:
        base.varied(point)  # raises if it is not allowed


def test_the_best_point_is_the_least_of_those_that_keep_the_limits(monkeypatch):
    points = [(False, {"filter.kind": "mean", "filter.window": w}) for w in (9.0, 1.0, 40.0)]
    monkeypatch.setattr(filter_grid, "grid", lambda: points)
    task = Task("xi2023-improved:law.kv=80", ("filter",), limits=Limits(2.0), seeds=1)
    told = []
    found = search_grid(task, 1, lambda *words: told.append(words[:2]))
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert found["filter.window"].iloc[0] == 1.0
    assert (found["keeps"] == (found["ms"] <= 2.0)).all()  # nothing collides here
    assert found["keeps"].tolist() == sorted(found["keeps"], reverse=True)
    assert not found["keeps"].iloc[-1]
    assert best(task, found).part("filter").window == 1.0


def test_scores_are_compared_in_pairs():
    rows = pd.MultiIndex.from_product([range(30), ["wavy", "step"]], names=["seed", "scenario"]).to_frame(index=False)
    rows["rms_true"] = np.random.default_rng(1).lognormal(3.0, 0.5, len(rows))
    other = rows.assign(rms_true=1.1 * rows["rms_true"], controller="b")
    ratio = ratio_of_scores(pd.concat([rows.assign(controller="a"), other]), "a", "b")
    assert tuple(ratio) == pytest.approx((1 / 1.1,) * 3)


def test_impulses_are_the_only_difference(monkeypatch):
    monkeypatch.setitem(scenarios.SPLITS, "test", range(1000, 1004))
    found = with_impulses(stacks.get("xi2023-improved"), 1)
    assert (found["with"] > found["without"]).all()
    assert found["seed"].tolist() == list(range(1000, 1004))
