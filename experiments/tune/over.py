"""``kerfgym tune`` from start to end: what all studies have in common, whatever their trials are."""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

from optuna.trial import FrozenTrial
from rich.console import Console
from rich.table import Table

from ..store import runs
from ..store.ledger import Ledger
from . import crew, storage
from .work import Search, done, steps_of

R = TypeVar("R", bound="Result")


@dataclass(frozen=True)
class Result:
    """What a command tells of its study.

    Attributes:
        task: what was searched.
        meta: the run's record.
        file: with the best that was found.
    """

    task: Any
    meta: dict[str, Any]
    file: Path

    @property
    def files(self) -> list[Path]:
        """What the user is told of, last."""
        return [self.file]

    def tell(
        self, title: str, before: str, parameters: Iterable[tuple[str, ...]], figures: Iterable[tuple[str, ...]]
    ) -> None:
        """Prints what was found beside what was before; of each its name, its unit, and both."""
        table = Table(title=title)
        for column, side in (("", "left"), ("unit", "left"), (before, "right"), ("tuned", "right")):
            table.add_column(column, justify="left" if side == "left" else "right")
        for rows in (parameters, figures):
            for row in rows:
                table.add_row(*row)
            table.add_section()
        Console(width=max(Console().width, 100)).print(table)

    def tell_cost(self) -> None:
        """Prints what the search took."""
        cost = self.meta["ledger"]["tuning"]
        steps, seconds = cost["simulated_steps"], cost["cpu_seconds"]
        print(f"{steps:,} simulated steps, {seconds:.0f} CPU-s; study {self.meta['study']}")


def carry_out(
    task: Search,
    folder: Path,
    workers: int = 1,
    threads: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    told: crew.Told = lambda finished, total, best: None,
    command: list[str] | None = None,
    *,
    conclude: Callable[[Any, list[FrozenTrial], Ledger, dict[str, Any], dict[str, Any], crew.Told], R],
) -> R:
    """Runs the study, or what is left of it, and writes the folder.

    Args:
        task: what is searched; without a URL its journal is kept in ``folder``.
        folder: of the run.
        workers: processes; with one, the same task gives the same trials.
        threads: of each process; the cores shared out among the workers unless told otherwise.
        overwrite, resume: as for :func:`runs.open_folder`.
        told: is told how many trials are over, of how many, and the best value.
        command: recorded in place of the process' own.
        conclude: what comes of it. Is given this process' work, the trials, what they cost, the run's record, which it
            adds to, what every result says of where it comes from, and ``told``.

    Raises:
        InvalidInput: bad input, a storage or folder that cannot be used, or no trial that is good enough.
    """
    task.check(workers)
    with crew.placed(task, folder, workers, threads, overwrite, resume) as (task, threads):
        started = time.time()
        work = crew.carried_out(task, workers, threads, told)
        trials, meta = done(work.study), runs.record(command)
        meta["packages"] |= {name: metadata.version(name) for name in task.packages}
        origin = {key: meta[key] for key in ("command", "kerfgym")} | {"git": meta["git"].get("commit", "unknown")}
        origin |= {"python": meta["python"], "optuna": meta["packages"]["optuna"], "study": storage.digest(task.words)}
        spent = Ledger(steps_of(trials), sum(t.user_attrs.get("cpu_seconds", 0.0) for t in trials))
        result = conclude(work, trials, spent, meta, origin, told)
        meta |= {"study": origin["study"], "space": [axis.words for axis in task.space.axes]}
        meta |= {"workers": workers, "wall_seconds": round(time.time() - started, 1)}
        runs.write_json(folder / "run.json", _plain(meta))
        return result


def _plain(data: Any) -> Any:
    """Without numbers that JSON does not know."""
    if isinstance(data, dict):
        return {k: _plain(v) for k, v in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(v) for v in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data
