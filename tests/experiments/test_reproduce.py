"""The frame of a reproduction: what rows and intervals say, how a run resumes, and how a failure shows."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import binom

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.cli import main
from kerfgym.experiments.reproduce import claims, claims_page
from kerfgym.experiments.reproduce.carry_out import reproduce
from kerfgym.experiments.reproduce.claims import (
    DOCUMENTS,
    Estimate,
    Evidence,
    Row,
    Rows,
    Trial,
    estimate,
    judged,
    weighed,
)
from kerfgym.experiments.reproduce.pictures import Drawing
from kerfgym.experiments.reproduce.verdicts import (
    CALIBRATED,
    FAILS,
    INPUT,
    NAMED,
    NOT,
    PRESENT,
    REPRODUCED,
    SILENT,
    TREND,
)


@pytest.fixture
def shelf(monkeypatch):
    """Studies of one's own in place of the documents'."""
    claims.studies()  # loads the documents once, so that they are not loaded into the shelf
    monkeypatch.setattr(claims, "_studies", {})
    return claims.study


# --------------------------------------------------------------------------------------------------------- estimates


def test_the_interval_of_a_median_is_made_of_the_order_statistics_that_cover_it_in_95_per_cent():
    values = np.random.default_rng(0).normal(size=24)
    found = estimate(values)
    ordered = np.sort(values)
    k = 0
    while binom.cdf(k, 24, 0.5) <= 0.025:
        k += 1
    assert found.value == np.median(values)
    assert found.low == ordered[k - 1]
    assert found.high == ordered[-k]


def test_a_failed_run_makes_the_estimate_a_failure_and_not_a_number():
    found = estimate([1.0, np.nan, 2.0, 3.0, 4.0, 5.0])
    assert np.isnan(found.value)
    assert "failed" in str(found)


def test_few_or_equal_values_have_no_interval():
    assert np.isnan(estimate([1.0, 2.0]).low)
    assert str(estimate([3.0] * 10, "mm")) == "3 mm"


@pytest.mark.parametrize(
    ("value", "text"), [(1234.4, "1234"), (0.00012345, "0.000123"), (-0.5, "−0.5"), (4.053e6, "4.05e+06")]
)
def test_numbers_are_written_with_three_digits(value, text):
    assert str(Estimate(value, digits=4 if value == 1234.4 else 3)) == text


GOOD = Evidence("deviation, %", -0.5, 1.0, "a guess", 30.0)


def test_a_row_takes_no_verdict_of_its_own():
    with pytest.raises(InvalidInput, match="reproduced"):
        Row("eq. 1", "x", "1", "1", "reproducd")
    assert judged(True, TREND) == TREND
    assert judged(np.bool_(False), TREND) == FAILS
    assert judged(False, TREND, NOT) == NOT


def test_reproduced_takes_evidence_that_is_met_and_that_a_trivial_predictor_misses():
    assert Row("eq. 1", "x", "1", "1", REPRODUCED, evidence=GOOD).verdict == REPRODUCED
    missed = Evidence("deviation, %", 1.5, 1.0, "a guess", 30.0)
    guessed = Evidence("deviation, %", 0.5, 1.0, "a guess", -0.9)
    failed = Evidence("deviation, %", np.nan, 1.0, "a guess", 30.0)
    for evidence, why in ((None, "no evidence"), *((e, "does not bear it") for e in (missed, guessed, failed))):
        with pytest.raises(InvalidInput, match=why):
            Row("eq. 1", "x", "1", "1", REPRODUCED, evidence=evidence)
    for verdict in ((REPRODUCED,), (TREND, REPRODUCED)):
        with pytest.raises(InvalidInput, match="weighed"):
            judged(True, *verdict)


@pytest.mark.parametrize("paper", ["", "–", " - ", NAMED, SILENT, f"{NAMED}: stops"])
def test_what_is_only_named_or_not_mentioned_is_present_or_fails_and_nothing_else(paper):
    for verdict in (REPRODUCED, CALIBRATED, TREND, INPUT, NOT):
        with pytest.raises(InvalidInput, match="nothing is printed"):
            Row("eq. 1", "x", paper, "1", verdict, evidence=GOOD)
    assert Row("eq. 1", "x", paper, "1", FAILS).verdict == FAILS
    assert Row("eq. 1", "x", paper, "1", PRESENT).verdict == PRESENT


def test_a_printed_figure_is_more_than_present_and_another_method_reproduces_nothing():
    with pytest.raises(InvalidInput, match="only 'named'"):
        Row("eq. 1", "x", "4.5", "1", PRESENT)
    with pytest.raises(InvalidInput, match="nothing is printed"):
        Row("", "x", "4.5", "1", REPRODUCED, evidence=GOOD)
    with pytest.raises(InvalidInput, match="observer is not the document's method"):
        Row("eq. 1", "x", "4.5", "1", REPRODUCED, evidence=GOOD, instead="observer")


def test_the_verdict_follows_from_the_evidence():
    def verdict(error: float, trivial: float, instead: str = "") -> str:
        evidence = Evidence("deviation, %", error, 1.0, "a guess", trivial)
        return weighed("eq. 1", "x", "4.5", "1", evidence, instead=instead).verdict

    assert verdict(0.9, 1.1) == REPRODUCED
    assert verdict(-0.9, -1.1) == REPRODUCED
    assert verdict(0.9, 0.95) == TREND
    assert verdict(0.9, 1.1, "observer") == TREND
    assert verdict(1.1, 30.0) == FAILS
    assert verdict(np.nan, 30.0) == FAILS
    assert weighed("eq. 1", "x", "4.5", "1", Evidence("%", 2.0, 1.0, "a guess", 9.0), otherwise=NOT).verdict == NOT


@pytest.mark.parametrize(
    "change", [{"measure": ""}, {"trivial": ""}, {"tolerance": -1.0}, {"tolerance": np.inf}, {"trivial_error": np.nan}]
)
def test_evidence_without_a_measure_a_tolerance_or_a_trivial_predictor_is_refused(change):
    whole = {"measure": "µm", "error": 0.0, "tolerance": 1.0, "trivial": "a guess", "trivial_error": 3.0}
    with pytest.raises(InvalidInput, match="evidence"):
        Evidence(**{**whole, **change})


# -------------------------------------------------------------------------------------------------------------- names


def test_documents_and_studies_are_found_by_name_in_the_order_of_the_documents():
    every = [s.name for s in claims.studies()]
    order = [list(claims.DOCUMENTS).index(name.split("/")[0]) for name in every]
    assert order == sorted(order)
    assert set(order) == set(range(len(claims.DOCUMENTS)))
    assert [s.name for s in claims.studies(["wu/stability"])] == ["wu/stability"]
    assert [s.name for s in claims.studies(["wu"])] == [name for name in every if name.startswith("wu/")]


def test_an_unknown_name_is_refused_with_the_nearest(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["reproduce", "xi2032"])
    assert "did you mean 'xi2023'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["reproduce", "wu/stability", "--seeds", "3"])
    assert "at least 6" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


# ------------------------------------------------------------------------------------------------ tables of claims


def test_a_row_has_its_texts_from_the_documents_table_and_its_figures_from_the_run():
    rows = Rows("wu")
    rows("sampled-axis", ("2 nm", 7), error=2e-6, guess=1.0)
    rows("servo", 4.0, holds=True)
    rows("fig-5", ("an ellipse", "b", "cw"), holds=False, case="both")
    first, second, third = rows
    assert first.simulation == "a step of 1 mm: apart by 2 nm over 7 samples"
    assert (first.verdict, first.evidence.measure) == (FAILS, "largest difference, mm")
    assert (second.where, second.paper, second.verdict, str(second.simulation)) == ("§3", "4 ms", INPUT, "4 ms")
    assert (third.claim, third.verdict) == ("case (b): cw", FAILS)
    assert third.note == "the axis with the larger lag sets the diagonal"
    with pytest.raises(ValueError, match="shorter"):
        rows("sampled-axis", ("2 nm",), error=2e-6, guess=1.0)
    with pytest.raises(ValueError, match="longer"):
        rows("servo", (4.0, 5.0), holds=True)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_every_entry_of_a_documents_table_is_a_row_of_its_studies(document):
    folder = Path(claims.__file__).parent
    code = "".join(file.read_text(encoding="utf-8") for file in folder.glob(f"{document}*.py"))
    entries = tomllib.loads((folder / f"{document}.toml").read_text(encoding="utf-8"))
    assert entries
    assert [key for key in entries if f'"{key}"' not in code] == []


# --------------------------------------------------------------------------------------------------------------- runs


def test_a_run_writes_page_markdown_figures_and_record(shelf, tmp_path):
    @shelf("wu", "One of one's own")
    def own(trial: Trial, rows: Rows) -> list[Drawing]:
        figure = Figure(figsize=(2, 1))
        figure.subplots().plot([0, 1])
        row = weighed("eq. 1", "gain | of it", "4.5", estimate(np.arange(trial.seeds), "mm"), GOOD, true="a < b")
        rows += [row, weighed("eq. 2", "by another law", "4.5", "4.5", GOOD, instead="the observer")]
        return [Drawing("line", figure, "A line (mm).", "Wu Fig. 0")]

    (part,) = reproduce(["wu"], tmp_path / "r", seeds=8, workers=1)
    assert part["rows"][0]["numbers"]["simulation"]["value"] == 3.5
    page_text = (tmp_path / "r" / "reproduce.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in page_text
    assert "a &lt; b" in page_text
    assert str(GOOD) in page_text
    assert part["rows"][0]["numbers"]["evidence"]["trivial_error"] == 30.0
    assert "1 of them are reproduced" in page_text
    assert ">trend only<small>with the observer</small>" in page_text
    assert "http://" not in page_text.replace("http://www.w3.org", "")
    assert "kerfgym reproduce wu/own --seeds 8" in page_text
    text = (tmp_path / "r" / "reproduce.md").read_text(encoding="utf-8")
    assert "gain \\| of it" in text
    assert f"| reproduced | {GOOD} |" in text
    assert "| trend only (with the observer) |" in text
    assert (tmp_path / "r" / "figures" / "wu-line.png").is_file()
    record = json.loads((tmp_path / "r" / "run.json").read_text(encoding="utf-8"))
    assert record["studies"] == ["wu/own"]
    assert record["failed"] == []
    assert claims_page.counts([part])[REPRODUCED] == 1


def test_a_study_that_fails_is_said_so_and_the_others_are_there(shelf, tmp_path, capsys):
    @shelf("wu", "Fails")
    def fails(trial: Trial, rows: Rows) -> None:
        raise ValueError("no such thing")

    @shelf("wu", "Works")
    def works(trial: Trial, rows: Rows) -> None:
        rows.append(weighed("eq. 1", "x", "1", "1", GOOD))

    parts = reproduce([], tmp_path / "r", workers=1)
    assert [bool(part["error"]) for part in parts] == [True, False]
    assert "no such thing" in (tmp_path / "r" / "reproduce.html").read_text(encoding="utf-8")
    assert "no such thing" in (tmp_path / "r" / "parts" / "wu-fails.error.txt").read_text(encoding="utf-8")
    claims_page.show(parts)
    assert "failed: ValueError:" in capsys.readouterr().out


def test_a_run_that_was_interrupted_goes_on_with_what_is_there(shelf, tmp_path):
    calls = []

    @shelf("wu", "First")
    def first(trial: Trial, rows: Rows) -> None:
        calls.append("first")

    @shelf("wu", "Second")
    def second(trial: Trial, rows: Rows) -> None:
        calls.append("second")

    folder = tmp_path / "r"
    reproduce([], folder, workers=1)
    (folder / "run.json").unlink()
    (folder / "parts" / "wu-second.json").write_text("{ torn", encoding="utf-8")
    reproduce([], folder, workers=1, resume=True)
    assert calls == ["first", "second", "second"]
    with pytest.raises(InvalidInput, match="finished"):
        reproduce([], folder, workers=1, resume=True)
    with pytest.raises(InvalidInput, match="exists"):
        reproduce([], folder, workers=1)
