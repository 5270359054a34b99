"""Exported controllers: code that compiles without a warning, answers as the kernel does, and is never without one."""

import csv
import json
import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import firmware
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import supervisor
from kerfgym.envs.scenarios import machines
from kerfgym.experiments.cli import main
from kerfgym.experiments.export import c_files, exporting, in_loop, processor, vectors
from kerfgym.experiments.measure import rollout
from kerfgym.experiments.results import jobs

COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
FOLLOWERS = [n for n in stacks.names() if stacks.asked(n).slots == "z" and stacks.resolve(n).python is None]

needs_c = pytest.mark.skipif("gcc" not in COMPILERS or not shutil.which("make"), reason="no gcc, or no make")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("exported")


def made(place, name, single=False):
    """The folder of a controller, once."""
    out = place / (name.replace(":", "_").replace(",", "_") + "-float" * single)
    return out if out.exists() else exporting.write(name, out, single)


@needs_c
@pytest.mark.parametrize("name", FOLLOWERS)
def test_every_follower_compiles_without_a_warning(tmp_path, name):
    for single in (False, True):
        code = c_files.of(stacks.resolve(name), single)
        texts = {"controller.h": code.header, "controller.c": code.source, "parameters.h": code.parameters}
        for file, text in texts.items():
            (tmp_path / file).write_text(text, encoding="utf-8")
        for compiler in COMPILERS:
            command = [compiler, *c_files.FLAGS, "-fsyntax-only", "controller.c"]
            done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
            assert (done.returncode, done.stderr) == (0, ""), (name, compiler, single)
        assert not re.search(r"\b(malloc|calloc|realloc|alloca|goto|setjmp)\b", code.source)
        assert single == ("double" not in code.header)


@needs_c
@pytest.mark.parametrize("name", ["pid", "xi2023-tuned:filter.kind=median,filter.window=9", "mpc", "preview-5ms"])
def test_it_answers_as_the_kernel_did_and_scores_the_same(place, name):
    out = made(place, name)
    told = [line for line in exporting.check(out) if "not installed" not in line]
    assert all("largest difference 0 mm/s" in line or line == "cppcheck: nothing found" for line in told)
    mine, seeds = stacks.resolve(name), np.arange(1000, 1003)
    for scenario in map(scenarios.load, ("step", "holes")):
        one = rollout.roll(scenario, mine, seeds)
        other = rollout.roll(scenario, stacks.resolve(str(out)), seeds)
        for channel in ("gap", "head", "command", "mode", "override", "height"):
            assert np.array_equal(one[channel], other[channel], equal_nan=True), (scenario.name, channel)
    assert stacks.resolve(str(out)).information == mine.information


@needs_c
@pytest.mark.parametrize("machine", ["modern", "heavy-head"])
def test_on_other_machines_and_in_many_blocks_it_is_the_same(place, machine):
    mine, other = stacks.resolve("pid"), stacks.resolve(str(made(place, "pid")))
    case = machines.put_on(scenarios.load("spatter-field"), machines.load(machine)).varied(duration=1.0)
    runs = [rollout.roll(case, stack, np.arange(1000, 1070), threads=2) for stack in (mine, other)]
    assert np.array_equal(runs[0]["gap"], runs[1]["gap"], equal_nan=True)


@needs_c
@pytest.mark.parametrize("name", ["contour-square", "cut-square"])
def test_in_a_job_whose_set_height_changes_it_is_the_same(place, name):
    gaps = []
    for z in ("pid", str(made(place, "pid"))):
        team = stacks.team(f"z={z},xy=wu-tuned,process=huang2024-adjusting")
        fleet, _, _ = jobs.roll(scenarios.load(name), team, np.arange(1000, 1002, dtype=np.uint64))
        gaps.append(fleet.column("signals.gap"))
    assert np.array_equal(*gaps)


@needs_c
def test_a_setting_that_the_filter_cannot_have_stays_within_its_ring(place, tmp_path):
    """Settings may be changed between two calls; whoever writes nonsense gets a window of 1 to 64."""
    out = tmp_path / "set"
    shutil.copytree(made(place, "pid"), out)
    fuzz = (out / "fuzz.c").read_text(encoding="utf-8")
    wrong = fuzz.replace(
        "        if ((bits() & 7) != 0) {",
        """\
        controller.settings.filter.kind = any(3.5, 4.0);
        controller.settings.filter.window = any(0.0, 200.0);
        controller.settings.filter.trim = any(0.0, 60.0);
        if ((bits() & 7) != 0) {""",
    )
    assert wrong != fuzz
    (out / "fuzz.c").write_text(wrong, encoding="utf-8")
    done = exporting.made(out, "CC=gcc", "CALLS=100000", "fuzz")
    if "cannot find" in done.stderr:
        pytest.skip("gcc has no sanitizers here")
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-500:]


@needs_c
def test_float_differs_by_little(place):
    out = made(place, "pid", True)
    exporting.check(out)
    seeds = np.arange(1000, 1003)
    for scenario in map(scenarios.load, ("step", "wavy")):
        runs = [rollout.roll(scenario, stacks.resolve(name), seeds) for name in ("pid", str(out))]
        scores = [np.sqrt(np.mean(run.error[run.scored] ** 2)) for run in runs]
        assert scores[1] == pytest.approx(scores[0], rel=5e-3)
        assert not np.array_equal(runs[0]["gap"], runs[1]["gap"])


@needs_c
def test_a_make_that_runs_the_check_has_no_part_in_it(place, monkeypatch):
    monkeypatch.setenv("MAKELEVEL", "1")
    monkeypatch.setenv("MAKEFLAGS", "w")
    assert any("largest difference 0 mm/s" in line for line in exporting.check(made(place, "pid")))


@needs_c
def test_the_check_compares_score_ms_and_margins(place, monkeypatch):
    monkeypatch.setattr(scenarios, "core", lambda suite: ("step",))
    controller = stacks.resolve("pid")
    same = in_loop.compared(controller, stacks.resolve(str(made(place, "pid"))), seeds=2)
    assert same.same
    assert (same.change, same.farthest) == (0.0, 0.0)
    assert same.score[0] > 1.0
    assert same.margins[0] == same.margins[1]
    single = in_loop.compared(controller, stacks.resolve(str(made(place, "pid", True))), seeds=2)
    assert not single.same
    assert 0.0 < abs(single.change) < 5e-3
    assert single.margins[1].ms == pytest.approx(single.margins[0].ms, rel=0.01)
    assert single.margins[1].gain == pytest.approx(single.margins[0].gain, rel=0.02)


@needs_c
@pytest.mark.parametrize("name", ["pid", "self-tuning"])
def test_nothing_undefined_happens_whatever_it_is_given(place, name):
    out = made(place, name)
    done = exporting.made(out, "CC=gcc", "CALLS=60000", "fuzz")
    if "cannot find" in done.stderr:
        pytest.skip("gcc has no sanitizers here")
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-500:]
    assert done.stdout.endswith("60000 calls\n")


@needs_c
def test_who_changes_the_code_fails_the_check(place, tmp_path):
    out = tmp_path / "changed"
    shutil.copytree(made(place, "pid"), out)
    text = (out / "controller.c").read_text(encoding="utf-8")
    wrong = text.replace("params->kp * error + integral", "params->kp * error - integral")
    assert wrong != text
    (out / "controller.c").write_text(wrong, encoding="utf-8")
    with pytest.raises(InvalidInput, match="with gcc: 6000 periods, largest difference"):
        exporting.check(out)
    (out / "controller.c").write_text(text + "}\n", encoding="utf-8")
    with pytest.raises(InvalidInput, match=r"does not compile: .*error"):
        stacks.resolve(str(out))


@needs_c
def test_the_readmes_program_compiles_as_it_stands(place, tmp_path):
    out = made(place, "pid")
    (block,) = re.findall(r"```c\n(.*?)```", (out / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    include, _, rest = block.partition("\n\nstatic Controller follower;\n")
    text = (
        f"{include}\nstatic Controller follower;\n"
        "int tick(double counted, double position, double path_feed, const double *table_frequency,\n"
        "         const double *table_height);\nvoid drive_velocity(double v);\n"
        "int tick(double counted, double position, double path_feed, const double *table_frequency,\n"
        f"         const double *table_height)\n{{\n{rest}return 0;\n}}\n"
    )
    (tmp_path / "main.c").write_text(text, encoding="utf-8")
    command = ["gcc", *c_files.FLAGS, "-Wno-missing-field-initializers", f"-I{out}", "-fsyntax-only", "main.c"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_parameter_sheet_is_what_the_controller_has(place):
    out = made(place, "pid")
    with (out / "parameters.csv").open(encoding="utf-8") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    known = stacks.resolve("pid").parameters()
    assert set(rows) == {name for name in known if not name.startswith("gate.")}
    assert float(rows["law.kp"]["value"]) == pytest.approx(known["law.kp"].value, rel=1e-8)
    assert rows["law.kp"]["unit"] == "1/s"
    assert rows["filter.kind"]["value"] == "anti-impulse"
    header = (out / "parameters.h").read_text(encoding="utf-8")
    assert f".kp = {known['law.kp'].value!r}, /* proportional gain: 1 to 400 1/s */" in header
    about = json.loads((out / "export.json").read_text(encoding="utf-8"))
    assert about["provenance"]["trials"] == stacks.resolve("pid").provenance["trials"]  # budgets stay comparable


def alone(name, rows, tables, change=None):
    """Commands and last state of a follower alone, in Python."""
    stack = stacks.resolve(name)
    parts = firmware.of(stack.law)
    settings, rings = c_files.settings_of(stack, parts), [np.zeros(n) for n in (64, 16, 16)]
    state, law_state, out = firmware.State(), None, []
    for i, row in enumerate(rows.to_dict("records")):
        orders = supervisor.Orders(**{
            k.removeprefix("orders."): bool(v) if k.endswith(("hole_guard", "indexed")) else v
            for k, v in row.items() if k.startswith("orders.")
        })  # fmt: skip
        given = firmware.Input(*(row[k] for k in ("frequency", "encoder", "feed", "place", "lap")), orders)
        given = change(i, given) if change else given
        step = parts.step(settings, state, law_state, given, *rings, *tables[int(row["table"])], np.zeros(0))
        state, law_state, command = step
        out.append(command)
    return np.array(out), state


@pytest.fixture(scope="module")
def told():
    return vectors.of(stacks.resolve("pid"), ["descent"], 250)


def test_one_follower_alone_does_what_the_kernel_does_with_blocks_of_them(told):
    rows, tables = told
    commands, _ = alone("pid", rows, tables)
    assert np.array_equal(commands, rows["command"])
    assert np.ptp(commands) > 10.0


def test_a_count_that_is_no_number_is_contact_and_any_other_input_the_last(told):
    rows, tables = told
    plain, _ = alone("pid", rows, tables)
    for value in (np.nan, -1.0, np.inf, 0.0):
        up, state = alone("pid", rows, tables, lambda i, x, v=value: x._replace(frequency=v) if i == 200 else x)
        assert np.array_equal(up[:200], plain[:200])
        assert state.guard.alarm == supervisor.COLLISION
        assert up[201:].max() > 100.0
    held = [
        alone("pid", rows, tables, lambda i, x, v=v: x._replace(feed=v) if i == 100 else x)[0]
        for v in (np.nan, -np.inf)
    ]
    last = alone("pid", rows, tables, lambda i, x: x._replace(feed=rows["feed"][99]) if i == 100 else x)[0]
    assert all(np.array_equal(each, last) for each in held)


def test_a_law_whose_wish_is_no_number_begins_anew(told, monkeypatch):
    rows, tables = told
    law = stacks.resolve("pid").law
    times, usual = [], law.control

    def control(params, state, signals, tables):
        times.append(signals.fresh)
        after, command = usual(params, state, signals, tables)
        return after, (float("nan") if len(times) == 150 else command)

    monkeypatch.setitem(law.__dict__, "control", control)
    commands, _ = alone("pid", rows, tables)
    assert np.isfinite(commands).all()
    assert [i for i, fresh in enumerate(times) if fresh] == [0, 150]


@pytest.mark.skipif(bool(processor.missing()), reason=f"not installed: {', '.join(processor.missing())}")
@pytest.mark.parametrize("which", processor.PROCESSORS, ids=lambda each: each.name)
def test_an_emulated_processor_answers_alike_within_its_period(place, which):
    for single in (True, False):
        found = processor.ran(made(place, "pid", single), which)
        assert found.calls == 6000
        assert found.difference <= exporting.TOLERANCE["float" if single else "double"]
        assert 500 < found.median <= found.worst < 0.5 * processor.CLOCK * processor.PERIOD
        assert 500 < found.first < found.worst * 3
        assert 200 < found.stack < 8192
        assert found.ram >= (4 if single else 8) * (firmware.SAMPLES + 2 * firmware.HISTORY)  # the rings alone
        assert 4000 < found.flash < 64000


def test_without_an_emulator_it_is_said_why(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    (told,) = processor.told(tmp_path)
    assert told.startswith("on a processor: not tried, arm-none-eabi-gcc, qemu-system-arm")


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["-c", "wu-tuned", "-o", "x"], "drives slot 'xy', not z"),
        (["-c", "height-following-ppo", "-o", "x"], "policies cannot be exported yet"),
        (["-c", "pidd", "-o", "x"], "did you mean 'pid'"),
        ([], "give one of --controller NAME, which is exported, and --check FOLDER"),
        (["--check", "nowhere"], "is not the folder of an export"),
    ],
)
def test_what_cannot_be_exported_is_refused(tmp_path, monkeypatch, capsys, words, why):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["export", *words])
    assert why in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_another_folder_is_never_replaced(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x", encoding="utf-8")
    for more in ([], ["--overwrite"]):
        with pytest.raises(SystemExit):
            main(["export", "-c", "pid", "-o", "mine", *more])
        assert "'mine' " in capsys.readouterr().err
    assert (tmp_path / "mine" / "thesis.tex").exists()


@needs_c
def test_what_c_takes_no_part_in_is_refused_or_left_out(place, tmp_path, monkeypatch, capsys):
    """Its filter and gains are its own: whoever changed the simulator's would change nothing, and not know."""
    out = made(place, "pid")
    monkeypatch.chdir(tmp_path)
    for words, why in (
        (["benchmark", "-c", f"{out}:filter.jump=0.1", "-s", "step"], "its settings are in its parameters.h"),
        (["tune", "read", "-c", str(out), "-s", "step"], "tune the controller that it was exported from"),
        (["blame", "-c", str(out), "-s", "step", "--seeds", "1"], "blame what it was exported from"),
    ):
        with pytest.raises(SystemExit):
            main(words)
        assert why in capsys.readouterr().err, words
    few = ["-s", "step", "--seeds", "2", "--jobs", "1", "--no-ms", "--no-detuned"]
    main(["benchmark", "-c", str(out), "-c", "pid", *few, "--name", "both"])
    runs = pd.read_csv("runs/both/runs.csv").pivot(index="seed", columns="controller", values="rms_true")
    assert np.array_equal(runs["pid"], runs[str(out)])
    (grid,) = json.loads((tmp_path / "runs/both/run.json").read_text(encoding="utf-8"))["grids"].values()
    assert set(grid["decisions"][str(out)].values()) == {None}
    assert grid["decisions"]["pid"]["median_us"] > 0.0
    main(["report", "both"])


def test_a_file_may_not_have_c_run_by_itself(place, tmp_path, monkeypatch):
    out = made(place, "pid")
    monkeypatch.chdir(out.parent)
    (tmp_path / "tuned.toml").write_text(f'controller = "{out.name}"\n[parameters]\n', encoding="utf-8")
    with pytest.raises(InvalidInput, match="that is C code, which would be run"):
        stacks.resolve(str(tmp_path / "tuned.toml"))


def test_the_vectors_have_an_approach_steps_faults_and_no_sheet(place):
    rows = pd.read_csv(made(place, "pid") / "vectors.csv")
    assert list(rows.index[rows["begins"] > 0]) == [0, 1500, 3000, 4500]
    assert rows["command"].abs().max() > 50.0
    assert rows["frequency"].gt(0).all()
    assert rows["orders.hole_guard"].max() == 1.0
