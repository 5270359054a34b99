"""``kerfgym tune ppo``: the search of a training's settings, what comes of it, and what is printed of that."""

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
import tomli_w
from matplotlib.figure import Figure
from optuna.trial import FrozenTrial, TrialState

from ...agents import settings as presets
from ...agents.evaluation import EPISODES
from ...agents.settings import ALGORITHMS, Settings
from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ..store import runs
from ..store.ledger import Ledger
from . import history, over
from .crew import Told
from .hyper import REST
from .trainings import Trainings, TrainingTask, short_steps
from .work import feasible

TRIALS = 40
"""Of a search unless told otherwise; each costs a tenth of a training, or less if it is pruned."""


@dataclass(frozen=True)
class Learned(over.Result):
    """What a command tells of its study; ``settings`` are the best, for as many steps as the preset's."""

    best: FrozenTrial
    settings: Settings

    def show(self) -> None:
        """Prints what was found and what it cost."""
        task, about = self.task, self.meta["tuned"]
        keys = [name.removeprefix(REST) for name in task.space.start]
        parameters = [(key, "", _word(task.base.value(key)), _word(self.settings.value(key))) for key in keys]
        before = about.get("score_tune_preset")
        shown = "failed" if before is None else f"{before:.4g}", f"{about['score_tune']:.4g}"
        title = f"{task.base.name} on {task.base.env} · {about['trials']} trials of {task.steps} steps"
        self.tell(title, "preset", parameters, [("score, tune seeds", "µm" * task.height, *shown)])
        if self.best.number == 0:
            print("no trial was better than the preset")
        if about["failed"]:
            print(f"{about['failed']} of {about['trials']} trainings failed; trials.csv says why")
        self.tell_cost()


def task(
    what: tuple[str, ...],
    env: str | None,
    steps: int | None,
    assignments: list[str],
    trials: int | None,
    sampler: str | None,
    seed: int,
    url: str | None,
    name: str | None,
    threads: int | None,
    others: list[str],
    more: dict[str, Any] | None = None,
) -> TrainingTask:
    """The study that a user asks for.

    Args:
        what: the algorithm.
        env, steps, assignments, trials, sampler, seed, url, name, threads: as given, None for the default.
        others: options that were given and are for controllers only.
        more: further settings.

    Raises:
        InvalidInput: anything that no study can be made of.
    """
    if len(what) != 1:
        raise InvalidInput(f"one algorithm is tuned at a time, and nothing besides; known: {', '.join(ALGORITHMS)}")
    if others:
        raise InvalidInput(f"--{others[0]} is for controllers; the settings of {what[0]} are searched without")
    base = presets.preset(what[0], env or next(iter(presets.TASKS)), presets.parsed(assignments) | (more or {}))
    steps, trials = short_steps(base) if steps is None else steps, TRIALS if trials is None else trials
    whole = TrainingTask(base, steps, 1 if threads is None else threads, trials=trials, seed=seed)
    return replace(whole, sampler=sampler or "tpe", name=name or "", url=url or "")


def frame(trials: list[FrozenTrial]) -> pd.DataFrame:
    """One row per trial."""
    rows = []
    for trial in trials:
        well = feasible(trial)
        state = "complete" if well else "failed" if trial.state == TrialState.COMPLETE else "pruned"
        row = {"trial": trial.number, "state": state, "feasible": well, "score": trial.values[0] if well else math.nan}
        row |= {key: trial.user_attrs.get(key) for key in ("steps", "training_steps", "cpu_seconds", "error")}
        rows.append(row | trial.params)
    return pd.DataFrame(rows)


def concluded(
    work: Trainings, trials: list[FrozenTrial], spent: Ledger, meta: dict[str, Any], origin: dict[str, Any], told: Told
) -> Learned:
    """The best settings, written into the run's folder.

    Raises:
        InvalidInput: no training ended well.
    """
    task, folder, table = work.task, Path(work.task.folder), frame(trials)
    runs.write_table(folder, "trials", table)
    good = [t for t in trials if feasible(t)]
    if not good:
        raise InvalidInput(
            f"none of {len(trials)} trainings ended with a finite score; trials.csv in '{folder}' says why. "
            "--resume with more --trials, or other --set"
        )
    best = min(good, key=lambda t: (t.values[0], t.number))
    settings = task.settings(best.number, best.params)
    spent.use(range(task.base.evaluation.get("episodes", EPISODES)))
    spent.check("tune")
    cost, counts = spent.entry(), table["state"].value_counts()
    first = next((t.values[0] for t in good if t.number == 0), None)
    provenance = {**origin, "trial": best.number, "score_tune": best.values[0]}
    provenance |= {} if first is None else {"score_tune_preset": first}
    provenance |= {"trial_steps": task.steps, "sampler": task.sampler, "seed": task.seed, "trials": len(trials)}
    provenance |= {"pruned": int(counts.get("pruned", 0)), "failed": int(counts.get("failed", 0))}
    provenance["tune_seeds"] = cost["seeds"]["tune"]
    provenance |= {key: cost[key] for key in ("simulated_steps", "cpu_seconds")}
    plots = history.written(folder, _pictures(work, table))
    file = folder / f"{task.base.name}.toml"
    head = f"# kerfgym train {task.base.name} --preset {file.as_posix()}\n"
    runs.write_text(file, head + tomli_w.dumps({**settings.plain(), presets.PROVENANCE: provenance}))
    cost["seeds"]["train"] = f"from {scenarios.SPLITS['train'].start}"
    cost["training_steps"] = sum(t.user_attrs["training_steps"] for t in trials)
    of_search = {"kind": "tune", "algorithm": task.base.name, "env": task.base.env, "threads": task.threads}
    tuned = {**provenance, "parameters": best.params}
    meta |= {**of_search, "tuned": tuned, "settings": settings.flat(), "plots": plots, "ledger": {"tuning": cost}}
    return Learned(task, meta, file, best, settings)


def _pictures(work: Trainings, table: pd.DataFrame) -> Iterator[tuple[str, Figure]]:
    task = work.task
    title = f"{task.base.name} on {task.base.env}"
    text = "score on tune seeds" + " (µm)" * task.height
    yield "history", history.history(table, title, "score", text)
    yield "slices", history.slices(table, title, task.space.axes, "score", text, {})
    shares = history.importances(work.study, title, "the score")
    if shares is not None:
        yield "importances", shares


def _word(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


tune = functools.partial(over.carry_out, conclude=concluded)
"""A study of a training's settings, see :func:`over.carry_out`."""
