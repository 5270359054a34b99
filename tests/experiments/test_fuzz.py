"""The fuzzer: the same cases every time, every kind of problem is noticed, and a few files of every quick kind."""

import multiprocessing
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.studies.fuzz import mutate, seeds, worker
from kerfgym.experiments.studies.fuzz.targets import TARGETS, case


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Seeds of the kinds that take no run."""
    folder = tmp_path_factory.mktemp("seeds")
    for name in ("drawings", "tables", "settings", "policies"):
        (folder / name).mkdir()
        getattr(seeds, name)(folder / name)
    return folder


QUICK = [name for name, target in TARGETS.items() if not target.seeds.startswith("runs/")]


@pytest.mark.parametrize("name", [name for name in QUICK if name != "preset"])  # which imports torch
def test_a_seed_is_good_and_what_is_changed_gives_a_result_or_a_clear_error(made, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    target = TARGETS[name]
    for i, seed in enumerate(sorted(made.glob(target.seeds))):
        if seed.name == "1.ngc":  # what is in it a reader may also refuse
            continue
        place = tmp_path / f"seed{i}"
        place.mkdir()
        target.use(target.place(seed.read_bytes(), seed, place))
    for number in range(12):
        place = tmp_path / "case"
        place.mkdir(exist_ok=True)
        outcome = worker._tried(target.use, case(name, number, 1, made, place), tmp_path / "home")
        assert outcome.kind in ("result", "error"), (number, outcome)
        shutil.rmtree(place)


@pytest.fixture(autouse=True)
def home(tmp_path):
    """The folder in which a worker works."""
    (tmp_path / "home").mkdir()
    return tmp_path / "home"


def test_a_case_is_found_again_by_its_number(made, tmp_path):
    texts = []
    for place in ("a", "b", "c"):
        (tmp_path / place).mkdir()
        texts.append(case("tuned", 7 if place != "c" else 8, 0, made, tmp_path / place).read_bytes())
    assert texts[0] == texts[1] != texts[2]


@pytest.mark.parametrize("change", mutate.CHANGES, ids=lambda change: change.__name__)
def test_every_change_changes_something(made, change):
    data = (made / "settings" / "tuned" / "one.toml").read_bytes()
    changed = {change(random.Random(i), data) for i in range(20)}
    assert len(changed) > 5
    for empty in (b"", b"\n", b"\xff"):
        for i in range(5):
            assert isinstance(change(random.Random(i), empty), bytes)


@pytest.mark.parametrize(
    ("use", "kind"),
    [
        (lambda path: None, "result"),
        (lambda path: (_ for _ in ()).throw(InvalidInput("x")), "error"),
        (lambda path: (_ for _ in ()).throw(InvalidInput("")), "words"),
        (lambda path: (_ for _ in ()).throw(KeyError("x")), "traceback"),
        (lambda path: (_ for _ in ()).throw(SystemExit(1)), "traceback"),
        (lambda path: (_ for _ in ()).throw(RecursionError), "traceback"),
        (lambda path: (_ for _ in ()).throw(MemoryError), "memory"),
        (lambda path: (path / "EXECUTED").touch(), "executed"),
        (lambda path: (path / "pyproject.toml").touch(), "escaped"),
    ],
)
def test_every_problem_is_noticed(home, use, kind):
    assert worker._tried(use, home, home).kind == kind
    assert not list(home.iterdir())


@pytest.mark.parametrize(
    ("does", "seconds", "answered"),
    [("pass", 30.0, True), ("time.sleep(60)", 0.3, False), ("while True: pass", 0.3, False)],
    ids=["answers", "sleeps", "works"],
)
def test_a_worker_hangs_that_sleeps_or_works_too_long(monkeypatch, does, seconds, answered):
    from kerfgym.experiments.studies.fuzz import __main__ as fuzz

    monkeypatch.setattr(fuzz, "TICK", 0.05)
    receive, send = multiprocessing.Pipe(duplex=False)
    code = f"import os, time\n{does}\nos.write({send.fileno()}, b'\\0\\0\\0\\1x')"
    process = subprocess.Popen([sys.executable, "-c", code], pass_fds=[send.fileno()])
    send.close()
    try:
        assert fuzz.answers(receive, process.pid, seconds) is answered
    finally:
        process.kill()
        process.wait()


def test_the_slowest_and_the_largest_are_told(monkeypatch, tmp_path, capsys):
    from kerfgym.experiments.studies.fuzz import __main__ as fuzz

    def fuzzed(names, *_):
        tallies = {name: fuzz.Tally(name) for name in names}
        for number, seconds in enumerate((0.5, 7.0, 3.0)):
            tallies["svg"].add(number, worker.Outcome("result", "", seconds, 1_000_000 * number))
        tallies["dxf"].add(4, worker.Outcome("error", "no", 5.0, 900_000_000))
        return tallies

    monkeypatch.setattr(fuzz, "fuzzed", fuzzed)
    assert fuzz.fuzz(("dxf", "svg"), seeds=tmp_path) == 0
    said = capsys.readouterr().out
    assert "slowest, s of the processor: svg case 1 7.0, dxf case 4 5.0, svg case 2 3.0\n" in said
    assert "most memory, MB: dxf case 4 900, svg case 2 2, svg case 1 1\n" in said


def test_a_worker_that_hangs_or_dies_is_replaced(monkeypatch, tmp_path):
    from kerfgym.experiments.studies.fuzz import __main__ as fuzz

    class Pipe:
        """The other end says nothing, or is gone."""

        def __init__(self, gone):
            self.gone = gone

        def send(self, asked):
            pass

        def poll(self, seconds):
            return self.gone

        def recv(self):
            raise EOFError

    class Process:
        """One that has ended."""

        exitcode, pid = -11, 0  # 0 is nobody's: asleep

        def join(self):
            pass

        kill = join

    begun = []

    def begin(self):
        begun.append(1)
        self.pipe, self.process = Pipe(len(begun) == 1), Process()

    monkeypatch.setattr(fuzz.Worker, "_begin", begin)
    monkeypatch.setattr(fuzz, "TICK", 30.0)
    work = fuzz.Worker(Path("x"))
    died, hung = work("dxf", 0, 0), work("dxf", 1, 0)
    assert (died.kind, died.words) == ("dies", "exit code -11")
    assert hung.kind == "hangs"
    assert len(begun) == 3
    tally = fuzz.Tally("dxf")
    tally.add(0, died)
    tally.add(1, hung)
    tally.add(2, worker.Outcome("result", "", 1.0, 2_000_000_000))
    assert dict(tally.outcomes) == {"dies": 1, "hangs": 1, "memory": 1}
    assert [numbers for numbers in tally.problems.values()] == [[0], [1], [2]]
