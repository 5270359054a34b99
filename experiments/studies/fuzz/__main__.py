"""``python -m kerfgym.experiments.studies.fuzz``: changed files of every kind, read by workers under limits."""

import collections
import multiprocessing
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from ...store import script
from ...store.markdown import table
from .seeds import make
from .targets import TARGETS, case
from .worker import MOST_MEMORY, Outcome, serve

LONGEST = 20.0
"""s of the processor, or asleep, after which a file counts as one that hangs. On a busy machine a worker that waits for
its turn is neither, so the count is the same there."""

MAKING = 5.0
"""s more that a worker gets, for it makes the file, too; what reading alone took is in its answer."""

IMPORTS = 60.0
"""s more for a worker's first file, before which it imports."""

TICK = 0.5
"""s from look to look at a worker that has not answered."""

TOLD = 3
"""Slowest files, and those of most memory, that are told."""

FRESH = 2000
"""Cases after which a worker is replaced: libraries keep what they have once taken."""


@dataclass
class Tally:
    """What came of the cases of a kind."""

    name: str
    outcomes: collections.Counter[str] = field(default_factory=collections.Counter)
    problems: dict[str, list[int]] = field(default_factory=dict)
    seconds: dict[Any, float] = field(default_factory=dict)  # of the processor, by case
    bytes: dict[Any, float] = field(default_factory=dict)

    @property
    def counts(self) -> tuple[int, ...]:
        """Files, results, clear errors, problems."""
        total, results, errors = self.outcomes.total(), self.outcomes["result"], self.outcomes["error"]
        return total, results, errors, total - results - errors

    def add(self, number: int, outcome: Outcome) -> None:
        """Counts one."""
        kind = outcome.kind
        if outcome.bytes > MOST_MEMORY:
            kind = "memory"
        self.outcomes[kind] += 1
        self.seconds[number], self.bytes[number] = outcome.seconds, outcome.bytes
        if kind not in ("result", "error"):
            known = self.problems.setdefault(f"{kind}: {outcome.words}", [])
            known.append(number)
            if len(known) == 1:
                print(f"{self.name}, case {number}: {kind}: {outcome.words}", file=sys.stderr, flush=True)


class Worker:
    """A process for cases of one kind; it is replaced when it dies, hangs or has had its share."""

    def __init__(self, seeds: Path) -> None:
        self.seeds, self.done = seeds, 0
        self._begin()

    def _begin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs, str(self.seeds)), daemon=True)
        self.process.start()
        theirs.close()
        self.pipe.recv()

    def end(self) -> None:
        """Ends the process."""
        self.process.kill()
        self.process.join()

    def __call__(self, name: str, number: int, seed: int) -> Outcome:
        """What comes of one case."""
        if self.done >= FRESH:
            self.end()
            self._begin()
            self.done = 0
        longest = LONGEST + MAKING + (IMPORTS if self.done == 0 else 0.0)
        self.done += 1
        self.pipe.send((name, number, seed))
        outcome: Outcome
        try:
            if answers(self.pipe, self.process.pid or 0, longest):
                outcome = self.pipe.recv()
                slow = outcome.seconds > LONGEST
                return Outcome("hangs", f"{LONGEST:g} s", outcome.seconds) if slow else outcome
            outcome = Outcome("hangs", f"{LONGEST:g} s without an answer", LONGEST)
        except EOFError:
            self.process.join()
            outcome = Outcome("dies", f"exit code {self.process.exitcode}")
        self.end()
        self._begin()
        self.done = 0
        return outcome


def answers(pipe: Connection, process: int, longest: float) -> bool:
    """Whether a process answers before it has used the processor for ``longest`` s, or slept that long in all."""
    begun, asleep = _used(process)[0], 0.0
    while not pipe.poll(TICK):
        used, awake = _used(process)
        asleep += 0.0 if awake else TICK
        if max(used - begun, asleep) > longest:
            return False
    return True


def _used(process: int) -> tuple[float, bool]:
    """s of the processor that a process has used, and whether it wants more of it now."""
    try:
        words = Path(f"/proc/{process}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    except OSError:
        return 0.0, False
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK"), words[0] == "R"


def fuzzed(names: list[str], cases: int, seed: int, jobs: int, seeds: Path) -> dict[str, Tally]:
    """Tallies by kind, of so many cases in all."""
    tallies = {name: Tally(name) for name in names}
    each, lock = -(-cases // len(names)), threading.Lock()
    # A worker for a stretch of one kind, so that it imports what that kind needs and no more.
    size = max(50, min(FRESH, -(-each // jobs)))
    stretches: Iterator[Any] = iter(
        [(name, range(i, min(i + size, each))) for i in range(0, each, size) for name in names]
    )

    def work() -> None:
        while True:
            with lock:
                stretch = next(stretches, None)
            if stretch is None:
                return
            name, numbers = stretch
            worker = Worker(seeds)
            for number in numbers:
                outcome = worker(name, number, seed)
                with lock:
                    tallies[name].add(number, outcome)
            worker.end()
            count = tallies[name].outcomes
            print(f"{name}: {count.total()} of {each} files: {dict(count)}", file=sys.stderr, flush=True)

    threads = [threading.Thread(target=work, daemon=True) for _ in range(jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return tallies


def fuzz(
    kinds: Annotated[Positional[tuple[str, ...]], arg(metavar="KIND")] = (),
    cases: int = 50_000,
    seed: int = 0,
    jobs: int = 2,
    seeds: Path | None = None,
    keep: Path | None = None,
) -> int:
    """Changes files at random and tells what came of reading them; nothing but results and clear errors is good.

    Args:
        kinds: dxf, svg, gcode, table, scenario, … Default: all.
        cases: files in all.
        seed: of the changes.
        jobs: processes.
        seeds: folder of the files that are changed, which is filled if it is not there. Further files put into its
            subfolders are changed too. Default: a temporary one.
        keep: folder into which a file of every problem is written.

    Returns:
        how many cases were problems.
    """
    wanted = script.known(kinds, TARGETS, "kind")
    with tempfile.TemporaryDirectory(prefix="kerfgym-seeds-") as temporary:
        where = seeds or Path(temporary) / "seeds"
        if not where.exists():
            make(where)
        tallies = fuzzed(wanted, cases, seed, jobs, where.resolve())
        for name, tally in tallies.items():
            for number, (words, numbers) in enumerate(tally.problems.items()):
                print(f"{name}: {len(numbers)} × {words}; the first is case {numbers[0]}")
                if keep is not None:
                    place = keep / f"{name}-{number}"
                    shutil.rmtree(place, ignore_errors=True)
                    place.mkdir(parents=True)
                    case(name, numbers[0], seed, where.resolve(), place)
    whole = Tally("all")
    for name, tally in tallies.items():
        whole.outcomes.update(tally.outcomes)
        for mine, every in ((tally.seconds, whole.seconds), (tally.bytes, whole.bytes)):
            every.update({f"{name} case {number}": value for number, value in mine.items()})
    rows = [
        [each.name, *each.counts, f"{max(each.seconds.values()):.1f}", f"{max(each.bytes.values()) / 1e6:.0f}"]
        for each in (*tallies.values(), whole)
    ]
    print(table(["kind", "files", "results", "clear errors", "problems", "longest, s", "most memory, MB"], rows))
    slow, large = (sorted(of.items(), key=lambda one: -one[1])[:TOLD] for of in (whole.seconds, whole.bytes))
    print(f"slowest, s of the processor: {', '.join(f'{case} {seconds:.1f}' for case, seconds in slow)}")
    print(f"most memory, MB: {', '.join(f'{case} {size / 1e6:.0f}' for case, size in large)}")
    return whole.counts[-1]


if __name__ == "__main__":
    script.run(fuzz, "kerfgym.experiments.studies.fuzz")
