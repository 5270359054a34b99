"""``kerfgym report``: a run's report once more, or one of several runs together."""

import contextlib
from collections.abc import Sequence
from pathlib import Path

from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files
from ..results import archive, merge
from ..results.archive import Archive
from ..store import runs, typed
from ..store.progress import Bars
from . import summary


def remake(
    names: Sequence[str],
    into: Path | None = None,
    overwrite: bool = False,
    quiet: bool = False,
    command: list[str] | None = None,
) -> tuple[Path, Archive]:
    """Makes the report of stored runs.

    Args:
        names: run folders, or their names in ``runs/``.
        into: folder to write tables, record and report into; None, for one run only: its report replaces the old one.
        overwrite: replace the folder ``into``.
        quiet: no progress bars.
        command: recorded in place of the process' own.

    Returns:
        the folder and what is reported.

    Raises:
        InvalidInput: no run, one that does not exist, or none that can be read.
    """
    from .page import write_report

    folders = [_folder(name) for name in names]
    if not folders:
        there = ", ".join(sorted(file.parent.name for file in Path("runs").glob("*/run.json")))
        raise InvalidInput(f"name at least one run; {f'in runs/ there are {there}' if there else 'runs/ holds none'}")
    if into is None and len(folders) > 1:
        raise InvalidInput("several runs need a folder for their report")
    if into is not None and into.resolve() in [folder.resolve() for folder in folders]:
        raise InvalidInput(f"'{into}' is one of the runs themselves; use another --name")
    found, broken = _loaded(folders)
    if into is None:
        (joined,) = found
        folder = joined.folder
    else:
        joined = merge.merge(found, runs.record(command))
        joined.meta["notes"].extend(broken)
        folder = into
    alone = runs.at_work(folder, overwrite) if into is not None else contextlib.nullcontext()
    with alone, Bars(quiet) as bars, bars.busy("writing tables and report"):
        record = None
        if into is not None:
            record = archive.save_tables(folder, joined.grids, joined.meta, joined.texts)
        summary.write(folder, joined.grids, joined.meta)
        write_report(folder, joined.grids, joined.meta)
        if record:
            runs.write_json(folder / "run.json", record)
    return folder, joined


def _folder(name: str) -> Path:
    """The run folder of a path, or of a name in ``runs/``."""
    path = Path(name)
    return path if files.is_folder(path) or len(path.parts) > 1 else Path("runs") / name


def _loaded(folders: list[Path]) -> tuple[list[Archive], list[str]]:
    """The runs that can be read, and why others cannot.

    Raises:
        InvalidInput: a folder does not exist, or none can be read.
    """
    found, broken = [], []
    for folder in folders:
        try:
            found.append(archive.load(folder))
        except InvalidInput as error:
            if len(folders) == 1 or not files.is_folder(folder):
                raise
            broken.append(f"Left out: {error}.")
    if not found:
        raise InvalidInput(" ".join(broken))
    return found, broken


def tell(archive_: Archive) -> None:
    """Prints what a reader of the report must know."""
    for note in archive_.meta.get("notes", []):
        typed.say(f"note: {note}")
