"""Oracle: a tight law with the truth (information class *privileged*); a reference with other information, no bound.

It sees true gap, nozzle, motor and sheet, now and up to 5 ms ahead, on the same machine with the same limits. Like the
preview it commands the sheet's coming speed, taken ``lead`` ahead, with a share of its coming acceleration. On top it
feeds back what no sensor tells: the true gap's error, extrapolated by ``ahead`` with the true relative speed, its
integral, and the motor's acceleration against the sheet's.
"""

from typing import Annotated, NamedTuple

from kerfgym.baselines import preview
from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD

INFORMATION = "privileged"


class Params(NamedTuple):
    """Gains."""

    kp: Annotated[float, Quantity("1/s", 1.0, 400.0, "gain on the motor's error", log=True)] = 53.0
    lead: Annotated[float, Quantity("ms", 0.0, 4.5, "how far ahead the sheet's speed is taken")] = 3.43
    sharpen: Annotated[float, Quantity("ms", -5.0, 10.0, "share of the coming acceleration, as a time")] = 2.1
    ki: Annotated[float, Quantity("1/s²", 0.0, 5000.0, "integral gain on the true gap's error")] = 0.0
    damping: Annotated[float, Quantity("1", -1.0, 2.0, "share of the relative speed that is fed back")] = 0.0
    brake: Annotated[float, Quantity("ms", -5.0, 5.0, "share of the relative acceleration, as a time")] = 0.0
    nozzle: Annotated[float, Quantity("1", 0.0, 1.0, "share of the nozzle in the error, the rest is the motor's")] = 0.0
    limit: Annotated[float, Quantity("mm/s", 0.1, 100.0, "largest integral part")] = 20.0


class State(NamedTuple):
    """Integral and the sheet of the period before."""

    integral: float = 0.0  # mm/s
    surface: float = 0.0  # mm


@part
def init(params):
    """The initial state."""
    return State(0.0, 0.0)


@part
def control(params, state, signals, tables):
    """Head velocity, mm/s."""
    x = signals
    true = x.gap - x.set_height
    error = x.head_position - x.surface_0 - x.set_height
    error += params.nozzle * (true - error)
    last = x.surface_0 if x.fresh else state.surface
    relative = x.velocity - 0.5 * (x.surface_1 - last) / PERIOD
    bent = x.acceleration - (x.surface_1 - 2.0 * x.surface_0 + last) / (PERIOD * PERIOD)
    held = clip(state.integral + params.ki * PERIOD * true, -params.limit, params.limit)
    integral = state.integral if x.override else held
    integral = integral if x.captured else 0.0
    feedback = params.kp * error + integral + params.damping * relative + params.brake * 1e-3 * bent
    return State(integral, x.surface_0), preview.coming(params, x) - feedback
