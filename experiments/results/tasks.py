"""Tasks of a benchmark: a controller on some seeds of a scenario, and what such a roll-out leaves in tables."""

import hashlib
import json
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from ... import __version__
from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.control.stack import Stack
from ...envs.engine import kernels
from ...envs.engine.quantity import InvalidInput
from ...envs.figures import metrics
from ...envs.plant import machine
from ...envs.plant.controller import PERIOD
from ...envs.plant.path import SPACING
from ...envs.scenarios import Scenario
from ..measure import margins, rollout, stability
from ..measure.plants import STANDARD, Machine
from ..measure.plants import machines as machines_of
from . import jobs

SEEDS_PER_TASK = 100
TRACE = 60_000
"""Most periods of a run that are kept."""

TRACED = 2
"""Seeds of each scenario of which every period is kept: the first ones."""


@dataclass(frozen=True)
class Case:
    """One task: a controller on some seeds of a scenario; without a scenario, its |S| and its margins on a machine.

    Of the seeds in ``traced`` every period is kept.
    """

    controller: str
    scenario: Scenario | None
    seeds: tuple[int, ...]
    traced: tuple[int, ...] = ()
    machine: Machine = STANDARD

    @property
    def with_job(self) -> bool:
        """Whether a team does it."""
        return self.scenario is not None and self.scenario.job is not None

    def key(self, stack: stacks.Stack | stacks.Team) -> str:
        """Name of the task's file when ``stack`` does it; it changes with anything the result depends on."""
        parameters = {name: p.value for name, p in stack.parameters().items()}
        physics = self.scenario.to_toml() if self.scenario else self.machine.tables
        program = [__version__, kernels.STAMP, *stack.program]
        text = json.dumps([self.controller, parameters, program, physics, self.seeds, self.traced])
        return hashlib.sha256(text.encode()).hexdigest()[:20]


def compute(case: Case, stack: stacks.Stack | stacks.Team) -> dict[str, pd.DataFrame]:
    """Tables ``runs``, ``traces``, ``sensitivity`` and ``margins`` of one task, with its cost in ``ledger``."""
    if isinstance(stack, stacks.Team):
        assert case.scenario is not None
        return jobs.compute(case.controller, case.scenario, stack, case.seeds, case.traced)
    start, steps = time.process_time(), 0
    tables: dict[str, pd.DataFrame] = {}
    if case.scenario is None:
        tables, steps = _stability(case, stack)
    else:
        record = rollout.roll(case.scenario, stack, case.seeds)
        steps = case.scenario.steps * len(case.seeds)
        frame = pd.DataFrame(metrics.evaluate(record))
        frame.insert(0, "controller", case.controller)
        frame.insert(1, "information", stack.information)
        frame.insert(2, "scenario", case.scenario.name)
        frame.insert(3, "seed", case.seeds)
        frame.insert(4, "failed", metrics.failed(record))
        tables["runs"] = frame
        if case.traced:
            tables["traces"] = pd.concat([_trace(case, record, seed) for seed in case.traced], ignore_index=True)
    cost = {"controller": case.controller, "steps": steps, "cpu_seconds": time.process_time() - start}
    tables["ledger"] = pd.DataFrame([cost])
    return tables


def _stability(case: Case, stack: Stack) -> tuple[dict[str, pd.DataFrame], int]:
    """Tables ``sensitivity`` and ``margins`` of a controller on a machine, and the steps that were simulated; what
    cannot be measured there has no figure and a ``reason``."""
    where = {"controller": case.controller, "machine": case.machine.label}
    curves, reasons, steps = [], [], 0
    room = margins.Margins(np.nan, np.nan)
    try:
        for signal, measure in (("sine", stability.sensitivity), ("noise", stability.broadband)):
            found = measure(stack, machine=case.machine)
            steps += found.steps
            low, high = found.interval
            frame = pd.DataFrame({"frequency": found.frequencies, "magnitude": found.worst})
            curves.append(frame.assign(signal=signal, peak_low=low, peak_high=high, **where))
        room = margins.Bench(stack, machine=case.machine).measure(stack)
    except InvalidInput as error:
        reasons.append(str(error))
    margin = {**where, "gain": room.gain, "delay_ms": room.delay_ms, "reason": "; ".join(reasons)}
    empty = pd.DataFrame(columns=[*where, "signal", "frequency", "magnitude", "peak_low", "peak_high"])
    columns = list(empty.columns)
    return {
        "sensitivity": pd.concat(curves, ignore_index=True)[columns] if curves else empty,
        "margins": pd.DataFrame([margin]),
    }, steps + room.steps


def _trace(case: Case, record: Any, seed: int) -> pd.DataFrame:
    """Every period of one run, of a long one the first :data:`TRACE`, with its place in the drawing if there is one."""
    assert case.scenario is not None
    index = case.seeds.index(seed)
    frame = pd.DataFrame(record.data[:TRACE, :, index], columns=list(machine.CHANNELS))
    frame.insert(0, "controller", case.controller)
    frame.insert(1, "scenario", case.scenario.name)
    frame.insert(2, "seed", seed)
    frame.insert(3, "time", (np.arange(len(frame)) + 1) * PERIOD)
    frame["set_height"] = record.set_height[index]
    frame["scored"] = record.scored[:TRACE, index].astype(np.float32)
    contour = scenarios.journey(case.scenario)
    if contour:
        along = np.arange(len(contour.x)) * SPACING
        frame["x"] = np.interp(frame["distance"], along, contour.x)
        frame["y"] = np.interp(frame["distance"], along, contour.y)
    return frame


def cases(controllers: Iterable[str], chosen: Iterable[Scenario], seeds: Iterable[int], with_ms: bool) -> list[Case]:
    """All tasks of a grid, by scenario, with |S| on each of the scenarios' machines first."""
    every, chosen, controllers = [int(seed) for seed in seeds], list(chosen), list(controllers)
    traced = set(every[:TRACED])
    out = [Case(name, None, (), machine=m) for m in machines_of(chosen) for name in controllers] if with_ms else []
    for scenario in chosen:
        for name in controllers:
            for some in rollout.chunks(scenario.some(every), SEEDS_PER_TASK):
                part = tuple(int(seed) for seed in some)
                out.append(Case(name, scenario, part, tuple(seed for seed in part if seed in traced)))
    return out
