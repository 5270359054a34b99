"""What a policy's training scenarios hold bounds the range in which it acts."""

import math

import numpy as np
import pytest

from kerfgym.agents.export import export
from kerfgym.agents.gradient import Gradient
from kerfgym.agents.vec_env import HeightFollowingVecEnv
from kerfgym.baselines import forecast
from kerfgym.envs.control import stack
from kerfgym.envs.scenarios import load
from kerfgym.experiments.measure import rollout


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Of a policy that acts at random on vibrating sheets at 200 mm/s."""
    env = HeightFollowingVecEnv(4, scenario="chatter", base="forecast", control="weights", observation="sheet")
    return export(Gradient("MlpPolicy", env, seed=1), tmp_path_factory.mktemp("known") / "policy", known="measured")


def test_its_range_is_what_the_scenarios_of_its_training_hold(exported):
    said = exported.policy.document.range
    assert said.names == list(forecast.CONDITIONS)
    feed = forecast.CONDITIONS.index("feed")
    assert said.low[feed] == said.high[feed] == pytest.approx(math.log(201.0 / 200.0), abs=1e-4)
    dead = forecast.CONDITIONS.index("dead time")
    assert said.low[dead] <= 1e3 * 0.0025 - 2.0 <= said.high[dead]  # the suite's drives, dead time in ms less 2


def test_it_acts_where_it_was_trained_and_its_base_acts_elsewhere(exported):
    sheet, policy, base = load("chatter"), stack.resolve(str(exported.folder)), stack.resolve("forecast")
    apart = {}
    for feed in (200.0, 400.0):
        there = sheet.varied(feed=feed, duration=1.0)
        gaps = [rollout.roll(there, each, [7, 8])["gap"] for each in (policy, base)]
        apart[feed] = np.abs(gaps[0] - gaps[1]).max()
    assert apart[200.0] > 1e-4
    assert apart[400.0] == 0.0


def test_a_law_without_conditions_has_no_measured_range(tmp_path):
    from stable_baselines3 import PPO

    env = HeightFollowingVecEnv(2, scenario="chatter")
    assert (
        export(PPO("MlpPolicy", env, n_steps=8, batch_size=8), tmp_path, known="measured").policy.document.range is None
    )
