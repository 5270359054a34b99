"""No law: asks for no motion. The hand that moves the machine is an environment's action or the supervisor's."""

from typing import NamedTuple

from ..engine.lanes import part


class Params(NamedTuple):
    """None; a part needs at least one number."""

    nothing: float = 0.0


class State(NamedTuple):
    """None."""

    nothing: float = 0.0


@part
def init(params):
    """The initial state."""
    return State(0.0)


@part
def control(params, state, signals, tables):
    """No motion."""
    return state, 0.0
