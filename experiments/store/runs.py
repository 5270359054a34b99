"""Run folders: ``runs/<name>/`` with ``run.json``, results as Parquet and CSV, plots and report; written atomically."""

import contextlib
import datetime
import fcntl
import json
import os
import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import pandas as pd

from ... import __version__
from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files, names
from . import typed

BEGUN = ".begun"
"""File of a run whose command has not come to its end: holds the command, and is locked while that is at work."""

UNFINISHED = (BEGUN, "parts", "study.journal")
"""What is found in the folder of a run that was interrupted."""

_TEMPORARY = re.compile(r"\..+\.[a-z0-9_]{8}")
_GONE = "removed_"

PACKAGES = ("numpy", "numba", "scipy", "gymnasium", "pandas", "pyarrow")


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    os.close(handle)
    try:
        yield Path(name)
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(name, 0o666 & ~mask)  # temporary files are private, results are not
        os.replace(name, path)
    finally:
        Path(name).unlink(missing_ok=True)


def is_temporary(path: Path) -> bool:
    """Whether a kill has left this file or folder: amid a write (:func:`atomic`) or a removal (:func:`discard`)."""
    return _TEMPORARY.fullmatch(path.name) is not None


def sweep(folder: Path) -> None:
    """Removes what kills have left in a folder. Nobody else may be writing into it."""
    for path in [path for path in folder.rglob(".*") if is_temporary(path)]:
        _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def discard(path: Path) -> None:
    """Removes a folder or file. A kill leaves it as it was, or gone: half of a run's parts would be taken for all."""
    if path.is_dir() and not path.is_symlink():
        gone = path.with_name(f".{path.name}.{_GONE}")
        _remove(gone)
        os.replace(path, gone)
        path = gone
    _remove(path)


def write_text(path: Path, text: str) -> None:
    """Writes a text atomically."""
    with atomic(path) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, data: Any) -> None:
    """Writes JSON atomically."""
    write_text(path, json.dumps(data, indent=2, ensure_ascii=False) + "\n")


def write_table(folder: Path, name: str, frame: pd.DataFrame, csv: bool = True) -> None:
    """Writes a table as Parquet and, if wanted, CSV."""
    with atomic(folder / f"{name}.parquet") as part:
        frame.to_parquet(part, index=False)
    if csv:
        with atomic(folder / f"{name}.csv") as part:
            frame.to_csv(part, index=False)


def near(name: str) -> Path | None:
    """A path that a record names, if it lies in the folder in which the user works. A record may come from somebody
    else, and nothing outside is read because it says so."""
    path = Path(name) if "\0" not in name else None
    if path is None or not path.resolve().is_relative_to(Path.cwd()):
        return None
    return path


def git(*words: str) -> str:
    """What git says in the package's checkout; nothing outside of one."""
    try:
        out = subprocess.run(["git", *words], capture_output=True, text=True, cwd=Path(__file__).parents[2], timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return out.stdout.strip() if out.returncode == 0 else ""


def git_state() -> dict[str, Any]:
    """Commit of the package's checkout and whether it was changed since; empty outside a checkout."""
    commit = git("rev-parse", "HEAD")
    return {"commit": commit, "changed": bool(git("status", "--porcelain", "-uno"))} if commit else {}


def record(command: list[str] | None = None) -> dict[str, Any]:
    """What every run records of itself: command, versions, git state, machine."""
    return {
        "command": typed.line() if command is None else typed.joined(command),
        "kerfgym": __version__,
        "git": git_state(),
        "python": platform.python_version(),
        "packages": {name: metadata.version(name) for name in PACKAGES},
        "machine": {"system": platform.system(), "processor": _processor(), "cores": os.cpu_count()},
    }


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def begun(folder: Path) -> list[str]:
    """The commands that have worked on an unfinished run, the one that began it first, without what tells them to go on
    or to begin anew; empty if unknown."""
    try:
        found = files.json_(folder / BEGUN)["commands"]
    except (InvalidInput, KeyError, TypeError):
        return []
    return [str(command) for command in found] if isinstance(found, list) else []


def _typed() -> str:
    return typed.same(typed.TYPED.get())


def _finished(folder: Path) -> bool:
    """Whether a run's command came to its end. One that was killed after it had written the record did not: what it
    should have removed is still there."""
    return (folder / "run.json").is_file() and not (folder / BEGUN).exists()


def _busy(folder: Path) -> bool:
    """Whether a command is at work in a folder."""
    try:
        handle = os.open(folder / BEGUN, os.O_RDWR)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False


def folder(name: str) -> Path:
    """The run folder of a name, in ``runs/``; the user's own words may also lead into a folder within or elsewhere.

    Raises:
        InvalidInput: it is no name.
    """
    for part in Path(name).parts:
        if part not in ("/", ".."):
            names.checked(part, "--name")
    return Path("runs") / name


def named(name: str | None, kind: str = "", resume: bool = False) -> Path:
    """The run folder of a name. Without one it is that of the last run which the same command began and did not finish,
    or a new one, called after kind, date and time.

    Raises:
        InvalidInput: it is to be resumed, has no name, and no such run is there.
    """
    if name:
        return folder(name)
    left = sorted(p for p in Path("runs").glob("*") if any((p / mark).exists() for mark in UNFINISHED))
    left = [p for p in left if not _finished(p)]
    mine = [p for p in left if _typed() in begun(p) and not _busy(p)]
    if mine:
        return max(mine, key=lambda p: (p / BEGUN).stat().st_mtime)
    if resume:
        raise InvalidInput(f"--resume needs --name; unfinished in runs/: {', '.join(p.name for p in left) or 'none'}")
    return Path("runs") / f"{kind}{datetime.datetime.now():%Y-%m-%d-%H%M%S}"


def open_folder(path: Path, overwrite: bool = False, resume: bool = False, shared: bool = False) -> Path:
    """A run folder to write into. What the command that was typed began and did not finish goes on unless told
    otherwise.

    Raises:
        InvalidInput: it exists already and neither ``overwrite`` nor ``resume`` was asked for, or a command is at work
            in it.
    """
    if path.exists() and not path.is_dir():
        raise InvalidInput(f"run folder '{path}' is a file; use another --name")
    if not shared and _busy(path):
        raise InvalidInput(f"another command is at work in '{path}'")
    commands = begun(path)
    # A command that was killed in its first moment leaves a mark without a word in it.
    files_ = [file for file in path.iterdir() if not is_temporary(file)] if path.exists() else []
    finished, there = _finished(path), any(file.name != BEGUN or commands for file in files_)
    if resume and finished and not overwrite:
        raise InvalidInput(f"run folder '{path}' is finished; use --overwrite to replace it, or another --name")
    if there and not (overwrite or resume):
        if finished or _typed() not in commands:
            hint = "" if finished else "--resume to finish it, "
            whose = f" and holds what '{commands[0]}' began" if commands and not finished else ""
            raise InvalidInput(
                f"run folder '{path}' exists{whose}; use {hint}--overwrite to replace it, or another --name"
            )
        typed.say(f"goes on with '{path}', which was interrupted; --overwrite begins anew")
    if overwrite and there:
        if not (finished or any((path / mark).exists() for mark in UNFINISHED)):
            raise InvalidInput(f"'{path}' is not a run folder; it is not overwritten")
        # What makes it a run's folder goes last: a kill meanwhile leaves one that may be overwritten.
        for file in sorted(path.iterdir(), key=lambda file: file.name in ("run.json", *UNFINISHED)):
            discard(file)
    path.mkdir(parents=True, exist_ok=True)
    return path


@contextlib.contextmanager
def at_work(
    path: Path, overwrite: bool = False, resume: bool = False, shared: bool = False, spent: Sequence[str] = ()
) -> Iterator[Path]:
    """A run folder that is ours until the command ends that was typed, or else the block.

    Args:
        path, overwrite, resume: as for :func:`open_folder`.
        shared: with others who do the same.
        spent: files and folders in it of which nobody needs anything once the command is over.

    Raises:
        InvalidInput: see :func:`open_folder`.
    """
    open_folder(path, overwrite, resume, shared)
    handle = os.open(path / BEGUN, os.O_CREAT | os.O_RDWR, 0o666)
    try:
        try:
            fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InvalidInput(f"another command is at work in '{path}'") from None
        commands = dict.fromkeys([*begun(path), *filter(None, [_typed()])])
        words = json.dumps({"commands": list(commands)}).encode() + b"\n"
        os.pwrite(handle, words, 0)  # more than was there, so that a kill before the next line leaves it whole
        os.ftruncate(handle, len(words))
        if not shared:
            sweep(path)
        yield path
    except BaseException:
        os.close(handle)
        raise
    later = typed.AFTERWARDS.get()
    if later is None:
        _settle(path, handle, spent)
    else:  # until it has shown what it found: if it is killed before, the same command does that
        later.callback(_settle, path, handle, spent)


def _settle(path: Path, handle: int, spent: Sequence[str]) -> None:
    """Removes what a finished run does not need, its mark last."""
    try:
        if (path / "run.json").is_file():
            for name in spent:
                discard(path / name)
            (path / BEGUN).unlink(missing_ok=True)
    finally:
        os.close(handle)
