"""Several trainings of one method: what is made, kept and told, and whether a policy beats its base."""

import json
import math
import shutil

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3

from kerfgym.agents import settings
from kerfgym.agents.policy import Policy
from kerfgym.agents.train import Diverged
from kerfgym.agents.train import train as learn
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.experiments.cli import main
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.statistics import comparison
from kerfgym.experiments.studies import recorded
from kerfgym.experiments.train import folder as single
from kerfgym.experiments.train import held_out, several

HEIGHT = "kerfgym/HeightFollowing-v0"
TINY = {
    "environment.num_envs": 4,
    "environment.max_steps": 30,
    "environment.scenario": "tilt",
    "policy.net_arch": [8],
    "evaluation.scenario": "tilt",
    "evaluation.max_steps": 20,
    "evaluation.episodes": 2,
    "algorithm.n_steps": 16,
    "algorithm.batch_size": 32,
    "algorithm.n_epochs": 2,
    "steps": 256,
}
WORDS = ["train", "ppo", "--seed", "3", "--test-seeds", "4", "--no-ms", "--name", "x"]
for _key, _value in TINY.items():
    WORDS += ["--set", f"{_key}={json.dumps(_value)}"]
THREE = [*WORDS, "--seeds", "3", "--jobs", "1"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three tiny trainings by their command: the folder in which it worked."""
    place = tmp_path_factory.mktemp("trainings")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        main(THREE)
    return place / "runs" / "x"


def record(folder):
    return json.loads((folder / "run.json").read_text(encoding="utf-8"))


def test_each_training_is_the_one_that_its_seed_makes_alone(made, tmp_path):
    table = pd.read_csv(made / several.TABLE).set_index("training")
    for seed in (3, 5):
        alone = learn(settings.preset("ppo", HEIGHT, TINY), tmp_path / str(seed), seed)
        mine = record(made / f"seed-{seed}")
        assert mine["best"]["score_tune"] == alone.score
        assert mine["ledger"]["simulated_steps"] == alone.ledger["simulated_steps"]
        assert table.loc[f"seed {seed}", "score_tune"] == pytest.approx(alone.score, rel=1e-5)
    whole = record(made)
    assert whole["seeds"] == [3, 4, 5]
    each = [record(made / f"seed-{seed}")["ledger"]["simulated_steps"] for seed in whole["seeds"]]
    assert whole["ledger"]["simulated_steps"] == sum(each)


def test_policies_and_base_are_scored_on_the_same_test_seeds(made, monkeypatch):
    """Against roll-outs of their own."""
    monkeypatch.chdir(made.parents[1])
    found = record(made)
    assert found["test"]["seeds"] == "1000-1003"
    assert found["test"]["base"] == "self-tuning"
    assert set(found["test"]["controllers"]) == {
        "seed 3",
        "seed 4",
        "seed 5",
        "self-tuning",
        held_out.CLASSICAL[HEIGHT],
    }
    scores = {}
    tilt = scenarios.load("tilt")
    for name in ("seed 4", "self-tuning"):
        words = str(made / "seed-4" / "policy") if name == "seed 4" else name
        seen = rollout.roll(tilt, stack.resolve(words), range(1000, 1004))
        error = seen["gap"][tilt.settle_steps :] - seen.set_height
        scores[name] = 1e3 * math.sqrt(np.mean(error**2))
        assert found["test"]["controllers"][name]["score"] == pytest.approx(scores[name], rel=1e-4)
    ratio = found["test"]["controllers"]["seed 4"]["ratio"]
    assert ratio == pytest.approx(scores["self-tuning"] / scores["seed 4"], rel=1e-4)
    low, high = (found["test"]["controllers"]["seed 4"][f"ratio_{end}"] for end in ("low", "high"))
    assert low <= ratio <= high


@pytest.mark.parametrize("env", held_out.CLASSICAL)
def test_the_best_classical_controller_is_that_of_the_recorded_study(env):
    found, shipped = recorded.read(held_out.suite_of(env))["numbers"], set(stack.names())
    informed = {name: row for name, row in found.items() if name in shipped and row.get("information") == "sensor"}
    assert len(informed) > 5
    assert min(informed, key=lambda name: informed[name]["score"]) == held_out.CLASSICAL[env]


def test_reports_know_them_as_runs_of_one_method(made, monkeypatch):
    monkeypatch.chdir(made.parents[1])
    policies = [str(made / f"seed-{seed}" / "policy") for seed in (3, 4, 5)]
    (row,) = comparison.methods(held_out.compared(settings.preset("ppo", HEIGHT, TINY), policies, 4)).to_dict("records")
    assert row["members"] == policies
    told = record(made)["method"]
    assert told["trainings"] == 3
    assert told["best"] <= told["median"] <= told["worst"]
    assert told["score_low"] <= told["score"] <= told["score_high"]


def test_finished_trainings_are_kept_when_the_command_goes_on(made, monkeypatch, tmp_path, capsys):
    shutil.copytree(made, tmp_path / "runs" / "x")
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "runs" / "x"
    (folder / "run.json").unlink()
    (folder / several.TABLE).unlink()
    shutil.rmtree(folder / "seed-4")
    done = []
    begun = several._trained
    monkeypatch.setattr(several, "_trained", lambda task: done.append(task.seed) or begun(task))
    main([*THREE, "--resume"])
    assert done == [4]
    assert "3 trainings: median" in capsys.readouterr().out
    old, new = (pd.read_csv(x / several.TABLE).drop(columns="cpu_seconds") for x in (made, folder))
    pd.testing.assert_frame_equal(old, new)
    (folder / "run.json").unlink()
    with pytest.raises(SystemExit):
        main([*THREE, "--resume", "--set", "algorithm.gamma=0.5"])
    assert "trained with other settings" in capsys.readouterr().err


def test_a_training_that_diverges_loses_no_other(made, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    begun = several.single.into

    def into(place, given, seed, *rest, **more):
        if seed == 4:
            raise Diverged("no finite numbers")
        return begun(place, given, seed, *rest, **more)

    monkeypatch.setattr(several.single, "into", into)
    several_ = [*THREE[: THREE.index("--test-seeds")], "--test-seeds", "0", *THREE[THREE.index("--no-ms") :]]
    main(several_)
    table = pd.read_csv(tmp_path / "runs" / "x" / several.TABLE).set_index("training")
    assert table["diverged"].to_list() == [False, True, False]
    assert record(tmp_path / "runs" / "x")["diverged"] == {"seed 4": "no finite numbers"}


def test_one_training_too_says_whether_it_beats_its_base(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    main(WORDS)
    said = capsys.readouterr().out
    assert "the policy is" in said
    assert said.count("self-tuning") >= 2
    assert set(record(tmp_path / "runs" / "x")["test"]["controllers"]) >= {"policy", "self-tuning"}


OFF = {"learning_starts": 64, "batch_size": 16, "gradient_steps": 1, "buffer_size": 1000}
OWN = {
    "ppo": (PPO, {"n_steps": 16, "batch_size": 32, "n_epochs": 2}),
    "sac": (SAC, OFF),
    "td3": (TD3, OFF),
    "tqc": (TQC, OFF),
    "recurrent-ppo": (RecurrentPPO, {"n_steps": 16, "batch_size": 32, "n_epochs": 2}),
}


@pytest.mark.parametrize("name", OWN)
def test_what_stable_baselines_loads_acts_as_the_artefact(name, tmp_path):
    """On what a machine shows, from the beginning of an episode."""
    learner, given = OWN[name]
    changes = {key: value for key, value in TINY.items() if not key.startswith("algorithm")}
    changes |= {f"algorithm.{key}": value for key, value in given.items()}
    folder = single.into(tmp_path, settings.preset(name, HEIGHT, changes), 0, "cpu", 1, False, quiet=True)
    model, policy = learner.load(folder / single.MODEL, device="cpu"), Policy.load(folder / single.POLICY)
    assert (folder / single.MODEL).stat().st_size < 2_000_000, "networks, and no replay buffer"
    env, state, largest = gym.make(HEIGHT, scenario="tilt"), None, 0.0
    seen, _ = env.reset(seed=7)
    for i in range(1000):
        its, state = model.predict(seen, state, np.array([i == 0]), deterministic=True)
        mine = policy.act(seen, start=i == 0)
        largest = max(largest, float(np.abs(its - mine).max()))
        seen, *_ = env.step(mine)
    assert float(np.abs(mine).max()) > 0.0
    assert largest < 1e-5


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [(1.01, 1.2, "better than b"), (0.8, 0.99, "worse than b"), (0.9, 1.1, "not distinguishable from b")],
)
def test_the_verdict_is_the_interval_s(low, high, said):
    assert held_out.verdict(low, high, "b") == said
    assert "not comparable" in held_out.verdict(math.nan, math.nan, "b")


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--seeds", "0"], "--seeds 0"), (["--jobs", "0"], "--jobs 0"), (["--test-seeds", "201"], "201 is out of range")],
)
def test_numbers_out_of_range_are_named_and_leave_no_folder(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["train", "ppo", *words])
    assert said in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
