"""What a search's result is worth: before and after, with intervals, and whether its own seeds flattered it."""

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from kerfgym.envs.control.stack import asked
from kerfgym.envs.scenarios import Scenario
from kerfgym.experiments.measure.population import Population
from kerfgym.experiments.store.ledger import Ledger
from kerfgym.experiments.tune import Limit, Limits, Task, verdict
from kerfgym.experiments.tune.assessed import Assessed
from kerfgym.experiments.tune.worth import FLATTERED, Ran, worth

TUNE, TEST = range(32), range(1000, 1200)
CASES = [Scenario(name="wavy"), Scenario(name="rough"), Scenario(name="holes", exempt=True)]
CORE = ("wavy", "rough")


def ran(seeds, level, random, scatter=0.2, touched=(), more=None):
    """Runs whose error scatters by so much about a level, µm, and touches in some seeds of the first scenario."""
    evaluator = SimpleNamespace(scenarios=CASES, core=CORE, seeds=np.array(seeds, np.uint64))
    figures = {}
    for case in CASES:
        values = level * np.exp(scatter * random.normal(size=len(seeds)))
        crash = np.isin(np.arange(len(seeds)), touched if case.name == "wavy" else ()).astype(float)
        figures[case.name] = {"rms_true": values, "collision": crash, **(more or {})}
    figures["holes"]["collision"][:] = 1.0  # which is built so
    return Ran(figures, evaluator)


def assessed(before, after, task=None):
    task = task or Task("pid", ("law",))
    return Assessed(worth(task, before, after), None, Ledger()), task


def test_twice_as_close_is_told_as_twice_with_the_interval_of_pairs():
    random = np.random.default_rng(0)
    before = tuple(ran(seeds, 80.0, random) for seeds in (TUNE, TEST))
    after = tuple(
        Ran({s: {**f, "rms_true": f["rms_true"] / 2} for s, f in each.figures.items()}, each.evaluator)
        for each in before
    )
    found, task = assessed(before, after)
    (figure,) = found.worth.figures
    assert figure.gain == pytest.approx((2.0, 2.0, 2.0))
    assert figure.before.value == pytest.approx(2 * figure.after.value)
    by_hand = np.sqrt([np.mean(before[1].figures[name]["rms_true"] ** 2) for name in CORE])
    assert figure.before.value == pytest.approx(stats.gmean(by_hand))
    assert figure.before.low < figure.before.value < figure.before.high
    assert verdict.headline(task, found).startswith("The tuned pid follows 2.0 times closer than before: ")
    assert verdict.warnings(task, found) == []


def test_a_touch_on_test_seeds_is_a_warning_and_its_runs_are_not_in_the_figures():
    random = np.random.default_rng(1)
    before = tuple(ran(seeds, 80.0, random) for seeds in (TUNE, TEST))
    after = (ran(TUNE, 40.0, random), ran(TEST, 40.0, random, touched=(3, 7, 8)))
    after[1].figures["wavy"]["rms_true"][[3, 7, 8]] = 1e5
    found, task = assessed(before, after)
    assert found.worth.touched == (0, 3)
    (told,) = verdict.warnings(task, found)
    assert "touches the sheet in 3 of 600 runs on test seeds (before: 0)" in told
    assert found.worth.figures[0].after.value == pytest.approx(40.0, rel=0.1)


def test_what_its_own_seeds_made_of_it_is_a_warning_where_that_is_sure_and_large():
    """Planted: the result is half as close on test seeds as on those of the search."""
    random = np.random.default_rng(2)
    before = tuple(ran(seeds, 80.0, random) for seeds in (TUNE, TEST))
    found, task = assessed(before, (ran(TUNE, 20.0, random), ran(TEST, 40.0, random)))
    (figure,) = found.worth.figures
    assert figure.flattered.low < 2.0 < figure.flattered.high
    (told,) = verdict.warnings(task, found)
    assert "times as large on test seeds as on the 32 seeds of the search" in told
    assert figure.flattered_before.low < 1.0 < figure.flattered_before.high
    slightly, _ = assessed(before, (ran(TUNE, 40.0, random, 0.01), ran(TEST, 40.0 * (1 + FLATTERED) / 2, random, 0.01)))
    assert slightly.worth.figures[0].flattered.low > 1.0  # sure, and too little to matter
    assert verdict.warnings(task, slightly) == []


def test_of_seeds_that_are_alike_it_is_seldom_warned():
    """Sixty searches that nothing flattered, six seeds each: at most one in twenty and what chance adds."""
    random, warned = np.random.default_rng(3), 0
    for _ in range(60):
        each = [tuple(ran(seeds, level, random, 0.4) for seeds in (range(6), range(1000, 1020))) for level in (80, 40)]
        found, task = assessed(*each)
        warned += bool(verdict.warnings(task, found))
    assert stats.binomtest(warned, 60, 0.05, alternative="greater").pvalue > 1e-3


def test_what_is_no_better_is_not_called_better():
    random = np.random.default_rng(4)
    before = tuple(ran(seeds, 40.0, random) for seeds in (TUNE, TEST))
    same, task = assessed(before, tuple(ran(seeds, 40.0, random) for seeds in (TUNE, TEST)))
    assert "cannot be told from what it was before" in verdict.headline(task, same)
    worse, task = assessed(before, tuple(ran(seeds, 60.0, random) for seeds in (TUNE, TEST)))
    assert "is worse than before" in verdict.headline(task, worse)


def test_where_all_runs_of_a_scenario_failed_there_is_no_figure_and_it_is_said():
    random = np.random.default_rng(5)
    before = tuple(ran(seeds, 40.0, random) for seeds in (TUNE, TEST))
    after = tuple(ran(seeds, 40.0, random) for seeds in (TUNE, TEST))
    after[1].figures["rough"]["rms_true"][:] = np.nan
    found, task = assessed(before, after)
    assert math.isnan(found.worth.figures[0].gain.value)
    assert verdict.headline(task, found).endswith("its runs on test seeds failed.")


def test_scenarios_on_fewer_seeds_count_with_those_that_they_have():
    random = np.random.default_rng(6)
    cases = [Scenario(name="wavy"), Scenario(name="rough", share=0.1)]
    evaluator = SimpleNamespace(scenarios=cases, core=CORE, seeds=np.array(TEST, np.uint64))
    sizes = {case.name: len(case.some(evaluator.seeds)) for case in cases}
    assert sizes == {"wavy": 200, "rough": 20}
    figures = {n: {"rms_true": random.uniform(1, 2, size), "collision": np.zeros(size)} for n, size in sizes.items()}
    sample = Ran(figures, evaluator).sample("rms_true")
    assert sample.values.shape == (1, 200, 2)
    assert np.isnan(sample.values).sum() == 180
    by_hand = stats.gmean([np.sqrt(np.mean(f["rms_true"] ** 2)) for f in figures.values()])
    task = Task("pid", ("law",))
    both = (Ran(figures, evaluator),) * 2
    assert worth(task, both, both).figures[0].after.value == pytest.approx(by_hand)


def test_limits_and_machines_that_do_not_keep_them_are_named():
    random = np.random.default_rng(7)
    task = Task("pid", ("law",), limits=Limits(2.0, (Limit("jitter", 1.0),)))
    quiet, loud = ({"jitter": np.full(len(TEST), x)} for x in (0.5, 1.5))
    before = (ran(TUNE, 80.0, random, more={"jitter": np.full(32, 0.5)}), ran(TEST, 80.0, random, more=quiet))
    after = (ran(TUNE, 40.0, random, more={"jitter": np.full(32, 0.5)}), ran(TEST, 40.0, random, more=loud))
    frame = {"machine": "mine", "seed": [1, 2, 3, 4], "ms": [1.5, 1.9, 2.1, np.inf], "gain": [3.0, 2.0, 1.5, 0.0],
             "delay_ms": [9.0, 8.0, np.inf, 0.0]}  # fmt: skip
    machines = Population(pd.DataFrame(frame), Ledger())
    found = Assessed(worth(task, before, after), (machines, machines), Ledger())
    assert verdict.cautions(task, found) == [
        "On test seeds it does not keep jitter ≤ 1.",
        "On 2 of 4 machines that may be meant Ms is above 2.",
        "On 1 of 4 machines the loop does not settle after a small step.",
    ]
    line = verdict.margins_in_words(task, machines)
    assert line == (
        "on 4 machines: Ms 2.00, worst ∞; gain margin 1.75, worst none; delay margin 8.50 ms, worst none; "
        "Ms is within 2 on 2"
    )


def test_a_parameters_value_is_told_as_it_is_set():
    known = asked("pid").parameters()
    assert verdict.setting(known["filter.kind"].value, known["filter.kind"].quantity) == "anti-impulse"
    assert verdict.setting("mean", known["filter.kind"].quantity) == "mean"
    assert verdict.setting(3899.54321, known["law.ki"].quantity) == "3899.5"
    assert verdict.unit(known["law.ki"].quantity) == "1/s²"
    assert verdict.unit(known["law.kd"].quantity) == ""
