"""What is shipped is small, is what ``make policies`` makes, and runs."""

import json

import numpy as np
import pandas as pd
import pytest

from kerfgym.agents import settings
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import job_metrics
from kerfgym.envs.plant import spot
from kerfgym.envs.tasks import workshop
from kerfgym.experiments.results import jobs
from kerfgym.experiments.statistics.budgets import spent
from kerfgym.experiments.studies import recorded, ship


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


@pytest.mark.parametrize("name", [name for name in ship.SHIPPED if (ship.TRAINED / name / "seeds.csv").is_file()])
def test_the_other_seeds_were_trained_with_the_policy_that_is_shipped(name):
    """The shipped seed's row is of the training on record, and its score that of the suite's study."""
    _, _, seed, _ = ship.SHIPPED[name]
    row = pd.read_csv(ship.TRAINED / name / "seeds.csv").set_index("seed").loc[seed]
    ledger = json.loads((ship.TRAINED / name / "run.json").read_text(encoding="utf-8"))["ledger"]
    assert row["simulated_steps"] == ledger["simulated_steps"]
    study = recorded.read(ship.suite_of(name))["numbers"][name]
    # Other trainings come to scores that differ by more than a percent.
    assert row["score"] == pytest.approx(study["score"], rel=1e-3)
    assert row["ratio"] == pytest.approx(study["ratio"], rel=1e-3)


def test_one_more_training_lies_within_its_interval_as_often_as_is_said():
    """By simulation: six trainings whose logarithms are normal, of which five are known."""
    scores = np.exp(np.random.default_rng(0).normal(1.0, 0.1, (4000, 6)))
    inside = [low <= each[5] <= high for each in scores for low, high in [ship.further(each[:5])]]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.011)  # three standard errors
    with pytest.raises(InvalidInput, match="at least 2"):
        ship.further(scores[0, :1])


@pytest.mark.parametrize(("score", "failed", "holds"), [(3.05, 0, True), (3.6, 0, False), (3.05, 1, False)])
def test_a_training_that_comes_out_otherwise_is_told(monkeypatch, tmp_path, capsys, score, failed, holds):
    name = "height-following-gradient"
    (tmp_path / name).mkdir()
    pd.DataFrame({"seed": range(5), "score": [3.0, 3.1, 3.05, 3.02, 3.08]}).to_csv(tmp_path / name / "seeds.csv")
    row = {"score": score, "ratio": 5.0, "ratio_low": 4.8, "ratio_high": 5.2, "failed": failed, "cpu_seconds": 200.0}
    monkeypatch.setattr(ship, "TRAINED", tmp_path)
    monkeypatch.setattr(ship, "judged", lambda name, folders: pd.DataFrame([row]))
    trained = []
    monkeypatch.setattr(ship, "_trained", lambda name, seed, run: trained.append(run) or run)
    monkeypatch.chdir(tmp_path)
    before = tmp_path / "runs" / f"again-{name}"
    before.mkdir(parents=True)
    (before / "run.json").write_text("{}")
    assert ship.reproduced(name) is holds
    assert ("NOT reproduced" in capsys.readouterr().out) is not holds
    assert [run.name for run in trained] == [before.name], "not the run that the stored scores are of"
    assert not before.exists(), "what an earlier check trained says nothing about this one"
    assert ship.main((name,), check=True) == (not holds)
    with pytest.raises(InvalidInput, match="leave --seeds away"):
        ship.main((name,), seeds=2, check=True)


def figures(name, team, seeds=6):
    """Every metric of jobs on the first test seeds of a scenario."""
    fleet, job, _ = jobs.roll(scenarios.load(name), team, list(scenarios.SPLITS["test"])[:seeds])
    return job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))


def test_the_contour_policy_keeps_twice_as_close_to_the_path_in_no_more_time():
    """On each job of the suite, two of which it was not trained on; in corners both slow down."""
    for name in scenarios.suite("contour"):
        teams = [stack.team(controller) for controller in ("contour-following-ppo", "wu-tuned")]
        assert [team.xy.part("plan").corners for team in teams] == [1.0, 1.0]
        mine, base = (figures(name, team) for team in teams)
        rms = [float(np.sqrt(np.mean(each["contour_rms"] ** 2))) for each in (mine, base)]
        assert 2.0 * rms[0] < rms[1], (name, rms)
        assert np.all(mine["time"] <= base["time"]), name
        for worse in ("dross", "roughness"):
            assert np.mean(mine[worse]) <= 1.05 * np.mean(base[worse]), (name, worse)


@pytest.mark.parametrize("controller", ["huang2024-tuned", "cutting-ppo"])
def test_within_the_published_settings_nothing_is_left_to_gain_over_huang2024(controller):
    """Neither is better in time, dross and roughness at once; neither is worse by more than 0.2 %."""
    for name in scenarios.core("cutting"):
        seeds = list(scenarios.SPLITS["test"])[:4]
        fleet, job, _ = jobs.roll(scenarios.load(name), stack.team(controller), seeds)
        assert not job_metrics.evidence(job_metrics.Jobs.of(fleet, job))["extrapolated"].any(), name
        mine, base = (figures(name, stack.team(each), 4) for each in (controller, "huang2024-dynamic"))
        ratios = [mine[metric] / base[metric] for metric in ("cutting_time", "dross", "roughness")]
        assert np.max(ratios) <= 1.002, (name, ratios)
        assert np.min(np.max(ratios, axis=0)) >= 0.999, (name, ratios)
        assert np.all(mine["through"] == 1.0), name
        assert np.all(mine["power_max"] <= workshop.material_of(scenarios.load(name)).power), name
        assert np.all(mine["dither_max"] <= spot.Params().galvo_range), name


def test_a_training_goes_on_unless_what_it_learns_on_has_changed(tmp_path, monkeypatch):
    run = tmp_path / "run"
    ship._renew(run)
    (run / "checkpoint").write_text("half way", encoding="utf-8")
    ship._renew(run)
    assert (run / "checkpoint").is_file()
    monkeypatch.setattr(ship, "with_imports", lambda entries, patterns: {"baselines/presets/*.toml": "another"})
    ship._renew(run)
    assert not (run / "checkpoint").exists()
