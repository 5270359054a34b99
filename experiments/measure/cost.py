"""What a controller costs: microseconds per decision, and their share of the control period.

A stack's law is run over the signals of a machine that it drove itself, decision after decision on one core, by the
same machine code as in a roll-out; so it meets approaches, impulses and bounds as often as in use. Timed are chunks of
a few decisions, less what the same calls cost with a law that does nothing::

    python -m kerfgym.experiments.measure.cost lqg mpc pid
"""

import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.control.stack import Stack
from ...envs.engine.deck import Deck, places
from ...envs.engine.kernels import Kernel
from ...envs.engine.lanes import U0, U1, U, W, call, doubles, rows, unflat, words
from ...envs.engine.quantity import InvalidInput
from ...envs.plant import heads, machine
from ...envs.plant.controller import PERIOD, Privileged
from ...envs.plant.fleet import Fleet
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


class Entries(NamedTuple):
    """The kernel's deck."""

    block: int  # array of the fleet
    law: int  # stage
    law_tables: int  # array (law_size,)
    law_size: int
    signals: int  # array (decisions, numbers)
    decisions: int
    pilot: int  # stage of a policy on top of the law, and its deck; 0: none
    pilot_io: int


D = places(Entries)


def _decide(deck_address):
    """Some decisions on recorded signals."""
    deck = words(deck_address, U(len(D)))
    block, signals = doubles(deck[D.block], U(2**40)), doubles(deck[D.signals], U(2**40))
    at = U0
    for _ in range(deck[D.decisions]):
        for row in range(U(_SIGNALS)):
            block[machine.SIGNALS + row * U(W)] = signals[at]
            at += U1
        call(deck[D.law], deck[D.block], U0, U1, deck[D.law_tables], deck[D.law_size])
        if deck[D.pilot] > U0:
            call(deck[D.pilot], deck[D.block], U0, U1, deck[D.pilot_io], U0)


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


def deck_for(fleet: Fleet, signals: np.ndarray, decisions: int) -> Deck:
    """What the kernel gets to make some decisions of the first machine of ``fleet`` on ``signals``."""
    of = fleet.deck
    owned = {name: of.owned(name) for name in ("block", "law_tables", "pilot_io")}
    plain = {name: of[name] for name in ("law", "law_size", "pilot")}
    return Deck(Entries, **owned, **plain, signals=np.ascontiguousarray(signals, np.float64), decisions=decisions)


def _times(stack: Stack, signals: np.ndarray, chunk: int) -> np.ndarray:
    """Nanoseconds of each chunk."""
    fleet = Fleet(1, stack.law, heads.POOL)
    stack.install(fleet, [0])
    deck = deck_for(fleet, signals, chunk)
    run, found, whole = _decide_kernel.bound(deck), [], deck.owned("signals")
    for first in range(0, len(signals) - chunk + 1, chunk):
        deck["signals"] = whole[first:]
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
