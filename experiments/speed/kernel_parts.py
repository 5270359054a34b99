"""The kernel part by part: nanoseconds, packed instructions, and the same machine from registers.

Vectorisation is lost silently, so it is shown in two ways: the lane loops against a machine that is stepped one after
the other with its state in registers, and the instructions that the loops were compiled to.
"""

import re
import time
from typing import Any

import numpy as np

from ...envs import scenarios
from ...envs.control import stack as stacks
from ...envs.engine.kernels import Kernel
from ...envs.engine.lanes import U1, UW, U, call, doubles, load, part, store, words
from ...envs.plant import machine
from ..measure import rollout
from .proof import NothingDone

_ANY, _AGAIN = U(2**40), 20


@part
def _blocks(deck):
    return (deck[machine.D.machines] + UW - U1) // UW


@part
def _lanes(deck, b):
    return min(UW, deck[machine.D.machines] - b * UW)


# Each runs one stage over all blocks, several times on each while it is in the cache.


def _supervise(deck_address):
    deck = words(deck_address, machine.DECK)
    block = doubles(deck[machine.D.block], _ANY)
    for b in range(_blocks(deck)):
        for i in range(_AGAIN):
            machine.supervise_all(block, b * machine.STRIDE, _lanes(deck, b), deck[machine.D.tick] + U(i))


def _travel(deck_address):
    deck = words(deck_address, machine.DECK)
    block = doubles(deck[machine.D.block], _ANY)
    for b in range(_blocks(deck)):
        for i in range(_AGAIN):
            machine.travel_all(block, b * machine.STRIDE, _lanes(deck, b), deck[machine.D.tick] + U(i), deck)


def _prepare(deck_address):
    deck = words(deck_address, machine.DECK)
    block = doubles(deck[machine.D.block], _ANY)
    for b in range(_blocks(deck)):
        for i in range(_AGAIN):
            machine.prepare_all(block, b * machine.STRIDE, _lanes(deck, b), deck[machine.D.tick] + U(i))


def _move(deck_address):
    deck = words(deck_address, machine.DECK)
    block = doubles(deck[machine.D.block], _ANY)
    for b in range(_blocks(deck)):
        for _ in range(_AGAIN):
            for k in range(0, machine.SUBSTEPS, 5):
                machine.move_all(block, b * machine.STRIDE, _lanes(deck, b), k, machine.has_bristles(deck))


def _sense(deck_address):
    deck = words(deck_address, machine.DECK)
    block = doubles(deck[machine.D.block], _ANY)
    keys = words(deck[machine.D.keys], _blocks(deck) * UW)
    for b in range(_blocks(deck)):
        for i in range(_AGAIN):
            at, tick = b * machine.STRIDE, deck[machine.D.tick] + U(i)
            machine.sense_all(block, at, _lanes(deck, b), tick, keys, b * UW)


def _filter(deck_address):
    deck = words(deck_address, machine.DECK)
    block = doubles(deck[machine.D.block], _ANY)
    for b in range(_blocks(deck)):
        for i in range(_AGAIN):
            at, tick, ranks = b * machine.STRIDE, deck[machine.D.tick] + U(i), deck[machine.D.flags] & machine.F_RANKS
            machine.filter_all(block, at, _lanes(deck, b), tick, deck[machine.D.window], ranks)


def _look_up(deck_address):
    deck = words(deck_address, machine.DECK)
    block = doubles(deck[machine.D.block], _ANY)
    for b in range(_blocks(deck)):
        for i in range(_AGAIN):
            machine.look_up_all(block, b * machine.STRIDE, _lanes(deck, b), deck[machine.D.tick] + U(i), deck)


def _report(deck_address):
    deck = words(deck_address, machine.DECK)
    block = doubles(deck[machine.D.block], _ANY)
    for b in range(_blocks(deck)):
        for i in range(_AGAIN):
            machine.report_all(block, b * machine.STRIDE, _lanes(deck, b), deck[machine.D.tick] + U(i))


def _law(deck_address):
    deck = words(deck_address, machine.DECK)
    for b in range(_blocks(deck)):
        for _ in range(_AGAIN):
            tables, size = deck[machine.D.law_tables], deck[machine.D.law_size]
            at, n = b * machine.STRIDE, _lanes(deck, b)
            call(deck[machine.D.law], deck[machine.D.block], at, n, tables, size)


@part
def _move_one(block, a, bristles):
    """All substeps of one machine with its state in local variables."""
    p, gains = load(machine.z_axis.Params, block, a + machine.P_Z), load(machine.z_axis.Gains, block, a + machine.GAINS)
    pace = load(machine.z_axis.Pace, block, a + machine.PACE)
    course = load(machine.Course, block, a + machine.COURSE)
    z, m = load(machine.z_axis.State, block, a + machine.S_Z), load(machine.Moment, block, a + machine.MOMENT)
    for k in range(machine.SUBSTEPS):
        z, m = machine.substep(p, gains, pace, course, z, m, (np.float64(k) + 1.0) / machine.SUBSTEPS, bristles)
    store(block, a + machine.S_Z, z)
    store(block, a + machine.MOMENT, m)


def _registers(deck_address):
    """The same machine, one after the other, nothing to vectorise: what the lanes are compared with."""
    deck = words(deck_address, machine.DECK)
    machines, block = deck[machine.D.machines], doubles(deck[machine.D.block], _ANY)
    keys = words(deck[machine.D.keys], _blocks(deck) * UW)
    for b in range(_blocks(deck)):
        for lane in range(min(UW, machines - b * UW)):
            a, i = b * machine.STRIDE + lane, b * UW + lane
            tick = deck[machine.D.tick]
            for _ in range(deck[machine.D.steps]):
                machine.supervise_all(block, a, U1, tick)
                machine.travel_all(block, a, U1, tick, deck)
                machine.prepare_all(block, a, U1, tick)
                _move_one(block, a, machine.has_bristles(deck))
                machine.sense_all(block, a, U1, tick, keys, i)
                machine.filter_all(block, a, U1, tick, deck[machine.D.window], deck[machine.D.flags] & machine.F_RANKS)
                machine.look_up_all(block, a, U1, tick, deck)
                machine.report_all(block, a, U1, tick)
                law, tables, size = deck[machine.D.law], deck[machine.D.law_tables], deck[machine.D.law_size]
                call(law, deck[machine.D.block], a, U1, tables, size)
                tick += U1
    deck[machine.D.tick] += deck[machine.D.steps]


registers = Kernel(_registers)
STAGES = {
    "supervisor and drive": Kernel(_supervise), "path and sheet": Kernel(_travel),
    "course of the period": Kernel(_prepare), "Z axis, 20 substeps": Kernel(_move), "sensor": Kernel(_sense),
    "filter": Kernel(_filter), "look-up": Kernel(_look_up), "signals": Kernel(_report), "law": Kernel(_law),
}  # fmt: skip
"""A kernel for each stage of the period, in order."""

for _kernel in STAGES.values():
    _kernel.together_with(registers)

FUNCTIONS = {
    "supervisor and drive": "supervise_all", "path and sheet": "travel_all", "course of the period": "prepare_all",
    "Z axis, 20 substeps": "move_all", "sensor": "sense_all", "filter": "filter_all", "look-up": "look_up_all",
    "signals": "report_all",
}  # fmt: skip


def stage_costs(size: int = 1024, controller: str = "pid") -> dict[str, float]:
    """CPU-seconds of each stage per machine and period.

    They run in their order on the same machines, so that each finds something new to work on.

    Raises:
        NothingDone: a stage has left a machine as it was.
    """
    costs = {}
    fleet = rollout.fleet_for(scenarios.load("wavy"), stacks.resolve(controller), np.arange(size))
    for name, kernel in STAGES.items():
        before = fleet._view.copy()
        start = time.process_time()
        fleet.run_kernel(kernel, 1)
        costs[name] = (time.process_time() - start) / _AGAIN / size
        changed = (fleet._view != before).any(axis=1).reshape(-1)[:size]
        if not changed.all():
            still = int(np.flatnonzero(~changed)[0])
            raise NothingDone(f"stage '{name}' is no measurement: it left machine {still} as it was")
    return costs


def instructions() -> dict[str, tuple[int, int, int]]:
    """For each stage: packed and scalar floating-point instructions, and bits of the widest vector register.

    Read from the assembly that the compiler makes of the kernel for this processor (x86-64 and AArch64).
    """
    from ...envs.engine import compiler

    text = compiler.assembly({"advance": machine.advance.function})
    found = {}
    for name, function in FUNCTIONS.items():
        body = re.search(rf"^\S*{len(function)}{function}\S*:\n(.*?)^\s+\.size", text, re.M | re.S)
        found[name] = _counted(body.group(1)) if body else (0, 0, 0)
    return found


_X86 = {512: "%zmm", 256: "%ymm", 128: "%xmm"}


def _counted(body: str) -> tuple[int, int, int]:
    operations = r"(?:add|sub|mul|div|min|max|fmadd\w*|fnmadd\w*|sqrt|round\w*|rndscale)"
    packed = len(re.findall(rf"\bv?{operations}pd\b", body)) + len(re.findall(r"\bf\w+\s+v\d+\.2d", body))
    scalar = len(re.findall(rf"\bv?{operations}sd\b", body)) + len(re.findall(r"\bf(?:add|mul|sub)\s+d\d+", body))
    lines = [line for line in body.splitlines() if re.search(rf"\bv?{operations}pd\b", line)]
    width = next((bits for bits, register in _X86.items() if any(register in line for line in lines)), 0)
    return packed, scalar, width or (128 if packed else 0)


def table() -> list[dict[str, Any]]:
    """A row for each stage: its packed and scalar instructions and the widest register."""
    return [
        {"stage": name, "packed": packed, "scalar": scalar, "bits": bits}
        for name, (packed, scalar, bits) in instructions().items()
    ]
