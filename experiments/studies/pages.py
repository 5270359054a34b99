"""Tables of the manual that a long run makes: the run writes them between two marks of a page::

    <!-- run: faults -->
    …
    <!-- end -->

What can be made from the code in a moment has other marks, and a test that it is not stale (:mod:`manual.docs`). What
takes minutes says beside the table with which command, version and commit it was made.
"""

import re
import time
from pathlib import Path
from typing import Any

from ...envs.engine.quantity import InvalidInput
from ..report.terminal import Sheet
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


class Cost:
    """What a campaign takes, from now on: wall time, and how many processes share it.

    The CPU time of worker processes is not seen from here, so it is not told.
    """

    def __init__(self, processes: int) -> None:
        self.processes, self._begun = processes, time.time()

    def record(self) -> dict[str, Any]:
        """For run.json, s."""
        return {"wall_seconds": round(time.time() - self._begun, 1), "processes": self.processes}


def origin(record: dict[str, Any], module: str) -> str:
    """Where a table comes from, in a sentence; ``record`` is that of a run, see :func:`runs.record`."""
    commit = (record.get("git") or {}).get("commit")
    changed = ", changed since" if (record.get("git") or {}).get("changed") else ""
    shared = f" on {record['processes']} processes" if record["processes"] > 1 else ""
    return (
        f"Made by `{record['command']}` (`{module}`), version {record['kerfgym']}"
        + (f", commit {commit[:10]}{changed}" if commit else "")
        + f", in {record['wall_seconds']:.0f} s{shared}."
    )


def publish(
    folder: Path, record: dict[str, Any], sheets: list[Sheet], module: str, mark: str | None, page: str = ""
) -> None:
    """Keeps a campaign's record, shows its tables, and writes them between ``mark`` of the manual's ``page``, if one is
    named."""
    runs.write_json(folder / "run.json", record)
    for sheet in sheets:
        sheet.show()
    if mark:
        put(mark, "\n\n".join([origin(record, module), *(sheet.markdown() for sheet in sheets)]), manual(page))
    print(f"\n{folder}")
