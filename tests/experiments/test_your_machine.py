"""The tutorial of a machine of one's own: its commands, one after the other, with small budgets."""

import re
import shlex
import tomllib

import pandas as pd
import pytest

from kerfgym.envs.scenarios import machines
from kerfgym.experiments import cli
from kerfgym.experiments.identify import drive, posterior
from kerfgym.experiments.manual import docs
from kerfgym.experiments.studies.identified import truth

SMALLER = {
    "tune": ["--trials", "60", "--seeds", "3", "--threads", "1"],
    "benchmark": ["--seeds", "2", "--jobs", "1", "--no-ms", "--no-cost", "--no-blame", "--no-detuned"],
}
"""What the tutorial's commands are run with, over what they say."""


def commands(page):
    """Its lines of shell, as words."""
    text = (docs.FOLDER / page).read_text(encoding="utf-8")
    for block in re.findall(r"^```\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        for line in block.splitlines():
            yield shlex.split(line)


@pytest.fixture
def done(tmp_path, monkeypatch, capsys):
    """A folder in which everything of the tutorial was done, and what was printed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(drive, "STARTS", 1)
    monkeypatch.setattr(posterior, "ROUNDS", 1)
    for words in commands("your-machine.md"):
        assert words[0] == "kerfgym"
        given = SMALLER.get(words[1], [])
        cut = [w for i, w in enumerate(words) if not {w, words[i - 1]} & {g for g in given if g.startswith("--")}]
        cli.main([*cut[1:], *given])
    return tmp_path, capsys.readouterr().out


def test_the_tutorial_leads_from_logs_to_a_controller(done):
    folder, printed = done
    found = tomllib.loads((folder / "mine.toml").read_text(encoding="utf-8"))["axis"]
    true = truth(machines.load(folder / "my_machine.toml"), 0)
    for key in ("bandwidth", "zeta", "dead_time", "acceleration"):
        assert sorted(found[key]["choice"])[50] == pytest.approx(true[key], rel=0.01), key
        assert found[key]["joint"] == "motion"
    assert "The model explains what mine did in its logs." in (folder / "mine.html").read_text(encoding="utf-8")
    tuned = tomllib.loads((folder / "runs/mine/tuned.toml").read_text(encoding="utf-8"))
    assert tuned["provenance"]["machine"]["name"] == "mine"
    assert "mine sheets" in tuned["provenance"]["suite"]
    runs = pd.read_csv(folder / "runs/compared/runs.csv")
    assert len(set(runs["scenario"])) == 2
    both = runs.groupby(["controller", "scenario"])["rms_true"].mean().groupby("controller").prod()
    assert both["runs/mine/tuned.toml"] < both["observer"]
    page = (folder / "runs/mine/tuned.html").read_text(encoding="utf-8")
    assert "<dt>Machine</dt><dd>mine, identified from sweep.csv, rest.csv, motion.csv, follow.csv" in page
    assert "differs from observer in" in (folder / "runs/compared/report.html").read_text(encoding="utf-8")
    assert "axis.bandwidth" in printed
