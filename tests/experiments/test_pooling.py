"""One quantity has one value: in the terminal, in Markdown, in ``summary.csv`` and on the page."""

import contextlib
import html.parser
import math
import re

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs.figures import job_metrics, metrics
from kerfgym.envs.scenarios import load
from kerfgym.experiments.benchmark.benchmarking import run
from kerfgym.experiments.report import summary as digest
from kerfgym.experiments.report.terminal import sheets
from kerfgym.experiments.statistics.pooling import declared, over_scenarios, over_seeds
from kerfgym.experiments.tune import goals

FOLLOWERS = ["xi2023-tuned", "pid", "preview-5ms"]
TEAMS = ["wu-tuned", "wu-stiff"]


class Table(html.parser.HTMLParser):
    """Of the headline table: of each column that shows one of the summary's, its name, and the values of all rows."""

    def __init__(self, text, name):
        super().__init__()
        self.name, self.inside, self.shows, self.rows = name, False, [], {}
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.inside = given.get("id") == self.name if tag == "table" else self.inside
        if not self.inside:
            return
        if tag == "th" and given.get("scope") == "col":
            self.shows.append(given.get("data-shows"))
        if tag == "th" and given.get("scope") == "row":
            self.rows[given["title"]] = self.row = []
        if tag == "td" and "data-value" in given:
            self.row.append(float(given["data-value"] or "nan"))

    @property
    def columns(self):
        """Column of the summary: controller: value; the first column holds the names."""
        return {
            shown: {name: row[i] for name, row in self.rows.items()} for i, shown in enumerate(self.shows[1:]) if shown
        }


def shown(cell):
    """The number in a cell, without interval, rank's mark, or what stands behind a slash."""
    if cell == "none":
        return 0.0
    if cell.startswith("> "):
        return math.inf
    found = re.match(r"-?[\d.]+", cell)
    return float(found[0]) * (0.01 if cell.endswith("%") else 1.0) if found else math.nan


@pytest.fixture(scope="module")
def followers(tmp_path_factory):
    """A small run in which some runs of the reference touch the sheet: steps as high as the gap."""
    folder = tmp_path_factory.mktemp("following") / "run"
    steps = {"steps": {"height": {"uniform": [0.2, 0.7], "sign": "±"}}}
    high = load("low-step").varied(duration=1.5, name="high", sheet=steps)
    cases = [load("wavy").varied(duration=1.0), load("step").varied(duration=1.0), high]
    results = run(FOLLOWERS, cases, folder, range(1000, 1006), core=("wavy", "step", "high"), workers=1, quiet=True)
    assert 0 < results.failures[results.runs["controller"] == "xi2023-tuned"].sum() < 6
    return results, folder


@pytest.fixture(scope="module")
def teams(tmp_path_factory):
    folder = tmp_path_factory.mktemp("jobs") / "run"
    cases = [load(name).varied(job={"size": 30.0}) for name in ("contour-square", "contour-circle")]
    core = tuple(case.name for case in cases)
    return run(TEAMS, cases, folder, range(1000, 1003), core=core, suite="contour", workers=1, quiet=True), folder


@pytest.mark.parametrize("which", ["followers", "teams"])
def test_every_column_that_is_shown_has_the_value_of_the_summary(which, request):
    results, folder = request.getfixturevalue(which)
    summary = pd.read_csv(folder / "summary.csv").set_index("controller")
    sheet = sheets(results)[0]
    table = {"followers": "table-following", "teams": "table-contour"}[which]
    page = Table((folder / "report.html").read_text(encoding="utf-8"), table).columns
    rows = {row[0]: dict(zip(sheet.titles, row, strict=True)) for section in sheet.sections for row in section}
    assert set(sheet.shown.values()) <= set(summary.columns) | {"rank"}
    both = 0
    for title, column in sheet.shown.items():
        for name, cells in rows.items():
            value = summary.at[name, column]
            if column.startswith("iso_"):
                assert cells[title] == str(value)
                continue
            if column == "wins" and name == results.reference:
                assert cells[title] == "–"  # against itself
                continue
            figure = shown(cells[title])
            decimals = len(re.match(r"[^ (%]*?(\.\d*)?(?=[ (=/%]|$)", cells[title])[1] or ".") - 1
            digits = 10.0**-decimals * (0.01 if cells[title].endswith("%") else 1.0)
            assert figure == pytest.approx(float(value), abs=0.5001 * digits, nan_ok=True), (title, name)
            if column in page:
                both += 1
                assert page[column][name] == pytest.approx(float(value), rel=1e-9, nan_ok=True), (column, name)
    for column, values in page.items():
        for name, value in values.items():
            if not (column == "wins" and name == results.reference):
                assert value == pytest.approx(float(summary.at[name, column]), rel=1e-9, nan_ok=True), (column, name)
    assert both >= 8 * len(rows)


@pytest.mark.parametrize("which", ["followers", "teams"])
def test_markdown_has_the_cells_of_the_terminal(which, request):
    results, folder = request.getfixturevalue(which)
    text = (folder / digest.NAME).read_text(encoding="utf-8")
    for row in sheets(results)[0].sections[0]:
        assert "| " + " | ".join(row) + " |" in text


@pytest.mark.parametrize("which", ["followers", "teams"])
def test_the_summary_is_what_its_runs_pool_to(which, request):
    results, _ = request.getfixturevalue(which)
    sound = results.runs[~results.failures & results.runs["scenario"].isin(results.scored)]
    names = {"score": results.metric, "roughness": "roughness", "dross": "dross"}
    names |= {"p99": "p99_true", "max": "max_true"} if which == "followers" else {m: m for m in job_metrics.METRICS}
    for column, metric in names.items():
        if metric in ("collision", "covered"):
            continue
        for name, mine in sound.groupby("controller"):
            parts = [over_seeds(metric, part[metric]) for _, part in mine.groupby("scenario")]
            value = results.summary().at[name, column]
            assert value == pytest.approx(over_scenarios(metric, parts), rel=1e-9), (column, name)


def test_a_search_pools_as_a_report_does(followers):
    results, _ = followers
    for metric in ("rms_true", "roughness", "max_true"):
        figures = {
            scenario: {metric: part.loc[~results.failures[part.index], metric]}
            for scenario, part in results.runs[results.runs["controller"] == "pid"].groupby("scenario")
        }
        assert goals.score(metric, figures, results.core) == pytest.approx(results.over(metric)["pid"])


def test_each_metric_is_pooled_as_what_it_is():
    values = [3.0, 4.0, 5.0]
    for name in (*metrics.METRICS, *job_metrics.METRICS):
        expected = {"rms": np.sqrt(50 / 3), "mean": 4.0, "largest": 5.0, "smallest": 3.0}[declared(name).pooled]
        assert over_seeds(name, values) == pytest.approx(expected)
        among = over_scenarios(name, values)
        with contextlib.suppress(KeyError):
            assert among == {"largest": 5.0, "smallest": 3.0}[declared(name).pooled]
            continue
        assert among == pytest.approx(4.0 if declared(name).zero else 60 ** (1 / 3))
    for name in ("rms_true", "rms_reported", "rms_acceleration", "rms_jerk", "contour_rms", "gap_rms"):
        assert declared(name).pooled == "rms"
    for name in ("max_true", "contour_max", "gap_max", "power_max", "dither_max"):
        assert declared(name).pooled == "largest"
    assert np.isnan(over_seeds("rms_true", []))
    assert np.isnan(over_scenarios("rms_true", [1.0, np.nan]))
