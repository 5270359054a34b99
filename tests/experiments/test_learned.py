"""Learned against classical: the figures are those of the runs' CSV, and nothing is compared that cannot be."""

import csv
import math
from dataclasses import replace

import numpy as np
import pytest

from kerfgym.experiments.report import learned as shown
from kerfgym.experiments.report import page, terminal
from kerfgym.experiments.results import archive
from kerfgym.experiments.statistics import rivals
from kerfgym.tests.experiments.conftest import TUNED, following
from kerfgym.tests.experiments.test_report import read

SEEDS = range(1000, 1030)
FOLLOWERS = {
    "xi2023-tuned": ("sensor", 24.0, 1.9),
    "pid": ("sensor", 8.0, 1.95),
    "net": ("sensor", 6.0, 1.5),
    "preview-5ms": ("preview", 2.0, 1.12),
}
POLICY = {"ledger": {"simulated_steps": 51_000_000, "cpu_seconds": 190.0}, "command": "kerfgym train gradient"}


def results(controllers=FOLLOWERS, policies=("net",), **changes):
    """Followers of which some are policies on ``pid``; 5 µm can be had in ``wavy``."""
    found = following(controllers, seeds=SEEDS, **changes)
    meta = found.meta
    for name in controllers:
        meta["parameters"][name] = {"law.kp": 50.0 if name in (*policies, "pid") else 70.0}
    meta["tuning"] |= {name: {**TUNED, "simulated_steps": 651_000_000, "policy": POLICY} for name in policies}
    meta["bounds"] = {"wavy": 2.0}
    return found


def failing(found, controller, scenario, seeds, column="failed"):
    """The same with some runs that failed or touched the sheet."""
    runs = found.runs.copy()
    hit = (runs["controller"] == controller) & (runs["scenario"] == scenario) & runs["seed"].isin(seeds)
    runs.loc[hit, column] = 1.0 if column == "collision" else True
    runs.loc[hit, "rms_true"] = 1e6  # what a failed run says is no figure
    return replace(found, runs=runs)


def test_the_table_is_what_the_runs_csv_says(tmp_path):
    found = failing(results(exempt=("holes",)), "net", "rough", [1003, 1004])
    found = failing(found, "pid", "wavy", [1007], "collision")
    archive.save_tables(tmp_path, {"following": found}, {}, {})
    with (tmp_path / "runs.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    with (tmp_path / "learned.csv").open(encoding="utf-8") as stream:
        told = {row["scenario"]: row for row in csv.DictReader(stream)}
    assert list(told) == ["wavy", "rough", "holes", "score"]
    assert {(row["learned"], row["classical"], row["kind"]) for row in told.values()} == {("net", "pid", "best, base")}
    errors = {}
    for scenario in ("wavy", "rough", "holes"):
        of = {
            name: {r["seed"]: r for r in rows if (r["controller"], r["scenario"]) == (name, scenario)}
            for name in ("net", "pid")
        }
        exempt = scenario == "holes"

        def sound(row, exempt=exempt):
            return row["failed"] == "False" and (exempt or float(row["collision"]) == 0)

        both = [seed for seed in of["net"] if sound(of["net"][seed]) and sound(of["pid"][seed])]
        errors[scenario] = [np.sqrt(np.mean([float(of[n][s]["rms_true"]) ** 2 for s in both])) for n in ("net", "pid")]
        row = told[scenario]
        assert [float(row["error_learned"]), float(row["error_classical"])] == pytest.approx(errors[scenario])
        assert float(row["gain"]) == pytest.approx(100 * (1 - errors[scenario][0] / errors[scenario][1]))
        assert float(row["gain_low"]) < float(row["gain"]) < float(row["gain_high"])
        for name, side in (("net", "learned"), ("pid", "classical")):
            assert int(row[f"collisions_{side}"]) == sum(float(r["collision"]) > 0 for r in of[name].values())
            assert int(row[f"failed_{side}"]) == sum(not sound(r) for r in of[name].values())
            assert int(row[f"runs_{side}"]) == len(SEEDS)
    mine, other = (math.sqrt(errors["wavy"][i] * errors["rough"][i]) for i in (0, 1))
    assert float(told["score"]["gain"]) == pytest.approx(100 * (1 - mine / other))
    assert (told["score"]["collisions_classical"], told["score"]["runs_classical"]) == ("1", "60")  # holes are exempt
    mine, other = errors["wavy"]
    assert float(told["wavy"]["closed"]) == pytest.approx(100 * (other - mine) / (other - 2.0))
    assert told["rough"]["bound"] == told["rough"]["closed"] == told["score"]["closed"] == ""


def test_the_interval_of_a_gain_is_that_of_a_plain_paired_bootstrap():
    found = results()
    row = rivals.side_by_side(found, rivals.Pair("net", "pid")).set_index("scenario").loc["rough"]
    table = found.runs[found.runs["scenario"] == "rough"].pivot(index="seed", columns="controller", values="rms_true")
    net, pid = (table[name].to_numpy() ** 2 for name in ("net", "pid"))
    drawn = np.random.default_rng(0).integers(0, len(net), (20_000, len(net)))
    gains = 100 * (1 - np.sqrt(net[drawn].mean(axis=1) / pid[drawn].mean(axis=1)))
    low, high = np.quantile(gains, [0.025, 0.975])
    assert row["gain_low"] == pytest.approx(low, abs=0.25 * (high - low))
    assert row["gain_high"] == pytest.approx(high, abs=0.25 * (high - low))


def test_references_with_other_information_are_nobody_to_beat():
    pair = rivals.best(results())
    assert (pair.one, pair.other, pair.learned, pair.classical) == ("net", "pid", 1, 2)
    alone = {name: FOLLOWERS[name] for name in ("net", "preview-5ms")}
    assert rivals.pairs(results(alone)) == []


def test_each_policy_stands_beside_its_own_base_and_is_marked_where_it_is_worse():
    found = results({**FOLLOWERS, "bad": ("sensor", 9.0, 1.9)}, policies=("net", "bad"))
    pairs = rivals.pairs(found)
    assert [(p.one, p.other, p.kind) for p in pairs] == [("net", "pid", "best, base"), ("bad", "pid", "base")]
    best, worse = shown.comparisons(found)
    assert best.worse == best.farther == []
    assert worse.worse == ["wavy", "rough", "holes"]
    assert "more than 5 % worse than that in wavy, rough and holes" in shown.beside_base(worse)
    assert "collisions in 0/90 runs against 1/90" in shown.beside_base(worse)


def test_steps_of_training_and_search_stand_beside_each_other():
    found = results()
    own = rivals.effort(found, rivals.Pair("net", "pid"))
    assert (own.training, own.whole, own.search, own.training_cpu, own.search_cpu) == (51e6, 651e6, 600e6, 190.0, 350.0)
    assert "0.0850 times the steps" in shown.spent("net", "pid", own)
    found.meta["tuning"]["pid"] = {"trials": 10}
    unknown = rivals.effort(found, rivals.Pair("net", "pid"))
    assert "So nothing can be said of equal steps." in shown.spent("net", "pid", unknown)
    assert "not at equal steps" in shown.spent("net", "pid", replace(own, training=700e6))


def test_without_a_policy_there_is_nothing_to_compare(tmp_path):
    found = results(policies=())
    assert rivals.pairs(found) == []
    assert not any("classical" in sheet.title for sheet in terminal.sheets(found))
    archive.save_tables(tmp_path, {"following": found}, {}, {})
    assert not (tmp_path / "learned.csv").exists()
    assert "Learned against classical" not in page.page(tmp_path, {"following": found}, found.meta)


def test_policies_alone_are_told_so(tmp_path):
    found = results({name: FOLLOWERS[name] for name in ("net",)})
    assert "Only learned controllers took part" in read(page.page(tmp_path, {"following": found}, found.meta)).text


def test_runs_that_all_failed_are_failures_and_no_figures(tmp_path):
    found = results()
    for scenario in ("wavy", "rough"):
        found = failing(found, "net", scenario, SEEDS)
    row = rivals.side_by_side(found, rivals.Pair("net", "pid")).iloc[-1]
    assert math.isnan(row["gain"])
    assert math.isnan(row["one"])
    assert (row["failed_one"], row["runs_one"]) == (60, 90)
    sentence = shown.headline(shown.Comparison(rivals.Pair("net", "pid"), row.to_frame().T), "net", "pid", "µm")
    assert "cannot be compared" in sentence
    page.page(tmp_path, {"following": found}, found.meta)


def test_the_page_has_the_table_with_the_bound_where_there_is_one(tmp_path):
    found = results()
    whole = read(page.page(tmp_path, {"following": found}, found.meta))
    rows = {row[0].split()[0]: row for row in whole.tables["learned-following-best"] if row and row[0]}
    assert [cell.strip() for cell in rows["wavy"][1:3]] == ["5.66", "4.24"]
    assert rows["wavy"][4].strip() == "2.00"
    assert rows["wavy"][5].strip() == "39"  # (5.66 − 4.24)/(5.66 − 2)
    assert rows["rough"][4].strip() == rows["rough"][5].strip() == "–"
    found.meta["bounds"] = {}
    plain = read(page.page(tmp_path, {"following": found}, found.meta))
    assert len(plain.tables["learned-following-best"][1]) == len(whole.tables["learned-following-best"][1]) - 2


def test_the_terminal_tells_it_in_a_row(capsys):
    sheet = next(s for s in terminal.sheets(results()) if s.title == "learned against classical")
    (row,) = sheet.sections[0]
    assert row[:4] == ["net", "pid (its base)", "6.00", "8.00"]
    assert row[4].startswith("25.0 (")
    assert row[-4:] == ["3/3", "0/3", "0/90", "1/90"]
