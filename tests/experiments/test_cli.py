"""The command, as a user types it."""

import errno
import json
import os
import resource
import shlex
import subprocess
import sys
from pathlib import Path

import ezdxf
import gymnasium as gym
import imageio.v3 as imageio
import numpy as np
import pandas as pd
import pytest
from PIL import Image

import kerfgym
from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.figures.job_metrics import METRICS as JOB_METRICS
from kerfgym.envs.figures.metrics import METRICS
from kerfgym.experiments.benchmark import benchmarking
from kerfgym.experiments.cli import main

SHORT = 'name = "short"\nsummary = "half a second"\nduration = 0.5\n[sheet]\ntilt = 0.01\n'

OWN = """
class Mine:
    def reset(self):
        self.last = 0.0

    def control(self, signals):
        self.last = -40.0 * (signals.height - signals.set_height)
        return self.last
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The user's folder, with a scenario and a controller of their own."""
    (tmp_path / "short.toml").write_text(SHORT, encoding="utf-8")
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def kerfgym_(folder, *words):
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "kerfgym.experiments.cli", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=280,
        env={**os.environ, "PYTHONIOENCODING": "utf-8", "COLUMNS": "200"},
    )


def refused(capsys, *words):
    """What the command says to bad input."""
    with pytest.raises(SystemExit) as error:
        main(list(words))
    assert error.value.code == 2
    out = capsys.readouterr()
    assert out.err.startswith("kerfgym: error: ")
    assert "Traceback" not in out.err
    return out.err


# --------------------------------------------------------------------------------------------------------------- list


def listed(capsys, *words):
    main(["list", *words])
    return capsys.readouterr().out.splitlines()


def test_list_shows_everything_that_is_registered_a_line_each(capsys):
    lines = listed(capsys)
    first = [line.split()[0] for line in lines if line.startswith("  ")]
    ids = [name for name in gym.registry if name.startswith("kerfgym/")]
    assert ids
    cases = [each for group in scenarios.suites() for each in scenarios.suite(group).values()]
    names = first[len(ids) : len(ids) + len(cases)]
    assert len(set(names)) == len(names)
    assert [scenarios.load(name) for name in names] == cases  # each by the name that -s takes
    assert first == [*ids, *names, *stack.names(), *stack.shelved(), *METRICS, *JOB_METRICS]
    assert all(len(line.split()) > 2 for line in lines if line.startswith("  "))  # a name and what it is


def test_list_shows_one_kind(capsys):
    lines = listed(capsys, "metrics")
    assert lines[0].startswith("metrics:")
    assert [line.split()[0] for line in lines[1:]] == [*METRICS, *JOB_METRICS]


def test_list_says_which_scenarios_make_the_score(capsys):
    core = [line.split()[0].split("/")[-1] for line in listed(capsys, "scenarios") if ", core]" in line]
    assert core == [
        name for suite in scenarios.suites() for name in scenarios.suite(suite) if name in scenarios.core(suite)
    ]


def test_an_unknown_kind_is_answered_with_the_nearest(capsys):
    assert "unknown kind 'metric'; did you mean 'metrics'?" in refused(capsys, "list", "metric")


def test_a_reader_that_has_seen_enough_is_no_error(here):
    process = subprocess.Popen(
        [sys.executable, "-m", "kerfgym.experiments.cli", "list"],
        cwd=here,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "environments:\n"
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait(60) == 141  # as a shell says of a program that a closed pipe has ended


def test_the_version_is_the_packages(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"kerfgym {kerfgym.__version__}\n"


def test_help_tells_of_every_command(capsys):
    with pytest.raises(SystemExit) as error:
        main(["--help"])
    assert error.value.code == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("list", "benchmark", "render"))


# ---------------------------------------------------------------------------------------------------------- benchmark


def test_a_benchmark_from_end_to_end_and_again_with_the_same_figures(here, capsys, monkeypatch):
    words = shlex.split(
        "benchmark -c xi2023-improved -c mine.py:Mine -s short.toml -s wavy --seeds 4 "
        "--jobs 1 --no-ms --no-blame --no-detuned --name first"
    )
    done = kerfgym_(here, *words)
    assert done.returncode == 0, done.stderr
    assert "xi2023-improved" in done.stdout
    assert "mine.py:Mine" in done.stdout
    assert done.stdout.rstrip().endswith(str(Path("runs") / "first" / "report.html"))
    folder = here / "runs" / "first"
    assert {"runs.parquet", "runs.csv", "summary.csv", "run.json", "report.html"} <= {p.name for p in folder.iterdir()}
    runs = pd.read_parquet(folder / "runs.parquet")
    assert runs.groupby(["controller", "scenario"]).size().to_dict() == {
        (c, s): 4 for c in ("xi2023-improved", "mine.py:Mine") for s in ("short", "wavy")
    }
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert record["command"].endswith(" ".join(words))
    assert record["kerfgym"] == kerfgym.__version__
    assert record["packages"]["numba"]
    grid = record["grids"]["following"]
    assert grid["seeds"] == "1000-1003"
    assert grid["ledger"]["mine.py:Mine"]["simulated_steps"] == 4 * (500 + 3000)

    taken = "run folder 'runs/first' exists; use --overwrite to replace it, or another --name"
    assert taken in refused(capsys, *words)
    monkeypatch.setattr("kerfgym.experiments.report.page.write_report", lambda *_: None)  # has tests of its own
    figures = [(folder / file).read_bytes() for file in ("runs.csv", "summary.csv")]
    main([*words, "--overwrite"])
    assert [(folder / file).read_bytes() for file in ("runs.csv", "summary.csv")] == figures

    capsys.readouterr()
    main(["report", "first", "--markdown"])
    printed = capsys.readouterr().out
    assert printed.strip() == (folder / "summary.md").read_text(encoding="utf-8").strip()
    assert "| mine.py:Mine |" in printed


@pytest.fixture
def asked(monkeypatch, here):
    """What the words of a benchmark ask for, without doing it: grids and options."""

    def of(*words):
        seen = {}

        def watched(grids, folder, **options):
            seen.update(grids=grids, options={"folder": folder, **options})
            raise KeyboardInterrupt

        monkeypatch.setattr(benchmarking, "run_grids", watched)
        with pytest.raises(SystemExit):
            main(["benchmark", *words])
        return seen["grids"], seen["options"]

    return of


def test_a_drawing_is_travelled_once_through(here, asked):
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = 4
    document.modelspace().add_lwpolyline([(0, 0), (15, 0), (15, 15), (0, 15)], close=True)
    document.saveas(here / "part.dxf")
    (grid,), _ = asked("--path", "part.dxf", "-c", "pid")
    (scenario,) = grid.scenarios
    assert scenario.name == "drawing@part"
    assert scenario.duration == pytest.approx(60.0 / 100.0, rel=0.05)  # round a square of 15 mm at 100 mm/s
    assert grid.core == ("drawing@part",)
    assert len(grid.seeds) == 20


@pytest.mark.parametrize(
    ("name", "text", "note"),
    [
        (
            "part.svg",
            '<svg xmlns="http://www.w3.org/2000/svg" width="20mm" height="20mm" viewBox="0 0 20 20">'
            '<rect width="15" height="15"/><text>7</text></svg>',
            "text is left out (1)",
        ),
        (
            "part.NGC",
            "G21 G0 X0 Y0\nM3\nG1 X15 F600\nY15\nX0\nY0\nG64 P1\nM2\n",
            "G64 (path blending) is left out (line 7)",
        ),
    ],
)
def test_pictures_and_programmes_are_travelled_too_and_what_is_left_out_is_said(here, asked, capsys, name, text, note):
    (here / name).write_text(text, encoding="utf-8")
    (grid,), _ = asked("--path", name, "-c", "pid")
    (scenario,) = grid.scenarios
    assert scenario.duration == pytest.approx(60.0 / 100.0, rel=0.05)
    assert f"kerfgym: {name}: {note}\n" in capsys.readouterr().err


def test_an_interruption_tells_how_to_go_on(asked, capsys):
    asked("-c", "pid")
    told = capsys.readouterr().err
    assert "kerfgym: interrupted; " in told
    assert "the same command" in told


def test_a_full_disk_is_told_in_words(here, capsys, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "runs/x/runs.parquet")

    monkeypatch.setattr(benchmarking, "run_grids", full)
    with pytest.raises(SystemExit) as stopped:
        main(["benchmark", "-c", "pid", "-s", "wavy"])
    assert stopped.value.code == 2
    told = capsys.readouterr().err
    assert "cannot write 'runs/x/runs.parquet': No space left on device" in told
    assert "the same command" in told


def test_without_the_packages_of_trainings_a_command_says_what_to_install(here, capsys, monkeypatch):
    for package in ("torch", "stable_baselines3", "sb3_contrib"):
        monkeypatch.setitem(sys.modules, package, None)
    for words in (["train", "ppo"], ["tune", "ppo"]):
        assert "which is not installed: pip install 'kerfgym[train]'" in refused(capsys, *words)


def test_the_standard_benchmark_is_the_whole_suite_with_200_test_seeds(asked):
    (grid,), options = asked("--name", "standard")
    assert grid.controllers == ("xi2023-ma", "xi2023-improved", "xi2023-tuned", "pid", "observer", "preview-5ms")
    assert [s.name for s in grid.scenarios] == list(scenarios.suite("following"))
    assert grid.seeds == range(1000, 1200)
    assert grid.core == scenarios.core("following")
    assert options["folder"] == Path("runs") / "standard"
    assert (options["with_ms"], options["overwrite"], options["resume"]) == (True, False, False)
    assert (options["workers"], options["backend"], options["scheduler"]) == (2, "loky", None)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-c", "pidd"], "unknown controller 'pidd'; did you mean 'pid'?"),
        (["-c", "pid:law.kp=1e9"], "law.kp = 1000000000.0 is out of range; allowed: 1 to 400 1/s"),
        (["-c", "pid:filter.window=65"], "filter.window = 65.0 is out of range; allowed: 1 to 64 samples (whole)"),
        (["-c", "xy=pid"], "controller 'pid' drives slot 'z', not 'xy'"),
        (["-c", "mine.py:Mien"], "module 'mine.py' has no 'Mien'; did you mean 'Mine'?"),
        (["-c", "yours.py:Mine"], "no file 'yours.py'"),
        (["-c", ":x"], "':x': nothing stands before the colon"),
        (["-c", "pid:"], "'pid:': nothing stands after the colon"),
        (["-c", ".mine:Mine"], "'.mine' is no module's name"),
        (["-c", "torn.py:Mine"], "torn.py, line 2: "),
        (["-c", "fails.py:Mine"], "fails.py, line 2: ZeroDivisionError: division by zero"),
        (["-s", "wavvy"], "unknown scenario 'wavvy'; did you mean 'wavy'?"),
        (["-s", "broken.toml"], "broken.toml: not valid TOML"),
        (["-s", "misspelt.toml"], "misspelt.toml, line 5: unknown key 'sheet.tlit'; did you mean 'tilt'?"),
        (["--suite", "folowing"], "unknown suite 'folowing'; did you mean 'following'?"),
        (["-s", "wavy", "--suite", "folowing"], "unknown suite 'folowing'; did you mean 'following'?"),
        (["--split", "tset"], "unknown split 'tset'; did you mean 'test'?"),
        (["--seeds", "201"], "--seeds 201 is out of range; split 'test' has 200"),
        (["--seeds", "0"], "--seeds 0 is out of range"),
        (["--suite", "following", "--suite", "cutting", "-c", "recipe"], "suite 'following': none of the controllers"),
        (["--suite", "following", "--suite", "ood", "-s", "wavy"], "suite 'ood': none of the scenarios given fits it"),
        (["--suite", "following", "--suite", "ood", "-s", "cut-square"], "scenario 'cut-square' fits none of these"),
        (["--backend", "daks"], "unknown backend 'daks'; did you mean 'dask'?"),
        (
            ["--scheduler", "tcp://localhost:1"],
            "--scheduler is the address of a dask scheduler; it needs --backend dask",
        ),
        (["--jobs", "0"], "--jobs 0 is out of range; at least 1"),
        (["--jobs", "-2"], "--jobs -2 is out of range; at least 1"),
        (["--path", "nowhere.dxf"], "nowhere.dxf"),
        (["--path", "misspelt.toml"], "'.toml' files cannot be read; "),
    ],
)
def test_bad_input_is_named_and_leaves_nothing_behind(here, capsys, words, message):
    (here / "broken.toml").write_text("name = = 3\n", encoding="utf-8")
    (here / "torn.py").write_text("class Mine:\n    def control(self:\n", encoding="utf-8")
    (here / "fails.py").write_text("def f():\n    return 1 / 0\nf()\n", encoding="utf-8")
    (here / "misspelt.toml").write_text(SHORT.replace("tilt", "tlit"), encoding="utf-8")
    assert message in refused(capsys, "benchmark", *words)
    assert not (here / "runs").exists()


@pytest.mark.parametrize("words", [["benchmark", "--sedes", "3"], ["benchmrk"], ["benchmark", "--seeds", "many"]])
def test_words_that_are_not_the_commands_are_refused(here, capsys, words):
    with pytest.raises(SystemExit) as error:
        main(words)
    assert error.value.code == 2
    assert not (here / "runs").exists()


@pytest.mark.parametrize("words", [["benchmark"], ["tune"], ["reproduce"], ["blame"]])
def test_what_goes_on_has_a_name(here, capsys, words):
    assert "--resume needs --name; unfinished in runs/: none" in refused(capsys, *words, "--resume")
    for name, mark in (("half", "parts"), ("done", "parts"), ("other", "plots")):
        (here / "runs" / name / mark).mkdir(parents=True)
    (here / "runs" / "done" / "run.json").write_text("{}", encoding="utf-8")
    assert refused(capsys, *words, "--resume").endswith("unfinished in runs/: half\n")


# ------------------------------------------------------------------------------------------------------------- report


def test_a_report_of_no_run_or_of_none_that_is_there_says_what_is_there(here, capsys):
    assert "name at least one run; runs/ holds none" in refused(capsys, "report")
    (here / "runs" / "first").mkdir(parents=True)
    (here / "runs" / "first" / "run.json").write_text("{}", encoding="utf-8")
    assert "name at least one run; in runs/ there are first" in refused(capsys, "report")
    assert "no run folder 'runs/frist'; did you mean 'first'?" in refused(capsys, "report", "frist")
    assert "run 'runs/first' is not a benchmark's" in refused(capsys, "report", "first")
    assert "run 'runs/first' is not a benchmark's" in refused(capsys, "report", "runs/first")


# ------------------------------------------------------------------------------------------------------------- render


def test_render_writes_the_last_moment_as_a_picture(here, capsys):
    main(["render", "out/last.png", "-c", "mine.py:Mine", "-s", "short.toml", "--seconds", "0.05", "--seed", "1003"])
    assert capsys.readouterr().out.strip() == str(Path("out") / "last.png")
    with Image.open(here / "out" / "last.png") as picture:
        assert picture.format == "PNG"
        assert picture.size > (400, 200)
        assert len(picture.convert("RGB").getcolors(maxcolors=1 << 20)) > 5
    assert [p.name for p in (here / "out").iterdir()] == ["last.png"]


@pytest.mark.parametrize(
    "words",
    [
        ["-c", "pid", "-s", "short.toml", "--seconds", "0.2", "--slow", "1.0"],
        ["-c", "wu", "-s", "contour-square", "--seconds", "2.0", "--slow", "0.1"],
    ],
)
@pytest.mark.parametrize("kind", ["mp4", "gif"])
def test_render_writes_films(here, kind, words):
    main(["render", f"film.{kind}", *words])
    frames = imageio.imread(f"film.{kind}")
    assert frames.ndim == 4
    assert len(frames) == 5  # 25 a second
    assert np.ptp(frames[-1]) > 100
    assert not list(here.glob(".*"))


@pytest.mark.parametrize("kind", ["mp4", "gif", "png"])
def test_a_film_that_does_not_fit_on_the_disk_is_an_error_and_no_file(here, kind):
    words = ["render", f"film.{kind}", "-c", "pid", "-s", "short.toml", "--seconds", "0.2"]
    done = subprocess.run(
        [sys.executable, "-m", "kerfgym.experiments.cli", *words],
        cwd=here,
        capture_output=True,
        text=True,
        timeout=100,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192)),
    )
    assert done.returncode == 2
    assert "kerfgym: error: cannot write" in done.stderr
    assert not list(here.glob("*film.*"))


def test_render_shows_at_least_one_period(here):
    main(["render", "first.png", "-s", "flat", "--seconds", "0.0001"])
    assert (here / "first.png").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["x.tiff"], "cannot write 'x.tiff'; allowed: .mp4, .gif, .png"),
        (["x.png", "--seconds", "0"], "--slow and --seconds must be above 0"),
        (["x.png", "--slow", "-1"], "--slow and --seconds must be above 0"),
        (["x.png", "--seed", "-1"], "--seed -1 is out of range; 0 and up"),
        (["x.png", "-c", "pidd"], "unknown controller 'pidd'; did you mean 'pid'?"),
        (["x.png", "-s", "wavvy"], "unknown scenario 'wavvy'; did you mean 'wavy'?"),
    ],
)
def test_render_names_bad_input(here, capsys, words, message):
    assert message in refused(capsys, "render", *words)
    assert not list(here.glob("x*"))
