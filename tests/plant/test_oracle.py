"""The compiled machine against the same equations in plain NumPy, period by period, whole and with each part alone."""

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control.stack import Stack, resolve
from kerfgym.envs.plant import heads, machine, supervisor
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.scenarios import load, suite
from kerfgym.experiments.measure.rollout import fleet_for
from kerfgym.tests.oracle.z_machine import CLOCK, ZMachine

PERIODS = 500
SEEDS = np.array([1000, 1001, 1002, 1003], np.uint64)

LAWS = {
    "xi2023": "xi2023-improved:filter.window=5,law.kv=50",
    "pid": "pid:filter.kind=improved,filter.window=3,law.kp=60,law.ki=2000,law.kd=0.2,law.lag=4",
}


@dataclass(frozen=True)
class Case:
    """A part of the machine, switched on in the case ``beside``."""

    scenario: dict[str, Any] = field(default_factory=dict)  # changes to that case's scenario
    stack: dict[str, Any] = field(default_factory=dict)  # changes to its stack
    columns: dict[str, float] = field(default_factory=dict)  # and what a scenario does not say
    beside: str = "bare"


def axis(**changes: float) -> dict[str, Any]:
    return {"axis": changes}


def head(**changes: Any) -> dict[str, Any]:
    return {"head": changes}


def sheet(**changes: Any) -> dict[str, Any]:
    return {"sheet": changes}


def level(**changes: Any) -> dict[str, Any]:
    """A sheet without the wave."""
    return sheet(waves=(), **changes)


BARE = load("flat").varied(
    duration=PERIODS * 1e-3,
    set_height=0.8,
    axis={
        "bandwidth": 80,
        "zeta": 0.8,
        "dead_time": 0,
        "latency": 0,
        "acceleration": 1e5,
        "jerk": 1e8,
        "speed": 2000,
        "compliance": 0,
        "friction": 0,
        "bristle": 0,
        "backlash": 0,
        "encoder": 0,
        "dac_bits": 0,
    },
    head={"noise": 0, "jitter": 0, "impulses": 0, "nominal": True, "plate": 2},
    sheet={"waves": [{"amplitude": 0.3, "wavelength": 120}]},
)
"""A wave under a head that does nothing but count, on an axis that is nothing but its loop."""

CASES = {
    "bare": Case(),
    # Z axis
    "a slow loop": Case(axis(bandwidth=50, zeta=0.6)),
    "dead time 1": Case(axis(dead_time=0.001)),
    "dead time 1.3": Case(axis(dead_time=0.0013)),
    "dead time 2": Case(axis(dead_time=0.002)),
    "dead time 3.5": Case(axis(dead_time=0.0035)),
    "latency": Case(axis(latency={"uniform": [0.0001, 0.0009]})),
    "latency beside a dead time": Case(axis(latency={"uniform": [0, 0.002]}), beside="dead time 2"),
    "dead time 6": Case(axis(dead_time=0.004, latency=0.002)),
    "dead time 6.4": Case(axis(dead_time=0.0055, latency=0.0009)),
    "dead times short and long": Case(axis(dead_time={"uniform": [0.001, 0.018]})),
    "dead time 14": Case(axis(dead_time=0.012, latency=0.002)),
    "D/A of 16 bits": Case(axis(dac_bits=16)),
    "D/A of 8 bits": Case(axis(dac_bits=8)),
    "encoder": Case(axis(encoder=1e-3)),
    "encoder of 20 µm": Case(axis(encoder=0.02)),
    "friction": Case(axis(friction=800)),
    "bristles": Case(axis(bristle=0.005), beside="friction"),
    "stiction": Case(axis(stiction=1.6, stribeck=2), beside="bristles"),
    "stiction, drawn": Case(
        axis(friction={"uniform": [200, 2000]}, bristle={"uniform": [1e-4, 0.02]}, stribeck={"uniform": [0.5, 20]}),
        beside="stiction",
    ),
    "stick and slip": Case(sheet(waves=[{"amplitude": 0.02, "wavelength": 300}]), beside="stiction"),
    "resonance": Case(axis(compliance=0.1, resonance=100)),
    "resonance, all of the path": Case(axis(compliance=1, resonance=140, resonance_zeta=0.2)),
    "speed limit": Case(axis(speed=20), beside="steps"),
    "acceleration limit": Case(axis(acceleration=1500), beside="steps"),
    "jerk limit": Case(axis(jerk=4e5), beside="steps"),
    "backlash": Case(axis(backlash=0.02), beside="pits"),
    "end of travel": Case(columns={"z.low": -0.5}, beside="pits"),
    # sensor
    "another head": Case(head(nominal=False)),
    "oscillator with series capacitors": Case(head(oscillator="eq1")),
    "noise": Case(head(noise=3e-3)),
    "jitter": Case(head(jitter=1e-5)),
    "drift": Case(head(drift=0.0016, warming=1)),
    "impulses": Case(head(impulses=60)),
    "impulses of three samples": Case(head(impulses=60, impulse_samples=3)),
    "bursts": Case(head(bursts=20)),
    "plasma": Case(head(plasma=0.05)),
    "plate": Case(head(plate=5.6)),
    "plate, gate of a period": Case(stack={"gate.length": 1.0}, beside="plate"),
    "plate, short gate": Case(stack={"gate.length": 0.1}, beside="plate"),
    "plate over steps": Case(head(plate=5.6), beside="steps"),
    "plate over raised parts": Case(head(plate=12), beside="raised parts"),
    "plate over waves": Case(head(plate=4), beside="waves"),
    # sheet and path
    "tilt": Case(level(tilt=0.008)),
    "waves": Case(sheet(waves=[{"amplitude": 0.1, "wavelength": w, "direction": 2 * w} for w in (15, 40, 90)])),
    "vibration": Case(level(vibrations=[{"frequency": 45, "amplitude": 0.02}])),
    "band": Case(level(vibrations=[{"frequency": 45, "amplitude": 0.02, "zeta": 0.1}])),
    "bands and tones": Case(
        level(
            vibrations=[
                {"frequency": f, "amplitude": 0.02, "zeta": {"choice": [0, z]}}
                for f, z in ((20, 0.05), (60, 0.3), (200, 0.7))
            ]
        )
    ),
    "random": Case(level(random={"rms": 0.2, "exponent": 2})),
    "random, steep": Case(level(random={"rms": 0.2, "exponent": 3, "rolloff": 400})),
    "plate over random": Case(head(plate=5.6), beside="random"),
    "random, fast": Case({"feed": 2000}, beside="plate over random"),
    "steps": Case(level(steps={"count": 4, "height": {"uniform": [-0.6, 0.2]}, "spacing": {"uniform": [20, 30]}})),
    "pits": Case(level(steps={"count": 4, "height": -3, "spacing": 70}) | {"feed": 600}, {"guard.rise": 5}),
    "pits that are no sheet's": Case(stack={"guard.rise": 0.05}, beside="pits"),
    "raised parts": Case(level(holes={"pitch": 45, "length": 10, "rise": 0.3})),
    "round holes": Case(level(holes={"pitch": 40, "jitter": {"uniform": [-5, 5]}, "length": 4, "round": True})),
    "bulge": Case(level(bulge={"height": 0.5, "width": 40, "growth": 0.2, "x": 60})),
    "twice the feed": Case({"feed": 400}),
    "corners": Case({"corners": {"pitch": {"uniform": [15, 40]}, "feed": 10, "acceleration": 2000}}),
    "slow corners": Case({"corners": {"pitch": 10, "feed": 1, "acceleration": {"uniform": [100, 500]}}}),
    "random between corners": Case(sheet(random={"rms": 0.2}), beside="corners"),
    "slope to and fro": Case({"feed": 2000}, columns={"sheet.length": 620.0}, beside="tilt"),
    # gate, filter and table
    "short gate": Case(stack={"gate.length": 0.1}),
    "gate of a period": Case(stack={"gate.length": 1.0}, beside="noise"),
    "mean of single periods": Case(stack={"gate.mean": "mean"}),
    "no filter": Case(stack={"filter.kind": "none"}, beside="noise"),
    "moving average": Case(stack={"filter.kind": "mean"}, beside="impulses"),
    "two trimmed of nine": Case(stack={"filter.window": 9, "filter.trim": 2}, beside="impulses of three samples"),
    "nearest entry": Case(stack={"table.look_up": "nearest"}),
    # supervisor
    "another set height": Case({"set_height": 0.5}),
    "approach": Case({"start_above": {"uniform": [2, 8]}}),
    "slow approach": Case(stack={"guard.delay": 40, "guard.fastest": 60, "guard.slew": 3}, beside="approach"),
    "hold over holes": Case(level(holes={"pitch": 60, "length": 15}) | {"guard": True}),
    "hold that times out": Case(stack={"guard.timeout": 40, "guard.fastest": 5}, beside="hold over holes"),
    "edge": Case(level(holes={"pitch": 100, "length": 40, "count": 1}) | {"guard": True}),
}

BUILT_TO_BE_HIT = ("long-hole", "tip-up")
SHIPPED = {
    f"the suite's {name}": load(name).varied(duration=PERIODS * 1e-3)
    for name in suite("following")
    if name not in BUILT_TO_BE_HIT
}


def settled(name: str) -> tuple[scenarios.Scenario, dict[str, Any], dict[str, float]]:
    """Scenario, changes to the stack and columns of a case or of a shipped scenario."""
    if name in SHIPPED:
        return SHIPPED[name], {}, {}
    case = CASES[name]
    scenario, stack, columns = (BARE, {}, {}) if name == "bare" else settled(case.beside)
    return scenario.varied(**case.scenario), {**stack, **case.stack}, {**columns, **case.columns}


COLUMNS = {
    "gap": "signals.gap", "height": "signals.height", "raw_height": "signals.raw_height",
    "frequency": "signals.frequency", "surface": "signals.surface_0", "head": "signals.head",
    "position": "motion.position", "velocity": "motion.velocity", "acceleration": "motion.acceleration",
    "play": "motion.play", "encoder": "signals.head_position", "encoder_velocity": "signals.head_velocity",
    "command": "signals.command", "override": "signals.override", "captured": "signals.captured",
    "scored": "course.scored", "lowest": "tally.lowest", "holding": "signals.mode",
}  # fmt: skip
NAMES = [*CASES, *SHIPPED]


@dataclass(frozen=True)
class Runs:
    """Every case under one law, by both machines."""

    kernel: dict[str, np.ndarray]  # channels, shape (periods, names, seeds)
    wanted: dict[str, np.ndarray]  # the oracle's
    lost: np.ndarray  # whether the oracle lost a machine, shape (names, seeds)
    clock: np.ndarray  # counts of the clock within the gate, shape (names, seeds)


@functools.cache
def runs(law: str) -> Runs:
    """All cases as machines of one fleet: a period costs the oracle little more for hundreds than for one."""
    base: Stack = resolve(LAWS[law])
    keys = scenarios.noise_keys(np.tile(SEEDS, len(NAMES)))
    fleet = Fleet(len(keys), base.law, heads.POOL)
    for i, name in enumerate(NAMES):
        machines = i * len(SEEDS) + np.arange(len(SEEDS))
        scenario, stack, columns = settled(name)
        scenarios.prepare(fleet, scenario, machines, SEEDS)
        base.varied(stack).install(fleet, machines)
        for column, value in columns.items():
            fleet.set(column, machines, value)
    oracle = ZMachine.like(fleet, keys, heads.POOL)
    fleet.begin(np.arange(fleet.size), keys)
    kept: dict[str, list[np.ndarray]] = {channel: [] for channel in COLUMNS}
    for _ in range(PERIODS):
        fleet.advance()
        for channel, column in COLUMNS.items():
            kept[channel].append(fleet.column(column))
    shape = (PERIODS, len(NAMES), len(SEEDS))
    kernel = {channel: np.reshape(values, shape) for channel, values in kept.items()}
    kernel["holding"] = kernel["holding"] == supervisor.HOLD
    wanted = {channel: values.reshape(shape) for channel, values in oracle.run(PERIODS).items()}
    clock = fleet.column("gate.length") * 1e-3 * CLOCK
    return Runs(kernel, wanted, oracle.lost.reshape(shape[1:]), clock.reshape(shape[1:]))


# The kernel's polynomials for sine and logarithm (good to 3e-11 and 1e-10) and its order of summing keep the two from
# being the same bits, by far less than this. Counts, encoder and D/A then wipe the difference out.
PLACES = ("gap", "height", "raw_height", "surface", "head", "position", "play", "encoder", "lowest")
SWITCHES = ("holding", "override", "captured", "scored")
TOLERANCE = {
    **dict.fromkeys(PLACES, 1e-9),
    "velocity": 1e-8,
    "command": 1e-8,
    "encoder_velocity": 1e-6,
    "acceleration": 1e-6,
    "frequency": 1e-6,
    **dict.fromkeys(SWITCHES, 0.0),
}
"""Largest difference: mm, Hz, mm/s, mm/s², flags."""

# Unless they lie on either side of a rounding edge: one sample in about 1e7 counts one tick of the clock more or less
# (0.4 µm at 1 mm), and from there the two runs are different ones that stay near each other. None of the samples here
# does, but with other seeds, or a table a little different, one may.
NEAR = 1e-3
"""mm between the gaps of two runs that parted at a count."""


def differences(law: str, name: str) -> dict[str, np.ndarray]:
    """Difference of each channel between kernel and oracle, shape (periods, seeds)."""
    run, i = runs(law), NAMES.index(name)
    return {c: np.abs(run.kernel[c][:, i].astype(float) - run.wanted[c][:, i]) for c in COLUMNS}


def parted(law: str, name: str) -> np.ndarray:
    """Whether the two runs of each seed part at a single count and at nothing else, shape (seeds,)."""
    run, i, d = runs(law), NAMES.index(name), differences(law, name)
    off = {c: ~(d[c] <= TOLERANCE[c]) for c in COLUMNS}
    moved = np.any([off[c] for c in ("gap", "head", "position", "velocity", "surface", "encoder")], axis=0)
    seeds = np.arange(len(SEEDS))
    first = np.any(list(off.values()), axis=0).argmax(axis=0)
    ticks = d["frequency"][first, seeds] / run.wanted["frequency"][first, i, seeds] * run.clock[i]
    return (np.abs(ticks - 1.0) < 0.05) & ~moved[first, seeds] & (d["gap"].max(axis=0) < NEAR)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", NAMES)
def test_the_machine_runs_as_its_equations_say(law, name):
    assert not runs(law).lost[NAMES.index(name)].any()
    same = ~parted(law, name)
    assert same.sum() >= len(SEEDS) - 1
    worst = {channel: d[:, same].max() for channel, d in differences(law, name).items()}
    assert not {channel: d for channel, d in worst.items() if not d <= TOLERANCE[channel]}


@pytest.mark.parametrize("law", LAWS)
def test_hardly_a_run_parts_at_a_count(law):
    assert sum(parted(law, name).sum() for name in NAMES) <= 2


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", [name for name in CASES if name != "bare"])
def test_each_part_shows_in_the_motion_or_in_the_encoder(law, name):
    wanted, i, beside = runs(law).wanted, NAMES.index(name), NAMES.index(CASES[name].beside)
    shown = [np.abs(wanted[channel][:, i] - wanted[channel][:, beside]).max() for channel in ("gap", "encoder")]
    assert max(shown) > 1e4 * TOLERANCE["gap"]


@pytest.mark.parametrize("law", LAWS)
def test_the_cases_reach_what_they_are_about(law):
    wanted = {channel: {n: v[:, i] for i, n in enumerate(NAMES)} for channel, v in runs(law).wanted.items()}
    assert wanted["play"]["backlash"].max() == 0.02  # the head has risen to its upper flank
    assert not wanted["play"]["backlash"][-1].any()
    assert np.abs(wanted["velocity"]["speed limit"]).max() < 20.0 < np.abs(wanted["command"]["speed limit"]).max()
    assert np.abs(wanted["acceleration"]["acceleration limit"]).max() == 1500.0
    assert -0.5 < wanted["position"]["end of travel"].min() < -0.49
    assert not wanted["captured"]["approach"][:20].any()
    assert wanted["captured"]["approach"][-1].all()
    for name in ("hold over holes", "hold that times out", "edge"):
        assert wanted["holding"][name].any(axis=0).all()
        assert not wanted["scored"][name].all()
    assert wanted["captured"]["hold over holes"][10:].all()
    assert not wanted["captured"]["hold that times out"][10:].all()


def test_turns_come_and_go_as_their_equations_say():
    turns = {"length": 2, "count": 3, "waves": [0], "random": [1], "vibrations": [1, 2], "impulses": [0, 2]}
    parts = sheet(
        random={"rms": 0.1},
        waves=[{"amplitude": 0.2, "wavelength": 120}],
        vibrations=[{"frequency": 20, "amplitude": 0.02, "zeta": 0.1}, {"frequency": 31, "amplitude": 0.01}],
    )
    scenario = BARE.varied(turns=turns, **head(plate=4), **parts)
    stack, keys, every = resolve(LAWS["xi2023"]), scenarios.noise_keys(SEEDS[:2]), [0, 1]
    fleet = Fleet(2, stack.law, heads.POOL)
    scenarios.prepare(fleet, scenario, every, SEEDS[:2])
    stack.install(fleet, every)
    oracle = ZMachine.like(fleet, keys, heads.POOL)
    fleet.begin(every, keys)
    seen: dict[str, list[np.ndarray]] = {name: [] for name in ("surface", "slope", "bend", "felt")}
    for _ in range(6500):
        fleet.advance()
        for name, values in seen.items():
            values.append(fleet.column(f"course.{name}"))
    halves = np.arange(13_001) / 2.0
    tip, plate = (np.array([oracle.surface_at(h, side) for h in halves]) for side in (False, True))
    start, middle, end = tip[:-1:2], tip[1::2], tip[2::2]
    begun, slope, bend = (np.array(seen[name]) for name in ("surface", "slope", "bend"))
    assert np.abs(begun - start).max() < 1e-9
    assert np.abs(begun + slope / 2 + bend / 4 - middle).max() < 1e-9
    assert np.abs(begun + slope + bend - end).max() < 1e-9
    # The parabola through the differences of the footprints, at the gate's five substeps.
    q, (start, middle, end) = 1.0 - np.arange(5)[:, None, None] / 20.0, ((plate - tip)[i::2] for i in (0, 1, 2))
    start = start[:-1]
    more = start * (1 - q) * (1 - 2 * q) + middle * 4 * q * (1 - q) + end * q * (2 * q - 1)
    assert np.abs(seen["felt"] - more.mean(axis=0)).max() < 1e-9
    assert np.ptp(more) > 0.01


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"filter.kind": "median"}, "the filter median"), ({"guard.alarm_error": 1.0}, "lasting following error")],
)
def test_what_the_oracle_does_not_know_it_refuses(changes, message):
    stack = resolve(LAWS["pid"]).varied(changes)
    fleet = Fleet(2, stack.law, heads.POOL)
    scenarios.prepare(fleet, BARE, [0, 1], SEEDS[:2])
    stack.install(fleet, [0, 1])
    with pytest.raises(NotImplementedError, match=message):
        ZMachine.like(fleet, scenarios.noise_keys(SEEDS[:2]), heads.POOL)


@pytest.mark.parametrize("row", ["HEIGHTS", "RAW_HEIGHTS", "POSITIONS", "COMMANDS"])
def test_a_machine_that_begins_anew_remembers_nothing_of_the_episode_before(row):
    scenario, stack = load("rough"), resolve("pid")
    fleet = fleet_for(scenario, stack, [1000, 1001])
    length = int(machine.HISTORY_LAST) + 1
    ring = fleet.slots(getattr(machine, row), length, 1)
    for periods in (100, 101, 109):  # wherever in the ring it ends
        fleet.advance(periods)
        assert len(set(ring.tolist())) > 2
        fleet.begin(np.arange(2), scenarios.noise_keys(np.array([1000, 1001], np.uint64)))
        assert len(set(ring.tolist())) == 1
