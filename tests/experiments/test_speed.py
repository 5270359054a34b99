"""``kerfgym speed``: what it times is what it says, and the lane loops are vectorised."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import scenarios, stack
from kerfgym.envs.plant import machine
from kerfgym.experiments import cli, rollout
from kerfgym.experiments.speed import parts, run, startup, tasks
from kerfgym.experiments.speed.picture import picture
from kerfgym.experiments.table import print_speed


@pytest.mark.parametrize(
    ("task", "machines"),
    [
        (lambda: tasks.kernel(3), 3), (lambda: tasks.kernel(70, 2), 70), (lambda: tasks.closed_loop("pid", 5), 5),
        (lambda: tasks.vector(4), 4), (lambda: tasks.with_policy(4), 4), (lambda: tasks.sb3(4), 4),
    ],
)  # fmt: skip
def test_a_task_tells_how_many_machine_steps_it_made(task, machines):
    made = task()
    steps = made.run()
    assert made.machines == machines
    assert steps % machines == 0
    assert made.cost() > 0


def test_the_machine_from_registers_lives_the_same_life_as_in_lanes():
    fleets = [rollout.fleet_for(scenarios.load("wavy"), stack.resolve("pid"), np.arange(40)) for _ in range(2)]
    fleets[0].advance(200)
    fleets[1].run_kernel(parts.registers, 200)
    for name in ("signals", "motion", "drive", "tally", "supervisor"):
        assert fleets[0].get(name, 37) == fleets[1].get(name, 37)


def test_every_stage_of_the_period_is_timed_and_takes_time():
    costs = parts.stage_costs(64)
    assert set(parts.FUNCTIONS) | {"law"} == set(costs)
    assert min(costs.values()) > 0
    staged = {name for name, thing in vars(machine).items() if name.endswith("_all") and callable(thing)}
    rare = {"live_all", "rank_all", "record_all", "replay_all"}  # not in every period
    assert staged - set(parts.FUNCTIONS.values()) == rare


def test_the_lane_loops_are_packed_instructions():
    found = parts.instructions()
    assert set(found) == set(parts.FUNCTIONS)
    for name, (packed, _, bits) in found.items():
        if name != "look-up":  # it gathers
            assert packed > 0, name
            assert bits >= 128, name
    packed, scalar, _ = found["Z axis, 20 substeps"]
    assert packed > 0.8 * scalar  # the scalar ones are the loop for the machines that do not fill a vector


def made_up() -> tuple[pd.DataFrame, dict[str, list[float]]]:
    """Costs of 100 ns for everything but the references."""
    todo = [
        ("single", "Pendulum-v1 unwrapped", 1, 1, 900.0), ("single", "env.step", 1, 1, 200.0),
        *(("kernel", "kernel, step by step", n, 1, 100.0) for n in tasks.SIZES),
        ("kernel", "kernel, step by step", 4096, 2, 125.0),
        *(("roll-out", f"roll-out, {c}", 1024, 1, 100.0) for c in tasks.CONTROLLERS),
        ("vector", "kernel with action and observation", 256, 1, 120.0),
        ("vector", "stable-baselines3 VecEnv.step", 256, 1, 180.0), ("vector", "VectorEnv.step", 256, 1, 200.0),
        ("registers", "from registers, pid", 1024, 1, 350.0),
    ]  # fmt: skip
    costs = pd.DataFrame(todo, columns=["group", "name", "machines", "threads", "ns_per_step"])
    costs = costs.assign(ns_low=costs.ns_per_step * 0.9, ns_high=costs.ns_per_step * 1.1, rounds=5)
    costs["times_pendulum"] = 900.0 / costs.ns_per_step
    costs["each"] = [[x, 2.0 * x, 3.0 * x] for x in costs.ns_per_step]  # a machine that slows down: no ratio does
    start = {name: [0.3, 0.2, 0.4] for name in (*startup.PROGRAMS, *startup.COLD)}
    return costs, start


def test_ratios_are_quotients_of_the_measured_costs_and_say_whether_a_promise_is_held():
    ratios = run.ratios(*made_up(), {"KB per machine, block": 4.5}).set_index("ratio")
    expected = {
        "env.step × Pendulum-v1 unwrapped": (4.5, 1.0), "roll-out of 1024, one thread × Pendulum-v1": (9.0, 0.0),
        "lanes × the same machine from registers": (3.5, 0.0), "two threads ÷ one, per CPU-second": (0.8, 0.0),
        "slowest law ÷ open loop, roll-out of 1024": (1.0, 1.0),
        "stable-baselines3 VecEnv ÷ kernel, 256, time": (1.8, 0.0),
        "stable-baselines3 VecEnv ÷ kernel with action and observation, 256, time": (1.5, 1.0),
        "import kerfgym ÷ import gymnasium": (1.0, 1.0), "first step warm, CPU-s": (0.3, 1.0),
        "KB per machine, block": (4.5, 0.0),
    }  # fmt: skip
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
        "kernel, step by step", "kernel with action and observation", "VectorEnv.step", "stable-baselines3 VecEnv.step",
    ]  # fmt: skip
    assert [t.get_text() for t in axes.texts] == ["Pendulum-v1 unwrapped: 900 ns", "env.step: 200 ns"]
    assert "ns" in axes.get_ylabel()


def tables() -> dict:
    costs, start = made_up()
    stages = pd.DataFrame({"stage": list(parts.STAGES), "ns": 10.0, "share": 0.1})
    stages = stages.assign(packed=5.0, scalar=4.0, bits=512.0)
    stages.loc[stages.stage == "law", ["packed", "scalar", "bits"]] = np.nan
    began = [{"program": n, "cpu_seconds": 0.3, "low": 0.2, "high": 0.4} for n in start]
    return {
        "speed": costs, "stages": stages, "memory": run.memory(), "startup": pd.DataFrame(began),
        "ratios": run.ratios(costs, start, {}),
    }  # fmt: skip


def test_the_tables_are_printed_whole(capsys):
    print_speed(tables())
    shown = capsys.readouterr().out
    for words in ("× Pendulum-v1", "4.50", "Z axis, 20 substeps", "0.50", "512 bit", "kerfgym list", "not measured"):
        assert words in shown


def test_a_machine_takes_no_more_than_4_kb_beside_the_tables():
    block = run.memory().set_index("what").bytes["machine"]
    assert machine.ROWS * 8 < block <= 4096


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

    def quick(folder, rounds, train, torch_threads, progress):
        progress("at work")
        asked.update(folder=folder, rounds=rounds, train=train, torch_threads=torch_threads)
        return tables()

    monkeypatch.setattr(run, "speed", quick)
    cli.main(["speed", "--rounds", "2", "--name", "quick", "--no-train", "--torch-threads", "2"])
    assert asked == {"folder": Path("runs") / "quick", "rounds": 2, "train": False, "torch_threads": 2}
    assert capsys.readouterr().out.rstrip().endswith("runs/quick")


@pytest.mark.parametrize("words", [["--rounds", "0"], ["--torch-threads", "0"]])
def test_nothing_can_be_measured_in_no_rounds_or_with_no_threads(words, capsys):
    with pytest.raises(SystemExit):
        cli.main(["speed", *words])
    assert f"{words[0]} 0 is out of range; at least 1" in capsys.readouterr().err
