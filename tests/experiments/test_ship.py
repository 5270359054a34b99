"""What is shipped is small, is what ``make train`` makes, and runs."""

import json

import pytest

from kerfgym.agents import settings
from kerfgym.envs import stack
from kerfgym.experiments import ship


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
    assert stack.resolve(str(folder)).information == "sensor"
