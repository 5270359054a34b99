"""``control="weights"`` and ``observation="sheet"``: what a policy sees and decides of a law that has weights."""

import sys
from types import SimpleNamespace
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pytest

from kerfgym.agents.vec_env import HeightFollowingVecEnv
from kerfgym.envs.control.stack import Stack
from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.height_following import HeightFollowingVectorEnv
from kerfgym.envs.plant.controller import Weight, make_law

ID = "kerfgym/HeightFollowing-v0"


FEATURES = ("error", "calls")
WEIGHTS = (Weight("gain", 20.0, "1/s"), Weight("bias", 5.0, "mm/s"))
ACTION, MEMORY = 2, 5


class Params(NamedTuple):
    kp: float = 40.0


class State(NamedTuple):
    calls: float = 0.0


def init(params):
    return State(0.0)


@part
def weigh(params, state, signals, memory):
    gain, bias = params.kp + 20.0 * memory[2], 5.0 * memory[3]
    return bias - gain * (signals.height - signals.set_height)


def control(params, state, signals, tables, memory):
    """A proportional law that counts its calls; an action moves its gain, and a bias."""
    memory[2], memory[3] = 0.0, 0.0
    state = State(state.calls + 1.0)
    memory[0], memory[1] = clip(signals.height - signals.set_height, -1.0, 1.0), 0.001 * state.calls
    return state, weigh(params, state, signals, memory)


CONTRACT = ("Params", "State", "init", "control", "FEATURES", "WEIGHTS", "ACTION", "MEMORY", "weigh")
WEIGHED = {name: globals()[name] for name in CONTRACT}
BASE = Stack("weighed", "", make_law(sys.modules[__name__], "tests.weighed"), {})


def made(**arguments):
    """A single environment with the law's weights as actions."""
    given = {"scenario": "wavy", "control": "weights", "observation": "sheet", "base": BASE, **arguments}
    return gym.make(ID, **given).unwrapped


def test_an_action_has_a_number_for_each_weight_and_an_observation_one_for_each_feature():
    env = made()
    assert env.action_space.shape == (2,)
    assert env.observation_space.shape == (2,)
    seen, _ = env.reset(seed=3)
    assert seen[1] == np.float32(0.001), "the law has decided once when an episode begins"
    seen, *_, info = env.step(np.zeros(2, np.float32))
    assert seen[1] == np.float32(0.002)
    assert seen[0] == np.float32(info["reported_error"])


def test_actions_of_nothing_leave_the_law_as_it_is():
    env, plain = made(), made(control="residual", observation="raw")
    env.reset(seed=5), plain.reset(seed=5)
    for _ in range(300):
        mine, theirs = env.step(np.zeros(2, np.float32))[-1], plain.step(np.zeros(1, np.float32))[-1]
        assert mine == theirs


def test_the_command_is_the_law_s_with_the_weights_of_the_action():
    env = made(observation="raw", scenario="flat")
    env.reset(seed=2)
    random, error = np.random.default_rng(0), 0.0
    command = list(env.observation_space.low).index(-2000.0)
    for _ in range(50):
        action = random.uniform(-1, 1, 2).astype(np.float32)
        seen, *_, info = env.step(action)
        expected = 5.0 * action[1] - (40.0 + 20.0 * action[0]) * error
        if error != 0.0 and not info["override"]:
            assert seen[command] == pytest.approx(expected, rel=1e-4, abs=500.0 / 2**15)
        error = info["reported_error"]


def test_machines_in_a_batch_get_each_its_own_weights():
    random = np.random.default_rng(1)
    actions = random.uniform(-1, 1, (60, 40, 2)).astype(np.float32)
    many = HeightFollowingVectorEnv(40, scenario="rough", control="weights", observation="sheet", base=BASE)
    native = HeightFollowingVecEnv(40, scenario="rough", control="weights", observation="sheet", base=BASE)
    seen, _ = many.reset(seed=7)
    native.seed(7)
    assert np.array_equal(native.reset(), seen)
    single = made(scenario="rough")
    alone = [single.reset(seed=7 + 35)[0]]
    batch = [seen[35].copy()]
    for action in actions:
        seen = many.step(action)[0]
        batch.append(seen[35].copy())
        assert np.array_equal(native.step(action)[0], seen)
        alone.append(single.step(action[35])[0])
    assert np.array_equal(batch, alone)


def test_a_base_without_weights_is_refused():
    for arguments in ({"control": "weights"}, {"observation": "sheet"}):
        with pytest.raises(InvalidInput, match="needs a base that says what it weighs"):
            gym.make(ID, base="pid", **arguments)
    with pytest.raises(InvalidInput, match="unknown control 'weights'"):
        gym.make("kerfgym/Cutting-v0", control="weights")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"ACTION": 1}, "do not lie one behind the other"),
        ({"MEMORY": 3}, "do not lie one behind the other"),
        ({"weigh": None}, "has no weigh"),
    ],
)
def test_a_law_that_declares_half_of_it_is_refused(change, said):
    space = SimpleNamespace(**{name: value for name, value in {**WEIGHED, **change}.items() if value is not None})
    with pytest.raises(InvalidInput, match=said):
        make_law(space, "tests.half")
