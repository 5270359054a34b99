"""Endurance: windows are those of the whole run, and what gets worse with time is found."""

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.figures import job_metrics, metrics
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.results import jobs
from kerfgym.experiments.studies import pages
from kerfgym.experiments.studies.endurance import __main__ as command
from kerfgym.experiments.studies.endurance import minutes, sheets
from kerfgym.experiments.studies.endurance import windows as tables
from kerfgym.experiments.studies.endurance import worse as verdict
from kerfgym.experiments.studies.endurance.stream import Windows, stream

SEEDS = tuple(range(1000, 1006))


class Age(NamedTuple):
    """State of :class:`Ageing`."""

    ms: float = 0.0


class Ageing:
    """A P law whose command swings more and more, from 4 s on."""

    class Params(NamedTuple):
        kv: float = 50.0
        swing: float = 4.0  # mm/s, gained per s

    State = Age

    @staticmethod
    def init(params):
        return Age(0.0)

    @staticmethod
    def control(params, state, signals, tables):
        more = params.swing * max(state.ms - 4000.0, 0.0) * 1e-3
        shake = more if np.floor(state.ms / 20.0) % 2.0 == 0.0 else -more
        return Age(state.ms + 1.0), shake - params.kv * (signals.height - signals.set_height)


class Steady(Ageing):
    """The same without the swing."""

    class Params(NamedTuple):
        kv: float = 50.0
        swing: float = 0.0


def long(seconds, name="wavy"):
    return scenarios.load(name).varied(duration=seconds)


# ------------------------------------------------------------------------------------------------------------- windows


@pytest.mark.parametrize("name", ["rough", "step"])
def test_windows_together_are_what_the_metrics_say_of_the_whole_run(name):
    follower, scenario = stack.resolve("pid"), long(2.3, name)
    whole = rollout.roll(scenario, follower, SEEDS)
    found = stream(scenario, follower, SEEDS, window=0.5)
    assert found.rms.shape == (5, len(SEEDS))
    assert found.whole == 4
    assert found.over(slice(None)) == pytest.approx(metrics.rms_true(whole), rel=1e-9)
    assert found.largest.max(axis=0) == pytest.approx(metrics.max_true(whole), rel=1e-9)
    last = slice(1000, 1500)
    error = np.where(whole.scored[last], np.abs(whole.error[last]), 0.0)
    assert found.largest[2] == pytest.approx(1e3 * error.max(axis=0), rel=1e-9)
    assert found.rms[2] == pytest.approx(1e3 * np.sqrt((error**2).mean(axis=0)), rel=1e-9)
    assert not found.lost.any()


def test_a_run_counts_until_the_window_in_which_it_collides():
    follower, high = stack.resolve("pid"), {"height": {"uniform": [0.5, 1.5], "sign": "±"}}
    scenario = scenarios.load("step").varied(duration=1.0, sheet={"steps": high})
    seeds = tuple(range(1000, 1024))
    record = rollout.roll(scenario, follower, seeds)
    assert 0 < record.collided.sum() < len(seeds)
    found = stream(scenario, follower, seeds, window=0.1)
    assert (found.lost == record.collided).all()
    hit = (record["gap"] <= 0.0).argmax(axis=0) // 100
    first = scenario.settle_steps // 100
    assert hit[record.collided].max() > first
    for i in np.flatnonzero(record.collided):
        assert np.isfinite(found.largest[first : hit[i], i]).all()
        assert np.isnan(found.largest[hit[i] :, i]).all()
    assert np.isfinite(found.rms[first:, ~record.collided]).all()


def test_a_job_is_cut_whole_and_its_windows_hold_its_largest_error():
    scenario = scenarios.load("contour-circle").varied(job={"size": 10.0})
    team = stack.team("z=xi2023-tuned")
    fleet, job, _ = jobs.roll(scenario, team, SEEDS[:3])
    figures = job_metrics.evaluate(job_metrics.Jobs.of(fleet, job))
    found = stream(scenario, stack.get("xi2023-tuned"), SEEDS[:3], window=1.0)
    assert np.nanmax(found.largest, axis=0) == pytest.approx(figures["gap_max"], rel=1e-4)
    assert found.counts.sum(axis=0) == pytest.approx(1e3 * figures["cutting_time"], abs=1)


def test_a_plain_python_controller_is_streamed_like_any_other():
    class Plain:
        def reset(self):
            self.count = 0

        def control(self, signals):
            self.count += 1
            return -50.0 * (signals.height - signals.set_height) if self.count < 900 else math.nan

    found = stream(long(1.2, "flat"), stack.as_stack(Plain, "plain"), SEEDS[:2], window=0.4)
    assert np.isfinite(found.rms[:2]).all()
    assert np.isnan(found.rms[2]).all()
    assert found.lost.all()


# ------------------------------------------------------------------------------------------------------------- verdicts


def test_a_law_that_swings_more_and_more_is_found_and_a_steady_one_is_not():
    frame, windows = minutes.endurance(
        [f"{__file__}:Ageing", f"{__file__}:Steady"], {"wavy": long(16.0)}, SEEDS, window=1.0
    )
    worse, steady = (row for _, row in frame.iterrows())
    assert (worse["word"], steady["word"]) == ("worse", "steady")
    assert worse["rms_growth_low"] > 1.05
    assert worse["ratio"] > 1.5
    assert steady["rms_growth"] == pytest.approx(1.0, abs=0.02)
    assert len(windows) == 2 * 16 * len(SEEDS)
    one = windows[(windows["seed"] == SEEDS[2]) & (windows["controller"] == f"{__file__}:Steady")]
    assert one["start_s"].tolist() == list(range(16))
    kept = tables.promises(frame)
    assert kept[0]["what"] == "controllers that get worse with time"
    assert (kept[0]["measured"], kept[0]["held"]) == (1.0, False)


def made(largest, rms=None):
    largest = np.asarray(largest, float)
    rms = largest / 3 if rms is None else rms
    counts = np.where(np.isnan(largest), 0, 1000)
    return Windows(rms, largest, counts, np.isnan(largest).any(axis=0), len(largest), 10.0)


def test_a_maximum_that_grows_only_because_the_time_is_longer_is_nothing_worse():
    r = np.random.default_rng(1)
    false, ratios = 0, []
    for _ in range(100):
        x = np.exp(0.3 * r.standard_normal((30, 24)))
        judged = verdict.judge(made(x, np.exp(0.02 * r.standard_normal((30, 24)))))
        ratios.append(judged.ratio)
        false += judged.word == "worse"
    assert np.mean(ratios) > 1.2, "the plain ratio grows by itself"
    assert false <= 1
    assert 0.4 < judged.above < 0.6


def test_what_grows_by_a_fifth_is_found():
    r = np.random.default_rng(2)
    trend = np.linspace(1.0, 1.25, 30)[:, None]
    assert verdict.judge(made(trend * np.exp(0.05 * r.standard_normal((30, 24)))), tests=95).word == "worse"
    assert verdict.judge(made(np.exp(0.05 * r.standard_normal((30, 24)))), tests=95).word == "steady"
    assert verdict.judge(made(np.exp(0.8 * r.standard_normal((30, 6)))), tests=95).word == "open"


def test_the_interval_of_growth_is_that_of_a_t_test():
    from scipy import stats

    r = np.random.default_rng(3)
    x = np.exp(r.standard_normal((31, 8)))
    judged = verdict.judge(made(x))
    late, early = np.log(x[21:]).mean(axis=0), np.log(x[1:4]).mean(axis=0)
    expected = stats.ttest_rel(late, early).confidence_interval(0.95)
    assert np.log(judged.largest_growth[1:]) == pytest.approx([expected.low, expected.high])


def test_bursts_are_rare_and_high_windows():
    x = np.full((30, 4), 20.0)
    x[12, 1] = 61.0
    x[13, 1] = 49.0  # below 50 µm
    x[14, 2] = 59.0  # below three times the usual
    x[20, 3] = 101.0
    judged = verdict.judge(made(x))
    assert (judged.bursts, judged.over_50, judged.over_100) == (2, 3, 1)
    assert (judged.largest_first, judged.largest_later) == (20.0, 101.0)
    assert judged.ratio == pytest.approx(5.05)


def test_a_lost_run_is_counted_and_its_other_windows_are_still_judged():
    x = np.full((30, 4), 20.0)
    x[5:, 0] = np.nan
    judged = verdict.judge(made(x))
    assert (judged.lost, judged.seeds, judged.windows) == (1, 4, 95)
    assert judged.word == "steady"
    everyone = verdict.judge(made(np.full((30, 4), np.nan)))
    assert (everyone.lost, everyone.word) == (4, "open")


def rows(**changed):
    row = {
        "controller": "self-tuning",
        "sheet": "wavy",
        "drawing": False,
        "word": "steady",
        "ratio": 1.4,
        "bursts": 0,
        "lost": 0,
        "largest_first": 10.0,
        "largest_later": 14.0,
    }
    return row | changed


def test_what_is_promised_of_self_tuning_is_checked_sheet_by_sheet_and_along_the_drawing():
    frame = pd.DataFrame(
        [
            rows(),
            rows(sheet="rough", ratio=1.6, bursts=2, lost=1),
            rows(controller="pid", ratio=9.0, bursts=7),
            rows(sheet="Gear", drawing=True, ratio=9.0),
            rows(sheet="Gear", drawing=True, controller="xi2023-tuned"),
        ]
    )
    held = {p["what"]: p["held"] for p in tables.promises(frame)}
    assert held == {
        "controllers that get worse with time": True,
        "self-tuning on wavy: largest error later over first": True,
        "self-tuning on wavy: bursts": True,
        "self-tuning on wavy: lost runs": True,
        "self-tuning on rough: largest error later over first": False,
        "self-tuning on rough: bursts": False,
        "self-tuning on rough: lost runs": False,
        "self-tuning along Gear: lost runs": True,
        "self-tuning along Gear: bursts": True,
        "self-tuning along Gear: largest error, µm": True,
    }
    turns = tables.promises(pd.DataFrame([rows(sheet="shift", drawing=True, bursts=9)]))
    assert [p["what"] for p in turns[1:]] == ["self-tuning along shift: lost runs"]
    frame.loc[3, "largest_first"] = 14.2
    assert not tables.promises(frame)[-1]["held"]
    frame.loc[3, "lost"], frame.loc[4, "lost"] = 1, 9  # and nobody sound to compare its errors with
    said = {p["what"]: p["held"] for p in tables.promises(frame) if "Gear" in p["what"]}
    assert said == {"self-tuning along Gear: lost runs": False, "self-tuning along Gear: bursts": True}


@pytest.mark.parametrize(
    ("first", "shown"), [(10.0, "12.2"), (0.122, "1000.0"), (0.12, "> 1000"), (8e-6, "> 1000"), (0.0, "> 1000")]
)
def test_a_ratio_to_almost_nothing_is_only_shown_to_be_large(first, shown):
    with np.errstate(divide="ignore"):
        row = rows(largest_first=first, largest_later=122.0, ratio=float(np.float64(122.0) / first))
    others = dict.fromkeys(("seeds", "over_50", "over_100", "windows"), 1)
    unknown = dict.fromkeys(("rms_first", "rms_later", "above", "rms_growth", "largest_growth"), np.nan)
    sheet = tables.table(pd.DataFrame([row | others | unknown | {"drawing": True}]))
    assert sheet.sections[0][0][sheet.titles.index("later over first")] == shown
    assert "> 1000: there was almost none in the first" in " ".join(sheet.notes)


# --------------------------------------------------------------------------------------------------- sheets and command


def test_the_mixed_sheet_has_the_waves_the_vibration_and_the_impulses():
    mixed = sheets.mixed()
    rough, flutter, impulses = (scenarios.load(name) for name in ("rough", "flutter", "impulses"))
    assert mixed.sheet.waves == rough.sheet.waves
    assert mixed.sheet.vibrations == flutter.sheet.vibrations
    assert (mixed.head.impulses, mixed.head.impulse_samples) == (impulses.head.impulses, impulses.head.impulse_samples)
    assert mixed.axis == rough.axis


def test_self_tuning_is_never_farther_off_than_pid_is_at_worst_however_its_predictions_fail():
    """Impulses on a sheet that turns: readings that are taken for impulses must not build a trend of their own."""
    found = {
        name: stream(sheets.mixed().varied(duration=230.0), stack.get(name), [1008]) for name in ("self-tuning", "pid")
    }
    assert np.nanmax(found["self-tuning"].largest) < np.nanmax(found["pid"].largest)
    assert np.nanmedian(found["self-tuning"].rms) < 0.7 * np.nanmedian(found["pid"].rms)


def test_no_sheet_leads_out_of_the_travel_of_the_head():
    for scenario in sheets.sheets().values():
        assert (scenario.sheet.tilt, scenario.sheet.tilt_y) == (0.0, 0.0)


def test_a_machine_that_an_alarm_stopped_is_lost():
    scenario = scenarios.load("chatter").varied(duration=1.0, feed=200.0, sheet={"tilt": 0.3})
    found = stream(scenario.varied(duration=2.5), stack.get("pid"), SEEDS[:3], window=0.5)
    assert found.lost.all()
    assert np.isfinite(found.largest[1]).all()
    assert np.isnan(found.largest[-1]).all()
    record = rollout.roll(scenario, stack.get("pid"), SEEDS[:3])
    assert not record.collided.any()


@pytest.mark.parametrize(
    ("names", "message"),
    [(("wavvy",), "unknown sheet 'wavvy'; did you mean 'wavy'"), (("path",), "needs a drawing: --path FILE")],
)
def test_sheets_that_are_not_there_are_refused(names, message):
    with pytest.raises(InvalidInput, match=message):
        sheets.sheets(names)


def test_the_command_writes_its_run_and_its_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "endurance.md"
    page.write_text("<!-- run: endurance -->\n<!-- end -->\n", "utf-8")
    monkeypatch.setattr(pages, "manual", lambda name: tmp_path / name)
    part = tmp_path / "part.svg"
    part.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="20mm" height="20mm" viewBox="0 0 20 20">'
        '<rect x="2" y="2" width="9" height="7"/></svg>',
        "utf-8",
    )
    command.main(
        controllers=("xi2023-tuned", "self-tuning"),
        sheets=("chatter", "path"),
        seeds=2,
        duration=3.0,
        path=part,
        docs=True,
    )
    frame = pd.read_parquet(tmp_path / "runs" / "endurance" / "verdicts.parquet")
    assert frame[["sheet", "controller"]].to_numpy().tolist() == [
        ["chatter", "xi2023-tuned"],
        ["chatter", "self-tuning"],
        ["part", "xi2023-tuned"],
        ["part", "self-tuning"],
    ]
    text = page.read_text("utf-8")
    assert "What is promised" in text
    assert "self-tuning along part: largest error, µm" in text
    assert str(tmp_path) not in text
    assert "--path part.svg" in text
    assert "runs/endurance" in capsys.readouterr().out
