"""Evidence range: what was published bounds the machine's process settings, and what lies outside is marked."""

import gymnasium as gym
import numpy as np
import pytest

import kerfgym  # noqa: F401
from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import team
from kerfgym.envs.figures import evidence, job_metrics
from kerfgym.envs.plant import published, spot
from kerfgym.envs.plant.controller import Process
from kerfgym.envs.scenarios import material as materials
from kerfgym.experiments.reproduce import fit_cut
from kerfgym.experiments.results import jobs

PRINTED, CALIBRATED = evidence.published("c45-10"), evidence.calibrated("c45-10")
FEED = 1000 / 60  # mm/s, of override 1
DYNAMIC = Process(1.0, 1.0, 2000.0, 0.3, 0.3, 1.0, 0.0, 0.0)
SMALL = {"job": {"size": 8.0, "lead_in": 1.0}}


def excess(command, feed=FEED, shape=spot.CIRCULAR, offset=0.0, pressure=1.0, ranges=CALIBRATED):
    found = published.beyond(ranges, feed, command, shape, offset, pressure)
    return {name: x for name, x in found._asdict().items() if x}


def did(name, scenario, seeds=(1000,)):
    fleet, job, _ = jobs.roll(scenario, team(name), list(seeds))
    return job_metrics.Jobs.of(fleet, job)


# --------------------------------------------------------------------------------------------- inside and outside


@pytest.mark.parametrize("row", fit_cut.TABLE_2.values(), ids=list(fit_cut.TABLE_2))
def test_the_three_published_cuts_lie_inside(row):
    d = row["dither"]
    command = Process(1.0, 1.0, d.frequency, d.x, d.y, d.z, d.focus, 0.0)
    assert excess(command, feed=row["feed"] * 1e3 / 60) == {}


def test_both_columns_of_table_1_were_published_and_no_mixture_of_them():
    thick = DYNAMIC._replace(frequency=4000.0, z=5.0)
    assert excess(thick, ranges=PRINTED) == {}
    assert excess(DYNAMIC._replace(z=5.0), ranges=PRINTED) == {"depth": pytest.approx(4.0)}
    assert excess(DYNAMIC._replace(frequency=3000.0, z=3.5), ranges=PRINTED) == {"depth": pytest.approx(0.5)}


def test_what_was_published_without_a_result_is_not_calibrated():
    """Table 2's cuts have 2 kHz and ±1 mm; Table 1 prints 4 kHz and ±5 mm for thick plate, with which none was cut."""
    dithers = [row["dither"] for row in fit_cut.TABLE_2.values() if row["dither"].frequency]
    assert {d.frequency for d in dithers} == {CALIBRATED.frequency_low} == {CALIBRATED.frequency_high}
    assert {d.z for d in dithers} == {CALIBRATED.deep_low} == {CALIBRATED.deep_high}
    assert excess(DYNAMIC._replace(frequency=4000.0, z=5.0)) == {"frequency": 2000.0, "depth": pytest.approx(4.0)}
    assert excess(DYNAMIC._replace(frequency=2100.0)) == {"frequency": pytest.approx(100.0)}


@pytest.mark.parametrize(
    ("command", "setting", "much"),
    [
        (DYNAMIC._replace(z=1.5), "depth", 0.5),
        (DYNAMIC._replace(override=1.5), "feed", 0.5 * FEED),
        (DYNAMIC._replace(override=0.1), "feed", 200 / 60 - 0.1 * FEED),
        (DYNAMIC._replace(power=0.9), "power", 0.1),
        (DYNAMIC._replace(power=1.1), "power", 0.1),
        (DYNAMIC._replace(frequency=1500.0), "frequency", 500.0),
        (DYNAMIC._replace(x=0.35, y=0.35), "amplitude", 0.05),
        (DYNAMIC._replace(focus=-5.0), "focus", 4.9),
        (DYNAMIC._replace(standoff=0.3), "standoff", 0.25),
    ],
)
def test_each_setting_knows_by_how_much_it_lies_outside(command, setting, much):
    assert excess(command) == {setting: pytest.approx(much)}


@pytest.mark.parametrize("setting", published.Excess._fields)
def test_one_setting_outside_is_enough(setting):
    nothing = published.Excess(*[0.0] * len(published.Excess._fields))
    assert not published.outside(nothing)
    assert published.outside(nothing._replace(**{setting: 0.01}))


def test_an_ellipse_the_hat_gas_and_a_standoff_that_is_set_wrong_lie_outside():
    slower = DYNAMIC._replace(override=0.7)
    assert excess(slower._replace(y=0.15)) == {"ellipse": pytest.approx(0.15)}
    assert excess(DYNAMIC, shape=spot.HAT) == {"shape": 1.0}
    assert excess(DYNAMIC, pressure=0.6) == {"pressure": pytest.approx(0.35)}
    assert excess(DYNAMIC, offset=-0.2) == {"standoff": pytest.approx(0.15)}


def test_the_smaller_the_dither_the_lower_the_published_feed():
    for amplitude, most in ((0.0, 500 / 60), (0.15, 750 / 60), (0.3, 1000 / 60)):
        assert published.fastest(CALIBRATED, amplitude) == pytest.approx(most)
    static = Process(1.0, 1.0, 0.0, 0.3, 0.3, 1.0, 0.0, 0.0)  # amplitudes without a frequency are none
    assert excess(static) == {"feed": pytest.approx(500 / 60)}


def test_of_other_materials_nothing_is_calibrated():
    for name in materials.names():
        known = bool(materials.material(name).calibration)
        assert (name in evidence.RANGES) == known
        assert evidence.calibrated(name).known == known
        assert evidence.published(name).bounded == known
        assert not evidence.published(name, extrapolate=True).bounded
        if not known:
            assert excess(DYNAMIC, ranges=evidence.calibrated(name)) == {"material": 1.0}


def test_what_is_obeyed_was_published_whatever_is_asked():
    random = np.random.default_rng(0)
    for _ in range(500):
        least = (0.05, 0.0, 0.0, 0.0, 0.0, 0.0, -5.0, -1.0)
        most = (2.0, 1.2, 4000.0, 0.3, 0.3, 5.0, 5.0, 1.0)
        asked = Process(*map(random.uniform, least, most))
        feed = random.uniform(3.4, 40.0)
        assert excess(published.bounded(PRINTED, feed, asked), feed=feed, ranges=PRINTED) == {}
    assert published.bounded(PRINTED, FEED, DYNAMIC) == pytest.approx(DYNAMIC)


def test_words_say_what_lies_outside_and_by_how_much():
    text = evidence.words({"beyond_feed": 8.333, "beyond_ellipse": 0.1476, "beyond_power": 0.322})
    assert text == "feed by 8.33 mm/s, power by 32%, dither x against y by 0.148 mm"
    assert evidence.said(text) == f"extrapolated: {text}"
    assert evidence.said("") == "within the calibrated settings"
    assert evidence.words({"material": 1.0}) == evidence.ASSUMED


def test_every_number_of_the_range_has_a_source():
    given = {name for setting in evidence.C45 for name in setting.values}
    assert given == set(published.Range._fields) - {"known", "bounded"}
    assert all(setting.source and setting.words for setting in evidence.C45)
    further = [setting for setting in evidence.C45 if setting.printed]
    assert {setting.name for setting in further} == {"frequency", "depth"}
    assert all(setting.printed_source and setting.printed_words for setting in further)
    assert [row[1] == row[3] for row in evidence.table("c45-10")] == [not s.printed for s in evidence.C45]


# -------------------------------------------------------------------------------------------------- the machine


def test_a_machine_obeys_only_what_was_published_unless_it_may_extrapolate():
    wild = "huang2024-dynamic:law.override=1.5,law.y=0.1,law.focus=-3"
    scenario = scenarios.load("cut-square").varied(**SMALL)
    kept, plain = did(wild, scenario), did("huang2024-dynamic", scenario)
    assert job_metrics.evidence(kept)["extrapolated"] == 0.0
    assert kept.sums["cutting"] > plain.sums["cutting"]  # ±0.1 mm of dither stand for 11 mm/s
    free = did(wild, scenario.varied(job={"extrapolate": True}))
    seen = job_metrics.evidence(free)
    assert seen["extrapolated"] == pytest.approx(1.0, abs=0.01)
    assert seen["beyond_ellipse"] == pytest.approx(0.2)
    assert seen["beyond_focus"] == pytest.approx(2.9)
    assert free.sums["cutting"] < plain.sums["cutting"]


def test_the_core_of_the_cutting_suite_lies_inside_for_whoever_cuts_and_the_rest_does_not():
    core = scenarios.core("cutting")
    for name, scenario in scenarios.suite("cutting").items():
        seen = job_metrics.evidence(did("huang2024-dynamic", scenario.varied(**SMALL)))
        assert (float(seen["extrapolated"][0]) == 0.0) == (name in core), name


# ----------------------------------------------------------------------------------------------- the environment


@pytest.mark.parametrize("control", ["direct", "residual"])
def test_the_action_space_is_what_was_published_unless_asked_otherwise(control):
    """``info`` marks what was published without a result, and nothing else as long as the action space ends there."""
    random = np.random.default_rng(1)
    names = published.Excess._fields
    for extrapolate in (False, True):
        env = gym.make(
            "kerfgym/Cutting-v0",
            scenario="cut-square",
            machine=SMALL,
            control=control,
            base="huang2024-dynamic",
            extrapolate=extrapolate,
        ).unwrapped
        env.reset(seed=0)
        seen = []
        for _ in range(150):
            *_, over, late, info = env.step(random.uniform(-1, 1, 8).astype(np.float32))
            seen.append([info[f"beyond_{name}"] for name in names])
            assert info["extrapolated"] == float(any(seen[-1]))
            if over or late:
                break
        left = {name for name, most in zip(names, np.max(seen, axis=0), strict=True) if most > 0}
        if extrapolate:
            assert {"feed", "power", "ellipse", "focus", "standoff"} < left
        else:
            assert left == {"frequency", "depth"}
            assert np.max(seen) <= 2000.0


def test_a_process_that_keeps_the_frequency_of_the_calibrated_cuts_is_within_them_whatever_else_it_asks():
    """At 2 kHz what was published and what was calibrated are the same."""
    random = np.random.default_rng(2)
    env = gym.make("kerfgym/Cutting-v0", scenario="cut-square", machine=SMALL, base="huang2024-dynamic").unwrapped
    env.reset(seed=0)
    for _ in range(150):
        action = random.uniform(-1, 1, 8).astype(np.float32)
        action[2] = -abs(action[2])
        *_, over, late, info = env.step(action)
        assert info["extrapolated"] == 0.0
        if over or late:
            break


def test_a_reward_may_charge_what_lies_outside_the_calibrated_settings_and_by_default_does_not():
    """Per mm cut: an action at the ends asks for the highest frequency, and the machine obeys."""
    for weights, charge in ((None, 0.0), ({"outside": 2.0}, 2.0)):
        env = gym.make(
            "kerfgym/Cutting-v0", scenario="cut-square", machine=SMALL, base="huang2024-dynamic", reward=weights
        ).unwrapped
        env.reset(seed=0)
        charged = 0.0
        for _ in range(400):
            *_, over, late, info = env.step(np.array([0, 0, 1, 0, 0, 0, 0, 0], np.float32))
            assert info["weighted_outside"] == pytest.approx(-charge * info["reward_outside"])
            charged += info["reward_outside"]
            if over or late:
                break
        assert charged == pytest.approx(float(env.batch.fleet.gantries.column("sums.outside")[0]), rel=1e-9)
        assert charged > 10.0  # mm


def test_direct_actions_reach_every_end_of_the_published_range():
    env = gym.make(
        "kerfgym/Cutting-v0", scenario="cut-square", machine=SMALL, control="direct", base="huang2024-dynamic"
    ).unwrapped
    for sign in (-1.0, 1.0):
        env.reset(seed=0)
        for _ in range(8):
            env.step(np.full(8, sign, np.float32))
        applied = env.batch.fleet.gantries.get("applied")
        if sign > 0:
            wanted = (1.0, 1.0, 4000.0, 0.3, 0.3, 5.0, 0.1, 0.05)
        else:
            wanted = (0.2, 1.0, 2000.0, 0.0, 0.0, 0.0, -0.1, -0.05)
        assert tuple(applied) == pytest.approx(wanted)
