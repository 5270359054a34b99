"""Budgets of tuning: which comparisons are at equal ones."""

import numpy as np
import pytest

from kerfgym.envs import stack
from kerfgym.experiments.budgets import SLACK, budgets, in_words

EQUAL = {"trials": 400, "simulated_steps": 600_000_000}


def test_stacks_with_the_references_budget_are_compared_at_equal_budgets():
    found = budgets({"ref": EQUAL, "pid": {**EQUAL, "simulated_steps": 630_000_000}}, ["ref", "pid"], "ref")
    assert found["budget"].tolist() == ["", ""]
    assert found["trials"].tolist() == [400, 400]
    assert [in_words(row) for _, row in found.iterrows()] == ["400 · 600 M", "400 · 630 M"]


def test_more_steps_than_the_references_are_marked():
    more = {"trials": 400, "simulated_steps": SLACK * 600_000_000 + 1}
    found = budgets({"ref": EQUAL, "greedy": more, "modest": {"steps": 1_000_000}}, ["ref", "greedy", "modest"], "ref")
    assert found["budget"].to_dict() == {"ref": "", "greedy": "larger", "modest": ""}
    assert in_words(found.loc["modest"]) == "1 M"


def test_without_the_reference_the_smallest_is_the_measure():
    found = budgets({"a": EQUAL, "b": {"trials": 10, "simulated_steps": 15_000_000}}, ["a", "b"], "ref")
    assert found["budget"].to_dict() == {"a": "larger", "b": ""}


def test_trials_are_the_measure_where_steps_are_unknown():
    found = budgets({"ref": {"trials": 400}, "a": {"trials": 800}}, ["ref", "a"], "ref")
    assert found["budget"].to_dict() == {"ref": "", "a": "larger"}


def test_who_has_no_record_or_was_edited_afterwards_is_marked():
    names = ["ref", "mine.py:Mine", "ref:law.kp=60,filter.hold=2"]
    found = budgets({"ref": EQUAL, names[2]: EQUAL}, names, "ref")
    assert found["budget"].tolist() == ["", "none", "edited"]
    assert np.isnan(found.at["mine.py:Mine", "trials"])
    assert [in_words(row) for _, row in found.iterrows()] == ["400 · 600 M", "none", "400 · 600 M edited"]


def test_a_teams_budget_is_that_of_all_its_slots():
    found = budgets({"team": {"z": EQUAL, "process": EQUAL, "xy": {"criterion": "overshoot"}}}, ["team"], "ref")
    assert (found.at["team", "trials"], found.at["team", "tuning_steps"]) == (800, 1_200_000_000)


@pytest.mark.parametrize("name", ["xi2023-tuned", "pid", "observer", "preview-5ms"])
def test_the_standard_benchmarks_tuned_stacks_had_equal_budgets(name):
    tuning = {each: stack.get(each).provenance for each in ("xi2023-tuned", name)}
    assert budgets(tuning, tuning, "xi2023-tuned")["budget"].tolist() == [""] * len(tuning)
