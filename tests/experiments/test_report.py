"""The report: opens offline, concludes what its data say, and survives what a benchmark may leave behind."""

import html.parser
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

import kerfgym.envs.scenarios
from kerfgym.envs.plant import supervisor
from kerfgym.experiments.report import page, plots
from kerfgym.experiments.report.page import headline, pictures, remarks, times, warnings, write_following
from kerfgym.experiments.results import Results

SUITE = tomllib.loads(
    (Path(kerfgym.envs.scenarios.__file__).parent / "suites" / "following.toml").read_text(encoding="utf-8")
)

CONTROLLERS = {
    "xi2023-ma": ("sensor", 33.8, 1.71), "xi2023-improved": ("sensor", 33.6, 1.72),
    "xi2023-tuned": ("sensor", 23.9, 1.9), "pid": ("sensor", 9.1, 1.95), "observer": ("sensor", 12.0, 3.1),
    "preview-5ms": ("preview", 2.5, 1.12),
}  # fmt: skip
"""Name: information class, score in µm, Ms."""

EXEMPT = ("long-hole", "tip-up")


def fake(controllers=CONTROLLERS, scenarios=None, seeds=range(1000, 1008), seconds=1.5, core=None, drawing=False):
    """Results whose scores are exactly those of ``controllers``; in ``holes`` the pid touches in one run."""
    rng = np.random.default_rng(0)
    scenarios = SUITE["scenarios"] if scenarios is None else scenarios
    core = tuple(SUITE["core"]) if core is None else core
    difficulty = {name: 2.0 ** ((i * 5) % 7 - 3.0) for i, name in enumerate(scenarios)}
    scored = [name for name in core if name in scenarios] or scenarios
    mean = np.exp(np.mean([np.log(difficulty[name]) for name in scored]))
    rows, traces, curves = [], [], []
    time = np.arange(1, round(seconds * 1000) + 1) * 1e-3
    for number, (name, (information, score, ms)) in enumerate(controllers.items()):
        for place, scenario in enumerate(scenarios):
            rms = score * difficulty[scenario] / mean
            for seed in seeds:
                touched = scenario in EXEMPT or (scenario, name, seed) == ("holes", "pid", seeds[0])
                rows.append({
                    "controller": name, "information": information, "scenario": scenario, "seed": seed, "failed": False,
                    "rms_true": rms, "p99_true": 3 * rms, "rms_reported": (0.6 + 0.2 * number) * rms,
                    "collision": float(touched), "jitter": 0.2 * number + 0.1,
                })  # fmt: skip
            surface = 0.5 * np.sin(2 * np.pi * 2 * time + place)
            error = 1.4e-3 * rms * np.sin(2 * np.pi * 2 * time + place + 0.2 * number)
            scored_now = (time % 0.5 > 0.08) if scenario in ("holes", "edge", *EXEMPT) or drawing else time > 0
            mode = np.full(len(time), supervisor.FOLLOW)
            if scenario in EXEMPT:
                mode[time > 0.8 * seconds], error[time > 0.8 * seconds] = supervisor.ALARM, 5.0
            traces.append(pd.DataFrame({
                "controller": name, "scenario": scenario, "seed": seeds[0], "time": time, "set_height": 0.8,
                "gap": 0.8 + error, "height": 0.8 + error + 1e-3 * rng.standard_normal(len(time)), "surface": surface,
                "command": 6 * np.cos(2 * np.pi * 2 * time + place) + 0.3 * rng.standard_normal(len(time)),
                "mode": mode, "scored": scored_now.astype(float), "distance": 200 * time,
            }))  # fmt: skip
            if drawing:
                turn = 2 * np.pi * time / seconds
                traces[-1]["x"], traces[-1]["y"] = 60 + 60 * np.cos(turn), 40 + 40 * np.sin(turn) + 8 * np.sin(4 * turn)
        frequency = np.geomspace(1, 200, 40)
        curve = frequency**2 / np.abs(frequency**2 - 900 + 30j * frequency)
        curves.append(pd.DataFrame({"controller": name, "frequency": frequency, "magnitude": curve * ms / curve.max()}))
    meta = {
        "command": "kerfgym benchmark --seeds 8", "kerfgym": "0.1.0", "git": {"commit": "0123abc", "changed": False},
        "packages": {"numpy": "2.0"}, "machine": {"system": "Linux", "cores": 2}, "seeds": "1000-1007", "seed_count": 8,
        "core": list(core), "ledger": {name: {"simulated_steps": 336000, "cpu_seconds": 1.5} for name in controllers},
        "tuning": {"xi2023-tuned": {"tune_seeds": "0-39", "trials": 400}},
        "parameters": {name: {f"law.p{i}": 0.5 * i for i in range(30)} for name in controllers},
    }  # fmt: skip
    return Results(
        pd.DataFrame(rows), pd.concat(traces, ignore_index=True), pd.concat(curves, ignore_index=True), meta, core,
        tuple(s for s in EXEMPT if s in scenarios), {name: f"what happens in {name}, ±3 mm/m" for name in scenarios},
    )  # fmt: skip


def some(**changes):
    """Fewer controllers, scenarios and periods."""
    few = {name: CONTROLLERS[name] for name in ("xi2023-tuned", "pid", "preview-5ms")}
    return fake(**{"controllers": few, "scenarios": ["wavy", "holes"], "seconds": 0.4, **changes})


class Reader(html.parser.HTMLParser):
    """Collects the resources, the visible text and the unclosed tags of a page."""

    EMPTY = ("meta", "img", "br")

    def __init__(self, text):
        super().__init__()
        self.resources, self.tags, self.ids, self.links, self.text, self.open = [], [], [], [], "", []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append(tag)
        self.resources += [attributes[key] for key in ("src", "srcset", "data", "poster") if key in attributes]
        self.ids += [attributes["id"]] if "id" in attributes else []
        self.links += [attributes["href"]] if "href" in attributes else []
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.text += data


def read(path):
    """The page, after checks that hold for every report."""
    text = path.read_text(encoding="utf-8")
    reader = Reader(text)
    assert reader.open == []
    assert all(r.startswith("data:image/png;base64,") for r in reader.resources)
    assert all(link.startswith("#") and link[1:] in reader.ids for link in reader.links)
    assert len(reader.ids) == len(set(reader.ids))
    assert not {"script", "link", "iframe", "object"} & set(reader.tags)
    images = sorted((path.parent / "plots").glob("*"))
    assert len(images) == len(reader.resources)
    assert all(file.suffix == ".png" for file in images)
    assert not list(path.parent.rglob(".*"))
    for file in images:
        with Image.open(file) as image:
            assert image.width > 600
            assert len(image.convert("RGB").getcolors(1 << 24)) > 20, file.name
    return reader


@pytest.fixture(autouse=True)
def _coarse(monkeypatch):
    """Pictures of few dots, which are made faster."""
    monkeypatch.setattr(plots, "DPI", 75)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The report of a whole benchmark: path and page."""
    path = write_following(tmp_path_factory.mktemp("run"), fake(seconds=0.5))
    return path, read(path)


# The page


def test_nothing_is_loaded_from_elsewhere(whole):
    path, _ = whole
    text = re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]+", "", path.read_text(encoding="utf-8"))
    assert "http" not in text
    assert "url(" not in text
    assert "@import" not in text


def test_every_picture_is_a_file_and_in_the_page(whole):
    path, reader = whole
    names = {p.stem for p in (path.parent / "plots").glob("*.png")}
    once = {"scores", "heat", "true_and_reported", "sensitivity", "collisions", "quality"}
    assert names == once | {f"oscilloscope-{s}" for s in SUITE["scenarios"]}
    assert names <= set(reader.ids)


def test_the_headline_gives_the_ratio_of_the_scores(whole):
    assert "pid follows 2.6 times closer than xi2023-tuned (9.10 against 23.9 µm)." in whole[1].text


def test_every_scenario_and_its_summary_is_in_the_table(whole):
    for scenario in SUITE["scenarios"]:
        assert f"what happens in {scenario}" in whole[1].text


def test_the_run_is_described_and_recorded(whole):
    text = whole[1].text
    assert "6 controllers × 14 scenarios × 8 seeds (1000 to 1007, test split)" in text
    for piece in ("kerfgym benchmark --seeds 8", "0123abc", "336000", "What this cannot tell you", "[A]"):
        assert piece in text


def test_the_table_counts_collisions_where_they_should_not_be(whole):
    row = whole[1].text.split("information", 1)[1].split("pid", 1)[1].split("observer")[0]
    assert "1/96" in row  # 12 scenarios of 8 runs
    assert "2.63" in row  # 23.9 / 9.1


def test_the_same_results_give_the_same_page(tmp_path):
    results = some(scenarios=["wavy"])
    first, second = (write_following(tmp_path / name, results).read_bytes() for name in "ab")
    assert first == second


# The headline


def test_the_ceiling_is_never_ranked():
    found = headline(fake(seconds=0.01))
    assert "preview" not in found
    assert any("preview-5ms" in remark and "2.50 µm" in remark for remark in remarks(fake(seconds=0.01)))


def test_without_the_reference_there_is_no_ratio():
    results = some(controllers={"pid": ("sensor", 9.1, 1.9), "observer": ("sensor", 12.0, 1.8)})
    assert headline(results).startswith("pid follows closest: 9.10 µm against 12.0 µm of observer, the next")
    assert "The reference xi2023-tuned was not run, so there are no ratios." in remarks(results)


def test_a_single_controller_is_compared_with_nobody():
    results = some(controllers={"pid": ("sensor", 9.1, 1.9)})
    assert headline(results) == "pid follows with an RMS error of 9.10 µm."


def test_the_reference_may_win():
    results = some(controllers={"xi2023-tuned": ("sensor", 9.0, 1.9), "pid": ("sensor", 12.0, 1.9)})
    assert headline(results).startswith("xi2023-tuned, the reference, follows closest: 9.00 µm against 12.0 µm of pid")


def test_nobody_of_the_sensor_class():
    assert "nothing to compare" in headline(some(controllers={"preview-5ms": ("preview", 2.5, 1.1)}))


def test_an_ms_over_the_limit_is_said():
    results = some(controllers={"xi2023-tuned": ("sensor", 23.9, 1.9), "pid": ("sensor", 9.1, 2.4)})
    assert "Its sensitivity peak Ms is 2.40, over the limit of 2." in remarks(results)
    assert "pid touched the sheet in 1 of the 16 runs in which it should not." in remarks(results)


@pytest.mark.parametrize(("ratio", "words"), [(1.043, "1.04"), (2.626, "2.6"), (12.4, "12")])
def test_ratios_in_words(ratio, words):
    assert times(ratio) == words


def test_seeds_that_tuning_saw_are_a_warning():
    assert warnings(some()) == []
    seen = warnings(some(seeds=range(30, 38)))
    assert any("8 of 8 seeds belong to the tune split" in text for text in seen)
    assert any("xi2023-tuned was tuned on seeds of this run" in text for text in seen)


# What a benchmark may leave behind


def test_failed_runs_are_shown_and_take_the_score(tmp_path):
    results = some(core=("wavy",))
    metrics = ["rms_true", "p99_true", "rms_reported", "jitter"]
    bad = (results.runs["controller"] == "pid") & (results.runs["scenario"] == "wavy") & (results.runs["seed"] == 1003)
    results.runs.loc[bad, metrics] = np.nan
    results.runs.loc[bad, "failed"] = True
    trace = (results.traces["controller"] == "pid") & (results.traces["time"] > 0.2)
    results.traces.loc[trace, ["gap", "height", "command"]] = np.nan
    reader = read(write_following(tmp_path, results))
    assert "Without a score, because runs failed: pid." in reader.text
    assert "xi2023-tuned follows with an RMS error of 23.9 µm" in reader.text
    assert "failed" in reader.text


def test_all_runs_may_have_failed(tmp_path):
    results = some()
    results.runs[["rms_true", "p99_true", "rms_reported", "jitter", "collision"]] = np.nan
    results.runs["failed"] = True
    results.traces[["gap", "height", "command", "surface"]] = np.nan
    results.sensitivity["magnitude"] = np.inf
    assert "nothing to compare" in read(write_following(tmp_path, results)).text


def test_one_controller_in_one_scenario(tmp_path):
    results = some(controllers={"mine": ("sensor", 9.1, 1.9)}, scenarios=["flat"], core=())
    text = read(write_following(tmp_path, results)).text
    assert "mine follows with an RMS error of 9.10 µm." in text
    assert "RMS while cutting, in the scenario 'flat'." in text
    assert "No run touched the sheet." in text


def test_without_sensitivity_and_traces_and_record(tmp_path):
    results = some()
    results.sensitivity = pd.DataFrame({"controller": [], "frequency": [], "magnitude": []})
    results.traces, results.meta = pd.DataFrame(), {}
    text = read(write_following(tmp_path, results)).text
    assert "The sensitivity was not measured" in text
    assert "Its sensitivity peak Ms was not measured." in text
    assert "The run left no record." in text


def test_names_are_text_and_not_markup(tmp_path):
    evil, other = "<script>alert(1)</script>&$x_{2$", "_a$b$c"
    controllers = {evil: ("sensor", 9.1, 1.9), other: ("sensor", 12.0, 1.9), "xi2023-tuned": ("sensor", 24.0, 1.9)}
    results = some(controllers=controllers, scenarios=["<b>wavy</b>/../$a$", "b?wavy--b"], core=())
    results.meta = {"command": 'kerfgym -c "<i>"', "<u>": {"</table>": ["<p>", 1, None, True]}}
    path = write_following(tmp_path, results)
    reader = read(path)
    assert f"{evil} follows 2.6 times closer" in reader.text
    assert not {"b", "i", "u"} & set(reader.tags)
    assert all(file.parent == tmp_path / "plots" for file in tmp_path.rglob("*.png"))


def test_many_controllers_of_all_classes(tmp_path):
    kinds = ("sensor", "preview", "privileged")
    controllers = {f"{kind}-{i}": (kind, 5.0 + i, 1.5) for i in range(5) for kind in kinds}
    results = some(controllers=controllers, scenarios=["wavy"])
    styles = list(plots.looks(results).values())
    assert len({(look.colour, str(look.line)) for look in styles}) == len(controllers)
    assert list(plots.ranked(results)) == ["sensor", "preview", "privileged"]
    read(write_following(tmp_path, results))


def test_colours_follow_the_order_of_appearance():
    whole = plots.looks(some())
    assert [look.colour for look in whole.values()] == list(plots.COLOURS[:3])
    assert whole["pid"] == plots.looks(some(scenarios=["wavy"]))["pid"]


# Pictures over time


def test_a_drawing_is_shown_as_a_contour(tmp_path):
    results = fake(scenarios=["drawing"], core=("drawing",), drawing=True)
    assert plots.contour_controllers(results) == ["pid", "xi2023-tuned", "observer", "xi2023-improved"]
    text = read(write_following(tmp_path, results)).text
    assert (tmp_path / "plots" / "contour.png").is_file()
    assert "Along the drawing" in text


def test_contour_colours_are_symmetric_and_rapid_moves_are_left_out():
    results = some(scenarios=["drawing"], core=("drawing",), drawing=True)
    figure = plots.contour(results)
    (lines, *_) = [c for sub in figure.subfigs[0].axes for c in sub.collections if c.get_array() is not None]
    assert lines.norm.vmin == -lines.norm.vmax
    trace = results.traces[results.traces["controller"] == "pid"]
    scored = trace["scored"].to_numpy() > 0.5
    error = 1e3 * (trace["gap"] - trace["set_height"]).to_numpy()
    shown = np.asarray(lines.get_array())
    assert len(shown) == scored.sum()
    np.testing.assert_allclose(shown, error[scored])


def test_no_contour_without_places():
    assert "contour" not in {picture.name for picture in pictures(some())}
    results = some()
    results.traces["x"] = results.traces["y"] = np.nan
    assert "contour" not in {picture.name for picture in pictures(results)}


def test_the_oscilloscope_shows_the_second_in_which_the_errors_differ():
    results = some(controllers={"a": ("sensor", 9.0, 1.9), "b": ("sensor", 9.0, 1.9)}, scenarios=["wavy"], seconds=4.0)
    here = (results.traces["controller"] == "b") & results.traces["time"].between(2.2, 2.9)
    results.traces.loc[here, "gap"] += 0.2
    first, last = plots.oscilloscope(results, "wavy").axes[0].get_xlim()
    assert last - first <= 1.0
    assert first < 2.2
    assert last > 2.9


def test_the_oscilloscope_shows_the_first_alarm():
    figure = plots.oscilloscope(fake(seconds=4.0, scenarios=["flat", "tip-up"]), "tip-up")
    first, last = figure.axes[0].get_xlim()
    assert first < 3.2 < last
    assert "6 of 6 controllers in alarm" in figure.get_suptitle()
    low, high = figure.axes[1].get_ylim()
    assert high - low < 1000  # the retracted head does not set the scale


def test_fast_vibrations_are_shown_over_a_shorter_time():
    results = some(scenarios=["wavy"], seconds=2.0)
    results.traces["gap"] = 0.8 + 0.01 * np.sin(2 * np.pi * 60 * results.traces["time"])
    first, last = plots.oscilloscope(results, "wavy").axes[0].get_xlim()
    assert last - first == pytest.approx(0.25, abs=0.002)


def test_a_missing_trace_is_said_in_words():
    assert "no trace of 'flat'" in plots.oscilloscope(some(), "flat").texts[0].get_text()


@pytest.mark.parametrize(("value", "text"), [
    (9.104, "9.10"), (23.94, "23.9"), (104.4, "104"), (99.96, "100"), (-3.0, "−3.00"), (np.nan, "–"), (np.inf, "∞"),
])  # fmt: skip
def test_numbers_have_three_digits(value, text):
    assert plots.number(value) == text


def test_pictures_have_distinct_names():
    taken = set()
    assert [page._stem(name, taken) for name in ("o-a/b", "o-a b", "o-A-B")] == ["o-a-b", "o-a-b-2", "o-A-B-3"]


def test_margins_cost_and_budget_have_a_table_that_marks_what_is_unequal(tmp_path):
    results = some()
    names = results.controllers
    results.margins = pd.DataFrame({"controller": names, "gain": [2.0, 3.456, np.inf], "delay_ms": [5.0, 0.0, np.inf]})
    results.meta["decisions"] = {names[0]: {"median_us": 0.25, "p99_us": 1.5, "ratio": 0.0015}}
    results.meta["tuning"] = {
        "xi2023-tuned": {"trials": 400, "simulated_steps": 6e8}, "pid": {"trials": 4000, "simulated_steps": 6e9},
    }  # fmt: skip
    text = Reader(write_following(tmp_path, results).read_text(encoding="utf-8")).text
    for words in ("3.46", "> 16", "> 64", "none", "0.15 %", "4000 · 6000 M", "larger", "Ratios not at equal budgets"):
        assert words in text, words
    equal = some()
    equal.meta["tuning"] = {name: {"trials": 400, "simulated_steps": 6e8} for name in equal.controllers}
    text = Reader(write_following(tmp_path, equal).read_text(encoding="utf-8")).text
    assert "All ratios are at equal budgets" in text
    assert "of the period" not in text
