"""Who carries a study out: this process or several, in a run folder and a storage that are fit for it."""

import contextlib
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from ...envs.engine.quantity import InvalidInput
from ..store import runs
from . import storage
from .work import Search, abandoned

POLL = 0.3
"""s between two looks at what the workers have done."""

WAIT = 600.0
"""s that is waited for the last trials of other processes."""

Told = Callable[[int, int, str], None]

T = TypeVar("T", bound=Any)


@contextlib.contextmanager
def placed(
    task: T, folder: Path, workers: int, threads: int | None, overwrite: bool, resume: bool
) -> Iterator[tuple[T, int]]:
    """A run folder that is ours alone; gives the search with its place and name, and the threads of each process.

    Raises:
        InvalidInput: a storage or folder that cannot be used, now or within the block.
    """
    if threads is not None and threads < 1:
        raise InvalidInput(f"--threads {threads} is out of range; at least 1")
    shared = _shared(task)
    threads = threads or max(1, (os.cpu_count() or 1) // workers)
    if shared:  # before anything is written
        replace(task, name=task.name or folder.name).open()
    with storage.reachable(str(folder)):
        # A process that joins a study elsewhere may find the folder of the one that began it.
        joins = shared and not (folder / "run.json").is_file()
        with runs.at_work(folder, overwrite, resume or joins, shared):
            task = _at(task, folder, overwrite and not shared)
            with storage.reachable(str(folder) if storage.is_file(task.url) else task.url):
                yield task, threads


def _shared(task: Search) -> bool:
    return bool(task.url) and not storage.is_file(task.url)


def _at(task: T, folder: Path, fresh: bool) -> T:
    url = storage.url_of(task.url, folder)
    if fresh and storage.is_file(url):
        Path(url).unlink(missing_ok=True)
    return replace(task, url=url, name=task.name or folder.name, folder=str(folder))


def carried_out(task: Search, workers: int, threads: int, told: Told) -> Any:
    """The study's work, after as many trials as were asked for are over.

    Raises:
        InvalidInput: a worker died.
    """
    study = task.open()
    stale = [t.number for t in abandoned(study, exclusive=not _shared(task))]

    def tell() -> None:
        told(*task.state(study))

    tell()
    work = task.work(threads, study)
    if workers == 1:
        work.run(_numbered(study, stale), tell)
    else:
        _processes(task, workers, threads, stale, tell)
    _wait(study, tell)
    if left := abandoned(study, exclusive=False):  # by processes that died meanwhile
        work.run(left, tell)
    return work


def _numbered(study: Any, numbers: list[int]) -> list[Any]:
    return [t for t in study.get_trials(deepcopy=False) if t.number in numbers]


def _worker(task: Search, threads: int, stale: list[int]) -> None:
    """What one process does, for as long as the one that started it lives."""
    parent = os.getppid()

    def orphaned() -> None:
        if os.getppid() != parent:
            raise SystemExit(1)

    work = task.work(threads)
    work.run(_numbered(work.study, stale), orphaned)


def _processes(task: Search, workers: int, threads: int, stale: list[int], tell: Callable[[], None]) -> None:
    """Runs the workers to their end.

    Raises:
        InvalidInput: one of them died.
    """
    context = multiprocessing.get_context("spawn")
    shares = [(task, threads, stale[i::workers]) for i in range(workers)]
    group = [context.Process(target=_worker, args=share, daemon=True) for share in shares]
    for process in group:
        process.start()
    try:
        while any(process.is_alive() for process in group):
            time.sleep(POLL)
            tell()
    finally:
        for process in group:
            if process.is_alive():
                process.terminate()
            process.join()
    failed = [process.exitcode for process in group if process.exitcode]
    if failed:
        raise InvalidInput(
            f"{len(failed)} of {workers} workers ended with code {failed[0]}; finished trials are kept, and the same "
            "command goes on"
        )


def _wait(study: Any, tell: Callable[[], None]) -> None:
    """Until other machines have finished their last trials, if they are still at work."""
    import optuna

    until = time.time() + WAIT
    while time.time() < until:
        running = study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.RUNNING,))
        gone = {t.number for t in abandoned(study, exclusive=False)}
        if all(t.number in gone for t in running):
            return
        time.sleep(POLL)
        tell()
