"""Long runs in little memory: the recorder runs for a second at a time, and windows of a few numbers are kept."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....envs.control import stack as stacks
from ....envs.control.stack import Stack
from ....envs.plant import machine, supervisor
from ....envs.plant.controller import PERIOD
from ....envs.scenarios import Scenario
from ....envs.tasks import workshop
from ...measure import rollout
from ...results.jobs import LONGEST

WINDOW = 10.0
"""s"""

_AT_ONCE = 1000
"""Periods that the recorder holds at most."""

_GAP, _SCORED = (machine.CHANNELS.index(name) for name in ("gap", "scored"))


@dataclass(frozen=True)
class Windows:
    """Errors of some runs in windows of time, of shape (windows, seeds), µm.

    Attributes:
        rms: RMS of the true gap error over the scored periods; NaN from the window on in which the run was lost, and
            where nothing is scored.
        largest: largest magnitude of the same.
        counts: scored periods.
        lost: shape (seeds,), the nozzle touched the sheet, the supervisor raised an alarm, or the state is no number
            any more.
        whole: windows of full length; one more may be shorter.
        seconds: length of a window.
    """

    rms: np.ndarray
    largest: np.ndarray
    counts: np.ndarray
    lost: np.ndarray
    whole: int
    seconds: float = WINDOW

    def over(self, some: slice) -> np.ndarray:
        """RMS over several windows together, µm, shape (seeds,); NaN where nothing is left to score."""
        weight = np.where(np.isnan(self.rms[some]), 0, self.counts[some])
        with np.errstate(invalid="ignore"):
            squares: np.ndarray = np.nansum(self.rms[some] ** 2 * weight, axis=0) / weight.sum(axis=0)
        return np.sqrt(squares)


class _Tally:
    """Windows that grow with the run."""

    def __init__(self, size: int, each: int) -> None:
        self.each, self.done = each, 0
        self.squares: list[np.ndarray] = []
        self.largest: list[np.ndarray] = []
        self.counts: list[np.ndarray] = []
        self.broken, self.lost_in = np.zeros(size, bool), np.full(size, np.inf)

    def add(self, error: np.ndarray, scored: np.ndarray, finite: np.ndarray, stopped: np.ndarray) -> None:
        """Some periods within one window: errors, µm, and what counts of them, both (periods, seeds)."""
        w = self.done // self.each
        if w == len(self.counts):
            zeros = np.zeros(error.shape[1])
            self.squares.append(zeros)
            self.largest.append(zeros)
            self.counts.append(zeros.astype(int))
        self.broken |= ~finite
        error = np.where(scored & ~self.broken, np.abs(error), 0.0)
        self.squares[w] = self.squares[w] + (error**2).sum(axis=0)
        self.largest[w] = np.maximum(self.largest[w], error.max(axis=0))
        self.counts[w] = self.counts[w] + scored.sum(axis=0)
        self.lost_in = np.where(np.isinf(self.lost_in) & (self.broken | stopped), w, self.lost_in)
        self.done += len(error)

    def windows(self, seconds: float) -> Windows:
        """What has come together."""
        counts = np.array(self.counts)
        unknown = (np.arange(len(counts))[:, None] >= self.lost_in) | (counts == 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            rms = np.sqrt(np.array(self.squares) / counts)
        rms, largest = (np.where(unknown, np.nan, values) for values in (rms, self.largest))
        return Windows(rms, largest, counts, np.isfinite(self.lost_in), self.done // self.each, seconds)


def stream(scenario: Scenario, stack: Stack, seeds: Sequence[int], window: float = WINDOW, threads: int = 1) -> Windows:
    """One episode of ``scenario`` per seed under ``stack``, in windows of ``window`` s; a job until it is done."""
    team = stacks.team(stack) if scenario.job else stacks.asked(stack)
    fleet = workshop.fleet_for(scenario, team, seeds, threads)
    if fleet.gantries:
        target, settle = fleet.gantries.column("recipe.standoff"), 0
        ends = len(workshop.programme(scenario, team).x) - 1.5
        steps = round(LONGEST * ends)
    else:
        target, settle = fleet.column("job.set_height"), scenario.settle_steps
        ends, steps = np.inf, scenario.steps
    tally = _Tally(fleet.size, round(window / PERIOD))
    go = rollout.advancing(fleet, stack, steps, tally.broken)
    while tally.done < steps:
        count = min(_AT_ONCE, tally.each - tally.done % tally.each, steps - tally.done)
        record = fleet.start_recording(count)
        go(count)
        fleet.stop_recording()
        scored = record[:, _SCORED] > 0.5
        scored[: max(0, settle - tally.done)] = False
        stopped = fleet.column("supervisor.mode") == supervisor.ALARM
        stopped |= fleet.column("tally.collided") > 0.5
        gap = record[:, _GAP].astype(np.float64)
        tally.add(1e3 * (gap - target), scored, np.isfinite(record).all(axis=(0, 1)), stopped)
        if fleet.gantries and ((fleet.gantries.column("progress.near") >= ends) | stopped).all():
            break
    return tally.windows(window)
