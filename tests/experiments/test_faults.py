"""Faults: each does what it says, nothing else, and whoever is to blame is found."""

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.deck import Deck
from kerfgym.envs.engine.lanes import U, call, doubles, load, store, words
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import calibration, filters, heads, machine, z_axis
from kerfgym.envs.plant.controller import stage_address
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.studies import pages
from kerfgym.experiments.studies.faults import __main__ as command
from kerfgym.experiments.studies.faults import campaign, culprits, drawn, inject, trials
from kerfgym.experiments.studies.faults import losses as tables
from kerfgym.experiments.studies.faults.drawn import Drawn
from kerfgym.experiments.studies.faults.inject import Fault, Faults, Without
from kerfgym.experiments.studies.faults.story import story

START = 400.0
PASSED = Without(supervisor=1.0)
_ANY = U(2**40)


def short(name="flat", **changes):
    return scenarios.load(name).varied(duration=1.0, **changes)


def given(*faults, seed=1000):
    return [Drawn("flat", i, seed + i, "planted", fault) for i, fault in enumerate(faults)]


def course(stack_, faults, without, scenario=None):
    """Signals of machines with faults, before and after the pilots, each of shape (periods, machines)."""
    scenario = scenario or short()
    fleet = trials.fleet_for(scenario, stack_, given(*faults), without)
    record = fleet.start_recording(scenario.steps)
    kept = {"spoilt": [], "count": [], "valid": []}
    for _ in range(scenario.steps):
        fleet.advance()
        wish = [fleet.slots(machine.WISH, 1, i)[0] for i in range(fleet.size)]
        kept["spoilt"].append(fleet.column("hand.gain") * wish + fleet.column("hand.residual"))
        kept["count"].append(fleet.column("signals.frequency"))
        kept["valid"].append(fleet.column("signals.valid"))
    out = {name: record[:, i].astype(float) for i, name in enumerate(machine.CHANNELS)}
    return out | {name: np.array(values) for name, values in kept.items()}


@pytest.fixture(scope="module")
def follower():
    return stack.resolve("xi2023-improved")


def at(period):
    """Index of a control period, which are counted from 1."""
    return int(period) - 1


# ---------------------------------------------------------------------------------------------------------- the faults


def test_a_spike_is_asked_for_in_one_period_and_a_pair_in_two(follower):
    x = course(follower, [Fault(inject.SPIKES, START, 1.0, -700.0), Fault(inject.SPIKES, START, 2.0, 5.0, 1e9)], PASSED)
    differs = np.abs(x["spoilt"] - x["wish"]) > 1e-5 * (1 + np.abs(x["wish"]))
    assert np.flatnonzero(differs[:, 0]).tolist() == [at(START)]
    assert np.flatnonzero(differs[:, 1]).tolist() == [at(START), at(START) + 1]
    assert x["spoilt"][at(START)].tolist() == [-700.0, 5.0]
    assert x["spoilt"][at(START) + 1, 1] == 1e9


def test_commands_are_scaled_frozen_and_late_as_told(follower):
    faults = [
        Fault(inject.SCALED, START, 7.0, -1.0),
        Fault(inject.FROZEN, START, 9.0),
        Fault(inject.DELAYED, START, 6.0, back=13.0),
    ]
    x = course(follower, faults, PASSED)
    own, spoilt, first = x["wish"], x["spoilt"], at(START)
    assert spoilt[first : first + 7, 0] == pytest.approx(-own[first : first + 7, 0], rel=1e-6)
    assert spoilt[first : first + 9, 1] == pytest.approx(np.full(9, own[first - 1, 1]), rel=1e-6)
    assert spoilt[first : first + 6, 2] == pytest.approx(own[first - 13 : first - 7, 2], rel=1e-6)
    for lane, length in enumerate((7, 9, 6)):
        sound = np.ones(len(own), bool)
        sound[first : first + length] = False
        assert spoilt[sound, lane] == pytest.approx(own[sound, lane], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("name", ["height-following-ppo", "height-following-schedule-ppo"])
def test_what_a_policy_adds_is_spoilt_with_the_command(name):
    x = course(stack.resolve(name), [Fault(inject.SPIKES, START, 3.0, 123.0, 45.0)], PASSED)
    assert x["spoilt"][at(START) : at(START) + 3, 0].tolist() == [123.0, 45.0, 45.0]
    assert np.abs(x["spoilt"] - x["wish"])[at(START) + 3 :].max() > 0.01, "afterwards it adds to it again"


def test_counts_drop_out_stick_and_saturate_as_told(follower):
    faults = [
        Fault(inject.DROPOUT, START, 5.0),
        Fault(inject.STUCK, START, 5.0),
        Fault(inject.SATURATED, START, 5.0, 1.0, 1.0),
        Fault(inject.SATURATED, START, 5.0, 0.5, 0.0),
    ]
    x = course(follower, faults, PASSED)
    spoilt = slice(at(START), at(START) + 5)
    assert np.flatnonzero(x["valid"][:, 0] == 0.0).tolist() == list(range(at(START), at(START) + 5))
    assert (x["count"][spoilt, 1] == x["count"][at(START) - 1, 1]).all()
    assert np.ptp(x["count"][at(START) - 5 : at(START), 1]) > 0  # it does not stick by itself
    assert x["raw_height"][spoilt, 2] == pytest.approx(calibration.SPAN, abs=1e-3)
    fleet = rollout.fleet_for(short(), follower, [1003])
    head = int(fleet.column("start.head")[0])
    assert x["count"][spoilt, 3] == pytest.approx(0.5 * heads.POOL.frequencies[head * calibration.POINTS])


def test_a_high_impulse_is_as_high_as_the_sensors_model_says(follower):
    x = course(follower, [Fault(inject.IMPULSE, START, 2.0, 10.0), Fault(inject.IMPULSE, START, 1.0, -2.0)], PASSED)
    head = rollout.fleet_for(short(), follower, [1000]).get("sensor")
    i = at(START)
    for lane, relative in enumerate((10.0, -2.0)):
        expected = relative * head.impulse / (1.0 + x["gap"][i, lane] / head.falloff)
        assert x["raw_height"][i, lane] - x["gap"][i, lane] == pytest.approx(expected, rel=0.05, abs=0.01)
    assert abs(x["raw_height"][i + 2, 0] - x["gap"][i + 2, 0]) < 0.02


def test_a_shower_has_its_rate_for_its_time_and_leaves_the_sensor_as_it_was(follower):
    quiet = short(head={"impulses": 0.0})
    x = course(follower, [Fault(inject.SHOWER, START, 200.0, 0.2, 1.0)] * 8, PASSED, quiet)
    hit = np.abs(x["raw_height"] - x["gap"]) > 0.02
    spoilt = slice(at(START), at(START) + 200)
    assert hit[spoilt].mean() == pytest.approx(0.2, abs=0.04)
    assert not hit[: at(START)].any()
    assert not hit[at(START) + 220 :].any()


@pytest.mark.parametrize("name", [*trials.REPEATS])
def test_all_repetitions_are_the_same_to_the_bit_until_the_fault(name):
    scenario, follower = short("rough", start_above=3.0), stack.resolve("lqg")  # the supervisor leads it down at first
    fault = [Fault(inject.SCALED, START, 20.0, -1.0)]
    plain, _ = trials._run(scenario, follower, given(*fault), None, None, 1)
    other, _ = trials._run(scenario, follower, given(*fault), trials.REPEATS[name], plain, 1)
    assert np.array_equal(plain[: at(START)], other[: at(START)])
    assert (name == trials.FAULTLESS) == np.array_equal(plain, other)


def test_hooks_that_do_nothing_change_no_bit(follower):
    scenario = short("rough")
    plain = rollout.roll(scenario, follower, [1000]).data
    fleet = trials.fleet_for(scenario, follower, given(Fault()), Without())
    record = fleet.start_recording(scenario.steps)
    fleet.advance(scenario.steps)
    assert np.array_equal(record, plain)


# ------------------------------------------------------------------------------------------------- what is taken out


def test_without_supervisor_the_drive_gets_every_command_within_its_speed(follower):
    values = [-700.0, 1e6, math.nan, -math.inf, 123.0]
    x = course(follower, [Fault(inject.SPIKES, START, 1.0, value) for value in values], PASSED)
    assert x["command"][at(START) + 1].tolist() == pytest.approx([-500.0, 500.0, 0.0, -500.0, 123.0], abs=0.02)
    later = slice(at(START) + 2, None)
    assert x["command"][later] == pytest.approx(x["wish"][at(START) + 1 : -1], abs=0.02)
    assert (x["override"][later] == 0.0).all()


def test_without_supervisor_a_dropout_stops_nothing(follower):
    fault = [Fault(inject.DROPOUT, START, 5.0)]
    x = course(follower, fault, PASSED)
    assert np.ptp(x["mode"]) == 0.0
    assert np.abs(x["gap"] - x["gap"][at(START) - 1])[at(START) :].max() < 0.05


def test_without_filter_the_newest_count_counts():
    follower = stack.resolve("xi2023-ma:filter.window=30")
    x = course(follower, [Fault(inject.IMPULSE, START, 1.0, 2.0)], Without(filter=1.0))
    filtered = np.abs(x["height"] - x["raw_height"])[:, 0]
    assert filtered[: at(START)].max() > 1e-4
    assert filtered[at(START) :].max() < 1e-6


# ------------------------------------------------------------------------------------------------------ who is to blame


class Planted(NamedTuple):
    """The deck of a defect before a stage of the campaign's; it begins as that stage's own."""

    next: int
    next_io: int
    faults: int
    machine: int
    stage: int


def dive(block_address, at, n, io_address, tick):
    """A supervisor's defect: for 100 ms after the start of a fault the drive gets −60 mm/s, whatever is asked for."""
    block, io = doubles(block_address, _ANY), words(io_address, U(5))
    faults, mine = doubles(io[2], _ANY), at // machine.STRIDE * inject._STRIDE + at % machine.STRIDE
    for lane in range(n):
        a = at + lane
        since = block[a + machine.TALLY] - load(Fault, faults, mine + lane + inject._FAULT).start
        if since > 1.0 and since < 100.0:
            d = load(z_axis.Drive, block, a + machine.DRIVE)
            store(block, a + machine.DRIVE, z_axis.Drive(-60.0, d.c1, d.c2, d.c3, d.c4, d.c5, d.c6))
    call(io[4], block_address, at, n, io_address, tick)


def read_high(block_address, at, n, io_address, tick):
    """A filter's defect: for 100 ms after the start of a fault it reports 10 mm."""
    block, numbers = doubles(block_address, _ANY), doubles(words(io_address, U(2))[0], U(2))
    faults = doubles(U(np.int64(numbers[1])), _ANY)
    mine = at // machine.STRIDE * inject._STRIDE + at % machine.STRIDE
    for lane in range(n):
        a = at + lane
        since = block[a + machine.TALLY] - load(Fault, faults, mine + lane + inject._FAULT).start
        if since > 1.0 and since < 100.0 and block[a + machine.P_FILTER] != filters.NONE:
            block[a + machine.FOLD] = numbers[0]


class Grudge(NamedTuple):
    left: float = 0.0  # periods


class Resentful:
    """A law that is told of a fast descent, and goes on with it."""

    class Params(NamedTuple):
        kv: float = 50.0

    State = Grudge

    @staticmethod
    def init(params):
        return Grudge(0.0)

    @staticmethod
    def control(params, state, signals, tables):
        left = 100.0 if signals.command < -200.0 else max(state.left - 1.0, 0.0)
        wish = -params.kv * (signals.height - signals.set_height)
        return Grudge(left), (-60.0 if left > 0.0 else wish)


HARMLESS = Fault(inject.SPIKES, START, 1.0, -300.0)


def plant(monkeypatch, defect):
    """Puts a defect into every machine that has a fault."""
    install = Faults.install

    def planted(self, fleet):
        install(self, fleet)
        if defect == "supervisor":
            its, stage = fleet.deck.owned("sent_io"), stage_address(inject.pass_commands)
            io = Deck(Planted, faults=its.owned("faults"), machine=its.owned("machine"), stage=stage)
            fleet.after_supervisor(stage_address(dive), io)
        else:
            top = heads.POOL.frequencies[calibration.POINTS - 1]
            fleet.after_filter(stage_address(read_high), np.array([top, float(self._block.ctypes.data)]))

    monkeypatch.setattr(Faults, "install", planted)


def found(stack_, fault):
    return culprits.judged(short(head={"nominal": True}), stack_, given(fault)).iloc[0]


def test_without_a_defect_a_spike_is_harmless():
    row = found(stack.resolve("xi2023-ma"), HARMLESS)
    assert (row["lost"], row["cause"], row["excess"]) == (False, "", "")
    assert 0.005 < row["apart_mm"] < 0.1


@pytest.mark.parametrize("defect", ["supervisor", "filter"])
def test_a_planted_defect_is_found_and_named(defect, monkeypatch):
    plant(monkeypatch, defect)
    row = found(stack.resolve("xi2023-ma:guard.rise=5"), HARMLESS)
    assert row["lost"]
    assert not row["lost_faultless"]
    assert row["cause"] == defect


def test_a_law_that_bears_a_grudge_is_found():
    resentful = stack.as_stack(Resentful, "resentful")
    row = found(resentful, HARMLESS)
    assert row["lost"]
    assert row["cause"] == "law's memory"
    assert found(resentful, Fault(inject.SPIKES, START, 1.0, -100.0))["cause"] == ""


HIGH = Fault(inject.SATURATED, START, 20.0, 1.0, 1.0)


def test_a_sensor_that_says_10_mm_for_20_ms_needs_no_further_cause():
    row = found(stack.resolve("xi2023-improved:filter.kind=none,guard.rise=5"), HIGH)
    assert (row["lost"], row["cause"]) == (True, "fault itself")


@pytest.mark.parametrize("name", ["xi2023-ma", "xi2023-tuned", "pid", "observer", "patent2022", "self-tuning"])
def test_a_sheet_that_falls_as_no_sheet_does_holds_the_head(name):
    row = found(stack.resolve(name), HIGH)
    assert (row["lost"], row["cause"], row["alarm"]) == (False, "", "none")
    assert row["lowest_mm"] > 0.3
    assert found(stack.resolve(name).varied({"guard.rise": 5}), HIGH)["lost"]


ROW = {
    "lost_faultless": False,
    "lost_no_supervisor": True,
    "lost_no_filter": True,
    "lost_neither": True,
    "lost_forgetful": True,
}


@pytest.mark.parametrize(
    ("changed", "cause"),
    [
        ({}, "fault itself"),
        ({"lost_faultless": True, "lost_no_supervisor": False}, "no fault"),
        ({"lost_no_supervisor": False}, "supervisor"),
        ({"lost_no_filter": False}, "filter"),
        ({"lost_no_supervisor": False, "lost_no_filter": False}, "supervisor and filter"),
        ({"lost_neither": False}, "supervisor and filter"),
        ({"lost_forgetful": False}, "law's memory"),
    ],
)
def test_the_cause_is_what_prevents_it_when_taken_out(changed, cause):
    assert culprits.cause(pd.Series(ROW | changed)) == cause


@pytest.mark.parametrize(
    ("apart", "bare", "unfiltered", "alarm", "excess"),
    [
        (0.09, 0.0, 0.0, "none", ""),
        (0.2, 0.05, 0.2, "none", "supervisor"),
        (0.2, 0.1, 0.05, "none", "filter"),
        (0.2, 0.1, 0.1, "none", ""),
        (5.0, 0.1, 0.1, "collision", "stopped"),
    ],
)
def test_an_excess_is_more_than_three_times_what_is_there_without(apart, bare, unfiltered, alarm, excess):
    row = {"apart_mm": apart, "apart_no_supervisor_mm": bare, "apart_no_filter_mm": unfiltered, "alarm": alarm}
    assert culprits.excess(pd.Series(row)) == excess


# --------------------------------------------------------------------------------------------------------- the campaign


def test_a_fault_is_a_function_of_its_number_alone():
    assert drawn.drawn("wavy", 17) == drawn.drawn("wavy", 17)
    assert drawn.drawn("wavy", 21, 1) != drawn.drawn("wavy", 21)
    assert drawn.drawn("wavy", 21) != drawn.drawn("rough", 21)
    many = [drawn.drawn("step", i) for i in range(2000)]
    assert {d.name for d in many} == set(drawn.CLASSES)
    assert {d.seed for d in many} == set(scenarios.SPLITS["test"])
    spikes = {d.fault.value for d in many if d.name == "spike" and not math.isnan(d.fault.value)}
    assert spikes == {s * 10.0**k for k in range(2, 10) for s in (-1, 1)} | {math.inf, -math.inf}
    assert any(math.isnan(d.fault.value) for d in many if d.name == "spike")
    lengths = {d.fault.length for d in many if d.name in ("frozen", "dropout", "zeroed", "stuck count")}
    assert lengths == set(map(float, range(1, 21)))
    starts = [d.fault.start for d in many]
    assert (min(starts), max(starts)) == pytest.approx((500, 1900), abs=5)
    assert all(d.fault.back < inject.RING for d in many)


def test_a_campaign_gives_every_controller_the_same_faults_and_says_how_to_see_one_again(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command.main(controllers=("lqg", "height-following-ppo"), faults=150)
    frame = pd.read_parquet(tmp_path / "runs" / "faults" / "faults.parquet")
    assert len(frame) == 2 * 4 * 19
    halves = [part.reset_index(drop=True) for _, part in frame.groupby("controller")]
    assert (halves[0]["words"] == halves[1]["words"]).all()
    assert not frame["lost_faultless"].any()
    text = capsys.readouterr().out
    assert "Faults by controller" in text
    lost = frame[frame["lost"]]
    assert set(lost["cause"]) <= set(culprits.CAUSES) - {""}
    again = tables.command(lost.iloc[0], 0)
    assert f"--case {lost.iloc[0]['controller']}/{lost.iloc[0]['scenario']}/{lost.iloc[0]['number']}" in again
    ways, told = story(again.split()[-1])
    assert ways.notes == [f"cause: {lost.iloc[0]['cause']}."]
    assert len(ways.sections[0]) == len(trials.REPEATS)
    fault = drawn.drawn(lost.iloc[0]["scenario"], int(lost.iloc[0]["number"])).fault
    spoilt = [float(row[0]) for row in told.sections[0] if row[1]]
    assert spoilt == list(np.arange(fault.start, fault.start + fault.length)[: len(spoilt)])
    assert spoilt[0] == fault.start


def test_its_tables_count_what_the_rows_say():
    row = {
        "controller": "pid",
        "scenario": "flat",
        "number": 3,
        "seed": 1003,
        "fault": "spike",
        "lost": True,
        "broken": False,
        "lowest_mm": -0.1,
        "cause": "supervisor",
        "excess": "",
        "lost_no_supervisor": False,
    }
    rows = [
        row,
        row | {"lowest_mm": -2.0, "number": 7, "controller": "lqg"},
        row | {"lost": False, "cause": "", "excess": "stopped", "lost_no_supervisor": True},
        row | {"cause": "fault itself", "lost_no_supervisor": True, "fault": "shower"},
    ]
    controllers, kinds, remaining = tables.sheets(pd.DataFrame(rows), seed=5)
    cells = dict(zip(controllers.titles, controllers.sections[1][0], strict=True))
    assert (cells["faults"], cells["lost"], cells["supervisor"], cells["fault itself"]) == ("4", "3", "2", "1")
    assert (cells["prevented"], cells["stopped"]) == ("1", "1")
    assert any("2 of 4 faults, 50.00%" in note for note in controllers.notes)
    assert [r[0] for r in kinds.sections[0]] == ["spike", "shower"]
    assert remaining.sections[0][0][:4] == ["spike", "supervisor", "2", "-2.00"]
    assert remaining.sections[0][0][-1] == "python -m kerfgym.experiments.studies.faults --case lqg/flat/7 --seed 5"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: story("lqg/flat"), r"--case lqg/flat: allowed: CONTROLLER/SCENARIO/NUMBER"),
        (lambda: story("lqgg/flat/3"), "did you mean 'lqg'"),
        (lambda: story("wu/flat/3"), r"'wu' drives slot 'xy'; faults are those of slot 'z'"),
        (lambda: command.main(faults=0), r"--faults 0 is out of range; at least 1"),
        (lambda: campaign.campaign(["pidd"], 4), "did you mean 'pid'"),
        (
            lambda: inject.check(stack.python_stack(lambda: None, "mine")),
            "'mine' is plain Python; faults reach compiled laws and policies alone",
        ),
    ],
)
def test_what_cannot_be_done_is_said(call, message):
    with pytest.raises(InvalidInput, match=message):
        call()


# ------------------------------------------------------------------------------------------------------------ the page


def test_a_run_writes_between_its_marks_and_nowhere_else(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- run: faults -->\nold\n<!-- end -->\nb\n<!-- run: other -->\n<!-- end -->\n", "utf-8")
    pages.put("faults", "| new |\n", page)
    pages.put("faults", "| newer \\1 |\n", page)
    assert page.read_text("utf-8") == (
        "a\n<!-- run: faults -->\n\n| newer \\1 |\n\n<!-- end -->\nb\n<!-- run: other -->\n<!-- end -->\n"
    )
    with pytest.raises(InvalidInput, match="needs '<!-- run: speed -->' … '<!-- end -->' just once"):
        pages.put("speed", "x", page)
    with pytest.raises(InvalidInput, match="cannot read"):
        pages.put("faults", "x", tmp_path / "none.md")


def test_a_fleet_keeps_the_arrays_of_its_faults_alive(follower):
    import gc

    fleet = trials.fleet_for(short(), follower, given(HARMLESS), PASSED)
    gc.collect()
    rubbish = [np.full(4000, 1e6) for _ in range(200)]
    fleet.advance(450)
    assert isinstance(fleet, Fleet)
    assert np.isfinite(fleet.column("signals.gap")).all()
    assert len(rubbish) == 200
    other = trials.fleet_for(short(), follower, given(HARMLESS), PASSED)
    other.advance(450)
    assert other.column("signals.gap") == fleet.column("signals.gap")
