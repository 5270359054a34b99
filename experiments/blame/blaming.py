"""``kerfgym blame`` from start to end, and the part of it that a benchmark's report shows."""

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from ...envs.control.stack import Team, asked
from ...envs.engine.quantity import InvalidInput
from ...envs.scenarios import Scenario, machine_text
from ..measure.grids import Grid
from ..results.archive import UNFINISHED
from ..results.conclusions import REFERENCE, Results
from ..results.tasks import Case
from ..statistics.ranks import foremost
from ..store import runs
from ..store.ledger import Ledger
from ..store.progress import Told
from . import game
from . import shares as tables
from .game import Blame

SHOWN = ("rough", "step", "impulses")
"""Scenarios of which a report shows blame, if they were run: a shape, jumps, a disturbed sensor."""

SEEDS = 24
"""For a report."""


def blame(
    grid: Grid,
    folder: Path,
    stages: Sequence[str] = (),
    threads: int = 1,
    overwrite: bool = False,
    resume: bool = False,
    told: Told = lambda done, total, last: None,
    command: list[str] | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Blames every controller of a grid in every scenario, and writes the folder.

    Args:
        grid: controllers of any information class, scenarios, seeds.
        folder: of the run.
        stages: that are idealised; without any, all that the scenarios have.
        threads: worker threads; they change no figure.
        overwrite, resume: as for :func:`runs.open_folder`.
        told: is told how many episodes are done, of how many, and where it is.
        command: recorded in place of the process' own.

    Returns:
        Tables ``blame`` and ``headroom``, see :mod:`tables`.

    Raises:
        InvalidInput: bad input, before anything is written.
    """
    if threads < 1:
        raise InvalidInput(f"--threads {threads} is out of range; at least 1")
    teams = _named(grid.known())
    for scenario in grid.scenarios:
        game.check(scenario, stages)
    started, ledger = time.time(), Ledger()
    with runs.at_work(folder, overwrite, resume, spent=[UNFINISHED]):
        found = _all(teams, grid.scenarios, grid.seeds, stages, threads, folder / UNFINISHED, told, ledger)
        shares, headroom = tables.shares(found), tables.headroom(found)
        _write(folder, found, shares, headroom, grid.scenarios)
        meta = runs.record(command) | {"seeds": f"{min(grid.seeds)}-{max(grid.seeds)}", "seed_count": len(grid.seeds)}
        meta |= {"scenarios": [s.name for s in grid.scenarios], "controllers": list(grid.controllers)}
        meta |= {"stages": list(found[0].stages), "failed": sum(b.failed for b in found)}
        meta |= {"wall_seconds": round(time.time() - started, 1), "ledger": ledger.entry()}
        if grid.machine:
            runs.write_text(folder / "machine.toml", machine_text.text_of(grid.machine))
        meta |= {"cut_by": grid.machine.record | {"replaces": list(grid.given_up)}} if grid.machine else {}
        meta["parameters"] = {s.name: {k: p.value for k, p in s.parameters().items()} for s in teams}
        runs.write_json(folder / "run.json", meta)
    return shares, headroom


def in_report(
    results: Results,
    chosen: Sequence[Scenario],
    parts: Path,
    threads: int = 1,
    told: Told = lambda done, total, last: None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tables ``blame`` and ``headroom`` for a benchmark: the reference and the best of the class *sensor*.

    Both in the scenarios of :data:`SHOWN` that were run, or else in the first three; on the run's first :data:`SEEDS`
    seeds. Controllers in plain Python are left out: hundreds of their episodes would take minutes. So is C, which has
    a filter of its own.
    """
    sensor = foremost(results.standings)
    names = dict.fromkeys([*(n for n in (REFERENCE,) if n in sensor), *sensor[:1]])
    teams = _named({name: team for name in names if _quick(team := asked(name))})
    live = [s for s in chosen if not s.head.signal]
    shown = [s for s in live if s.name in SHOWN] or live[: len(SHOWN)]
    seeds = sorted(results.runs["seed"].unique())[:SEEDS]
    found = _all(teams, shown, seeds, (), threads, parts, told, Ledger())
    return tables.shares(found), tables.headroom(found)


def _quick(team: Team) -> bool:
    return team.z.python is None and not team.z.sealed


def _named(known: Mapping[str, Team]) -> list[Team]:
    """Controllers under the words by which they were asked for."""
    return [replace(team, name=name) for name, team in known.items()]


def _all(
    teams: Sequence[Team],
    chosen: Sequence[Scenario],
    seeds: Sequence[int],
    stages: Sequence[str],
    threads: int,
    parts: Path,
    told: Told,
    ledger: Ledger,
) -> list[Blame]:
    """Every controller in every scenario; what lies in ``parts`` already is not computed again."""
    pairs = [(scenario, team) for scenario in chosen for team in teams]
    found, done, total = [], 0, sum(game.episodes(*pair, len(seeds), stages) for pair in pairs)
    for scenario, team in pairs:
        where = f"{team.name} · {scenario.name}"

        def tell(more: int, where: str = where) -> None:
            nonlocal done
            done += more
            told(done, total, where)

        tell(0)
        key = _key(scenario, team, seeds, stages)
        if (file := parts / f"{key}.parquet").is_file():
            part = tables.of_coalitions(pd.read_parquet(file), team.name, game.check(scenario, stages))
            tell(game.episodes(scenario, team, len(seeds), stages))
        else:
            part = game.measure(scenario, team, seeds, stages, threads=threads, told=tell, ledger=ledger)
            runs.write_table(parts, key, pd.concat(map(tables.coalitions, part), ignore_index=True), csv=False)
        found += part
    return found


def _key(scenario: Scenario, team: Team, seeds: Sequence[int], stages: Sequence[str]) -> str:
    """Name of a part's file; it changes with anything that the part depends on."""
    case = Case(team.name, scenario, tuple(int(s) for s in seeds)).key(team)
    return hashlib.sha256(f"{case} {', '.join(stages)}".encode()).hexdigest()[:20]


def _write(
    folder: Path, found: list[Blame], shares: pd.DataFrame, headroom: pd.DataFrame, chosen: Sequence[Scenario]
) -> None:
    from ..plots.png import png
    from .panels import picture

    runs.write_table(folder, "blame", shares)
    runs.write_table(folder, "headroom", headroom)
    runs.write_table(folder, "coalitions", pd.concat(map(tables.coalitions, found), ignore_index=True), csv=False)
    for scenario in chosen:
        with runs.atomic(folder / "scenarios" / f"{scenario.name}.toml") as part:
            part.write_text(scenario.to_toml(), encoding="utf-8")
    with runs.atomic(folder / "blame.png") as part:
        part.write_bytes(png(picture(shares)))
