"""``kerfgym speed``: what it times is what it says, and the lane loops are vectorised."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.deck import Deck
from kerfgym.envs.plant import machine
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.experiments import cli
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.report.terminal import print_speed
from kerfgym.experiments.speed import kernel_parts, ppo, proof, startup, timed
from kerfgym.experiments.speed import timing as run
from kerfgym.experiments.speed.cost_curve import picture
from kerfgym.experiments.speed.proof import NothingDone

TASKS = {
    "kernel": (lambda: timed.kernel(700), 700),
    "kernel, two threads": (lambda: timed.kernel(700, 2), 700),
    "roll-out": (lambda: timed.closed_loop("pid", 500), 500),
    "open loop": (lambda: timed.closed_loop("idle"), 1024),
    "registers": (lambda: timed.from_registers(40), 40),
    "vector": (lambda: timed.vector(400), 400),
    "batch": (lambda: timed.with_policy(400), 400),
    "sb3": (lambda: timed.sb3(400), 400),
    "env": (timed.single, 1),
    "job": (timed.job_step, 1),
    "jobs": (lambda: timed.job_vector(300), 300),
}


@pytest.mark.parametrize("kind", TASKS)
def test_a_task_tells_how_many_machine_steps_it_made(kind):
    task, machines = TASKS[kind]
    made = task()
    made.prepare()
    before = made.lived()
    steps = made.run()
    assert made.machines == machines
    assert made.lived().clock - before.clock == steps / machines
    for _ in range(2):
        assert made.cost() > 0


def test_references_prove_their_steps_too():
    (pendulum, *_), numpy = list(timed.references()), timed.oracle(8)
    assert pendulum.cost() > 0
    assert numpy is not None
    assert numpy.cost() > 0
    for made in (pendulum, numpy):
        with pytest.raises(NothingDone, match=re.escape(f"'{made.title}' is no measurement")):
            replace(made, run=lambda made=made: 3 * made.machines).cost()


def test_no_machine_of_a_timed_roll_out_has_crashed():
    for controller in timed.CONTROLLERS:
        fleet = timed._fleet(256, controller)
        fleet.advance(400)
        assert not fleet.column("tally.collided").any(), controller


# ----------------------------------------------------------------------------- what has not been done is not timed


@pytest.mark.parametrize("kind", TASKS)
def test_a_task_that_does_nothing_is_no_measurement(kind):
    made = TASKS[kind][0]()
    with pytest.raises(NothingDone, match=re.escape(f"'{made.title}' is no measurement: 10 periods")):
        replace(made, run=lambda: 10 * made.machines).cost()


@pytest.mark.parametrize("kind", ["kernel", "roll-out", "vector", "env", "jobs"])
def test_a_clock_that_goes_on_alone_is_no_measurement(kind):
    """The machines' own counts tell: only the deck's tick moves."""
    made = TASKS[kind][0]()

    def run():
        nonlocal ahead
        ahead += 10
        return 10 * made.machines

    ahead, lived = 0, made.lived
    moved = replace(made, run=run, lived=lambda: lived()._replace(clock=lived().clock + ahead))
    with pytest.raises(NothingDone, match="machine 0 counted 0"):
        moved.cost()


def test_one_machine_that_stands_still_is_found():
    fleet = timed._fleet(40, "pid")

    def run():
        kept = fleet._view[1, :, 3].copy()
        fleet.advance(10)
        fleet._view[1, :, 3] = kept
        return 400

    made = timed.Task("kernel", "35 stands still", 40, 1, run, lambda: proof.of_fleet(fleet))
    with pytest.raises(NothingDone, match="machine 35 counted 0"):
        made.cost()
    before = proof.of_fleet(fleet)
    fleet.advance(10)
    after = proof.of_fleet(fleet)
    state = after.state.copy()
    state[35] = before.state[35]
    with pytest.raises(NothingDone, match="machine 35 is in the state"):
        proof.check("35 counts only", before, after._replace(state=state), 10)
    state[35] = np.nan
    with pytest.raises(NothingDone, match="machine 35 is not finite"):
        proof.check("35 is broken", before, after._replace(state=state), 10)


def test_machines_whose_episodes_end_meanwhile_are_no_error_and_their_steps_count():
    made = timed.vector(300)  # 200 steps a run, of episodes of 3000
    for _ in range(16):
        assert made.cost() > 0


def test_a_stage_that_does_nothing_is_no_measurement(monkeypatch):
    monkeypatch.setitem(kernel_parts.STAGES, "look-up", lambda deck: None)
    with pytest.raises(NothingDone, match="stage 'look-up' is no measurement: it left machine 0 as it was"):
        kernel_parts.stage_costs(40)


def test_training_without_machines_is_no_measurement(monkeypatch):
    monkeypatch.setattr(ppo, "MACHINES", 4)
    monkeypatch.setattr(ppo, "SETTINGS", {"n_steps": 8, "batch_size": 32, "n_epochs": 1})
    share, rate = ppo.share()
    assert 0.0 < share < 1.0
    assert rate > 0.0
    monkeypatch.setattr(Fleet, "stepper", lambda fleet, steps=1: lambda: None)
    with pytest.raises(NothingDone, match="'training PPO' is no measurement: 24 periods were timed"):
        ppo.share()


def test_programs_that_fail_or_compile_nothing_are_no_measurement(tmp_path):
    with pytest.raises(NothingDone, match=r"'a program' is no measurement: .* status 1: ValueError: so it is"):
        startup._seconds("raise ValueError('so it is')")
    with pytest.raises(NothingDone, match="nothing was compiled into the empty cache"):
        startup._seconds("print(1.0)", str(tmp_path))


def freed(fleet, steps=1):
    """What ``Fleet.stepper`` once gave: the kernel on memory that has become somebody else's, here zeros."""
    return machine.advance.bound(Deck(machine.Entries))


@pytest.mark.parametrize("broken", [freed, lambda fleet, steps=1: lambda: None])
def test_the_command_fails_loudly_when_a_task_has_not_moved_its_machines(broken, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run, "_all_tasks", lambda machine: [timed.closed_loop("pid", 64), timed.kernel(64)])
    monkeypatch.setattr(Fleet, "stepper", broken)
    with pytest.raises(SystemExit) as stopped:
        cli.main(["speed", "--rounds", "1", "--name", "broken", "--no-train"])
    assert re.fullmatch(
        "kerfgym: error: 'kernel, step by step, N = 64, threads: 1' is no measurement: 937 periods were timed, but the "
        "clock went on by 0",
        str(stopped.value.code),
    )
    assert "what is promised" not in capsys.readouterr().out
    assert not list(tmp_path.glob("runs/broken/*.csv"))


def test_the_machine_from_registers_lives_the_same_life_as_in_lanes():
    fleets = [rollout.fleet_for(scenarios.load("wavy"), stack.resolve("pid"), np.arange(40)) for _ in range(2)]
    fleets[0].advance(200)
    fleets[1].run_kernel(kernel_parts.registers, 200)
    for name in ("signals", "motion", "drive", "tally", "supervisor"):
        assert fleets[0].get(name, 37) == fleets[1].get(name, 37)


def test_every_stage_of_the_period_is_timed_and_takes_time():
    costs = kernel_parts.stage_costs(64)
    assert set(kernel_parts.FUNCTIONS) | {"law"} == set(costs)
    assert min(costs.values()) > 0
    staged = {name for name, thing in vars(machine).items() if name.endswith("_all") and callable(thing)}
    rare = {"live_all", "rank_all", "record_all", "replay_all", "shake_all", "pass_on_all", "delay_all"}  # not always
    assert staged - set(kernel_parts.FUNCTIONS.values()) == rare


def test_the_lane_loops_are_packed_instructions():
    found = kernel_parts.instructions()
    assert set(found) == set(kernel_parts.FUNCTIONS)
    for name, (packed, _, bits) in found.items():
        if name != "look-up":  # it gathers
            assert packed > 0, name
            assert bits >= 128, name
    packed, scalar, _ = found["Z axis, 20 substeps"]
    assert packed > 0.8 * scalar  # the scalar ones are the loop for the machines that do not fill a vector


def made_up() -> tuple[pd.DataFrame, dict[str, list[float]]]:
    """Costs of 100 ns for everything but the references."""
    todo = [
        ("single", "Pendulum-v1 unwrapped", 1, 1, 900.0),
        ("single", "env.step", 1, 1, 200.0),
        *(("kernel", "kernel, step by step", n, 1, 100.0) for n in timed.SIZES),
        ("kernel", "kernel, step by step", 4096, 2, 125.0),
        *(("roll-out", f"roll-out, {c}", 1024, 1, 100.0) for c in timed.CONTROLLERS),
        ("vector", "kernel with action and observation", 256, 1, 120.0),
        ("vector", "stable-baselines3 VecEnv.step", 256, 1, 180.0),
        ("vector", "VectorEnv.step", 256, 1, 200.0),
        ("registers", "from registers, pid", 1024, 1, 350.0),
    ]
    costs = pd.DataFrame(todo, columns=["group", "name", "machines", "threads", "ns_per_step"])
    costs = costs.assign(ns_low=costs.ns_per_step * 0.9, ns_high=costs.ns_per_step * 1.1, rounds=5)
    costs["times_pendulum"] = 900.0 / costs.ns_per_step
    costs["each"] = [[x, 2.0 * x, 3.0 * x] for x in costs.ns_per_step]  # a machine that slows down: no ratio does
    start = {name: [0.3, 0.2, 0.4] for name in (*startup.PROGRAMS, *startup.COLD)}
    return costs, start


def test_ratios_are_quotients_of_the_measured_costs_and_say_whether_a_promise_is_held():
    ratios = run.ratios(*made_up(), {"KB per machine, block": 5.0}).set_index("ratio")
    expected = {
        "env.step × Pendulum-v1 unwrapped": (4.5, 1.0),
        "roll-out of 1024, one thread × Pendulum-v1": (9.0, 0.0),
        "lanes × the same machine from registers": (3.5, 0.0),
        "two threads ÷ one, per CPU-second": (0.8, 0.0),
        "slowest law ÷ open loop, roll-out of 1024": (1.0, 1.0),
        "stable-baselines3 VecEnv ÷ kernel, 256, time": (1.8, 0.0),
        "stable-baselines3 VecEnv ÷ kernel with action and observation, 256, time": (1.5, 1.0),
        "import kerfgym ÷ import gymnasium": (1.0, 1.0),
        "first step warm, CPU-s": (0.3, 1.0),
        "KB per machine, block": (5.0, 0.0),
    }
    for name, (value, held) in expected.items():
        assert ratios.measured[name] == pytest.approx(value), name
        assert ratios.held[name] == held, name
    for name in ("kernel of 4096 × plain NumPy model", "env.step × HalfCheetah-v5 unwrapped"):
        assert np.isnan(ratios.measured[name])  # what could not be measured is not said to be held
        assert np.isnan(ratios.held[name])


def test_the_picture_has_a_curve_for_each_way_of_stepping_and_a_level_for_each_reference():
    axes = picture(made_up()[0]).axes[0]
    legend = [text.get_text() for text in axes.get_legend().get_texts()]
    assert legend == [
        "kernel, step by step",
        "kernel with action and observation",
        "VectorEnv.step",
        "stable-baselines3 VecEnv.step",
    ]
    assert [t.get_text() for t in axes.texts] == ["Pendulum-v1 unwrapped: 900 ns", "env.step: 200 ns"]
    assert "ns" in axes.get_ylabel()


def tables() -> dict:
    costs, start = made_up()
    stages = pd.DataFrame({"stage": list(kernel_parts.STAGES), "ns": 10.0, "share": 0.1})
    stages = stages.assign(packed=5.0, scalar=4.0, bits=512.0)
    stages.loc[stages.stage == "law", ["packed", "scalar", "bits"]] = np.nan
    began = [{"program": n, "cpu_seconds": 0.3, "low": 0.2, "high": 0.4} for n in start]
    return {
        "speed": costs,
        "stages": stages,
        "memory": run.memory(),
        "startup": pd.DataFrame(began),
        "ratios": run.ratios(costs, start, {}),
    }


def test_the_tables_are_printed_whole(capsys):
    print_speed(tables())
    shown = capsys.readouterr().out
    for words in ("× Pendulum-v1", "4.50", "Z axis, 20 substeps", "0.50", "512 bit", "kerfgym list", "not measured"):
        assert words in shown


def test_a_machine_takes_no_more_than_4_and_a_half_kb_beside_the_tables():
    block = run.memory().set_index("what").bytes["machine"]
    assert machine.ROWS * 8 < block <= 4608


def test_programs_of_the_start_up_give_their_cpu_time():
    assert 0.0 < startup._seconds(startup.PROGRAMS["import kerfgym"]) < 60.0


def test_an_empty_cache_is_filled_where_it_is_asked_for(tmp_path):
    code = (
        "from kerfgym.envs.plant import idle; from kerfgym.envs.plant.controller import make_law, stage_of;"
        "from kerfgym.envs.plant import machine; stage_of(make_law(idle, 'idle'), machine.LAW_PLACES); print(1.0)"
    )
    assert startup._seconds(code, str(tmp_path / "cache")) == 1.0
    (file,) = (tmp_path / "cache").iterdir()
    assert file.name.startswith("controller._stage.idle.")


def test_the_command_writes_its_folder_and_prints_where_it_is(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    asked = {}

    def quick(folder, rounds, train, torch_threads, progress, machine):
        progress("at work")
        asked.update(folder=folder, rounds=rounds, train=train, torch_threads=torch_threads, machine=machine)
        return tables()

    monkeypatch.setattr(run, "speed", quick)
    cli.main(["speed", "--rounds", "2", "--name", "quick", "--no-train", "--torch-threads", "2"])
    assert asked.pop("machine") is None
    assert asked == {"folder": Path("runs") / "quick", "rounds": 2, "train": False, "torch_threads": 2}
    assert capsys.readouterr().out.rstrip().endswith("runs/quick")


@pytest.mark.parametrize("words", [["--rounds", "0"], ["--torch-threads", "0"]])
def test_nothing_can_be_measured_in_no_rounds_or_with_no_threads(words, capsys):
    with pytest.raises(SystemExit):
        cli.main(["speed", *words])
    assert f"{words[0]} 0 is out of range; at least 1" in capsys.readouterr().err
