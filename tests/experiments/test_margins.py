"""Margins by simulation against python-control's of the linear loop, and what they say of loops that are not linear."""

import control
import numpy as np
import pytest
from scipy.linalg import expm

from kerfgym.envs.control.stack import get, python_stack, resolve
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.scenarios import Scenario
from kerfgym.experiments.measure import margins as module
from kerfgym.experiments.measure import population
from kerfgym.experiments.measure.margins import CANDIDATES, DELAYS, GAINS, Bench, in_words, margins
from kerfgym.experiments.measure.plants import of
from kerfgym.experiments.measure.stability import sensitivity

T = PERIOD
CENTRE = 0.125e-3
"""s from the centre of a gate of 0.25 ms to the end of its period."""

PLAIN = {"friction": 0.0, "bristle": 0.0, "stiction": 1.0, "stribeck": 2.0, "latency": 0.0}
"""An axis without friction, with fixed dead times."""

DRAWN = ("axis.bandwidth", "axis.zeta", "axis.dead_time", "axis.resonance")
MACHINE = of(Scenario(name="plain", axis=PLAIN))
CORNERS = [tuple(corner[name] for name in DRAWN) for corner in MACHINE.corners]

NO_FILTER = "xi2023-improved:filter.kind=none"


def axis(bandwidth, zeta, resonance):
    """Head over velocity command, continuous, without dead time: drive of second order, integrator, mode."""
    w, wr = 2 * np.pi * bandwidth, 2 * np.pi * resonance
    drive = control.tf([w**2], [1, 2 * zeta * w, w**2])
    mode = control.tf([wr**2], [1, 2 * 0.05 * wr, wr**2])
    return control.ss(drive * control.tf([1], [1, 0]) * (0.9 + 0.1 * mode))


def loop(kv, corner, window=1):
    """Open loop of a P law on a mean of ``window`` samples: held command, dead time, reading at the gate's centre."""
    bandwidth, zeta, dead_time, resonance = corner
    plant = axis(bandwidth, zeta, resonance)
    size = plant.nstates
    both = np.zeros((size + 1, size + 1))
    both[:size, :size], both[:size, size:] = plant.A, plant.B
    whole, to_gate = expm(both * T), expm(both * (T - CENTRE))
    reading = plant.C @ to_gate[:size]
    held = control.ss(whole[:size, :size], whole[:size, size:], reading[:, :size], reading[:, size:], T)
    periods = round(dead_time / T) + 1  # and the one after which the reading is there
    mean = control.tf(np.ones(window) / window, [1] + [0] * (window - 1), T)
    return kv * control.ss(mean) * control.ss(control.tf([1], [1] + [0] * periods, T)) * held


def linear(kv, window=1, corners=CORNERS):
    """Gain margin and dead-time margin (ms), worst over the corner plants."""
    gains, delays = [], []
    for corner in corners:
        gm, pm, _, _, wg, _ = control.stability_margins(loop(kv, corner, window), returnall=True, method="frd")
        gains.append(min(g for g in gm if g > 1))
        delays.append(min(np.deg2rad(pm) / wg))
    return min(gains), 1e3 * min(delays)


def ideal(bench):
    """Takes friction, backlash, quantisation and limits out of a bench's machines."""
    every = np.arange(bench.fleet.size)
    for name in ("friction", "backlash", "dac", "encoder"):
        bench.fleet.set(f"z.{name}", every, 0.0)
    for name in ("speed", "acceleration", "jerk"):
        bench.fleet.set(f"z.{name}", every, 1e12)
    return bench


pytestmark = pytest.mark.filterwarnings("ignore:Badly conditioned")  # python-control, on the way to a transfer function


@pytest.mark.parametrize(
    ("spec", "kv", "window"),
    [(f"{NO_FILTER},law.kv=50", 50.0, 1), (f"{NO_FILTER},law.kv=150", 150.0, 1), ("xi2023-ma:law.kv=80", 80.0, 5)],
)
def test_the_margins_of_a_p_law_are_those_of_the_linear_loop(spec, kv, window):
    stack = resolve(spec)
    found = ideal(Bench(stack, machine=MACHINE)).measure(stack)
    gain, delay = linear(kv, window)
    assert found.gain == pytest.approx(gain, rel=0.02)
    assert found.delay_ms == pytest.approx(delay, rel=0.04)


def test_the_margins_are_those_of_the_machine_that_is_asked_for():
    """A drive of 25 Hz with 4 ms of dead time, as much as its queue of commands can hold back."""
    stack = resolve(f"{NO_FILTER},law.kv=30")
    machine = of(Scenario(name="slow", axis={**PLAIN, "bandwidth": 25.0, "dead_time": 0.004}))
    found = ideal(Bench(stack, machine=machine)).measure(stack)
    gain, delay = linear(30.0, 1, [(25.0, zeta, 0.004, f) for zeta in (0.6, 1.0) for f in (60.0, 150.0)])
    assert gain < 0.7 * linear(30.0)[0]  # far from the standard machine's
    assert found.gain == pytest.approx(gain, rel=0.02)
    assert found.delay_ms == pytest.approx(delay, rel=0.04)


def test_a_machine_without_dead_time_has_no_margins_and_says_why():
    machine = of(Scenario(name="quick", axis={"dead_time": 0.0005, "latency": 0.0}))
    with pytest.raises(InvalidInput, match="margins need a dead time of at least a control period, 1 ms"):
        Bench(get("pid"), machine=machine)


def some(candidates, monkeypatch):
    """Fewer factors and delays, for controllers that take long."""
    monkeypatch.setattr(module, "CANDIDATES", candidates)


def test_a_faulty_drive_is_a_wrong_gain_to_laws_and_residuals_alike(monkeypatch):
    """Twice the drive under a gain of 40 moves the head as the drive under 80 does; in Python the law is a residual."""
    some(2, monkeypatch)

    class Proportional:
        def reset(self):
            pass

        def control(self, signals):
            return -40.0 * (signals.height - signals.set_height)

    half, twice = resolve(f"{NO_FILTER},law.kv=40"), resolve(f"{NO_FILTER},law.kv=80")
    python = python_stack(Proportional, "p").varied({"filter.kind": "none"})
    heads = []
    for stack, factor in ((half, 2.0), (python, 2.0), (twice, 1.0), (half, 1.0)):
        bench = ideal(Bench(stack, machine=MACHINE))
        seen = recorded(bench, monkeypatch)
        bench.settles(stack, np.array([factor, factor]), np.zeros(2))
        heads.append(seen[0]["head"][:, :16])
    assert heads[0] == pytest.approx(heads[2], abs=1e-6)
    assert heads[1] == pytest.approx(heads[2], abs=1e-6)
    assert np.abs(heads[3] - heads[2]).max() > 0.01


def recorded(bench, monkeypatch):
    """The recordings that a bench makes from now on."""
    seen, run = [], module.rollout.run

    def keep(fleet, *rest):
        record = run(fleet, *rest)
        if fleet is bench.fleet:
            seen.append(record)
        return record

    monkeypatch.setattr(module.rollout, "run", keep)
    return seen


def test_a_fault_of_nothing_changes_nothing(monkeypatch):
    some(1, monkeypatch)
    stack, heads = get("pid"), []
    for faulty in (True, False):
        bench = Bench(stack)
        seen = recorded(bench, monkeypatch)
        if not faulty:
            bench.fleet.deck["finish"] = 0
        bench.settles(stack, np.ones(1), np.zeros(1))
        heads.append(seen[0]["head"])
    assert np.array_equal(*heads)


@pytest.mark.parametrize("delay", [3.0, 4.6])
def test_the_head_begins_to_move_that_much_later(delay, monkeypatch):
    some(1, monkeypatch)
    stack = resolve(f"{NO_FILTER},law.kv=50")
    bench = ideal(Bench(stack, machine=MACHINE))
    every = np.arange(bench.fleet.size)
    seen = recorded(bench, monkeypatch)
    bench.settles(stack, np.ones(1), np.array([delay]))
    corners = len(CORNERS)
    head = seen[0]["head"].astype(float)
    moved = np.abs(head - head[0]) > 1e-5
    on_time, late = moved[:, :corners].argmax(axis=0), moved[:, corners:].argmax(axis=0)
    assert set(late - on_time) <= {int(np.floor(delay)), int(np.ceil(delay))}
    fraction = bench.fleet.column("z.dead_time")[every[corners:]] - bench.dead_time[corners:]
    assert fraction == pytest.approx(delay % 1.0)


def test_a_loop_that_oscillates_has_no_margin_and_one_that_does_nothing_has_every(monkeypatch):
    wild = resolve(f"{NO_FILTER},law.kv=400")
    none = Bench(wild).measure(wild)
    assert (none.gain, none.delay_ms) == (0.0, 0.0)
    idle = get("idle")
    every = Bench(idle).measure(idle)
    assert (every.gain, every.delay_ms) == (np.inf, np.inf)
    assert [in_words(x, 64.0) for x in (0.0, np.inf, np.nan, 3.14159, 31.4159)] == ["none", "> 64", "–", "3.14", "31.4"]


def test_a_relay_swings_on_and_does_not_settle(monkeypatch):
    some(1, monkeypatch)

    class Relay:
        def reset(self):
            pass

        def control(self, signals):
            return -20.0 if signals.height > signals.set_height else 20.0

    stack = python_stack(Relay, "relay").varied({"filter.kind": "none"})
    gains, _ = Bench(stack).settles(stack, np.ones(1), np.zeros(1))
    assert not gains[0]


def test_friction_and_limits_make_the_margins_of_the_machine_its_own():
    """The paper's tuned law: friction damps the structure's resonance a little, and impulses stay harmless."""
    tuned = get("xi2023-tuned")
    friction = of(Scenario(name="rubs", axis={**PLAIN, "friction": 800.0}))
    real, linear_gain = Bench(tuned, machine=friction).measure(tuned), linear(tuned.parameters()["law.kv"].value)[0]
    assert 1.0 < real.gain / linear_gain < 1.15


def test_margins_are_reported_with_the_peak_and_what_they_cost():
    stack = get("pid")
    found, peak = margins(stack, threads=2, machine=MACHINE), sensitivity(stack, machine=MACHINE)
    assert found.ms == pytest.approx(peak.peak)
    assert found.steps == peak.steps + 2 * 2 * CANDIDATES * MACHINE.size * 1800
    assert 1.5 < found.gain < 3.0
    assert 4.0 < found.delay_ms < 12.0


def test_a_bench_used_again_gives_what_a_new_one_gives():
    first, second = resolve("xi2023-ma:filter.window=40"), get("xi2023-improved")
    used = Bench(first)
    used.measure(first)
    assert used.measure(second) == Bench(second, threads=2).measure(second)


def test_the_grids_begin_at_the_loop_as_it_is_and_rise():
    assert len(GAINS) == len(DELAYS) == CANDIDATES
    assert GAINS[0] == 1.0
    assert np.all(np.diff(GAINS) > 0)
    assert np.all(np.diff(DELAYS) > 0)
    assert DELAYS[-1] < module.RING


def test_margins_of_each_machine_are_those_of_its_own_loop():
    """python-control's, machine by machine; and the worst of them is what is told of all."""
    stack = resolve(f"{NO_FILTER},law.kv=90")
    bench = ideal(Bench(stack, machine=MACHINE))
    gains, delays, steps = bench.measure_each(stack)
    for i in range(0, len(CORNERS), 5):
        gain, delay = linear(90.0, corners=[CORNERS[i]])
        assert gains[i] == pytest.approx(gain, rel=0.05), CORNERS[i]
        assert delays[i] == pytest.approx(delay, rel=0.05), CORNERS[i]
    worst = bench.measure(stack)
    assert (gains.min(), delays.min(), steps) == (worst.gain, worst.delay_ms, worst.steps)
    assert gains.max() > 1.2 * gains.min()


def test_a_loop_that_does_not_settle_on_one_machine_has_no_margin_there_alone():
    """By python-control's gain margin at a third of the gain."""
    stack = resolve(f"{NO_FILTER},law.kv=300")
    bench = ideal(Bench(stack, machine=MACHINE))
    gains, delays, _ = bench.measure_each(stack)
    unstable = np.array([100.0 * linear(100.0, corners=[corner])[0] < 300.0 for corner in CORNERS])
    assert 0 < unstable.sum() < len(unstable)
    assert np.array_equal(gains == 0, unstable)
    assert np.array_equal(delays == 0, unstable)


def test_a_population_is_measured_machine_by_machine(monkeypatch):
    """Two machines that a scenario draws have the Ms and the margins that each has alone."""
    monkeypatch.setattr(population, "DRAWN", 8)
    known = {**PLAIN, "zeta": 0.7, "dead_time": 0.001, "resonance": 300.0, "acceleration": 14000.0}
    stack = resolve("xi2023-tuned")
    either = Scenario(name="either", axis={**known, "bandwidth": {"choice": [30.0, 90.0]}})
    found = population.measured(stack, [either])
    alone = {}
    for bandwidth in (30.0, 90.0):
        one = population.measured(stack, [Scenario(name="one", axis={**known, "bandwidth": bandwidth})]).machines
        assert len(one) == 1
        alone[tuple(one.loc[0, ["gain", "delay_ms"]])] = one.loc[0, "ms"]
    peaks = found.machines.groupby(["gain", "delay_ms"])["ms"].agg(["min", "max"])
    assert set(peaks.index) == set(alone)
    assert len(alone) == 2
    for key, peak in alone.items():  # frequencies are set finer about the highest peak of all
        assert peaks.loc[key, "min"] == peaks.loc[key, "max"] == pytest.approx(peak, rel=0.02)
    assert found.ledger.entry()["seeds"] == {"test": "1000-1007"}
    assert found.within(min(alone.values()) * 1.05)[1] == 8
    assert 0 < found.within(min(alone.values()) * 1.05)[0] < 8


def test_a_machine_without_a_period_of_dead_time_has_ms_and_says_why_it_has_no_margins():
    found = population.measured(resolve("pid"), [Scenario(name="quick", axis={"dead_time": 0.0, "latency": 0.0})])
    assert found.machines["ms"].notna().all()
    assert found.machines["gain"].isna().all()
    assert "dead time of at least a control period" in found.reason
