"""The whole: controllers × sheets, and the verdicts that hold together."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import pandas as pd

from ....envs.control import stack as stacks
from ....envs.scenarios import Scenario
from ...measure import grids
from ...store import pool
from .stream import WINDOW, Windows, stream
from .worse import NOT_JUDGED, Verdict, judge


class Task(NamedTuple):
    """A controller on a sheet."""

    controller: str
    sheet: str
    scenario: Scenario
    seeds: tuple[int, ...]
    window: float = WINDOW


def work(task: Task) -> tuple[Task, Windows]:
    """Its windows."""
    return task, stream(task.scenario, _follower(task.controller), task.seeds, task.window)


def _follower(name: str) -> stacks.Stack:
    return grids.resolved(name, False).z


def endurance(
    controllers: Sequence[str],
    sheets: dict[str, Scenario],
    seeds: Sequence[int],
    window: float = WINDOW,
    jobs: int = 1,
    told: Callable[[int, int, str], None] = lambda done, total, last: None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Verdicts, a row for each sheet and controller; and what they stand on, a row for each window and seed.

    Raises:
        InvalidInput: an unknown controller, or one of another slot.
    """
    for name in controllers:
        _follower(name)
    tasks = [
        Task(name, sheet, scenario, tuple(int(s) for s in seeds), window)
        for sheet, scenario in sheets.items()
        for name in controllers
    ]
    found: dict[tuple[str, str], Windows] = {}
    for task, windows in pool.spread(work, tasks, jobs):
        found[task.sheet, task.controller] = windows
        told(len(found), len(tasks), f"{task.controller} on {task.sheet}")
    tests = sum(not _changes(task.scenario) for task in tasks)
    rows, pieces = [], []
    for task in tasks:
        windows = found[task.sheet, task.controller]
        head = {"sheet": task.sheet, "controller": task.controller}
        drawing = _changes(task.scenario)
        judged = judge(windows, max(1, tests))
        rows.append(head | {"drawing": drawing} | _columns(judged._replace(word=NOT_JUDGED) if drawing else judged))
        count = len(windows.rms)
        seeds = [s for s in task.seeds for _ in range(count)]
        starts = [w * window for _ in task.seeds for w in range(count)]
        errors = {"rms_um": windows.rms.T.ravel(), "largest_um": windows.largest.T.ravel()}
        lost = windows.lost.repeat(count)
        pieces.append(pd.DataFrame({**head, "seed": seeds, "start_s": starts, **errors, "lost": lost}))
    return pd.DataFrame(rows), pd.concat(pieces, ignore_index=True)


def _changes(scenario: Scenario) -> bool:
    """Whether a run is not the same from beginning to end: a drawing, or disturbances in turn. Nothing is said of its
    growth."""
    return scenario.job is not None or scenario.turns is not None


def _columns(verdict: Verdict) -> dict:
    out = verdict._asdict()
    for name in ("rms_growth", "largest_growth"):
        value, low, high = out.pop(name)
        out |= {name: value, f"{name}_low": low, f"{name}_high": high}
    return out
