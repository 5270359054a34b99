"""Tables of the manual that a long run makes: the run writes them between two marks of a page::

    <!-- run: faults -->
    …
    <!-- end -->

What can be made from the code in a moment has other marks, and a test that it is not stale (:mod:`manual.docs`). What
takes minutes says beside the table with which command, version and commit it was made.
"""

import re
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...envs.engine.quantity import InvalidInput
from ..report.terminal import TextTable
from ..store import runs
from ..store.runs import atomic
from ..store.stamp import ROOT


def put(name: str, text: str, page: Path) -> None:
    """Writes ``text`` between the marks ``name`` of a page.

    Raises:
        InvalidInput: the page does not exist, or does not have the marks just once.
    """
    marked = re.compile(rf"(<!-- run: {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
    try:
        old = page.read_text(encoding="utf-8")
    except OSError as error:
        raise InvalidInput(f"cannot read '{page}': {error.strerror}") from None
    if len(marked.findall(old)) != 1:
        raise InvalidInput(f"{page}: needs '<!-- run: {name} -->' … '<!-- end -->' just once")
    new = marked.sub(lambda found: f"{found[1]}\n{text.strip()}\n\n{found[2]}", old)
    with atomic(page) as part:
        part.write_text(new, encoding="utf-8")


def manual(name: str) -> Path:
    """A page of the manual."""
    return ROOT / "docs" / name


class Campaign:
    """A run whose tables stand in the manual: command, folder, and what it takes from now on.

    The CPU time of worker processes is not seen from here, so it is not told.

    Args:
        module: as typed after ``python -m``.
        words: as typed after it.
        folder: of the run, open.
        processes: that share the work.
    """

    def __init__(self, module: str, words: Iterable[object], folder: Path, processes: int = 1) -> None:
        self.module, self.words, self.folder, self.processes = module, list(map(str, words)), folder, processes
        self._begun = time.time()

    def publish(
        self,
        sheets: list[TextTable],
        found: dict[str, Any],
        page: str,
        mark: str | None,
        documented: int | None = None,
        told: Iterable[str] = (),
    ) -> None:
        """Keeps the record, shows the tables, and writes the first of them into the manual.

        Args:
            sheets: the tables.
            found: for run.json.
            page: of the manual.
            mark: between which the tables are written there; none: nowhere.
            documented: so many tables; without a number, all.
            told: lines below the tables.
        """
        wall = round(time.time() - self._begun, 1)
        record = runs.record(["python", "-m", self.module, *self.words])
        record |= {"wall_seconds": wall, "processes": self.processes, **found}
        runs.write_json(self.folder / "run.json", record)
        for sheet in sheets:
            sheet.show()
        for line in told:
            print(line)
        if mark:
            parts = [origin(record, self.module), *(sheet.markdown() for sheet in sheets[:documented])]
            put(mark, "\n\n".join(parts), manual(page))
        print(f"\n{self.folder}")


def origin(record: dict[str, Any], module: str) -> str:
    """Where a table comes from, in a sentence; ``record`` is that of a run, see :func:`runs.record`."""
    git = record.get("git") or {}
    commit = f", commit {git['commit'][:10]}{', changed since' * bool(git.get('changed'))}" if git.get("commit") else ""
    shared = f" on {record['processes']} processes" if record["processes"] > 1 else ""
    return (
        f"Made by `{record['command']}` (`{module}`), version {record['kerfgym']}{commit}, in "
        f"{record['wall_seconds']:.0f} s{shared}."
    )
