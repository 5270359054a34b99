"""What is shipped is small, is what ``make train`` makes, and runs."""

import json

import numpy as np
import pytest

from kerfgym.agents import settings
from kerfgym.envs import job_metrics, scenarios, stack, workshop
from kerfgym.experiments import ship
from kerfgym.experiments.budgets import spent


@pytest.mark.parametrize("name", list(ship.SHIPPED))
def test_a_shipped_policy_is_small_and_carries_the_record_of_its_making(name):
    folder = ship.TRAINED / name
    assert sum(file.stat().st_size for file in folder.iterdir()) < 1_000_000
    assert {file.suffix for file in folder.iterdir()} <= {".json", ".safetensors", ".onnx", ".csv"}
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    algorithm, env, seed, changes = ship.SHIPPED[name]
    assert (record["algorithm"], record["env"], record["seed"]) == (algorithm, env, seed)
    given = settings.preset(algorithm, env, changes).flat()
    assert record["settings"] == json.loads(json.dumps(given))
    assert record["ledger"]["cpu_seconds"] <= 600
    assert record["ledger"]["training_steps"] >= given["steps"]
    policy = stack.resolve(str(folder))
    assert policy.information == "sensor"
    assert not spent(policy.provenance).edited  # what its preset changed in the base is on record as its training


def test_the_contour_policy_keeps_twice_as_close_to_the_path_in_no_more_time():
    """On each job of the suite, two of which it was not trained on; in corners both slow down."""

    def figures(name, controller):
        scenario, team = scenarios.load(name), stack.team(controller)
        assert team.xy.part("plan").corners == 1.0
        fleet = workshop.fleet_for(scenario, team, list(scenarios.SPLITS["test"])[:6])
        job = workshop.programme(scenario, team)
        fleet.advance(len(job.x) + 500)
        return job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))

    for name in scenarios.suite("contour"):
        mine, base = figures(name, "contour-following-ppo"), figures(name, "wu-tuned")
        rms = [float(np.sqrt(np.mean(each["contour_rms"] ** 2))) for each in (mine, base)]
        assert 2.0 * rms[0] < rms[1], (name, rms)
        assert np.all(mine["time"] <= base["time"]), name
        for worse in ("dross", "roughness"):
            assert np.mean(mine[worse]) <= 1.05 * np.mean(base[worse]), (name, worse)
