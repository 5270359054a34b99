"""Xi2023: proportional height follower on a filtered capacitive reading.

``u = −Kv·(height − set height)``. The paper does not publish its gain; ``xi2023-ma`` (moving average, eq. 6) and
``xi2023-improved`` (trimmed mean, Fig. 9) assume 50 1/s, ``xi2023-tuned`` has window, trim and gain tuned.
"""

from typing import Annotated, NamedTuple

from kerfgym.envs.engine.lanes import part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant import idle


class Params(NamedTuple):
    """The loop gain."""

    kv: Annotated[float, Quantity("1/s", 1.0, 400.0, "position loop gain Kv", "[A]", log=True)] = 50.0


State, init = idle.State, idle.init  # it remembers nothing


@part
def control(params, state, signals, tables):
    """Head velocity, mm/s."""
    return state, -params.kv * (signals.height - signals.set_height)
