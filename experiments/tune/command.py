"""What the words of ``kerfgym tune`` mean."""

import math

from ...agents.settings import ALGORITHMS
from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput
from ...envs.scenarios import Machine
from ..measure.stability import LIMIT_MS
from ..statistics import budgets
from . import gradients
from .evaluate import with_jobs
from .goals import Limit, Limits
from .study import Task
from .study import controller as stated

TRIALS, MOST = 300, 1_000_000
"""Of a study unless told otherwise; of one with a budget of steps."""


def trains(what: tuple[str, ...], env: str | None, steps: int | None, assignments: list[str]) -> bool:
    """Whether the settings of a training are searched: an algorithm is named, or what only trainings have."""
    return any(word in ALGORITHMS for word in what) or env is not None or steps is not None or bool(assignments)


def task(
    what: tuple[str, ...],
    trials: int | None,
    sampler: str | None,
    seed: int,
    url: str | None,
    name: str | None,
    controller: str | None,
    suite: str | None,
    metric: list[str] | None,
    ms: float | None,
    jitter: float | None,
    overshoot: float | None,
    limit: list[str] | None,
    seeds: int | None,
    budget: str | None,
    extrapolate: bool | None,
    gradient: bool | None = None,
    named: list[str] | None = None,
    machine: Machine | None = None,
) -> Task:
    """The study that a user asks for; defaults depend on whether the suite's scenarios are jobs.

    Raises:
        InvalidInput: anything that no study can be made of.
    """
    if gradient and sampler not in (None, gradients.SAMPLER):
        raise InvalidInput(f"--gradient is a sampler of its own; --sampler {sampler} is not given beside it")
    sampler = gradients.SAMPLER if gradient else sampler
    those = tuple(named or ())
    usual = "contour" if those and scenarios.load(those[0]).job else "following"
    suite = suite or usual
    scenarios.suite(suite)  # an unknown one is an error here
    rules = scenarios.rules(suite)
    jobs = with_jobs(suite, those)
    given = [Limit(n, v) for n, v in (("jitter", jitter), ("overshoot", overshoot)) if v is not None]
    for word in limit or ():
        key, _, number = word.partition("=")
        try:
            given.append(Limit(key, float(number)))
        except ValueError:
            raise InvalidInput(f"--limit {word}: it is written METRIC=NUMBER, such as time=12.5") from None
    chosen = tuple(metric or ()) or (str(rules.get("score", "rms_true")),)
    begins = controller or (
        "wu-tuned" if rules["slot"] == "xy" else "huang2024-adjusting" if jobs else "xi2023-improved"
    )
    limits = Limits(ms if ms is not None else (math.inf if jobs else LIMIT_MS), tuple(given))
    asked = Task(
        begins,
        what or ("law",),
        suite,
        chosen,
        limits,
        seeds if seeds is not None else (8 if jobs else 32),
        bool(extrapolate),
        sampler=sampler or ("tpe+cmaes" if len(chosen) == 1 else "tpe"),
        trials=(MOST if budget else TRIALS) if trials is None else trials,
        seed=seed,
        name=name or "",
        url=url or "",
        budget=steps_left(budget, begins) if budget else 0,
        named=those,
        machine=machine,
    )
    asked.check()
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
