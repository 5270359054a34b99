"""CN102528288A: position and speed loop in cascade, with gains that follow the error.

With e = height − set height and T = 1 ms, each period::

    I  += g(e)·Ki·(−e)·T,        u_p = −K(e)·e + I            position loop: the speed that is wanted, mm/s
    e_v = u_p − v,  J += g(e)·Kiv·e_v·T,  u = Kpv·e_v + J     speed loop: the drive's command, mm/s

K(e) is 75 % of the largest gain from 3 mm on and 35 % up to 1 mm, linear between (the document leaves that open). g(e)
opens the integral gains of both loops step by step: nothing from 1 mm on, half below, all below 0.5 mm. Since what g
scales is the increments, no step of it moves the command. The integrals stand still while the supervisor overrides the
law and are empty until the approach is over.

"Last period's following speed", v, is read in two ways: ``encoder``, the head's own speed, or ``gap``, the change of
the measured height; the latter holds the sheet's speed too and so feeds it forward. ``lag`` smooths it (0 as printed).
The document gives no gains: ``cn102528288a`` and ``cn102528288a-gap`` assume them, in ``cn102528288a-tuned`` they are
tuned. The assumed ones leave room for the schedule: it raises the gain with the error, and where the drive's
acceleration is at its limit a speed loop of Kpv = 1 answers a step of 1.5 mm with a limit cycle.
"""

from typing import Annotated, NamedTuple

from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD

SPEEDS = ("encoder", "gap")
"""Readings of "following speed"."""

FAR, NEAR = 0.75, 0.35
"""Shares of the largest position gain for large and for small errors."""

FAR_ERROR, NEAR_ERROR = 3.0, 1.0
"""mm, the errors beyond and within which they hold."""

HALF_ERROR, FULL_ERROR = 1.0, 0.5
"""mm, the errors below which half of and the full integral gains are on."""


class Params(NamedTuple):
    """Gains of both loops."""

    gain: Annotated[float, Quantity("1/s", 1.0, 1000.0, "largest position gain Kmax", log=True)] = 200.0
    ki: Annotated[float, Quantity("1/s²", 0.0, 20000.0, "integral gain of the position loop")] = 200.0
    kpv: Annotated[float, Quantity("1", 0.0, 5.0, "gain of the speed loop")] = 1.0
    kiv: Annotated[float, Quantity("1/s", 0.0, 500.0, "integral gain of the speed loop")] = 60.0
    speed: Annotated[
        float, Quantity("", 0, len(SPEEDS) - 1, "what the following speed is", "CN102528288A", choices=SPEEDS)
    ] = 0.0
    lag: Annotated[float, Quantity("ms", 0.0, 20.0, "time constant of the following speed's lag")] = 0.0
    limit: Annotated[float, Quantity("mm/s", 1.0, 500.0, "largest part of each integral")] = 100.0


class State(NamedTuple):
    """Integrals and following speed."""

    position: float = 0.0  # mm/s, integral of the position loop
    speed: float = 0.0  # mm/s, integral of the speed loop
    height: float = 0.0  # mm, of the period before
    following: float = 0.0  # mm/s


@part
def position_gain(error):
    """K(e)/Kmax for a following error in mm, of either sign."""
    far = clip((abs(error) - NEAR_ERROR) / (FAR_ERROR - NEAR_ERROR), 0.0, 1.0)
    return NEAR + far * (FAR - NEAR)


@part
def integral_share(error):
    """Share g(e) of the integral gains that is on, for a following error in mm, of either sign."""
    return 1.0 if abs(error) < FULL_ERROR else (0.5 if abs(error) < HALF_ERROR else 0.0)


@part
def init(params):
    """The initial state."""
    return State(0.0, 0.0, 0.0, 0.0)


@part
def control(params, state, signals, tables):
    """Head velocity, mm/s."""
    error = signals.height - signals.set_height
    before = signals.height if signals.fresh else state.height
    # How the reading moves while the supervisor overrides the law, across a hole or a fault, is not the loop's speed.
    of_gap = 0.0 if signals.override else (signals.height - before) / PERIOD
    newest = of_gap if params.speed > 0.5 else signals.head_velocity
    following = state.following + (newest - state.following) / (params.lag + 1.0)
    grows = 0.0 if signals.override else integral_share(error) * PERIOD
    position = clip(state.position - grows * params.ki * error, -params.limit, params.limit)
    position = position if signals.captured else 0.0
    wanted = position - params.gain * position_gain(error) * error
    speed = clip(state.speed + grows * params.kiv * (wanted - following), -params.limit, params.limit)
    speed = speed if signals.captured else 0.0
    return State(position, speed, signals.height, following), params.kpv * (wanted - following) + speed
