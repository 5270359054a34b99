"""What comes out of a study: the best candidate that keeps its limits, what it is worth on *test* seeds, and how much
worse it gets when a parameter is 20 % off."""

import contextlib
import math
from collections.abc import Iterator
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
from ..store.ledger import Ledger, ranges
from . import goals, staged
from .study import RollOuts, Task
from .work import feasible, told_number
from .worth import Ran

TEST_SEEDS, TEST_SEEDS_JOBS = 200, 20
"""*Test* seeds per scenario on which the result is scored."""

CHECKED = 20
"""Candidates whose Ms is measured at the suite's frequencies, best first, before none is found to keep the cap."""

OFF = 0.2
"""By how much the sensitivity note changes each parameter."""


class NothingFound(InvalidInput):
    """No candidate of a study keeps the limits."""


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
        row |= {"ms": trial.user_attrs.get("ms"), "feasible": feasible(trial)}
        row |= {key: trial.user_attrs.get(key) for key in ("steps", "cpu_seconds")}
        row |= {f"limit {name}": value for name, value in trial.constraints.items()}
        rows.append(row | trial.params)
    return pd.DataFrame(rows)


def best(work: RollOuts, trials: list[FrozenTrial]) -> tuple[Found, dict[str, Any], Ledger]:
    """The best candidate of a study with one metric, what its record says of the choice, and what that cost.

    Where a study has finalists, they are run on many more tune seeds: few seeds flatter a candidate that fails one time
    in a hundred.

    Raises:
        NothingFound: none keeps the limits; the nearest is named.
    """
    task, cap, kept = work.task, work.task.limits.ms, list[tuple[Found, FrozenTrial]]()
    sign = -1.0 if task.directions[0] == "maximize" else 1.0
    work.ms_steps = 0

    def place(trial: FrozenTrial) -> float:
        if task.finalists:
            return staged.rank(trial, cap)
        return sign * trial.values[0] if feasible(trial) else math.inf

    ranked = sorted((t for t in trials if math.isfinite(place(t))), key=place)
    for trial in ranked if task.finalists else ranked[:CHECKED]:
        found = checked(work, trial)
        if not found.ms > cap:
            kept.append((found, trial))
        if len(kept) == max(task.finalists, 1):
            break
    if not kept:
        raise NothingFound(_none(trials, task.limits.ms))
    if not task.finalists:
        return kept[0][0], {}, Ledger()
    many = task.evaluator(range(task.final_seeds), work.evaluator.threads)
    again: list[tuple[float, int]] = []
    for at, (found, _) in enumerate(kept):
        figures = many.whole(found.controller, task.wanted)
        value = goals.score(task.metrics[0], figures, many.core)
        if math.isfinite(value) and max(task.limits.check(figures, many.core, task.jobs).values()) <= 0:
            again.append((value, at))
    if not again:
        raise NothingFound(
            f"none of {len(kept)} finalists of {len(trials)} trials of {task.controller} keeps the limits on "
            f"{task.final_seeds} tune seeds"
        )
    value, at = min(again)
    found, trial = kept[at]
    more: dict[str, Any] = {"score_tune": trial.values[0], "score_checked": value}
    more["checked_on"] = ranges(range(task.final_seeds))
    more["ms_steps"] = work.ms_steps + sum(t.user_attrs.get("ms_steps", 0) for t in trials)
    return found, more, many.ledger


def front(work: RollOuts, trials: list[FrozenTrial]) -> list[Found]:
    """The candidates of a study with several metrics of which none is better than another in all of them.

    Raises:
        NothingFound: none keeps the limits.
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
        raise NothingFound(_none(trials, work.task.limits.ms))
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
    parameters = work.space.values(trial.params, work.task.digits or 5)
    controller = work.base.varied(parameters)
    ms = work.exact_peak(controller) if work.task.peaks else math.nan
    return Found(trial.number, parameters, tuple(trial.values), ms, controller)


def nearest(trials: list[FrozenTrial]) -> FrozenTrial | None:
    """The trial that breaks the limits least; None if none could be evaluated."""
    over = [t for t in trials if t.constraints]
    return min(over, key=lambda t: sum(max(0.0, v) for v in t.constraints.values()), default=None)


def _none(trials: list[FrozenTrial], cap: float) -> str:
    near = nearest(trials)
    if near is None:
        return "no trial could be evaluated"
    ms = near.user_attrs.get("ms", math.inf)
    told = {"ms": f"ms {ms:.3g}, at most {cap:g} is allowed" if ms < goals.FAILED else "ms, its loop does not settle"}
    broken = ", ".join(told.get(name, name) for name, v in near.constraints.items() if v > 0) or "the exact Ms"
    return (
        f"no trial keeps all limits; the nearest, trial {near.number}, breaks: {broken}. "
        "Loosen a limit, search more parameters, or --resume with more --trials"
    )


def scored(work: RollOuts, controller: Team, threads: int) -> tuple[dict[str, Any], Ran]:
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
    return {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in out.items()}, Ran(figures, evaluator)


def moves(controller: Team, spans: dict[str, float]) -> Iterator[tuple[str, int, float]]:
    """Parameter, side and value of all that is moved, within its declared range, whole numbers by at least 1.

    Args:
        controller: whose parameters are.
        spans: of each of them; the measure of one that is 0.
    """
    known = controller.parameters()
    for name, span in spans.items():
        q, own = known[name].quantity, float(known[name].value)
        step = OFF * abs(own) or OFF * 0.5 * span
        step = max(1.0, round(step)) if q.whole else step
        for side in (-1, 1):
            value = min(max(own + side * step, q.low), q.high)
            if value != own and not q.choices:
                yield name, side, value


def sensitivity(work: RollOuts, found: Found) -> pd.DataFrame:
    """How the metrics change, relative to the candidate's, when one parameter is 20 % off, on *tune* seeds.

    A parameter whose value is 0 is moved by 20 % of its searched range's half.
    """
    task, rows = work.task, []

    def measure(controller: Team) -> tuple[list[float], float, float]:
        figures = work.evaluator.whole(controller, task.wanted)
        crashes = sum(float(figures[s]["collision"].sum()) for s in figures)
        peak = work.evaluator.peak(controller) if math.isfinite(task.limits.ms) else math.nan
        return [goals.score(m, figures, work.evaluator.core) for m in task.metrics], peak, crashes

    plain, ms, _ = measure(found.controller)
    spans = {axis.name: axis.high - axis.low for axis in work.space.axes if axis.name in found.parameters}
    for name, side, moved in moves(found.controller, spans):
        with contextlib.suppress(InvalidInput):  # such as a trim that would eat the window
            values, peak, crashes = measure(found.controller.varied({name: moved}))
            both = zip(task.metrics, values, plain, strict=True)
            figures = {m: told_number(v / p) if p else math.nan for m, v, p in both}
            row = {"parameter": name, "value": found.parameters[name], "side": side, "moved": moved, **figures}
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
        "parameters": before
        | {k: int(v) if not isinstance(v, str) and v == int(v) else v for k, v in found.parameters.items()},
        "provenance": provenance,
    }
    head = f"# kerfgym benchmark -c {path.as_posix()}\n"
    runs.write_text(path, head + tomli_w.dumps(body))
