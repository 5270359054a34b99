"""Proof that a timed task has done its work: what its machines have lived through, before and after.

Each machine keeps a count of its own periods in its column, which has nothing to do with the fleet's clock in the deck;
so a task that steps other memory than its own, or nothing at all, is found out.
"""

from typing import Any, NamedTuple

import numpy as np

from ...envs.plant.fleet import Fleet
from ...envs.tasks.batch import Batch


class NothingDone(RuntimeError):
    """A timed task did not do what it was timed for; the message names it."""


class Life(NamedTuple):
    """What machines have lived through."""

    clock: int | None  # periods by the fleet's clock; None: there is none
    periods: np.ndarray | None  # of each machine's episode, by the machine's own count
    episodes: np.ndarray | None  # that each machine has begun; None: nobody begins any
    state: np.ndarray  # (machines, numbers), which changes in each period


STATE = ("motion.position", "motion.velocity", "signals.gap", "signals.frequency", "journey.distance")
"""What changes while a machine runs; frequency and distance do even if the head rests."""


def of_fleet(fleet: Fleet) -> Life:
    """Of a fleet that nobody resets."""
    state = np.stack([fleet.column(field) for field in STATE], axis=1)
    return Life(fleet.tick, fleet.column("tally.ticks"), None, state)


def of_batch(batch: Batch) -> Life:
    """Of machines whose episodes end and begin anew."""
    return of_fleet(batch.fleet)._replace(episodes=batch.begun)


def of_state(state: Any, clock: int | None = None) -> Life:
    """Of something that counts no periods, or only by one clock."""
    return Life(clock, None, None, np.atleast_2d(np.array(state, float)))


def check(name: str, before: Life, after: Life, periods: int) -> None:
    """Raises :class:`NothingDone` unless every machine has lived through so many periods more."""

    def refuse(what: str) -> None:
        raise NothingDone(f"'{name}' is no measurement: {periods} periods were timed, but {what}")

    if before.clock is not None and after.clock is not None and after.clock - before.clock != periods:
        refuse(f"the clock went on by {after.clock - before.clock}")
    if before.periods is not None and after.periods is not None:
        went = after.periods - before.periods
        good = went == periods
        if before.episodes is not None:
            anew = after.episodes != before.episodes
            good = np.where(anew, (after.periods >= 0) & (after.periods <= periods), good)
        if not good.all():
            bad = int(np.flatnonzero(~good)[0])
            refuse(f"machine {bad} counted {went[bad]:g}")
    still = (after.state == before.state).all(axis=1)
    if still.any():
        refuse(f"machine {int(np.flatnonzero(still)[0])} is in the state in which it was before")
    if not np.isfinite(after.state).all():
        bad = int(np.flatnonzero(~np.isfinite(after.state).all(axis=1))[0])
        refuse(f"the state of machine {bad} is not finite")
