"""The vector environment: Gymnasium's rules, the bits of the single environment, and what bad input says."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import kerfgym  # noqa: F401
from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import get
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.height_following import HeightFollowingVectorEnv
from kerfgym.envs.tasks.interface import FEATURES, INFO
from kerfgym.experiments.measure.rollout import roll

ID = "kerfgym/HeightFollowing-v0"


def made(num_envs, **arguments):
    return gym.make_vec(ID, num_envs=num_envs, **arguments)


def actions(steps, num_envs, width=1, seed=0):
    """The first environments get the same actions however many there are."""
    return np.random.default_rng(seed).uniform(-1, 1, (257, steps, width)).astype(np.float32)[:num_envs].swapaxes(0, 1)


def equal(a, b):
    """Whether two results of a step or their infos are the same bits."""
    if isinstance(a, tuple):
        return len(a) == len(b) and all(equal(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(equal(a[k], b[k]) for k in a)
    if isinstance(a, np.ndarray) and a.dtype == object:
        return all((x is None and y is None) or np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    return np.array_equal(a, b)


def test_make_vec_gives_it_and_it_says_how_it_resets():
    env = made(3, autoreset_mode="SameStep")
    assert isinstance(env.unwrapped, HeightFollowingVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert made(3).metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP  # and the other's is its own
    assert env.observation_space.shape == (3, len(FEATURES))
    assert env.action_space.shape == (3, 1)
    observations, info = env.reset(seed=1)
    assert env.observation_space.contains(observations)
    assert all(info[name].shape == (3,) and info[f"_{name}"].all() for name in INFO)


CASES = {
    "truncated": {"scenario": ["flat", "wavy", "step"], "max_steps": 40},
    "collided": {"scenario": "wavy", "control": "direct", "max_steps": 90},
    "schedule": {"scenario": "rough", "control": "schedule", "observation": "raw", "max_steps": 50},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_it_lives_through_the_same_steps_as_single_environments_side_by_side(case, mode):
    arguments, width = CASES[case], 3 if case == "schedule" else 1
    ours = made(5, autoreset_mode=mode, **arguments)
    theirs = made(5, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **arguments)
    assert equal(ours.reset(seed=7), theirs.reset(seed=7))
    ended = 0
    for action in actions(130, 5, width):
        if case == "collided":
            action = -np.abs(action)  # down into the sheet
        a, b = ours.step(action), theirs.step(action)
        for x, y in zip(a, b, strict=True):
            assert equal(x, y)
        ended += int(a[2].sum() + a[3].sum())
        if case == "collided" and mode == "SameStep" and a[2].any():
            assert (a[4]["final_info"]["cost"][a[2]] == 1.0).all()
    assert ended >= 10


def test_without_autoreset_an_episode_that_is_over_waits_for_its_reset():
    env = made(4, autoreset_mode="Disabled", max_steps=5)
    env.reset(seed=3)
    for action in actions(5, 4):
        *_, truncated, _ = env.step(action)
    assert truncated.all()
    with pytest.raises(InvalidInput, match="the episode of environment 0 is over; call reset"):
        env.step(action)
    env.reset(options={"reset_mask": np.array([True, True, False, True])})
    with pytest.raises(InvalidInput, match="the episode of environment 2 is over"):
        env.step(action)
    env.reset(options={"reset_mask": np.array([False, False, True, False])})
    assert not env.step(action)[3].any()


def lives(num_envs, threads, mode):
    """Every observation of two episodes of 40 steps, by environment."""
    env = made(num_envs, num_threads=threads, autoreset_mode=mode, scenario="rough", max_steps=40)
    seen = [env.reset(seed=11)[0]]
    for step, action in enumerate(0.1 * actions(80, num_envs)):  # gentle: none collides
        observations, _, _, truncated, info = env.step(action)
        assert truncated.all() == (step in (39, 79))
        if mode == "SameStep" and truncated.all():
            seen += [np.stack(info["final_obs"]), observations]
        else:
            seen.append(observations)
        if mode == "Disabled" and truncated.all():
            seen.append(env.reset()[0])
        if mode == "NextStep" and truncated.all():  # one more step that only resets
            seen.append(env.step(action)[0])
    return np.stack(seen, axis=1)


def test_a_seeds_life_is_the_same_bits_for_any_number_of_environments_threads_and_way_of_resetting():
    whole = lives(257, 1, "SameStep")
    assert whole.shape == (257, 83, len(FEATURES))
    for num_envs, threads, mode in (
        (1, 1, "SameStep"),
        (2, 2, "NextStep"),
        (31, 1, "Disabled"),
        (64, 2, "SameStep"),
        (257, 2, "NextStep"),
        (257, 1, "Disabled"),
        (257, 2, "SameStep"),
    ):
        assert np.array_equal(lives(num_envs, threads, mode), whole[:num_envs]), (num_envs, threads, mode)


@pytest.mark.parametrize("num_envs", [1, 2, 31, 64, 257])
def test_without_an_action_it_is_the_compiled_roll_out(num_envs):
    scenario = scenarios.load("holes").varied(duration=0.2, settle=0.0)
    env = made(num_envs, scenario=scenario, split="test", num_threads=2)
    seeds = 1000 + np.arange(num_envs) % 200
    env.reset(options={"scenario_seed": seeds})
    record = roll(scenario, get("xi2023-improved"), seeds)
    for step in range(200):
        *_, info = env.step(np.zeros((num_envs, 1), np.float32))
        assert np.array_equal(info["true_gap"].astype(np.float32), record["gap"][step])


def test_resetting_some_leaves_the_others_as_they_were():
    alone, other = made(70, scenario="wavy"), made(70, scenario="wavy")
    alone.reset(seed=5), other.reset(seed=5)
    mask = np.zeros(70, bool)
    mask[[3, 31, 32, 69]] = True
    for step, action in enumerate(actions(60, 70)):
        if step == 30:
            other.reset(options={"reset_mask": mask})
        a, b = alone.step(action), other.step(action)
        assert np.array_equal(a[0][~mask], b[0][~mask])
        assert np.array_equal(a[1][~mask], b[1][~mask])
        assert step < 30 or not np.array_equal(a[0][mask], b[0][mask])


def test_results_are_the_callers_own():
    env = made(4)
    first = env.reset(seed=0)[0]
    kept = first.copy()
    result = env.step(np.ones((4, 1), np.float32))
    copies = [x.copy() for x in result[:4]]
    env.step(-np.ones((4, 1), np.float32))
    assert np.array_equal(first, kept)
    assert all(np.array_equal(x, y) for x, y in zip(result[:4], copies, strict=True))


def test_pictures_are_those_of_the_single_environments():
    env = made(2, render_mode="rgb_array", scenario="wavy")
    env.reset(seed=1)
    env.step(np.zeros((2, 1), np.float32))
    one = gym.make(ID, render_mode="rgb_array", scenario="wavy")
    one.reset(seed=2)
    one.step(np.zeros(1, np.float32))
    frames = env.render()
    assert len(frames) == 2
    assert np.array_equal(frames[1], one.render())


def begun(**arguments):
    env = made(3, **arguments)
    env.reset(seed=0)
    return env


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: made(0), r"num_envs = 0; a whole number, at least 1"),
        (lambda: made(2.5), r"num_envs = 2\.5; a whole number"),
        (lambda: made(2, num_threads=0), r"num_threads = 0; a whole number, at least 1"),
        (lambda: made(2, autoreset_mode="NextSetp"), r"unknown autoreset_mode 'NextSetp'; did you mean 'NextStep'"),
        (lambda: made(2, scenaro="wavy"), r"unknown argument 'scenaro'; did you mean 'scenario'"),
        (lambda: made(2, render_mode="human"), r"unknown render_mode 'human'"),
        (lambda: made(2).step(np.zeros((2, 1))), r"the episode of environment 0 has not begun; call reset"),
        (lambda: begun().step(np.zeros((2, 1))), r"the actions have shape \(2, 1\); it must be \(3, 1\)"),
        (lambda: begun().step(np.zeros(3)), r"the actions have shape \(3,\)"),
        (lambda: begun().step(np.full((3, 1), "up")), r"the actions are of type <U2; numbers are needed"),
        (lambda: begun().step(np.ones((3, 1), bool)), r"the actions are of type bool"),
        (lambda: begun().step([[0.0], [np.nan], [0.0]]), r"the action of environment 1, \[nan\], is not finite"),
        (lambda: made(3).reset(seed=[1, 2]), r"2 seeds for 3 environments; one for each"),
        (lambda: made(3).reset(seed=[1, -2, 3]), r"seed -2 of environment 1: a whole number from 0 on"),
        (lambda: made(3).reset(options={"mask": 1}), r"unknown option 'mask'; did you mean 'reset_mask'"),
        (lambda: made(3).reset(options={"reset_mask": [True] * 3}), r"reset_mask must be an array of bool of shape"),
        (lambda: made(3).reset(options={"reset_mask": np.zeros(3, bool)}), r"reset_mask selects no environment"),
        (lambda: made(3).reset(options={"scenario_seed": 5}), r"scenario_seed = 5 is not in split 'train': 10000 to"),
        (lambda: made(3).reset(options={"scenario_seed": [10000] * 2}), r"scenario_seed has shape \(2,\)"),
        (lambda: made(3).reset(options={"scenario_seed": 1.5}), r"scenario_seed = 1\.5; whole numbers are needed"),
    ],
)
def test_bad_input_is_named(act, message):
    with pytest.raises(InvalidInput, match=message):
        act()
