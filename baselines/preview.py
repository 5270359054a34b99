"""Preview: knows the sheet 5 ms ahead (information class *preview*); a reference with other information, no bound.

Same machine, same limits. The command is the sheet's coming speed, taken ``lead`` ahead to make up for dead time and
servo lag, with a share of its coming acceleration, and a proportional term on the difference between where the sheet
was ``back`` ago and where the encoder says the head is; the reading only corrects the level slowly.
"""

from typing import Annotated, NamedTuple

from kerfgym.envs.engine.lanes import clip, part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD

INFORMATION = "preview"


class Params(NamedTuple):
    """Gains."""

    kp: Annotated[float, Quantity("1/s", 1.0, 400.0, "proportional gain", log=True)] = 60.0
    lead: Annotated[float, Quantity("ms", 0.0, 4.5, "how far ahead the speed is taken")] = 3.5
    sharpen: Annotated[float, Quantity("ms", -5.0, 10.0, "share of the coming acceleration, as a time")] = 1.0
    level: Annotated[float, Quantity("1/s", 0.0, 100.0, "rate at which the reading corrects the level", log=False)] = (
        5.0
    )


class State(NamedTuple):
    """Slow difference between reading and knowledge, and the head's expected place."""

    bias: float = 0.0  # mm
    expected: float = 0.0  # mm, where the head should be now for the commands given


@part
def init(params):
    """The initial state."""
    return State(0.0, 0.0)


@part
def _at(x, time):
    """Surface ``time`` ms ahead, mm, 0 to 5; linear between the known points."""
    t = clip(time, 0.0, 4.999999)
    a = x.surface_0 + clip(t, 0.0, 1.0) * (x.surface_1 - x.surface_0)
    a += clip(t - 1.0, 0.0, 1.0) * (x.surface_2 - x.surface_1)
    a += clip(t - 2.0, 0.0, 1.0) * (x.surface_3 - x.surface_2)
    a += clip(t - 3.0, 0.0, 1.0) * (x.surface_4 - x.surface_3)
    return a + clip(t - 4.0, 0.0, 1.0) * (x.surface_5 - x.surface_4)


@part
def coming(p, x):
    """The sheet's speed ``lead`` ahead, sharpened, mm/s."""
    near = clip(p.lead, 0.5, 4.5)
    rise = _at(x, near + 0.5) - _at(x, near - 0.5)  # mm in 1 ms
    inner = clip(p.lead, 1.5, 4.0)  # where all four points are known
    before, after = _at(x, inner - 0.5) - _at(x, inner - 1.5), _at(x, inner + 1.0) - _at(x, inner)
    return (rise + p.sharpen * ((after - before) / 1.25)) / PERIOD


@part
def control(params, state, signals, tables):
    """Head velocity, mm/s."""
    x = signals
    measured = x.head_position - x.height - x.surface_0
    bias = 0.0 if x.fresh else state.bias + params.level * PERIOD * clip(measured - state.bias, -0.02, 0.02)
    error = x.head_position - x.surface_0 - x.set_height - bias
    return State(bias, error), coming(params, x) - params.kp * error
