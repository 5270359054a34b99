"""``kerfgym tune ppo``: the search of a training's settings from start to end, and what it prints."""

import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import pandas as pd
import tomli_w
from matplotlib.figure import Figure
from optuna.trial import FrozenTrial, TrialState

from ...agents import settings as presets
from ...agents.evaluation import EPISODES
from ...agents.settings import ALGORITHMS, Settings
from ...agents.train import begun
from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ..store import runs
from ..store.ledger import Ledger
from . import crew, history, sampling, storage
from .hyper import REST
from .trainings import Trainings, TrainingTask, short_steps
from .work import done, feasible

TRIALS = 40
"""Of a search unless told otherwise; each costs a tenth of a training, or less if it is pruned."""


@dataclass(frozen=True)
class Learned:
    """What a command tells of its study."""

    task: TrainingTask
    best: FrozenTrial
    settings: Settings  # the best, for as many steps as the preset's
    file: Path
    meta: dict[str, Any]


def task(
    what: tuple[str, ...], env: str | None, steps: int | None, assignments: list[str], trials: int | None,
    sampler: str | None, seed: int, url: str | None, name: str | None, threads: int | None, others: list[str],
) -> TrainingTask:  # fmt: skip
    """The study that a user asks for.

    Args:
        what: the algorithm.
        env, steps, assignments, trials, sampler, seed, url, name, threads: as given, None for the default.
        others: options that were given and are for controllers only.

    Raises:
        InvalidInput: anything that no study can be made of.
    """
    if len(what) != 1:
        raise InvalidInput(f"one algorithm is tuned at a time, and nothing besides; known: {', '.join(ALGORITHMS)}")
    if others:
        raise InvalidInput(f"--{others[0]} is for controllers; the settings of {what[0]} are searched without")
    base = presets.preset(what[0], env or next(iter(presets.TASKS)), presets.parsed(assignments))
    return TrainingTask(
        base, short_steps(base) if steps is None else steps, sampler or "tpe",
        TRIALS if trials is None else trials, seed, name or "", url or "", 1 if threads is None else threads,
    )  # fmt: skip


def check(task: TrainingTask, workers: int = 1) -> None:
    """Raises :class:`InvalidInput` for anything that the study could not be made of, before anything is written."""
    for what, value in (
        ("--trials", task.trials), ("--steps", task.steps), ("--workers", workers), ("--threads", task.threads),
    ):  # fmt: skip
        if value < 1:
            raise InvalidInput(f"{what} {value} is out of range; at least 1")
    sampling.check(task.sampler, 1)
    begun(task.short(task.base), Path(), task.seed, threads=task.threads)  # writes nothing


def tune(
    task: TrainingTask,
    folder: Path,
    workers: int = 1,
    overwrite: bool = False,
    resume: bool = False,
    told: crew.Told = lambda finished, total, best: None,
    command: list[str] | None = None,
) -> Learned:
    """Runs the study, or what is left of it, and writes the folder.

    Args:
        task: what is searched; without a URL its journal is kept in ``folder``.
        folder: of the run.
        workers: processes; with one, the same task gives the same trials.
        overwrite, resume: as for :func:`runs.open_folder`.
        told: is told how many trials are over, of how many, and the best value.
        command: recorded in place of the process' own.

    Raises:
        InvalidInput: bad input, a storage or folder that cannot be used, or no training that ended well.
    """
    check(task, workers)
    task = replace(task, folder=str(folder))
    with crew.placed(task, folder, workers, task.threads, overwrite, resume) as (task, threads):
        started = time.time()
        work = crew.carried_out(task, workers, threads, told)
        return _finish(work, folder, workers, started, command)


def frame(trials: list[FrozenTrial]) -> pd.DataFrame:
    """One row per trial."""
    rows = []
    for trial in trials:
        well = feasible(trial)
        state = "complete" if well else "failed" if trial.state == TrialState.COMPLETE else "pruned"
        rows.append({
            "trial": trial.number, "state": state, "feasible": well, "score": trial.values[0] if well else float("nan"),
            **{key: trial.user_attrs.get(key) for key in ("steps", "training_steps", "cpu_seconds", "error")},
            **trial.params,
        })  # fmt: skip
    return pd.DataFrame(rows)


def _finish(work: Trainings, folder: Path, workers: int, started: float, command: list[str] | None) -> Learned:
    task, trials = work.task, done(work.study)
    table = frame(trials)
    runs.write_table(folder, "trials", table)
    good = [t for t in trials if feasible(t)]
    if not good:
        raise InvalidInput(
            f"none of {len(trials)} trainings ended with a finite score; trials.csv in '{folder}' says why. "
            "--resume with more --trials, or other --set"
        )
    best = min(good, key=lambda t: (t.values[0], t.number))
    settings = task.settings(best.number, best.params)
    spent = Ledger(sum(t.user_attrs["steps"] for t in trials), sum(t.user_attrs["cpu_seconds"] for t in trials))
    spent.use(range(task.base.evaluation.get("episodes", EPISODES)))
    spent.check("tune")
    cost, meta, counts = spent.entry(), runs.record(command), table["state"].value_counts()
    meta["packages"] |= {name: metadata.version(name) for name in ("optuna", "stable-baselines3", "torch")}
    first = next((t.values[0] for t in good if t.number == 0), None)
    provenance = {
        "command": meta["command"], "kerfgym": meta["kerfgym"], "git": meta["git"].get("commit", "unknown"),
        "python": meta["python"], "optuna": meta["packages"]["optuna"], "study": storage.digest(task.words),
        "trial": best.number, "score_tune": best.values[0], **({} if first is None else {"score_tune_preset": first}),
        "trial_steps": task.steps, "sampler": task.sampler, "seed": task.seed, "trials": len(trials),
        "pruned": int(counts.get("pruned", 0)), "failed": int(counts.get("failed", 0)),
        "tune_seeds": cost["seeds"]["tune"], "simulated_steps": cost["simulated_steps"],
        "cpu_seconds": cost["cpu_seconds"],
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plots = history.written(folder, _pictures(work, table))
    file = folder / f"{task.base.name}.toml"
    head = f"# kerfgym train {task.base.name} --preset {file.as_posix()}\n"
    with runs.atomic(file) as part:
        part.write_text(head + tomli_w.dumps({**settings.plain(), presets.PROVENANCE: provenance}), encoding="utf-8")
    cost["seeds"]["train"] = f"from {scenarios.SPLITS['train'].start}"
    cost["training_steps"] = sum(t.user_attrs["training_steps"] for t in trials)
    meta |= {
        "kind": "tune", "algorithm": task.base.name, "env": task.base.env, "study": provenance["study"],
        "space": [axis.words for axis in task.hyper.space.axes], "workers": workers, "threads": task.threads,
        "wall_seconds": round(time.time() - started, 1), "tuned": {**provenance, "parameters": best.params},
        "settings": settings.flat(), "plots": plots, "ledger": {"tuning": cost},
    }  # fmt: skip
    runs.write_json(folder / "run.json", meta)
    return Learned(task, best, settings, file, meta)


def _pictures(work: Trainings, table: pd.DataFrame) -> Iterator[tuple[str, Figure]]:
    task = work.task
    title = f"{task.base.name} on {task.base.env}"
    text = "score on tune seeds" + " (µm)" * task.height
    yield "history", history.history(table, title, "score", text)
    yield "slices", history.slices(table, title, task.hyper.space.axes, "score", text, {})
    shares = history.importances(work.study, title, "the score")
    if shares is not None:
        yield "importances", shares


def show(result: Learned) -> None:
    """Prints what was found and what it cost."""
    from rich.console import Console
    from rich.table import Table

    task, about = result.task, result.meta["tuned"]
    table = Table(title=f"{task.base.name} on {task.base.env} · {about['trials']} trials of {task.steps} steps")
    for title in ("", "preset", "tuned"):
        table.add_column(title, justify="right" if title else "left")
    for name in task.hyper.space.start:
        key = name.removeprefix(REST)
        table.add_row(key, *(_word(settings.value(key)) for settings in (task.base, result.settings)))
    table.add_section()
    before = about.get("score_tune_preset")
    table.add_row("score, tune seeds", "failed" if before is None else f"{before:.4g}", f"{about['score_tune']:.4g}")
    console = Console(width=max(Console().width, 100))
    console.print(table)
    if result.best.number == 0:
        print("no trial was better than the preset")
    if about["failed"]:
        print(f"{about['failed']} of {about['trials']} trainings failed; trials.csv says why")
    cost = result.meta["ledger"]["tuning"]
    print(f"{cost['simulated_steps']:,} simulated steps, {cost['cpu_seconds']:.0f} CPU-s; study {about['study']}")


def _word(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)
