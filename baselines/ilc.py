"""Iterative learning control: over laps of one closed contour it learns, place by place, what velocity is needed.

The command is a PID's, ``u_fb``, and a velocity F(place) learnt in the laps before (Bristow et al.
2006). In lap j + 1::

    F_{j+1}(place) = Q[F_j(place) + γ·(u_fb − de/dt)(place + lead)],     F_0 = 0,   e = height − set height

Without the loop's delay a change of F by δ changes ``de/dt − u_fb`` by δ; so ``u_fb − de/dt`` is what F lacks, at all
frequencies alike, and ``lead`` makes up for dead time, servo lag and filter. From lap to lap the error of a frequency ω
changes by about ``|Q·(1 − γ·exp(iω·Δ))|``, Δ being what lead and delay differ by; where this would exceed 1, Q (a Hann
window along the path, without phase) stops the learning. What a reading jumps by beyond ``gate`` in a period counts as
the gate, so impulses are hardly learnt. Nothing is learnt while the supervisor overrides the law.

The memory is three rings of cells along the lap: F of even and of odd laps, and what was seen. F is updated as the head
goes, as soon as Q has all it needs; how many cells a lap has is known after the first. Without laps (``lap`` = 0), and
in the first, the law is its PID; so it is throughout on laps of more than CELLS cells.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np

from kerfgym.baselines import pid
from kerfgym.envs.engine.lanes import clip, extended, part, sine
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD

CELLS = 4096
"""Longest lap, cells."""

MEMORY = 3 * CELLS

WIDEST = 60.0
"""Cells on each side that Q reaches at most."""


class Learning(NamedTuple):
    """Gains of the PID and of the learning."""

    learn: Annotated[float, Quantity("1", 0.0, 1.5, "learning gain γ; 0: nothing is learnt")] = 0.6
    lead: Annotated[float, Quantity("ms", 0.0, 20.0, "of what is learnt from")] = 6.0
    smooth: Annotated[float, Quantity("ms", 0.0, 40.0, "half the length of Q")] = 14.0
    gate: Annotated[float, Quantity("mm", 0.001, 5.0, "largest change of the reading in a period", log=True)] = 0.03
    cell: Annotated[float, Quantity("mm", 0.1, 5.0, "length of a cell")] = 0.4


Params: Any = extended("Params", pid.Params, Learning, kp=50.0, lag=4.0)


class Place(NamedTuple):
    """The PID's, and where in the memory the law is."""

    place: float = 0.0  # mm
    lap: float = 0.0
    cell: float = -1.0  # that the head is in, −1: none yet
    cells: float = 0.0  # in a lap; 0: not known yet
    length: float = 0.0  # mm of a lap
    total: float = 0.0  # mm/s, sum of what was seen in the cell
    periods: float = 0.0  # in the cell


State: Any = extended("State", pid.State, Place)
_FIRST = State()


@part
def init(params):
    """The initial state."""
    return _FIRST


@part
def _index(ring, cell):
    """Where cell ``cell`` of ring 0, 1 (F of even and odd laps) or 2 (what was seen) lies."""
    return np.uint64(np.int64(ring * CELLS + cell))


@part
def _ring(lap):
    """Ring of the lap's F."""
    return lap - 2.0 * np.floor(0.5 * lap)


@part
def _around(cell, cells):
    """A cell at most a lap before or behind this one, as one of this lap."""
    return cell + (cells if cell < 0.0 else (-cells if cell >= cells else 0.0))


@part
def _learnt(memory, lap, cell, cells, half, lead, gain):
    """F of the next lap at a cell of ``lap``: Q over what was in force and what was seen there."""
    value, weights = 0.0, 0.0
    shift = np.floor(lead)
    share = lead - shift
    for i in range(int(2.0 * half) + 1):
        k = i - half
        weight = sine(1.5707963267948966 * (1.0 + k / (half + 1.0)))
        weight *= weight
        # A lap's end is followed by its beginning; in the first nothing is known of what lies before its beginning.
        there, seen, further = cell + k, cell + k + shift, cell + k + shift + 1.0
        if cells > 0.0:
            there, seen, further = _around(there, cells), _around(seen, cells), _around(further, cells)
        if there >= 0.0 and seen >= 0.0 and there < CELLS and further < CELLS and further >= 0.0:
            lacks = (1.0 - share) * memory[_index(2.0, seen)] + share * memory[_index(2.0, further)]
            value += weight * (memory[_index(_ring(lap), there)] + gain * lacks)
            weights += weight
    return value / weights if weights > 0.0 else 0.0


@part
def _learn(p, s, memory, cells, left, feed):
    """Notes what was seen in the ``left`` cells that were left, and learns wherever Q now has all it needs."""
    half = min(np.floor(p.smooth * 1e-3 * feed / p.cell + 0.5), WIDEST)
    lead = p.lead * 1e-3 * feed / p.cell
    mean = s.total / max(s.periods, 1.0)
    for i in range(int(clip(left, 0.0, 64.0))):
        cell, lap = s.cell + i, s.lap
        if cells > 0.0 and cell >= cells:
            cell, lap = cell - cells, lap + 1.0
        memory[_index(2.0, clip(cell, 0.0, CELLS - 1.0))] = mean
        ready = cell - half - np.floor(lead) - 1.0
        if cells > 0.0 and ready < 0.0:
            ready, lap = ready + cells, lap - 1.0
        if ready >= 0.0 and lap >= 0.0:
            memory[_index(_ring(lap + 1.0), ready)] = _learnt(memory, lap, ready, cells, half, lead, p.learn)


@part
def _forward(memory, state, lap, place):
    """F here, mm/s, linear between the middles of the cells."""
    at = place / state.length * state.cells - 0.5
    low = np.floor(at)
    share = at - low
    one = low + state.cells if low < 0.0 else low
    two = one + 1.0 if one + 1.0 < state.cells else 0.0
    one = min(one, state.cells - 1.0)
    ring = _ring(lap)
    return (1.0 - share) * memory[_index(ring, one)] + share * memory[_index(ring, two)]


@part
def control(params, state, signals, tables, memory):
    """Head velocity, mm/s."""
    x = signals
    if x.fresh:
        for i in range(MEMORY):
            memory[np.uint64(i)] = 0.0
    inner, back = pid.control(params, state, x, tables)
    error = x.height - x.set_height
    change = 0.0 if x.fresh else clip(error - state.error, -params.gate, params.gate)
    lacks = back - change / PERIOD if x.captured and not x.override else 0.0

    turned = x.lap > state.lap
    # A lap is as long as what was travelled from its last place to the first of the next, and before.
    length, cells = state.length, state.cells
    if turned and cells == 0.0:
        length = state.place + x.feed * PERIOD - x.place
        cells = np.floor(length / params.cell + 0.5)
    here = np.floor(x.place / length * cells if cells > 0.0 else x.place / params.cell)
    here = min(here, cells - 1.0) if cells > 0.0 else here
    fits = x.lap < 1e6 and here < CELLS and cells < CELLS and params.learn > 0.0
    entered = here != state.cell or turned
    if fits and entered and state.cell >= 0.0:
        # All cells that were left, were there more than one in this period.
        left = here - state.cell + (cells if turned else 0.0)
        _learn(params, state, memory, cells, left, x.feed)
    total = (0.0 if entered else state.total) + lacks
    periods = (0.0 if entered else state.periods) + 1.0
    after = State(inner.integral, inner.error, inner.slope, x.place, x.lap, here, cells, length, total, periods)
    knows = fits and x.lap >= 1.0 and cells > 0.0 and x.captured
    forward = _forward(memory, after, x.lap, x.place) if knows else 0.0
    return after, back + forward
