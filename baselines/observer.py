"""Surface observer: estimates level, slope and bend of the sheet from encoder − reading and feeds its motion forward.

The sheet under the nozzle is ``head position − height``. A Kalman-like observer with three states (level, speed,
acceleration of the surface) follows it; what an innovation exceeds ``gate`` by is cut off, so impulses hardly move it.
The command is the predicted speed of the surface, ``lead`` ahead to make up for dead time and servo lag, and a
proportional term that brings the head to the set height above the predicted level.
"""

from typing import Annotated, NamedTuple

from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD
from kerfgym.envs.plant.supervisor import HOLD


class Params(NamedTuple):
    """Gains of observer and loop."""

    kp: Annotated[float, Quantity("1/s", 1.0, 400.0, "proportional gain", log=True)] = 30.0
    bandwidth: Annotated[float, Quantity("Hz", 1.0, 200.0, "of the observer (three equal poles)", log=True)] = 25.0
    feed: Annotated[float, Quantity("1", 0.0, 1.5, "share of the surface's speed fed forward")] = 1.0
    lead: Annotated[float, Quantity("ms", 0.0, 20.0, "prediction of the speed")] = 8.0
    bend: Annotated[float, Quantity("1", 0.0, 1.0, "share of the estimated acceleration used in the prediction")] = 0.5
    gate: Annotated[float, Quantity("mm", 0.002, 5.0, "largest innovation that counts", log=True)] = 0.05


class State(NamedTuple):
    """The estimate."""

    level: float = 0.0  # mm
    speed: float = 0.0  # mm/s
    acceleration: float = 0.0  # mm/s²


@part
def init(params):
    """The initial state."""
    return State(0.0, 0.0, 0.0)


@part
def control(params, state, signals, tables):
    """Head velocity, mm/s."""
    measured = signals.head_position - signals.height
    # Three poles at exp(−2π·bandwidth·T), to first order in the exponent: fixed gains of an α-β-γ tracker.
    r = 1.0 / (1.0 + 6.283185307179586 * params.bandwidth * PERIOD)
    d = 1.0 - r
    level = state.level + PERIOD * (state.speed + 0.5 * PERIOD * state.acceleration)
    speed = state.speed + PERIOD * state.acceleration
    missed = clip(measured - level, -params.gate, params.gate)
    # Far from the sheet there is nothing to track yet; over a hole the reading is not the sheet's.
    blind, holds = not signals.captured, signals.mode == HOLD
    level = measured if blind else (state.level if holds else level + (1.0 - r * r * r) * missed)
    speed = 0.0 if blind or holds else speed + 1.5 * d * d * (1.0 + r) / PERIOD * missed
    bend = 0.0 if blind or holds else state.acceleration + d * d * d / (PERIOD * PERIOD) * missed
    coming = speed + params.bend * params.lead * 1e-3 * bend
    error = signals.head_position - level - signals.set_height
    return State(level, speed, bend), params.feed * coming - params.kp * error
