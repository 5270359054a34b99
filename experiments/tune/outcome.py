"""What comes out of a study: the best candidate that keeps its limits, what it is worth on *test* seeds, and how much
worse it gets when a parameter is 20 % off."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from optuna.trial import FrozenTrial, TrialState

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.control.stack import Team
from ...envs.engine.quantity import InvalidInput
from ...envs.figures import evidence
from ..store import runs
from . import goals
from .study import RollOuts, Task
from .work import feasible, told_number

TEST_SEEDS, TEST_SEEDS_JOBS = 200, 20
"""*Test* seeds per scenario on which the result is scored."""

CHECKED = 20
"""Candidates whose Ms is measured at the suite's frequencies, best first, before none is found to keep the cap."""

OFF = 0.2
"""By how much the sensitivity note changes each parameter."""


@dataclass(frozen=True)
class Found:
    """A candidate that keeps all limits."""

    number: int
    parameters: dict[str, Any]
    values: tuple[float, ...]
    ms: float
    controller: Team


def frame(trials: list[FrozenTrial], task: Task) -> pd.DataFrame:
    """One row per trial."""
    rows = []
    for trial in trials:
        row: dict[str, Any] = {"trial": trial.number, "state": trial.state.name.lower()}
        finished = trial.values if trial.state == TrialState.COMPLETE else [math.nan] * len(task.metrics)
        row |= {m: v if abs(v) < goals.FAILED else math.nan for m, v in zip(task.metrics, finished, strict=True)}
        row |= {
            "ms": trial.user_attrs.get("ms"), "feasible": feasible(trial),
            "steps": trial.user_attrs.get("steps"), "cpu_seconds": trial.user_attrs.get("cpu_seconds"),
        }  # fmt: skip
        row |= {f"limit {name}": value for name, value in trial.constraints.items()}
        rows.append(row | trial.params)
    return pd.DataFrame(rows)


def best(work: RollOuts, trials: list[FrozenTrial]) -> Found:
    """The best candidate of a study with one metric.

    Raises:
        InvalidInput: none keeps the limits; the nearest is named.
    """
    task, higher = work.task, work.task.directions[0] == "maximize"
    ranked = sorted(filter(feasible, trials), key=lambda t: (-t.values[0] if higher else t.values[0], t.number))
    for trial in ranked[:CHECKED]:
        found = checked(work, trial)
        if found.ms <= task.limits.ms or math.isinf(task.limits.ms):
            return found
    raise InvalidInput(_none(trials))


def front(work: RollOuts, trials: list[FrozenTrial]) -> list[Found]:
    """The candidates of a study with several metrics of which none is better than another in all of them.

    Raises:
        InvalidInput: none keeps the limits.
    """
    signs = [-1.0 if d == "maximize" else 1.0 for d in work.task.directions]
    seen: dict[tuple[float, ...], FrozenTrial] = {}
    for trial in filter(feasible, trials):
        seen.setdefault(tuple(s * v for s, v in zip(signs, trial.values, strict=True)), trial)
    kept = [
        trial
        for point, trial in sorted(seen.items())
        if not any(all(a <= b for a, b in zip(other, point, strict=True)) for other in seen if other != point)
    ]
    found = [checked(work, trial) for trial in kept]
    found = [f for f in found if f.ms <= work.task.limits.ms or math.isinf(work.task.limits.ms)]
    if not found:
        raise InvalidInput(_none(trials))
    return found


def middle(found: list[Found], task: Task) -> Found:
    """The candidate of a front whose metrics, each on its range along the front, are smallest together."""

    def cost(candidate: Found) -> float:
        total = 0.0
        for i, direction in enumerate(task.directions):
            column = [f.values[i] for f in found]
            share = (candidate.values[i] - min(column)) / ((max(column) - min(column)) or 1.0)
            total += (1.0 - share if direction == "maximize" else share) ** 2
        return total

    return min(found, key=cost)


def checked(work: RollOuts, trial: FrozenTrial) -> Found:
    """A trial's candidate with its Ms at the suite's frequencies."""
    parameters = work.space.values(trial.params)
    controller = work.base.varied(parameters)
    ms = work.evaluator.exact_peak(controller) if math.isfinite(work.task.limits.ms) else math.nan
    return Found(trial.number, parameters, tuple(trial.values), ms, controller)


def _none(trials: list[FrozenTrial]) -> str:
    over = [t for t in trials if t.constraints]
    if not over:
        return "no trial could be evaluated"
    near = min(over, key=lambda t: sum(max(0.0, v) for v in t.constraints.values()))
    broken = ", ".join(name for name, v in near.constraints.items() if v > 0) or "the exact Ms"
    return (
        f"no trial keeps all limits; the nearest, trial {near.number}, breaks: {broken}. "
        "Loosen a limit, search more parameters, or --resume with more --trials"
    )


def scored(work: RollOuts, controller: Team, threads: int) -> tuple[dict[str, Any], goals.Figures]:
    """What a controller is worth on *test* seeds: the metrics, collisions, overshoot of descents, runs per scenario,
    and of figures of the cut whether they lie within what they were calibrated on."""
    task = work.task
    seeds = scenarios.SPLITS["test"][: TEST_SEEDS_JOBS if task.jobs else TEST_SEEDS]
    evaluator = task.evaluator(seeds, threads)
    wanted = tuple(dict.fromkeys((*task.wanted, *(() if task.jobs else ("overshoot", "jitter")))))
    figures = evaluator.whole(controller, wanted)
    work.validation += evaluator.ledger
    out: dict[str, Any] = {name: goals.score(name, figures, evaluator.core) for name in task.metrics}
    out["collisions"] = int(sum(figures[s]["collision"].sum() for s in figures))
    out["runs"] = sum(len(each["collision"]) for each in figures.values())
    if not task.jobs:
        out["descent_overshoot"] = goals.measured("overshoot", figures, evaluator.core, task.jobs)
        out["jitter"] = goals.score("jitter", figures, evaluator.core)
    if task.jobs or any(m in evidence.QUALITY for m in task.metrics):
        out["evidence"] = evidence.said(evaluator.outside if task.jobs else evidence.ASSUMED)
    return {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in out.items()}, figures


def sensitivity(work: RollOuts, found: Found) -> pd.DataFrame:
    """How the metrics change, relative to the candidate's, when one parameter is 20 % off, on *tune* seeds.

    A parameter whose value is 0 is moved by 20 % of its searched range's half; a whole one by at least 1; none
    leaves its declared range.
    """
    task, known, rows = work.task, found.controller.parameters(), []

    def measure(controller: Team) -> tuple[list[float], float, float]:
        figures = work.evaluator.whole(controller, task.wanted)
        crashes = sum(float(figures[s]["collision"].sum()) for s in figures)
        peak = work.evaluator.peak(controller) if math.isfinite(task.limits.ms) else math.nan
        return [goals.score(m, figures, work.evaluator.core) for m in task.metrics], peak, crashes

    plain, ms, _ = measure(found.controller)
    for axis in work.space.axes:
        value = found.parameters.get(axis.name)
        if axis.choices or value is None:
            continue
        q = known[axis.name].quantity
        step = OFF * abs(float(value)) or OFF * 0.5 * (axis.high - axis.low)
        step = max(1.0, round(step)) if axis.whole else step
        for side in (-1.0, 1.0):
            moved = min(max(float(value) + side * step, q.low), q.high)
            if moved == value:
                continue
            row: dict[str, Any] = {"parameter": axis.name, "value": value, "side": int(side), "moved": moved}
            try:
                values, peak, crashes = measure(work.base.varied(found.parameters | {axis.name: moved}))
            except InvalidInput:  # the trim would eat the window
                continue
            row |= {
                m: told_number(v / p) if p else math.nan for m, v, p in zip(task.metrics, values, plain, strict=True)
            }
            rows.append(row | {"ms": peak, "ms_before": ms, "collisions": crashes})
    columns = ["parameter", "value", "side", "moved", *task.metrics, "ms", "ms_before", "collisions"]
    return pd.DataFrame(rows, columns=columns)


def write(path: Path, task: Task, found: Found, provenance: dict[str, Any]) -> None:
    """Writes a candidate as a controller that every command takes."""
    import tomli_w

    base: str = task.controller
    before: dict[str, Any] = {}
    if base.endswith(".toml"):
        base, before, _ = stacks.tuned(base)
    body = {
        "controller": base,
        "parameters": before | {k: int(v) if not isinstance(v, str) and v == int(v) else v
                                for k, v in found.parameters.items()},
        "provenance": provenance,
    }  # fmt: skip
    head = f"# kerfgym benchmark -c {path.as_posix()}\n"
    with runs.atomic(path) as part:
        part.write_text(head + tomli_w.dumps(body), encoding="utf-8")
