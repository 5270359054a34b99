"""Reports of stored runs: joined where they agree, said where they do not, and made of what damage has left."""

import json
import re

import numpy as np
import pandas as pd
import pytest

import kerfgym
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.scenarios import load as load_scenario
from kerfgym.experiments.report.remake import remake
from kerfgym.experiments.results import archive
from kerfgym.experiments.results.archive import load
from kerfgym.experiments.results.conclusions import Results
from kerfgym.experiments.results.merge import labels, merge
from kerfgym.experiments.store import runs

RECORD = {"command": "kerfgym report", "kerfgym": kerfgym.__version__}


def rows(controllers, scenarios, seeds):
    """Runs whose RMS is 100 · controller's number + 10 · scenario's + seed, µm."""
    return pd.DataFrame(
        [
            {
                "controller": name,
                "information": "sensor",
                "scenario": scenario,
                "seed": seed,
                "failed": False,
                "rms_true": 100.0 * number + 10.0 * place + seed,
                "rms_reported": 1.0,
                "p99_true": 2.0,
                "collision": 0.0,
                "jitter": 0.5,
                "dross": 0.1,
                "roughness": 20.0,
            }
            for name, number in controllers.items()
            for place, scenario in enumerate(scenarios)
            for seed in seeds
        ]
    )


def store(
    folder, controllers, scenarios=("wavy", "step"), seeds=range(1000, 1004), texts=None, suite="following", **meta
):
    """A finished run in a folder; ``controllers`` are names with a number that makes their figures."""
    frame = rows(controllers, scenarios, seeds)
    record = {**RECORD, "command": f"kerfgym benchmark --name {folder.name}", "kernel": "k", **meta}
    own = {
        "seeds": "1000-1003",
        "seed_count": len(seeds),
        "scenarios": list(scenarios),
        "controllers": list(controllers),
        "core": ["wavy", "step"],
        "parameters": {name: {"law.kp": float(n)} for name, n in controllers.items()},
        "ledger": {name: {"simulated_steps": 7} for name in controllers},
    }
    channels = {"time": 0.001, "gap": 1.0, "height": 1.0, "mode": 1.0, "scored": True, "set_height": 1.0}
    traces = frame[frame["seed"] == 1000][["controller", "scenario", "seed"]].assign(**channels)
    peaks = pd.DataFrame({"controller": list(controllers), "frequency": 1.0, "magnitude": list(controllers.values())})
    results = Results(frame, traces, peaks, {**record, **own}, ("wavy", "step"), (), dict.fromkeys(scenarios, "s"))
    texts = {name: f'name = "{name}"\n' for name in scenarios} if texts is None else texts
    runs.write_json(folder / "run.json", archive.save_tables(folder, {suite: results}, record, {suite: texts}))
    return load(folder)


@pytest.fixture
def no_page(monkeypatch):
    """Pages have tests of their own."""
    monkeypatch.setattr("kerfgym.experiments.report.page.write_report", lambda *_: None)


def notes(found, word):
    return [note for note in found.meta["notes"] if word in note]


# ------------------------------------------------------------------------------------------------------------- joined


def test_other_controllers_on_the_same_seeds_become_one_table(tmp_path):
    found = merge([store(tmp_path / "a", {"pid": 1}), store(tmp_path / "b", {"observer": 2, "mpc": 3})], RECORD)
    (results,) = found.grids.values()
    assert results.controllers == ["pid", "observer", "mpc"]
    assert results.scenarios == ["wavy", "step"]
    pd.testing.assert_frame_equal(
        results.runs, rows({"pid": 1, "observer": 2, "mpc": 3}, ("wavy", "step"), range(1000, 1004))
    )
    assert results.summary()["ms"].to_dict() == {"pid": 1, "observer": 2, "mpc": 3}
    assert set(results.traces["controller"]) == {"pid", "observer", "mpc"}
    assert results.meta["parameters"]["mpc"] == {"law.kp": 3.0}
    assert found.meta["notes"] == []
    assert found.meta["runs"]["b"]["command"] == "kerfgym benchmark --name b"


def test_runs_of_earlier_versions_had_the_standard_machine_and_sines(tmp_path):
    old, new = store(tmp_path / "old", {"pid": 1}), store(tmp_path / "new", {"observer": 2})
    grid = new.grids["following"]
    noise = grid.sensitivity.assign(magnitude=1.5, signal="noise", peak_low=1.4, peak_high=1.6)
    grid.sensitivity = pd.concat([grid.sensitivity.assign(signal="sine"), noise]).assign(machine="axis.bandwidth 25")
    grid.meta["machines"] = {"axis.bandwidth 25": ["wavy", "step"]}
    (results,) = merge([old, new], RECORD).grids.values()
    found = results.stability.set_index("controller")
    assert found["machine"].to_dict() == {"pid": "standard", "observer": "axis.bandwidth 25"}
    assert found["ms"].to_dict() == {"pid": 1.0, "observer": 2.0}
    assert np.isnan(found.at["pid", "ms_noise"])
    assert found.loc["observer", ["ms_noise", "ms_noise_low", "ms_noise_high"]].tolist() == [1.5, 1.4, 1.6]
    assert results.machines == {"axis.bandwidth 25": ["wavy", "step"]}


def test_a_controller_that_is_the_same_in_both_is_shown_once(tmp_path):
    found = merge([store(tmp_path / "a", {"pid": 1}), store(tmp_path / "b", {"pid": 1, "mpc": 3})], RECORD)
    assert found.grids["following"].controllers == ["pid", "mpc"]
    assert len(found.grids["following"].runs) == 2 * 2 * 4
    assert found.meta["notes"] == ["Suite following: pid is the same, to the last digit, in a and b."]


def test_two_versions_of_a_controller_are_told_apart_and_compared_on_the_same_seeds(tmp_path):
    found = merge([store(tmp_path / "old", {"pid": 1}), store(tmp_path / "new", {"pid": 2})], RECORD)
    results = found.grids["following"]
    assert results.controllers == ["pid@old", "pid@new"]
    wide = results.runs.pivot(index=["scenario", "seed"], columns="controller", values="rms_true")
    assert (wide["pid@new"] - wide["pid@old"] == 100.0).all()
    assert set(results.sensitivity["controller"]) == {"pid@old", "pid@new"}
    assert list(results.meta["ledger"]) == ["pid@old", "pid@new"]
    assert notes(found, "pid differs between the runs in law.kp; shown as pid@old and pid@new.")


def test_one_figure_in_its_last_digit_makes_a_difference(tmp_path):
    a, b = store(tmp_path / "a", {"pid": 1}), store(tmp_path / "b", {"pid": 1})
    b.grids["following"].runs.loc[3, "jitter"] = np.nextafter(0.5, 1.0)
    found = merge([a, b], RECORD)
    assert found.grids["following"].controllers == ["pid@a", "pid@b"]
    assert notes(found, "pid differs between the runs in its figures, with the same program and parameters")


def test_the_reference_keeps_its_name_in_the_first_run(tmp_path):
    found = merge([store(tmp_path / n, {"xi2023-tuned": i, "pid": i}) for i, n in enumerate("ab", 1)], RECORD)
    results = found.grids["following"]
    assert results.controllers == ["xi2023-tuned", "pid@a", "xi2023-tuned@b", "pid@b"]
    assert np.isfinite(results.summary()["ratio"]).all()


def test_only_seeds_and_scenarios_that_all_have_are_compared(tmp_path):
    a = store(tmp_path / "a", {"pid": 1}, ("wavy", "step", "tilt"), range(1000, 1004))
    b = store(tmp_path / "b", {"mpc": 2}, ("step", "wavy"), range(1002, 1009))
    found = merge([a, b], RECORD)
    results = found.grids["following"]
    assert results.scenarios == ["wavy", "step"]
    assert set(results.runs["seed"]) == {1002, 1003}
    assert results.meta["seeds"] == "1002-1003"
    assert not len(results.traces)  # they are of seed 1000
    assert notes(found, "tilt left out, because not every run has it")
    assert notes(found, "(a: 1000-1003; b: 1002-1008); compared are those that all have, 1002-1003")


def test_a_scenario_that_was_changed_is_left_out(tmp_path):
    a = store(tmp_path / "a", {"pid": 1})
    b = store(tmp_path / "b", {"mpc": 2}, texts={"wavy": "feed = 400\n", "step": 'name = "step"\n'})
    found = merge([a, b], RECORD)
    assert found.grids["following"].scenarios == ["step"]
    assert found.grids["following"].core == ("step",)
    assert notes(found, "wavy left out, because the scenario is not the same in every run")


@pytest.mark.parametrize(
    ("other", "why"),
    [
        ({"seeds": range(1100, 1104)}, "the runs have no seed in common"),
        ({"scenarios": ("tilt",)}, "the runs have no scenario in common"),
    ],
)
def test_what_has_nothing_in_common_stands_beside_it(tmp_path, other, why):
    found = merge([store(tmp_path / "a", {"pid": 1}), store(tmp_path / "b", {"pid": 1}, **other)], RECORD)
    assert list(found.grids) == ["following@a", "following@b"]
    assert notes(found, f"Suite following: {why}, so the runs stand beside each other")


def test_suites_of_one_run_stay_as_they_are(tmp_path):
    found = merge([store(tmp_path / "a", {"pid": 1}), store(tmp_path / "b", {"pid": 2}, suite="ood")], RECORD)
    assert {suite: grid.controllers for suite, grid in found.grids.items()} == {"following": ["pid"], "ood": ["pid"]}
    assert found.grids["ood"].meta["command"] == "kerfgym benchmark --name b"
    assert notes(found, "Suite ood is in run b only")


def test_other_versions_and_machines_are_told(tmp_path):
    def both(kernel):
        a = store(tmp_path / "a", {"pid": 1}, machine={"processor": "old"})
        b = store(tmp_path / "b", {"mpc": 1}, kernel=kernel, git={"commit": "0123456789abcdef", "changed": True})
        return merge([a, b], RECORD)

    version = f"kerfgym {kerfgym.__version__}"
    said = f"different versions (a: {version}; b: {version} 0123456789ab with changes); the simulated machine "
    assert notes(both("k"), f"{said}is the same.")
    assert notes(both("other"), f"{said}may differ")
    assert notes(both("k"), "on different machines: times per decision are not comparable")


def test_runs_of_the_same_name_are_told_apart_by_the_folders_above(tmp_path):
    a, b = store(tmp_path / "x" / "run", {"pid": 1}), store(tmp_path / "y" / "run", {"pid": 2})
    assert labels([a, b]) == ["x/run", "y/run"]
    with pytest.raises(InvalidInput, match="run' is given twice"):
        labels([a, a])


# ------------------------------------------------------------------------------------------------------ from the folder


def test_a_joined_run_is_a_run(tmp_path, no_page):
    store(tmp_path / "a", {"pid": 1})
    store(tmp_path / "b", {"pid": 2}, suite="following")
    store(tmp_path / "c", {"pid": 2}, suite="ood")
    folder, made = remake(
        [str(tmp_path / n) for n in "abc"], tmp_path / "all", quiet=True, command=["kerfgym", "report"]
    )
    found = load(folder)
    assert list(found.grids) == ["following", "ood"]
    for suite, results in made.grids.items():
        pd.testing.assert_frame_equal(found.grids[suite].runs, results.runs)
    assert found.meta["notes"] == made.meta["notes"]
    assert found.grids["ood"].meta["command"] == "kerfgym benchmark --name c"
    assert (folder / "following" / "scenarios" / "wavy.toml").is_file()
    text = (folder / "summary.md").read_text(encoding="utf-8")
    assert "| pid@a |" in text
    assert "- Suite following: pid differs between the runs" in text


def test_a_report_is_remade_in_its_folder_and_nothing_else_changes(tmp_path, no_page):
    store(tmp_path / "a", {"pid": 1})
    before = {p.name: p.read_bytes() for p in tmp_path.glob("a/*.*")}
    remake([str(tmp_path / "a")], quiet=True)
    after = {p.name: p.read_bytes() for p in tmp_path.glob("a/*.*")}
    assert after.pop("summary.md")
    assert after == before


def test_a_run_that_cannot_be_read_is_left_out_of_a_joint_report(tmp_path, no_page):
    store(tmp_path / "a", {"pid": 1})
    (tmp_path / "half" / "parts").mkdir(parents=True)
    given = [str(tmp_path / n) for n in ("a", "half")]
    _, found = remake(given, tmp_path / "all", quiet=True)
    assert found.grids["following"].controllers == ["pid"]
    assert notes(found, "Left out: run '")
    assert notes(found, "half' was interrupted; the same command with --resume finishes it")
    with pytest.raises(InvalidInput, match=r"no run folder '.*b'"):
        remake([*given, str(tmp_path / "b")], tmp_path / "more", quiet=True)
    assert not (tmp_path / "more").exists()


def test_no_report_takes_the_place_of_a_run_that_it_is_of(tmp_path):
    store(tmp_path / "a", {"pid": 1})
    with pytest.raises(InvalidInput, match="is one of the runs themselves"):
        remake([str(tmp_path / "a")], tmp_path / "a", overwrite=True)
    assert load(tmp_path / "a")


@pytest.mark.usefixtures("no_page")
@pytest.mark.parametrize("frame", [{"failed": True, "rms_true": np.nan}, {}])
def test_a_single_seed_and_failed_runs_have_a_report(tmp_path, frame):
    found = store(tmp_path / "a", {"pid": 1, "mpc": 2}, seeds=range(1000, 1001)).grids["following"]
    for column, value in frame.items():
        found.runs.loc[found.runs["controller"] == "mpc", column] = value
    runs.write_table(tmp_path / "a", "runs", found.runs)
    remake([str(tmp_path / "a")], quiet=True)
    text = (tmp_path / "a" / "summary.md").read_text(encoding="utf-8")
    assert "one seed per scenario, so nothing says how sure this is" in text
    assert bool(re.search(r"\| mpc \| – \| \d/\d \| – \|", text)) == bool(frame)  # neither rank nor score


# --------------------------------------------------------------------------------------------------------------- damage


def broken(folder, change):
    """A run in whose folder something was changed."""
    store(folder, {"pid": 1})
    change(folder)
    return load(folder)


def edit(**changes):
    def change(folder):
        record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        runs.write_json(folder / "run.json", {**record, **changes})

    return change


def truncate(*names):
    def change(folder):
        for name in names:
            data = (folder / name).read_bytes()
            (folder / name).write_bytes(data[: len(data) // 2])

    return change


def remove(*names):
    def change(folder):
        for name in names:
            (folder / name).unlink()

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (remove("run.json"), "is not a run folder: it has no run.json"),
        (truncate("run.json"), "cannot read '.*run.json'"),
        (
            edit(format=9, kerfgym="7.0"),
            f"has format 9, made by kerfgym 7.0; kerfgym {kerfgym.__version__} reads formats up to 2",
        ),
        (edit(grids={}), "holds nothing to show"),
        (edit(grids=None, command="kerfgym train ppo"), "is not a benchmark's: kerfgym train ppo"),
        (
            edit(grids={"following": {"kind": "following", "folder": "."}}),
            "record of suite 'following' in .* lacks 'core'",
        ),
        (remove("runs.parquet", "runs.csv"), "runs.parquet' is missing"),
        (lambda folder: runs.write_table(folder, "runs", rows({}, (), ())), "runs.parquet' has no"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, change, message):
    with pytest.raises(InvalidInput, match=message):
        broken(tmp_path / "run", change)


@pytest.mark.parametrize("change", [remove("runs.parquet"), truncate("runs.parquet")])
def test_a_damaged_table_is_read_from_its_csv_to_the_last_digit(tmp_path, change):
    found = broken(tmp_path / "run", change)
    pd.testing.assert_frame_equal(found.grids["following"].runs, rows({"pid": 1}, ("wavy", "step"), range(1000, 1004)))
    assert notes(found, "runs.parquet' ")
    assert notes(found, "its CSV was read instead")
    assert found.grids["following"].meta["notes"] == found.meta["notes"]


@pytest.mark.parametrize("change", [remove("traces.parquet"), truncate("traces.parquet")])
def test_without_traces_there_is_a_report_that_says_so(tmp_path, change):
    found = broken(tmp_path / "run", change)
    assert not len(found.grids["following"].traces)
    assert notes(found, "traces.parquet' ")
    assert notes(found, "what it held is not shown")


def test_a_table_that_was_changed_afterwards_is_told(tmp_path):
    def change(folder):
        runs.write_table(folder, "runs", rows({"pid": 0.5}, ("wavy", "step"), range(1000, 1004)))

    assert notes(broken(tmp_path / "run", change), "runs.parquet' was changed after the run")


def test_a_run_of_another_version_is_shown_with_a_note(tmp_path):
    found = broken(tmp_path / "run", edit(kerfgym="0.0.9"))
    assert notes(found, f"made by kerfgym 0.0.9, this page by {kerfgym.__version__}")
    assert found.grids["following"].controllers == ["pid"]


def test_one_suite_that_cannot_be_read_does_not_hide_the_others(tmp_path):
    def change(folder):
        record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        runs.write_json(
            folder / "run.json",
            {**record, "grids": {**record["grids"], "ood": {**record["grids"]["following"], "folder": "ood"}}},
        )

    found = broken(tmp_path / "run", change)
    assert list(found.grids) == ["following"]
    assert notes(found, "Suite ood of run run is left out: ")


def test_a_run_whose_jobs_still_say_a_set_height_is_joined_with_one_that_does_not(tmp_path):
    now = load_scenario("cut-square").to_toml()
    early = "set_height = 0.8\nduration = 3.0\n" + now
    files = [
        store(tmp_path / name, {controller: 1}, ("cut-square",), texts={"cut-square": text}, suite="cutting")
        for name, controller, text in (("a", "pid", early), ("b", "mpc", now))
    ]
    assert merge(files, RECORD).grids["cutting"].controllers == ["pid", "mpc"]
    assert merge(files, RECORD).texts["cutting"] == {"cut-square": now}


@pytest.mark.parametrize(("suite", "name"), [("following", "tip-up"), ("cutting", "cut-square")])
def test_the_first_format_is_still_read(tmp_path, suite, name):
    from kerfgym.envs import scenarios

    folder, case = tmp_path / "old", load_scenario(name)
    frame = rows({"pid": 1}, (name,), range(2)).assign(**{"roughness": 5.0, "iso_roughness": "3"})
    runs.write_table(folder, "runs", frame)
    runs.write_json(
        folder / "run.json",
        {
            **RECORD,
            "seeds": "0-1",
            "seed_count": 2,
            "scenarios": [name],
            "controllers": ["pid"],
            "core": list(scenarios.core(suite)),
            "ledger": {},
            "tuning": {},
            "parameters": {},
        },
    )
    with runs.atomic(folder / "scenarios" / f"{name}.toml") as part:
        dead = "set_height = 0.8\n" if case.job else ""  # which early runs have
        part.write_text(dead + case.to_toml(), encoding="utf-8")
    found = load(folder)
    results = found.grids[suite]
    assert results.controllers == ["pid"]
    assert results.meta["seeds"] == "0-1"
    if suite == "cutting":
        assert results.jobs
        assert (results.metric, results.core) == ("roughness", ("cut-square",))
    else:
        assert results.exempt == ("tip-up",)


def test_an_interrupted_run_says_which_command_finishes_it(tmp_path):
    folder = tmp_path / "runs" / "half"
    runs.write_json(folder / runs.BEGUN, {"commands": ["kerfgym benchmark -c pid"]})
    with pytest.raises(InvalidInput, match="'kerfgym benchmark -c pid' finishes it"):
        load(folder)
