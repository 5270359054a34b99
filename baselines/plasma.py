"""Torch height control in the manner of the open-source plasma tables, carried over to a capacitive reading.

A PID follows the reading, and two locks stop the head where the reading is known to lie. Both are described in the
documentation of LinuxCNC's plasma components (plasmac, QtPlasmaC: "velocity anti dive" and "void lock"; read as
behaviour, nothing is taken over):

- *velocity anti-dive*: at corners the torch slows down, the kerf widens, the arc voltage rises and the torch would
  dive. While the feed is below ``feed`` of the feed that was programmed the height is not corrected. The machine tells
  the law only the feed itself, so what was programmed is the largest feed seen of late (it fades with ``fade``);
- *void lock*: crossing a kerf or a hole, the reading rises faster than sheets do. Once it has risen faster than
  ``slope`` for ``on`` periods in a row the height is locked until ``off`` periods have passed without that.

While locked the head stands still; integral and derivative start afresh afterwards.
"""

from typing import Annotated, Any, NamedTuple

from kerfgym.baselines import pid
from kerfgym.envs.engine.lanes import extended, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD


class Locks(NamedTuple):
    """Gains and locks."""

    feed: Annotated[
        float, Quantity("1", 0.0, 1.0, "share of the programmed feed below which the head stands still")
    ] = 0.9
    fade: Annotated[float, Quantity("s", 0.1, 1000.0, "time in which the largest feed is forgotten")] = 10.0
    slope: Annotated[float, Quantity("mm/s", 1.0, 1000.0, "rise of the reading that means a void", log=True)] = 50.0
    on: Annotated[float, Quantity("ms", 1, 50, "for which it must last", whole=True)] = 2.0
    off: Annotated[float, Quantity("ms", 1, 2000, "without it after which the lock ends", whole=True)] = 30.0


Params: Any = extended("Params", pid.Params, Locks, kp=50.0, lag=4.0)


class Watch(NamedTuple):
    """The PID's, and the locks'."""

    programmed: float = 0.0  # mm/s, largest feed of late
    rising: float = 0.0  # ms for which the reading has risen too fast
    lock: float = 0.0  # ms for which the void lock still holds


State: Any = extended("State", pid.State, Watch)


@part
def init(params):
    """The initial state."""
    return State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@part
def control(params, state, signals, tables):
    """Head velocity, mm/s."""
    programmed = max(signals.feed, state.programmed * (1.0 - PERIOD / params.fade))
    slow = signals.feed < params.feed * programmed
    error = signals.height - signals.set_height
    rise = 0.0 if signals.fresh else (error - state.error) / PERIOD
    # On the way down from above the reading saturates and then falls: no void there.
    rising = state.rising + 1.0 if signals.captured and rise > params.slope else 0.0
    lock = params.off if rising >= params.on else max(state.lock - 1.0, 0.0)
    locked = signals.captured and (slow or lock > 0.0)
    after, wish = pid.control(params, state, signals, tables)
    if locked:
        return State(0.0, error, 0.0, programmed, rising, lock), 0.0
    return State(after.integral, error, after.slope, programmed, rising, lock), wish
