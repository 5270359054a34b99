"""A filter without delay: what it makes of noise stays, what it does to the signal goes.

Beside the machine's filter a second one of the same settings reads what a faultless sensor would count. Their
difference is what is left of noise and impulses; it is added to the newest faultless count::

    prompt = filter(counted) − filter(faultless) + faultless now

For a filter that is linear this takes away its delay and its roundness, and nothing else. No real filter can do that:
it serves to ask what the delay of one costs (:mod:`kerfgym.envs.plant.ideal`).

The second filter lives in a *shadow*, a block with the machine's layout of which only the filter's rows are used.
"""

from typing import Any

import numpy as np

from ..engine.columns import aligned
from ..engine.deck import places
from ..engine.kernels import Kernel
from ..engine.lanes import U1, U2, UW, W, doubles, load, stage, store, words
from . import filters, machine, sensor
from .controller import Privileged
from .fleet import Filtered, Fleet

_ROWS = machine.ROWS + 1
_STRIDE, _ON = np.uint64(_ROWS * W), np.uint64(machine.ROWS * W)
_ANY = np.uint64(2**40)
_LAST = machine.SAMPLES_LAST
D = places(Filtered)


@stage
def _count_all(block, at, shadow, mine, n, tick):
    """What a faultless sensor counts, into the shadow's ring; an invalid count leaves the last one there."""
    now = mine + machine.SAMPLES + (tick & _LAST) * UW
    last = mine + machine.SAMPLES + ((tick - U1) & _LAST) * UW
    for lane in range(n):
        a, b = at + lane, mine + lane
        p, c = load(sensor.Params, block, a + machine.P_SENSOR), load(machine.Course, block, a + machine.COURSE)
        gap = machine.sensed_gap(load(machine.Moment, block, a + machine.MOMENT), c)
        f = sensor.oscillator(p, sensor.capacitance(p, max(gap, sensor.LEAST_GAP), c.cover), 0.0)
        valid = load(Privileged, block, a + machine.SIGNALS).frequency > 0.0
        shadow[now + lane] = f if valid else shadow[last + lane]
        store(shadow, b + machine.P_FILTER, load(filters.Params, block, a + machine.P_FILTER))
        shadow[b + machine.SLOPE] = block[a + machine.SLOPE]


@stage
def _begin_all(block, at, shadow, mine, n, tick):
    """Where an episode begins, the ring and the recursive filters start from its first count."""
    for lane in range(n):
        b = mine + lane
        if load(machine.Tally, block, at + lane + machine.TALLY).ticks < 0.5:
            first = shadow[b + machine.SAMPLES + (tick & _LAST) * UW]
            for i in range(_LAST + U1):
                shadow[b + machine.SAMPLES + i * UW] = first
            store(shadow, b + machine.S_FILTER, filters.State(first, 1e6, 0.0, 0.0))


@stage
def _mend_all(block, at, shadow, mine, n, tick):
    """The filtered frequency without the filter's delay, for the machines that have such a filter."""
    now = mine + machine.SAMPLES + (tick & _LAST) * UW
    for lane in range(n):
        a, b = at + lane, mine + lane
        filtered, late = block[a + machine.FOLD], shadow[now + lane] - shadow[b + machine.FOLD]
        block[a + machine.FOLD] = filtered + late if shadow[b + _ON] > 0.5 else filtered


def _prompt(block_address, at, n, words_address, tick):
    """Stage between filter and table; its deck is of :class:`fleet.Filtered`, the numbers are the shadow."""
    known = words(words_address, U2)
    deck = words(known[D.machine], machine.DECK)
    block, shadow = doubles(block_address, _ANY), doubles(known[D.numbers], _ANY)
    mine = at // machine.STRIDE * _STRIDE + at % machine.STRIDE
    _count_all(block, at, shadow, mine, n, tick)
    _begin_all(block, at, shadow, mine, n, tick)
    machine.filter_all(shadow, mine, n, tick, deck[machine.D.window], deck[machine.D.flags] & machine.F_RANKS)
    _mend_all(block, at, shadow, mine, n, tick)


prompt = Kernel(_prompt)


def install(fleet: Fleet, machines: Any) -> None:
    """Takes the delay of the filters of ``machines`` away, from their next episode on; the others keep theirs."""
    shadow = aligned(fleet.blocks * _ROWS * W)
    on = shadow.reshape(fleet.blocks, _ROWS, W)[:, machine.ROWS]
    m = np.atleast_1d(machines)
    on[m // W, m % W] = 1.0
    fleet.after_filter(prompt.address, shadow)
