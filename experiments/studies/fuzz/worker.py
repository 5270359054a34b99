"""A process that reads changed files, one after the other, under limits, and says what came of each."""

import contextlib
import logging
import os
import resource
import shutil
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from ....envs.engine.quantity import InvalidInput
from ...store import typed

MOST_MEMORY = 1_000_000_000
"""Bytes beyond what the process has when it begins; also of a file that it writes."""

TRAP = "import pathlib\npathlib.Path(__file__).with_name('EXECUTED').touch()\n\n\nclass Mine:\n    pass\n"
"""Python that no file may have run; it leaves a mark."""


OURS = ("case", "pipe", "x.py", "evil.py", "__pycache__")
"""What lies in a worker's folder; anything else a file has put there."""


@dataclass(frozen=True)
class Outcome:
    """What came of a case: ``result``, ``error`` (a clear one), or a problem with its words and place."""

    kind: str
    words: str = ""
    seconds: float = 0.0  # of the processor
    bytes: int = 0  # of memory that the process has had more than at its beginning


def serve(pipe: Connection, seeds: str) -> None:
    """Answers cases (name, number, seed) until it is told None."""
    from .targets import TARGETS, case

    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    with tempfile.TemporaryDirectory(prefix="kerfgym-fuzz-") as home:
        os.chdir(home)
        for name in ("x.py", "evil.py"):
            Path(name).write_text(TRAP, encoding="utf-8")
        os.mkfifo("pipe")
        pipe.send("ready")
        least = 0
        while (asked := pipe.recv()) is not None:
            name, number, seed = asked
            place = Path(home) / "case"
            place.mkdir()
            path = case(name, number, seed, Path(seeds), place)
            if not least:  # what the libraries take is not the files' doing
                _warm(name, Path(seeds))
                least = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            beginning = _fresh_peak()
            start = time.process_time()
            with _limits(least + MOST_MEMORY):
                outcome = _tried(TARGETS[name].use, path, Path(home))
            spent, grown = time.process_time() - start, _peak() - beginning
            pipe.send(Outcome(outcome.kind, outcome.words, spent, grown))
            shutil.rmtree(place, ignore_errors=True)


def _warm(name: str, seeds: Path) -> None:
    """Reads a seed as it is, so that everything is imported."""
    from .targets import TARGETS

    target = TARGETS[name]
    first = sorted(seeds.glob(target.seeds))[0]
    with tempfile.TemporaryDirectory() as place:
        target.use(target.place(first.read_bytes(), first, Path(place)))


@contextlib.contextmanager
def _limits(most: int) -> Iterator[None]:
    """Limits of reading, in memory and in what it writes; making a file may take more."""
    kinds = {resource.RLIMIT_AS: most, resource.RLIMIT_FSIZE: MOST_MEMORY, resource.RLIMIT_CORE: 0}
    before = {kind: resource.getrlimit(kind) for kind in kinds}
    for kind, limit in kinds.items():
        resource.setrlimit(kind, (limit, before[kind][1]))
    try:
        yield
    finally:
        for kind, limits in before.items():
            resource.setrlimit(kind, limits)


def _fresh_peak() -> int:
    """Bytes that the process has, from which on :func:`_peak` counts."""
    with contextlib.suppress(OSError):  # kernels without it keep the peak of earlier cases
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return _peak()


def _peak() -> int:
    """The most bytes that the process had at a time."""
    words = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * next(int(line.split()[1]) for line in words.splitlines() if line.startswith("VmHWM"))


def _tried(use: object, path: Path, home: Path) -> Outcome:
    try:
        use(path)  # type: ignore[operator]
        outcome = Outcome("result")
    except InvalidInput as error:
        words = typed.told(error)  # as the command shows it
        outcome = Outcome("error", words) if words else Outcome("words", "an error without words")
    except MemoryError:
        outcome = Outcome("memory", _where())
    except BaseException as error:  # whatever it is, it would have been a traceback
        outcome = Outcome("traceback", f"{type(error).__name__}: {str(error)[:200]} at {_where()}")
    if (home / "EXECUTED").exists():
        (home / "EXECUTED").unlink()
        return Outcome("executed", "Python that the file named was run")
    if strange := [each.name for each in home.iterdir() if each.name not in OURS]:
        for each in strange:
            (shutil.rmtree if (home / each).is_dir() else os.unlink)(home / each)
        return Outcome("escaped", f"wrote {', '.join(strange)} outside of its folder")
    return outcome


def _where() -> str:
    """The innermost line of ours, and the innermost of all."""
    import sys

    frames = traceback.extract_tb(sys.exc_info()[2])
    root = str(Path(__file__).parents[3])
    own = [f for f in frames if f.filename.startswith(root) and "/fuzz/" not in f.filename]
    shown = [f"{Path(f.filename).name}:{f.lineno}" for f in (*own[-1:], *frames[-1:])]
    return " ← ".join(dict.fromkeys(shown))
