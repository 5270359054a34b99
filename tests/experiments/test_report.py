"""The report: opens offline, concludes what its data say, and survives what a benchmark may leave behind."""

import base64
import html.parser
import json
import re
import zlib

import numpy as np
import pandas as pd
import plotly.graph_objects as go
import pytest
from plotly.offline import get_plotlyjs

from kerfgym.envs import scenarios
from kerfgym.experiments.plots.palette import COLOURS, looks
from kerfgym.experiments.report import answer, limits, numbers, page, scope, standing, table
from kerfgym.experiments.report.curves import curves
from kerfgym.experiments.report.curves import figure as trained
from kerfgym.experiments.report.fronts import efficient
from kerfgym.experiments.report.heat import figure as heat
from kerfgym.experiments.report.kerfs import coloured, pieces
from kerfgym.experiments.report.pack import Channel, pack, thinned
from kerfgym.experiments.report.scores import figure as scores
from kerfgym.experiments.report.spectra import spectrum
from kerfgym.experiments.report.suite import Suite
from kerfgym.experiments.report.terminal import sheets
from kerfgym.experiments.report.tuning import studies


class Reader(html.parser.HTMLParser):
    """Collects resources, text, figures' data and the unclosed tags of a page, and the rows of its tables by id."""

    EMPTY = ("meta", "input", "br", "link")

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.resources, self.tags, self.ids, self.links, self.text, self.open = [], [], [], [], "", []
        self.data, self.figure, self.tables, self.table = {}, "", {}, None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append(tag)
        self.resources += [attributes[key] for key in ("src", "srcset", "data", "poster") if key in attributes]
        self.ids += [attributes["id"]] if "id" in attributes else []
        if "href" in attributes:
            (self.resources if tag == "link" else self.links).append(attributes["href"])
        if tag == "figure":
            self.figure = attributes["id"]
        elif tag == "table" and "id" in attributes:
            self.table = self.tables.setdefault(attributes["id"], [])
        elif tag == "tr" and self.table is not None:
            self.table.append([])
        elif tag in ("td", "th") and self.table:
            self.table[-1].append("")
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag == "table":
            self.table = None

    def handle_data(self, data):
        if self.open and self.open[-1] == "script" and "figure" in self.open:
            self.data[self.figure] = self.data.get(self.figure, "") + data
        elif not {"style", "script"} & set(self.open):
            self.text += data
            if self.table and self.table[-1] and {"td", "th"} & set(self.open):
                self.table[-1][-1] += f" {data.strip()}" if data.strip() else ""

    def row(self, table, controller):
        """Cells of the row that begins with a controller's name."""
        return next(r for r in self.tables[table] if r and r[0].split()[:1] == [controller])


def read(text):
    """The page, after checks that hold for every report."""
    plain = text.replace(get_plotlyjs().replace("</script", "<\\/script"), "")
    assert len(text) - len(plain) > 4e6  # the library is there …
    assert plain.count("plotly.js v") == 0  # … once
    reader = Reader(plain)
    assert reader.open == []
    assert all(r.startswith("data:") for r in reader.resources)
    assert all(link.startswith("#") and link[1:] in reader.ids for link in reader.links)
    assert len(reader.ids) == len(set(reader.ids))
    assert not {"iframe", "object", "img"} & set(reader.tags)
    assert not re.search(r"https?:|url\(|@import", re.sub(r"[A-Za-z0-9+/=]{200,}", "", plain))
    for data in reader.data.values():
        for view in json.loads(data).get("views", []):
            go.Figure(view)  # plotly refuses what it does not know
    return reader


@pytest.fixture(scope="module")
def whole(whole_run):
    """The page of a run that has everything."""
    text = whole_run.path.read_text(encoding="utf-8")
    assert len(text) < 15e6
    return read(text)


def judged(results, name="following"):
    """The suite and its standings."""
    suite = Suite(name, results)
    return suite, standing.all_of(suite)


def headline(results, name="following"):
    suite, found = judged(results, name)
    return answer.headline(found[suite.metric], page.labelled(results.controllers))


# ---------------------------------------------------------------------------------------------------------- the page


def test_every_section_for_which_there_are_data_is_there(whole):
    figures = {f"{kind}-{suite}" for kind in ("scores", "heat") for suite in ("following", "ood")}
    figures |= {f"profile-{suite}" for suite in ("following", "cutting", "ood")}
    figures |= {f"fronts-{suite}" for suite in ("following", "cutting", "ood")} | {"scores-cutting"}
    figures |= {"spectra", "sensitivity-following", "sensitivity-ood", "oscilloscope", "kerfs", "blame-following"}
    figures |= {"quality-thin-sheet", "quality-c45-10"}
    assert set(whole.data) == figures
    for words in (
        "What this can’t tell you",
        "Record of the run",
        "Condition by condition",
        "Beside references with other information",
    ):
        assert words in whole.text


def test_every_figure_carries_its_command(whole):
    assert whole.text.count("kerfgym benchmark --seeds 6") >= len(whole.data)


def test_the_record_holds_versions_seeds_and_parameters(whole):
    for piece in ("0123abc", "0.1.0", "1000-1005", "600000000", "law.kp"):
        assert piece in whole.text


def test_a_page_without_data_for_them_has_no_such_sections(made_up, tmp_path):
    results = made_up.following({"mine": ("sensor", 9.0, 1.9)}, ["flat"], (), traced=0)
    results.sensitivity, results.margins, results.meta = pd.DataFrame(), pd.DataFrame(), {}
    text = page.page(tmp_path, {"following": results}, {})
    reader = read(text)
    assert set(reader.data) == {"scores-following", "quality-thin-sheet"}
    assert "The run left no record." in reader.text
    assert "mine: no record" in reader.text
    assert text == page.page(tmp_path, {"following": results}, {})  # the same results, the same page


def test_all_runs_may_have_failed(made_up, tmp_path):
    results = made_up.following(scenarios=["wavy"], core=["wavy"], seconds=0.05)
    metrics = ["rms_true", "p99_true", "max_true", "rms_reported", "jitter", "collision", "dross", "roughness"]
    results.runs[metrics], results.runs["failed"] = np.nan, True
    results.traces[["gap", "height", "command", "surface", "velocity"]] = np.nan
    results.sensitivity["magnitude"] = np.inf
    assert "nothing to compare" in read(page.page(tmp_path, {"following": results}, {"notes": ["a note"]})).text


def test_names_are_text_and_not_markup(made_up, tmp_path):
    evil, other = "<script>alert(1)</script>&$x_{2$", "_a$b$c</td>"
    controllers = {evil: ("sensor", 9.1, 1.9), other: ("sensor", 12.0, 1.9)}
    results = made_up.following(controllers, ["<b>wavy</b>/../$a$", "b?wavy--b"], (), seconds=0.6, traced=1)
    meta = {"command": 'kerfgym -c "<i>"', "<u>": {"</table>": ["<p>", 1, None, True]}}
    reader = read(page.page(tmp_path, {"</script>": results}, meta))
    assert f"{evil} follows closest" in reader.text
    assert not {"u", "td>"} & set(reader.tags)


# ------------------------------------------------------------------------------------------------------- the answer


def test_the_headline_gives_the_ratio_of_the_scores(whole):
    assert "pid follows closest: 8.00\u00a0µm, 3.0 times closer than xi2023-tuned." in whole.text
    assert "fine has the smallest roughness Rz: 50.0\u00a0µm, 3.4 times smoother than fast." in whole.text


def test_a_reference_with_other_information_is_never_ranked(made_up):
    suite, found = judged(made_up.following())
    assert found["rms_true"].best == "pid"
    words = answer.remarks(suite, found["rms_true"], {n: n for n in suite.ranked}, 2.0)
    assert any(word.startswith("preview-5ms (knows the sheet ahead, not ranked) reaches 2.0") for word in words)


def test_without_the_reference_there_is_no_ratio(made_up):
    results = made_up.following({"pid": ("sensor", 9.1, 1.9), "observer": ("sensor", 18.0, 1.8)})
    assert headline(results) == "pid follows closest: 9.10\u00a0µm."
    suite, found = judged(results)
    words = answer.remarks(suite, found["rms_true"], {n: n for n in suite.ranked}, 2.0)
    assert "The reference xi2023-tuned was not run, so there are no ratios." in words


def test_who_cannot_be_told_apart_is_named(made_up):
    results = made_up.following({"a": ("sensor", 9.0, 1.9), "b": ("sensor", 9.05, 1.9)})
    assert headline(results) == "a and b follow closest and cannot be told apart: a has 9.00\u00a0µm."


def test_who_may_not_be_ranked_does_not_win(made_up):
    results = made_up.following()
    del results.meta["tuning"]["pid"]
    suite, found = judged(results)
    assert found["rms_true"].best == "xi2023-tuned"
    assert not found["rms_true"].frame.at["pid", "rank"] > 0
    cells = {g.title: g for g in table.groups(suite, found)}["score"].columns[0].cells
    assert (cells["pid"].text, cells["xi2023-tuned"].text) == ("–", "1")


def test_nobody_of_the_sensor_class(made_up):
    results = made_up.following({"preview-5ms": ("preview", 2.5, 1.1)})
    _, found = judged(results)
    assert found["rms_true"].ranked == ["preview-5ms"]  # of its own class
    results = made_up.following({"preview-5ms": ("preview", 2.5, 1.1)})
    results.meta["tuning"] = {}
    assert "nothing to compare" in headline(results)


def test_what_speaks_against_the_winner_is_said(made_up):
    results = made_up.following({"xi2023-tuned": ("sensor", 24.0, 1.9), "pid": ("sensor", 8.0, 2.4)})
    results.margins.loc[results.margins["controller"] == "pid", "gain"] = 0.0
    suite, found = judged(results)
    assert answer.caveats(suite, found["rms_true"], {n: n for n in suite.ranked}, 2.0) == [
        "it touched the sheet in 1 of 18 runs of all scenarios",
        "its sensitivity peak Ms is 2.40 with a sine, over the limit of 2",
        "its loop does not settle after a step on every corner plant",
    ]


@pytest.mark.parametrize(
    ("ratio", "low", "high", "words"),
    [
        (3.012, 2.226, 3.666, "3.01 (2.23–3.67) times closer"),
        (23.4, 20.2, 27.9, "23.4 (20.2–27.9) times closer"),
        (1.03, 1.02, 1.04, "2.91 (1.96–3.85) % closer"),
        (2.0, np.nan, np.nan, "2.00 times closer"),
    ],
)
def test_how_much_better_in_words(ratio, low, high, words):
    assert answer.better(ratio, low, high, "closer") == words


def test_seeds_that_tuning_saw_are_a_warning(made_up):
    assert page.warnings([Suite("following", made_up.following(traced=0))]) == []
    seen = page.warnings([Suite("following", made_up.following(seeds=range(30, 36), traced=0))])
    assert seen == [
        "Height following: 6 of 6 seeds belong to the tune split; a controller that was fitted to them is flattered."
    ]


# --------------------------------------------------------------------------------------------------------- the table


def test_the_table_says_what_the_runs_say(whole):
    row = whole.row("table-following", "pid")
    text = " ".join(row)
    assert row[1] == " 1"
    assert row[2].split()[0] == "1/18"  # failed
    assert row[3].split()[0] == f"{np.log(24 / 8) / np.log(24 / 2):.2f}"  # 0 is the reference, 1 the informed one
    assert row[4].split()[0] == "8.00"
    assert row[5].split()[0] == "3.00"
    assert "1/18" in text  # touched
    assert "1.95" in text  # Ms
    assert [cell.split() for cell in whole.row("table-following", "xi2023-tuned")[-2:]] == [
        ["400"],
        ["600", "350", "CPU-s"],
    ]
    assert "0.15 %" in " ".join(whole.row("table-following", "xi2023-tuned"))  # of the period


def test_jobs_have_contour_quality_time_and_ranges(whole):
    heads = " ".join(whole.tables["table-cutting"][1])
    for title in ("RMS", "dross", "Rz", "through", "kerf", "job", "energy", "touched"):
        assert title in heads
    assert heads.count("Rz") == 2  # what is scored, and its range
    assert "3" in [cell.strip() for cell in whole.row("table-cutting", "fine")]


def test_who_is_closer_but_not_ranked_is_said_with_the_reason(made_up):
    results = made_up.following()
    results.meta["tuning"]["pid"] = {**results.meta["tuning"]["pid"], "simulated_steps": 900_000_000}
    suite, found = judged(results)
    assert answer.caveats(suite, found["rms_true"], {n: n for n in suite.ranked}, 2.0) == [
        "pid (8.00\u00a0µm) is closer but not ranked (tuned with 1.5 times the simulated steps of xi2023-tuned)"
    ]
    ranks = {g.title: g for g in table.groups(suite, found)}["score"].columns[0].cells
    assert {name: cell.text for name, cell in ranks.items()} == {
        "pid": "–",
        "xi2023-tuned": "1",
        "preview-5ms": "1",
    }  # each in its class


def test_runs_of_earlier_versions_lack_metrics(made_up, tmp_path):
    results = made_up.cutting()
    results.runs = results.runs.drop(columns=["cutting_time", "power_max", "energy", "taper"])
    assert np.isnan(results.summary()["energy"]).all()
    assert len(sheets(results)) == 1
    text = page.page(tmp_path, {"cutting": results}, {})
    assert "roughness Rz" in text
    assert "energy</button>" not in text


def test_the_best_and_who_is_tied_are_marked(made_up):
    results = made_up.following(
        {"a": ("sensor", 9.0, 1.9), "b": ("sensor", 9.05, 1.9), "c": ("sensor", 30.0, 1.9), "p": ("preview", 1.0, 1.0)}
    )
    suite, found = judged(results)
    column = {g.title: g for g in table.groups(suite, found)}["score"].columns
    cells = next(c for c in column if c.title == "score").cells
    assert {name: cell.mark for name, cell in cells.items()} == {"a": "best", "b": "tied", "c": "", "p": ""}


def test_failed_runs_are_said_of_the_best_and_are_not_in_the_figure(made_up):
    results = made_up.following()
    bad = (results.runs["controller"] == "pid") & (results.runs["scenario"] == "wavy") & (results.runs["seed"] == 1003)
    results.runs.loc[bad, ["rms_true", "p99_true", "dross"]] = np.nan
    results.runs.loc[bad, "failed"] = True
    suite, found = judged(results)
    labels = {n: n for n in suite.ranked}
    assert found["rms_true"].best == "pid"  # one run of six seeds says nothing about how often it fails
    assert "1 of its 18 runs hold no figure or were not finished" in answer.caveats(
        suite, found["rms_true"], labels, 2.0
    )
    columns = {c.title: c.cells["pid"] for c in table.groups(suite, found)[0].columns}
    assert (columns["rank"].text, columns["failed"].text, columns["failed"].mark) == ("1", "2/18", "bad")
    assert 7.5 < columns["score"].value < 8.5
    results = made_up.following()
    results.runs.loc[results.runs["controller"] == "pid", "failed"] = True
    suite, found = judged(results)
    words = " ".join(answer.remarks(suite, found["rms_true"], labels, 2.0))
    assert "Without a score, because runs failed: pid." in words
    plot = scores(found["rms_true"], looks(suite.ranked), labels).views[""]
    assert any("no score: 18 failed runs" in note.text for note in plot.layout.annotations)


def test_a_collision_is_shown_apart_from_the_error(made_up):
    """pid touches the sheet in one of the six runs of ``holes``."""
    results = made_up.following()
    touched = (results.runs["controller"] == "pid") & (results.runs["collision"] > 0)
    results.runs.loc[touched, "rms_true"] = 900.0
    suite, _ = judged(results)
    plot = heat(suite, {n: n for n in suite.ranked}).views["true gap error, RMS, µm"]
    text = dict(zip(suite.ranked, plot.data[0].text, strict=True))
    error, lost = text["pid"][suite.scenarios.index("holes")].split("<br>")
    assert float(error) < 30.0
    assert lost == "1 failed"
    assert "failed" not in "".join(text["xi2023-tuned"])


def test_ms_that_was_not_measured_says_why(made_up, tmp_path):
    results = made_up.following()
    results.margins["reason"] = ["", "margins need more dead time", ""]
    results.margins.loc[1, ["gain", "delay_ms"]] = np.nan
    results.margins["machine"] = "axis.dead_time 0.0005"
    results.sensitivity["machine"], results.sensitivity["signal"] = "axis.dead_time 0.0005", "sine"
    suite, found = judged(results)
    columns = {g.title: g for g in table.groups(suite, found)}["stability"].columns
    gain = next(c for c in columns if c.title == "gain").cells["pid"]
    assert (gain.text, gain.title) == ("–", "not measured on axis.dead_time 0.0005: margins need more dead time")
    reader = read(page.page(tmp_path, {"following": results}, {}))
    assert "pid on the machine axis.dead_time 0.0005: margins need more dead time" in reader.text
    notes = "\n".join(sheets(results)[0].notes)
    assert "not measured: pid on axis.dead_time 0.0005: margins need more dead time." in notes
    assert "on the worst corner plant of the machine that was run (axis.dead_time 0.0005)" in notes


def test_whose_ms_may_be_its_bases_is_told(made_up, tmp_path):
    results = made_up.following()
    words = "pid: beyond the feeds of its training such a policy is its base; Ms is measured at 0 mm/s"

    def told():
        return "\n".join(sheets(results)[0].notes)

    assert words not in told()
    results.meta["tuning"]["pid"] = {"policy": {"range": ["noise"]}}  # it hands over, but not for a feed
    assert words not in told()
    results.meta["tuning"]["pid"] = {"z": {"policy": {"range": ["feed", "noise"]}}}
    assert words in told()
    assert words in read(page.page(tmp_path, {"following": results}, {})).text


def test_several_machines_have_a_table_of_their_own(made_up, tmp_path):
    results = made_up.following()
    curves, margins = results.sensitivity, results.margins
    both = [(1.0, "standard"), (1.4, "axis.bandwidth 25")]
    results.sensitivity = pd.concat(
        [
            curves.assign(
                machine=machine,
                signal=signal,
                magnitude=factor * more * curves["magnitude"],
                peak_low=1.0,
                peak_high=3.0,
            )
            for factor, machine in both
            for more, signal in ((1.0, "sine"), (1.1, "noise"))
        ]
    )
    results.margins = pd.concat(
        [margins.assign(machine=machine, gain=margins["gain"] / factor, reason="") for factor, machine in both]
    )
    results.meta["machines"] = {"standard": ["wavy"], "axis.bandwidth 25": ["rough", "holes"]}
    row = results.summary().loc["pid"]
    assert (row["ms"], row["ms_noise"]) == pytest.approx((1.4 * 1.95, 1.4 * 1.1 * 1.95))  # the worst of both
    assert row["gain_margin"] == pytest.approx(3.0 / 1.4)
    reader = read(page.page(tmp_path, {"following": results}, {}))
    found = [r for r in reader.tables["machines-following"] if "pid" in r[1]]
    assert [r[0].strip() for r in found] == ["standard", "axis.bandwidth 25"]
    assert [r[2].strip() for r in found] == ["1.95", "2.73"]
    assert len(json.loads(reader.data["sensitivity-following"])["views"]) == 4
    sheet = next(s for s in sheets(results) if s.title == "Ms and margins by machine")
    assert [len(section) for section in sheet.sections] == [3, 3]
    assert sheet.notes == ["standard: wavy.", "axis.bandwidth 25: rough, holes."]


def test_beyond_the_distribution_the_error_is_compared_with_that_within(whole):
    row = whole.row("table-beyond", "pid")
    assert row[1:4] == [" 8.00", " 40.0 × 5.0", " 1.20"]  # within, beyond, × reference
    heads = whole.tables["table-beyond"][0]
    assert " 400 mm/s µm" in heads
    assert " set height 0.3 mm µm" in heads


def test_headroom_has_a_table(whole):
    assert whole.row("table-headroom", "rough") == [" rough", " pid", " 8.00", " 2.00", " × 4.0 3.5–4.5"]


# ------------------------------------------------------------------------------------------------------- the figures


def test_colours_follow_the_order_of_appearance():
    names = [f"c{i}" for i in range(50)]
    found = looks(names)
    assert [found[name].colour for name in names[: len(COLOURS)]] == list(COLOURS)
    assert len({(look.colour, look.dash) for look in found.values()}) == 50


def test_names_of_files_are_shortened_as_long_as_they_stay_apart():
    names = ["runs/a/policy", "agents/trained/x-ppo", "pid:law.kp=80", "z=runs/b/policy,xy=wu", "runs/c/tuned.toml"]
    assert list(page.labelled(names).values()) == ["a", "x-ppo", "pid:law.kp=80", "z=runs/b/policy,xy=wu", "c"]
    assert list(page.labelled(["one/x/policy", "two/x/policy"]).values()) == ["one/x/policy", "two/x/policy"]


def test_the_map_is_coloured_by_the_ratio_to_the_reference(whole):
    view = json.loads(whole.data["heat-following"])["views"][0]["data"][0]
    colours, text = np.array(view["z"], float) if isinstance(view["z"], list) else decoded(view["z"]), view["text"]
    assert view["y"] == ["pid", "xi2023-tuned", "preview-5ms"]
    np.testing.assert_allclose(colours[0][:2], np.log2(8 / 24))
    np.testing.assert_allclose(colours[0][2], np.log2(8 / 24), rtol=0.01)  # holes, where a run of six failed
    np.testing.assert_allclose(colours[1], 0.0)
    np.testing.assert_allclose(colours[2], -3.0)  # further than what is shown
    assert text[0][:2] == ["5.66", "11.3"]  # 8 µm · 2^∓½


def decoded(array):
    """An array as plotly stores it."""
    flat = np.frombuffer(base64.b64decode(array["bdata"]), array["dtype"])
    return flat.reshape([int(n) for n in str(array.get("shape", len(flat))).split(",")])


def test_the_front_holds_those_that_nobody_beats():
    points = pd.DataFrame({"x": [1.0, 2.0, 3.0, 2.0, np.inf], "y": [3.0, 2.0, 1.0, 2.5, 0.0]}, index=list("abcde"))
    assert efficient(points) == ["a", "b", "c"]


def test_the_spectrum_holds_the_whole_mean_square():
    t = np.arange(4096) * 1e-3
    error = 3.0 * np.sin(2 * np.pi * 62.5 * t)
    frequency, density = spectrum(error, np.ones(len(t), bool))
    assert frequency[np.argmax(density)] == 62.5
    assert np.sum(density**2) * (frequency[1] - frequency[0]) == pytest.approx(np.mean(error**2), rel=1e-3)
    assert spectrum(error, t < 0.3) is None  # too short


def test_packed_signals_come_back_within_half_a_step():
    rng = np.random.default_rng(0)
    signals = [np.cumsum(rng.standard_normal(500)), 1e-9 * np.arange(500.0), np.full(500, 7.0), 1e6 * rng.random(500)]
    signals[0][[0, 17, 499]] = [np.nan, np.inf, np.nan]
    packed = pack([Channel(s, 1e-3) for s in signals])
    split = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8).reshape(2, -1)
    whole = np.cumsum((split[0].astype(np.int64) | split[1].astype(np.int64) << 8).reshape(4, -1), axis=1)
    whole = (whole + 32768) % 65536 - 32768
    for signal, row, low, step in zip(signals, whole, packed["low"], packed["step"], strict=True):
        known = np.isfinite(signal)
        assert (row[~known] == -32768).all()
        np.testing.assert_allclose(low + step * (row[known] + 32767), signal[known], atol=0.51 * step, rtol=1e-8)
        assert step == pytest.approx(max(1e-3, np.ptp(signal[known]) / 65000))


def test_thinned_signals_keep_their_extremes():
    signal = np.zeros(1000)
    signal[[333, 666]] = 5.0, -7.0
    thin = thinned(signal, 10)
    assert len(thin) == 100
    assert (thin.max(), thin.min()) == (5.0, -7.0)
    assert thinned(np.full(100, np.nan), 5).shape == (20,)


def test_the_oscilloscope_begins_where_the_errors_differ():
    t = np.arange(4000) * 1e-3
    a, b = 9 * np.sin(12 * t), 9 * np.sin(12 * t) + 200 * ((t > 2.2) & (t < 2.9))
    counted = np.ones(len(t), bool)
    first, last = scope.interesting([(a, counted), (b, counted)], 1e-3)
    assert last - first <= 1000
    assert first < 2200
    assert last >= 2900


def test_the_oscilloscope_begins_at_the_first_alarm(made_up):
    suite = Suite("following", made_up.following(scenarios=["tip-up"], core=(), seconds=4.0, traced=1))
    run = scope.widget([suite], {})["groups"][0]["scenarios"][0]["seeds"][0]
    assert run["window"][0] < 3.2 < run["window"][1]
    assert run["controllers"]["pid"]["alarm"] == pytest.approx(3.201)
    assert run["idle"] == [[pytest.approx(0.001), pytest.approx(0.101)], [pytest.approx(3.201), 4.0]]


def test_fast_vibrations_are_shown_over_a_shorter_time():
    error = 10 * np.sin(2 * np.pi * 60 * np.arange(2000) * 1e-3)
    first, last = scope.interesting([(error, np.ones(2000, bool))], 1e-3)
    assert last - first == pytest.approx(250, abs=2)


def test_signals_leave_room_for_the_rest_of_the_page(made_up, monkeypatch):
    suite = Suite("following", made_up.following())
    count = lambda: [len(s["seeds"]) for s in scope.widget([suite], {})["groups"][0]["scenarios"]]  # noqa: E731
    assert count() == [2, 2, 2]
    monkeypatch.setattr(scope, "ROOM", 1)
    assert count() == [1, 1, 1]  # the first seed is always there


def test_pieces_of_a_kerf_keep_the_worst_error_and_the_mean_quality(made_up):
    run = made_up.cutting().traces
    x, y, cuts, through, values = pieces(*coloured(run[run["controller"] == "fine"]))
    assert len(x) <= 2003
    assert np.abs(values["standoff"]).max() == pytest.approx(40.0, rel=1e-3)
    np.testing.assert_allclose(values["roughness"], 50.0)
    assert cuts[0] == 0.0
    np.testing.assert_allclose(np.hypot(x, y)[cuts > 0.5], 30.0, rtol=1e-6)
    right = x / np.hypot(x, y) > 0.91
    assert (through[right & (cuts > 0.5)] == 0).all()


def test_a_follower_along_a_drawing_has_a_kerf_too(made_up):
    results = made_up.following({"pid": ("sensor", 8.0, 1.9)}, ["drawing"], ["drawing"], drawing=True)
    *_, values = coloured(results.traces[results.traces["seed"] == 1000])
    assert set(values) == {"standoff", "dross", "roughness"}
    assert np.isfinite(values["dross"]).sum() == (results.traces["scored"] > 0.5).sum() / 2


def test_studies_and_trainings_are_found_beside_their_controllers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # nothing outside of it is read because a record names it
    tuned = pd.DataFrame(
        {"parameter": ["law.kp"], "value": [50.0], "side": [1], "moved": [60.0], "rms_true": [1.1], "ms": [2.0]}
    )
    (tmp_path / "study").mkdir()
    tuned.to_parquet(tmp_path / "study" / "sensitivity.parquet")
    (tmp_path / "ppo" / "policy").mkdir(parents=True)
    (tmp_path / "ppo" / "policy" / "policy.json").write_text("{}")
    (tmp_path / "ppo" / "evaluations.csv").write_text("steps,cpu_seconds,score\n100,1,9\n200,2,7\n")
    names = ["pid", f"{tmp_path}/study/tuned.toml", f"{tmp_path}/ppo/policy"]
    assert list(studies(names)) == names[1:2]
    found = curves(names)
    assert list(found) == names[2:]
    assert found[names[2]][0]["score"].tolist() == [9, 7]
    shipped = curves(["height-following-ppo", "contour-following-ppo"])  # these have them beside themselves
    shown = trained(shipped, looks(list(shipped)), {name: name for name in shipped})
    assert list(shown.views) == ["HeightFollowing-v0", "ContourFollowing-v0"]  # different scores, different views


# ------------------------------------------------------------------------------------------------------- the numbers


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (9.104, "9.10"),
        (23.94, "23.9"),
        (104.4, "104"),
        (99.96, "100"),
        (-3.0, "−3.00"),
        (np.nan, "–"),
        (np.inf, "∞"),
        (0.05068, "0.0507"),
        (12345.6, "12\u202f346"),
        (0.0, "0.00"),
    ],
)
def test_numbers_have_three_digits(value, text):
    assert numbers.number(value) == text


def test_an_interval_tells_how_many_digits_are_known():
    assert numbers.fixed(7.912, numbers.known(6.65, 10.47, 7.912)) == "7.9"
    assert numbers.fixed(0.050650, numbers.known(0.050592, 0.050720, 0.05065)) == "0.05065"
    assert numbers.span(6.65, 10.47, 1) == "6.7–10.5" or numbers.span(6.65, 10.47, 1) == "6.6–10.5"
    assert numbers.span(-0.4, 0.3, 1) == "−0.4 to 0.3"


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.5, "50 %"), (0.9996, "> 99.9 %"), (1.0, "100 %"), (0.0003, "< 0.1 %"), (0.995, "99.5 %"), (np.nan, "–")],
)
def test_shares_are_never_rounded_to_certainty(share, text):
    assert numbers.percent(share) == text


def test_the_limits_tell_of_the_scenarios_that_were_run(made_up):
    def said(suite):
        cases = scenarios.suite(suite).values()
        results = made_up.following()
        results.meta |= {
            "plates": sorted({s.head.plate for s in cases}),
            "corners": [s.name for s in cases if s.corners],
        }
        one = [Suite(suite, results)]
        return " ".join(text for _, text in limits.sentences(one, []))

    first, second = said("following-v1"), said("following")
    assert "The sensor takes it over the same" in first
    assert "Constant feed, no slow-down in corners" in first
    assert "over a plate of 5.6 mm radius" in second
    assert "The feed falls in corners in corners, shift" in second
    assert "the same; only" not in second
    assert "did not record" in " ".join(text for _, text in limits.sentences([Suite("x", made_up.following())], []))
