"""The campaign of kills notices what goes wrong: here a made-up command that does what it is told."""

import sys
from pathlib import Path

import pytest

from kerfgym.experiments.studies.kills import killing as kills
from kerfgym.experiments.studies.kills.commands import COMMANDS, NAME, Command
from kerfgym.experiments.tune.sampling import SAMPLERS

PROGRAM = """
import pathlib, sys, time
kind, run = sys.argv[1], pathlib.Path("runs") / sys.argv[3]
again = (run / ".begun").exists()
run.mkdir(parents=True, exist_ok=True)
(run / ".begun").touch()
time.sleep(0.3)
if again and kind == "refuses":
    sys.exit("it exists")
(run / "figures").write_text("2" if again and kind == "differs" else "1")
(run / "run.json").touch()
if again and kind == "leaves":
    (run / ".table.csv.a1b2c3d4").touch()
else:
    (run / ".begun").unlink()
"""


STEPPED = """
import runpy, sys
from kerfgym.experiments import cli
from kerfgym.experiments.studies.kills import steps
cli.main = lambda: runpy.run_path({program!r}, run_name="__main__")
steps.main()
"""
WRITER = """
import os, pathlib, sys
kind, run = sys.argv[1], pathlib.Path("runs") / sys.argv[3]
run.mkdir(parents=True, exist_ok=True)
(run / ".begun").touch()
if kind == "whole":
    (run / ".part").write_text("1")
    os.replace(run / ".part", run / "figures")
elif not (run / "figures").exists():  # half of them is taken for all
    handle = os.open(run / "figures", os.O_CREAT | os.O_RDWR)
    os.pwrite(handle, b"1", 0)
    os.pwrite(handle, b"2", 1)
(run / "run.json").touch()
os.unlink(run / ".begun")
"""


@pytest.mark.parametrize(("kind", "steps", "bad"), [("whole", 4, 0), ("half", 6, 3)])
def test_a_command_is_killed_before_and_after_each_step_of_writing(tmp_path, monkeypatch, kind, steps, bad):
    program, stepped = tmp_path / "program.py", tmp_path / "stepped.py"
    program.write_text(WRITER, encoding="utf-8")
    stepped.write_text(STEPPED.format(program=str(program)), encoding="utf-8")
    monkeypatch.setattr(kills, "PROGRAM", (sys.executable, str(program)))
    monkeypatch.setattr(kills, "STEPPED", (sys.executable, str(stepped)))
    monkeypatch.setattr(kills, "prepare", lambda folder: None)
    command = Command((kind,), lambda folder: {"figures": (folder / "figures").read_text()})
    met = list(kills.campaign(command, tmp_path / "work", 0, steps=100))
    assert [kill.moment for kill in met] == [f"at step {i + 1} of {steps} of writing" for i in range(steps)]
    assert [kill.trouble for kill in met if kill.trouble] == ["other figures in figures"] * bad
    assert {kill.found for kill in met} == {"begun", "record", "over"}


def test_every_other_moment_takes_the_commands_processes_too(found):
    moments = [kill.moment for kill in found("well", 4)]
    assert ["with its processes" in moment for moment in moments] == [False, True, False, True]


@pytest.fixture
def found(tmp_path, monkeypatch):
    """A function: what the campaign makes of a command of this kind."""
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    monkeypatch.setattr(kills, "PROGRAM", (sys.executable, str(tmp_path / "program.py")))
    monkeypatch.setattr(kills, "prepare", lambda folder: None)

    def of(kind, moments=3):
        command = Command((kind,), lambda folder: {"figures": (folder / "figures").read_text()})
        return list(kills.campaign(command, tmp_path / "work", moments))

    return of


def test_a_command_that_goes_on_well_has_no_bad_end(found):
    kills_ = found("well")
    assert [kill.trouble for kill in kills_] == ["", "", ""]
    assert {kill.found for kill in kills_} <= {"nothing", "begun", "record", "over"}
    moments = [float(kill.moment.split()[1]) for kill in kills_]
    assert moments == sorted(moments)


@pytest.mark.parametrize(
    ("kind", "trouble"),
    [
        ("refuses", "rc 1: ['it exists']"),
        ("differs", "other figures in figures"),
        ("leaves", "left behind: .begun, .table.csv.a1b2c3d4"),
    ],
)
def test_every_bad_end_is_noticed(found, kind, trouble):
    met = [kill for kill in found(kind, 8) if kill.found == "begun"]
    assert met
    assert {kill.trouble for kill in met} == {trouble}


def test_a_command_that_fails_by_itself_is_no_campaign(found, monkeypatch, tmp_path):
    (tmp_path / "program.py").write_text("raise SystemExit('no')", encoding="utf-8")
    with pytest.raises(RuntimeError, match="no"):
        found("well")


def test_every_command_that_goes_on_is_in_the_campaign():
    assert {"benchmark", "tune ppo", "train", "reproduce", "report", *(f"tune {s}" for s in SAMPLERS)} == set(COMMANDS)
    for name, command in COMMANDS.items():
        assert "--name" not in command.words
        assert name.split()[0] == command.words[0]
    assert Path(NAME).parts == (NAME,)
