"""A policy hands over to its base outside of the range that it was trained in."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO

from kerfgym.agents.export import export
from kerfgym.agents.network import FALL, RISE, Known, Layer, Memory, Network, run, trusted
from kerfgym.agents.onnx_file import described, write
from kerfgym.agents.policy import Policy, Range
from kerfgym.agents.vec_env import HeightFollowingVecEnv
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.measure import rollout

KNOWN = Known(np.array([1]), np.float32([0.0]), np.float32([1.0]), np.float32([0.5]))
SHORT = scenarios.load("wavy").varied(duration=0.4, settle=0.1)


def observed(*values):
    """Observations of two numbers, of which the second is bounded."""
    return np.float32([[9.0, value] for value in values])


def test_trust_is_whole_within_the_range_and_gone_a_margin_beyond():
    first = np.full((7, 1), -1.0, np.float32)
    seen = observed(0.0, 0.4, 1.0, 1.25, 1.5, 3.0, -0.1)
    np.testing.assert_allclose(trusted(KNOWN, first, seen)[:, 0], [1, 1, 1, 0.5, 0, 0, 0.8], rtol=1e-6)


def test_trust_is_lost_within_twenty_decisions_and_comes_back_within_two_hundred():
    trust, lost, back = np.ones((1, 1), np.float32), 0, 0
    while trust[0, 0] > 0.0:
        trust, lost = trusted(KNOWN, trust, observed(9.0)), lost + 1
    while trust[0, 0] < 1.0:
        trust, back = trusted(KNOWN, trust, observed(0.5)), back + 1
    assert (lost, back) == pytest.approx((1.0 / FALL, 1.0 / RISE), abs=1)


def test_the_worst_of_several_signals_decides():
    both = Known(np.array([0, 1]), np.float32([0, 0]), np.float32([1, 1]), np.float32([1, 1]))
    none = np.full((2, 1), -1.0, np.float32)
    seen = np.float32([[1.25, 0.5], [1.25, -0.75]])
    np.testing.assert_allclose(trusted(both, none, seen)[:, 0], [0.75, 0.25], rtol=1e-6)


def test_the_action_is_multiplied_by_the_trust_and_each_machine_has_its_own():
    layer = Layer("linear", np.float32([[0.0, 0.0], [0.0, 0.0]]), np.float32([0.8, -0.6]))
    network = Network(2, 1, None, (layer,), "clip", KNOWN)
    memory = Memory(network, 2)
    np.testing.assert_allclose(run(network, memory, observed(0.5, 1.25)), [[0.8, -0.6], [0.4, -0.3]], rtol=1e-6)
    moved = run(network, memory, observed(9.0, 0.5))
    np.testing.assert_allclose(moved, np.float32([[0.8, -0.6]]) * [[1 - FALL], [0.5 + RISE]], rtol=1e-6)
    memory.forget(np.array([True, False]))
    np.testing.assert_allclose(run(network, memory, observed(9.0, 0.5))[0], [0.0, 0.0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A policy for residual control that knows how fast the sheet moved while it was trained."""
    place = tmp_path_factory.mktemp("ranged") / "policy"
    env = HeightFollowingVecEnv(2)
    learnt = PPO("MlpPolicy", env, n_steps=8, batch_size=8, seed=1, device="cpu")
    learnt.policy.action_net.weight.data.normal_(0.0, 0.5)
    names = ["surface_step_0_1", "set_height"]
    export(learnt, place, known=Range(names=names, low=[-0.1, 0.5], high=[0.1, 1.0], margin=[0.2, 0.1]))
    return place


def test_it_hands_over_compiled_as_it_does_in_numpy(folder):
    policy, gaps = Policy.load(folder), []
    env = gym.make("kerfgym/HeightFollowing-v0", scenario=SHORT, split="tune")
    seen, _ = env.reset(options={"scenario_seed": 3})
    trust = []
    for period in range(400):
        seen, *_, info = env.step(policy.act(seen, start=period == 0))
        gaps.append(info["true_gap"])
        trust.append(policy._memory.trust[0, 0])
    record = rollout.roll(SHORT, stack.resolve(str(folder)), [9, 3, 4])
    np.testing.assert_array_equal(record["gap"][:400, 1], np.float32(gaps))
    assert min(trust) < 0.7 < 0.95 < max(trust)  # it was both


def test_beyond_its_range_the_machine_is_its_base_s_to_the_bit(folder):
    high = SHORT.varied(set_height=1.5)
    base = rollout.roll(high, stack.resolve("xi2023-improved"), [3, 5])
    np.testing.assert_array_equal(rollout.roll(high, stack.resolve(str(folder)), [3, 5])["gap"], base["gap"])


def test_where_it_hands_over_is_part_of_what_a_comparison_records(folder):
    made = stack.resolve(str(folder)).provenance["policy"]
    assert made["range"] == Policy.load(folder).document.range.names
    assert "feed" in stack.resolve("height-following-gradient").provenance["policy"]["range"]
    assert "range" not in stack.resolve("height-following-ppo").provenance["policy"]


def test_the_onnx_graph_hands_over_as_the_policy_does(folder, tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    policy = Policy.load(folder)
    graph = runtime.InferenceSession(write(policy, tmp_path / "policy.onnx").read_bytes())
    assert "trust" in described(policy.network)[0]
    random, trust = np.random.default_rng(0), np.full((1, 1), -1.0, np.float32)
    for i in range(40):
        row = random.normal(0.0, 0.15, policy.network.size).astype(np.float32)
        row[policy.document.observation["names"].index("set_height")] = 0.8
        action, trust = graph.run(["action", "next_trust"], {"observation": row[None], "trust": trust})
        np.testing.assert_allclose(action[0], policy.act(row, start=i == 0), atol=2e-6)
    assert 0.0 < trust[0, 0] < 1.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"names": ["set_heigth", "error_0"]}, "did you mean 'set_height'"),
        ({"low": [0.0]}, "needs a low, a high and a margin"),
        ({"low": [2.0, 0.0]}, "low above its high"),
        ({"margin": [0.0, 1.0]}, "a margin that is not above 0"),
        ({"margin": [1e-300, 1.0]}, "a margin below 0.0001"),  # 0 in single precision
        ({"low": [-1e300, 0.0]}, "numbers beyond ±10000"),
    ],
)
def test_a_range_that_says_nothing_is_refused(folder, change, said):
    said_before = Policy.load(folder).document.range.model_dump()
    learnt = PPO("MlpPolicy", HeightFollowingVecEnv(1), device="cpu")
    with pytest.raises(InvalidInput, match=said):
        export(learnt, folder.parent / "other", known=Range(**{**said_before, **change}))


def test_where_no_action_is_the_base_there_is_no_range(tmp_path):
    learnt = PPO("MlpPolicy", HeightFollowingVecEnv(1, control="direct"), device="cpu")
    with pytest.raises(InvalidInput, match="no action means the base"):
        export(learnt, tmp_path, known=Range(names=["set_height"], low=[0.5], high=[1.0], margin=[0.1]))
