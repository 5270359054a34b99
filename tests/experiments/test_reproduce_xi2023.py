"""Xi2023 beside the simulation: what is printed, what the filters do, and Table 1 within the promised deviations."""

import re
import tomllib

import numpy as np
import pytest

from kerfgym.experiments.reproduce import fit_table1 as table1
from kerfgym.experiments.reproduce.claims import DOCUMENTS, Estimate, Row, Trial, studies
from kerfgym.experiments.reproduce.xi2023_filters import centred, kind, machine_filters, noisy, six_steps
from kerfgym.experiments.reproduce.xi2023_sensor import c5_of, inductance, megahertz
from kerfgym.experiments.reproduce.xi2023_table import OneSided

FEW = Trial(seeds=6)

STUDIES = (
    "oscillator",
    "calibration-run",
    "look-up",
    "moving-average",
    "improved-filter",
    "table-1",
    "rising-height",
    "above-set-height",
    "static-accuracy",
    "dynamic-accuracy",
)

PRINTED = {
    "oscillator": ("1.665–4.053 MHz, 10–50 pF",),
    "calibration-run": ("1000", "0.01 mm"),
    "table-1": tuple(f"{e:.6f} mm (height {h:.6f})" for row in table1.TABLE_1.values() for h, e in row.values()),
    "static-accuracy": ("0.001 mm",),
    "dynamic-accuracy": ("500 mm/s", "0.01 mm"),
}
"""What the column of the paper must hold, by study."""


@pytest.fixture(scope="module")
def found():
    """Findings of every study but the operator's, by key, few seeds."""
    return {s.key: s.run(FEW) for s in studies([f"xi2023/{key}" for key in STUDIES])}


def rows(found, key: str, words: str) -> list[Row]:
    """Rows of a study whose claim has these words."""
    return [row for row in found[key].rows if words in row.claim]


def numbers(text: object) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.?\d*", str(text).replace("−", "-"))]


def test_the_studies_come_in_the_order_of_the_paper():
    keys = [s.key for s in studies(["xi2023"])]
    assert keys[: len(STUDIES)] == list(STUDIES)


@pytest.mark.parametrize("key", PRINTED)
def test_the_papers_column_is_what_is_printed(found, key):
    assert set(PRINTED[key]) <= {row.paper for row in found[key].rows}


def test_every_study_draws_and_every_picture_has_a_name_of_its_own(found):
    names = [drawing.name for findings in found.values() for drawing in findings.drawings]
    assert all(findings.drawings for findings in found.values())
    assert len(set(names)) == len(names)
    assert all(ax.get_xlabel() and ax.get_ylabel() for f in found.values() for d in f.drawings for ax in d.figure.axes)


# ---------------------------------------------------------------------------------------------------- the oscillator


def test_the_two_ends_of_the_band_ask_for_inductances_of_154_and_183_uh():
    assert inductance(4.053, 10.0) == pytest.approx(154.2, abs=0.05)
    assert inductance(1.665, 50.0) == pytest.approx(182.7, abs=0.05)


def test_capacitors_in_series_and_in_parallel_only_narrow_a_band():
    from kerfgym.envs.plant import sensor

    plain = megahertz(sensor.EQ3, 10.0) / megahertz(sensor.EQ3, 50.0)
    assert plain == pytest.approx(5**0.5)
    assert plain < 4.053 / 1.665
    series = sensor.EQ3._replace(series=3 / 1000)
    assert megahertz(series, 10.0) / megahertz(series, 50.0) < plain
    assert megahertz(sensor.EQ3, 15.0) / megahertz(sensor.EQ3, 55.0) < plain
    assert megahertz(sensor.EQ1, c5_of(sensor.EQ1, 2.5)) == pytest.approx(2.5)


def test_the_contradictions_of_the_oscillator_are_called_that(found):
    assert {row.verdict for row in rows(found, "oscillator", "one L1")} == {"not reproducible as printed"}
    assert {row.verdict for row in rows(found, "oscillator", "in series")} == {"not reproducible as printed"}


# ------------------------------------------------------------------------------------------------------- the filters


def test_the_buffer_is_the_printed_sum_k_samples_late():
    x = noisy(5, 400)
    y = machine_filters([kind("mean", window=7)], x)[:, 0]
    assert y[6:] == pytest.approx(np.convolve(x, np.ones(7) / 7, "valid"), abs=1e-5)
    assert y[6:] == pytest.approx(centred(x, 3), abs=1e-5)


def test_the_six_steps_are_a_trimmed_mean():
    x = noisy(6, 400)
    y = machine_filters([kind("improved", window=7)], x)[:, 0]
    sorted_ = np.sort(np.lib.stride_tricks.sliding_window_view(x, 7), axis=1)
    assert six_steps(x, 7)[6:] == pytest.approx(sorted_[:, 1:-1].mean(axis=1), abs=1e-5)
    assert np.isnan(six_steps(x, 7)[:6]).all()
    assert y[6:] == pytest.approx(six_steps(x, 7)[6:], abs=1e-5)


def test_the_studies_say_so_too(found):
    for key, words, verdict in (
        ("moving-average", "N = 3, 5, 9, 17", "reproduced"),
        ("moving-average", "delay", "present"),
        ("improved-filter", "six steps", "reproduced"),
    ):
        (row,) = rows(found, key, words)
        assert row.verdict == verdict
    (pair,) = rows(found, "improved-filter", "two samples")
    assert numbers(pair.simulation) == pytest.approx([33.3, 40])


# ----------------------------------------------------------------------------------------------------------- Table 1


@pytest.fixture(scope="module")
def table():
    """Table 1 on 24 seeds that the fit has not seen."""
    return table1.medians(table1.load(), range(24))


def test_table_1_is_met_within_5_percent_where_it_was_fitted_and_12_where_not(table):
    assert len(table) == 10
    assert table[table["fitted"]]["deviation"].abs().max() <= 0.05
    assert table[~table["fitted"]]["deviation"].abs().max() <= 0.12


def test_the_improvement_is_smaller_on_the_true_gap(table):
    middle = table.groupby("filter")[["reported", "true"]].median()
    reported, true = middle.loc["moving average"] / middle.loc["improved"]
    assert 3.0 < reported < 3.7
    assert 1.1 < true < 1.7


def test_the_verdicts_of_table_1_tell_fitted_from_held_out(found):
    for height in table1.TABLE_1:
        both = rows(found, "table-1", f"set height {height:g} mm")
        assert len(both) == 2
        assert {row.verdict for row in both} == {"calibrated" if height in table1.FITTED else "trend only"}
        assert all((row.evidence is None) == (height in table1.FITTED) for row in both)
        assert all(isinstance(row.true, Estimate) and row.true.low < row.true.value < row.true.high for row in both)


def test_the_line_between_the_fitted_points_is_beside_every_number_held_out(found, table):
    line = {
        (0.3, "moving average"): -9.05,
        (0.3, "improved"): -10.13,
        (0.7, "moving average"): 4.60,
        (0.7, "improved"): 4.30,
    }
    for (height, name), deviation in line.items():
        (row,) = rows(found, "table-1", f"{name}, set height {height:g} mm")
        assert row.evidence.trivial_error == pytest.approx(deviation, abs=0.01)
        assert row.evidence.trivial == "a straight line between the fitted points"
    assert (table.loc[table["fitted"], "line"] == 0).all()


def test_what_is_held_out_is_no_better_than_a_line_and_is_said_so(found):
    (row,) = rows(found, "table-1", "held out of the fit, together")
    assert row.evidence.error > 0.5 * row.evidence.trivial_error
    assert row.evidence.telling
    assert row.verdict == "trend only"
    assert "predicts next to nothing" in row.note


def test_a_machine_that_meets_the_held_out_numbers_is_said_to_reproduce_them(monkeypatch):
    from kerfgym.experiments.reproduce import xi2023_table

    def exact(p, height, name, seeds):
        error = np.full(12, table1.TABLE_1[height][name][1])
        return table1.Largest(error, error)

    monkeypatch.setattr(table1, "largest", exact)
    (row,) = [row for row in xi2023_table.table_1(FEW).rows if "together" in row.claim]
    assert row.verdict == "reproduced"


def test_the_papers_own_law_has_a_row_of_its_own_beside_the_observers(found):
    (own,) = rows(found, "dynamic-accuracy", "within 0.01 mm, xi2023-improved")
    (observer,) = rows(found, "dynamic-accuracy", "within 0.01 mm, observer")
    assert own.verdict == "does not hold here"
    assert own.instead == ""
    assert observer.verdict != "reproduced"
    assert observer.instead == "observer, not the paper's law"
    assert f"that holds 0.01 mm up to {own.simulation.value:.2g} mm/s" in observer.note


def test_the_fit_has_not_seen_the_seeds_of_a_reproduction_nor_the_heights_held_out():
    record = tomllib.loads(table1.FILE.read_text(encoding="utf-8"))["record"]
    assert record["seeds"][0] >= 10_000
    assert not set(record["fitted_heights"]) & set(record["held_out_heights"])
    assert record["parameters"] < record["numbers"]
    assert record["largest_deviation_fitted"] <= 0.05


def test_a_fit_finds_the_law_of_the_gain_again(monkeypatch):
    monkeypatch.setattr(table1, "LASTS", 1.0)
    wrong = table1.load()._replace(gain_scale=1.3 * table1.load().gain_scale)
    before = (table1.medians(wrong, range(24), table1.FITTED)["deviation"] ** 2).sum()
    after = table1.medians(table1.fit(range(24), wrong), range(24), table1.FITTED)["deviation"]
    assert (after**2).sum() < 0.2 * before


def test_a_run_without_impulses_lags_by_the_surface_speed_over_the_gain():
    p = table1.load()._replace(impulse=1e-6)
    for height in (0.1, 0.5):  # higher up noise adds to it
        lag = p.speed / table1.gain(p, height)
        assert np.median(table1.largest(p, height, "improved", range(6)).true) == pytest.approx(lag, rel=0.1)


# ------------------------------------------------------------------------------------------------------- conclusions


def test_noise_alone_makes_the_error_rise_with_the_height(found):
    for row in rows(found, "rising-height", "electrical noise"):
        first, last = numbers(row.simulation)
        assert last > first
        assert row.verdict == "does not hold here"


def test_a_p_law_is_above_the_set_height_half_of_the_time(found):
    (row,) = rows(found, "above-set-height", "P law")
    assert row.simulation.value == pytest.approx(50, abs=2)
    assert row.verdict == "does not hold here"


def test_table_1_contradicts_the_sentence_about_it(found):
    (row,) = rows(found, "rising-height", "errors of Table 1 themselves")
    assert row.verdict == "not reproducible as printed"
    assert numbers(row.simulation)[:4] == [6, -12, -19, -15]


def test_the_one_sided_law_rests_above_the_set_height_only():
    class Signals:
        set_height = 1.0

    def answer(height: float) -> float:
        signals = Signals()
        signals.height = height
        return OneSided(40.0, 0.01).control(signals)

    assert [answer(h) for h in (0.99, 1.005, 1.01)] == pytest.approx([0.4, 0.0, 0.0])
    assert answer(1.03) == pytest.approx(-0.8)


def test_static_accuracy_needs_interpolation(found):
    interpolated = rows(found, "static-accuracy", "interpolate")
    assert all(row.evidence.met and "does not mention" in row.instead for row in interpolated)
    assert {row.verdict for row in interpolated} == {"trend only"}
    nearest = rows(found, "static-accuracy", "nearest")
    # Within an entry of the table, 0.01 mm: the tolerance of 0.001 mm is missed, at 0.9 mm by a hair or not at all.
    assert [row.verdict for row in nearest[:2]] == ["does not hold here"] * 2
    for one, other in zip(interpolated, nearest, strict=True):
        assert one.evidence.error < 0.7 * other.evidence.error


def test_a_p_law_keeps_its_accuracy_up_to_gain_times_error(found):
    (slope,) = rows(found, "dynamic-accuracy", "xi2023-improved")
    assert slope.simulation.value == pytest.approx(50 * 0.01, rel=0.1)
    (limit,) = rows(found, "dynamic-accuracy", "limit")
    assert limit.simulation.value == pytest.approx(500, rel=0.01)


def test_the_document_is_one_of_the_page():
    assert "xi2023" in DOCUMENTS
