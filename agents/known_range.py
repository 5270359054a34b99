"""The range in which a policy was trained, measured: what its training's scenarios say of feed, noise and drive.

A law whose signals a policy weighs may name ``CONDITIONS``, those of its features that describe the situation rather
than the moment. The exported policy drives machines of its training's scenarios, on the *tune* seeds, and what it sees
of the conditions bounds its range. Beyond the range it hands over to its base (:func:`agents.network.trusted`).
"""

import sys
from typing import Any

import numpy as np

from .network import Memory, Network, run
from .policy import Range

MACHINES, PERIODS = 16, 3000
"""Machines of each scenario, and control periods that each lives."""

OUTSIDE = 0.001
"""Share of what was seen that may lie outside, on each side: estimates that have not settled yet."""

MARGIN, LEAST = 0.25, 0.05
"""Of the width of a bound, and at least, until nothing is left of the action."""


def conditions(law: Any) -> tuple[str, ...]:
    """Those that a law names; none if it has no weights."""
    if law.weighing is None:
        return ()
    return tuple(getattr(sys.modules[law.weighing.weigh.__module__], "CONDITIONS", ()))


def measured(network: Network, batch: Any) -> Range | None:
    """The range of a policy that was trained on machines like those of ``batch``; None where the law names no
    conditions or the policy does not see them."""
    names = conditions(batch.base.z.law) if batch.task.slot == "z" else ()
    seen_names = batch.base.z.law.weighing.features if names and batch.observation == "sheet" else ()
    which = [seen_names.index(name) for name in names if name in seen_names]
    if not which:
        return None
    size = MACHINES * len(batch.scenarios)
    like = type(batch)(
        batch.task, size, batch.scenarios, batch.control, batch.observation, split="tune", base=batch.base
    )
    every = np.arange(size)
    like.sequence(every, every)
    like.restart(every)
    memory, alive = Memory(network, size), np.ones(size, bool)
    periods = min(PERIODS, int(like.longest.max()))
    seen = np.full((periods, size, len(which)), np.nan, np.float32)
    for t in range(periods):
        seen[t, alive] = like.observations[alive][:, which]
        like.put_actions(run(network, memory, like.observations.copy()))
        like.advance()
        alive &= ~(like.terminated | like.truncated)
        if not alive.any():
            break
    low, high = np.nanquantile(seen, [OUTSIDE, 1.0 - OUTSIDE], axis=(0, 1)).astype(np.float64)
    margin = np.maximum(MARGIN * (high - low), LEAST)
    rounded = [[round(float(x), 4) for x in each] for each in (low, high, margin)]
    return Range(names=[seen_names[i] for i in which], low=rounded[0], high=rounded[1], margin=rounded[2])
