"""What a controller costs: microseconds per decision, and their share of the control period.

A stack's law is run over the signals of a machine that it drove itself, decision after decision on one core, by the
same machine code as in a roll-out; so it meets approaches, impulses and bounds as often as in use. Timed are chunks of
a few decisions, less what the same calls cost with a law that does nothing::

    python -m kerfgym.experiments.decisions lqg mpc pid
"""

import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..envs import scenarios
from ..envs import stack as stacks
from ..envs.engine.addresses import Address, Words, address
from ..envs.engine.kernels import Kernel
from ..envs.engine.lanes import U0, U1, U, W, call, doubles, rows, unflat, words
from ..envs.engine.quantity import InvalidInput
from ..envs.plant import heads, machine
from ..envs.plant.controller import PERIOD, Privileged, stage_of
from ..envs.plant.fleet import Fleet
from ..envs.stack import Stack
from . import rollout

SCENARIOS = ("rough", "step", "impulses", "holes", "descent")
"""Whose signals are decided on, in equal shares."""

DECISIONS, CHUNK = 20000, 5
"""Decisions that are timed, and how many at a time."""

WARM_UP = 500
"""Decisions before them."""

SEED = 0
"""Of the tune split."""

_SIGNALS = rows(Privileged)


class Decision(NamedTuple):
    """Cost of a decision, of one machine on one core."""

    median_us: float
    p99_us: float  # 99th percentile of the chunks' means
    ratio: float  # of the 99th percentile to the control period


def _decide(deck_address):
    """Some decisions on recorded signals; the deck: block, law, its tables and their size, signals, decisions, and the
    policy on top of the law with its words, or 0."""
    deck = words(deck_address, U(8))
    block, signals = doubles(deck[0], U(2**40)), doubles(deck[4], U(2**40))
    at = U0
    for _ in range(deck[5]):
        for row in range(U(_SIGNALS)):
            block[machine.SIGNALS + row * U(W)] = signals[at]
            at += U1
        call(deck[1], deck[0], U0, U1, deck[2], deck[3])
        if deck[6] > U0:
            call(deck[6], deck[0], U0, U1, deck[7], U0)


_decide_kernel = Kernel(_decide, Path(__file__).read_text(encoding="utf-8"))


def lived(stack: Stack, scenario: str, periods: int) -> np.ndarray:
    """Signals of a machine that ``stack`` drives, shape (periods, numbers), from the first period of an episode on."""
    fleet = rollout.fleet_for(scenarios.load(scenario), stack, [SEED])
    view, seen = fleet.slots(machine.SIGNALS, _SIGNALS), []
    ahead = rollout.periods(fleet, stack, periods)
    for _ in range(periods):
        seen.append(np.array(view))
        next(ahead)
    return np.array(seen)


def deck_for(fleet: Fleet, signals: np.ndarray, decisions: int) -> Words:
    """What the kernel gets to make some decisions of the first machine of ``fleet`` on ``signals``."""
    plain, law = fleet._deck, fleet.law
    whole = np.ascontiguousarray(signals, np.float64)
    return Words((
        Address(plain[machine.D_BLOCK], fleet), stage_of(law, machine.LAW_PLACES), plain[machine.D_LAW_TABLES],
        law.tables.size, address(whole), decisions, plain[machine.D_PILOT], plain[machine.D_PILOT_IO],
    ))  # fmt: skip


def _times(stack: Stack, signals: np.ndarray, chunk: int) -> np.ndarray:
    """Nanoseconds of each chunk."""
    fleet = Fleet(1, stack.law, heads.POOL)
    stack.install(fleet, [0])
    deck = deck_for(fleet, signals, chunk)
    run, found, begin, size = _decide_kernel.bound(address(deck)), [], int(deck[4]), signals[0].nbytes
    for first in range(0, len(signals) - chunk + 1, chunk):
        deck[4] = begin + first * size
        start = time.perf_counter_ns()
        run()
        found.append(time.perf_counter_ns() - start)
    return np.array(found, float)


def _python_times(stack: Stack, signals: np.ndarray, chunk: int) -> np.ndarray:
    """The same for a controller in plain Python."""
    assert stack.python
    mind, found = stack.python(), []
    kind = stack.law.signals
    views = [unflat(kind, row[: len(kind._fields)].tolist()) for row in signals]
    mind.reset()
    for first in range(0, len(signals) - chunk + 1, chunk):
        start = time.perf_counter_ns()
        for view in views[first : first + chunk]:
            mind.control(view)
        found.append(time.perf_counter_ns() - start)
    return np.array(found, float)


def measure(stack: "str | Stack", decisions: int = DECISIONS, chunk: int = CHUNK) -> Decision:
    """Cost of a decision of a stack of the slot z.

    Args:
        stack: or its name.
        decisions: that are timed, at least 100.
        chunk: decisions that are timed together.

    Raises:
        InvalidInput: the stack drives another slot, or there are too few decisions.
    """
    chosen = stacks.resolve(stack)
    if chosen.slot != "z":
        raise InvalidInput(f"controller '{chosen.name}' drives slot '{chosen.slot}'; decisions are timed in slot 'z'")
    if decisions < 100 or not 1 <= chunk <= decisions // 20:
        raise InvalidInput(
            f"decisions = {decisions}, chunk = {chunk}; allowed: 100 decisions or more, chunks of 1 to a 20th of them"
        )
    each = -(-(decisions + WARM_UP) // len(SCENARIOS))
    longest = min(scenarios.load(name).steps for name in SCENARIOS)
    times, base = [], []
    for name in SCENARIOS:
        signals = lived(chosen, name, min(each, longest))
        again = -(-each // len(signals))
        # The first run warms up; gains that are computed once an episode are no part of a decision.
        for run in range(again + 1):
            found = (_python_times if chosen.python else _times)(chosen, signals, chunk)[1:]
            idle = np.zeros(1) if chosen.python else _times(stacks.get("idle"), signals, chunk)[1:]
            if run:
                times.append(found)
                base.append(idle)
    cost = np.maximum(np.concatenate(times) - np.median(np.concatenate(base)), 0.0) * 1e-3 / chunk
    median, p99 = np.percentile(cost, [50, 99])
    return Decision(float(median), float(p99), float(p99 * 1e-6 / PERIOD))


def table(specs: Iterable[str], decisions: int = DECISIONS) -> str:
    """A line for each stack."""
    lines = [f"{'controller':<24}{'median, µs':>12}{'99th pct, µs':>14}{'of the period':>15}"]
    for spec in specs:
        cost = measure(spec, decisions)
        lines.append(f"{spec:<24}{cost.median_us:>12.3f}{cost.p99_us:>14.3f}{cost.ratio:>15.3%}")
    return "\n".join(lines)


def main() -> None:
    """Prints the table for the stacks named on the command line."""
    try:
        print(table(sys.argv[1:] or ["lqg", "mpc", "pid"]))
    except InvalidInput as error:
        raise SystemExit(str(error)) from None


if __name__ == "__main__":
    main()
