"""Budgets of tuning: which comparisons are at equal ones."""

import numpy as np
import pytest

from kerfgym.envs.control import stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.statistics.budgets import CPU_SLACK, SLACK, budgets, faults, in_words, measures

EQUAL = {"trials": 400, "simulated_steps": 600_000_000, "cpu_seconds": 300.0}


def marks(tuning, reference="ref"):
    return budgets(tuning, tuning, reference)["budget"].to_dict()


def test_stacks_with_the_references_budget_are_compared_at_equal_budgets():
    found = budgets({"ref": EQUAL, "pid": {**EQUAL, "simulated_steps": 630_000_000}}, ["ref", "pid"], "ref")
    assert found["budget"].tolist() == ["", ""]
    assert found["trials"].tolist() == [400, 400]
    assert found["tuning_cpu"].tolist() == [300, 300]
    assert [in_words(row) for _, row in found.iterrows()] == ["400 · 600 M", "400 · 630 M"]


def test_more_steps_than_the_references_are_marked():
    more = {"trials": 400, "simulated_steps": SLACK * 600_000_000 + 1}
    found = budgets({"ref": EQUAL, "greedy": more, "modest": {"steps": 1_000_000}}, ["ref", "greedy", "modest"], "ref")
    assert found["budget"].to_dict() == {"ref": "", "greedy": "larger", "modest": ""}
    assert in_words(found.loc["modest"]) == "1 M"


def test_without_the_reference_the_smallest_is_the_measure():
    assert marks({"a": EQUAL, "b": {"trials": 10, "simulated_steps": 15_000_000}}) == {"a": "larger", "b": ""}


def test_a_reference_that_was_not_tuned_is_no_measure_and_fair_at_any():
    tuned = {"trials": 200, "simulated_steps": 1_000_000}
    assert marks({"ref": {"trials": 0}, "a": tuned, "b": tuned}) == {"ref": "", "a": "", "b": ""}
    assert marks({"ref": {"trials": 0}, "a": tuned, "b": EQUAL})["b"] == "larger"


def test_trials_are_the_measure_where_steps_are_unknown():
    assert marks({"ref": {"trials": 400}, "a": {"trials": 800}}) == {"ref": "", "a": "larger"}


def test_cpu_seconds_count_for_what_learns_and_nowhere_else():
    slow = {**EQUAL, "cpu_seconds": 300.0 * CPU_SLACK + 1}
    learned = {**EQUAL, "policy": {"ledger": {"cpu_seconds": 300.0 * CPU_SLACK + 1}}}
    modest = {**EQUAL, "policy": {"ledger": {"cpu_seconds": 60.0}}}
    on_slow = {**slow, "policy": {"ledger": {"cpu_seconds": 60.0}}}  # what it stands on is measured in steps
    found = marks({"ref": EQUAL, "slow": slow, "learned": learned, "modest": modest, "on_slow": on_slow})
    assert found == {"ref": "", "slow": "", "learned": "larger", "modest": "", "on_slow": ""}
    assert budgets({"m": modest}, ["m"], "ref").at["m", "tuning_cpu"] == 360
    assert marks({"ref": EQUAL, "m": {**EQUAL, "policy": {"seed": 0}}})["m"] == "none"  # without CPU-seconds


def test_what_a_search_started_from_counts():
    record = {"trials": 300, "simulated_steps": 300_000_000, "start": EQUAL}
    assert marks({"ref": EQUAL, "again": record})["again"] == "larger"
    assert budgets({"again": record}, ["again"], "").at["again", "trials"] == 700
    assert marks({"ref": EQUAL, "first": {**record, "start": {"trials": 0}}})["first"] == ""


def test_who_has_no_record_or_was_edited_afterwards_is_marked():
    tuning = {"ref": EQUAL, "mine.py:Mine": {}, "ref:law.kp=60": {**EQUAL, "edited": "law.kp=60"}}
    found = budgets(tuning, tuning, "ref")
    assert found["budget"].tolist() == ["", "none", "edited"]
    assert np.isnan(found.at["mine.py:Mine", "trials"])
    assert [in_words(row) for _, row in found.iterrows()] == ["400 · 600 M", "none", "400 · 600 M edited"]


def test_a_teams_budget_is_that_of_all_its_slots_and_each_is_measured_by_its_own():
    axes = {"criterion": "overshoot", "trials": 0}
    tuning = {
        "ref": {"z": EQUAL, "process": {"trials": 0}, "xy": axes},
        "a": {"z": EQUAL, "process": {"trials": 100, "simulated_steps": 1_000_000}, "xy": axes},
        "b": {"z": EQUAL, "process": {"trials": 200, "simulated_steps": 2_000_000}, "xy": axes},
    }
    found = budgets(tuning, tuning, "ref")
    assert (found.at["b", "trials"], found.at["b", "tuning_steps"]) == (600, 602_000_000)
    assert found["budget"].to_dict() == {"ref": "", "a": "", "b": "larger"}
    assert [words for _, words in faults(tuning["b"], measures(tuning, tuning, "ref"))] == [
        "process: tuned with 2 times the simulated steps of a"
    ]


def test_one_study_of_a_whole_team_counts_once():
    one = {"trials": 300, "simulated_steps": 1_000_000, "study": "0a1b"}
    assert budgets({"t": {"z": one, "xy": one}}, ["t"], "ref").at["t", "trials"] == 300


@pytest.mark.parametrize("name", ["xi2023-tuned", "pid", "observer", "preview-5ms", "mpc", "ilc", "xi2023-improved"])
def test_the_shipped_stacks_have_equal_budgets_or_none(name):
    tuning = {each: stack.get(each).provenance for each in ("xi2023-tuned", name)}
    assert budgets(tuning, tuning, "xi2023-tuned")["budget"].tolist() == [""] * len(tuning)


def test_every_shipped_stack_says_how_it_was_tuned():
    without = [name for name in stack.names() if name != "idle" and "trials" not in stack.get(name).provenance]
    assert not without
    assert stack.get("ilc").provenance == stack.get("pid").provenance


class Mine:
    TUNING = {"trials": 12, "tune_seeds": "0-3"}

    def reset(self):
        pass

    def control(self, signals):
        return 0.0


def test_a_controller_of_ones_own_says_how_it_was_tuned_and_overrides_are_remembered():
    assert stack.as_stack(Mine, "mine").provenance == Mine.TUNING
    assert not stack.as_stack(type("Silent", (), {"reset": Mine.reset, "control": Mine.control}), "silent").provenance
    assert stack.resolve("pid:law.kp=60").provenance == {**stack.get("pid").provenance, "edited": "law.kp=60"}


@pytest.mark.parametrize("record", [3, {"trials": "many"}, {"simulated_steps": -1}, {"cpu_seconds": float("nan")}])
def test_a_record_that_is_none_is_an_error(record):
    with pytest.raises(InvalidInput, match="TUNING"):
        stack.as_stack(type("Wrong", (Mine,), {"TUNING": record}), "wrong")
