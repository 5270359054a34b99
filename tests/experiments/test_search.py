"""The search of the shipped presets: what it varies, what it refuses, what it writes down."""

import math
import tomllib
from dataclasses import replace

import pytest

from kerfgym.baselines import PRESETS
from kerfgym.envs.control.stack import get
from kerfgym.experiments.statistics import budgets
from kerfgym.experiments.tune import protocol
from kerfgym.experiments.tune.protocol import COUNTED, NAMES, NARROWED, space


@pytest.mark.parametrize("name", NAMES)
def test_all_of_a_law_is_searched_and_all_that_its_filter_reads(name):
    stack = get(name)
    searched = space(stack)
    assert {key for key in stack.parameters() if key.startswith("law.")} <= set(searched)
    read = {key for key in searched if key.startswith("filter.")}
    # A setting that is searched changes what the filter lets through, one that is not changes nothing.
    assert "filter.kind" not in read
    assert bool(read) == (name not in protocol.UNFILTERED)


@pytest.mark.parametrize("name", NAMES)
def test_ranges_of_the_search_lie_within_the_declared_ones(name):
    known = get(name).parameters()
    for key in set(space(get(name))) & set(NARROWED):
        low, high = NARROWED[key]
        assert known[key].quantity.low <= low < high <= known[key].quantity.high


@pytest.mark.parametrize("name", NAMES)
def test_the_preset_holds_what_was_searched_and_nothing_else(name):
    preset = tomllib.loads((PRESETS / f"{name}.toml").read_text(encoding="utf-8"))
    assert set(preset["parameters"]) == set(space(get(name)))


def test_no_winner_of_the_protocol_had_a_larger_budget_than_another():
    records = {name: get(name).provenance for name in NAMES}
    measure = budgets.measures(records, NAMES, "xi2023-tuned")
    assert {name: list(budgets.faults(record, measure)) for name, record in records.items()} == {n: [] for n in NAMES}


class Pretended:
    """Scores by one gain alone, the larger the better; odd gains collide on more seeds than a trial sees."""

    made = 0

    def __init__(self, stack, suite=protocol.SUITE, seeds=protocol.SEEDS, threads=1):
        self.seeds, self.steps, self.ms_steps = seeds, 0, 0

    def score(self, stack):
        self.steps += self.seeds
        gain = stack.parameters()["law.kp"].value
        return 1000.0 / gain, int(gain % 2.0 >= 1.0 and self.seeds > protocol.SEEDS)

    def peak(self, stack):
        return stack.parameters()["law.kp"].value / 60.0

    def exact_peak(self, stack):
        self.ms_steps += 7
        return self.peak(stack)


def test_the_final_check_refuses_what_touches_the_sheet_on_a_hundred_seeds(monkeypatch):
    monkeypatch.setattr(protocol, "Evaluator", Pretended)
    found, record = protocol.search("pid", trials=60)
    gain = found.parameters()["law.kp"].value
    assert 90.0 < gain <= 120.0  # beyond that Ms is above 2
    assert gain % 2.0 < 1.0
    assert record["score_checked_um"] == pytest.approx(1000.0 / gain, rel=1e-3)
    assert record["ms"] <= record["cap"]
    assert record["ms_steps"] > 0
    assert record["simulated_steps"] <= 60 * protocol.SEEDS + protocol.CHECKED * protocol.MORE_SEEDS


def test_a_search_without_anything_that_keeps_the_limits_leaves_the_preset_alone(monkeypatch, capsys, tmp_path):
    class Hopeless(Pretended):
        def score(self, stack):
            return math.inf, 1

    monkeypatch.setattr(protocol, "Evaluator", Hopeless)
    before = (PRESETS / "pid.toml").read_bytes()
    assert protocol.make("pid", trials=20) == {}
    assert "its preset stays as it is" in capsys.readouterr().out
    assert (PRESETS / "pid.toml").read_bytes() == before


def test_a_search_goes_on_from_a_preset_of_the_same_suite_and_counts_it(monkeypatch):
    monkeypatch.setattr(protocol, "Evaluator", Pretended)
    for suite, counted in ((protocol.suite_name(), True), ("following-1", False)):
        earlier = {"suite": suite, "trials": 100, "simulated_steps": 10**6, "cpu_seconds": 5.0, "git": "abc"}
        base = replace(get("pid"), provenance=earlier)
        monkeypatch.setattr(protocol.stacks, "get", lambda _, base=base: base)
        _, record = protocol.search("pid", trials=20)
        assert ("start" in record) == counted
        assert budgets.spent(record).trials == 20 + 100 * counted
        if counted:
            assert set(record["start"]) <= set(COUNTED)
