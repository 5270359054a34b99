"""Search of a training's settings: spaces, short trainings as trials, what is left of a kill, and what comes out."""

import csv
import json
import math
import os
import signal
import subprocess
import sys
import time
import tomllib
from dataclasses import replace

import numpy as np
import optuna
import pytest
from PIL import Image

from kerfgym.agents import settings
from kerfgym.agents.evaluation import Evaluation
from kerfgym.agents.train import CHECKPOINT, Training, train
from kerfgym.envs import scenarios
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.cli import main
from kerfgym.experiments.tune import learners, storage, trainings
from kerfgym.experiments.tune.hyper import KNOBS, Hyper
from kerfgym.experiments.tune.space import start_of
from kerfgym.experiments.tune.trainings import TrainingTask
from kerfgym.experiments.tune.work import abandoned, done

HEIGHT, CONTOUR, CUTTING = settings.TASKS
TINY = {
    "environment.num_envs": 8,
    "environment.max_steps": 30,
    "environment.scenario": "tilt",
    "policy.net_arch": [8],
    "evaluation.scenario": "tilt",
    "evaluation.max_steps": 20,
    "evaluation.episodes": 2,
    "algorithm.n_steps": 8,
    "algorithm.batch_size": 16,
    "algorithm.n_epochs": 2,
    "steps": 2560,
    "checkpoint.every": 26,
}
BASE = settings.preset("ppo", HEIGHT, TINY)
TASK = TrainingTask(BASE, steps=256, trials=6)
WORDS = ["ppo", "--steps", "256", "--trials", "6"]
for _key, _value in TINY.items():
    WORDS += ["--set", f"{_key}={json.dumps(_value)}"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The tiny search by its command, not interrupted: its folder."""
    place = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        main(["tune", *WORDS, "--name", "x"])
    return place / "runs" / "x"


def told(folder):
    """What two runs of the same study must agree in."""
    study = optuna.load_study(study_name=folder.name, storage=storage.opened(str(folder / storage.JOURNAL)))
    costs = ("steps", "training_steps", "best_at", "error")
    return [
        (t.number, t.state.name, t.values, t.params, t.intermediate_values, [t.user_attrs.get(c) for c in costs])
        for t in study.trials
    ]


# -------------------------------------------------------------------------------------------------------------- space


LEARNT = [(name, env) for name in settings.ALGORITHMS for env in settings.LEARNS.get(name, settings.TASKS)]


@pytest.mark.parametrize(("name", "env"), LEARNT)
def test_the_search_begins_at_the_preset(name, env):
    base = settings.preset(name, env)
    hyper = Hyper(base)
    again, mine = (s.flat() for s in (hyper.settings(start_of(hyper.space)), base))
    for key, value in again.items():
        if isinstance(value, int | float):  # an entropy's weight of 0 is not on a logarithmic scale
            assert value == pytest.approx(base.value(key), rel=1e-6, abs=1e-6), key
        else:
            assert value == mine[key], key
    assert {knob.key for knob in hyper.knobs} >= {KNOBS[name][0].key, KNOBS[name][1].key}
    assert len(hyper.space.axes) >= len(KNOBS[name])  # all of them, or all but a spread for each action


def test_every_point_of_the_space_is_a_training_that_could_be():
    random = np.random.default_rng(0)
    for name in ("ppo", "sac", "recurrent-ppo"):
        base = settings.preset(name, HEIGHT)
        hyper = Hyper(base)
        for _ in range(40):
            point = {}
            for axis in hyper.space.axes:
                point[axis.name] = str(random.choice(axis.choices)) if axis.choices else axis.decode(random.random())
            given = hyper.settings(point)
            assert settings.checked(given) is given
            assert 1.0 - given.algorithm["gamma"] == pytest.approx(point["1 - algorithm.gamma"], abs=1e-5)
            for key in ("algorithm.n_steps", "algorithm.gradient_steps"):
                if base.value(key) is not None:
                    assert math.log2(given.value(key) / base.value(key)) in (-2, -1, 0, 1, 2)
            if name != "sac":
                assert given.algorithm["batch_size"] <= given.algorithm["n_steps"] * base.environment["num_envs"]
                rates = [
                    s.value("algorithm.final_learning_rate") / s.value("algorithm.learning_rate") for s in (given, base)
                ]
                assert rates[0] == pytest.approx(rates[1], rel=1e-3)


# ------------------------------------------------------------------------------------------------------------ command


def test_the_first_trial_is_a_training_of_the_preset(whole, tmp_path):
    found = told(whole)
    assert len(found) == 6
    assert {state for _, state, *_ in found} <= {"COMPLETE", "PRUNED"}
    alone = train(TASK.short(BASE), tmp_path)
    number, _, values, _, looks, (steps, training_steps, best_at, _) = found[0]
    assert (number, values, best_at) == (0, [alone.score], alone.best_at)
    assert (steps, training_steps) == (alone.ledger["simulated_steps"], 256)
    assert min(looks.values()) == alone.score
    assert sorted(looks.values()) == sorted(row["score"] for row in alone.evaluations)


def test_the_best_settings_can_be_trained_with(whole, here, capsys):
    about = json.loads((whole / "run.json").read_text(encoding="utf-8"))
    with (whole / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    best = min((r for r in rows if r["state"] == "complete"), key=lambda r: float(r["score"]))
    assert about["tuned"]["trial"] == int(best["trial"])
    assert about["tuned"]["score_tune"] == float(best["score"])
    ledger = about["ledger"]["tuning"]
    assert ledger["simulated_steps"] == sum(int(r["steps"]) for r in rows) > 5 * 256
    assert ledger["cpu_seconds"] > 0
    assert ledger["seeds"] == {"tune": "0-1", "train": f"from {scenarios.SPLITS['train'].start}"}
    file = whole / "ppo.toml"
    body = tomllib.loads(file.read_text(encoding="utf-8"))
    assert (body["name"], body["env"], body["steps"]) == ("ppo", HEIGHT, 2560)  # as long as the preset's
    assert body["provenance"]["study"] == about["study"]
    assert body["algorithm"]["learning_rate"] == pytest.approx(float(best["algorithm.learning_rate"]), rel=1e-3)
    assert not list(whole.glob("trials/*/parts"))
    for name in ("history", "slices"):
        with Image.open(whole / "plots" / f"{name}.png") as picture:
            assert picture.size[0] > 600
    main(["train", "ppo", "--preset", str(file), "--no-ms", "--steps", "64", "--name", "y"])
    trained = json.loads((here / "runs/y/run.json").read_text(encoding="utf-8"))
    assert trained["env"] == HEIGHT
    assert trained["settings"] == {**about["settings"], "steps": 64}
    capsys.readouterr()
    for words, message in (
        (["sac", "--preset", str(file)], "is for algorithm 'ppo', not 'sac'"),
        (["ppo", "--preset", str(file), "--env", CUTTING], f"is for environment '{HEIGHT}', not '{CUTTING}'"),
        (["ppo", "--preset", "nowhere.toml"], "cannot read 'nowhere.toml': No such file"),
        (["ppo", "--preset", str(whole / "plots/history.png")], "is not UTF-8 (byte 0x89)"),
    ):
        with pytest.raises(SystemExit):
            main(["train", *words, "--name", "z"])
        assert message in capsys.readouterr().err
    assert not (here / "runs/z").exists()


def test_the_same_command_gives_the_same_study_even_if_it_is_killed(whole, here, capsys):
    """A trial that was half-way goes on from its checkpoint; in earnest, by a signal that nothing can catch."""
    code = "import sys; from kerfgym.experiments.cli import main; main(sys.argv[1:])"
    more = ["--name", "x"]
    process = subprocess.Popen(
        [sys.executable, "-c", code, "tune", *WORDS, *more],
        cwd=here,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    folder, until = here / "runs" / "x", time.monotonic() + 120
    while not (folder / "trials" / "0002" / CHECKPOINT).is_file():
        assert time.monotonic() < until
        assert process.poll() is None
        time.sleep(0.002)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    study = replace(TASK, url=str(folder / storage.JOURNAL), name="x").open()
    assert 2 <= len(done(study)) < 6
    assert len(abandoned(study, exclusive=True)) <= 1
    with pytest.raises(SystemExit):
        main(["tune", *WORDS, *more, "--threads", "2"])
    assert "--resume to finish it" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["tune", *WORDS, *more, "--resume", "--steps", "128"])
    assert "is another one (it has: steps 256; asked for: steps 128)" in capsys.readouterr().err
    main(["tune", *WORDS, *more])
    assert told(folder) == told(whole)
    bodies = [tomllib.loads((place / "ppo.toml").read_text(encoding="utf-8")) for place in (folder, whole)]
    assert bodies[0]["algorithm"] == bodies[1]["algorithm"]


def test_an_interrupted_trial_goes_on_from_its_checkpoint(whole, tmp_path, monkeypatch):
    """And one whose checkpoint is damaged from its beginning; both end as if nothing had happened."""
    task, keep, begun = replace(TASK, trials=2), Training.keep, []

    def interrupted(training):
        keep(training)
        if "0001" in str(training.folder) and training.model.num_timesteps >= 100:
            raise KeyboardInterrupt

    def counted(training):
        begun.append(training.model.num_timesteps)
        return finish(training)

    finish = Training.finish
    for damaged in (False, True):
        folder = tmp_path / str(damaged)
        with monkeypatch.context() as patch:
            patch.setattr(Training, "keep", interrupted)
            with pytest.raises(KeyboardInterrupt):
                learners.tune(task, folder)
        if damaged:
            (folder / "trials" / "0001" / CHECKPOINT).write_bytes(b"cut off")
        with monkeypatch.context() as patch:
            patch.setattr(Training, "finish", counted)
            learners.tune(task, folder, resume=True)
        assert told(folder) == told(whole)[:2]
    assert begun[0] >= 100
    assert begun[1:] == [0]


def test_a_training_worse_than_the_median_is_ended(tmp_path, monkeypatch):
    """Scores here only get worse, so the second trial is worse than the first at each look."""
    calls = []

    def score(evaluator, model):
        calls.append(model.num_timesteps)
        return Evaluation(float(len(calls)), 0.0, 0, 10)

    monkeypatch.setattr("kerfgym.agents.evaluation.Evaluator.__call__", score)
    monkeypatch.setattr(trainings, "PRUNE_TRIALS", 1)
    result = learners.tune(replace(TASK, trials=2), tmp_path / "x")
    (first, second) = done(result.task.open())
    assert (first.state.name, second.state.name) == ("COMPLETE", "PRUNED")
    assert first.user_attrs["training_steps"] == 256
    assert second.user_attrs["training_steps"] == calls[-1] < 256
    looks = len(second.intermediate_values)
    assert second.user_attrs["steps"] == calls[-1] + 10 * looks
    assert looks >= 2


def test_trainings_whose_numbers_run_away_count_as_failed(tmp_path):
    """The first trial is the preset; a rate of 1e18 leaves no finite weight."""
    task = replace(TASK, base=BASE.varied({"algorithm.learning_rate": 1e18}), trials=2)
    result = learners.tune(task, tmp_path / "runs")
    with (tmp_path / "runs" / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == ["failed", "complete"]
    assert "no finite numbers" in rows[0]["error"]
    assert int(rows[0]["steps"]) > 0
    assert result.best.number == 1
    assert result.meta["tuned"]["failed"] == 1
    assert 1e-4 <= result.settings.algorithm["learning_rate"] <= 1e-2
    with pytest.raises(InvalidInput, match="none of 1 trainings ended with a finite score"):
        learners.tune(replace(task, trials=1), tmp_path / "none")


def test_off_policy_learners_are_searched_too(tmp_path):
    tiny = {
        **{k: v for k, v in TINY.items() if "algorithm" not in k},
        "algorithm.learning_starts": 32,
        "algorithm.batch_size": 16,
        "algorithm.gradient_steps": 1,
        "algorithm.buffer_size": 500,
    }
    result = learners.tune(
        TrainingTask(settings.preset("td3", HEIGHT, tiny), 128, sampler="random", trials=2), tmp_path / "td3"
    )
    assert {"algorithm.tau", "algorithm.noise", "algorithm.train_freq"} <= set(result.best.params)
    assert result.file.name == "td3.toml"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["pppo"], "did you mean 'ppo'?"),
        (["pppo", "--steps", "100"], "unknown algorithm 'pppo'; did you mean 'ppo'?"),
        (["ppo", "sac"], "one algorithm is tuned at a time"),
        (["ppo", "--env", "kerfgym/Cuting-v0"], "unknown environment 'kerfgym/Cuting-v0'; did you mean"),
        (["ppo", "--sampler", "tpr"], "unknown sampler 'tpr'; did you mean 'tpe'?"),
        (["ppo", "--ms", "2"], "--ms is for controllers"),
        (["ppo", "--trials", "0"], "--trials 0 is out of range"),
        (["ppo", "--steps", "0"], "--steps 0 is out of range"),
        (["ppo", "--set", "algorithm.gama=0.9"], "did you mean 'algorithm.gamma'"),
        ([*WORDS, "--set", "evaluation.scenario=wavi"], "did you mean 'wavy'"),
        ([*WORDS, "--storage", "postgresql://nobody@127.0.0.1:1/x"], "Connection refused"),
    ],
)
def test_bad_input_is_named_and_leaves_nothing_behind(here, capsys, words, message):
    with pytest.raises(SystemExit) as error:
        main(["tune", *words])
    assert error.value.code == 2
    assert message in capsys.readouterr().err
    assert not (here / "runs").exists()
