"""PID with filtered derivative and anti-windup (Åström and Hägglund 2006).

``u = −(kp·e + I + kd·de/dt)``, ``e = height − set height``. The derivative is taken of the error behind a first-order
lag. While the supervisor overrides the law the integral stands still and the derivative is 0: how the error moves then
is not the law's doing, and what a hole or a faulty reading leaves in it would throw the head up afterwards. The
integral is empty until the approach is over, so that nothing winds up; the supervisor's own slew limit makes the
handover bumpless.
"""

from typing import Annotated, NamedTuple

from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD


class Params(NamedTuple):
    """Gains."""

    kp: Annotated[float, Quantity("1/s", 1.0, 400.0, "proportional gain", log=True)] = 90.0
    ki: Annotated[float, Quantity("1/s²", 0.0, 20000.0, "integral gain")] = 1500.0
    kd: Annotated[float, Quantity("1", -1.0, 2.0, "derivative gain")] = 0.2
    lag: Annotated[float, Quantity("ms", 0.0, 20.0, "time constant of the derivative's lag")] = 1.0
    limit: Annotated[float, Quantity("mm/s", 1.0, 500.0, "largest integral part")] = 100.0


class State(NamedTuple):
    """Integral and derivative."""

    integral: float = 0.0  # mm/s
    error: float = 0.0  # mm, of the period before
    slope: float = 0.0  # mm/s


@part
def init(params):
    """The initial state."""
    return State(0.0, 0.0, 0.0)


@part
def control(params, state, signals, tables):
    """Head velocity, mm/s."""
    error = signals.height - signals.set_height
    last = error if signals.fresh else state.error
    share = 1.0 / (params.lag + 1.0)  # of the newest difference, lag in ms, T = 1 ms
    slope = 0.0 if signals.override else state.slope + share * ((error - last) / PERIOD - state.slope)
    grown = state.integral + params.ki * PERIOD * error
    integral = clip(state.integral if signals.override else grown, -params.limit, params.limit)
    integral = integral if signals.captured else 0.0
    command = -(params.kp * error + integral + params.kd * slope)
    return State(integral, error, slope), command
