"""``kerfgym tune`` of a controller from start to end."""

import math
import time
import warnings
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ..store import runs
from ..store.ledger import Ledger, ranges
from . import crew, goals, history, outcome, sampling, staged, storage
from .study import RollOuts, Task
from .work import done


@dataclass(frozen=True)
class Result:
    """What a command tells of its study."""

    task: Task
    found: outcome.Found
    front: list[outcome.Found]
    before: dict[str, Any]
    after: dict[str, Any]
    near: Any
    meta: dict[str, Any]


def check(task: Task, workers: int = 1) -> None:
    """Raises :class:`InvalidInput` for anything that the study could not be made of, before anything is written."""
    if task.suite not in scenarios.suites():
        raise InvalidInput(f"unknown suite '{task.suite}'; {did_you_mean(task.suite, scenarios.suites())}")
    for what, value in (("--trials", task.trials), ("--workers", workers), ("--seeds", task.seeds)):
        if value < 1:
            raise InvalidInput(f"{what} {value} is out of range; at least 1")
    if task.seeds > len(scenarios.SPLITS["tune"]):
        raise InvalidInput(f"--seeds {task.seeds} is out of range; split 'tune' has {len(scenarios.SPLITS['tune'])}")
    if task.seed < 0:
        raise InvalidInput(f"--seed {task.seed} is out of range; 0 and up")
    for name in (*task.metrics, *(limit.name for limit in task.limits.limits)):
        goals.metric(name, task.jobs)
    twice = [m for m in task.metrics if task.metrics.count(m) > 1]
    if twice:
        raise InvalidInput(f"metric '{twice[0]}' is given twice")
    if task.stages:
        staged.check(task.stages, task.trials, task.directions, workers, task.space)
    else:
        sampling.check(task.sampler, len(task.metrics))
    evaluator = task.evaluator()  # refuses what does not fit the suite
    if task.budget and task.budget < (one := evaluator.steps):
        raise InvalidInput(f"--budget of {task.budget:,} steps is out of range; one candidate takes {one:,}")
    _ = task.space


def tune(
    task: Task,
    folder: Path,
    workers: int = 1,
    threads: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    told: crew.Told = lambda finished, total, best: None,
    command: list[str] | None = None,
) -> Result:
    """Runs the study, or what is left of it, and writes the folder.

    Args:
        task: what is searched; without a URL its journal is kept in ``folder``.
        folder: of the run.
        workers: processes; with one, the same task gives the same trials.
        threads: of each process; the cores shared out among the workers unless told otherwise.
        overwrite, resume: as for :func:`runs.open_folder`.
        told: is told how many trials are over, of how many, and the best value.
        command: recorded in place of the process' own.

    Raises:
        InvalidInput: bad input, a storage or folder that cannot be used, or no candidate that keeps the limits.
    """
    check(task, workers)
    with crew.placed(task, folder, workers, threads, overwrite, resume) as (task, threads):
        started = time.time()
        work = crew.carried_out(task, workers, threads, told)
        return _finish(work, folder, workers, started, command, told)


def _finish(
    work: RollOuts, folder: Path, workers: int, started: float, command: list[str] | None, told: crew.Told
) -> Result:
    task, study = work.task, work.study
    over, _, best = task.state(study)
    told(over, over, f"{best} · now its neighbourhood and its score on test seeds")
    trials = done(study)
    table = outcome.frame(trials, task)
    runs.write_table(folder, "trials", table)
    searched = Ledger(
        sum(t.user_attrs.get("steps", 0) for t in trials), sum(t.user_attrs.get("cpu_seconds", 0.0) for t in trials)
    )
    searched.use(range(task.seeds))
    work.evaluator.ledger = Ledger()  # from here on: what choosing costs
    more: dict[str, Any] = {}
    if len(task.metrics) == 1:
        found, more, spent = outcome.best(work, trials)
        searched, front = searched + spent, [found]
    else:
        front = outcome.front(work, trials)
        found = outcome.middle(front, task)
    searched.check("tune")
    if task.relative:
        figures = work.evaluator.whole(found.controller, task.wanted)
        pooled = {name: goals.score(name, figures, work.evaluator.core) for name in task.wanted if name != "collision"}
        more["relative"] = {name: round(value, 4) for name, value in pooled.items()}
    near = outcome.sensitivity(work, found)
    before, _ = outcome.scored(work, work.base, work.evaluator.threads)
    after, _ = outcome.scored(work, found.controller, work.evaluator.threads)
    meta = runs.record(command)
    meta["packages"] |= {name: metadata.version(name) for name in ("optuna", "cmaes")}
    pruned = sum(t.state.name == "PRUNED" for t in trials)
    provenance = _provenance(work, meta, len(trials), pruned, searched) | more

    def full(candidate: outcome.Found) -> dict[str, Any]:
        values = dict(zip(task.metrics, candidate.values, strict=True))
        more = {"ms": round(candidate.ms, 4)} if math.isfinite(candidate.ms) else {}
        return {**provenance, "trial": candidate.number, **more, "tune": values}

    runs.write_table(folder, "sensitivity", near)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plots = history.write(folder, study, table, near, task, front)
    if len(front) > 1:
        for i, candidate in enumerate(front, 1):
            outcome.write(folder / "front" / f"{i:02d}.toml", task, candidate, full(candidate))
    final = {**full(found), "test": after, "test_before": before}
    outcome.write(folder / "tuned.toml", task, found, final)
    meta |= {
        "study": provenance["study"], "what": list(task.what), "space": [axis.words for axis in task.space.axes],
        "workers": workers, "wall_seconds": round(time.time() - started, 1),
        "tuned": {**final, "parameters": found.parameters}, "plots": plots, "front": len(front),
        "ledger": {
            "tuning": searched.entry(), "choosing": work.evaluator.ledger.entry(), "testing": work.validation.entry(),
        },
    }  # fmt: skip
    runs.write_json(folder / "run.json", _plain(meta))
    return Result(task, found, front, before, after, near, meta)


def _provenance(work: RollOuts, meta: dict[str, Any], trials: int, pruned: int, searched: Ledger) -> dict[str, Any]:
    task = work.task
    version = scenarios.rules(task.suite)["version"]
    limits: dict[str, Any] = {limit.name: limit.most for limit in task.limits.limits} | {"collisions": 0}
    if math.isfinite(task.limits.ms):
        limits["ms"] = task.limits.ms
    cost = searched.entry()
    return {
        "command": meta["command"], "kerfgym": meta["kerfgym"], "git": meta["git"].get("commit", "unknown"),
        "python": meta["python"], "optuna": meta["packages"]["optuna"], "study": storage.digest(task.words),
        "suite": f"{task.suite}-{version}", "metrics": list(task.metrics), "limits": limits,
        "sampler": staged.told(task.stages, task.trials) if task.stages else task.sampler,
        "sampler_seed": task.seed, "trials": trials, "pruned": pruned, "tune_seeds": ranges(range(task.seeds)),
        "simulated_steps": cost["simulated_steps"], "cpu_seconds": cost["cpu_seconds"],
        **({"budget": task.budget} if task.budget else {}),
        "start": dict(work.base.provenance),  # what the controller as it stood was tuned with
    }  # fmt: skip


def _plain(data: Any) -> Any:
    """Without numbers that JSON does not know."""
    if isinstance(data, dict):
        return {k: _plain(v) for k, v in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(v) for v in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data
