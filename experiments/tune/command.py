"""What the words of ``kerfgym tune`` mean, and what it prints."""

import math

from ...agents.settings import ALGORITHMS
from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ..statistics import budgets
from . import storage
from .controllers import Result, check
from .evaluate import with_jobs
from .goals import Limit, Limits
from .study import Task
from .study import controller as stated

TRIALS, MOST = 300, 1_000_000
"""Of a study unless told otherwise; of one with a budget of steps."""

CAP = 2.0
"""Largest Ms of followers unless told otherwise: that of the following suite's ranking."""


def trains(what: tuple[str, ...], env: str | None, steps: int | None, assignments: list[str]) -> bool:
    """Whether the settings of a training are searched: an algorithm is named, or what only trainings have."""
    return any(word in ALGORITHMS for word in what) or env is not None or steps is not None or bool(assignments)


def task(
    what: tuple[str, ...], controller: str | None, suite: str, trials: int | None, sampler: str | None,
    metrics: list[str], ms: float | None, jitter: float | None, overshoot: float | None, limits: list[str], seed: int,
    seeds: int | None, url: str | None, name: str | None, budget: str | None = None, extrapolate: bool = False,
) -> Task:  # fmt: skip
    """The study that a user asks for; defaults depend on whether the suite's scenarios are jobs.

    Raises:
        InvalidInput: anything that no study can be made of.
    """
    scenarios.suite(suite)  # an unknown one is an error here
    rules = scenarios.rules(suite)
    jobs = with_jobs(suite)
    given = [Limit(n, v) for n, v in (("jitter", jitter), ("overshoot", overshoot)) if v is not None]
    for word in limits:
        key, _, number = word.partition("=")
        try:
            given.append(Limit(key, float(number)))
        except ValueError:
            raise InvalidInput(f"--limit {word}: it is written METRIC=NUMBER, such as time=12.5") from None
    chosen = tuple(metrics) or (str(rules.get("score", "rms_true")),)
    named = controller or ("wu-tuned" if suite == "contour" else "huang2024-adjusting" if jobs else "xi2023-improved")
    asked = Task(
        named, what or ("law",), suite, chosen,
        Limits(ms if ms is not None else (math.inf if jobs else CAP), tuple(given)),
        sampler or ("tpe+cmaes" if len(chosen) == 1 else "tpe"),
        (MOST if budget else TRIALS) if trials is None else trials, seed,
        seeds if seeds is not None else (8 if jobs else 32), name or "", url or "",
        steps_left(budget, named) if budget else 0, extrapolate,
    )  # fmt: skip
    check(asked)
    return asked


def steps_left(budget: str, start: str) -> int:
    """Simulated steps of a budget, less those that the controller has had from which the search starts.

    Args:
        budget: a number, or a controller, which stands for all that it was tuned and trained with.
        start: a controller.

    Raises:
        InvalidInput: no such controller, one without a record, or nothing is left.
    """
    try:
        whole = float(budget)
    except ValueError:
        whole = _had(budget)
        if not whole > 0:
            raise InvalidInput(
                f"--budget {budget}: its record says nothing of simulated steps; give a number"
            ) from None
    before = _had(start)
    left = whole - before if before > 0 else whole
    if not 1 <= left < math.inf:
        raise InvalidInput(f"--budget {budget}: nothing is left; '{start}' has had {before:,.0f} simulated steps")
    return round(left)


def _had(name: str) -> float:
    """Simulated steps that a controller was tuned and trained with; NaN if that is not recorded."""
    return sum(budgets.spent(record).steps for record in budgets.slots(stated(name).provenance).values())


def show(result: Result) -> None:
    """Prints what was found and what it is worth."""
    from rich.console import Console
    from rich.table import Table

    task, found = result.task, result.found
    console = Console(width=max(Console().width, 100))
    table = Table(title=f"{task.controller} · {result.meta['tuned']['trials']} trials · suite {task.suite}")
    for title in ("", "before", "tuned"):
        table.add_column(title, justify="right" if title else "left")
    known = task.base.parameters()
    for name, value in found.parameters.items():
        p = known[name]
        old = p.quantity.choices[int(p.value)] if p.quantity.choices else f"{p.value:.5g}"
        table.add_row(name, old, value if isinstance(value, str) else f"{value:.5g}")
    table.add_section()
    for name, value in result.after.items():
        if name not in ("runs", "evidence"):
            table.add_row(f"{name}, test seeds", f"{result.before[name]:.4g}", f"{value:.4g}")
    if math.isfinite(found.ms):
        table.add_row("Ms", "", f"{found.ms:.3f}")
    console.print(table)
    if "evidence" in result.after:
        print(f"figures of the cut: before {result.before['evidence']}; tuned {result.after['evidence']}")
    near = result.near
    if len(near):
        worst = near.loc[near[task.metrics[0]].idxmax()]
        print(
            f"20 % off: {worst['parameter']} costs most, {task.metrics[0]} × {worst[task.metrics[0]]:.3f} at "
            f"{worst['moved']:.5g}" + (f", Ms {near['ms'].max():.2f} at worst" if math.isfinite(found.ms) else "")
        )
    if len(result.front) > 1:
        print(f"{len(result.front)} candidates on the Pareto front; tuned.toml holds the one in its middle")
    cost = result.meta["ledger"]["tuning"]
    print(f"{cost['simulated_steps']:,} simulated steps, {cost['cpu_seconds']:.0f} CPU-s; study {result.meta['study']}")
    if not storage.is_file(task.url):
        print(f"kept in {storage.hidden(task.url)} as '{task.name}'")
