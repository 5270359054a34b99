"""Commands on a machine of one's own and on suites in folders: what they run, and what their results say of it."""

import json
import math
import tomllib

import numpy as np
import pytest
from matplotlib.figure import Figure

from kerfgym.agents import settings as presets
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.scenarios import machines
from kerfgym.experiments.cli import main
from kerfgym.experiments.measure import grids, plants, rollout, stability
from kerfgym.experiments.render import explained_picture
from kerfgym.experiments.speed import timed
from kerfgym.experiments.train.held_out import cut_by
from kerfgym.experiments.train.training import trained_in

NEW = ["machine", "new", "mine.toml", "--set", "axis.bandwidth=25", "--set", "axis.dead_time=0.004"]
NEW += ["--set", "head.bore=1.5", "--set", "head.noise={ log_uniform = [2e-3, 1e-2] }"]


@pytest.fixture
def workplace(here, capsys):
    """A folder with the slow machine and a suite of one's own, in which there is a short and a shorter scenario."""
    main(NEW)
    own = here / "my_suite"
    own.mkdir()
    for name, seconds in (("short", 0.5), ("shorter", 0.4)):
        text = f'name = "{name}"\nduration = {seconds}\nsettle = 0.1\nset_height = 1.0\n[sheet]\ntilt = 0.003\n'
        (own / f"{name}.toml").write_text(text, encoding="utf-8")
    capsys.readouterr()
    return here


def record(folder):
    return json.loads((folder / "run.json").read_text(encoding="utf-8"))


def refused(words, capsys):
    with pytest.raises(SystemExit):
        main(words)
    return capsys.readouterr().err


def test_a_machine_is_made_checked_and_shown(workplace, capsys):
    machine = machines.load("mine.toml")
    assert (machine.axis.bandwidth, machine.axis.dead_time, machine.head.bore) == (25.0, 0.004, 1.5)
    assert machine.summary.startswith("begun as standard, with head.noise")
    main(["machine", "check", "mine.toml", "standard"])
    said = capsys.readouterr().out
    assert f"mine.toml: machine 'mine' ({machine.digest}) is good; 4 numbers" in said
    assert "standard: machine 'standard'" in said
    main(["machine", "show", "mine.toml"])
    said = capsys.readouterr().out
    assert "axis.dead_time" in said
    assert "axis.zeta" not in said
    main(["machine", "list"])
    listed = capsys.readouterr().out
    assert all(f"{name} " in listed for name in machines.presets())
    main(["machine", "new", "soft.toml", "--like", "heavy-head"])
    assert machines.load("soft.toml").digest == machines.load("heavy-head").digest


def test_a_machine_without_a_number_of_its_own_says_so(here, capsys):
    main(["machine", "new", "mine.toml"])
    for action in ("check", "show"):
        main(["machine", action, "mine.toml"])
        assert "all numbers are the standard machine's" in capsys.readouterr().out
    main(["machine", "new", "one.toml", "--set", "axis.bandwidth=25"])
    main(["machine", "check", "one.toml"])
    assert "; 1 number is not the standard machine's" in capsys.readouterr().out


def test_what_is_hardly_meant_is_told_by_check(workplace, capsys):
    main(["machine", "new", "late.toml", "--set", "axis.dead_time=0.02", "--set", "axis.bandwidth=100"])
    main(["machine", "check", "late.toml"])
    said = capsys.readouterr().out
    assert "dead time and latency are 20.5 ms: gradients (train gradient) stop at 6 ms" in said
    assert "are longer than 1/bandwidth of the drive, 10 ms" in said


def test_bad_words_of_machine_are_refused(workplace, capsys):
    assert "unknown action 'chekc'; did you mean 'check'?" in refused(["machine", "chekc"], capsys)
    assert "'mine.toml' exists; --overwrite replaces it" in refused(["machine", "new", "mine.toml"], capsys)
    assert "new takes one file to write" in refused(["machine", "new", "mine"], capsys)
    assert "unknown table 'axes'; did you mean 'axis'?" in refused(
        ["machine", "new", "x.toml", "--set", "axes.zeta=1"], capsys
    )
    assert "unknown key 'axis.zta'; did you mean 'zeta'?" in refused(
        ["machine", "new", "x.toml", "--set", "axis.zta=1"], capsys
    )
    for words, said in (
        ("axis.zeta", "--set axis.zeta: not of the form key=value, as in axis.bandwidth=25"),
        ("bandwidth=25", "unknown key 'bandwidth'; did you mean 'axis.bandwidth'?"),
    ):
        assert said in refused(["machine", "new", "x.toml", "--set", words], capsys)
    assert "no machine 'mine'; did you mean the file 'mine.toml'?" in refused(["machine", "show", "mine"], capsys)
    assert "check takes machines" in refused(["machine", "check"], capsys)
    for words in (["benchmark"], ["blame"], ["render", "x.png"], ["tune"], ["train", "ppo"], ["speed"]):
        assert "unknown machine 'moden'; did you mean 'modern'?" in refused([*words, "--machine", "moden"], capsys)


def test_a_benchmark_on_a_machine_runs_a_folder_and_says_on_what(workplace, capsys):
    words = ["-c", "xi2023-tuned:law.kv=20", "--suite", "my_suite/", "--machine", "mine.toml", "--seeds", "2"]
    main(["benchmark", *words, "--no-ms", "--no-cost", "--no-blame", "--jobs", "1", "--name", "first"])
    machine, folder = machines.load("mine.toml"), workplace / "runs" / "first"
    assert f"Machine: mine, {machine.summary} (machine.toml, {machine.digest})." in capsys.readouterr().out
    (grid,) = record(folder)["grids"].values()
    assert list(record(folder)["grids"]) == ["my_suite"]
    assert grid["cut_by"] == {**machine.record, "replaces": []}
    assert machines.load(folder / "machine.toml") == machine
    stored = scenarios.read(folder / "scenarios" / "short.toml")
    assert stored == machines.put_on(scenarios.suite("my_suite")["short"], machine)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert f"Machine: mine, {machine.summary}" in page
    assert "machine mine" in (folder / "summary.md").read_text(encoding="utf-8")
    main(["report", "first"])
    assert "Machine: mine" in capsys.readouterr().out


def test_what_a_suite_says_of_another_machine_is_told(workplace):
    machine = machines.load("mine.toml")
    (grid,) = grids.plan(["ood"], ["pid"], machine=machine, seeds=1)
    assert all(s.axis == machine.axis and s.cut_by == "mine" for s in grid.scenarios)
    assert "machine 'mine' replaces what late-flutter, late-rough say of axis.dead_time" in grids.planning([grid])


def test_a_search_on_a_machine_over_scenarios_or_a_folder_says_so(workplace, capsys):
    machine = machines.load("mine.toml")
    usual = ["tune", "law.kv", "-c", "xi2023-tuned", "--ms", "inf", "--seeds", "1", "--trials", "2", "--threads", "1"]
    main([*usual, "--suite", "my_suite", "--machine", "mine.toml", "--name", "t1"])
    told = tomllib.loads((workplace / "runs/t1/tuned.toml").read_text(encoding="utf-8"))["provenance"]
    assert (told["suite"], told["machine"]) == ("my_suite-1", machine.record)
    assert record(workplace / "runs/t1")["cut_by"] == machine.record
    assert machines.load(workplace / "runs/t1/machine.toml") == machine
    assert "suite my_suite · machine mine" in " ".join(capsys.readouterr().out.split())
    main([*usual, "-s", "my_suite/short.toml", "-s", "flat", "--name", "t2"])
    told = tomllib.loads((workplace / "runs/t2/tuned.toml").read_text(encoding="utf-8"))["provenance"]
    assert told["suite"] == "short, flat"
    assert "machine" not in told


def test_a_training_in_a_folder_on_a_machine_keeps_all_its_numbers(workplace):
    machine = machines.load("mine.toml")
    more = trained_in(["my_suite"], ["wavy"], machine)
    assert more["environment.scenario"] == [str(workplace / "my_suite"), "wavy"] == more["evaluation.scenario"]
    settings = presets.preset("ppo", "kerfgym/HeightFollowing-v0", more)
    assert cut_by(settings) == machine
    assert cut_by(presets.preset("ppo", "kerfgym/HeightFollowing-v0", {})) is None
    assert trained_in([], [], None) == {}
    with pytest.raises(InvalidInput, match="unknown scenario 'wavi'"):
        trained_in([], ["wavi"], None)


def test_a_policy_says_on_which_machine_it_was_trained(workplace):
    few = {"environment.num_envs": 2, "environment.max_steps": 50, "algorithm.n_steps": 25, "algorithm.batch_size": 25}
    few |= {"evaluation.episodes": 2, "evaluation.every": 100, "checkpoint.every": 100}
    words = [word for key, value in few.items() for word in ("--set", f"{key}={value}")]
    words += ["--suite", "my_suite", "--machine", "mine.toml"]
    main(["train", "ppo", "--steps", "100", *words, "--no-ms", "--name", "p"])
    machine, folder = machines.load("mine.toml"), workplace / "runs" / "p"
    document = json.loads((folder / "policy" / "policy.json").read_text(encoding="utf-8"))
    assert document["provenance"]["machine"] == machine.record
    assert record(folder)["cut_by"] == machine.record
    assert (
        tomllib.loads((folder / "settings.toml").read_text(encoding="utf-8"))["environment"]["machine"]
        == machine.tables
    )


def test_trainings_of_several_seeds_are_compared_on_their_machine(workplace, capsys):
    """The base against roll-outs of its own."""
    few = {"environment.num_envs": 2, "environment.max_steps": 50, "algorithm.n_steps": 25, "algorithm.batch_size": 25}
    few |= {"evaluation.episodes": 2, "evaluation.every": 100, "checkpoint.every": 100}
    words = [word for key, value in few.items() for word in ("--set", f"{key}={value}")]
    words += ["--suite", "my_suite", "--machine", "mine.toml", "--seeds", "2", "--jobs", "1", "--test-seeds", "3"]
    main(["train", "ppo", "--steps", "100", *words, "--no-ms", "--name", "q"])
    machine, folder = machines.load("mine.toml"), workplace / "runs" / "q"
    assert "3 test seeds a scenario on machine mine, 95 %" in " ".join(capsys.readouterr().out.split())
    for place in (folder, folder / "seed-0", folder / "seed-1"):
        assert record(place)["cut_by"] == machine.record
    scores = {}
    for on in (machine, machines.load("standard")):
        cases = [machines.put_on(case, on) for case in scenarios.suite("my_suite").values()]
        runs = [rollout.roll(case, stacks.resolve("self-tuning"), range(1000, 1003)) for case in cases]
        errors = [run["gap"][case.settle_steps :] - run.set_height for run, case in zip(runs, cases, strict=True)]
        scores[on.name] = 1e3 * math.exp(np.mean([0.5 * math.log(np.mean(each**2)) for each in errors]))
    found = record(folder)["test"]
    assert found["base"] == "self-tuning"
    assert found["controllers"]["self-tuning"]["score"] == pytest.approx(scores["mine"], rel=1e-4)
    assert scores["mine"] > 1.1 * scores["standard"]


def test_a_search_along_slopes_keeps_the_cap_on_the_machine(workplace, monkeypatch):
    monkeypatch.setattr("kerfgym.experiments.tune.outcome.TEST_SEEDS", 2)
    words = ["tune", "law.kv", "-c", "xi2023-tuned:law.kv=20", "--gradient", "--machine", "mine.toml", "--suite"]
    main([*words, "my_suite", "--seeds", "1", "--trials", "6", "--threads", "1", "--name", "g"])
    machine, found = machines.load("mine.toml"), workplace / "runs/g/tuned.toml"
    told = tomllib.loads(found.read_text(encoding="utf-8"))["provenance"]
    assert told["machine"] == machine.record
    assert told["test"]["rms_true"] < told["test_before"]["rms_true"]
    tuned = stacks.resolve(str(found))
    mine = plants.of(machines.put_on(scenarios.load("wavy"), machine))
    peak = stability.sensitivity(tuned, machine=mine).peak
    assert told["ms"] == pytest.approx(peak, rel=1e-3)
    assert stability.sensitivity(tuned).peak < 0.95 * peak <= 1.9


def test_the_actions_of_a_policy_are_drawn_on_the_machine(workplace, monkeypatch, capsys):
    """Errors against a roll-out of their own."""
    drawn, draw = [], explained_picture.draw

    def kept(found, *words):
        drawn.append((*found, draw(found, *words)))
        return Figure()

    monkeypatch.setattr(explained_picture, "draw", kept)
    policy = "height-following-gradient"
    main(["render", "a.png", "--explain", policy, "-s", "ood/late-rough", "--machine", "mine.toml"])
    ((found, figure),) = drawn
    case = machines.put_on(scenarios.load("ood/late-rough"), machines.load("mine.toml"))
    run = rollout.roll(case, stacks.resolve(policy), [1000])
    error = np.where(run["scored"][:, 0] > 0.5, 1e3 * (run["gap"][:, 0].astype(float) - run.set_height[0]), np.nan)
    assert found.error == pytest.approx(error, abs=1e-9, nan_ok=True)
    assert any("Machine mine, seed 1000" in text.get_text() for text in figure.texts)
    assert "machine 'mine' replaces what late-rough says of axis.dead_time" in " ".join(capsys.readouterr().err.split())


def test_blame_and_films_are_of_the_machine(workplace):
    short = ["-c", "xi2023-tuned:law.kv=20", "-s", "my_suite/short.toml", "--machine", "mine.toml"]
    main(["blame", *short, "--seeds", "1", "--stage", "sensor", "--threads", "1", "--name", "b"])
    assert record(workplace / "runs/b")["cut_by"]["name"] == "mine"
    assert machines.load(workplace / "runs/b/machine.toml").name == "mine"
    main(["render", "slow.png", *short, "--seconds", "0.3"])
    main(["render", "usual.png", *short[:-2], "--seconds", "0.3"])
    assert (workplace / "slow.png").read_bytes() != (workplace / "usual.png").read_bytes()
    main(["render", "plan.png", "--plan", "square", "--machine", "modern"])
    assert (workplace / "plan.png").is_file()


def test_a_part_that_is_larger_than_the_machine_is_refused(workplace, capsys):
    main(["machine", "new", "small.toml", "--set", "gantry.travel_x=20"])
    assert "travel" in refused(["render", "plan.png", "--plan", "square", "--machine", "small.toml"], capsys)


def test_speed_times_the_machine(workplace):
    machine = machines.load("mine.toml")
    fleet = timed._fleet(4, "idle", machine=machine)
    assert fleet.column("z.omega") == pytest.approx(157.08, rel=1e-4)
