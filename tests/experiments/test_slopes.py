"""Slopes by a law's parameters: the run is the kernel's, slopes are those of differences, and tuning goes down them."""

import json
import math

import numpy as np
import optuna
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import heads
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.scenarios import machines as put_on
from kerfgym.experiments.cli import main
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.measure.plants import of as plants_of
from kerfgym.experiments.measure.slopes import Slopes
from kerfgym.experiments.measure.stability import Injection
from kerfgym.experiments.tune import Task, gradients, sampling
from kerfgym.experiments.tune.evaluate import Evaluator
from kerfgym.experiments.tune.goals import FAILED
from kerfgym.experiments.tune.space import space

optuna.logging.set_verbosity(optuna.logging.ERROR)


def machines(scenario, stack, count):
    """Machines of a scenario, and their seeds."""
    seeds = np.arange(count, dtype=np.uint64)
    fleet = Fleet(count, stack.law, heads.POOL)
    scenarios.prepare(fleet, scenario, np.arange(count), seeds)
    return fleet, seeds


def squares(record):
    """Sum of the scored squares of the true gap error, mm², that a score is made of."""
    return float((record.error**2)[record.scored].sum())


@pytest.mark.parametrize("name", ["pid", "holes"])
def test_a_run_with_slopes_is_the_kernels_to_the_bit(name):
    stack = stacks.asked("pid").z
    scenario = scenarios.load("rough" if name == "pid" else name)
    fleet, seeds = machines(scenario, stack, 9)
    plain = rollout.anew(fleet, scenario, stack, seeds).data
    again, _ = machines(scenario, stack, 9)
    with Slopes(again, stack, ("law.kp",), scenario.steps):
        assert (rollout.anew(again, scenario, stack, seeds).data == plain).all()
    fleet_after = rollout.anew(again, scenario, stack, seeds).data
    assert (fleet_after == plain).all()  # and without them again


# A filter of each kind that has slopes, and laws. What is allowed is the scatter of the differences themselves, over
# ± 2 %, by the rounding of counter, encoder and D/A; it is more where the error is not far above that.
CLOSE = ("observer", "preview")
SEEN = {
    "pid": ("pid", ("law.kp", "law.ki", "law.lag")),
    "trimmed mean": ("xi2023-improved", ("law.kv",)),
    "lag": ("xi2023-ma:filter.kind=lag,filter.tau=2,law.kv=90", ("law.kv", "filter.tau")),
    "weighted": ("xi2023-ma:filter.kind=weighted,filter.window=5,law.kv=90", ("law.kv", "filter.ratio")),
    "kalman": ("xi2023-ma:filter.kind=kalman,law.kv=90", ("law.kv", "filter.trust")),
    "observer": ("observer:law.gate=5", ("law.kp", "law.bandwidth", "law.feed", "law.lead")),
    "preview": ("preview-5ms", ("law.kp",)),
}


@pytest.mark.parametrize("case", SEEN)
def test_slopes_of_the_score_are_those_of_differences(case):
    spec, names = SEEN[case]
    stack, scenario, by = stacks.asked(spec).z, scenarios.load("rough"), 0.02
    fleet, seeds = machines(scenario, stack, 64)
    with Slopes(fleet, stack, names, scenario.steps) as slopes:
        record = rollout.anew(fleet, scenario, stack, seeds)
    found = 2.0 * np.einsum("tm,ptm->p", record.error * record.scored, slopes.of_gap())
    for name, slope in zip(names, found, strict=True):
        value = stack.parameters()[name].value
        both = (
            squares(rollout.anew(fleet, scenario, stack.varied({name: value * (1 + side * by)}), seeds))
            for side in (1, -1)
        )
        difference = np.subtract(*both) / (2 * by)  # per relative change of the parameter, as share of the whole:
        rel, least = (0.02, 4e-3) if case in CLOSE else (5e-3, 2e-3)
        assert value * slope / squares(record) == pytest.approx(difference / squares(record), rel=rel, abs=least)


def test_slopes_of_sensitivity_are_those_of_differences():
    stack, names = stacks.asked("pid").z, ("law.kp", "law.kd")
    injection = Injection(stack, np.array([8.0, 25.0]), settle=0.4, window=0.8)
    found, slopes = injection.measure_with_slopes(stack, names)
    assert (found.magnitude == injection.measure(stack).magnitude).all()
    highest = np.argmax(found.magnitude, axis=0), np.arange(2)  # the corner plant, whichever is higher elsewhere
    for name, slope in zip(names, slopes.T, strict=True):
        value, by = stack.parameters()[name].value, 0.03
        both = (injection.measure(stack.varied({name: value * (1 + side * by)})).magnitude for side in (1, -1))
        up, down = (magnitude[highest] for magnitude in both)
        assert value * slope == pytest.approx(np.log(up / down) / (2 * by), rel=0.03, abs=0.01)


def test_slopes_count_the_steps_of_their_tangents():
    task = Task("pid", ("law",), seeds=1)
    evaluator = task.evaluator()
    evaluator.part(0, task.base, task.wanted)
    plain = evaluator.ledger.steps
    evaluator.part(0, task.base, task.wanted, ("law.kp", "law.ki"))
    assert evaluator.ledger.steps == plain + 3 * plain


def test_the_slopes_of_a_score_are_those_of_its_logarithm():
    """What a trial is told, from the mean squares of the scenarios, against two scores."""
    base, names, by = stacks.asked("xi2023-tuned"), ("law.kv",), 0.02
    evaluator = Evaluator(base, "following", range(8))
    figures = evaluator._part(0, base, ("rms_true",), names)
    each = [0.5 * evaluator.bent[s] / np.mean(of["rms_true"] ** 2) for s, of in figures.items()]
    value = base.z.parameters()["law.kv"].value

    def log(factor):
        found = evaluator.part(0, base.varied({"law.kv": value * factor}), ("rms_true",)).values()
        return np.mean([0.5 * math.log(np.mean(of["rms_true"] ** 2)) for of in found])

    assert value * np.mean(each) == pytest.approx((log(1 + by) - log(1 - by)) / (2 * by), rel=0.02)


def test_slopes_on_a_machine_of_ones_own_are_those_of_differences():
    """A slow and late drive, of a score and of |S|."""
    base, by = stacks.asked("pid:law.kp=30,law.ki=200,law.kd=0.1"), 0.02
    machine = put_on.of_tables({"name": "mine", "axis": {"bandwidth": 25.0, "dead_time": 0.004}}, "mine")
    evaluator = Evaluator(base, "following", range(4), named=("rough",), machine=machine)
    plants = plants_of(put_on.put_on(scenarios.load("rough"), machine))
    injection = Injection(base.z, np.array([8.0]), settle=0.4, window=0.8, machine=plants)

    def logs(factor):
        candidate = base.varied({"law.kp": 30.0 * factor})
        figures = evaluator.part(0, candidate, ("rms_true",))["rough"]["rms_true"]
        return np.array([0.5 * math.log(np.mean(figures**2)), math.log(injection.measure(candidate.z).peak)])

    expected = (logs(1 + by) - logs(1 - by)) / (2 * by)
    found = evaluator.part(0, base, ("rms_true",), ("law.kp",))["rough"]["rms_true"]
    assert 30.0 * 0.5 * evaluator.bent["rough"][0] / np.mean(found**2) == pytest.approx(expected[0], rel=0.02)
    assert 30.0 * injection.measure_with_slopes(base.z, ("law.kp",))[1][0, 0] == pytest.approx(expected[1], rel=0.03)
    standard = Injection(base.z, np.array([8.0]), settle=0.4, window=0.8)
    assert abs(injection.measure(base.z).peak - standard.measure(base.z).peak) > 0.05


# ------------------------------------------------------------------------------------------------------------ descents


def bowl(cap, trials, study=None, first=0, lost=()):
    """A study of a score with a known least place and slopes, under a cap on an Ms of its own; the loops of some trials
    are ``lost``, which do not settle and have no slopes."""
    s = space(stacks.asked("pid"), ["law.kp=1..400", "law.ki=0..20000"])
    kp, ki = s.axes
    study = study or optuna.create_study()
    study.sampler = gradients.Descents(s, 0, 3, sampling.costs(1.0, True, False), cap)
    for number in range(first, trials):
        trial = study.ask()
        chosen = s.suggest(trial)
        u, v = kp.encode(chosen["law.kp"]), ki.encode(chosen["law.ki"])
        per = np.array([1 / (chosen["law.kp"] * math.log(400.0)), 1 / 20000.0])  # range per unit
        log = 2.0 + 4.0 * (u - 0.6) ** 2 + 3.0 * (v - 0.7) ** 2 + 2.0 * (u - 0.6) * (v - 0.7)
        slope = np.array([8.0 * (u - 0.6) + 2.0 * (v - 0.7), 6.0 * (v - 0.7) + 2.0 * (u - 0.6)])
        trial.set_user_attr("ms", FAILED if number in lost else math.exp(u + v))
        if number not in lost:
            trial.set_user_attr("slopes", {"score": list(per * slope), "peaks": [u + v], "ms": list(per)})
        study.tell(trial, math.exp(log))
    return study


def test_a_descent_finds_the_least_place_of_a_bowl():
    best = bowl(math.inf, 20).best_trial
    assert best.value == pytest.approx(math.exp(2.0), rel=2e-3)
    assert best.params["law.kp"] == pytest.approx(400.0**0.6, rel=0.2)


def test_a_descent_finds_the_least_place_below_a_cap():
    """Below u + v = c the least place of the bowl is where the two slopes agree: 8u′ + 2v′ = 6v′ + 2u′."""
    cap = 2.0
    c = math.log(gradients.AIM * cap) - 1.3
    u, v = 0.4 * c, 0.6 * c
    least = 2.0 + 4.0 * u * u + 3.0 * v * v + 2.0 * u * v
    found = [t for t in bowl(cap, 24).trials if t.user_attrs["ms"] <= cap]
    assert min(math.log(t.value) for t in found) == pytest.approx(least, abs=5e-3)


def test_a_study_along_slopes_cut_in_two_is_the_study_in_one():
    whole, half = bowl(2.0, 14), bowl(2.0, 8)
    again = bowl(2.0, 14, study=half, first=8)
    assert [t.params for t in again.trials] == [t.params for t in whole.trials]


def test_descents_that_are_over_are_not_gone_down_again():
    """A bowl of three starts takes some twenty steps; further trials are others, down from new places."""
    found = bowl(2.0, 60).trials[3:]
    assert len({tuple(trial.params.values()) for trial in found}) == len(found)
    whole = bowl(2.0, 60, study=bowl(2.0, 45), first=45)
    assert [trial.params for trial in whole.trials[3:]] == [trial.params for trial in found]


def test_no_descent_starts_where_the_loop_does_not_settle():
    trials = bowl(math.inf, 4, lost=(0, 1)).trials
    assert trials[3].params == pytest.approx(trials[2].params)
    trials = bowl(math.inf, 5, lost=(0, 1, 2, 3)).trials  # then TPE goes on
    assert all(trials[n].params != pytest.approx(before.params) for n in (3, 4) for before in trials[:n])


# ---------------------------------------------------------------------------------------------------- the command


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["law", "-c", "forecast"], "the law of 'forecast' keeps a memory"),
        (["law", "-c", "forecast"], "laws with slopes: cn102528288a, "),
        (["law", "filter.jump", "-c", "pid"], "filter.jump is a choice, a whole number, or only compared with"),
        (["filter.window", "-c", "xi2023-tuned"], "filter.window: whole numbers and choices have no slope"),
        (["law", "filter.trim", "-c", "xi2023-improved"], "filter.trim above 1 ranks the samples"),
        (["law", "guard.slew", "-c", "pid"], "guard.slew is outside of filter and law"),
        (["law", "-c", "pid", "-m", "p99_true"], "p99_true has no slope here"),
        (["law", "-c", "pid", "--jitter", "1"], "jitter has no slope here"),
        (["law", "-c", "pid", "--workers", "2"], "--workers 2 is out of range"),
        (["law", "-c", "pid", "--sampler", "tpe"], "--sampler tpe is not given beside it"),
        (["law", "--suite", "contour"], "not for suite 'contour'"),
    ],
)
def test_what_has_no_slope_is_refused_by_name(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as error:
        main(["tune", *words, "--gradient"])
    assert error.value.code == 2
    assert said in " ".join(capsys.readouterr().err.split())


def test_no_slope_is_an_error_in_python_too():
    scenario, stack = scenarios.load("rough"), stacks.asked("pid").z
    fleet, _ = machines(scenario, stack, 1)
    with pytest.raises(InvalidInput, match=r"gate\.length is outside of filter and law"):
        Slopes(fleet, stack, ("gate.length",), scenario.steps)


def test_tuning_along_slopes_ends_better_than_it_began_in_a_run_folder_like_any(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("kerfgym.experiments.tune.outcome.TEST_SEEDS", 4)
    words = ["law", "-c", "xi2023-tuned:law.kv=40", "--gradient", "--trials", "6", "--seeds", "2", "--name", "run"]
    main(["tune", *words])
    record = json.loads((tmp_path / "runs" / "run" / "run.json").read_text())
    tuned = record["tuned"]
    assert tuned["sampler"] == gradients.SAMPLER
    assert tuned["ms"] <= 2.0
    assert tuned["test"]["rms_true"] < tuned["test_before"]["rms_true"]
    assert (tmp_path / "runs" / "run" / "tuned.toml").is_file()
