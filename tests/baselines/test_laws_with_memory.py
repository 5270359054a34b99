"""Laws that keep a memory give the same trajectory alone, in company, on several threads and in an environment."""

import gymnasium as gym
import numpy as np
import pytest

import kerfgym  # noqa: F401
from kerfgym.envs.control.stack import resolve
from kerfgym.envs.plant import machine
from kerfgym.envs.scenarios import load
from kerfgym.experiments.measure.rollout import fleet_for

# The bounds of the last are met all the time.
SPECS = ["lqg", "mpc", "mpc:law.acceleration=300,law.fastest=5", "forecast"]
PERIODS = 400
GAP, WISH = machine.CHANNELS.index("gap"), machine.CHANNELS.index("wish")


def recorded(spec, scenario, seeds, threads=1):
    fleet = fleet_for(load(scenario), resolve(spec), seeds, threads)
    record = fleet.start_recording(PERIODS)
    fleet.advance(PERIODS)
    return record


@pytest.mark.parametrize("spec", SPECS)
def test_a_machine_lives_the_same_alone_and_among_others_on_two_threads(spec):
    seeds = np.arange(1000, 1070)
    company = recorded(spec, "rough", seeds, threads=2)
    assert np.isfinite(company).all()
    assert np.ptp(company[:, GAP]) > 0.01
    for seed in (1000, 1037, 1069):
        alone = recorded(spec, "rough", [seed])
        assert np.array_equal(alone[:, :, 0], company[:, :, seed - 1000])


@pytest.mark.parametrize("scenario", ["rough", "holes"])
@pytest.mark.parametrize("spec", SPECS)
def test_an_environment_with_zero_actions_lives_the_roll_out(spec, scenario):
    env = gym.make(
        "kerfgym/HeightFollowing-v0", scenario=scenario, base=spec, control="residual", split="test", max_steps=PERIODS
    ).unwrapped
    _, info = env.reset(options={"scenario_seed": 1005})
    record, gaps = recorded(spec, scenario, [1005]), []
    for _ in range(PERIODS):
        _, _, terminated, _, info = env.step(np.zeros(1, np.float32))
        gaps.append(info["true_gap"])
        assert not terminated
    assert np.array_equal(np.float32(gaps), record[:, GAP, 0])


def test_an_episode_does_not_depend_on_the_one_before():
    env = gym.make("kerfgym/HeightFollowing-v0", scenario="rough", base="mpc", control="residual", split="test")
    lived = []
    for seed in (1005, 1006, 1005):
        env.reset(options={"scenario_seed": seed})
        lived.append([env.step(np.zeros(1, np.float32))[4]["true_gap"] for _ in range(100)])
    assert lived[0] == lived[2] != lived[1]


def test_the_wishes_of_the_tight_mpc_keep_its_bounds_while_it_commands():
    record = recorded(SPECS[2], "rough", np.arange(1000, 1010))
    wish, command = record[:, WISH], record[:, machine.CHANNELS.index("command")]
    free = record[:, machine.CHANNELS.index("override")] == 0.0
    change = np.abs(wish - command)[free]
    assert change.max() == pytest.approx(0.3, rel=1e-5)
    assert (change > 0.299).mean() > 0.02
    assert np.abs(wish[free]).max() <= 5.0 + 1e-5
