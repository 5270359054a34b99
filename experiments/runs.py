"""Run folders: ``runs/<name>/`` with ``run.json``, results as Parquet and CSV, plots and report; written atomically."""

import contextlib
import datetime
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pandas as pd

from .. import __version__
from ..envs.plant.quantity import InvalidInput

UNFINISHED = ("parts", "study.journal")
"""What is found in the folder of a run that was interrupted."""

_TEMPORARY = re.compile(r"\..+\.[a-z0-9_]{8}")

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


def sweep(folder: Path) -> None:
    """Removes what writes that were killed have left in a folder. Nobody else may be writing into it."""
    for file in folder.rglob(".*"):
        if file.is_file() and _TEMPORARY.fullmatch(file.name):
            file.unlink()


def write_json(path: Path, data: Any) -> None:
    """Writes JSON atomically."""
    with atomic(path) as part:
        part.write_text(json.dumps(data, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_table(folder: Path, name: str, frame: pd.DataFrame, csv: bool = True) -> None:
    """Writes a table as Parquet and, if wanted, CSV."""
    with atomic(folder / f"{name}.parquet") as part:
        frame.to_parquet(part, index=False)
    if csv:
        with atomic(folder / f"{name}.csv") as part:
            frame.to_csv(part, index=False)


def git_state() -> dict[str, Any]:
    """Commit of the package's checkout and whether it was changed since; empty outside a checkout."""
    folder = Path(__file__).parents[1]

    def git(*words: str) -> str | None:
        try:
            out = subprocess.run(["git", *words], capture_output=True, text=True, cwd=folder, timeout=10)
        except (OSError, subprocess.TimeoutExpired):
            return None
        return out.stdout.strip() if out.returncode == 0 else None

    commit = git("rev-parse", "HEAD")
    return {"commit": commit, "changed": bool(git("status", "--porcelain", "-uno"))} if commit else {}


def record(command: list[str] | None = None) -> dict[str, Any]:
    """What every run records of itself: command, versions, git state, machine."""
    words = command if command is not None else ["kerfgym", *sys.argv[1:]]
    return {
        "command": " ".join(words),
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


def named(name: str | None, kind: str = "", resume: bool = False) -> Path:
    """The run folder of a name; without one it is called after kind, date and time.

    Raises:
        InvalidInput: it is to be resumed and has no name.
    """
    if name:
        return Path("runs") / name
    if resume:
        left = sorted({p.parent.name for mark in UNFINISHED for p in Path("runs").glob(f"*/{mark}")
                       if not (p.parent / "run.json").is_file()})  # fmt: skip
        raise InvalidInput(f"--resume needs --name; unfinished in runs/: {', '.join(left) or 'none'}")
    return Path("runs") / f"{kind}{datetime.datetime.now():%Y-%m-%d-%H%M%S}"


def open_folder(path: Path, overwrite: bool = False, resume: bool = False) -> Path:
    """A run folder to write into.

    Raises:
        InvalidInput: it exists already and neither ``overwrite`` nor ``resume`` was asked for.
    """
    if path.exists() and not path.is_dir():
        raise InvalidInput(f"run folder '{path}' is a file; use another --name")
    finished = (path / "run.json").is_file()
    if resume and finished and not overwrite:
        raise InvalidInput(f"run folder '{path}' is finished; use --overwrite to replace it, or another --name")
    if path.exists() and any(path.iterdir()) and not (overwrite or resume):
        unfinished = not finished
        hint = "--resume to finish it, " if unfinished else ""
        raise InvalidInput(f"run folder '{path}' exists; use {hint}--overwrite to replace it, or another --name")
    if overwrite and path.exists() and any(path.iterdir()):
        if not (finished or any((path / mark).exists() for mark in UNFINISHED)):
            raise InvalidInput(f"'{path}' is not a run folder; it is not overwritten")
        for file in path.iterdir():
            if file.is_dir() and not file.is_symlink():
                shutil.rmtree(file)
            else:
                file.unlink()
    path.mkdir(parents=True, exist_ok=True)
    return path
