"""A recorded run: what a roll-out of one scenario kept of every control period."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..engine.lanes import W
from ..plant import cut, machine, streamed, supervisor
from ..scenarios import Scenario
from ..scenarios.material import material


@dataclass(frozen=True)
class Recording:
    """One episode per seed.

    ``data`` is float32 of shape (periods, channels, machines), see ``machine.CHANNELS``; ``set_height`` (mm),
    ``collided`` and ``lowest`` (mm, smallest true gap over sheet) have the shape (machines,). With ``to_the_end`` a run
    is scored beyond the moment at which the nozzle touched the sheet, as a search wants it that is to avoid that.
    """

    scenario: Scenario
    seeds: np.ndarray
    set_height: np.ndarray
    data: np.ndarray
    collided: np.ndarray
    lowest: np.ndarray
    to_the_end: bool = False

    def __getitem__(self, channel: str) -> np.ndarray:
        """One channel, shape (periods, machines)."""
        return self.data[:, machine.CHANNELS.index(channel)]

    @cached_property
    def scored(self) -> np.ndarray:
        """Which periods count: beam on, over sheet, after the settling time, before the nozzle touched the sheet; shape
        (periods, machines)."""
        mask = self["scored"] > 0.5
        mask[: self.scenario.settle_steps] = False
        return mask if self.to_the_end else mask & (np.arange(len(mask))[:, None] < self.touched)

    @cached_property
    def touched(self) -> np.ndarray:
        """Period in which the nozzle touched the sheet, shape (machines,); their number if it did not.

        It is the first in which the gap is closed where there is sheet, or in which the supervisor has seen it: between
        the ends of two periods nothing is recorded.
        """
        over = (self["mode"] == supervisor.ALARM) | ((self["gap"] <= 0.0) & (self["scored"] > 0.5))
        first = np.where(over.any(axis=0), over.argmax(axis=0), len(over))
        return np.where(self.collided, first, len(over))

    @cached_property
    def error(self) -> np.ndarray:
        """True gap error, actual − set, mm, shape (periods, machines)."""
        return self["gap"].astype(np.float64) - self.set_height

    @cached_property
    def thin_sheet(self) -> dict[str, np.ndarray]:
        """Figures of a cut of thin sheet with these standoff errors, means along it, each of shape (machines,)."""
        steel = material("thin-sheet")
        beam = cut.beam(steel.params, steel.power, 0.0, 0.0, 0.0, 0.0, 0.0)
        counts = self.scored.sum(axis=0)
        known = np.isfinite(np.where(self.scored, self.error, 0.0)).all(axis=0) & (counts > 0)
        out = np.full((len(cut.Figures._fields), len(counts)), np.nan)
        for some in np.array_split(np.flatnonzero(known), max(1, -(-int(known.sum()) // W))):
            errors = np.zeros((int(counts[some].max(initial=0)), len(some)))  # what follows a run's end changes nothing
            for lane, i in enumerate(some):
                errors[: counts[i], lane] = self.error[self.scored[:, i], i]
            figures = streamed.figures(steel.params, beam, steel.feed, errors)
            over = np.arange(len(errors))[:, None] >= counts[some]
            figures = np.where(over[:, None, :], 0.0, figures)
            out[:, some] = figures.sum(axis=0) / counts[some]
        return dict(zip(cut.Figures._fields, out, strict=True))

    @cached_property
    def reported_error(self) -> np.ndarray:
        """Error of the reported (filtered, measured) height, mm, shape (periods, machines)."""
        return self["height"].astype(np.float64) - self.set_height
