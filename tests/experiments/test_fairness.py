"""Fair play: who is ranked with whom, who is only shown, and why."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from kerfgym.envs.control import stack
from kerfgym.experiments.report.terminal import sheets
from kerfgym.experiments.results.conclusions import Results
from kerfgym.experiments.statistics.comparison import by_scenario, figures, methods
from kerfgym.experiments.statistics.ranks import order, overlaps, seeds_of

CORE = ("tilt", "wavy", "step")
RECORD = {"trials": 400, "simulated_steps": 600_000_000, "tune_seeds": "0-39"}
LEVELS = {"xi2023-tuned": 20.0, "pid": 10.0, "twin": 10.0, "slow": 40.0, "seer": 1.0}
SEEDS = range(1000, 1040)


def runs(levels=None, seeds=SEEDS, scenarios=CORE):
    """Every controller's error is its level times the sheet's, which is common, times a little noise of its own."""
    sheet = np.exp(0.5 * np.random.default_rng(0).normal(size=(len(seeds), len(scenarios))))
    rows = []
    for k, (name, level) in enumerate((levels or LEVELS).items()):
        errors = level * sheet * np.exp(0.1 * np.random.default_rng(k + 1).normal(size=sheet.shape))
        for (s, c), error in np.ndenumerate(errors):
            rows.append((name, "preview" if name == "seer" else "sensor", scenarios[c], seeds[s], error, False))
    return pd.DataFrame(rows, columns=["controller", "information", "scenario", "seed", "rms_true", "failed"])


def standings(frame=None, tuning=None):
    frame = runs() if frame is None else frame
    tuning = dict.fromkeys(LEVELS, RECORD) if tuning is None else tuning
    results = Results(frame, pd.DataFrame(), pd.DataFrame(), {"tuning": tuning}, CORE)
    return results.standings


def test_ranks_count_who_is_significantly_better_within_a_class():
    found = standings()
    assert found["rank"].to_dict() == {"xi2023-tuned": 3, "pid": 1, "twin": 1, "slow": 4, "seer": 1}
    assert found["tied"].to_dict() == {"xi2023-tuned": [], "pid": ["twin"], "twin": ["pid"], "slow": [], "seer": []}
    assert not found["reasons"].any()


def test_figures_stand_with_their_intervals():
    frame, found = runs(), standings()
    table = frame[frame["controller"] == "pid"].pivot(index="seed", columns="scenario", values="rms_true")
    assert found.at["pid", "score"] == pytest.approx(np.exp(np.log(np.sqrt((table**2).mean())).mean()), rel=1e-12)
    for figure in ("score", "ratio", "typical", "wins"):
        low, value, high = (found.at["pid", f"{figure}{end}"] for end in ("_low", "", "_high"))
        assert low < value <= high
    assert found.at["pid", "ratio_low"] < 2 < found.at["pid", "ratio_high"]
    assert found.loc["xi2023-tuned", ["ratio", "typical", "wins"]].tolist() == [1.0, 1.0, 0.5]
    assert found.loc["xi2023-tuned", ["ratio_low", "ratio_high"]].tolist() == [1.0, 1.0]


def test_the_unfair_are_shown_with_the_reason_and_take_nobodys_rank():
    tuning = dict.fromkeys(LEVELS, RECORD) | {"pid": {**RECORD, "tune_seeds": "990-1009,1030"}, "slow": {}}
    found = standings(tuning=tuning)
    assert found["rank"].isna().to_dict() == dict.fromkeys(LEVELS, False) | {"pid": True, "slow": True}
    assert found.at["twin", "rank"] == 1
    assert found.at["twin", "tied"] == []
    assert found.at["pid", "reasons"] == ["tuned on seeds of this run: 1000-1009,1030"]
    assert "no record of how it was tuned" in found.at["slow", "reasons"][0]
    assert np.isfinite(found.loc["pid", ["score", "score_low", "score_high", "ratio"]].astype(float)).all()


def test_where_nobody_may_be_ranked_nobody_is():
    found = standings(tuning={})
    assert found["rank"].isna().all()
    assert not found["tied"].any()


def test_a_larger_budget_is_a_reason():
    tuning = dict.fromkeys(LEVELS, RECORD) | {"pid": {**RECORD, "simulated_steps": 1_500_000_000}}
    assert standings(tuning=tuning).at["pid", "reasons"] == ["tuned with 2.5 times the simulated steps of xi2023-tuned"]


def failing(frame, name, runs, column="failed"):
    """A frame in which the first ``runs`` runs of a controller have failed, or touched the sheet."""
    mine = frame.index[frame["controller"] == name][:runs]
    frame.loc[mine, column] = True if column == "failed" else 1.0
    return frame


def test_one_failed_run_is_counted_and_decides_no_rank():
    """Its controller is twice as close as the next: one run in 120 does not turn that round."""
    found = standings(failing(runs(), "pid", 1))
    assert found["rank"].to_dict() == {"xi2023-tuned": 3, "pid": 1, "twin": 1, "slow": 4, "seer": 1}
    assert found.at["pid", "tied"] == ["twin"]
    assert (found.at["pid", "lost"], found.at["pid", "tried"]) == (1, 120)
    assert found.at["pid", "typical"] == pytest.approx(standings().at["pid", "typical"], rel=0.01)  # one in 120
    assert found.at["pid", "typical"] < standings().at["pid", "typical"]


@pytest.mark.parametrize("column", ["failed", "collision"])
def test_one_failed_run_in_two_hundred_decides_neither_rank_nor_figure_of_error(column):
    """A run that touched the sheet has a large figure of its own, which is not in the table's cell."""
    frame = runs(seeds=range(1000, 1200)).assign(collision=0.0)
    before = standings(frame).loc["pid"]
    failing(frame, "pid", 1, column)
    frame.loc[frame.index[frame["controller"] == "pid"][:1], "rms_true"] = 5000.0
    found = standings(frame)
    assert (found.at["pid", "rank"], found.at["pid", "lost"]) == (1, 1)
    assert found.at["pid", "score"] == pytest.approx(before["score"], rel=0.01)
    for figure in ("score", "ratio"):
        width = found.at["pid", f"{figure}_high"] / found.at["pid", f"{figure}_low"]
        assert width == pytest.approx(before[f"{figure}_high"] / before[f"{figure}_low"], rel=0.05)
    assert found.at["pid", "wins"] < before["wins"]


def test_nobody_gains_by_failing_on_the_seeds_that_are_difficult():
    """Who gives up where the error would be large has a smaller score, and neither rank, wins nor ratio for it."""
    frame = runs().assign(collision=0.0)
    honest = standings(frame)
    worst = frame[frame["controller"] == "pid"].sort_values("rms_true").index[-30:]
    frame.loc[worst, "collision"] = 1.0
    found = standings(frame)
    assert found.at["pid", "score"] < 0.9 * honest.at["pid", "score"]
    assert found.at["pid", "ratio"] == pytest.approx(honest.at["pid", "ratio"], rel=0.05)
    assert found.at["pid", "rank"] == 4 > honest.at["pid", "rank"]
    for figure in ("wins", "typical"):
        assert found.at["pid", figure] < honest.at["pid", figure]
    both = order(found)
    assert both.index("pid") > both.index("slow")  # neither does the table show it further up


def test_of_those_that_fail_the_one_that_fails_less_is_better_and_then_the_closer_one():
    frame = runs().assign(collision=0.0)
    for name, count in {"pid": 60, "twin": 2, "slow": 2, "xi2023-tuned": 2}.items():
        failing(frame, name, count, "collision")
    found = standings(frame)
    assert found["rank"].to_dict() == {"xi2023-tuned": 2, "pid": 4, "twin": 1, "slow": 3, "seer": 1}
    assert order(found.drop("seer")) == ["twin", "xi2023-tuned", "slow", "pid"]


def test_two_that_fail_seldom_and_are_alike_share_their_rank():
    frame = runs().assign(collision=0.0)
    for name, count in {"pid": 1, "twin": 3}.items():
        failing(frame, name, count, "collision")
    found = standings(frame)
    assert found.at["pid", "rank"] == found.at["twin", "rank"] == 1
    assert found.at["pid", "tied"] == ["twin"]


def test_who_fails_on_significantly_more_seeds_stands_below_all_whatever_its_error():
    """A risk of 2.5 % for three pairs and two questions: 2 · 0.5^9 is below it, 2 · 0.5^8 is not."""
    frame = runs().assign(collision=0.0)
    core = frame[(frame["controller"] == "pid") & (frame["scenario"] == "wavy")].index
    few, many = frame.copy(), frame.copy()
    few.loc[core[:8], "collision"] = 1.0
    many.loc[core[:9], "collision"] = 1.0
    assert standings(few).at["pid", "rank"] == 1
    found = standings(many)
    assert found["rank"].to_dict() == {"xi2023-tuned": 2, "pid": 4, "twin": 1, "slow": 3, "seer": 1}
    assert found.at["pid", "score"] < 0.6 * found.at["xi2023-tuned", "score"]


def test_one_failed_run_leaves_the_lead_to_who_is_closer():
    """A tenth more error in every run of the other: one failure does not turn that round."""
    frame = runs(seeds=range(1000, 1200)).assign(collision=0.0)
    frame.loc[frame["controller"] == "twin", "rms_true"] *= 1.1
    assert standings(frame).loc[["pid", "twin"], "rank"].tolist() == [1, 2]
    assert standings(failing(frame, "pid", 1, "collision")).loc[["pid", "twin"], "rank"].tolist() == [1, 2]


def test_who_fails_in_all_runs_of_a_scenario_has_no_score_and_says_why():
    frame = runs()
    frame.loc[(frame["controller"] == "pid") & (frame["scenario"] == "wavy"), "failed"] = True
    found = standings(frame).loc["pid"]
    assert found["score"] == np.inf
    assert np.isnan(found["ratio"])
    assert found["note"] == "no score: 40 of 120 runs failed, and of a scenario all"


def test_a_scenario_on_fewer_seeds_leaves_the_others_theirs():
    """An episode of minutes is run on a tenth of the seeds; the others count with all of theirs."""
    frame = runs(seeds=range(1000, 1100))
    few = frame[(frame["scenario"] != "step") | (frame["seed"] < 1010)]
    found = standings(few)
    for name, mine in few.groupby("controller"):
        level = [np.sqrt(np.mean(part["rms_true"] ** 2)) for _, part in mine.groupby("scenario")]
        assert found.at[name, "score"] == pytest.approx(stats.gmean(level))
    assert set(found["tried"]) == {210}
    mine, base = (few[few["controller"] == name]["rms_true"].to_numpy() for name in ("pid", "xi2023-tuned"))
    assert found.at["pid", "wins"] == pytest.approx(np.mean(mine < base))
    without = frame[frame["scenario"] != "step"]
    both = Results(without, pd.DataFrame(), pd.DataFrame(), {}, ("tilt", "wavy"))
    assert found.at["pid", "typical"] == figures(both).at["pid", "typical"]  # and not of ten seeds
    narrow = standings(frame[frame["seed"] < 1010]).loc["pid"]
    wide = found.loc["pid"]
    assert np.log(wide["score_high"] / wide["score_low"]) < 0.7 * np.log(narrow["score_high"] / narrow["score_low"])
    assert found["rank"].to_dict() == standings(frame)["rank"].to_dict()


def test_a_figure_that_is_not_a_number_is_a_failure_too():
    frame = runs()
    frame.loc[frame["controller"] == "pid", "rms_true"] = [
        np.nan,
        *frame.loc[frame["controller"] == "pid", "rms_true"][1:],
    ]
    found = standings(frame).loc["pid"]
    assert (found["lost"], found["tried"]) == (1, 120)
    assert found["wins"] < standings().at["pid", "wins"]


def test_who_was_not_run_everywhere_is_not_ranked():
    frame = runs()
    frame = frame[~((frame["controller"] == "slow") & (frame["scenario"] == "step"))]
    found = standings(frame)
    assert found.at["slow", "reasons"] == ["not run in step"]
    assert np.isnan(found.at["slow", "score"])


def test_one_seed_gives_figures_without_intervals_and_says_why():
    found = standings(runs(seeds=range(1000, 1001)))
    assert found["score"].notna().all()
    assert found["score_low"].isna().all()
    assert set(found["note"]) == {"no interval: there is only one seed"}
    assert set(found["rank"]) == {1}  # nobody is shown to be better


def test_two_copies_on_independent_seeds_are_seldom_significant_winners():
    """At most 7 % of 200 repeats (5 % are expected), here of 20 skewed runs of seven scenarios each."""
    random, won = np.random.default_rng(11), 0
    from kerfgym.experiments.statistics.bootstrap import log_score, replicate
    from kerfgym.experiments.statistics.intervals import Sample

    for _ in range(200):
        plant = random.normal(size=(40, 1))
        values = np.exp(0.3 * plant + 0.4 * random.normal(size=(40, 7)))
        pair = [Sample.of(values[:20], range(20)), Sample.of(values[20:], range(20, 40))]
        won += bool(replicate(pair, log_score, count=500).better().any())
    assert 0 < won <= 14


def test_each_scenario_has_its_interval():
    frame = runs()
    found = by_scenario(Results(frame, pd.DataFrame(), pd.DataFrame(), {}, CORE))
    assert len(found) == len(LEVELS) * len(CORE)
    assert (found["low"] < found["value"]).all()
    assert (found["value"] < found["high"]).all()
    mine = found[(found["controller"] == "pid") & (found["scenario"] == "wavy")].iloc[0]
    assert mine["ratio_low"] < 2.0 < mine["ratio_high"]


@pytest.mark.parametrize(
    ("record", "seen"),
    [
        ({"tune_seeds": "0-39"}, []),
        ({"tune_seeds": "0-39,1003"}, ["tuned on seeds of this run: 1003"]),
        ({"seeds": [1, 1004]}, ["tuned on seeds of this run: 1004"]),
        ({"policy": {"ledger": {"seeds": {"train": "from 10000", "tune": "0-55"}}}}, []),
        (
            {"tune_seeds": "0-3", "policy": {"ledger": {"seeds": {"train": "from 1005"}}}},
            ["tuned on seeds of this run: 1005-1009"],
        ),
        ({"tune_seeds": "0-3", "start": {"tune_seeds": "1000"}}, ["tuned on seeds of this run: 1000"]),
        ({"z": {"tune_seeds": "1000"}, "xy": {"trials": 0}}, ["z: tuned on seeds of this run: 1000"]),
        ({"trials": 400}, ["its record does not say on which seeds it was tuned"]),
        ({"trials": 0}, []),
        ({}, []),
    ],
)
def test_seeds_of_tuning_and_training_are_found_in_every_record(record, seen):
    assert overlaps(record, set(range(1000, 1010))) == seen


def test_the_shipped_records_name_their_seeds():
    for name in stack.names():
        record = stack.get(name).provenance
        assert bool(seeds_of(record)) == bool(record.get("trials"))
    assert any(10_000 in span for span in seeds_of(stack.resolve("agents/trained/height-following-ppo").provenance))


def test_the_printed_table_has_ranks_intervals_and_reasons(capsys):
    tuning = dict.fromkeys(LEVELS, RECORD) | {"slow": {}}
    frame = runs().assign(rms_reported=1.0, collision=0.0, jitter=1.0)
    sheet = sheets(Results(frame, pd.DataFrame(), pd.DataFrame(), {"tuning": tuning}, CORE))[0]
    cells = {row[0]: [row[1], *row[3:5]] for section in sheet.sections for row in section}
    assert {name: row[0] for name, row in cells.items()} == {
        "pid": "1=",
        "twin": "1=",
        "xi2023-tuned": "3",
        "slow": "–",
        "seer": "1",
    }
    assert re.fullmatch(r"\d+\.\d\d \(\d+\.\d\d … \d+\.\d\d\)", cells["pid"][1])
    assert re.fullmatch(r"[12]\.\d\d \(1\.\d\d … 2\.\d\d\)", cells["pid"][2])
    assert cells["xi2023-tuned"][2] == "1.00"
    assert "not ranked: slow: no record of how it was tuned (a class of one's own has it in TUNING)." in sheet.notes
    sheet.show()
    assert "not ranked: slow" in capsys.readouterr().out
    parts = sheet.parts(80)  # on a terminal; each begins with the names
    assert len(parts) > 1
    assert all(part[0] == 0 and len(part) > 1 for part in parts)
    assert sorted(i for part in parts for i in part[1:]) == list(range(1, len(sheet.titles)))
    assert sheet.parts(1000) == [list(range(len(sheet.titles)))]


def test_trainings_of_one_method_are_its_independent_runs():
    trained = [f"runs/ppo-{i}/policy" for i in range(5)]
    levels = {"xi2023-tuned": 20.0, **{name: 10.0 * 1.2**i for i, name in enumerate(trained)}, "runs/sac/policy": 9.0}
    command = "kerfgym train {} --env kerfgym/HeightFollowing-v0 --seed {} --set algorithm.gamma=0.97 --name x{}"
    tuning = {name: {"policy": {"command": command.format("ppo", i, i)}} for i, name in enumerate(trained)}
    tuning["runs/sac/policy"] = {"policy": {"command": command.format("sac", 0, 9)}}
    results = Results(runs(levels), pd.DataFrame(), pd.DataFrame(), {"tuning": tuning}, CORE)
    (found,) = methods(results).to_dict("records")
    assert found["method"] == "kerfgym train ppo --env kerfgym/HeightFollowing-v0 --set algorithm.gamma=0.97"
    assert found["members"] == trained
    assert found["score"] == pytest.approx(stats.gmean([results.standings.at[name, "score"] for name in trained]))
    assert (found["best"], found["worst"]) == pytest.approx(
        (results.standings.at[trained[0], "score"], results.standings.at[trained[-1], "score"])
    )
    alone = results.standings.loc[trained[2]]
    assert found["ratio_high"] / found["ratio_low"] > 2 * alone["ratio_high"] / alone["ratio_low"]  # trainings differ
    assert "methods that were trained" in methods_sheet(results).title


def methods_sheet(results):
    frame = results.runs.assign(rms_reported=1.0, collision=0.0, jitter=1.0)
    found = sheets(Results(frame, pd.DataFrame(), pd.DataFrame(), results.meta, CORE))
    return next(sheet for sheet in found if "methods" in sheet.title)
