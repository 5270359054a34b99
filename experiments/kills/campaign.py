"""A command that is killed at many moments, each time in a fresh folder, and then given once more."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from .. import runs
from .commands import NAME, Command, Figures, prepare

LONGEST = 900.0
"""s after which a command counts as one that never ends."""

PROGRAM = (sys.executable, "-m", "kerfgym.experiments.cli")


@dataclass(frozen=True)
class Kill:
    """What came of one.

    Attributes:
        moment: s after the start.
        found: what the kill met: ``nothing``, a run ``begun``, one whose ``record`` was written, or one that was
            ``over`` before it came.
        trouble: what is wrong afterwards; empty if nothing is.
    """

    moment: float
    found: str
    trouble: str


def campaign(command: Command, folder: Path, moments: int, seed: int = 0) -> Iterator[Kill]:
    """Kills a command at so many moments of its life, drawn one from each of as many equal stretches.

    Args:
        command: which.
        folder: to work in; each run has a folder of its own there.
        moments: how many.
        seed: of the moments.

    Raises:
        RuntimeError: the command does not end well even if it is let alone.
    """
    whole = _fresh(folder / "whole", command, None)
    start = time.monotonic()
    done = _given(whole, command)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command.words)}: {done.stderr[-2000:]}")
    lasts, expected = time.monotonic() - start, command.figures(_run(whole))
    draw = random.Random(seed)
    for i in range(moments):
        at = lasts * (i + draw.random()) / moments
        place = _fresh(folder / f"{i:03d}", command, whole)
        yield _killed(place, command, at, expected)
        shutil.rmtree(place)


def _run(place: Path) -> Path:
    return place / "runs" / NAME


def _fresh(place: Path, command: Command, like: Path | None) -> Path:
    """A folder with what the command needs; a copy, if that has been made before."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    prepare(place)
    for words in command.before:
        if like is None:
            subprocess.run([*PROGRAM, *words], cwd=place, check=True, capture_output=True, timeout=LONGEST)
        else:
            name = words[words.index("--name") + 1]
            shutil.copytree(like / "runs" / name, place / "runs" / name)
    return place


def _words(command: Command) -> list[str]:
    return [*PROGRAM, *command.words, "--name", NAME]


def _given(place: Path, command: Command) -> subprocess.CompletedProcess[str]:
    return subprocess.run(_words(command), cwd=place, capture_output=True, text=True, timeout=LONGEST)


def _killed(place: Path, command: Command, at: float, expected: Figures) -> Kill:
    with (place / "first.txt").open("w") as log:
        process = subprocess.Popen(_words(command), cwd=place, stdout=log, stderr=log)
        time.sleep(at)
        over = process.poll() is not None
        if not over:
            os.kill(process.pid, signal.SIGKILL)
        process.wait()
    folder = _run(place)
    record, mark = (folder / "run.json").is_file(), (folder / runs.BEGUN).exists()
    if over or (record and not mark):  # the command had ended, though perhaps not its process
        return Kill(at, "over", _wrong(folder, command, expected))
    found = "record" if record else "begun" if mark else "nothing"
    try:
        again = _given(place, command)
    except subprocess.TimeoutExpired:
        return Kill(at, found, f"the same command does not end within {LONGEST:g} s")
    if again.returncode:
        return Kill(at, found, f"rc {again.returncode}: {again.stderr.strip().splitlines()[-1:]}")
    return Kill(at, found, _wrong(folder, command, expected))


def _wrong(folder: Path, command: Command, expected: Figures) -> str:
    """What of a finished run is not as it should be."""
    try:
        figures = command.figures(folder)
    except (OSError, ValueError) as error:
        return f"figures are missing: {error}"
    other = [name for name in {**expected, **figures} if figures.get(name) != expected.get(name)]
    left = [name for name in command.spent if (folder / name).exists()]
    left += [file.name for file in folder.rglob(".*") if runs.is_temporary(file)]
    words = [f"other figures in {', '.join(other)}"] * bool(other) + [f"left behind: {', '.join(left)}"] * bool(left)
    return "; ".join(words)
