"""Every controller that is shipped: declared, listed, and the same in a roll-out, an environment and a benchmark."""

import gymnasium as gym
import numpy as np
import pytest

import kerfgym  # noqa: F401
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.plant.controller import SLOTS
from kerfgym.envs.tasks import workshop
from kerfgym.experiments.benchmark import benchmarking
from kerfgym.experiments.cli import main
from kerfgym.experiments.measure.rollout import fleet_for

NAMES = [name for name in stack.names() if name != "idle"]
IN_Z = [name for name in NAMES if stack.get(name).slot == "z"]
IN_JOBS = [name for name in NAMES if stack.get(name).slot != "z"]
PERIODS = 150


@pytest.mark.parametrize("name", NAMES)
def test_it_declares_what_may_be_tuned_with_bounds_and_what_it_knows(name):
    found = stack.get(name)
    assert found.information in SLOTS[found.slot].information
    assert found.summary
    laws = [p for p in found.parameters().values() if p.name.startswith("law.")]
    assert laws
    for p in found.parameters().values():
        assert p.quantity.low < p.quantity.high
        assert p.quantity.low <= p.value <= p.quantity.high, p.name
        assert p.quantity.doc, p.name


def test_all_of_them_are_listed(capsys):
    main(["list", "controllers"])
    listed = {line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  ")}
    assert set(NAMES) <= listed


@pytest.mark.parametrize("name", IN_Z)
def test_in_an_environment_it_does_what_it_does_in_a_roll_out(name):
    env = gym.make(
        "kerfgym/HeightFollowing-v0", scenario="rough", base=name, control="residual", split="test"
    ).unwrapped
    _, info = env.reset(options={"scenario_seed": 1005})
    fleet = fleet_for(scenarios.load("rough"), stack.get(name), [1005])
    for _ in range(PERIODS):
        assert info["true_gap"] == fleet.get("signals").gap
        _, _, _, _, info = env.step(np.zeros(1, np.float32))
        fleet.advance()
    assert info["true_gap"] == fleet.get("signals").gap


@pytest.mark.parametrize("name", IN_JOBS)
def test_in_an_environment_of_jobs_it_does_what_it_does_in_a_roll_out(name):
    found = stack.get(name)
    kind, scenario = ("ContourFollowing", "contour-corners") if found.slot == "xy" else ("Cutting", "cut-corners")
    env = gym.make(f"kerfgym/{kind}-v0", scenario=scenario, base=f"{found.slot}={name}", split="test").unwrapped
    env.reset(options={"scenario_seed": 1005})
    team = stack.team(f"{found.slot}={name}")
    fleet = workshop.fleet_for(scenarios.load(scenario), team, [1005])
    for _ in range(60):
        _, _, terminated, truncated, _ = env.step(np.zeros(env.action_space.shape, np.float32))
        fleet.advance(8)
        assert not terminated
        assert not truncated
        assert env.batch.fleet.get("signals") == fleet.get("signals")
        assert env.batch.fleet.gantries.get("x") == fleet.gantries.get("x")
        assert env.batch.fleet.gantries.get("applied") == fleet.gantries.get("applied")


def test_all_that_follow_run_in_one_benchmark(tmp_path):
    case = scenarios.load("tilt").varied(duration=0.6)
    results = benchmarking.run(IN_Z, [case], tmp_path / "r", [1000, 1001], core=("tilt",), with_ms=False, workers=1)
    assert results.controllers == IN_Z
    assert np.isfinite(results.runs["rms_true"]).all()
