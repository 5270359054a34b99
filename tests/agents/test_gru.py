"""A policy by gradients may remember: torch, NumPy, compiled roll-outs and ONNX agree on what."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from kerfgym.agents import settings
from kerfgym.agents.export import BOUND, _gru, export
from kerfgym.agents.learner import environment, learner
from kerfgym.agents.network import Memory, Network, run
from kerfgym.agents.policy import Policy
from kerfgym.agents.train import train
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.measure import rollout

HEIGHT = "kerfgym/HeightFollowing-v0"
SHORT = scenarios.load("wavy").varied(duration=0.5, settle=0.1)
TINY = {
    "steps": 40_000,
    "environment.scenario": "tilt",
    "environment.max_steps": 400,
    "environment.num_envs": 16,
    "checkpoint.every": 20_000,
    "evaluation.scenario": "tilt",
    "evaluation.episodes": 4,
    "evaluation.max_steps": 200,
    "evaluation.every": 20_000,
    "policy.net_arch": [8],
    "policy.gru_hidden_size": 6,
}


def tiny(**changes):
    return settings.preset("gradient", HEIGHT, {**TINY, **changes})


@pytest.fixture(scope="module")
def model():
    """Untrained, and far from its base."""
    return learner(tiny(**{"policy.output_gain": 1.0}), environment(tiny()), seed=0)


@pytest.fixture(scope="module")
def exported(model, tmp_path_factory):
    return export(model, tmp_path_factory.mktemp("gru") / "policy", known="measured")


def test_the_layer_is_torch_s():
    random = np.random.default_rng(0)
    theirs = torch.nn.GRU(5, 7)
    with torch.no_grad():
        for weights in theirs.parameters():
            weights.normal_(0.0, 0.8, generator=torch.Generator().manual_seed(1))
    x = random.normal(0.0, 1.5, (300, 3, 5)).astype(np.float32)
    network = Network(5, 1, None, tuple(_gru(theirs)), "clip")
    memory = Memory(network, 3)
    ours = np.stack([run(network, memory, row) for row in x])
    np.testing.assert_allclose(ours, theirs(torch.from_numpy(x))[0].detach().numpy(), atol=1e-5)
    memory.forget(np.array([True, False, True]))
    again = run(network, memory, x[0])
    np.testing.assert_array_equal(again[[0, 2]], ours[0][[0, 2]])
    assert np.abs(again[1] - ours[0][1]).max() > 0.01


def test_what_is_remembered_goes_on_from_piece_to_piece_and_ends_with_the_episode(model):
    policy = model.policy
    seen = torch.randn(4, 30, model.observation_space.shape[0], generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        whole, then = policy.course(seen, policy.nothing(4))
        first, known = policy.course(seen[:, :11], policy.nothing(4))
        second, last = policy.course(seen[:, 11:], known)
    torch.testing.assert_close(torch.cat([first, second], dim=1), whole, atol=1e-6, rtol=0.0)
    torch.testing.assert_close(last, then, atol=1e-6, rtol=0.0)
    state, begins = None, np.array([True, True, False, False])  # an unknown state is that of a beginning
    for t in range(30):
        actions, state = model.predict(seen[:, t].numpy(), state, begins if t == 0 else None, deterministic=True)
        np.testing.assert_allclose(actions, whole[:, t].numpy(), atol=1e-6)
    actions, _ = model.predict(seen[:, 0].numpy(), state, begins)
    np.testing.assert_allclose(actions[:2], whole[:2, 0].numpy(), atol=1e-6)
    assert np.abs(actions[2:] - whole[2:, 0].numpy()).max() > 1e-3
    one, _ = model.predict(seen[1, 0].numpy())
    np.testing.assert_allclose(one, whole[1, 0].numpy(), atol=1e-6)


def test_a_seed_gives_the_same_trajectory_in_the_gymnasium_loop_and_compiled(exported):
    assert exported.difference <= BOUND
    policy, gaps, acted = Policy.load(exported.folder), [], []
    env = gym.make(HEIGHT, scenario=SHORT, split="tune", control="weights", observation="sheet", base="forecast")
    seen, _ = env.reset(options={"scenario_seed": 3})
    for t in range(500):
        acted.append(policy.act(seen, start=t == 0))
        seen, *_, info = env.step(acted[-1])
        gaps.append(np.float32(info["true_gap"]))
    record = rollout.roll(SHORT, stack.resolve(str(exported.folder)), [3])
    np.testing.assert_array_equal(record["gap"][:500, 0], gaps)
    assert np.ptp(acted, axis=0).max() > 0.05


def test_the_onnx_graph_remembers_too(exported):
    runtime = pytest.importorskip("onnxruntime")
    policy = Policy.load(exported.folder)
    graph = runtime.InferenceSession(exported.onnx.read_bytes())
    given = {one.name: one.shape for one in graph.get_inputs()}
    assert set(given) == {"observation", "hidden_0", "trust"}
    random, state = np.random.default_rng(3), {"hidden_0": np.zeros((1, 6), np.float32), "trust": np.float32([[-1]])}
    for i in range(60):
        row = random.normal(0.0, 0.4, policy.network.size).astype(np.float32)
        action, *rest = graph.run(["action", "next_hidden_0", "next_trust"], {"observation": row[None], **state})
        state = dict(zip(state, rest, strict=True))
        np.testing.assert_allclose(action[0], policy.act(row, start=i == 0), atol=2e-6)


def test_a_training_with_memory_goes_on_with_the_same_bits(tmp_path):
    whole = train(tiny(), tmp_path / "whole", seed=4)
    before = learner(tiny(), environment(tiny()), seed=4).policy.memory.weight_hh_l0
    assert (whole.model.policy.memory.weight_hh_l0 != before).all(), "the gradient reaches what is remembered"

    class Stop(Exception):
        pass

    def told(done, of, word):
        if done >= 20_000:
            raise Stop

    with pytest.raises(Stop):
        train(tiny(), tmp_path / "parts", seed=4, told=told)
    again = train(tiny(), tmp_path / "parts", seed=4, resume=True)
    for mine, its in zip(again.model.policy.parameters(), whole.model.policy.parameters(), strict=True):
        assert torch.equal(mine, its)


@pytest.mark.parametrize("size", [-1, 2.5, True, 5000, "many"])
def test_a_size_that_is_none_is_refused(size):
    with pytest.raises(InvalidInput, match=r"policy\.gru_hidden_size = .*; a whole number, from 0 to 4096"):
        learner(tiny(**{"policy.gru_hidden_size": size}), environment(tiny()), 0)


def test_other_learners_have_no_such_setting():
    with pytest.raises(InvalidInput, match=r"unknown setting 'policy\.gru_hidden_size'"):
        settings.preset("ppo", HEIGHT, {"policy.gru_hidden_size": 8})


def test_the_learner_takes_what_is_remembered_from_piece_to_piece(monkeypatch):
    given = tiny(**{"environment.max_steps": 600})
    mine, begun = learner(given, environment(given), seed=0), []
    monkeypatch.setattr(mine, "_step", lambda seen, known, bars: begun.append(known.clone()))
    mine._setup_learn(1)
    passed = mine._live()
    mine._learn_from(passed)
    with torch.no_grad():
        _, then = mine.policy.course(torch.as_tensor(passed.observations[:, :200]), mine.policy.nothing(16))
    assert not begun[0].any(), "a pass is of new episodes"
    torch.testing.assert_close(begun[1], then, atol=1e-6, rtol=0.0)
    assert then.abs().mean() > 0.05
    assert not any(known.requires_grad for known in begun)
