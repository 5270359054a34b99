"""What a controller of jobs gains and gives against the reference, in numbers and in words."""

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import job_metrics
from kerfgym.experiments import table
from kerfgym.experiments.comparison import relative
from kerfgym.experiments.jobs import JobResults

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
                rows.append({
                    "controller": name, "information": "sensor", "scenario": scenario, "seed": seed, "failed": False,
                    "iso_roughness": "1", "iso_taper": "1", **{m: base[m] * own[m] for m in base},
                })  # fmt: skip
    return JobResults(
        pd.DataFrame(rows), pd.DataFrame(), {}, "roughness", reference, ("one", "other"), ("assumed",)
    )  # fmt: skip


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


def test_better_and_worse_are_what_the_intervals_say():
    first, second = table.sheets(results())
    assert second.title.startswith("over plain")
    (row,) = second.sections[0]
    cells = dict(zip(second.titles, row, strict=True))
    assert cells["better in"] == "cutting time, Rz, energy"
    assert cells["worse in"] == "contour rms"
    assert cells["power, W"] == "906"
    assert "plain: 1007 W" in second.notes[-1]
    assert any("assumed" in note for note in first.notes)


def test_a_mean_that_is_better_hides_no_scenario_that_is_worse():
    mixed = results()
    (row,) = table.sheets(mixed)[1].sections[0]
    assert "contour rms" in row[-3]
    at = (mixed.runs["controller"] == "mine") & (mixed.runs["scenario"] == "one")
    mixed.runs.loc[at, "contour_rms"] /= 2.0  # now 0.65 there, and 1.3 in the other
    (row,) = table.sheets(mixed)[1].sections[0]
    assert row[-4] == "cutting time, contour rms, Rz, energy"
    assert row[-3] == "contour rms (other)"


def test_without_the_reference_there_is_nothing_to_set_it_against():
    assert len(table.sheets(results(reference="somebody"))) == 1
