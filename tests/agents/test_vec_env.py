"""The stable-baselines3 VecEnv: the bits of the single environment, and the habits of stable-baselines3's own."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import kerfgym  # noqa: F401
from kerfgym.agents.vec_env import HeightFollowingVecEnv
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.tasks.interface import INFO

ID = "kerfgym/HeightFollowing-v0"


def actions(steps, num_envs, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (257, steps, 1)).astype(np.float32)[:num_envs].swapaxes(0, 1)


@pytest.mark.parametrize(
    "arguments",
    [{"scenario": ["flat", "wavy"], "max_steps": 40}, {"control": "direct", "max_steps": 90}],
    ids=["truncated", "collided"],
)
def test_it_lives_through_the_same_steps_as_stable_baselines_own(arguments):
    ours = HeightFollowingVecEnv(3, full_info=True, **arguments)
    theirs = make_vec_env(ID, 3, env_kwargs=arguments)
    ours.seed(7), theirs.seed(7)
    assert np.array_equal(ours.reset(), theirs.reset())
    assert ours.reset_infos == theirs.reset_infos
    ended = []
    for action in actions(130, 3):
        action = -np.abs(action) if "control" in arguments else action
        a, b = ours.step(action), theirs.step(action)
        assert all(np.array_equal(x, y) and x.dtype == y.dtype for x, y in zip(a[:3], b[:3], strict=True))
        for x, y, done in zip(a[3], b[3], a[2], strict=True):
            assert {name: x[name] for name in INFO} == {name: y[name] for name in INFO}
            if done:
                assert np.array_equal(x["terminal_observation"], y["terminal_observation"])
                assert x["TimeLimit.truncated"] == y["TimeLimit.truncated"]
                assert x["episode"]["r"] == pytest.approx(y["episode"]["r"], abs=2e-6)
                assert x["episode"]["l"] == y["episode"]["l"]
                ended.append(x["TimeLimit.truncated"])
    assert len(ended) >= 4
    assert set(ended) == {"control" not in arguments}


@pytest.mark.parametrize(("num_envs", "threads"), [(1, 1), (2, 1), (31, 1), (64, 2), (257, 1), (257, 2)])
def test_a_seeds_life_is_the_same_bits_for_any_number_of_environments_and_threads(num_envs, threads):
    env = HeightFollowingVecEnv(num_envs, num_threads=threads, scenario="rough", max_steps=30)
    one = gym.make(ID, scenario="rough", max_steps=30).unwrapped
    env.seed(11)
    observations, (single, _) = env.reset(), one.reset(seed=11)
    for action in actions(70, num_envs):
        assert np.array_equal(observations[0], single)
        observations, rewards, over, infos = env.step(action)
        single, reward, terminated, truncated, info = one.step(action[0])
        assert rewards[0] == np.float32(reward)
        assert over[0] == (terminated or truncated)
        assert env.get_attr("true_gap", 0)[0] == (info["true_gap"] if not over[0] else env.reset_infos[0]["true_gap"])
        if over[0]:
            assert np.array_equal(infos[0]["terminal_observation"], single)
            single, _ = one.reset()


def test_resetting_one_leaves_the_others_as_they_were():
    alone, other = HeightFollowingVecEnv(40), HeightFollowingVecEnv(40)
    for env in (alone, other):
        env.seed(5)
        env.reset()
    for step, action in enumerate(actions(40, 40)):
        if step == 20:
            seen, info = other.env_method("reset", indices=33, seed=99)[0]
            assert np.array_equal(seen, gym.make(ID).reset(seed=99)[0])
            assert set(info) == set(INFO)
        a, b = alone.step(action), other.step(action)
        keep = np.arange(40) != 33
        assert np.array_equal(a[0][keep], b[0][keep])


def test_infos_are_empty_until_an_episode_ends_and_full_where_it_is_asked_for():
    env = HeightFollowingVecEnv(2, max_steps=3)
    env.seed(0)
    env.reset()
    for step in range(3):
        infos = env.step(np.zeros((2, 1), np.float32))[3]
        assert [set(info) >= set(INFO) for info in infos] == [step == 2] * 2
    assert env.step(np.zeros((2, 1), np.float32))[3] == [{}, {}]


def test_attributes_and_methods_of_single_environments():
    env = HeightFollowingVecEnv(3, scenario=["flat", "wavy"], split="test", render_mode="rgb_array")
    env.seed(0)
    env.set_options({"scenario_seed": 1007})
    env.reset()
    assert env.get_attr("scenario_seed") == [1007, 1007, 1007]
    env.set_options([{"scenario_seed": 1001}, {}, {"scenario_seed": 1003}])
    env.reset()
    assert [env.get_attr("scenario_seed")[i] for i in (0, 2)] == [1001, 1003]
    assert [s.name in ("flat", "wavy") for s in env.get_attr("scenario")] == [True] * 3
    assert env.get_attr("render_mode") == ["rgb_array"] * 3
    assert not env.has_attr("phase")
    env.set_attr("phase", 4, indices=[0, 2])
    assert env.has_attr("phase")
    assert env.get_attr("phase") == [4, None, 4]
    assert env.env_is_wrapped(Monitor) == [True] * 3
    frames = env.env_method("render", indices=[1])
    assert frames[0].shape[2] == 3
    assert env.render().shape[0] >= frames[0].shape[0]
    env.close()


def test_wrappers_and_evaluation_of_stable_baselines_work_around_it():
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):  # it keeps the statistics itself
        env = VecNormalize(VecMonitor(HeightFollowingVecEnv(4, max_steps=20)), norm_obs=False)
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=1, device="cpu", seed=0).learn(128)
    assert len(model.ep_info_buffer) == 4
    returns, lengths = evaluate_policy(
        model, HeightFollowingVecEnv(3, max_steps=20, split="test"), n_eval_episodes=6, return_episode_rewards=True
    )
    assert lengths == [20] * 6
    assert np.isfinite(returns).all()


@pytest.mark.parametrize("algorithm", [PPO, SAC])
def test_stable_baselines_learns_on_it(algorithm):
    env = HeightFollowingVecEnv(8, max_steps=15)  # too short to touch the sheet in
    settings = {"n_steps": 32, "batch_size": 64} if algorithm is PPO else {"learning_starts": 64, "batch_size": 32}
    model = algorithm("MlpPolicy", env, device="cpu", seed=0, **settings).learn(320)
    assert model.num_timesteps >= 320
    assert {info["l"] for info in model.ep_info_buffer} == {15}


def begun():
    env = HeightFollowingVecEnv(2)
    env.reset()
    return env


@pytest.mark.parametrize(
    ("act", "error", "message"),
    [
        (lambda: HeightFollowingVecEnv(0), InvalidInput, r"num_envs = 0; a whole number, at least 1"),
        (lambda: HeightFollowingVecEnv(2, num_threads=0), InvalidInput, r"num_threads = 0"),
        (lambda: HeightFollowingVecEnv(2, obsevation="raw"), InvalidInput, r"unknown argument 'obsevation'; did"),
        (lambda: HeightFollowingVecEnv(2).step(np.zeros((2, 1))), InvalidInput, r"the episodes have not begun"),
        (lambda: begun().step(np.zeros((3, 1))), InvalidInput, r"the actions have shape \(3, 1\); it must be \(2, 1\)"),
        (lambda: begun().step(np.array([[0.0], [np.inf]])), InvalidInput, r"the action of environment 1, \[inf\]"),
        (lambda: begun().get_attr("true_gpa"), AttributeError, r"no attribute 'true_gpa'; did you mean 'true_gap'"),
        (lambda: begun().env_method("rest"), AttributeError, r"no method 'rest'; did you mean 'reset'"),
        (lambda: begun().set_attr("control", "direct"), InvalidInput, r"'control' is fixed when the envir"),
        (lambda: begun().get_attr("true_gap", 5), InvalidInput, r"environment 5 does not exist; there are 2"),
    ],
)
def test_bad_input_is_named(act, error, message):
    with pytest.raises(error, match=message):
        act()
