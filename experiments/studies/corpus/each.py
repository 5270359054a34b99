"""One file after the other, each in a process of its own with a limit of time and memory."""

import importlib.util
import multiprocessing
import traceback
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path

from ....envs.paths.read import FORMATS
from .judged import FAILED, Verdict

TIME_LIMIT = 60.0
"""s for a file; the reference's time is not in it."""

MEMORY_LIMIT = 4 << 30
"""Bytes of address space."""

REFERENCE_TIME = 60.0
"""s that the reference may take besides."""

KINDS = {"dxf": "drawings", "svg": "drawings", "gcode": "programmes"}
"""Which module of this folder checks which format."""


def files(folder: Path) -> list[Path]:
    """The drawings and programmes in a folder and those below it, in order."""
    found = [folder] if folder.is_file() else sorted(folder.rglob("*"))
    return [path for path in found if path.suffix.lower() in FORMATS and path.is_file()]


def verdicts(paths: Iterable[Path], limit: float = TIME_LIMIT) -> Iterator[Verdict]:
    """The verdict on each file, ``limit`` s for each."""
    modules = sorted(f"{__package__}.{m}" for m in set(KINDS.values()) if checker(m))
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(modules)
    for path in paths:
        yield one(path, limit, context)


def checker(module: str) -> bool:
    """Whether a module of this folder is there."""
    return importlib.util.find_spec(f"{__package__}.{module}") is not None


def one(path: Path, limit: float, context: multiprocessing.context.BaseContext) -> Verdict:
    """The verdict on a file, from a process of its own."""
    kind = FORMATS[path.suffix.lower()]
    if not checker(KINDS[kind]):
        return Verdict(path, kind, FAILED, "nothing checks this format", counted=False)
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(KINDS[kind], path, send), daemon=True)  # type: ignore[attr-defined]
    process.start()
    send.close()
    try:
        found = receive.recv() if receive.poll(limit + REFERENCE_TIME) else None
    except EOFError:
        found = Verdict(path, kind, FAILED, "its process ended without a word")
    if found is None:
        process.kill()
        found = Verdict(path, kind, FAILED, f"not read within {limit:g} s", seconds=limit)
    elif found.seconds > limit:
        found = Verdict(path, kind, FAILED, f"not read within {limit:g} s", seconds=found.seconds)
    process.join()
    return found


def _work(module: str, path: Path, send: Connection) -> None:
    check: Callable[[Path], Verdict] = import_module(f"{__package__}.{module}").check
    _limit_memory()
    try:
        send.send(check(path))
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__}: {error} ({Path(last.filename).name}, line {last.lineno})"
        send.send(Verdict(path, FORMATS[path.suffix.lower()], FAILED, text))


def _limit_memory() -> None:
    """So much more than what the process was begun with."""
    try:
        import resource

        begun = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (begun + MEMORY_LIMIT, resource.getrlimit(resource.RLIMIT_AS)[1]))
    except (ImportError, ValueError, OSError):  # not on this system
        return
