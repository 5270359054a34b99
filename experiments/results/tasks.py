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
from ...envs.control.stack import Stack, Team
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

    def key(self, team: Team) -> str:
        """Name of the task's file when ``team`` does it; it changes with anything the result depends on."""
        parameters = {name: p.value for name, p in team.parameters().items()}
        physics = self.scenario.to_toml() if self.scenario else self.machine.tables
        program = [__version__, kernels.STAMP, *team.program]
        text = json.dumps([self.controller, parameters, program, physics, self.seeds, self.traced])
        return hashlib.sha256(text.encode()).hexdigest()[:20]


def compute(case: Case, team: Team) -> dict[str, pd.DataFrame]:
    """Tables ``runs``, ``traces``, ``sensitivity`` and ``margins`` of one task, with its cost in ``ledger``."""
    start = time.process_time()
    if case.scenario is None:
        tables, steps = _stability(case, team.z)
    else:
        measured = jobs.measured if case.with_job else _followed
        frame, traces, steps = measured(case.scenario, team, case.seeds, case.traced)
        run = {"controller": case.controller, "information": team.information, "scenario": case.scenario.name}
        tables = {"runs": pd.concat([pd.DataFrame({**run, "seed": case.seeds}, frame.index), frame], axis=1)}
        if traces:
            about = {"controller": case.controller, "scenario": case.scenario.name}
            labelled = [
                pd.concat([pd.DataFrame({**about, "seed": seed}, trace.index), trace], axis=1)
                for seed, trace in traces.items()
            ]
            tables["traces"] = pd.concat(labelled, ignore_index=True)
    cost = {"controller": case.controller, "steps": steps, "cpu_seconds": time.process_time() - start}
    return {**tables, "ledger": pd.DataFrame([cost])}


def _followed(
    scenario: Scenario, team: Team, seeds: tuple[int, ...], traced: tuple[int, ...]
) -> tuple[pd.DataFrame, dict[int, pd.DataFrame], int]:
    """A row of figures for each seed, the traces of some, and the periods simulated; see :func:`jobs.measured`."""
    record = rollout.roll(scenario, team.z, seeds)
    frame = pd.DataFrame({"failed": metrics.failed(record), **metrics.evaluate(record)})
    return frame, {seed: _trace(scenario, record, seeds.index(seed)) for seed in traced}, scenario.steps * len(seeds)


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


def _trace(scenario: Scenario, record: Any, index: int) -> pd.DataFrame:
    """Every period of one run, of a long one the first :data:`TRACE`, with its place in the drawing if there is one."""
    frame = pd.DataFrame(record.data[:TRACE, :, index], columns=list(machine.CHANNELS))
    frame.insert(0, "time", (np.arange(len(frame)) + 1) * PERIOD)
    frame["set_height"] = record.set_height[index]
    frame["scored"] = record.scored[:TRACE, index].astype(np.float32)
    contour = scenarios.journey(scenario)
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
