"""Pools and interruption: whoever computes a grid, and however often it is killed, the figures are the same."""

import shlex
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from distributed import LocalCluster

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.scenarios import load
from kerfgym.experiments.benchmark.benchmarking import run
from kerfgym.experiments.cli import main
from kerfgym.experiments.store import pool, runs

OWN = """
class Mine:
    def reset(self):
        pass

    def control(self, signals):
        return -40.0 * (signals.height - signals.set_height)
"""
FILES = ("runs.parquet", "runs.csv", "traces.parquet", "summary.parquet", "summary.csv")
CASES = [load(name).varied(duration=0.4) for name in ("wavy", "step", "impulses")]
WORDS = shlex.split(
    "benchmark -c mine.py:Mine -c pid -s wavy.toml -s step.toml -s impulses.toml --seeds 12 "
    "--no-ms --no-cost --no-blame --no-detuned"
)


def figures(folder):
    return {name: (folder / name).read_bytes() for name in FILES}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """The user's folder, with scenarios and a controller of their own."""
    for case in CASES:
        (tmp_path / f"{case.name}.toml").write_text(case.to_toml(), encoding="utf-8")
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("kerfgym.experiments.report.page.write_report", lambda *_: None)  # has tests of its own
    return tmp_path


def grid(folder, **options):
    run(["pid", "mine.py:Mine"], CASES, folder, range(1000, 1003), with_ms=False, quiet=True, **options)
    return figures(folder)


# --------------------------------------------------------------------------------------------------------------- pools


def test_processes_and_a_dask_cluster_give_the_same_bytes(here):
    alone = grid(here / "alone", workers=1)
    assert grid(here / "loky", workers=2) == alone
    assert grid(here / "dask", workers=2, backend="dask") == alone


def test_a_scheduler_elsewhere_gives_the_same_bytes_however_many_threads_its_workers_have(here):
    with LocalCluster(
        n_workers=2, threads_per_worker=2, processes=False, protocol="tcp://", dashboard_address=None
    ) as cluster:
        far = grid(here / "far", backend="dask", scheduler=cluster.scheduler_address)
    assert far == grid(here / "alone", workers=1)


@pytest.fixture
def stranger():
    """A function: the address of somebody who is no scheduler, and answers every caller with these bytes."""
    listening, callers = socket.create_server(("127.0.0.1", 0)), []

    def begin(words):
        def serve():
            while True:
                try:
                    callers.append(listening.accept()[0])
                except OSError:
                    return
                callers[-1].sendall(words)

        threading.Thread(target=serve, daemon=True).start()
        return f"127.0.0.1:{listening.getsockname()[1]}"

    yield begin
    listening.close()
    for each in callers:
        each.close()


@pytest.mark.parametrize("scheme", ["tcp", "tls"])
@pytest.mark.parametrize("words", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\xff" * 64, b"\0" * 64])
def test_a_stranger_at_the_schedulers_address_is_an_error_at_once(here, stranger, scheme, words, capsys):
    address = f"{scheme}://{stranger(words)}"
    start = time.monotonic()
    with pytest.raises(SystemExit):
        main(["benchmark", "-c", "pid", "-s", "wavy.toml", "--seeds", "6", "--backend", "dask", "--scheduler", address])
    assert time.monotonic() - start < 5.0
    assert f"no dask scheduler at '{address}'" in capsys.readouterr().err
    assert not (here / "runs").exists()


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("tcp://127.0.0.1:1", "no dask scheduler at 'tcp://127.0.0.1:1': .*refused"),
        ("127.0.0.1:1", "no dask scheduler at '127.0.0.1:1': .*refused"),
        ("tls://127.0.0.1:1", "no dask scheduler"),
        ("tcp://[::1]:1", "no dask scheduler"),
        ("tcp://127.0.0.1:99999", "is not an address such as tls://10.0.0.1:8786"),
        ("x", "is not an address"),
        ("tcp://user:hunter2@127.0.0.1:1", r"'tcp://user:…@127.0.0.1:1' is not an address"),
        ("carrier-pigeon://127.0.0.1:1", "is not an address|no dask scheduler"),
    ],
)
def test_a_scheduler_that_does_not_answer_is_an_error_at_once(address, message):
    start = time.monotonic()
    with pytest.raises(InvalidInput, match=message):
        pool.check("dask", 1, address)
    assert time.monotonic() - start < 5.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("multiprocessing", 2, None), r"unknown backend 'multiprocessing'.* \(known: loky, dask\)"),
        (("loky", 0, None), "--jobs 0 is out of range; at least 1"),
        (("loky", 2, "tcp://x:1"), "it needs --backend dask"),
    ],
)
def test_pools_that_do_not_exist_are_refused(arguments, message):
    with pytest.raises(InvalidInput, match=message):
        pool.check(*arguments)


def test_without_the_package_dask_is_refused(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InvalidInput, match=r"pip install 'kerfgym\[dask\]'"):
        pool.check("dask", 2, None)


# -------------------------------------------------------------------------------------------------------- interruption


def test_a_run_that_is_killed_goes_on_and_ends_as_if_nothing_had_happened(here, capsys):
    words = [*WORDS, "--name", "killed", "--jobs", "2"]
    process = subprocess.Popen(
        [sys.executable, "-m", "kerfgym.experiments.cli", *words], cwd=here, stderr=subprocess.PIPE, text=True
    )
    parts = here / "runs" / "killed" / "parts"
    while process.poll() is None and len(list(parts.glob("*.runs.parquet"))) < 1:
        time.sleep(0.01)
    process.kill()
    process.communicate(timeout=60)  # until its workers have ended too, who hold the pipe
    assert not (here / "runs" / "killed" / "run.json").exists()
    with pytest.raises(SystemExit):
        main(["report", "killed"])
    assert f"{' '.join(words)}' finishes it" in capsys.readouterr().err

    (here / "runs" / "killed" / ".runs.parquet.a1b2c3d4").write_bytes(b"half of a table")
    main(words)
    main([*WORDS, "--name", "whole", "--jobs", "1"])
    assert figures(here / "runs" / "killed") == figures(here / "runs" / "whole")
    left = {p.name for p in (here / "runs" / "killed").iterdir()}
    assert left == {*FILES, "run.json", "summary.md", "scenarios"}


def test_a_kill_after_the_last_task_loses_nothing(here, monkeypatch):
    def dies(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("kerfgym.experiments.report.summary.write", dies)
        with pytest.raises(KeyboardInterrupt):
            grid(here / "late", workers=1)
    with monkeypatch.context() as patch:
        patch.setattr("kerfgym.experiments.benchmark.benchmarking.compute", dies)  # nothing is left to compute
        late = grid(here / "late", workers=1, resume=True)
    assert late == grid(here / "whole", workers=1)


def test_a_kill_amid_the_removal_of_its_parts_leaves_a_run_that_goes_on(here, monkeypatch):
    words, late = [*WORDS, "--name", "late", "--jobs", "1"], here / "runs" / "late"

    def dies(path, *_, **__):
        for file in sorted(Path(path).rglob("*.parquet"))[:3]:
            file.unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("shutil.rmtree", dies)
        with pytest.raises(KeyboardInterrupt):
            main(words)
    assert (late / "run.json").exists()
    assert (late / runs.BEGUN).exists()
    main(words)
    main([*WORDS, "--name", "whole", "--jobs", "1"])
    assert figures(late) == figures(here / "runs" / "whole")
    assert {path.name for path in late.iterdir()} == {path.name for path in (here / "runs" / "whole").iterdir()}
