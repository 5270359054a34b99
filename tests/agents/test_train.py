"""Training: every algorithm on every environment, killed and resumed, and what it says to bad input."""

import csv
import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
import tomllib

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from kerfgym.agents import checkpoint, settings
from kerfgym.agents.evaluation import Evaluator
from kerfgym.agents.learner import environment, falling, learner
from kerfgym.agents.spread import SpreadPolicy
from kerfgym.agents.train import CHECKPOINT, curves_are_written, train
from kerfgym.envs import scenarios
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments import cli

HEIGHT, CONTOUR, CUTTING = settings.TASKS
TINY = {
    "environment.num_envs": 4,
    "environment.max_steps": 30,
    "environment.scenario": "tilt",
    "policy.net_arch": [8],
    "evaluation.scenario": "tilt",
    "evaluation.max_steps": 20,
    "evaluation.episodes": 2,
    "evaluation.every": 128,
    "checkpoint.every": 64,
    "steps": 256,
}
ON = {"algorithm.n_steps": 16, "algorithm.batch_size": 32, "algorithm.n_epochs": 2}
OFF = {
    "algorithm.learning_starts": 64,
    "algorithm.batch_size": 16,
    "algorithm.gradient_steps": 1,
    "algorithm.buffer_size": 1000,
}
MORE = {
    "ppo": ON,
    "sac": OFF,
    "td3": OFF,
    "tqc": {**OFF, "policy.n_quantiles": 5},
    "recurrent-ppo": {**ON, "policy.lstm_hidden_size": 8},
}
JOB = {CONTOUR: "contour-square", CUTTING: "cut-square"}


def tiny(name, env=HEIGHT, **changes):
    more = {**TINY, **MORE[name]}
    if env in JOB:
        more |= {"environment.scenario": JOB[env], "evaluation.scenario": JOB[env]}
    return settings.preset(name, env, {**more, **{key.replace("__", "."): value for key, value in changes.items()}})


LEARNT = [(name, env) for name in settings.ALGORITHMS for env in settings.LEARNS.get(name, settings.TASKS)]


@pytest.mark.parametrize(("name", "env"), LEARNT)
def test_a_preset_stands_for_every_algorithm_on_every_environment_and_is_accepted(name, env):
    given = settings.preset(name, env)
    if env == HEIGHT or name == "ppo":  # the algorithms' arguments are the same elsewhere; environments take long
        given = given.varied({"environment.num_envs": 16})
        model = learner(given, environment(given), seed=0)
        assert type(model).__name__.lower() == name.replace("-", "")
        assert name == "gradient" or model.gamma == given.algorithm["gamma"]
    text = settings.preset_file(name, env).read_text(encoding="utf-8")
    bare = [line for line in text.splitlines() if "=" in line and "#" not in line]
    assert not [line for line in bare if not line.startswith(("steps", "num_envs", "n_quantiles"))], bare  # reasons


@pytest.mark.parametrize(("name", "env"), [*((name, HEIGHT) for name in MORE), ("ppo", CONTOUR), ("sac", CUTTING)])
def test_a_training_ends_with_its_best_policy_and_a_ledger(tmp_path, name, env):
    trained = train(tiny(name, env), tmp_path)
    with (tmp_path / "evaluations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["steps"]) for row in rows] == [128, 256]
    assert trained.score == min(float(row["score"]) for row in rows)
    assert trained.ledger["training_steps"] == 256
    periods = 1 if env == HEIGHT else 8
    assert trained.ledger["simulated_steps"] == periods * (256 + trained.ledger["evaluation_steps"])
    assert Evaluator(tiny(name, env))(trained.model).score == trained.score
    assert list((tmp_path / "tensorboard").iterdir())


def test_the_score_is_the_geometric_mean_of_the_scenarios_rms_error():
    """Against a loop of the single environment."""
    import gymnasium

    given = tiny("ppo", evaluation__scenario=["tilt", "wavy"], evaluation__max_steps=350, evaluation__episodes=3)
    model = learner(given, environment(given), seed=0)
    found = Evaluator(given)(model)
    errors: dict[str, list[float]] = {}
    env = gymnasium.make(
        HEIGHT, scenario=["tilt", "wavy"], base=given.environment["base"], split="tune", max_steps=350
    ).unwrapped
    for seed in range(3):
        seen, _ = env.reset(options={"scenario_seed": seed})
        mine = errors.setdefault(env.scenario.name, [])
        for period in range(349):
            seen, *_, info = env.step(model.predict(seen, deterministic=True)[0])
            if period >= 300:
                mine.append(info["true_error"])
    rms = {name: 1e3 * np.sqrt(np.mean(np.square(values))) for name, values in errors.items()}
    assert found.scenarios == pytest.approx(rms, rel=1e-3)
    assert found.score == pytest.approx(np.exp(np.mean(np.log(list(rms.values())))), rel=1e-3)
    assert found.steps == 3 * 350


@pytest.mark.parametrize("name", ["ppo", "sac", "recurrent-ppo"])
def test_a_training_in_two_parts_is_the_same_bits_as_one_in_one_go(tmp_path, name):
    whole = train(tiny(name), tmp_path / "whole", seed=3)
    with pytest.raises(KeyboardInterrupt):
        train(tiny(name), tmp_path / "parts", seed=3, told=interrupt_at(140))
    kept = checkpoint.read(tmp_path / "parts" / CHECKPOINT)
    assert 0 < kept["model"]["counters"]["num_timesteps"] < 256
    again = train(tiny(name), tmp_path / "parts", seed=3, resume=True)
    for key, value in whole.model.policy.state_dict().items():
        assert torch.equal(value, again.model.policy.state_dict()[key]), key
    assert [row["score"] for row in again.evaluations] == [row["score"] for row in whole.evaluations]
    steps = ("simulated_steps", "training_steps", "evaluation_steps", "seeds")
    assert {key: again.ledger[key] for key in steps} == {key: whole.ledger[key] for key in steps}


def interrupt_at(steps):
    def told(done, *_):
        if done >= steps:
            raise KeyboardInterrupt

    return told


def test_other_seeds_train_other_policies(tmp_path):
    one, other = (train(tiny("ppo"), tmp_path / str(seed), seed) for seed in (0, 1))
    assert one.score != other.score


def test_killed_in_earnest_the_same_command_goes_on_to_the_same_policy(tmp_path):
    words = ["train", "ppo", "--no-ms", "--steps", "4096", "--name", "x"]
    for key, value in {**TINY, **ON, "evaluation.every": 1024, "checkpoint.every": 512}.items():
        if key != "steps":
            words += ["--set", f"{key}={json.dumps(value)}"]
    command = [sys.executable, "-m", "kerfgym.experiments.cli", *words]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL)
    file, until = tmp_path / "runs" / "x" / CHECKPOINT, time.monotonic() + 120
    while not file.is_file() and time.monotonic() < until and process.poll() is None:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert not (tmp_path / "runs" / "x" / "run.json").exists()
    kept = checkpoint.read(file)["model"]["counters"]["num_timesteps"]
    assert 512 <= kept < 4096
    before = os.getcwd()
    os.chdir(tmp_path)
    try:
        with pytest.raises(SystemExit):  # another command does not touch what is there
            cli.main([*words, "--seed", "1"])
        cli.main(words)
        cli.main(["whole" if word == "x" else word for word in words])
    finally:
        os.chdir(before)
    parts, whole = (checkpoint.read(tmp_path / "runs" / name / CHECKPOINT) for name in ("x", "whole"))
    for key, value in whole["model"]["parameters"]["policy"].items():
        assert torch.equal(value, parts["model"]["parameters"]["policy"][key]), key
    record = json.loads((tmp_path / "runs" / "x" / "run.json").read_text())
    assert record["ledger"]["training_steps"] == 4096
    assert record["settings"]["algorithm.n_steps"] == 16


def test_a_checkpoint_that_holds_something_else_is_refused(tmp_path):
    train(tiny("ppo"), tmp_path)
    whole = checkpoint.read(tmp_path / CHECKPOINT)
    for key in ("identity", "model", "best", "rows"):
        content = {name: value for name, value in whole.items() if name != key}
        checkpoint.write(tmp_path / CHECKPOINT, content)
        with pytest.raises(InvalidInput, match="does not fit its training"):
            train(tiny("ppo"), tmp_path, resume=True)


def test_curves_that_the_disk_does_not_take_are_one_line(tmp_path, capfd):
    def fails():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def writes():
        with curves_are_written(tmp_path / "curves"):
            thread = threading.Thread(target=fails)  # as tensorboard's, which raises it once more where it is flushed
            thread.start()
            thread.join()
            fails()

    before = threading.excepthook
    with pytest.raises(InvalidInput, match=r"cannot write '.*curves': No space left on device; nothing written before"):
        writes()
    assert capfd.readouterr().err == ""
    assert threading.excepthook is before


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    train(tiny("ppo"), tmp_path)
    with pytest.raises(InvalidInput, match=r"trained with algorithm.gamma = 0.96, not 0.9; use the same command"):
        train(tiny("ppo", algorithm__gamma=0.9), tmp_path, resume=True)
    with pytest.raises(InvalidInput, match=r"trained with seed = 0, not 1"):
        train(tiny("ppo"), tmp_path, seed=1, resume=True)


def test_a_damaged_checkpoint_is_refused_and_nothing_in_it_is_run(tmp_path):
    import pickle

    file = tmp_path / CHECKPOINT
    file.parent.mkdir()

    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "ran"), "w"))

    file.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(InvalidInput, match="is not a checkpoint"):
        train(tiny("ppo"), tmp_path, resume=True)
    torch.save({"format": checkpoint.FORMAT, "model": Bomb()}, file)
    with pytest.raises(InvalidInput, match="is not a checkpoint"):
        train(tiny("ppo"), tmp_path, resume=True)
    assert not (tmp_path / "ran").exists()
    checkpoint.write(file, {"model": 1})
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(InvalidInput, match="damaged"):
        checkpoint.read(file)


def test_what_cannot_be_written_leaves_the_last_checkpoint(tmp_path):
    file = tmp_path / "checkpoint.pt"
    checkpoint.write(file, {"a": 1})
    with pytest.raises(InvalidInput, match=r"cannot write .*: No space left.*nothing written before is lost"):
        fill_the_disk(file)
    assert checkpoint.read(file)["a"] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint.pt"]


def test_a_full_disk_is_named_though_torch_speaks_of_positions(tmp_path, monkeypatch):
    def full(*_):
        raise RuntimeError("[enforce fail at inline_container.cc:672] . unexpected pos 163776 vs 163664")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(InvalidInput, match=r"checkpoint\.pt': \[enforce fail"):
        checkpoint.write(tmp_path / "checkpoint.pt", {})
    monkeypatch.setattr(checkpoint, "LITTLE", 2**63)
    with pytest.raises(InvalidInput, match=r"checkpoint\.pt': No space left on device; nothing written before is lost"):
        checkpoint.write(tmp_path / "checkpoint.pt", {})


def fill_the_disk(file):
    with checkpoint.replaced(file) as part:
        part.write_bytes(b"half")
        raise OSError(28, "No space left on device")


def test_the_learning_rate_falls_geometrically():
    rate = falling(1e-3, 1e-5)
    assert [rate(1.0), rate(0.5), rate(0.0)] == pytest.approx([1e-3, 1e-4, 1e-5])


@pytest.mark.parametrize("name", list(MORE))
def test_the_first_policy_is_near_the_base_controller(name):
    given = tiny(name, policy__output_gain=1e-6)
    env = environment(given)
    actions, _ = learner(given, env, 0).predict(env.reset(), deterministic=True)
    assert np.abs(actions).max() < 1e-4


def test_the_first_spread_is_what_was_asked():
    for name, more in (("ppo", {}), ("ppo", {"policy__spread_by_state": True}), ("sac", {})):
        given = tiny(name, policy__spread=0.05, policy__output_gain=1e-6, **more)
        env = environment(given)
        model, seen = learner(given, env, 0), env.reset()
        drawn = np.concatenate([model.predict(seen)[0] for _ in range(500)])
        assert drawn.std() == pytest.approx(0.05, rel=0.1)


class Trembling(gym.Env):
    """A chain of situations at random; in one kind trembling costs, in the other nothing does."""

    observation_space, action_space = gym.spaces.Box(-1, 1, (1,)), gym.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.situation = self.np_random.choice([-1.0, 1.0])
        return np.array([self.situation], np.float32), {}

    def step(self, action):
        reward = -float(action[0] ** 2) if self.situation > 0 else 0.0
        return *self.reset()[:1], reward, False, False, {}


def test_a_spread_by_state_falls_where_trembling_costs():
    model = PPO(
        SpreadPolicy,
        DummyVecEnv([Trembling] * 8),
        n_steps=32,
        batch_size=64,
        gamma=0.0,
        seed=0,
        device="cpu",
        policy_kwargs={"net_arch": [16], "log_std_init": np.log(0.3)},
        learning_rate=1e-3,
    )
    model.learn(6000)
    seen = torch.tensor([[-1.0], [1.0]])
    elsewhere, here = model.policy.get_distribution(seen).distribution.stddev.detach().flatten().tolist()
    assert here < 0.7 * elsewhere
    assert elsewhere > 0.2


def test_the_presets_own_scenario_is_found_and_trains_what_the_suite_has_not():
    given = settings.preset("ppo", HEIGHT)
    names = [s.name for s in environment(given).batch.scenarios]
    short = [name for name in scenarios.core("following") if name != "shift"]  # which lasts minutes
    assert set(names) == {*short, "tone", "mixed"}
    assert [s.name for s in Evaluator(given).env.batch.scenarios] == short


def test_values_are_set_as_in_toml():
    assert settings.parsed(["a.b=0.5", 'c=["x", "y"]', "d=word", "e=true"]) == {
        "a.b": 0.5,
        "c": ["x", "y"],
        "d": "word",
        "e": True,
    }
    given = settings.preset("ppo", HEIGHT, {"environment.reward.rate": 0.1, "algorithm.gamma": 0.9})
    assert given.environment["reward"] == {"rate": 0.1, "tolerance": 1e-4}
    assert given.flat()["algorithm.gamma"] == 0.9
    assert tomllib.loads(settings.preset_file("ppo", HEIGHT).read_text())["algorithm"]["gamma"] == 0.96


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["pp"], "unknown algorithm 'pp'; did you mean 'ppo'"),
        (
            ["ppo", "--env", "kerfgym/HeightFollowing-v1"],
            "unknown environment 'kerfgym/HeightFollowing-v1'; did you mean",
        ),
        (["ppo", "--set", "algorithm.gama=0.9"], "unknown setting 'algorithm.gama'; did you mean 'algorithm.gamma'"),
        (["ppo", "--set", "environment.bas=pid"], "unknown setting 'environment.bas'; did you mean 'environment.base'"),
        (["ppo", "--set", "algorithm.gamma"], "not of the form key=value"),
        (["ppo", "--set", "algorithm.gamma=high"], "algorithm.gamma = 'high'; a number from 0 to 1"),
        (["ppo", "--set", "algorithm.n_steps=2.5"], "algorithm.n_steps = 2.5; a whole number from 0 on"),
        (["ppo", "--set", "environment.base=pidd"], "unknown controller 'pidd'; did you mean 'pid'"),
        (["ppo", "--set", "environment.reward.rat=1"], "unknown reward term 'rat'; did you mean 'rate'"),
        (["ppo", "--set", "policy.activation=gelu"], "policy.activation = 'gelu'"),
        (["ppo", "--set", "policy.spread_by_state=1"], "policy.spread_by_state = 1; true or false"),
        (["sac", "--set", "policy.spread_by_state=true"], "unknown setting 'policy.spread_by_state'"),
        (["ppo", "--set", "steps=1.5"], "steps = 1.5; a whole number, at least 1"),
        (["ppo", "--steps", "0"], "steps = 0; a whole number, at least 1"),
        (["ppo", "--seed", "-1"], "seed = -1; a whole number from 0 on"),
        (["ppo", "--device", "tpu9x"], "device 'tpu9x' cannot be used"),
        (["ppo", "--set", "environment.base=wu"], "base controller 'wu' drives slot 'xy', not 'z'"),
        (["sac", "--set", "algorithm.noise=0.1"], "unknown setting 'algorithm.noise'"),
        (
            ["ppo", "--env", HEIGHT, "--preset", str(settings.preset_file("ppo", CUTTING))],
            f"is for environment '{CUTTING}', not '{HEIGHT}'",
        ),
        (["sac", "--preset", str(settings.preset_file("ppo", HEIGHT))], "is for algorithm 'ppo', not 'sac'"),
    ],
)
def test_bad_input_is_named_and_leaves_no_folder(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as error:
        cli.main(["train", *words, "--name", "x"])
    assert error.value.code == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
