"""Benchmark: the grid and its folder, interruption, what is concluded, and what the shipped controllers reach."""

import contextlib
import importlib.util
import json
from unittest import mock

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs.control import stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures.metrics import METRICS
from kerfgym.envs.scenarios import core, load, suite
from kerfgym.experiments.benchmark import benchmarking
from kerfgym.experiments.benchmark.benchmarking import compute, run
from kerfgym.experiments.measure.grids import split_seeds
from kerfgym.experiments.measure.rollout import roll
from kerfgym.experiments.results.conclusions import Results
from kerfgym.experiments.results.tasks import Case, cases
from kerfgym.experiments.statistics import budgets

PAGE = importlib.util.find_spec("kerfgym.experiments.report.page")
SHORT = [load("wavy").varied(duration=0.5), load("impulses").varied(duration=0.5)]

OWN = '''
class Mine:
    """A law of my own."""

    GAIN = 50.0

    def reset(self):
        pass

    def control(self, signals):
        return -self.GAIN * (signals.height - signals.set_height)
'''


@pytest.fixture
def own(tmp_path):
    """A plain-Python controller in a file of its own: the words that name it."""
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    return f"{tmp_path / 'mine.py'}:Mine"


def go(folder, controllers, chosen=SHORT, seeds=range(1000, 1004), report=False, **options):
    """A small run; pages and plots have tests of their own."""
    with contextlib.ExitStack() as stack:
        if not report and PAGE:
            stack.enter_context(mock.patch(f"{PAGE.name}.write_report"))
        return run(controllers, chosen, folder, seeds, **{"workers": 1, "with_ms": False, "quiet": True, **options})


# ---------------------------------------------------------------------------------------------------------- the grid


def test_a_run_leaves_its_tables_its_record_and_its_scenarios(tmp_path, own):
    folder = tmp_path / "runs" / "first"
    results = go(folder, ["pid", own], core=core("following"), report=True)
    expected = {
        "runs.parquet",
        "runs.csv",
        "summary.parquet",
        "summary.csv",
        "traces.parquet",
        "run.json",
        "scenarios",
        "summary.md",
    }
    if PAGE:
        assert (folder / "report.html").stat().st_size > 10_000
    assert {p.name for p in folder.iterdir()} - {"report.html", "plots"} == expected
    assert {p.name for p in (folder / "scenarios").iterdir()} == {"wavy.toml", "impulses.toml"}
    assert load(folder / "scenarios" / "wavy.toml") == SHORT[0]

    runs = pd.read_parquet(folder / "runs.parquet")
    assert len(runs) == 2 * 2 * 4
    assert list(runs.columns) == ["controller", "information", "scenario", "seed", "failed", *METRICS]
    pd.testing.assert_frame_equal(pd.read_csv(folder / "runs.csv"), runs, check_dtype=False)
    pd.testing.assert_frame_equal(results.runs, runs, check_dtype=False)
    keys = list(zip(runs["controller"], runs["scenario"], runs["seed"], strict=True))
    assert keys == [(c, s, n) for c in ("pid", own) for s in ("wavy", "impulses") for n in range(1000, 1004)]

    traces = pd.read_parquet(folder / "traces.parquet")
    assert len(traces) == 2 * 2 * 2 * 500
    assert set(traces["seed"]) == {1000, 1001}
    summary = pd.read_csv(folder / "summary.csv")
    assert summary["controller"].tolist() == ["pid", own]
    assert summary["score"].tolist() == pytest.approx(results.summary()["score"].tolist())


def test_the_record_tells_seeds_versions_parameters_and_cost(tmp_path, own):
    go(tmp_path / "run", ["pid:law.kp=33", own], command=["kerfgym", "benchmark"])
    record = json.loads((tmp_path / "run" / "run.json").read_text(encoding="utf-8"))
    assert record["command"] == "kerfgym benchmark"
    assert {"format", "kerfgym", "python", "packages", "machine", "git"} <= set(record)
    grid = record["grids"]["following"]
    assert (grid["seeds"], grid["seed_count"]) == ("1000-1003", 4)
    assert grid["scenarios"] == ["wavy", "impulses"]
    assert grid["controllers"] == ["pid:law.kp=33", own]
    assert grid["parameters"]["pid:law.kp=33"]["law.kp"] == 33.0
    assert grid["parameters"]["pid:law.kp=33"]["filter.kind"] == 6.0
    for name in grid["controllers"]:
        cost = grid["ledger"][name]
        assert cost["simulated_steps"] == 2 * 4 * 500
        assert cost["cpu_seconds"] > 0


def test_a_row_is_the_roll_out_of_its_seed(tmp_path):
    results = go(tmp_path / "run", ["pid"])
    record = roll(SHORT[1], stack.get("pid"), [1002])
    row = results.runs[(results.runs["scenario"] == "impulses") & (results.runs["seed"] == 1002)].iloc[0]
    for name in METRICS:
        assert row[name] == pytest.approx(METRICS[name].function(record)[0], rel=1e-12), name
    assert row["information"] == "sensor"
    assert not row["failed"]


def test_the_sensitivity_peak_is_measured_when_asked_for(tmp_path):
    results = go(tmp_path / "run", ["xi2023-improved"], seeds=range(1000, 1001), with_ms=True)
    table = pd.read_csv(tmp_path / "run" / "sensitivity.csv")
    assert (table["signal"] == "sine").sum() == 40
    assert set(table["machine"]) == {"standard"}
    peaks = table.groupby("signal")["magnitude"].max()
    assert results.summary()[["ms", "ms_noise"]].to_numpy().tolist() == [pytest.approx(peaks[["sine", "noise"]])]
    assert peaks["sine"] == pytest.approx(peaks["noise"], rel=0.1)  # nothing learns here
    assert 1.0 < peaks["sine"] < 3.0
    row, margins = results.summary().iloc[0], pd.read_csv(tmp_path / "run" / "margins.csv").iloc[0]
    assert (row["gain_margin"], row["delay_margin"]) == pytest.approx((margins["gain"], margins["delay_ms"]))
    assert 3.0 < row["gain_margin"] < 4.0  # python-control's for the linear loop: 3.35 and 21.2 ms
    assert 18.0 < row["delay_margin"] < 23.0


def test_the_cost_of_a_decision_is_in_the_record_and_not_among_the_figures(tmp_path, monkeypatch):
    monkeypatch.setattr(benchmarking.cost, "measure", lambda stack: benchmarking.cost.Decision(0.25, 1.5, 1.5e-3))
    results = go(tmp_path / "run", ["pid", "xi2023-ma"], with_cost=True, report=True)
    record = json.loads((tmp_path / "run" / "run.json").read_text(encoding="utf-8"))
    assert record["grids"]["following"]["decisions"]["pid"] == {"median_us": 0.25, "p99_us": 1.5, "ratio": 0.0015}
    assert results.decisions().loc["xi2023-ma"].tolist() == [0.25, 1.5, 0.0015]
    assert not {"median_us", "p99_us"} & set(results.summary().columns)
    without = go(tmp_path / "without", ["pid"])
    assert np.isnan(without.decisions().loc["pid"].to_numpy(float)).all()
    assert without.summary().at["pid", "trials"] == budgets.spent(stack.get("pid").provenance).trials
    assert results.summary()["budget"].to_dict() == {"pid": "", "xi2023-ma": ""}


def figures(folder):
    return [(folder / name).read_bytes() for name in ("runs.csv", "summary.csv", "runs.parquet", "traces.parquet")]


def test_the_same_command_gives_the_same_figures(tmp_path):
    for name in ("first", "second"):
        go(tmp_path / name, ["xi2023-improved", "pid"])
    assert figures(tmp_path / "first") == figures(tmp_path / "second")


def test_a_seeds_figures_do_not_depend_on_how_many_others_are_run(tmp_path):
    few, many = (
        go(tmp_path / "few", ["pid"], seeds=range(1001, 1003)),
        go(tmp_path / "many", ["pid"], seeds=range(1000, 1040)),
    )
    both = many.runs[many.runs["seed"].isin([1001, 1002])].reset_index(drop=True)
    pd.testing.assert_frame_equal(few.runs, both)


# ------------------------------------------------------------------------------------------------------- interruption


@pytest.fixture
def interrupting(monkeypatch):
    """Lets a given number of tasks pass, then interrupts; returns the tasks that were computed."""
    computed = []

    def after(count):
        computed.clear()

        def counted(case, *rest):
            if len(computed) == count:
                raise KeyboardInterrupt
            computed.append(case)
            return compute(case, *rest)

        monkeypatch.setattr(benchmarking, "compute", counted)
        return computed

    return after


def test_an_interrupted_run_resumes_and_computes_only_what_is_missing(tmp_path, own, interrupting):
    controllers = ["pid", own]
    go(tmp_path / "whole", controllers)
    done = list(interrupting(3)) or interrupting(3)
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path / "half", controllers)
    assert len(done) == 3
    assert not (tmp_path / "half" / "run.json").exists()
    with pytest.raises(InvalidInput, match="use --resume to finish it"):
        go(tmp_path / "half", controllers)
    rest = interrupting(-1)
    go(tmp_path / "half", controllers, resume=True)
    assert len(rest) == 1
    assert figures(tmp_path / "half") == figures(tmp_path / "whole")
    assert not (tmp_path / "half" / "parts").exists()


def test_a_resumed_run_forgets_what_an_earlier_version_of_a_controller_did(tmp_path, own, interrupting):
    interrupting(1)
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path / "half", [own])
    file = tmp_path / "mine.py"
    file.write_text(OWN.replace("50.0", "20.0"), encoding="utf-8")
    interrupting(-1)
    resumed = go(tmp_path / "half", [own], resume=True)
    fresh = go(tmp_path / "fresh", [own])
    pd.testing.assert_frame_equal(resumed.runs, fresh.runs)


def test_an_edit_of_the_controllers_file_during_a_run_never_mixes_versions(tmp_path, own, monkeypatch):
    done = []

    def edits(case, *rest):
        done.append(case)
        if len(done) == 1:
            (tmp_path / "mine.py").write_text(OWN + "# a later thought\n", encoding="utf-8")
        return compute(case, *rest)

    monkeypatch.setattr(benchmarking, "compute", edits)
    with pytest.raises(InvalidInput, match=r"mine.py:Mine' was edited during the run; the same command computes what"):
        go(tmp_path / "run", [own, "pid"])
    resumed = go(tmp_path / "run", [own, "pid"], resume=True).runs
    assert len(done) == 4 + 1  # only what the edit has changed is computed again
    pd.testing.assert_frame_equal(resumed, go(tmp_path / "fresh", [own, "pid"]).runs)


def key(task):
    return task.key(stack.resolve(task.controller))


def test_a_tasks_name_changes_with_everything_its_result_depends_on():
    seeds = (1000, 1001)
    tasks = [
        Case("pid", SHORT[0], seeds, seeds),
        Case("observer", SHORT[0], seeds, seeds),
        Case("pid", SHORT[1], seeds, seeds),
        Case("pid", SHORT[0], (1000, 1002), seeds),
        Case("pid", SHORT[0], seeds),
        Case("pid", None, ()),
        Case("pid", SHORT[0].varied(feed=201), seeds, seeds),
        Case("pid:law.kp=40", SHORT[0], seeds, seeds),
    ]
    assert len({key(task) for task in tasks}) == len(tasks)
    assert key(Case("pid", load("wavy").varied(duration=0.5), seeds, seeds)) == key(tasks[0])


def test_the_grid_holds_every_seed_of_every_pair_once():
    tasks = cases(["pid", "observer"], SHORT, range(1000, 1150), True)
    assert [task.controller for task in tasks if task.scenario is None] == ["pid", "observer"]
    seen = [(t.controller, t.scenario.name, seed) for t in tasks if t.scenario for seed in t.seeds]
    assert len(seen) == len(set(seen)) == 2 * 2 * 150
    assert [t.traced for t in tasks if t.scenario] == [(1000, 1001), ()] * 4


# ---------------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("count", "split", "message"),
    [
        (201, "test", r"--seeds 201 is out of range; split 'test' has 200"),
        (0, "test", r"--seeds 0 is out of range; split 'test' has 200"),
        (-3, "tune", r"--seeds -3 is out of range; split 'tune' has 1000"),
        (5, "trian", r"unknown split 'trian'; did you mean 'train'\?"),
    ],
)
def test_seeds_outside_their_split_are_refused(count, split, message):
    with pytest.raises(InvalidInput, match=message):
        split_seeds(count, split)


def test_seeds_are_the_first_of_their_split():
    assert split_seeds(200) == range(1000, 1200)
    assert split_seeds(3, "reserve") == range(1200, 1203)
    assert split_seeds(2, "tune") == range(0, 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 0}, r"--jobs 0 is out of range; at least 1"),
        ({"controllers": ["pidd"]}, r"unknown controller 'pidd'; did you mean 'pid'\?"),
        ({"controllers": ["pid", "pid:law.kp=0"]}, r"law\.kp = 0\.0 is out of range; allowed: 1 to 400 1/s"),
        ({"controllers": ["pid", "pid"]}, r"controller 'pid' is given twice"),
        ({"chosen": [SHORT[0], SHORT[1], load("wavy")]}, r"scenario 'wavy' is given twice"),
    ],
)
def test_bad_input_is_named_before_anything_is_written(tmp_path, options, message):
    with pytest.raises(InvalidInput, match=message):
        go(tmp_path / "run", **{"controllers": ["pid"], **options})
    assert not (tmp_path / "run").exists()


def test_a_finished_run_is_left_alone_unless_told(tmp_path):
    go(tmp_path / "run", ["pid"])
    before = figures(tmp_path / "run")
    with pytest.raises(InvalidInput, match="exists; use --overwrite to replace it"):
        go(tmp_path / "run", ["xi2023-ma"])
    assert figures(tmp_path / "run") == before
    go(tmp_path / "run", ["xi2023-ma"], overwrite=True)
    assert set(pd.read_csv(tmp_path / "run" / "runs.csv")["controller"]) == {"xi2023-ma"}


# -------------------------------------------------------------------------------------------------------- conclusions


def results_of(runs, core_=("a", "b"), exempt=(), sensitivity=None):
    """Results of runs given as (controller, scenario, seed, RMS in µm); ``collides`` and so on by keyword."""
    rows = []
    for controller, scenario, seed, rms, *more in runs:
        extra = more[0] if more else {}
        row = {
            "controller": controller,
            "information": "preview" if controller == "preview-5ms" else "sensor",
            "scenario": scenario,
            "seed": seed,
            "failed": bool(np.isnan(rms)),
            "rms_true": rms,
            "rms_reported": rms / 2,
            "p99_true": 3 * rms,
            "jitter": 0.5,
            "collision": 0.0,
            **extra,
        }
        rows.append(row)
    peaks = pd.DataFrame(sensitivity or {"controller": [], "frequency": [], "magnitude": []})
    return Results(pd.DataFrame(rows), pd.DataFrame(), peaks, {"seed_count": 2}, core_, exempt)


def grid(controller, a, b):
    return [(controller, "a", 0, a), (controller, "a", 1, a), (controller, "b", 0, b), (controller, "b", 1, b)]


def test_the_score_is_the_geometric_mean_over_the_core_of_the_rms_over_seeds():
    runs = [
        ("pid", "a", 0, 3.0),
        ("pid", "a", 1, 4.0),
        ("pid", "b", 0, 8.0),
        ("pid", "b", 1, 8.0),
        ("pid", "c", 0, 500.0),
        ("pid", "c", 1, 500.0),
    ]
    summary = results_of(runs).summary()
    assert summary.at["pid", "score"] == pytest.approx(np.sqrt(np.sqrt(12.5) * 8.0))
    assert summary.at["pid", "reported"] == pytest.approx(np.sqrt(np.sqrt(12.5) * 8.0) / 2)
    assert summary.at["pid", "p99"] == pytest.approx(3 * np.sqrt(3.5 * 8.0))
    every = results_of(runs, core_=()).summary()
    assert every.at["pid", "score"] == pytest.approx((np.sqrt(12.5) * 8.0 * 500.0) ** (1 / 3))


def test_ratio_and_scale_run_from_the_reference_to_the_preview():
    runs = grid("xi2023-tuned", 40.0, 10.0) + grid("preview-5ms", 2.0, 2.0) + grid("pid", 10.0, 4.0)
    summary = results_of(runs).summary()
    assert summary["ratio"].to_dict() == pytest.approx(
        {"xi2023-tuned": 1.0, "preview-5ms": 10.0, "pid": 20 / np.sqrt(40)}
    )
    assert summary["scale"].to_dict() == pytest.approx(
        {"xi2023-tuned": 0.0, "preview-5ms": 1.0, "pid": np.log10(20 / np.sqrt(40))}
    )
    assert summary["information"].to_dict() == {"xi2023-tuned": "sensor", "preview-5ms": "preview", "pid": "sensor"}


def test_without_the_reference_there_is_no_ratio():
    summary = results_of(grid("pid", 10.0, 4.0)).summary()
    assert np.isnan(summary.at["pid", "ratio"])
    assert np.isnan(summary.at["pid", "scale"])
    assert np.isnan(summary.at["pid", "ms"])


def test_a_failed_run_is_counted_and_leaves_the_error_of_the_others():
    runs = grid("pid", 5.0, 5.0) + grid("observer", 4.0, 4.0)
    runs[1] = ("pid", "a", 1, np.nan)
    results = results_of(runs)
    assert results.summary().at["pid", "score"] == pytest.approx(5.0)
    assert results.summary()["failed"].to_dict() == {"pid": 1, "observer": 0}
    assert results.summary()["runs"].to_dict() == {"pid": 4, "observer": 4}
    assert results.pooled().at["pid", "a"] == pytest.approx(5.0)
    runs[0] = ("pid", "a", 0, np.nan)
    results = results_of(runs)
    assert np.isnan(results.pooled().at["pid", "a"])  # no run is left
    assert np.isnan(results.summary().at["pid", "score"])
    assert results.summary().at["observer", "score"] == pytest.approx(4.0)


def test_a_collision_is_a_failed_run_and_the_others_make_the_error():
    touched = {"collision": 1.0}
    runs = [("pid", "a", 0, 700.0, touched), ("pid", "a", 1, 5.0), ("pid", "wall", 0, 9.0, touched)]
    results = results_of(runs, core_=("a", "wall"), exempt=("wall",))
    assert results.pooled().loc["pid"].to_dict() == {"a": 5.0, "wall": 9.0}  # built to be touched in
    assert results.summary().at["pid", "failed"] == 1


def test_collisions_where_they_are_expected_are_counted_apart():
    runs = [
        ("pid", "a", 0, 5.0, {"collision": 1.0}),
        ("pid", "a", 1, 5.0),
        ("pid", "b", 0, 5.0),
        ("pid", "wall", 0, 900.0, {"collision": 1.0}),
        ("pid", "wall", 1, 900.0, {"collision": 1.0}),
    ]
    row = results_of(runs, exempt=("wall",)).summary().loc["pid"]
    assert (row["collisions"], row["runs"], row["exempt_collisions"]) == (1, 3, 2)


def test_a_run_over_nothing_but_exempt_scenarios_has_a_summary():
    runs = [("pid", "wall", 0, 900.0, {"collision": 1.0}), ("pid", "wall", 1, 900.0)]
    row = results_of(runs, exempt=("wall",)).summary().loc["pid"]
    assert (row["collisions"], row["runs"], row["exempt_collisions"]) == (0, 0, 1)


def test_the_peak_is_the_largest_over_frequencies():
    peaks = {"controller": ["pid"] * 3, "frequency": [1.0, 2.0, 3.0], "magnitude": [0.2, 1.7, 1.1]}
    assert results_of(grid("pid", 1.0, 1.0), sensitivity=peaks).summary().at["pid", "ms"] == 1.7


def test_controllers_and_scenarios_keep_their_order():
    results = results_of(grid("pid", 1.0, 2.0)[::-1] + grid("observer", 1.0, 2.0)[::-1])
    assert results.controllers == ["pid", "observer"]
    assert results.scenarios == ["b", "a"]
    assert results.pooled().columns.tolist() == ["b", "a"]


# ------------------------------------------------------------------------------- what the shipped controllers reach

SEEDS = tuple(range(1000, 1200))
SAFE = [name for name, scenario in suite("following").items() if not scenario.exempt]


@pytest.fixture(scope="module")
def standard():
    """The report's test seeds: three controllers on the core, two of them on everything but what is built to be hit."""
    frames = []
    for name in SAFE:
        scenario = suite("following")[name]
        for controller in ("xi2023-tuned", "pid", "observer") if name in core("following") else ("pid", "observer"):
            frames.append(compute(Case(controller, scenario, scenario.some(SEEDS)), stack.asked(controller))["runs"])
    runs = pd.concat(frames, ignore_index=True)
    return Results(runs, pd.DataFrame(), pd.DataFrame(), {"seed_count": len(SEEDS)}, core("following"), ())


@pytest.mark.parametrize(("controller", "ratio"), [("pid", 1.5), ("observer", 1.6)])
def test_tuned_controllers_follow_better_than_the_tuned_law_of_the_paper(standard, controller, ratio):
    summary = standard.summary()
    assert not summary["failed"].any()
    assert summary.at[controller, "ratio"] >= ratio, summary[["score", "ratio"]]


@pytest.mark.parametrize("controller", ["pid", "observer"])
@pytest.mark.parametrize("scenario", SAFE)
def test_tuned_controllers_collide_with_nothing_they_could_avoid(standard, controller, scenario):
    runs = standard.runs[(standard.runs["controller"] == controller) & (standard.runs["scenario"] == scenario)]
    assert len(runs) == len(load(scenario).some(SEEDS))
    hit = runs.loc[runs["collision"] > 0, "seed"].tolist()
    assert hit == [], f"{len(hit)} of {len(runs)} seeds"
