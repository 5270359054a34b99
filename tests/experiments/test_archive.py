"""Run folders of benchmarks: what is written is read back, one grid or several."""

import json
import shutil
from dataclasses import fields
from unittest import mock

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.scenarios import load as scenario
from kerfgym.experiments.benchmark.benchmarking import Grid, run_grids
from kerfgym.experiments.results import archive
from kerfgym.experiments.results.archive import load
from kerfgym.experiments.store import tabular

SHORT = (scenario("wavy").varied(duration=0.5), scenario("tip-up").varied(duration=0.5))
CIRCLE = (scenario("contour-circle").varied(job={"size": 6.0, "pierce": False}),)
GRIDS = [
    Grid("following", ("pid",), SHORT, range(1000, 1003), ("wavy", "rough")),
    Grid("contour", ("wu",), CIRCLE, range(1000, 1002), ("contour-circle",)),
]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A run of two grids: its folder and the results as they were before they were stored."""
    folder = tmp_path_factory.mktemp("runs") / "two"
    with mock.patch("kerfgym.experiments.report.page.write_report"):  # has tests of its own
        return folder, run_grids(GRIDS, folder, workers=1, quiet=True, command=["kerfgym", "benchmark"])


def equal(read, made):
    """Whether two results hold the same."""
    assert type(read) is type(made)
    for name, value in ((field.name, getattr(made, field.name)) for field in fields(made)):
        if isinstance(value, pd.DataFrame):
            pd.testing.assert_frame_equal(getattr(read, name), value, check_dtype=len(value) > 0)
        else:
            assert getattr(read, name) == value, name


def test_a_run_of_several_grids_is_read_back_as_it_was(stored):
    folder, made = stored
    found = load(folder)
    assert list(found.grids) == ["following", "contour"]
    assert [results.jobs for results in found.grids.values()] == [False, True]
    for name, results in made.items():
        equal(found.grids[name], results)
        pd.testing.assert_frame_equal(found.grids[name].summary(), results.summary())
    assert found.grids["following"].core == ("wavy",)
    assert found.grids["following"].exempt == ("tip-up",)
    assert np.isfinite(found.grids["following"].summary()["ms"]).all()


def test_grids_lie_apart_and_the_record_is_common(stored):
    folder, _ = stored
    for name in ("following", "contour"):
        files = {p.name for p in (folder / name).iterdir()}
        assert {"runs.parquet", "runs.csv", "summary.csv", "traces.parquet"} <= files
    assert (folder / "contour" / "scenarios" / "contour-circle.toml").is_file()
    assert {p.name for p in folder.iterdir()} == {"run.json", "summary.md", "following", "contour"}
    assert load(folder).meta["command"] == "kerfgym benchmark"


def test_a_table_with_a_run_that_is_there_twice_is_an_error(stored, tmp_path):
    folder = tmp_path / "twice"
    shutil.copytree(stored[0], folder)
    table = folder / "following" / "runs.parquet"
    rows = pd.read_parquet(table)
    pd.concat([rows, rows.tail(1)]).to_parquet(table)
    found = load(folder)
    assert list(found.grids) == ["contour"]
    (told,) = [note for note in found.meta["notes"] if "left out" in note]
    assert told.endswith("runs.parquet' has pid in tip-up with seed 1002 twice.")


def test_a_job_without_its_range_in_iso_9013_has_a_dash_there(stored, tmp_path):
    folder = tmp_path / "without"
    shutil.copytree(stored[0], folder)
    table = folder / "contour" / "runs.parquet"
    known = load(folder).grids["contour"].summary()["iso_taper"]
    rows = pd.read_parquet(table)
    rows["iso_roughness"] = pd.Series([None, "2"], dtype=object)
    rows["iso_taper"] = None
    rows.to_parquet(table)
    summary = load(folder).grids["contour"].summary()
    assert list(summary["iso_roughness"]) == ["2"]
    assert list(summary["iso_taper"]) == ["–"] != list(known)
    rows.drop(columns="iso_taper").to_parquet(table)
    assert list(load(folder).grids["contour"].summary()["iso_taper"]) == ["–"]


def unstamped(stored, place):
    """The run without its tables' hashes: of one that has them a changed table is left out whatever it holds."""
    folder = place / "unstamped"
    shutil.copytree(stored[0], folder)
    record = json.loads((folder / "run.json").read_text())
    for grid in record["grids"].values():
        del grid["tables"]
    (folder / "run.json").write_text(json.dumps(record))
    return folder


def test_a_table_beside_the_runs_that_was_changed_is_left_out(stored, tmp_path):
    folder = tmp_path / "changed"
    shutil.copytree(stored[0], folder)
    table = folder / "following" / "margins.parquet"
    rows = pd.read_parquet(table)
    pd.concat([rows, rows]).to_parquet(table)
    found = load(folder)
    assert any(
        note.endswith("margins.parquet' was changed after the run; it is left out.") for note in found.meta["notes"]
    )
    assert not len(found.grids["following"].margins)
    assert np.isfinite(found.grids["following"].summary()["ms"]).all()


@pytest.mark.parametrize(
    ("table", "change", "message"),
    [
        ("margins", lambda t: pd.concat([t, t]), "has a controller twice"),
        ("margins", lambda t: t.assign(controller="p@d"), "has controller 'p@d', of which there is no run"),
        ("traces", lambda t: t.assign(scenario="moon"), "has scenario 'moon', of which there is no run"),
        ("sensitivity", lambda t: t.assign(signal="chirp"), "has signal 'chirp'; known: sine, noise"),
        ("sensitivity", lambda t: t.assign(magnitude=np.inf), "has a frequency or a magnitude that is not finite"),
        ("sensitivity", lambda t: t.assign(frequency=-t["frequency"]), "a frequency or a magnitude that is not finite"),
    ],
)
def test_a_table_that_cannot_stand_beside_the_runs_is_left_out(stored, tmp_path, table, change, message):
    folder = unstamped(stored, tmp_path)
    file = folder / "following" / f"{table}.parquet"
    change(pd.read_parquet(file)).to_parquet(file)
    found = load(folder)
    assert any(f"{message}; it is left out" in note for note in found.meta["notes"])
    assert not len(getattr(found.grids["following"], table))
    assert found.grids["following"].summary().index.size


@pytest.mark.parametrize("suite", ["following", "contour"])
def test_a_column_that_is_gone_takes_its_table_or_its_figures_with_it(stored, tmp_path, suite):
    """With any of them gone there are still a summary and a sentence about it, or another suite."""
    folder = unstamped(stored, tmp_path)
    for table in sorted((folder / suite).glob("*.parquet")):
        whole = pd.read_parquet(table)
        for column in whole if table.stem != "summary" else ():
            whole.drop(columns=column).to_parquet(table)
            found = load(folder)
            needed = column in archive.TABLES["jobs" if suite == "contour" else "following"].get(table.stem, ())
            if suite in found.grids:
                assert column not in getattr(found.grids[suite], table.stem, ())
                assert found.grids[suite].summary().index.size
            if needed or suite not in found.grids:
                assert any(f"has no column {column}" in note for note in found.meta["notes"]), (table.stem, column)
        whole.to_parquet(table)
    assert set(load(folder).grids) == {"following", "contour"}


def test_a_table_of_very_many_columns_is_refused_at_once(tmp_path):
    file = tmp_path / "wide.csv"
    file.write_text(",".join(map("c{}".format, range(50_000))) + "\n")
    with pytest.raises(InvalidInput, match=r"wide\.csv' has 50,000 columns; more than can be read"):
        tabular.read_csv(file)
