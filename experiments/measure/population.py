"""Ms and margins of a controller on machines that a distribution draws: what is likely, beside the corners' worst.

A machine's file holds what is known of it, such as the posterior of its logs. Its corner plants (:mod:`plants`) bound
what a search may do; how a loop would stand on the machine itself is seen on machines that may be it.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ...envs import scenarios
from ...envs.control.stack import Stack
from ...envs.engine.quantity import InvalidInput
from ...envs.scenarios import Scenario
from ..store.ledger import Ledger
from . import plants, stability
from .margins import Bench

DRAWN, FEW, LEAST = 64, 4, 8
"""Machines that are drawn of all distributions together; those for a controller in plain Python, which takes a thousand
times as long; and fewest of a distribution, where there are many."""

COLUMNS = ("machine", "seed", "ms", "gain", "delay_ms")


@dataclass(frozen=True)
class Population:
    """Of one controller, on each machine.

    Attributes:
        machines: a row each: ``machine``, what differs from the standard one, ``seed`` that drew it, ``ms``, largest
            \\|S\\|, infinite if the loop does not settle; ``gain`` and ``delay_ms``, as :class:`margins.Margins` has
            them.
        ledger: what that took.
        reason: why something is missing; empty if nothing is.
    """

    machines: pd.DataFrame
    ledger: Ledger
    reason: str = ""

    def within(self, limit: float) -> tuple[int, int]:
        """On how many machines Ms keeps a limit, and on how many it was measured."""
        peaks = self.machines["ms"].dropna()
        return int((peaks <= limit).sum()), len(peaks)


def measured(stack: Stack, chosen: Iterable[Scenario], threads: int = 1) -> Population:
    """Ms, of sines, and margins of a height follower on machines that the scenarios draw, by *test* seeds."""
    ledger, rows, reasons = Ledger(), [], []
    machines = plants.machines(chosen)
    each_has = FEW if stack.python else max(DRAWN // len(machines), min(LEAST, DRAWN))
    seeds = scenarios.SPLITS["test"][:each_has]
    with ledger.timed():
        for machine in machines:
            those = plants.drawn(machine, seeds)
            ledger.use(those.seeds)
            each = {"machine": machine.label, "seed": list(those.seeds), "gain": np.nan, "delay_ms": np.nan}
            found = stability.sensitivity(stack, threads, those)
            ledger.steps += found.steps
            each["ms"] = np.where(np.isfinite(found.magnitude).all(axis=1), found.magnitude.max(axis=1), np.inf)
            try:
                each["gain"], each["delay_ms"], steps = Bench(stack, threads, those).measure_each(stack)
                ledger.steps += steps
            except InvalidInput as error:
                reasons.append(str(error))
            rows.append(pd.DataFrame(each)[list(COLUMNS)])
    return Population(pd.concat(rows, ignore_index=True), ledger, "; ".join(dict.fromkeys(reasons)))
