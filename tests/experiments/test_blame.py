"""Blame: shares of idealised stages add up, and a stage made worse gains share."""

import json

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import job_metrics, metrics
from kerfgym.envs.plant.ideal import FOLLOWING, JOBS
from kerfgym.experiments.benchmark import benchmarking
from kerfgym.experiments.blame import Blame, blame, measure, shapley
from kerfgym.experiments.blame import blaming as runner
from kerfgym.experiments.blame.game import stages_of
from kerfgym.experiments.blame.shares import coalitions, headroom, of_coalitions, shares
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.measure.grids import Grid
from kerfgym.experiments.results import jobs

SEEDS = range(1000, 1006)
ROUGH = scenarios.load("rough").varied(duration=0.8, settle=0.1, name="short")


@pytest.fixture(scope="module")
def found():
    return measured(ROUGH, stacks.resolve("xi2023-improved"), SEEDS)


def measured(scenario, controller, *words, **more):
    (one,) = measure(scenario, stacks.asked(controller), *words, **more)
    return one


def of(blame_, stage):
    return blame_.shares[FOLLOWING.index(stage)].mean()


# ------------------------------------------------------------------------------------------------------ the game


def test_shapley_of_games_solved_by_hand():
    # One left glove (player 0) and two right ones: a pair is worth 1. Of the six orders, player 0 completes it in four.
    pair = [float(c & 1 and c > 1) for c in range(8)]
    np.testing.assert_allclose(shapley(np.array(pair)), [2 / 3, 1 / 6, 1 / 6])
    # A runway for planes that need 1, 2 and 3 km (Littlechild and Owen 1973): each shares what it uses.
    runway = [max([i + 1 for i in range(3) if c >> i & 1], default=0) for c in range(8)]
    np.testing.assert_allclose(shapley(np.array(runway)), [1 / 3, 1 / 3 + 1 / 2, 1 / 3 + 1 / 2 + 1])


def test_shapley_is_symmetric_efficient_and_gives_nothing_for_nothing():
    bits = np.arange(32)[:, None] >> np.arange(5) & 1
    worth = np.sin(bits[:, 0] + bits[:, 3]) + bits[:, 1] * bits[:, 4] ** 2  # 0 and 3 alike, 2 without effect
    values = shapley(np.stack([worth, 2 * worth], axis=1))
    np.testing.assert_allclose(values[0], values[3])
    np.testing.assert_allclose(values[2], 0.0, atol=1e-15)
    np.testing.assert_allclose(values.sum(axis=0), [worth[-1] - worth[0], 2 * (worth[-1] - worth[0])])
    with pytest.raises(InvalidInput, match="6 coalitions"):
        shapley(np.zeros(6))


# ----------------------------------------------------------------------------------------------------- the machine


def test_shares_add_up_to_the_difference_of_the_real_and_the_ideal_machine(found):
    stack = stacks.resolve("xi2023-improved")
    real = metrics.evaluate(rollout.roll(ROUGH, stack, SEEDS))["rms_true"] ** 2
    np.testing.assert_allclose(found.errors[0], real)
    np.testing.assert_allclose(found.shares.sum(axis=0), found.errors[0] - found.errors[-1], rtol=1e-9)
    assert found.errors[-1].mean() < real.mean()
    table = shares([found])
    np.testing.assert_allclose(table["share"].sum(), real.mean())
    assert (table["low"] <= table["share"]).all()
    assert (table["share"] <= table["high"]).all()
    preview = metrics.evaluate(rollout.roll(ROUGH, stacks.resolve("preview-5ms"), SEEDS))["rms_true"]
    gained = headroom([found]).set_index("informed").loc["preview-5ms"]
    assert gained["ratio"] == pytest.approx(np.sqrt(real.mean() / np.mean(preview**2)))
    assert gained["low"] < gained["ratio"] < gained["high"]


def test_a_stage_that_is_made_worse_gains_share(found):
    stack = stacks.resolve("xi2023-improved")
    flat = scenarios.load("flat").varied(duration=0.8, settle=0.1)  # where noise is all that there is
    louder = flat.varied(head={"noise": {"log_uniform": [5 * n for n in flat.head.noise.log_uniform]}})
    before, after = (of(measured(s, stack, SEEDS, references=()), "sensor") for s in (flat, louder))
    assert after > 5 * before > 0
    later = ROUGH.varied(axis={"dead_time": {"choice": [0.004]}})  # 1 or 2 ms, plus 3 or 2
    assert of(measured(later, stack, SEEDS, references=()), "dead time") > 2 * of(found, "dead time") > 0
    sluggish = ROUGH.varied(axis={"bandwidth": 30.0})
    assert of(measured(sluggish, stack, SEEDS, references=()), "servo") > 2 * of(found, "servo") > 0
    slower = stack.varied({"filter.window": 12.0})
    assert of(measured(ROUGH, slower, SEEDS, references=()), "filter") > 2 * of(found, "filter") > 0


def test_a_stage_without_effect_is_not_simulated_and_has_no_share(found):
    quick = measured(ROUGH, stacks.resolve("xi2023-tuned"), SEEDS[:2], told=(told := []).append)
    assert sum(told) == 2 * 16
    assert not quick.shares[FOLLOWING.index("filter")].any()
    assert (quick.errors[0] != quick.errors[-1]).all()


def test_of_a_job_gap_and_contour_are_blamed_apart():
    job = scenarios.load("contour-mismatch").varied(job={"size": 40.0})  # mm, diameter
    team = stacks.team("z=xi2023-improved,xy=wu")
    gap, contour = measure(job, team, SEEDS[:2], ["servo", "matching", "axes"], references=("oracle",))
    fleet, programme, _ = jobs.roll(job, team, SEEDS[:2])
    real = job_metrics.evaluate(job_metrics.Jobs.of(fleet, programme))
    np.testing.assert_allclose(gap.errors[0], real["gap_rms"] ** 2)
    np.testing.assert_allclose(contour.errors[0], real["contour_rms"] ** 2)
    assert stages_of(job) == JOBS
    assert (list(gap.references), list(contour.references)) == (["oracle"], [])
    assert gap.shares[0].min() > 0
    servo, matching, axes = contour.shares
    assert np.abs(servo).max() < 1e-3 * matching.min()
    # Drives that lag are of use: the loop Kv = 30 1/s alone makes the circle too small, its sampled first-order lag by
    # R·(1 − |H|), H = K/(e^(jωT) − 1 + K), K = Kv·T, ωT = 60 mm/s · 4 ms/R.
    k, turn = 30.0 * 0.004, 60.0 * 0.004 / 20.0
    small = 20e3 * (1 - abs(k / (np.exp(1j * turn) - 1 + k)))
    np.testing.assert_allclose(np.sqrt(contour.errors[0b110]), small, rtol=0.05)
    assert axes.max() < 0


def test_threads_change_nothing(found):
    again = measured(ROUGH, stacks.resolve("xi2023-improved"), SEEDS, threads=2, references=())
    np.testing.assert_array_equal(again.errors, found.errors)


# ---------------------------------------------------------------------------------------------------- the tables


def test_intervals_are_paired_and_need_two_seeds():
    random = np.random.default_rng(0)
    real, gained = random.normal(500.0, 90.0, 200), random.normal(5.0, 1.0, 200)
    whole = Blame(
        "s", "c", "gap", tuple(range(200)), ("servo",), np.array([real, real - gained]), {"oracle": real / 16}
    )
    row = shares([whole]).set_index("stage").loc["servo"]
    half = 1.96 * gained.std(ddof=1) / 200**0.5  # of the difference, not of the errors, which scatter far more
    assert (row["low"], row["high"]) == pytest.approx((row["share"] - half, row["share"] + half), abs=0.2 * half)
    gain = headroom([whole]).loc[0]
    assert (gain["ratio"], gain["low"], gain["high"]) == pytest.approx((4.0, 4.0, 4.0))
    single = Blame("s", "c", "gap", (1,), ("servo",), np.array([[4.0], [1.0]]), {})
    row = shares([single]).set_index("stage").loc["servo"]
    assert row["share"] == 3.0
    assert np.isnan([row["low"], row["high"]]).all()


def test_a_failed_run_leaves_no_share_of_its_controller():
    errors = np.ones((4, 3)) * np.array([4.0, 2.0, 3.0, 1.0])[:, None]
    errors[1, 2] = np.nan
    broken = Blame("s", "c", "gap", (1, 2, 3), ("sensor", "servo"), errors, {"oracle": np.ones(3)})
    assert broken.failed == 1
    table = shares([broken]).set_index("stage")
    assert table.loc[["sensor", "servo"], ["share", "low", "high"]].isna().all(axis=None)
    assert table.loc["law", "share"] == 1.0


def test_a_part_is_read_back_as_it_was(found):
    frame = coalitions(found)
    assert len(frame) == (32 + 2) * len(SEEDS)
    (again,) = of_coalitions(frame, found.controller, found.stages)
    assert (again.seeds, list(again.references)) == (found.seeds, list(found.references))
    np.testing.assert_array_equal(again.errors, found.errors)
    mine = frame[(frame["controller"] == found.controller) & (frame["idealised"] == "sensor+servo")]
    np.testing.assert_array_equal(mine["square"], found.errors[0b01001])


# --------------------------------------------------------------------------------------------------- the commands


def test_the_command_writes_a_run_that_resumes_and_repeats(tmp_path, monkeypatch):
    def ask(folder, **more):
        return blame(Grid("x", ("pid",), (ROUGH,), SEEDS[:2]), folder, ["servo", "dead time"], command=["x"], **more)

    table, room = ask(tmp_path / "a")
    files = {p.name for p in (tmp_path / "a").iterdir()}
    assert files == {
        "blame.parquet",
        "blame.csv",
        "headroom.parquet",
        "headroom.csv",
        "coalitions.parquet",
        "blame.png",
        "run.json",
        "scenarios",
    }
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "a" / "blame.parquet"), table)
    record = json.loads((tmp_path / "a" / "run.json").read_text())
    assert record["ledger"]["simulated_steps"] == ROUGH.steps * 2 * (4 + 2)

    with monkeypatch.context() as patch:
        patch.setattr(runner, "_write", lambda *_: 1 / 0)  # killed after everything was simulated
        with pytest.raises(ZeroDivisionError):
            ask(tmp_path / "b")
    with monkeypatch.context() as patch:
        patch.setattr(runner.game, "measure", lambda *_, **__: 1 / 0)  # nothing is left to simulate
        again, same_room = ask(tmp_path / "b", resume=True)
    pd.testing.assert_frame_equal(again, table)
    pd.testing.assert_frame_equal(same_room, room)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"stages": ["server"]}, "unknown stage 'server'.*servo"),
        ({"stages": ["servo", "servo"]}, "given twice"),
        ({"stages": ["axes"]}, "of jobs; in scenario 'short' it is ideal already"),
        ({"controllers": ["wu"]}, "slot 'xy'"),
        ({"controllers": ["pid", "pid"]}, "given twice"),
        ({"scenarios": [ROUGH, scenarios.load("cut-square")]}, "cannot share a table"),
        ({"threads": 0}, "--threads 0"),
    ],
)
def test_bad_input_is_told_before_anything_is_written(tmp_path, words, message):
    given = {"controllers": ["pid"], "scenarios": [ROUGH], "stages": [], "threads": 1} | words

    def ask():
        grid = Grid("x", tuple(given["controllers"]), tuple(given["scenarios"]), (1000,))
        blame(grid, tmp_path / "x", given["stages"], given["threads"])

    with pytest.raises(InvalidInput, match=message):
        ask()
    assert not (tmp_path / "x").exists()


def test_a_benchmark_stores_blame_of_reference_and_best(tmp_path, monkeypatch):
    monkeypatch.setattr("kerfgym.experiments.report.page.write_report", lambda *_: None)
    results = benchmarking.run(
        ["xi2023-tuned", "pid", "preview-5ms"],
        [ROUGH],
        tmp_path / "r",
        SEEDS[:2],
        with_ms=False,
        with_blame=True,
        workers=1,
        quiet=True,
        command=["x"],
    )
    stored = pd.read_parquet(tmp_path / "r" / "blame.parquet")
    best = results.summary().loc[["xi2023-tuned", "pid"], "score"].idxmin()
    assert list(stored["controller"].unique()) == list(dict.fromkeys(["xi2023-tuned", best]))
    assert list(stored.columns[:7]) == ["scenario", "controller", "stage", "share", "low", "high", "unit"]
    total = stored.groupby("controller")["share"].sum()
    np.testing.assert_allclose(total["xi2023-tuned"], results.pooled().loc["xi2023-tuned", "short"] ** 2)
    assert (tmp_path / "r" / "headroom.parquet").is_file()
    assert not (tmp_path / "r" / "parts").exists()
