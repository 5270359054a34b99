"""``control="weights"`` and ``observation="sheet"``: a policy sees what the base controller's law sees, and chooses the
weights of the signals that the law's command is a sum of.

An action of 0 is what the law itself takes, so a policy begins as good as its base, and what it does can be read off
its actions: which signal counts for more, and when.
"""

import functools
from typing import Any

import numpy as np

from ..engine import lanes
from ..engine.kernels import Kernel, specialise
from ..engine.lanes import U, clip, doubles, load, singles, stage, words
from ..plant import machine
from ..plant.controller import Law
from .task import ANY, IO, IO_SIZE, LIMIT

_BYTES = U(8)

# Filled in by `stage_of` for each law.
_weigh: Any = None
_Params: Any = None
_State: Any = None
_Signals: Any = None
_ACTION = _MEMORY = lanes.U0


def _put_weights(block_address, at, n, io_address, first):
    """Stage before a period: the law's command once more, with the actions as weights."""
    block, io = doubles(block_address, ANY), words(io_address, IO_SIZE)
    actions, width = singles(io[IO.actions], ANY), io[IO.width]
    for lane in range(n):
        a, i = at + lane, first + lane
        memory = doubles(io[IO.memories] + _BYTES * i * _MEMORY, _MEMORY)
        for k in range(width):
            memory[_ACTION + k] = clip(np.float64(actions[i * width + k]), -1.0, 1.0)
        params, state = load(_Params, block, a + machine.P_LAW), load(_State, block, a + machine.S_LAW)
        block[a + machine.WISH] = _weigh(params, state, load(_Signals, block, a + machine.SIGNALS), memory)
        lanes.store(block, a + machine.HAND, machine.Hand(1.0, 0.0))


@functools.cache
def _kernel(name: str, source: str, law: Law) -> Kernel:
    assert law.weighing
    contract = {"_Params": law.Params, "_State": law.State, "_Signals": law.signals, "_weigh": law.weighing.weigh}
    places = {"_ACTION": U(law.weighing.action), "_MEMORY": U(law.memory)}
    return specialise(_put_weights, name, source, **contract, **places)


def stage_of(law: Law) -> int:
    """Address of the stage that puts actions into force as weights of ``law``, which has some."""
    return _kernel(f"{law.name}.weights".replace("-", "_").replace(":", "_"), law.source, law).address


@stage
def look(n, io, first):
    """The observation of each machine: the features that lie first in its law's memory."""
    observations, size, each = singles(io[IO.observations], ANY), io[IO.size], io[IO.memory_size]
    for lane in range(n):
        i = first + lane
        memory = doubles(io[IO.memories] + _BYTES * i * each, each)
        for j in range(size):
            observations[i * size + j] = clip(memory[j], -LIMIT, LIMIT)
