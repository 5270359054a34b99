"""CN102528288A's dual loop with gains that stay: what its scheduled gains are compared with.

The law is that of ``baselines/cn102528288a.py``, the speed from the encoder. ``share`` in place of the schedule is the
fixed share of the largest position gain, and ``gated`` says whether the integral gains open step by step or are on all
the time. With ``share`` 0 and ``gated`` it is the document's law.
"""

from typing import Annotated, NamedTuple

from kerfgym.baselines import cn102528288a as scheduled
from kerfgym.baselines.cn102528288a import integral_share, position_gain
from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD

LIMIT = 100.0
"""mm/s, largest part of each integral, as in the document's law here."""


class Params(NamedTuple):
    """Gains of both loops, and which of them follow the error."""

    gain: Annotated[float, Quantity("1/s", 1.0, 1000.0, "largest position gain Kmax", log=True)] = 250.0
    ki: Annotated[float, Quantity("1/s²", 0.0, 20000.0, "integral gain of the position loop")] = 100.0
    kpv: Annotated[float, Quantity("1", 0.0, 5.0, "gain of the speed loop")] = 0.5
    kiv: Annotated[float, Quantity("1/s", 0.0, 500.0, "integral gain of the speed loop")] = 20.0
    share: Annotated[float, Quantity("1", 0.0, 1.0, "of the largest position gain, at any error; 0: scheduled")] = 0.0
    gated: Annotated[float, Quantity("", 0, 1, "integral gains open step by step", choices=("no", "yes"))] = 1.0


State = scheduled.State


@part
def init(params):
    """The initial state."""
    return State(0.0, 0.0, 0.0, 0.0)


@part
def control(params, state, signals, tables):
    """Head velocity, mm/s."""
    error = signals.height - signals.set_height
    gated = params.gated > 0.5
    grows = PERIOD * (integral_share(error) if gated else 1.0)
    grows = 0.0 if signals.override else grows
    share = params.share if params.share > 0.0 else position_gain(error)
    keeps = signals.captured or not gated
    position = clip(state.position - grows * params.ki * error, -LIMIT, LIMIT) if keeps else 0.0
    wanted = position - params.gain * share * error
    slip = wanted - signals.head_velocity
    speed = clip(state.speed + grows * params.kiv * slip, -LIMIT, LIMIT) if keeps else 0.0
    return State(position, speed, signals.height, signals.head_velocity), params.kpv * slip + speed
