"""The whole campaign: controllers × scenarios, the same faults for each."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import pandas as pd

from ....envs import scenarios
from ....envs.control import stack as stacks
from ...store import pool
from .culprits import judged
from .drawn import drawn
from .inject import check

SCENARIOS = ("flat", "wavy", "rough", "step")


class Task(NamedTuple):
    """Faults ``first`` … ``first + faults − 1`` of a scenario under a controller."""

    controller: str
    scenario: str
    faults: int
    seed: int
    first: int = 0


def work(task: Task) -> pd.DataFrame:
    """One row a fault, see :func:`culprits.judged`."""
    given = [drawn(task.scenario, task.first + i, task.seed) for i in range(task.faults)]
    found = judged(scenarios.load(task.scenario), stacks.resolve(task.controller), given)
    return found.assign(controller=task.controller)


def campaign(
    controllers: Sequence[str],
    faults: int,
    seed: int = 0,
    jobs: int = 1,
    told: Callable[[int, int, str], None] = lambda done, total, last: None,
) -> pd.DataFrame:
    """At least ``faults`` faults in all, evenly spread; one row each.

    Raises:
        InvalidInput: an unknown controller, or one that faults do not reach.
    """
    for name in controllers:
        check(stacks.resolve(name))
    each = -(-faults // (len(controllers) * len(SCENARIOS)))
    tasks = [Task(name, scenario, each, seed) for name in controllers for scenario in SCENARIOS]
    parts = []
    for frame in pool.spread(work, tasks, jobs):
        parts.append(frame)
        told(len(parts), len(tasks), str(frame["controller"].iloc[0]))
    whole = pd.concat(parts, ignore_index=True)
    for column, order in (("controller", controllers), ("scenario", SCENARIOS)):
        whole[column] = pd.Categorical(whole[column], list(dict.fromkeys(order)))
    whole = whole.sort_values(["controller", "scenario", "number"], ignore_index=True)
    return whole.astype({"controller": str, "scenario": str})
