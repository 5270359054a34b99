"""Benchmark: controllers × scenarios × seeds in compiled roll-outs over the cores, then tables, plots and a report."""

import hashlib
import json
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .. import __version__
from ..envs import metrics, scenarios, workshop
from ..envs import stack as stacks
from ..envs.plant import kernels, machine
from ..envs.plant.controller import PERIOD
from ..envs.plant.path import SPACING
from ..envs.plant.quantity import InvalidInput, did_you_mean
from ..envs.scenarios import Scenario
from . import archive, decisions, jobs, margins, rollout, runs, stability
from .ledger import Ledger
from .results import Results

DEFAULT = ("xi2023-ma", "xi2023-improved", "xi2023-tuned", "pid", "observer", "preview-5ms")
"""Controllers of the standard benchmark."""

SEEDS_PER_TASK = 100
PATH_SEEDS = 20
"""Seeds along a drawing, unless told otherwise: its journeys are long."""


@dataclass(frozen=True)
class Case:
    """One task: a controller on some seeds of a scenario; without a scenario, its |S| and its margins."""

    controller: str
    scenario: Scenario | None
    seeds: tuple[int, ...]
    trace: int | None

    def key(self, stack: stacks.Stack | stacks.Team) -> str:
        """Name of the task's file when ``stack`` does it; it changes with anything the result depends on."""
        parameters = {name: p.value for name, p in stack.parameters().items()}
        physics = self.scenario.to_toml() if self.scenario else None
        program = [__version__, kernels.STAMP, *stack.program]
        text = json.dumps([self.controller, parameters, program, physics, self.seeds, self.trace])
        return hashlib.sha256(text.encode()).hexdigest()[:20]


def split_seeds(count: int, split: str = "test") -> range:
    """The first ``count`` seeds of a split.

    Raises:
        InvalidInput: unknown split, or more seeds than it has.
    """
    if split not in scenarios.SPLITS:
        raise InvalidInput(f"unknown split '{split}'; {did_you_mean(split, scenarios.SPLITS)}")
    seeds = scenarios.SPLITS[split]
    if not 1 <= count <= len(seeds):
        raise InvalidInput(f"--seeds {count} is out of range; split '{split}' has {len(seeds)}")
    return seeds[:count]


def along(path: Path, names: list[str], suite: str) -> list[Scenario]:
    """Scenarios along a drawing: the suite's (or the named) ones with the drawing as their part or path.

    Raises:
        InvalidInput: the drawing cannot be read, or lies outside what scenario and machine allow.
    """
    found = [scenarios.load(s) for s in names] or [scenarios.load(scenarios.rules(suite).get("along", "drawing"))]
    return [
        s.varied(name=f"{s.name}@{path.stem}", job={"part": str(path), "size": 0.0}) if s.job else s.along(path)
        for s in found
    ]


def compute(case: Case, stack: stacks.Stack | stacks.Team) -> dict[str, pd.DataFrame]:
    """Tables ``runs``, ``traces``, ``sensitivity`` and ``margins`` of one task, with its cost in ``ledger``."""
    if isinstance(stack, stacks.Team):
        assert case.scenario is not None
        return jobs.compute(case.controller, case.scenario, stack, case.seeds, case.trace)
    start, steps = time.process_time(), 0
    tables: dict[str, pd.DataFrame] = {}
    if case.scenario is None:
        found, room = stability.sensitivity(stack), margins.Bench(stack).measure(stack)
        steps = found.steps + room.steps
        tables["sensitivity"] = pd.DataFrame(
            {"controller": case.controller, "frequency": found.frequencies, "magnitude": found.worst}
        )
        tables["margins"] = pd.DataFrame(
            {"controller": [case.controller], "gain": [room.gain], "delay_ms": [room.delay_ms]}
        )
    else:
        record = rollout.roll(case.scenario, stack, case.seeds)
        steps = case.scenario.steps * len(case.seeds)
        frame = pd.DataFrame(metrics.evaluate(record))
        frame.insert(0, "controller", case.controller)
        frame.insert(1, "information", stack.information)
        frame.insert(2, "scenario", case.scenario.name)
        frame.insert(3, "seed", case.seeds)
        frame.insert(4, "failed", metrics.failed(record))
        tables["runs"] = frame
        if case.trace is not None and case.trace in case.seeds:
            tables["traces"] = _trace(case, record, case.seeds.index(case.trace))
    cost = {"controller": case.controller, "steps": steps, "cpu_seconds": time.process_time() - start}
    tables["ledger"] = pd.DataFrame([cost])
    return tables


def _trace(case: Case, record: Any, index: int) -> pd.DataFrame:
    """Every period of one run, with its place in the drawing if there is one."""
    assert case.scenario is not None
    frame = pd.DataFrame(record.data[:, :, index], columns=list(machine.CHANNELS))
    frame.insert(0, "controller", case.controller)
    frame.insert(1, "scenario", case.scenario.name)
    frame.insert(2, "seed", case.seeds[index])
    frame.insert(3, "time", (np.arange(len(frame)) + 1) * PERIOD)
    frame["set_height"] = record.set_height[index]
    frame["scored"] = record.scored[:, index].astype(np.float32)
    contour = scenarios.journey(case.scenario)
    if contour:
        along = np.arange(len(contour.x)) * SPACING
        frame["x"] = np.interp(frame["distance"], along, contour.x)
        frame["y"] = np.interp(frame["distance"], along, contour.y)
    return frame


def cases(controllers: list[str], chosen: list[Scenario], seeds: range | tuple[int, ...], with_ms: bool) -> list[Case]:
    """All tasks; the longest first, so that the cores finish together."""
    out = [Case(c, None, (), None) for c in controllers] if with_ms else []
    for scenario in chosen:
        for controller in controllers:
            for part in rollout.chunks(seeds, SEEDS_PER_TASK):
                out.append(Case(controller, scenario, tuple(int(s) for s in part), int(seeds[0])))
    return out


@dataclass(frozen=True)
class Grid:
    """What fills one table of a benchmark: controllers × scenarios × seeds.

    The suite gives its name, the metric of its score and its reference; ``core`` are the scenarios that make the score.
    """

    suite: str
    controllers: tuple[str, ...]
    scenarios: tuple[Scenario, ...]
    seeds: range | tuple[int, ...]
    core: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for what, given in (("controller", self.controllers), ("scenario", tuple(s.name for s in self.scenarios))):
            twice = [name for name in given if given.count(name) > 1]
            if twice:
                raise InvalidInput(f"{what} '{twice[0]}' is given twice")
        if not self.with_jobs and any(s.job for s in self.scenarios):
            raise InvalidInput("scenarios with a job and scenarios without one cannot share a table")

    @property
    def with_jobs(self) -> bool:
        """Whether its scenarios are jobs, which take teams."""
        return all(s.job is not None for s in self.scenarios)

    def resolved(self) -> dict[str, stacks.Stack | stacks.Team]:
        """Its controllers by the words that name them.

        Raises:
            InvalidInput: unknown, of another slot, or unable to do one of the jobs.
        """
        known = {name: _resolved(name, self.with_jobs) for name in self.controllers}
        for stack in known.values():
            if isinstance(stack, stacks.Team):
                for scenario in self.scenarios:
                    workshop.programme(scenario, stack)
        return known


def run(
    controllers: list[str],
    chosen: list[Scenario],
    folder: Path,
    seeds: range | tuple[int, ...],
    *,
    core: tuple[str, ...] = (),
    suite: str = "following",
    **options: Any,
) -> Results | jobs.JobResults:
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
    workers: int = 2,
    command: list[str] | None = None,
    overwrite: bool = False,
    resume: bool = False,
    quiet: bool = False,
) -> dict[str, Results | jobs.JobResults]:
    """Runs the grids, writes the folder, returns the results by suite.

    Args:
        grids: of different suites.
        folder: of the run.
        with_ms: measure |S| and margins of height followers.
        with_cost: time their decisions.
        with_blame: ask what each stage of the machine costs reference and best (:mod:`blame`).
        workers: processes.
        command: recorded in place of the process' own.
        overwrite, resume: as for :func:`runs.open_folder`.
        quiet: no progress bar.

    Raises:
        InvalidInput: unknown controller or scenario, the folder exists, or a controller's file was edited meanwhile.
    """
    from .blame import in_report
    from .report.page import write_report
    from .table import progress

    if workers < 1:
        raise InvalidInput(f"--jobs {workers} is out of range; at least 1")
    known = {grid.suite: grid.resolved() for grid in grids}  # errors before anything is written
    runs.open_folder(folder, overwrite, resume)
    started = time.time()
    parts = folder / "parts"
    todo = {
        grid.suite: {
            case.key(known[grid.suite][case.controller]): case
            for case in cases(list(grid.controllers), list(grid.scenarios), grid.seeds, with_ms and not grid.with_jobs)
        }
        for grid in grids
    }

    def missing() -> dict[str, tuple[Case, stacks.Stack | stacks.Team]]:
        return {
            key: (case, known[suite][case.controller])
            for suite, tasks in todo.items()
            for key, case in tasks.items()
            if not (parts / f"{key}.json").is_file()
        }

    _warm({(case.controller, type(stack)): stack for case, stack in missing().values()}.values())
    _run_all([case for case, _ in missing().values()], parts, workers, quiet)
    if left := missing():
        edited = ", ".join(sorted({f"'{case.controller}'" for case, _ in left.values()}))
        raise InvalidInput(f"{edited} was edited during the run; --resume computes what the edit has changed")

    meta = runs.record(command) | {"wall_seconds": round(time.time() - started, 1)}
    found = {
        grid.suite: _results(grid, known[grid.suite], _gathered(list(todo[grid.suite]), parts), meta, with_cost)
        for grid in grids
    }
    for grid in grids:
        results = found[grid.suite]
        if with_blame and isinstance(results, Results):
            with progress("blame", quiet) as told:
                results.blame, results.headroom = in_report(results, grid.scenarios, parts, workers, told)
    record = archive.save_tables(folder, found, meta, {grid.suite: grid.scenarios for grid in grids})
    write_report(folder, found, meta)
    runs.write_json(folder / "run.json", record)
    _clear(parts)
    return found


def _gathered(keys: list[str], parts: Path) -> dict[str, pd.DataFrame]:
    """The tasks' tables, joined by name."""
    tables: dict[str, list[pd.DataFrame]] = {}
    for key in keys:
        for name in json.loads((parts / f"{key}.json").read_text(encoding="utf-8")):
            tables.setdefault(name, []).append(pd.read_parquet(parts / f"{key}.{name}.parquet"))
    return {name: pd.concat(frames, ignore_index=True) for name, frames in tables.items()}


def _results(
    grid: Grid, known: dict[str, stacks.Stack | stacks.Team], joined: dict[str, pd.DataFrame], meta: dict[str, Any],
    with_cost: bool,
) -> Results | jobs.JobResults:  # fmt: skip
    names = [s.name for s in grid.scenarios]
    frame = joined["runs"].sort_values("seed", kind="stable")
    for column, order in (("scenario", names), ("controller", grid.controllers)):
        frame = frame.sort_values(column, key=lambda c, order=order: c.map(order.index), kind="stable")
    frame = frame.reset_index(drop=True)
    ledger = joined["ledger"].groupby("controller", sort=False).sum()
    meta = meta | {
        "seeds": f"{min(grid.seeds)}-{max(grid.seeds)}", "seed_count": len(grid.seeds), "scenarios": names,
        "controllers": list(grid.controllers), "core": list(grid.core),
        "ledger": {
            name: Ledger(int(row["steps"]), float(row["cpu_seconds"])).entry() for name, row in ledger.iterrows()
        },
        "tuning": {name: stack.provenance for name, stack in known.items() if stack.provenance},
        "parameters": {name: {k: p.value for k, p in stack.parameters().items()} for name, stack in known.items()},
    }  # fmt: skip
    core, summaries = tuple(c for c in grid.core if c in names), {s.name: s.summary for s in grid.scenarios}
    traces = joined.get("traces", pd.DataFrame())
    if grid.with_jobs:
        rules, materials = scenarios.rules(grid.suite), [workshop.material_of(s) for s in grid.scenarios]
        return jobs.JobResults(
            frame, traces, meta, rules.get("score", "contour_rms"), rules.get("reference", "wu-tuned"), core,
            tuple(dict.fromkeys(m.label for m in materials)),
            tuple(dict.fromkeys((m.name, m.thickness) for m in materials)), summaries,
        )  # fmt: skip
    if with_cost:  # one after another, when the cores are idle
        meta["decisions"] = {
            name: {key: float(f"{value:.4g}") for key, value in decisions.measure(stack)._asdict().items()}
            for name, stack in known.items()
            if isinstance(stack, stacks.Stack)
        }
    empty = pd.DataFrame({"controller": [], "frequency": [], "magnitude": []})
    return Results(
        frame, traces, joined.get("sensitivity", empty), meta, core,
        tuple(s.name for s in grid.scenarios if s.exempt), summaries, joined.get("margins", pd.DataFrame()),
    )  # fmt: skip


def _clear(parts: Path) -> None:
    for file in parts.iterdir():
        file.unlink()
    parts.rmdir()


def _resolved(name: str, with_jobs: bool) -> stacks.Stack | stacks.Team:
    """The controller of a name: a team for jobs, a stack of the slot ``z`` for followers."""
    if with_jobs:
        return stacks.team(name)
    stack = stacks.resolve(name)
    if stack.slot != "z":
        raise InvalidInput(
            f"controller '{name}' drives slot '{stack.slot}'; scenarios without a job need one of slot 'z', such as pid"
        )
    return stack


def _warm(needed: Iterable[stacks.Stack | stacks.Team]) -> None:
    """Compiles what is not in the cache yet, here and once, before the workers need it."""
    flat = Scenario(name="warm", duration=0.05, settle=0.0)
    job = scenarios.Scenario(name="warm", job=scenarios.Job(part="circle", size=5.0))
    for stack in needed:
        if isinstance(stack, stacks.Team):
            workshop.fleet_for(job, stack, [0]).advance(1)
        else:
            rollout.roll(flat, stack, [0])


def _work(case: Case, parts: Path) -> None:
    stack = _resolved(case.controller, case.scenario is not None and case.scenario.job is not None)
    key, tables = case.key(stack), compute(case, stack)
    for name, frame in tables.items():
        runs.write_table(parts, f"{key}.{name}", frame, csv=False)
    runs.write_json(parts / f"{key}.json", list(tables))


def _run_all(missing: list[Case], parts: Path, workers: int, quiet: bool) -> None:
    from joblib import Parallel, delayed
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, disable=quiet) as progress:
        bar = progress.add_task("simulating", total=len(missing))
        if workers == 1 or len(missing) <= 2:
            for case in missing:
                _work(case, parts)
                progress.advance(bar)
        elif missing:
            pool = Parallel(n_jobs=workers, return_as="generator_unordered", inner_max_num_threads=1)
            for _ in pool(delayed(_work)(case, parts) for case in missing):
                progress.advance(bar)
