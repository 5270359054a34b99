"""``python -m kerfgym.experiments.fuzz``: changed files of every kind, read by workers under limits."""

import collections
import multiprocessing
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from .. import script
from ..markdown import table
from .seeds import make
from .targets import TARGETS, case
from .worker import MOST_MEMORY, Outcome, serve

LONGEST = 20.0
"""s of the processor after which a file counts as one that hangs."""

WAIT = 120.0
"""s after which no answer is one, too; on a busy machine twenty of the processor take longer."""

FRESH = 2000
"""Cases after which a worker is replaced: libraries keep what they have once taken."""


@dataclass
class Tally:
    """What came of the cases of a kind."""

    name: str
    outcomes: collections.Counter[str] = field(default_factory=collections.Counter)
    problems: dict[str, list[int]] = field(default_factory=dict)
    seconds: float = 0.0
    bytes: int = 0

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
        self.seconds, self.bytes = max(self.seconds, outcome.seconds), max(self.bytes, outcome.bytes)
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
        longest = WAIT + (60.0 if self.done == 0 else 0.0)  # the first has to import
        self.done += 1
        self.pipe.send((name, number, seed))
        start = time.monotonic()
        outcome: Outcome
        try:
            if self.pipe.poll(longest):
                outcome = self.pipe.recv()
                slow = outcome.seconds > LONGEST
                return Outcome("hangs", f"{LONGEST:g} s", outcome.seconds) if slow else outcome
            outcome = Outcome("hangs", f"{WAIT:g} s", time.monotonic() - start)
        except EOFError:
            self.process.join()
            outcome = Outcome("dies", f"exit code {self.process.exitcode}")
        self.end()
        self._begin()
        self.done = 0
        return outcome


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
    counts = {name: tally.counts for name, tally in tallies.items()}
    counts["all"] = tuple(sum(column) for column in zip(*counts.values(), strict=True))
    longest = {name: tally.seconds for name, tally in tallies.items()}
    most = {name: tally.bytes for name, tally in tallies.items()}
    longest["all"], most["all"] = max(longest.values()), max(most.values())
    rows = [[name, *counts[name], f"{longest[name]:.1f}", f"{most[name] / 1e6:.0f}"] for name in counts]
    print(table(["kind", "files", "results", "clear errors", "problems", "longest, s", "most memory, MB"], rows))
    return counts["all"][-1]


if __name__ == "__main__":
    script.run(fuzz, "kerfgym.experiments.fuzz")
