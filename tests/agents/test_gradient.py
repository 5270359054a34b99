"""The learner by gradients: it lives through what the machines did, to the bit, and gets better."""

import numpy as np
import pytest

from kerfgym.agents import settings
from kerfgym.agents.export import BOUND, export
from kerfgym.agents.gradient import Pass
from kerfgym.agents.learner import environment, learner
from kerfgym.agents.policy import Policy
from kerfgym.agents.train import train
from kerfgym.agents.vec_env import HeightFollowingVecEnv
from kerfgym.baselines import forecast
from kerfgym.envs.control import stack
from kerfgym.envs.engine.lanes import part
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant.derivatives import Rollout
from kerfgym.experiments.measure import rollout

HEIGHT = "kerfgym/HeightFollowing-v0"
TINY = {
    "steps": 500_000,
    "environment.scenario": "tilt",
    "environment.max_steps": 600,
    "environment.num_envs": 32,
    "checkpoint.every": 250_000,
    "evaluation.scenario": "tilt",
    "evaluation.episodes": 16,
    "evaluation.max_steps": 600,
    "evaluation.every": 250_000,
    "policy.net_arch": [16],
}


def tiny(**changes):
    """Settings of a training of seconds."""
    return settings.preset("gradient", HEIGHT, {**TINY, **changes})


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A short training, and its folder."""
    folder = tmp_path_factory.mktemp("gradient")
    return train(tiny(), folder), folder


SLOW = {"axis": {"bandwidth": 25.0, "dead_time": 0.004, "bristle": 0.008, "stiction": 1.4}}
"""A drive that is far from the standard one."""


@pytest.mark.parametrize(
    ("scenario", "change"),
    [
        ("rough", {}),
        ("step-flutter", {}),
        ("holes", {}),  # over which the supervisor commands
        ("corners", {"environment.machine": SLOW}),
        ("rough", {"environment.base": "forecast:law.ki=1500"}),
        ("long-hole", {"environment.base": "forecast:guard.timeout=50", "environment.machine": {"feed": 400.0}}),
    ],
)
def test_drive_and_loop_alone_do_what_the_machines_did_to_the_bit(scenario, change):
    """With a policy that acts at random, so weights are anything."""
    given = tiny(**{"environment.scenario": scenario, "environment.num_envs": 40, **change})
    env = environment(given)
    passed, seen, random = Pass(env.batch, 200), env.reset(), np.random.default_rng(0)
    passed.begin()
    gaps, commands = np.zeros((40, 600)), np.zeros((40, 600))
    acted = np.float32(random.uniform(-0.3, 0.3, (40, 600, env.action_space.shape[0])))
    for t in range(600):
        passed.before(t, seen, acted[:, t])
        seen, _, dones, _ = env.step(acted[:, t])
        passed.after(t, dones)
        gaps[:, t] = env.batch.infos[env.batch.task.info.index("true_gap")]
        commands[:, t] = env.batch.fleet.column("signals.command")
    passed.restart()
    passed.check()
    passed.restart()
    lived = passed.lived[:, :-1]
    assert lived.mean() > 0.8
    for first in (0, 200, 400):
        passed.decide(first, acted[:, first : first + 200].reshape(-1, acted.shape[2]))
        made = passed.roll.forward(first, 200)
        for column, theirs in ((0, gaps), (1, commands)):
            mine = made[:, : 200 if first < 400 else 199, column]
            length = slice(first, first + mine.shape[1])
            np.testing.assert_array_equal(np.where(lived[:, length], mine - theirs[:, length], 0.0), 0.0)


def test_it_gets_better_than_its_base(trained):
    found, folder = trained
    base = learner(tiny(**{"policy.output_gain": 1e-9}), environment(tiny()), 0)
    from kerfgym.agents.evaluation import Evaluator

    assert found.score < 0.9 * Evaluator(tiny())(base).score
    assert found.ledger["training_steps"] == found.model.num_timesteps >= 500_000
    assert (folder / "evaluations.csv").is_file()


def test_the_loss_changes_along_its_gradient_as_its_adjoints_say():
    """The squares of a piece, on both sides of the actions along their adjoints."""
    given = tiny(**{"environment.scenario": "step", "policy.output_gain": 0.5})
    model = learner(given, environment(given), 0)
    model._setup_learn(1)
    passed = model._live()
    passed.restart()
    seen, nothing = passed.observations[:, :200].copy(), model.policy.nothing(len(passed.lived))
    acted, _ = model.decided(seen, nothing)

    passed.counts[:] = True
    passed.decide(0, acted)
    errors, _ = passed.rolled(0)
    made_ = np.zeros((*errors.shape, 3))
    made_[:, :, 0] = 2.0 * errors
    bars = passed.roll.backward(made_)
    step = 3e-3 / np.abs(bars).max() * bars  # beyond the converter's steps
    moved = []
    for side in (1.0, -1.0):
        passed.restart()
        passed.decide(0, acted + side * step)
        moved.append(float((passed.rolled(0)[0] ** 2).sum()))
    assert 0.5 * (moved[0] - moved[1]) == pytest.approx((step * bars).sum(), rel=0.03)


def test_its_policy_is_exported_and_runs_compiled(trained, tmp_path):
    found, _ = trained
    exported = export(found.model, tmp_path / "policy", onnx=False)
    assert exported.difference <= BOUND
    assert Policy.load(tmp_path / "policy").document.control == "weights"
    wavy = rollout.roll(
        HeightFollowingVecEnv(1, scenario="wavy").batch.scenarios[0], stack.resolve(str(tmp_path / "policy")), [3]
    )
    assert not wavy.collided.any()


def test_a_training_goes_on_with_the_same_bits(trained, tmp_path):
    whole, _ = trained

    class Stop(Exception):
        pass

    def told(done, of, word):
        if done >= 250_000:
            raise Stop

    with pytest.raises(Stop):
        train(tiny(), tmp_path, told=told)
    again = train(tiny(), tmp_path, resume=True)
    assert [row["score"] for row in again.evaluations] == [row["score"] for row in whole.evaluations]


@pytest.mark.parametrize("change", [{"control": "residual"}, {"observation": "features"}])
def test_other_environments_are_refused(change):
    with pytest.raises(InvalidInput, match='gradient learns with control = "weights"'):
        learner(
            tiny(**{f"environment.{key}": value for key, value in change.items()}),
            environment(tiny(**{f"environment.{key}": value for key, value in change.items()})),
            0,
        )
    with pytest.raises(InvalidInput, match="gradient learns kerfgym/HeightFollowing-v0 alone"):
        settings.preset("gradient", "kerfgym/Cutting-v0")


@part
def other_loop(params, state, felt, memory):
    """Not what ``forecast`` does: a hundredth is missing."""
    state, command = forecast.loop(params, state, felt, memory)
    return state, 0.99 * command


def test_a_loop_that_is_not_the_law_s_is_refused(monkeypatch):
    """The first piece is lived through again before anything is learnt from it."""
    monkeypatch.setattr("kerfgym.agents.gradient.Rollout", lambda n, loop, *rest: Rollout(n, other_loop, *rest))
    model = learner(tiny(), environment(tiny()), 0)
    model._setup_learn(1)
    with pytest.raises(InvalidInput, match="the law's loop does not do what its control does"):
        model._live()


@pytest.mark.parametrize(("key", "value"), [("horizon", 0), ("epochs", 0)])
def test_a_training_that_learns_nothing_is_refused(key, value):
    given = tiny(**{f"algorithm.{key}": value})
    with pytest.raises(InvalidInput, match=f"algorithm.{key} = 0; a whole number, at least 1"):
        learner(given, environment(given), 0)


def test_episodes_that_memory_does_not_hold_are_refused():
    given = tiny(**{"environment.scenario": "shift", "environment.max_steps": 300_000})
    model = learner(given, environment(given), 0)
    model._setup_learn(1)
    with pytest.raises(InvalidInput, match="300,000 periods of 32 machines"):
        model._live()
