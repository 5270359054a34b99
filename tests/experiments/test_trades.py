"""What a controller of jobs gains and gives against the reference, in numbers and in words."""

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs.figures import evidence, job_metrics
from kerfgym.experiments.report import terminal
from kerfgym.experiments.results.conclusions import Results
from kerfgym.experiments.statistics import ranks
from kerfgym.experiments.statistics.comparison import relative

FACTORS = {"cutting_time": 0.8, "contour_rms": 1.3, "dross": 1.0, "roughness": 0.5, "energy": 0.9}


def results(reference="plain"):
    random = np.random.default_rng(0)
    rows = []
    for scenario in ("one", "other"):
        for seed in range(8):
            base = {m: random.lognormal() for m in job_metrics.METRICS} | {"power_max": 1000.0 + seed, "collision": 0}
            for name in ("plain", "mine"):
                factor = FACTORS if name == "mine" else {}
                # On the same seed both have the same luck, but for dross: now this, now that one is better.
                own = {m: factor.get(m, 1.0) * random.lognormal(0.0, 1e-3) for m in base}
                own["dross"] = 1.3 if (seed % 2 == 0) == (name == "mine") else 1.0
                own |= {"power_max": 1.0 if name == "plain" else 0.9, "collision": 1.0}
                row = {
                    "controller": name,
                    "information": "sensor",
                    "scenario": scenario,
                    "seed": seed,
                    "failed": False,
                    "iso_roughness": "1",
                    "iso_taper": "1",
                    **{m: base[m] * own[m] for m in base},
                }
                rows.append(row)
    return Results(
        pd.DataFrame(rows),
        pd.DataFrame(),
        pd.DataFrame(),
        {},
        ("one", "other"),
        metric="roughness",
        reference=reference,
        jobs=True,
        labels=("assumed",),
    )


def test_each_figure_is_over_the_references_with_an_interval_from_the_same_seeds():
    frame = relative(results(), FACTORS)
    assert list(frame.index) == ["mine"]
    for metric, factor in FACTORS.items():
        value, low, high = frame.loc["mine", [metric, f"{metric}_low", f"{metric}_high"]]
        assert low <= value <= high
        assert value == pytest.approx(factor, rel=0.5 if metric == "dross" else 2e-3)
        runs = results().runs.pivot(index=["scenario", "seed"], columns="controller", values=metric)
        power = 2 if metric == "contour_rms" else 1  # an RMS is pooled as one, all else by its mean
        pooled = (runs**power).groupby("scenario").mean() ** (1 / power)
        assert value == pytest.approx(np.exp(np.log(pooled["mine"] / pooled["plain"]).mean()))


def trades(found):
    """The row of ``mine`` in the table against the reference, by title."""
    sheet = terminal.sheets(found)[1]
    (row,) = sheet.sections[0]
    return dict(zip(sheet.titles, row, strict=True))


def extrapolating(metric):
    """The same, but ``mine`` cut the scenario ``one`` in part faster than was published."""
    found = results()
    found.metric, found.meta = metric, {"tuning": {name: {"trials": 0} for name in ("plain", "mine")}}
    found.runs = found.runs.assign(extrapolated=0.0, **dict.fromkeys(evidence.COLUMNS, 0.0))
    at = (found.runs["controller"] == "mine") & (found.runs["scenario"] == "one")
    found.runs.loc[at, ["extrapolated", "beyond_feed"]] = [0.6, 8.33]
    return found


def test_extrapolated_figures_of_the_cut_are_shown_and_marked_but_not_ranked():
    found = extrapolating("roughness")
    first = terminal.sheets(found)[0]
    rows = {row[0]: dict(zip(first.titles, row, strict=True)) for section in first.sections for row in section}
    assert (rows["mine"]["rank"], rows["plain"]["rank"]) == ("–", "1")
    assert rows["mine"]["Rz, µm"] != "–"
    assert (rows["mine"]["evidence"], rows["plain"]["evidence"]) == ("extrapolated, 30% of the cut", "inside")
    assert trades(found)["evidence"] == "extrapolated, 30% of the cut"
    notes = " ".join(first.notes)
    assert "not ranked: mine: extrapolated: feed by 8.33 mm/s." in notes
    assert "extrapolated: mine: feed by 8.33 mm/s (one)." in notes
    summary = found.summary()
    assert summary.loc["mine", ["extrapolated", "beyond"]].tolist() == [0.3, "feed by 8.33 mm/s"]


def test_what_is_no_figure_of_the_cut_is_ranked_all_the_same():
    assert not any(
        "extrapolated" in why for each in ranks.reasons(extrapolating("contour_rms")).values() for why in each
    )
    assert any("extrapolated" in why for why in ranks.reasons(extrapolating("dross"))["mine"])


def test_better_and_worse_are_what_the_intervals_say():
    first, second = terminal.sheets(results())
    assert second.title.startswith("over plain")
    cells = trades(results())
    assert cells["better in"] == "cutting time, Rz, energy"
    assert cells["worse in"] == "contour rms"
    assert cells["power, W"] == "906"
    assert "plain: 1007 W" in second.notes[-1]
    assert any("assumed" in note for note in first.notes)


def test_a_mean_that_is_better_hides_no_scenario_that_is_worse():
    mixed = results()
    assert "contour rms" in trades(mixed)["worse in"]
    at = (mixed.runs["controller"] == "mine") & (mixed.runs["scenario"] == "one")
    mixed.runs.loc[at, "contour_rms"] /= 2.0  # now 0.65 there, and 1.3 in the other
    assert trades(mixed)["better in"] == "cutting time, contour rms, Rz, energy"
    assert trades(mixed)["worse in"] == "contour rms (other)"


def test_without_the_reference_there_is_nothing_to_set_it_against():
    assert len(terminal.sheets(results(reference="somebody"))) == 1
