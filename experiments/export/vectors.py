"""Test vectors: what a follower was told on the simulated machine, period by period, and what it answered."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from ...envs import scenarios
from ...envs.control.firmware import POINTS, Input
from ...envs.control.stack import Stack
from ...envs.engine.lanes import fields
from ...envs.plant import supervisor
from ..measure import rollout

SHOWN = ("descent", "step", "impulses", "holes")
"""Scenarios of which the vectors are, one behind the other: approach, steps, faults of the sensor, no sheet."""

PERIODS = 1500
"""Of each."""

SEED = 1000
"""Of machine, sheet and noise: the first of the test seeds."""

SIGNALS = {"frequency": "signals.frequency", "encoder": "tally.encoder", "feed": "signals.feed",
           "place": "signals.place", "lap": "signals.lap"}  # fmt: skip


def of(
    stack: Stack, names: Iterable[str] = SHOWN, periods: int = PERIODS, seed: int = SEED
) -> tuple[pd.DataFrame, np.ndarray]:
    """A row for each period, and the calibration tables.

    Columns: ``begins``, 1 where following begins anew and a table of its own counts; ``table``, its place among them;
    those of the input, orders as ``orders.name``; what only a simulator knows, where the law is told that, as
    ``ahead.name`` and ``truth.name``; ``command``, mm/s, what the kernel sent to the drive.

    Returns:
        The rows, and frequencies (Hz) and heights (mm) of each table, (tables, 2, POINTS).
    """
    frames, tables = [], []
    for i, name in enumerate(names):
        scenario = scenarios.load(name)
        fleet = rollout.fleet_for(scenario, stack, [seed])
        columns = {key: fleet.row(place) for key, place in SIGNALS.items()}
        orders = [f for f in fields(Input) if f.startswith("orders.")]
        columns |= {key: fleet.row(f"job.{key.removeprefix('orders.')}") for key in orders}
        more = [f for f in stack.law.signals._fields if f not in supervisor.View._fields and f.startswith("surface_")]
        columns |= {f"ahead.{key}": fleet.row(f"signals.{key}") for key in more}
        if stack.information == "privileged":
            truth = ("gap", "head", "velocity", "acceleration")
            columns |= {f"truth.{key}": fleet.row(f"signals.{key}") for key in truth}
        sent, rows = fleet.row("supervisor.command"), []
        for period in range(min(periods, scenario.steps)):
            given = [float(column[0]) for column in columns.values()]
            fleet.advance()
            rows.append([float(period == 0), float(i), *given, float(sent[0])])
        frames.append(pd.DataFrame(rows, columns=["begins", "table", *columns, "command"]))
        first = int(fleet.column("start.head")[0]) * POINTS
        both = (fleet.deck.owned(key)[first : first + POINTS] for key in ("frequencies", "heights"))
        tables.append(np.array([each.copy() for each in both]))
    return pd.concat(frames, ignore_index=True), np.array(tables)
