"""Tuning: spaces, limits, samplers that can be repeated, studies that survive a kill, and what comes out of them."""

import errno
import json
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import tomllib
import types
from dataclasses import replace
from pathlib import Path

import cmaes
import numpy as np
import optuna
import pandas as pd
import pytest
from PIL import Image

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import metrics
from kerfgym.experiments.cli import main
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.plots.png import png
from kerfgym.experiments.statistics import budgets
from kerfgym.experiments.store.ledger import Ledger, ranges
from kerfgym.experiments.tune import Limit, Limits, Task, crew, goals, history, sampling, storage, tune
from kerfgym.experiments.tune.command import steps_left
from kerfgym.experiments.tune.evaluate import Evaluator
from kerfgym.experiments.tune.space import READS, Space, space, start_of
from kerfgym.experiments.tune.work import WORKER, abandoned, done

optuna.logging.set_verbosity(optuna.logging.ERROR)


def refused(capsys, *words):
    """What the command says when it refuses."""
    with pytest.raises(SystemExit) as error:
        main(["tune", *words])
    assert error.value.code == 2
    return capsys.readouterr().err


def told(trials):
    """What two runs of the same study must agree in."""
    return [(t.number, t.state.name, t.values, t.params, t.constraints, t.intermediate_values) for t in trials]


# ------------------------------------------------------------------------------------------------------------- ledger


def test_the_ledger_adds_up_and_keeps_splits_apart():
    ledger = Ledger(100, 1.25)
    ledger.use([0, 1, 2, 5, 1000])
    both = ledger + Ledger(11, 0.5, {"tune": {3}})
    assert both.entry() == {"simulated_steps": 111, "cpu_seconds": 1.75, "seeds": {"tune": "0-3,5", "test": "1000"}}
    with pytest.raises(InvalidInput, match=r"seeds 1000 are of split 'test'; allowed: 'tune'"):
        both.check("tune")
    assert ranges([7, 3, 4]) == "3-4,7"


# -------------------------------------------------------------------------------------------------------------- space


def test_words_name_groups_parameters_and_ranges():
    pid = stacks.get("pid")
    law = {f"law.{name}" for name in pid.law.Params._fields}
    assert {a.name for a in space(pid, ["law"]).axes} == law
    narrow = space(pid, ["law.kp=20..120", "filter.window"])
    assert [(a.name, a.low, a.high) for a in narrow.axes] == [("law.kp", 20, 120), ("filter.window", 1, 15)]
    groups = {a.name.split(".")[0] for a in space(pid, ["all"]).axes}
    assert groups == {"filter", "law", "guard"}
    team = stacks.team("z=pid,xy=wu")
    assert {a.name for a in space(team, ["xy.law.kp", "z.law.kd"]).axes} == {"xy.law.kp", "z.law.kd"}


@pytest.mark.parametrize("name", ["law.kp", "law.ki", "filter.window", "filter.jump"])
def test_the_scale_from_0_to_1_goes_both_ways(name):
    (axis,) = space(stacks.get("pid"), [name]).axes
    for x in np.linspace(0.001, 0.999, 7):
        assert axis.low <= axis.decode(x) <= axis.high
        assert axis.decode(axis.encode(axis.decode(x))) == pytest.approx(axis.decode(x))
    if axis.whole:  # every value has an equal share
        values = [axis.decode(x) for x in (np.arange(1500) + 0.5) / 1500]
        assert set(np.unique(values, return_counts=True)[1]) == {100}


def test_only_the_settings_that_a_filter_reads_are_searched():
    s = space(stacks.get("xi2023-improved"), ["filter"])
    for kind, settings in READS.items():
        assert {a.name for a in s.active({"filter.kind": kind})} == {"filter.kind", *(f"filter.{x}" for x in settings)}
    assert start_of(s) == {"filter.kind": "improved", "filter.window": 5, "filter.trim": 1}


def test_a_trim_leaves_something_of_the_window():
    s = space(stacks.get("xi2023-improved"), ["filter"])
    for window in range(1, 16):
        values = s.values({"filter.kind": "improved", "filter.window": window, "filter.trim": 7})
        stacks.get("xi2023-improved").varied(values)  # raises if it does not
        assert values["filter.trim"] == min(7, (window - 1) // 2)


# -------------------------------------------------------------------------------------------------- goals and running


def test_a_limit_weighs_a_tenth_too_much_alike_everywhere():
    assert Limit("a", 2.0).broken(2.2) == pytest.approx(Limit("b", 300.0).broken(330.0)) == pytest.approx(math.log(1.1))
    assert Limit("a", 2.0).broken(1.9) < 0 < Limit("a", 2.0).broken(1.9, higher=True)
    assert Limits(2.0).peak(math.inf) == goals.FAR


def test_the_score_is_that_of_plain_rollouts():
    base, seeds = stacks.asked("pid"), [0, 1, 2]
    evaluator = Evaluator(base, "following", seeds)
    figures = evaluator.whole(base, ("rms_true", "jitter", "collision"))
    logs = []
    for name in scenarios.core("following"):
        case = scenarios.load(name)
        record = rollout.roll(case, base.z, case.some(seeds))
        logs.append(0.5 * np.log(np.mean(metrics.METRICS["rms_true"].function(record) ** 2)))
        assert figures[name]["jitter"] == pytest.approx(metrics.METRICS["jitter"].function(record), rel=1e-12)
    assert goals.score("rms_true", figures, evaluator.core) == pytest.approx(np.exp(np.mean(logs)), rel=1e-12)
    assert set(figures) - set(evaluator.core) == {"holes", "edge", "descent"}
    assert evaluator.ledger.steps == sum(len(s.some(seeds)) * s.steps for s in evaluator.scenarios)


def test_a_fleet_that_is_used_again_remembers_nothing():
    base = stacks.asked("xi2023-improved")
    evaluator = Evaluator(base, "following", [0, 1])
    wide = base.varied({"filter.kind": "improved", "filter.window": 15, "filter.trim": 4})
    first = evaluator.part(0, base, ("rms_true",)), evaluator.peak(base)
    evaluator.part(0, wide, ("rms_true",)), evaluator.peak(wide)
    again = evaluator.part(0, base, ("rms_true",)), evaluator.peak(base)
    for name, figures in first[0].items():
        assert (figures["rms_true"] == again[0][name]["rms_true"]).all()
    assert first[1] == again[1]


# ----------------------------------------------------------------------------------------------------------- samplers


def bowl(s: Space, sampler: str, trials: int, seed: int = 0, first: int = 0, study=None):
    """A study of a function whose smallest value is known: a narrow, tilted valley in kp and ki."""
    study = study or optuna.create_study()
    study.sampler = sampling.Seeded(
        sampler, s, seed, sampling.explored(trials, s) if "+" in sampler else 1, sampling.costs(1.0, True, False)
    )
    for _ in range(first, trials):
        trial = study.ask()
        values = s.suggest(trial)
        u, v = (axis.encode(values[axis.name]) for axis in s.axes)
        study.tell(trial, 1e-6 + (u - 0.7) ** 2 + 300.0 * (u + v - 1.1) ** 2)
    return study


@pytest.mark.parametrize("sampler", [*sampling.SAMPLERS])
def test_a_study_cut_in_two_is_the_study_in_one(sampler):
    s, trials = space(stacks.get("pid"), ["law.kp", "law.ki"]), 34 if sampler != "gp" else 12
    whole = bowl(s, sampler, trials)
    assert whole.trials[0].params == start_of(s)
    half = bowl(s, sampler, trials // 2) if "+" not in sampler else None
    if half is None:  # explore depends on the trials asked for
        half = optuna.create_study()
        for trial in whole.trials[: trials // 2]:
            half.add_trial(trial)
    assert told(bowl(s, sampler, trials, first=trials // 2, study=half).trials) == told(whole.trials)
    assert sampler == "gp" or told(bowl(s, sampler, trials, seed=1).trials)[1:] != told(whole.trials)[1:]


def test_cmaes_finds_the_bottom_of_a_narrow_valley():
    s = space(stacks.get("pid"), ["law.kp", "law.ki"])
    found = {name: bowl(s, name, 200).best_value for name in ("cmaes", "random")}
    assert found["cmaes"] < 0.02 * found["random"]


@pytest.mark.parametrize("sampler", sampling.SINGLE)
def test_cmaes_searches_a_lone_parameter_too(sampler):
    s = space(stacks.get("pid"), ["law.kp=20..120"])
    study = optuna.create_study()
    study.sampler = sampling.Seeded(sampler, s, 0, sampling.explored(60, s), sampling.costs(1.0, True, False))
    for _ in range(60):
        trial = study.ask()
        study.tell(trial, 1e-6 + math.log(s.suggest(trial)["law.kp"] / 77.0) ** 2)
    assert study.best_params["law.kp"] == pytest.approx(77.0, rel=5e-3)
    assert sampling.ASKED in study.best_trial.user_attrs


def test_cmaes_replayed_is_cmaes_that_was_never_interrupted():
    s, trials = space(stacks.get("pid"), ["law.kp", "law.ki"]), 40
    study = bowl(s, "cmaes", trials)
    mean = np.array([axis.encode(start_of(s)[axis.name]) for axis in s.axes])
    live = cmaes.CMA(mean, 0.2, np.tile([0.0, 1.0], (2, 1)), seed=sampling.seed_of(0, 0), population_size=6)
    told = []
    for trial in study.trials[1:]:
        live._rng.seed(sampling.seed_of(0, trial.number))
        point = live.ask()
        assert [axis.decode(x) for axis, x in zip(s.axes, point, strict=True)] == pytest.approx(
            [*trial.params.values()]
        )
        told.append((point, math.log(trial.value)))
        if len(told) == 6:
            live.tell(told)
            told = []


def test_every_kind_of_filter_gets_its_turn():
    s, study = space(stacks.get("xi2023-improved"), ["filter"]), optuna.create_study()
    study.sampler = sampling.Seeded("tpe", s, 0, 1, sampling.costs(1.0, True, False))
    kinds = []
    for _ in range(1 + 2 * len(READS)):
        trial = study.ask()
        kinds.append(s.suggest(trial)["filter.kind"])
        study.tell(trial, 1.0)
    assert sorted(kinds[1:]) == sorted([*READS] * 2)


# ------------------------------------------------------------------------------------------------------------ storage


def test_a_torn_last_line_is_cut_off_and_damage_elsewhere_is_named(tmp_path):
    file = tmp_path / "study.journal"
    study = storage.study_of(str(file), "a", ["minimize"], ["x"], {})
    study.tell(study.ask(), 1.0)
    whole = file.read_bytes()
    file.write_bytes(whole + b'{"op_code":4,"wor')
    again = storage.study_of(str(file), "a", ["minimize"], ["x"], {})
    assert file.read_bytes().startswith(whole)
    assert again.best_value == 1.0
    file.write_bytes(whole[:50] + b"\n" + whole[50:])
    with pytest.raises(InvalidInput, match=r"study\.journal', line 1: not a journal of a study"):
        storage.study_of(str(file), "a", ["minimize"], ["x"], {})


def test_a_study_of_another_space_is_refused(tmp_path):
    url = f"sqlite:///{tmp_path / 's.db'}"
    storage.study_of(url, "a", ["minimize"], ["suite following", "law.kp=1..2"], {})
    with pytest.raises(
        InvalidInput, match=r"'a' in .* is another one \(it has: law\.kp=1\.\.2; asked for: law\.kp=1\.\.3"
    ):
        storage.study_of(url, "a", ["minimize"], ["suite following", "law.kp=1..3", "fixed 1"], {})
    with pytest.raises(InvalidInput, match=r"another one \(what is not searched has changed"):
        storage.study_of(url, "a", ["minimize"], ["suite following", "law.kp=1..2", "fixed 1"], {})
    storage.study_of(url, "b", ["minimize"], ["suite following", "law.kp=1..3"], {})


QUICK = ["law.kv", "filter.window", "-c", "xi2023-improved", "--seeds", "1", "--trials", "12"]
TASK = Task("xi2023-improved", ("law.kv", "filter.window"), limits=Limits(2.0), seeds=1, trials=12)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Trials and result of the quick task, not interrupted."""
    folder = tmp_path_factory.mktemp("whole") / "runs"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("kerfgym.experiments.tune.outcome.TEST_SEEDS", 2)
        patch.setattr("kerfgym.experiments.tune.history.write", lambda *_: [])
        result = tune(TASK, folder, threads=1)
    return told(done(result.task.open())), result.found.parameters


@pytest.fixture
def plain(few, monkeypatch):
    """Without pictures, which have a test of their own."""
    monkeypatch.setattr("kerfgym.experiments.tune.history.write", lambda *_: [])


@pytest.fixture
def few(monkeypatch):
    """Four test seeds are enough here."""
    monkeypatch.setattr("kerfgym.experiments.tune.outcome.TEST_SEEDS", 4)
    monkeypatch.setattr("kerfgym.experiments.tune.outcome.TEST_SEEDS_JOBS", 1)


def test_a_full_disk_loses_nothing_and_says_so(here, plain, whole, monkeypatch):
    write, calls = storage.JournalFileBackend.append_logs, []

    def full(backend, logs):
        calls.append(1)
        if len(calls) == 60:
            with open(backend._file_path, "ab") as file:
                file.write(json.dumps(logs[0]).encode()[:20])  # what still fitted
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), backend._file_path)
        write(backend, logs)

    monkeypatch.setattr(storage.JournalFileBackend, "append_logs", full)
    with pytest.raises(InvalidInput, match=r"cannot write 'runs/.*study\.journal': No space left on device; .*goes on"):
        tune(TASK, Path("runs/full"), threads=1)
    kept = done(TASK_AT("runs/full").open())
    assert 2 <= len(kept) < 12
    result = tune(TASK, Path("runs/full"), threads=1, resume=True)
    assert told(done(TASK_AT("runs/full").open())) == whole[0]
    assert result.found.parameters == whole[1]


def TASK_AT(folder):
    """The quick task with its journal in a folder."""
    return replace(TASK, url=str(Path(folder) / storage.JOURNAL), name=Path(folder).name)


# ------------------------------------------------------------------------------------------------------------ command


def test_the_command_writes_a_controller_that_the_others_take(here, few, capsys, monkeypatch):
    main(["tune", *QUICK, "--name", "first"])
    printed, folder = capsys.readouterr().out, here / "runs" / "first"
    assert str(Path("runs/first/tuned.toml")) in printed
    body = tomllib.loads((folder / "tuned.toml").read_text(encoding="utf-8"))
    assert body["controller"] == "xi2023-improved"
    assert set(body["parameters"]) == {"law.kv", "filter.window"}
    found = stacks.resolve("runs/first/tuned.toml")
    assert {k: found.parameters()[k].value for k in body["parameters"]} == body["parameters"]
    assert stacks.resolve("runs/first/tuned.toml:law.kv=33").parameters()["law.kv"].value == 33
    assert stacks.team("z=runs/first/tuned.toml,xy=wu").z.parameters()["law.kv"].value == body["parameters"]["law.kv"]

    told_of = body["provenance"]
    record = rollout.roll(scenarios.load("wavy"), found, range(1000, 1004))
    assert told_of["test"]["runs"] == 4 * 14 + 1  # of a scenario of minutes one
    assert told_of["ms"] <= 2.0
    assert told_of["tune_seeds"] == "0"
    assert not metrics.failed(record).any()
    meta = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert meta["ledger"]["tuning"]["simulated_steps"] == told_of["simulated_steps"] > 0
    assert meta["ledger"]["tuning"]["seeds"] == {"tune": "0"}
    assert meta["ledger"]["testing"]["seeds"] == {"test": "1000-1003"}
    for name in ("history", "slices", "sensitivity"):
        with Image.open(folder / "plots" / f"{name}.png") as picture:
            assert picture.size[0] > 600
    assert "exists; use --overwrite" in refused(capsys, *QUICK, "--name", "first")
    assert "is finished" in refused(capsys, *QUICK, "--name", "first", "--resume")
    monkeypatch.setattr("kerfgym.experiments.tune.history.write", lambda *_: [])
    main(["tune", *QUICK, "--name", "first", "--overwrite"])
    again = tomllib.loads((folder / "tuned.toml").read_text(encoding="utf-8"))
    assert again["parameters"] == body["parameters"]
    assert again["provenance"]["test"] == told_of["test"]
    assert again["provenance"]["study"] == told_of["study"]


def test_a_budget_makes_a_comparison_one_at_equal_steps(here, few, plain):
    words = ["tune", "law.kv", "--seeds", "1", "--ms", "inf", "--name", "x"]
    whole = 342_000  # fourteen scenarios of 3 s, and one of 300
    main([*words, "--budget", str(4 * whole)])
    record = json.loads(Path("runs/x/run.json").read_text(encoding="utf-8"))
    assert 4 * whole <= record["ledger"]["tuning"]["simulated_steps"] < 5 * whole
    assert record["tuned"]["budget"] == 4 * whole
    # A controller stands for what it was tuned with; what the search starts from has had its share.
    had = budgets.spent(stacks.get("pid").provenance).steps
    assert steps_left("pid", "xi2023-improved") == had
    spent = record["tuned"]["simulated_steps"]
    assert steps_left("pid", "runs/x/tuned.toml") == had - spent


def test_an_unfinished_search_with_a_budget_goes_on_to_the_same_end(here, plain):
    task = replace(TASK, budget=3_420_000, limits=Limits(), trials=1000)
    tune(task, Path("runs/whole"), threads=1)
    study = replace(task, url=str(storage.url_of(None, Path("runs/cut"))), name="cut")
    Path("runs/cut").mkdir()
    work = replace(study, trials=3).work(1)
    work.run([])
    assert len(done(work.study)) == 3
    tune(task, Path("runs/cut"), threads=1, resume=True)
    whole, cut = (
        replace(task, url=str(storage.url_of(None, Path("runs") / n)), name=n).open() for n in ("whole", "cut")
    )
    assert told(done(whole)) == told(done(cut))


def test_candidates_that_come_again_cost_a_killed_search_no_more_than_one_that_was_not(here, few, plain):
    """A whole number has few values, and what is known is not run again; what a killed process knew must not be paid
    for twice, or its study ends with fewer trials."""
    task = replace(
        TASK, what=("filter.window=3..8",), budget=6_000_000, limits=Limits(2.5), trials=30, sampler="random"
    )
    tune(task, Path("runs/whole"), threads=1)
    study = replace(task, url=str(storage.url_of(None, Path("runs/cut"))), name="cut")
    Path("runs/cut").mkdir()
    for more in (2, 4, 5):  # a process each
        replace(study, trials=more).work(1).run([])
    tune(task, Path("runs/cut"), threads=1, resume=True)
    whole, cut = (
        done(replace(task, url=str(storage.url_of(None, Path("runs") / n)), name=n).open()) for n in ("whole", "cut")
    )
    assert told(whole) == told(cut)
    assert [t.user_attrs["steps"] for t in whole] == [t.user_attrs["steps"] for t in cut]
    after = [t.params["filter.window"] for t in whole[5:]]
    assert set(after) & {t.params["filter.window"] for t in whole[:5]}  # some came again after the cut
    assert len(whole) < 30
    bodies = [tomllib.loads(Path(f"runs/{n}/tuned.toml").read_text(encoding="utf-8")) for n in ("whole", "cut")]
    assert bodies[0]["parameters"] == bodies[1]["parameters"]
    assert bodies[0]["provenance"]["simulated_steps"] == bodies[1]["provenance"]["simulated_steps"]


def test_several_metrics_give_a_front(here, few):
    task = Task(
        "xi2023-improved",
        ("law.kv",),
        metrics=("rms_true", "jitter"),
        limits=Limits(2.0),
        sampler="nsga2",
        seeds=1,
        trials=40,
    )
    result = tune(task, Path("runs/front"), threads=1)
    assert len(result.front) > 2
    points = np.array(sorted(f.values for f in result.front))
    assert (np.diff(points[:, 0]) > 0).all()  # one grows …
    assert (np.diff(points[:, 1]) < 0).all()  # … as the other shrinks
    assert len(list((here / "runs/front/front").glob("*.toml"))) == len(result.front)
    assert (here / "runs/front/plots/front.png").is_file()


def test_what_breaks_limits_by_far_does_not_press_the_front_flat():
    rms = [7.4, 8.0, 9.1, *np.linspace(2000.0, 4000.0, 20)]
    trials = pd.DataFrame({"rms_true": rms, "jitter": np.linspace(0.4, 4.0, 23), "state": "complete"})
    trials["feasible"] = trials["rms_true"] < 10.0
    task = Task("pid", ("law",), metrics=("rms_true", "jitter"), sampler="nsga2")
    front = [types.SimpleNamespace(values=(v, j)) for v, j in zip(rms[:3], trials["jitter"], strict=False)]
    (axes,) = history.pareto(trials, task, front).axes
    low, high = axes.get_xlim()
    assert low < 7.4
    assert 9.1 < high < 20.0


def test_a_number_that_no_finished_trial_has_is_not_drawn():
    """Such as trust, of Kalman filters, where every trial of one was pruned."""
    trials = pd.DataFrame({"trial": range(4), "state": ["complete"] * 3 + ["pruned"], "feasible": True})
    trials = trials.assign(
        **{"law.kp": 10.0, "filter.trust": [math.nan] * 3 + [2.0], "rms_true": [3.0, 2.0, 1.0, math.nan]}
    )
    searched = Task("pid", ("law.kp", "filter.trust")).space.axes
    assert [axis.log for axis in searched] == [True, True]
    figure = history.slices(trials, "pid", searched, "rms_true", "RMS", {})
    assert png(figure)
    assert [axes.get_xlabel() for axes in figure.axes if axes.get_visible()] == ["law.kp"]


def test_jobs_are_tuned_as_teams_or_one_stack_of_them(here, plain, monkeypatch):
    monkeypatch.setattr(
        "kerfgym.experiments.tune.evaluate.chosen",
        lambda suite, *_: (
            [scenarios.load("contour-circle").varied(name="contour-circle", job={"size": 8.0})],
            ("contour-circle",),
        ),
    )
    task = Task("z=pid,xy=wu", ("xy.law.kp=0.1..1",), "contour", ("contour_rms",), seeds=1, trials=8, sampler="tpe")
    result = tune(task, Path("runs/team"), threads=1)
    assert result.found.values[0] < result.before["contour_rms"] * 1.5
    team = stacks.team("runs/team/tuned.toml")
    assert team.xy.parameters()["law.kp"].value == result.found.parameters["xy.law.kp"]
    with pytest.raises(InvalidInput, match="is a team"):
        stacks.resolve("runs/team/tuned.toml")


def test_how_far_the_nearest_candidate_is_from_the_cap_is_said(here, plain, capsys):
    words = ["law.kv=150..200", "-c", "xi2023-improved:law.kv=150", "--seeds", "1", "--trials", "2", "--name", "none"]
    said = refused(capsys, *words)
    (ms,) = re.findall(r"trial \d, breaks: ms ([\d.]+), at most 2 is allowed", said)
    assert float(ms) == pytest.approx(pd.read_csv("runs/none/trials.csv")["ms"].min(), rel=0.01)


def test_no_candidate_that_keeps_the_limits_is_said_and_the_trials_are_kept(here, plain, capsys):
    words = ["law.kv", "-c", "xi2023-improved", "--seeds", "1", "--trials", "4", "--jitter", "0.0001", "--name", "none"]
    assert "no trial keeps all limits; the nearest, trial" in refused(capsys, *words)
    assert len((here / "runs/none/trials.csv").read_text(encoding="utf-8").splitlines()) == 5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["filtr"], "nothing called 'filtr' to tune; did you mean 'filter'?"),
        (["law.kpp", "-c", "pid"], "did you mean 'law.kp'?"),
        (["law.kp=20..900", "-c", "pid"], "law.kp = 900 is out of range; allowed: 1 to 400 1/s"),
        (["law.kp=90..20", "-c", "pid"], "the range is empty"),
        (["law", "--sampler", "tpr"], "unknown sampler 'tpr'; did you mean 'tpe'?"),
        (["law", "-m", "rms_tru"], "unknown metric 'rms_tru'; did you mean 'rms_true'?"),
        (["law", "-m", "rms_true", "-m", "jitter", "--sampler", "cmaes"], "takes one metric"),
        (["law", "--suite", "folowing"], "did you mean 'following'?"),
        (["law", "-c", "wu"], "drives slot 'xy'; suite 'following' needs one of slot 'z'"),
        (["law", "--limit", "time"], "it is written METRIC=NUMBER"),
        (["law", "--trials", "0"], "--trials 0 is out of range"),
        (["law", "--threads", "0"], "--threads 0 is out of range"),
        (["law", "--budget", "1000"], "--budget of 1,000 steps is out of range; one candidate takes 2,244,000"),
        (["law", "--budget", "-5"], "--budget -5: nothing is left"),
        (["law", "--budget", "pidd"], "unknown controller 'pidd'; did you mean 'pid'?"),
        (["law", "--budget", "xi2023-improved"], "--budget xi2023-improved: its record says nothing of"),
        (["law", "-c", "self-tuning", "--budget", "pid"], "nothing is left; 'self-tuning' has had 1,022,400,000"),
        (["law", "--storage", "postgresql://nobody@127.0.0.1:1/x"], "Connection refused"),
        (["law", "--storage", "nonsense://x"], "is not a URL such as postgresql://"),
        (["law", "-c", "nowhere.toml"], "cannot read 'nowhere.toml': No such file"),
    ],
)
def test_bad_input_is_named_and_leaves_nothing_behind(here, capsys, words, message):
    assert message in refused(capsys, *words)
    assert not (here / "runs").exists()


def test_a_folder_that_cannot_be_written_is_an_error_in_words(here, capsys):
    (here / "runs").write_text("in the way", encoding="utf-8")
    assert "cannot write" in refused(capsys, *QUICK, "--name", "x")


# -------------------------------------------------------------------------------------- processes: kill, join, share


def command(folder, *words, **more):
    """The command in a process of its own."""
    code = (
        "import sys; from kerfgym.experiments.tune import outcome; outcome.TEST_SEEDS = 2;"
        "from kerfgym.experiments.tune import history; history.write = lambda *_: [];"
        "from kerfgym.experiments.cli import main; main(sys.argv[1:])"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code, "tune", *QUICK, "--threads", "1", *words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **more,
    )


def finished(process):
    """Its output, after it ended well."""
    out, err = process.communicate(timeout=200)
    assert process.returncode == 0, err
    return out


def test_a_killed_study_goes_on_and_is_the_same_trial_by_trial(here, plain, whole):
    journal = here / "runs" / "killed" / storage.JOURNAL
    process = command(here, "--name", "killed")
    until = time.time() + 120
    while not (journal.is_file() and journal.read_text(errors="ignore").count('"op_code":6') >= 5):
        assert time.time() < until
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not (here / "runs/killed/run.json").exists()
    study = TASK_AT("runs/killed").open()
    left = len(done(study))
    assert 5 <= left < 12
    assert len(abandoned(study, exclusive=True)) <= 1
    tune(TASK, Path("runs/killed"), threads=1, resume=True)
    assert told(TASK_AT("runs/killed").open().trials) == whole[0]
    body = tomllib.loads((here / "runs/killed/tuned.toml").read_text(encoding="utf-8"))
    assert {k: float(v) for k, v in body["parameters"].items()} == whole[1]


@pytest.fixture(scope="module")
def postgresql(tmp_path_factory):
    """URL of a server of our own; skipped with the reason where none can be started."""
    pytest.importorskip("psycopg")
    places = [Path("/usr/local/bin"), *sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)]
    place = next((p for p in places if (p / "initdb").is_file()), None)
    if place is None and shutil.which("initdb"):
        place = Path(shutil.which("initdb")).parent
    if place is None:
        pytest.skip("PostgreSQL's initdb is not installed")
    folder = tmp_path_factory.mktemp("postgresql")
    become = {}
    if os.geteuid() == 0:  # the server refuses to run as root
        import pwd

        user = next((u for u in ("postgres", "nobody") if any(p.pw_name == u for p in pwd.getpwall())), None)
        if user is None:
            pytest.skip("PostgreSQL does not run as root, and there is no other user")
        for above in (folder, *folder.parents):
            if above.stat().st_uid == 0 and above != Path("/tmp") and above.is_relative_to("/tmp"):
                above.chmod(above.stat().st_mode | 0o011)
        shutil.chown(folder, user)
        become = {"user": user, "group": pwd.getpwnam(user).pw_gid, "extra_groups": []}
    data = folder / "data"

    def run(*words):
        done = subprocess.run(
            words,
            capture_output=True,
            text=True,
            cwd=folder,
            timeout=120,
            env={**os.environ, "HOME": str(folder)},
            **become,
        )
        return done.returncode, done.stdout + done.stderr

    code, text = run(place / "initdb", "-D", data, "-A", "trust", "-U", "kerf", "--no-sync", "-E", "UTF8")
    if code:
        pytest.skip(f"initdb fails here: {text.strip().splitlines()[-1]}")
    options = f"-k {folder} -c listen_addresses='' -c fsync=off"
    code, text = run(place / "pg_ctl", "-D", data, "-o", options, "-w", "-l", folder / "log", "start")
    if code:
        pytest.skip(f"PostgreSQL does not start here: {text.strip().splitlines()[-1]}")
    yield f"postgresql://kerf@/postgres?host={folder}"
    run(place / "pg_ctl", "-D", data, "-m", "immediate", "stop")


def test_two_processes_started_together_share_a_fresh_database(here, postgresql):
    for name in ("a", "b"):
        (here / name).mkdir()
    together = [command(here / name, "--storage", postgresql, "--name", "shared") for name in ("a", "b")]
    for process in together:
        finished(process)
    study = optuna.load_study(study_name="shared", storage=storage.opened(postgresql))
    trials = [t for t in study.trials if t.state.name in ("COMPLETE", "PRUNED")]
    assert len(trials) == 12
    assert len({t.user_attrs["worker"] for t in trials}) == 2
    results = [(here / name / "runs/shared/tuned.toml").read_text(encoding="utf-8") for name in ("a", "b")]
    assert tomllib.loads(results[0])["parameters"] == tomllib.loads(results[1])["parameters"]
    other = replace(TASK, url=postgresql, name="shared", seed=5)
    with pytest.raises(InvalidInput, match=r"is another one \(it has: seed 0; asked for: seed 5\)"):
        tune(other, Path("runs/other"))
    assert not Path("runs").exists()


def test_what_a_process_that_died_meanwhile_left_is_finished(here, plain):
    task = replace(TASK, url=f"sqlite:///{here / 'study.db'}", name="x", trials=5)
    left = []

    def dies(*_):
        """Another process takes a trial and is gone."""
        if not left:
            study = task.open()
            left.append(study.ask().number)
            study._storage.set_trial_user_attr(study.trials[-1]._trial_id, WORKER, f"{socket.gethostname()}/1/0")

    crew.carried_out(task, 1, 1, dies)
    trials = task.open().trials
    assert left == [0]
    assert [t.state.is_finished() for t in trials] == [True] * 5


def test_several_workers_share_a_study(here, plain):
    tune(TASK, Path("runs/two"), workers=2, threads=1)
    trials = done(TASK_AT("runs/two").open())
    assert len(trials) == 12
    assert len({t.user_attrs["worker"] for t in trials}) == 2
