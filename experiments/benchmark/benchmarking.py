"""Benchmark: controllers × scenarios × seeds in compiled roll-outs over the cores, then tables, plots and a report."""

import hashlib
import threading
import time
from pathlib import Path
from typing import Any

import pandas as pd

from ...envs import scenarios
from ...envs.control.stack import Team
from ...envs.engine import kernels
from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files
from ...envs.scenarios import Scenario, machine_text
from ...envs.tasks import workshop
from ..bounds import recorded
from ..measure import cost, plants
from ..measure.grids import Grid, resolved
from ..render import plans
from ..report import summary
from ..results import archive
from ..results.conclusions import Results, in_order
from ..results.tasks import Case, cases, compute
from ..store import pool, runs
from ..store.ledger import Ledger
from ..store.progress import Bars
from . import detuned
from .in_units import settings

_ALONE = threading.Lock()
"""A task of its process: workers of a dask cluster may have several threads, and the pool of heads is shared."""


def run(
    controllers: list[str],
    chosen: list[Scenario],
    folder: Path,
    seeds: range | tuple[int, ...],
    *,
    core: tuple[str, ...] = (),
    suite: str = "following",
    **options: Any,
) -> Results:
    """Runs one grid, see :func:`run_grids`; returns its results."""
    grid = Grid(suite, tuple(controllers), tuple(chosen), seeds, core)
    return run_grids([grid], folder, **options)[suite]


def run_grids(
    grids: list[Grid],
    folder: Path,
    *,
    with_ms: bool = True,
    with_cost: bool = False,
    with_blame: bool = False,
    with_detuned: bool = False,
    workers: int = 2,
    backend: str = "loky",
    scheduler: str | None = None,
    command: list[str] | None = None,
    overwrite: bool = False,
    resume: bool = False,
    quiet: bool = False,
) -> dict[str, Results]:
    """Runs the grids, writes the folder, returns the results by suite.

    Args:
        grids: of different suites.
        folder: of the run.
        with_ms: measure |S| and margins of height followers.
        with_cost: time their decisions.
        with_blame: ask what each stage of the machine costs reference and best (:mod:`blame`).
        with_detuned: ask how well the parameters of the best presets must be known (:mod:`detuned`).
        workers: processes.
        backend: of the processes, see :mod:`pool`.
        scheduler: address of a dask cluster.
        command: recorded in place of the process' own.
        overwrite, resume: as for :func:`runs.open_folder`.
        quiet: no progress bars.

    Raises:
        InvalidInput: unknown controller, scenario or backend, the folder exists, or a controller's file was edited
            meanwhile.
    """
    from ..blame import in_report
    from ..report.page import write_report

    pool.check(backend, workers, scheduler)
    known = {grid.suite: grid.known() for grid in grids}  # errors before anything is written
    started, parts = time.time(), folder / archive.UNFINISHED
    todo = {
        grid.suite: {
            case.key(known[grid.suite][case.controller]): case
            for case in cases(grid.controllers, grid.scenarios, grid.seeds, with_ms and not grid.with_jobs)
        }
        for grid in grids
    }
    record = runs.record(command) | {"kernel": kernels.STAMP}

    def missing() -> list[tuple[str, Case, Team]]:
        left = {
            key: (key, case, known[suite][case.controller])
            for suite, tasks in todo.items()
            for key, case in tasks.items()
            if not (parts / f"{key}.json").is_file()
        }
        return sorted(left.values(), key=lambda task: _quickness(*task[1:]))

    with runs.at_work(folder, overwrite, resume, spent=[archive.UNFINISHED]), Bars(quiet) as bars:
        teams = {(case.controller, case.with_job): team for _, case, team in missing()}
        for team in bars.each("compiling", teams.values(), len(teams)):
            _warm(team)
        tasks = [case for _, case, _ in missing()]
        done = pool.spread(_work, tasks, workers, backend, scheduler)
        for key, tables in bars.each("simulating", done, len(tasks)):
            for name, frame in tables.items():
                runs.write_table(parts, f"{key}.{name}", frame, csv=False)
            runs.write_json(parts / f"{key}.json", list(tables))
        if left := missing():
            edited = ", ".join(sorted({f"'{case.controller}'" for _, case, _ in left}))
            raise InvalidInput(f"{edited} was edited during the run; the same command computes what that has changed")

        record["wall_seconds"] = round(time.time() - started, 1)
        found = {
            grid.suite: _results(grid, known[grid.suite], _gathered(list(todo[grid.suite]), parts), record)
            for grid in grids
        }
        if with_cost:
            _time_decisions(found, known, bars)
        for grid in grids:
            results = found[grid.suite]
            if with_blame and not results.jobs:
                with bars.counted("blame") as told:
                    results.blame, results.headroom = in_report(results, grid.scenarios, parts, workers, told)
            if with_detuned and not results.jobs and grid.suite == detuned.SUITE:
                with bars.counted("one parameter 20 % off") as told:
                    results.detuned = detuned.in_report(results, workers, told)
        for cuts in {grid.machine for grid in grids if grid.machine}:
            runs.write_text(folder / "machine.toml", machine_text.text_of(cuts))
        texts = {grid.suite: {s.name: s.to_toml() for s in grid.scenarios} for grid in grids}
        with bars.busy("writing tables and report"):
            written = archive.save_tables(folder, found, record, texts)
            summary.write(folder, found, record)
            write_report(folder, found, record)
            runs.write_json(folder / "run.json", written)
    return found


def unwritten(grid: Grid, workers: int = 1) -> Results:
    """The results of one small grid, without Ms, and without a folder: whoever is interrupted begins anew."""
    known = grid.known()
    todo = cases(grid.controllers, grid.scenarios, grid.seeds, False)
    for team in {case.controller: known[case.controller] for case in todo}.values():
        _warm(team)
    tasks = sorted([(case.key(known[case.controller]), case) for case in todo], key=lambda task: task[0])
    tables: dict[str, list[pd.DataFrame]] = {}
    done = dict(pool.spread(_named, tasks, workers))
    for key, _ in tasks:  # in an order of their own: the tables are those of any number of workers
        for name, frame in done[key].items():
            tables.setdefault(name, []).append(frame)
    joined = {name: pd.concat(frames, ignore_index=True) for name, frames in tables.items()}
    return _results(grid, known, joined, {})


def _named(task: tuple[str, Case]) -> tuple[str, dict[str, pd.DataFrame]]:
    return task[0], _work(task[1])[1]


def _quickness(case: Case, team: Team) -> int:
    """Where a task comes: what takes longest goes first, so that the cores finish together."""
    return 0 if team.z.python else 1 if case.scenario is None else 2 if case.with_job else 3


def _gathered(keys: list[str], parts: Path) -> dict[str, pd.DataFrame]:
    """The tasks' tables, joined by name."""
    tables: dict[str, list[pd.DataFrame]] = {}
    for key in keys:
        for name in files.json_(parts / f"{key}.json"):
            part = files.checked(files.within(parts, f"{key}.{name}.parquet", "table"), files.NUMBERS)
            tables.setdefault(name, []).append(pd.read_parquet(part))
    return {name: pd.concat(frames, ignore_index=True) for name, frames in tables.items()}


def _results(grid: Grid, known: dict[str, Team], joined: dict[str, pd.DataFrame], record: dict[str, Any]) -> Results:
    names = [s.name for s in grid.scenarios]
    frame = in_order(joined["runs"], grid.controllers, names)
    ledger = joined["ledger"].groupby("controller", sort=False).sum()
    bounds = {s.name: each for s in grid.scenarios if (each := recorded(s))}
    spent = {name: Ledger(int(row["steps"]), float(row["cpu_seconds"])) for name, row in ledger.iterrows()}
    meta = record | {
        "seeds": f"{min(grid.seeds)}-{max(grid.seeds)}",
        "seed_count": len(grid.seeds),
        "scenarios": names,
        "controllers": list(grid.controllers),
        "core": list(grid.core),
        "plates": sorted({s.head.plate for s in grid.scenarios}),
        "corners": [s.name for s in grid.scenarios if s.corners],
        "bounds": {name: each.bound for name, each in bounds.items()},
        "linear": {name: each.linear for name, each in bounds.items() if each.linear is not None},
        "ledger": {name: each.entry() for name, each in spent.items()},
        "tuning": {name: team.provenance for name, team in known.items() if team.provenance},
        "programs": {name: _digest(team.program) for name, team in known.items()},
        "parameters": {name: {k: p.value for k, p in team.parameters().items()} for name, team in known.items()},
        "settings": {name: settings(name, team) for name, team in known.items()},
    }
    if grid.machine:
        meta["cut_by"] = grid.machine.record | {"replaces": list(grid.given_up)}
    if len(joined.get("margins", ())):
        meta["machines"] = {machine.label: names for machine, names in plants.machines(grid.scenarios).items()}
    core, summaries = tuple(c for c in grid.core if c in names), {s.name: s.summary for s in grid.scenarios}
    traces = joined.get("traces", pd.DataFrame())
    if grid.with_jobs:
        rules, materials = grid.rules, [workshop.material_of(s) for s in grid.scenarios]
        of_jobs: dict[str, Any] = {"jobs": True, "plans": plans.table(grid.scenarios)}
        of_jobs["metric"] = rules.get("score", "contour_rms")
        of_jobs["reference"] = rules.get("reference", "wu-tuned")
        of_jobs["labels"] = tuple(dict.fromkeys(m.label for m in materials))
        of_jobs["materials"] = tuple(dict.fromkeys((m.name, m.thickness) for m in materials))
        return Results(frame, traces, pd.DataFrame(), meta, core, (), summaries, **of_jobs)
    empty = pd.DataFrame({"controller": [], "frequency": [], "magnitude": []})
    exempt = tuple(s.name for s in grid.scenarios if s.exempt)
    sensitivity, margins = (joined.get(name, empty) for name in ("sensitivity", "margins"))
    return Results(frame, traces, sensitivity, meta, core, exempt, summaries, margins)


def _digest(program: list[str]) -> str:
    """What tells a controller's program from any other."""
    return hashlib.sha256("\n".join(program).encode()).hexdigest()[:16]


def _time_decisions(found: dict[str, Results], known: dict[str, dict[str, Team]], bars: Bars) -> None:
    """Times the followers' decisions one after another, when the cores are idle."""
    wanted = {name: team.z for each in known.values() for name, team in each.items() if len(team.stacks) == 1}
    timed: dict[str, dict[str, float | None]] = {
        name: {key: float(f"{value:.4g}") for key, value in cost.measure(stack)._asdict().items()}
        for name, stack in bars.each("timing decisions", wanted.items(), len(wanted))
        if not stack.sealed  # C decides elsewhere than a law does
    }
    timed |= {name: dict.fromkeys(cost.Decision._fields) for name in wanted if name not in timed}
    for suite, results in found.items():
        if not results.jobs:
            results.meta["decisions"] = {name: timed[name] for name in known[suite]}


def _warm(team: Team) -> None:
    """Compiles what is not in the cache yet, here and once, before the workers need it."""
    job = scenarios.Job(part="circle", size=5.0) if len(team.stacks) > 1 else None
    workshop.fleet_for(Scenario(name="warm", job=job), team, [0]).advance(1)


def _work(case: Case) -> tuple[str, dict[str, pd.DataFrame]]:
    """A task's tables, under the name that its team gives it here and now: what was edited meanwhile has another."""
    with _ALONE:
        team = resolved(case.controller, case.with_job)
        return case.key(team), compute(case, team)
