"""Gain and dead-time margins by simulation: how wrong the drive may be before the loop no longer settles.

Between controller and drive stands a fault: every command is multiplied by a factor, or comes so many milliseconds
later. It acts behind law, residual, supervisor and D/A, where a machine's own scaling and bus lie, so that it scales
the *whole* command of a learned residual as of a classical law, and what a law knows of its own command stays what it
asked for. (``hand.gain`` would leave a residual out, and would show the law the scaled command.)

The nozzle runs over a step of the sheet of 0.1 mm, on the corner plants of a machine (:mod:`plants`). The loop
*settles* when what is left of the response a second later has become smaller: the RMS of the true gap about its mean in
the second window is below 0.9 of that in the first, or below 2 µm (friction, backlash and D/A keep a little hunting
alive). A loop that swings on with constant amplitude does not settle, nor does one that touches the sheet. Nothing is
assumed about the controller; for a linear loop this is the stability margin. Where friction, limits or a filter's
threshold matter, the margin holds for this step: larger ones leave less of it.

Many factors and delays are tried side by side, each on all corners, in two roll-outs: a coarse grid, and a fine one
between the last value at which every corner settles and the next.
"""

import math
from dataclasses import dataclass

import numpy as np

from ...envs.control.stack import Stack
from ...envs.engine.lanes import U1, UW, U, W, doubles, stage
from ...envs.engine.quantity import InvalidInput
from ...envs.plant import heads, sheet, z_axis
from ...envs.plant import machine as kernel
from ...envs.plant.controller import PERIOD, stage_address
from ...envs.plant.fleet import Fleet
from ...envs.scenarios import Scenario
from . import rollout, stability
from .plants import STANDARD, Drawn, Machine

STEP = 0.1
"""mm by which the sheet rises; the smallest of the following suite's steps."""

SETTLE, WINDOW = 0.3, 0.5
"""s before the step; s of each of the two windows, the first of which begins that much after the step."""

DECAY, FLOOR = 0.9, 0.002
"""Largest ratio of the windows' RMS, and the RMS (mm) below which it does not matter."""

FEED = 500.0
"""mm/s: the sensor's plate takes 20 ms to get over the step. Slower, the step would be too smooth to excite a loop."""

CANDIDATES = 16
"""Factors, and as many delays, that are tried side by side."""

GAINS = np.concatenate([[1.0], np.geomspace(1.2, 16.0, CANDIDATES - 1)])
"""Factors of the coarse grid; 1 is the loop as it is."""

DELAYS = np.geomspace(0.5, 64.0, CANDIDATES)
"""ms of additional dead time, coarse grid."""

RING = 128
"""Commands that the fault can hold back."""

_RING, _ANY = U(RING), U(2**40)


@dataclass(frozen=True)
class Margins:
    """Robustness of a controller, the worst over the corner plants.

    Attributes:
        gain: factor on the loop's gain up to which it settles; 0 if it does not at 1, infinite if at all of ``GAINS``.
        delay_ms: ms of additional dead time up to which it settles; 0 and infinite likewise.
        ms: largest |S| (:mod:`stability`); NaN if it was not measured.
        steps: simulated for it.
    """

    gain: float
    delay_ms: float
    ms: float = math.nan
    steps: int = 0


@stage
def _fault_all(block, at, n, numbers, tick):
    """The newest command of each lane gives way to the one of ``delay`` periods ago, times ``gain``.

    ``numbers`` holds rows of lanes: the number of machines, gains, delays (periods), then a ring of commands.
    """
    machines = U(np.int64(numbers[0]))
    first = (at // kernel.STRIDE) * UW
    now = U1 + machines * U(2) + (tick % _RING) * machines
    for lane in range(n):
        i, a = first + lane, at + lane
        numbers[now + i] = block[a + kernel.DRIVE]  # the newest command stands first
        ago = U(np.int64(numbers[U1 + machines + i]))
        then = numbers[U1 + machines * U(2) + ((tick - ago) % _RING) * machines + i]
        block[a + kernel.DRIVE] = numbers[U1 + i] * then


def fault(block_address, at, n, numbers_address, tick):
    """Stage at the end of a period. A command acts a period after it was given or later, so this comes in time."""
    _fault_all(doubles(block_address, _ANY), at, n, doubles(numbers_address, _ANY), tick)


def _scenario(feed: float) -> Scenario:
    return Scenario(name="margins", duration=SETTLE + 3 * WINDOW, settle=SETTLE, feed=feed, set_height=0.8)


class Bench:
    """The fleet of a measurement, built once and used for many stacks of one law.

    Args:
        stack: any stack with the law.
        threads: worker threads.
        machine: whose corner plants are measured, or machines that it draws.
        feed: mm/s.

    Raises:
        InvalidInput: a corner plant has less dead time than a control period, so that a command acts before the fault
            can take hold of it.
    """

    def __init__(self, stack: Stack, threads: int = 1, machine: Machine | Drawn = STANDARD, feed: float = FEED) -> None:
        self.scenario, self.corners = _scenario(feed), machine.size
        self.corner = np.tile(np.arange(machine.size), 2 * CANDIDATES)
        size = self.corner.size
        self.fleet = Fleet(size, stack.law, heads.ensure([0]), threads)
        every = np.arange(size)
        machine.prepare(self.fleet, self.scenario, self.corner)
        self.dead_time = self.fleet.column("z.dead_time")
        if self.dead_time.min() < 1.0:
            raise InvalidInput(f"margins need a dead time of at least a control period, {1e3 * PERIOD:g} ms")
        self.fleet.put_feature(every, 0, feed * SETTLE, sheet.FAR, STEP, 0.0)
        self.padded = self.fleet.blocks * W
        self.numbers = np.zeros(1 + (2 + RING) * self.padded)
        self.numbers[0] = self.padded
        self.fleet.at_end(stage_address(fault), self.numbers)

    def settles(self, stack: Stack, gains: np.ndarray, delays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether the loop settles on every corner, for each factor alone and for each delay (ms) alone.

        Args:
            stack: its law must be the fleet's.
            gains, delays: shape (CANDIDATES,).

        Returns:
            Two arrays of bool, shape (CANDIDATES,).
        """
        each = self.each_settles(stack, *(np.repeat(grid, self.corners) for grid in (gains, delays)))
        return each[0].all(axis=1), each[1].all(axis=1)

    def each_settles(self, stack: Stack, gains: np.ndarray, delays: np.ndarray) -> np.ndarray:
        """The same for each machine by itself, bool (2, CANDIDATES, corners).

        Args:
            stack: its law must be the fleet's.
            gains, delays: shape (CANDIDATES · corners,), the machines of a candidate side by side.
        """
        every, others = np.arange(self.fleet.size), CANDIDATES * self.corners
        factor = np.concatenate([gains, np.ones(others)])
        periods = np.concatenate([np.zeros(others), delays * 1e-3 / PERIOD])
        whole = np.floor(periods)
        whole += self.dead_time + periods - whole > z_axis.QUEUE - 1  # then the drive's own queue must give some back
        self.numbers[1:] = 0.0
        self.numbers[1 : 1 + self.fleet.size] = factor
        self.numbers[1 + self.padded : 1 + self.padded + self.fleet.size] = whole
        self.fleet.set("z.dead_time", every, self.dead_time + periods - whole)
        record = rollout.anew(self.fleet, self.scenario, stack, np.zeros(self.fleet.size))
        gap = record["gap"].astype(np.float64)
        window = round(WINDOW / PERIOD)
        with np.errstate(invalid="ignore", over="ignore"):
            before, after = gap[-2 * window : -window].std(axis=0), gap[-window:].std(axis=0)
            good = (after <= DECAY * before) | (after <= FLOOR)
        good &= ~record.collided & np.isfinite(gap).all(axis=0)
        settled: np.ndarray = good.reshape(2, CANDIDATES, self.corners)
        return settled

    def measure(self, stack: Stack) -> Margins:
        """Both margins of ``stack``, whose law must be the fleet's; without ``ms``."""
        coarse = self.settles(stack, GAINS, DELAYS)
        steps = self.fleet.size * self.scenario.steps
        if not coarse[0][0]:
            return Margins(0.0, 0.0, steps=steps)
        brackets = (_bracket(GAINS, coarse[0], 1.0), _bracket(DELAYS, coarse[1], 0.0))
        grids = [
            np.linspace(low, high, CANDIDATES + 2)[1:-1] if high < math.inf else np.full(CANDIDATES, low)
            for low, high in brackets
        ]
        fine = self.settles(stack, *grids)
        gain, delay = (
            _bracket(grid, good, low)[0] if high < math.inf else math.inf
            for (low, high), grid, good in zip(brackets, grids, fine, strict=True)
        )
        return Margins(gain, delay, steps=2 * steps)

    def measure_each(self, stack: Stack) -> tuple[np.ndarray, np.ndarray, int]:
        """Both margins of each machine by itself, (corners,) each, as :class:`Margins` has them, and the steps."""
        starts, grids = (1.0, 0.0), (GAINS, DELAYS)
        coarse = self.each_settles(stack, *(np.repeat(grid, self.corners) for grid in grids))
        brackets = np.array(
            [
                [_bracket(grid, good, start) for good in settled.T]
                for grid, settled, start in zip(grids, coarse, starts, strict=True)
            ]
        )  # (2, corners, 2)
        low, high = brackets[..., 0], brackets[..., 1]
        closed = np.where(np.isfinite(high), high, low)
        fine = np.linspace(low, closed, CANDIDATES + 2, axis=1)[:, 1:-1]  # (2, CANDIDATES, corners)
        good = self.each_settles(stack, *(grid.ravel() for grid in fine))
        found = np.full(low.shape, math.inf)
        for at in np.ndindex(low.shape):
            if math.isfinite(high[at]):
                found[at] = _bracket(fine[at[0], :, at[1]], good[at[0], :, at[1]], float(low[at]))[0]
        found[:, ~coarse[0, 0]] = 0.0
        return found[0], found[1], 2 * self.fleet.size * self.scenario.steps


def _bracket(grid: np.ndarray, good: np.ndarray, start: float) -> tuple[float, float]:
    """The last value (or ``start``) up to which all settle, and the first at which one does not, or infinity."""
    bad = np.flatnonzero(~good)
    first = int(bad[0]) if len(bad) else len(grid)
    return float(grid[first - 1]) if first else start, float(grid[first]) if len(bad) else math.inf


def margins(stack: Stack, threads: int = 1, machine: Machine = STANDARD) -> Margins:
    """Gain and dead-time margin and Ms of a stack, worst over a machine's corner plants."""
    found = Bench(stack, threads, machine).measure(stack)
    peak = stability.sensitivity(stack, threads, machine)
    return Margins(found.gain, found.delay_ms, peak.peak, found.steps + peak.steps)


def in_words(value: float, largest: float) -> str:
    """A margin for a table: ``> 64`` if none was found up to there, ``none`` if the loop does not settle as it is."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return f"> {largest:g}"
    if not value:
        return "none"
    return f"{value:.2f}" if value < 9.95 else f"{value:.1f}"
