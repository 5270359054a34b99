"""``kerfgym blame`` from start to end, and the part of it that a benchmark's report shows."""

import hashlib
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from ...envs.plant.quantity import InvalidInput
from ...envs.scenarios import Scenario
from ...envs.stack import Stack, resolve
from .. import runs
from ..bars import Told
from ..ledger import Ledger
from ..results import REFERENCE, Results
from ..tasks import Case
from . import game, tables
from .game import BOUNDS, STAGES, Blame

SHOWN = ("rough", "step", "impulses")
"""Scenarios of which a report shows blame, if they were run: a shape, jumps, a disturbed sensor."""

SEEDS = 24
"""For a report."""


def blame(
    controllers: Sequence[str],
    chosen: Sequence[Scenario],
    folder: Path,
    seeds: Sequence[int],
    stages: Sequence[str] = STAGES,
    threads: int = 1,
    overwrite: bool = False,
    resume: bool = False,
    told: Told = lambda done, total, last: None,
    command: list[str] | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Blames every controller in every scenario, and writes the folder.

    Args:
        controllers, chosen, seeds: as for a benchmark; any information class, without a job.
        folder: of the run.
        stages: some of ``game.STAGES``.
        threads: worker threads; they change no figure.
        overwrite, resume: as for :func:`runs.open_folder`.
        told: is told how many episodes are done, of how many, and where it is.
        command: recorded in place of the process' own.

    Returns:
        Tables ``blame`` and ``headroom``, see :mod:`tables`.

    Raises:
        InvalidInput: bad input, before anything is written.
    """
    for what, given in (("controller", list(controllers)), ("scenario", [s.name for s in chosen])):
        twice = [name for name in given if given.count(name) > 1]
        if twice:
            raise InvalidInput(f"{what} '{twice[0]}' is given twice")
    if threads < 1:
        raise InvalidInput(f"--threads {threads} is out of range; at least 1")
    stacks = [replace(resolve(name), name=name) for name in controllers]
    for stack in stacks:
        for scenario in chosen:
            game.check(scenario, stack, stages)
    runs.open_folder(folder, overwrite, resume)
    started, cpu = time.time(), time.process_time()
    found = _all(stacks, chosen, seeds, stages, threads, folder / "parts", told)
    shares, headroom = tables.shares(found), tables.headroom(found)
    _write(folder, found, shares, headroom, chosen)
    steps = sum(s.steps * (game.episodes(c, len(seeds), stages) + len(BOUNDS) * len(seeds))
                for c in stacks for s in chosen)  # fmt: skip
    meta = runs.record(command) | {
        "seeds": f"{min(seeds)}-{max(seeds)}", "seed_count": len(seeds), "scenarios": [s.name for s in chosen],
        "controllers": [s.name for s in stacks], "stages": list(stages), "failed": sum(b.failed for b in found),
        "wall_seconds": round(time.time() - started, 1),
        "ledger": Ledger(steps, time.process_time() - cpu).entry(),
        "parameters": {s.name: {k: p.value for k, p in s.parameters().items()} for s in stacks},
    }  # fmt: skip
    runs.write_json(folder / "run.json", meta)
    for file in (folder / "parts").iterdir():
        file.unlink()
    (folder / "parts").rmdir()
    return shares, headroom


def in_report(
    results: Results, chosen: Sequence[Scenario], parts: Path, threads: int = 1,
    told: Told = lambda done, total, last: None,
) -> tuple[pd.DataFrame, pd.DataFrame]:  # fmt: skip
    """Tables ``blame`` and ``headroom`` for a benchmark: the reference and the best of the class *sensor*.

    Both in the scenarios of :data:`SHOWN` that were run, or else in the first three; on the run's first :data:`SEEDS`
    seeds. Controllers in plain Python are left out: hundreds of their episodes would take minutes.
    """
    summary = results.summary()
    sensor = summary[(summary["information"] == "sensor") & (summary["failed"] == 0)]["score"].dropna()
    names = dict.fromkeys([*(n for n in (REFERENCE,) if n in sensor), *sensor.sort_values().index[:1]])
    stacks = [replace(stack, name=name) for name in names if (stack := resolve(name)).python is None]
    live = [s for s in chosen if not s.head.signal]
    shown = [s for s in live if s.name in SHOWN] or live[: len(SHOWN)]
    seeds = sorted(results.runs["seed"].unique())[:SEEDS]
    found = _all(stacks, shown, seeds, STAGES, threads, parts, told)
    return tables.shares(found), tables.headroom(found)


def _all(
    stacks: Sequence[Stack], chosen: Sequence[Scenario], seeds: Sequence[int], stages: Sequence[str], threads: int,
    parts: Path, told: Told,
) -> list[Blame]:  # fmt: skip
    """Every controller in every scenario; what lies in ``parts`` already is not computed again."""
    total, done, found = len(chosen) * sum(game.episodes(s, len(seeds), stages) for s in stacks), 0, []
    for scenario in chosen:
        for stack in stacks:
            where = f"{stack.name} · {scenario.name}"

            def tell(more: int, where: str = where) -> None:
                nonlocal done
                done += more
                told(done, total, where)

            tell(0)
            key = _key(scenario, stack, seeds, stages)
            if (file := parts / f"{key}.parquet").is_file():
                found.append(tables.of_coalitions(pd.read_parquet(file), stack.name, tuple(stages)))
                tell(game.episodes(stack, len(seeds), stages))
            else:
                found.append(game.measure(scenario, stack, seeds, stages, threads=threads, told=tell))
                runs.write_table(parts, key, tables.coalitions(found[-1]), csv=False)
    return found


def _key(scenario: Scenario, stack: Stack, seeds: Sequence[int], stages: Sequence[str]) -> str:
    """Name of a part's file; it changes with anything that the part depends on."""
    case = Case(stack.name, scenario, tuple(int(s) for s in seeds)).key(stack)
    return hashlib.sha256(f"{case} {', '.join(stages)}".encode()).hexdigest()[:20]


def _write(
    folder: Path, found: list[Blame], shares: pd.DataFrame, headroom: pd.DataFrame, chosen: Sequence[Scenario]
) -> None:
    from ..report.pictures import png
    from .picture import picture

    runs.write_table(folder, "blame", shares)
    runs.write_table(folder, "headroom", headroom)
    runs.write_table(folder, "coalitions", pd.concat(map(tables.coalitions, found), ignore_index=True), csv=False)
    for scenario in chosen:
        with runs.atomic(folder / "scenarios" / f"{scenario.name}.toml") as part:
            part.write_text(scenario.to_toml(), encoding="utf-8")
    with runs.atomic(folder / "blame.png") as part:
        part.write_bytes(png(picture(shares)))
