"""``kerfgym tune`` of a controller: what comes of its study, and what is printed of that."""

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from optuna.trial import FrozenTrial

from ...envs import scenarios
from ...envs.scenarios import machine_text
from ..store import runs, typed
from ..store.ledger import Ledger, ranges
from . import goals, history, outcome, over, staged, storage, tuned_page, verdict
from .assessed import Assessed, assessed
from .crew import Told
from .study import RollOuts

UNITS = {"collisions": "runs", "descent_overshoot": "mm", "jitter": "mm/s per ms"}
"""Of what is not searched for."""


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


@dataclass(frozen=True)
class Result(over.Result):
    """What a command tells of its study."""

    found: outcome.Found
    front: list[outcome.Found]
    before: dict[str, Any]
    after: dict[str, Any]
    near: Any
    assessed: Assessed
    page: Path

    @property
    def files(self) -> list[Path]:
        """The controller, and the page about it."""
        return [self.file, self.page]

    def show(self) -> None:
        """Prints what was found and what it is worth."""
        task, found, near, known = self.task, self.found, self.near, self.task.base.parameters()
        parameters = []
        for name, value in found.parameters.items():
            p = known[name]
            both = (verdict.setting(each, p.quantity) for each in (p.value, value))
            parameters.append((name, verdict.unit(p.quantity), *both))
        figures = [
            (
                f"{each.metric}, test seeds",
                _unit(each.unit),
                *(verdict.figure(x, ends=True) for x in (each.before, each.after)),
            )
            for each in self.assessed.worth.figures
        ]
        figures += [
            (f"{name}, test seeds", unit, f"{self.before[name]:.4g}", f"{self.after[name]:.4g}")
            for name, unit in UNITS.items()
            if name in self.after and name not in task.metrics
        ]
        figures += [("Ms", "", "", f"{found.ms:.3f}")] if math.isfinite(found.ms) else []
        title = f"{task.controller} · {self.meta['tuned']['trials']} trials · {task.over}"
        self.tell(title, "before", parameters, figures)
        warned = verdict.warnings(task, self.assessed)
        for text in warned:
            typed.say(f"warning: {text}")
        if not warned:
            print(verdict.headline(task, self.assessed))
        for text in verdict.cautions(task, self.assessed):
            print(f"but: {text}")
        if self.assessed.margins:
            print(f"margins {verdict.margins_in_words(task, self.assessed.margins[1])}")
        if "evidence" in self.after:
            print(f"figures of the cut: before {self.before['evidence']}; tuned {self.after['evidence']}")
        if len(near):
            worst = near.loc[near[task.metrics[0]].idxmax()]
            print(
                f"20 % off: {worst['parameter']} costs most, {task.metrics[0]} × {worst[task.metrics[0]]:.3f} at "
                f"{worst['moved']:.5g}" + (f", Ms {near['ms'].max():.2f} at worst" if math.isfinite(found.ms) else "")
            )
        if len(self.front) > 1:
            print(f"{len(self.front)} candidates on the Pareto front; tuned.toml holds the one in its middle")
        self.tell_cost()
        if not storage.is_file(task.url):
            print(f"kept in {storage.hidden(task.url)} as '{task.name}'")


def concluded(
    work: RollOuts,
    trials: list[FrozenTrial],
    searched: Ledger,
    meta: dict[str, Any],
    origin: dict[str, Any],
    told: Told,
) -> Result:
    """The best candidate, or a front of them, scored on test seeds; written into the run's folder.

    Raises:
        NothingFound: no candidate keeps the limits.
    """
    task, evaluator, folder = work.task, work.evaluator, Path(work.task.folder)
    count, _, best = task.state(work.study)
    told(count, count, f"{best} · now its neighbourhood and its score on test seeds")
    table = outcome.frame(trials, task)
    runs.write_table(folder, "trials", table)
    searched.use(range(task.seeds))
    evaluator.ledger = Ledger()  # from here on: what choosing costs
    try:
        found, front, more, spent = _chosen(work, trials)
    except outcome.NothingFound as error:
        meta |= {"ledger": {"tuning": searched.entry()}}
        meta["plots"] = history.write(folder, work.study, table, pd.DataFrame(), task, [])
        page = tuned_page.write_nothing(folder, task, meta, outcome.nearest(trials), str(error))
        raise outcome.NothingFound(f"{error}; {page} shows the nearest") from None
    searched += spent
    searched.check("tune")
    if task.relative:
        figures = evaluator.whole(found.controller, task.wanted)
        pooled = {name: goals.score(name, figures, evaluator.core) for name in task.wanted if name != "collision"}
        more["relative"] = {name: round(value, 4) for name, value in pooled.items()}
    near = outcome.sensitivity(work, found)
    before, was = outcome.scored(work, work.base, evaluator.threads)
    after, now = outcome.scored(work, found.controller, evaluator.threads)
    known = assessed(work, found, was, now)
    provenance = origin | _provenance(work, trials, searched) | more

    def full(candidate: outcome.Found) -> dict[str, Any]:
        values = dict(zip(task.metrics, candidate.values, strict=True))
        more = {"ms": round(candidate.ms, 4)} if math.isfinite(candidate.ms) else {}
        return {**provenance, "trial": candidate.number, **more, "tune": values}

    runs.write_table(folder, "sensitivity", near)
    plots = history.write(folder, work.study, table, near, task, front, known.margins)
    if known.margins:
        each = zip(("before", "tuned"), known.margins, strict=True)
        table = pd.concat([m.machines.assign(controller=name) for name, m in each], ignore_index=True)
        runs.write_table(folder, "margins", table)
    if len(front) > 1:
        for i, candidate in enumerate(front, 1):
            outcome.write(folder / "front" / f"{i:02d}.toml", task, candidate, full(candidate))
    final, file = {**full(found), "test": after, "test_before": before}, folder / "tuned.toml"
    outcome.write(file, task, found, final)
    ledgers = {"tuning": searched, "choosing": evaluator.ledger, "testing": work.validation, "margins": known.ledger}
    meta |= {"what": list(task.what), "tuned": {**final, "parameters": found.parameters}, "plots": plots}
    if task.machine:
        runs.write_text(folder / "machine.toml", machine_text.text_of(task.machine))
        meta["cut_by"] = task.machine.record
    meta |= {"front": len(front), "ledger": {name: ledger.entry() for name, ledger in ledgers.items()}}
    page = tuned_page.write(folder, task, meta, found, near, known, front, before, after)
    return Result(task, meta, file, found, front, before, after, near, known, page)


def _chosen(work: RollOuts, trials: list[FrozenTrial]) -> tuple[outcome.Found, list[outcome.Found], Any, Ledger]:
    """The result, the front of which it is one, what its record says of the choice, and what choosing cost the search.

    Raises:
        NothingFound: no candidate keeps the limits.
    """
    if len(work.task.metrics) == 1:
        found, more, spent = outcome.best(work, trials)
        return found, [found], more, spent
    front = outcome.front(work, trials)
    return outcome.middle(front, work.task), front, dict[str, Any](), Ledger()


def _provenance(work: RollOuts, trials: list[FrozenTrial], searched: Ledger) -> dict[str, Any]:
    """How it was searched, and what that took."""
    task, cost = work.task, searched.entry()
    limits: dict[str, Any] = {limit.name: limit.most for limit in task.limits.limits} | {"collisions": 0}
    if math.isfinite(task.limits.ms):
        limits["ms"] = task.limits.ms
    sampler = staged.told(task.stages, task.trials) if task.stages else task.sampler
    pruned = sum(t.state.name == "PRUNED" for t in trials)
    out: dict[str, Any] = {"suite": f"{scenarios.called(task.suite)}-{scenarios.rules(task.suite)['version']}"}
    if task.named:
        out = {"suite": ", ".join(work.evaluator.core)}
    if task.machine:
        out["machine"] = task.machine.record
    out |= {"metrics": list(task.metrics), "limits": limits, "sampler": sampler, "sampler_seed": task.seed}
    out |= {"trials": len(trials), "pruned": pruned, "tune_seeds": ranges(range(task.seeds))}
    out |= {key: cost[key] for key in ("simulated_steps", "cpu_seconds")}
    out |= {"budget": task.budget} if task.budget else {}
    return out | {"start": dict(work.base.provenance)}  # what the controller as it stood was tuned with


tune = functools.partial(over.carry_out, conclude=concluded)
"""A study of a controller, see :func:`over.carry_out`."""
