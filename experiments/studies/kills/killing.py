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

from ...store import runs
from .commands import NAME, Command, Figures, prepare
from .steps import COUNTED

LONGEST = 900.0
"""s after which a command counts as one that never ends."""

PROGRAM = (sys.executable, "-m", "kerfgym.experiments.cli")
STEPPED = (sys.executable, "-m", "kerfgym.experiments.studies.kills.steps")
"""The same, which dies at a step of writing."""


@dataclass(frozen=True)
class Kill:
    """What came of one.

    Attributes:
        moment: when, in words.
        found: what the kill met: ``nothing``, a run ``begun``, one whose ``record`` was written, or one that was
            ``over`` before it came.
        trouble: what is wrong afterwards; empty if nothing is.
    """

    moment: str
    found: str
    trouble: str


def campaign(command: Command, folder: Path, moments: int, seed: int = 0, steps: int = 0) -> Iterator[Kill]:
    """Kills a command at so many moments of its life, drawn one from each of as many equal stretches, every other time
    with all processes that it has started; then at so many of its steps of writing, see :mod:`kills.steps`.

    Args:
        command: which.
        folder: to work in; each run has a folder of its own there.
        moments: how many.
        seed: of moments and steps.
        steps: how many.

    Raises:
        RuntimeError: the command does not end well even if it is let alone.
    """
    whole = _fresh(folder / "whole", command, None)
    start = time.monotonic()
    counted = {**os.environ, COUNTED: str(whole.resolve() / "steps.txt")}
    done = _given(whole, command, (*STEPPED, "0") if steps else PROGRAM, counted)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command.words)}: {done.stderr[-2000:]}")
    lasts, expected = time.monotonic() - start, command.figures(_run(whole))
    draw = random.Random(seed)
    for i in range(moments):
        at = lasts * (i + draw.random()) / moments
        place = _fresh(folder / f"{i:03d}", command, whole)
        yield _after(place, command, _at_moment(place, command, at, i % 2 == 1), expected)
        shutil.rmtree(place)
    made = int(Path(counted[COUNTED]).read_text(encoding="utf-8")) if steps else 0
    for i in range(min(steps, made)):
        step = 1 + int(made * (i + draw.random()) / min(steps, made))
        place = _fresh(folder / f"step-{step:03d}", command, whole)
        yield _after(place, command, _at_step(place, command, step, made), expected)
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


def _words(command: Command, program: tuple[str, ...]) -> list[str]:
    return [*program, *command.words, "--name", NAME]


def _given(
    place: Path, command: Command, program: tuple[str, ...], environment: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        _words(command, program), cwd=place, capture_output=True, text=True, timeout=LONGEST, env=environment
    )


def _at_moment(place: Path, command: Command, at: float, group: bool) -> tuple[str, bool]:
    """Kills the command, or it and all its processes; the moment in words, and whether it was over before."""
    with (place / "first.txt").open("w") as log:
        process = subprocess.Popen(_words(command, PROGRAM), cwd=place, stdout=log, stderr=log, start_new_session=True)
        time.sleep(at)
        over = process.poll() is not None
        if not over:
            (os.killpg if group else os.kill)(process.pid, signal.SIGKILL)
        process.wait()
    return f"after {at:.2f} s{' with its processes' * group}", over


def _at_step(place: Path, command: Command, step: int, made: int) -> tuple[str, bool]:
    """Lets the command kill itself and all its processes."""
    with (place / "first.txt").open("w") as log:
        words = _words(command, (*STEPPED, str(step)))
        done = subprocess.run(
            words, cwd=place, stdout=log, stderr=log, start_new_session=True, timeout=LONGEST, check=False
        )
        over = done.returncode == 0
    return f"at step {step} of {made} of writing", over


def _after(place: Path, command: Command, killed: tuple[str, bool], expected: Figures) -> Kill:
    """Gives the command once more and looks at what there is then."""
    at, over = killed
    folder = _run(place)
    record, mark = (folder / "run.json").is_file(), (folder / runs.BEGUN).exists()
    if over or (record and not mark):  # the command had ended, though perhaps not its process
        return Kill(at, "over", _wrong(folder, command, expected))
    found = "record" if record else "begun" if mark else "nothing"
    try:
        again = _given(place, command, PROGRAM)
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
