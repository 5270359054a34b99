"""Patent2022: velocity planning far from the sheet, increments of displacement near it.

With d the height difference (height − set height), each period one of three cases sets the displacement L:

=====================  ======  ==============================  ==========================================
difference             case    kp                              L
=====================  ======  ==============================  ==========================================
d < −ε                 lift    (s/100)·(vs/vm)                 kp·d + (kp/r)·d_prev
\\|d\\| ≤ ε              hold    0.01·(vs/vm)                    the same; none if less than ``smallest``
d > ε, height < h_max  lower   0.01·(vs/vm)                    the same
d > ε, height ≥ h_max  plan    –                               the planned descent's
=====================  ======  ==============================  ==========================================

and the head's velocity is −L/T. vs is the largest speed that the remaining distance allows, ``sqrt(2·a·|d|)``, vm the
largest that the deceleration distance D allows, ``sqrt(2·a·D)``; neither exceeds the fastest descent. The planned
descent accelerates by a·T each period towards vs and then goes on at it; beyond the range the reading stands still, so
vs is the speed from which the head stops within the range.

The print drops the plus sign of L and has no band for the hold; |d| ≤ ε is the reading that makes it reachable. It
gives none of s, r, ε, h_max, a, D and the smallest displacement. ``patent2022`` assumes them and keeps the printed
0.01; in ``patent2022-free`` the constants are tuned. The loop's gain as printed is at most (0.01/T)·(1 + 1/r) and
falls with ``sqrt(|d|)`` to 0.
"""

from typing import Annotated, NamedTuple

import numpy as np

from kerfgym.envs.engine.lanes import part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant.controller import PERIOD


class Params(NamedTuple):
    """Constants of the three cases and of the descent."""

    s: Annotated[float, Quantity("1", 0.1, 1000.0, "sensitivity of the lift", "Patent2022, value [A]", log=True)] = 5.0
    r: Annotated[float, Quantity("1", 0.5, 100.0, "vibration suppression", "Patent2022, value [A]", log=True)] = 1.0
    hold: Annotated[float, Quantity("1", 1e-4, 1.0, "factor of kp in the hold", "Patent2022", log=True)] = 0.01
    lower: Annotated[float, Quantity("1", 1e-4, 1.0, "factor of kp when lowering", "Patent2022", log=True)] = 0.01
    accuracy: Annotated[
        float, Quantity("mm", 1e-4, 1.0, "preset accuracy ε, half the hold's band", "Patent2022, value [A]", log=True)
    ] = 0.01
    smallest: Annotated[
        float, Quantity("mm", 0.0, 0.01, "smallest displacement of the hold", "Patent2022, value [A]")
    ] = 5e-6
    range: Annotated[float, Quantity("mm", 1.0, 10.0, "measuring range h_max", "Patent2022, value [A]")] = 8.0
    acceleration: Annotated[float, Quantity("mm/s²", 100.0, 5e4, "a, of the planned descent")] = 5000.0
    distance: Annotated[
        float, Quantity("mm", 0.01, 20.0, "deceleration distance D", "Patent2022, value [A]", log=True)
    ] = 2.25
    fastest: Annotated[float, Quantity("mm/s", 1.0, 500.0, "fastest descent")] = 150.0


class State(NamedTuple):
    """Last period's height difference."""

    difference: float = 0.0  # mm


@part
def init(params):
    """The initial state."""
    return State(0.0)


@part
def allowed(params, distance):
    """Largest speed from which ``distance`` (mm, of either sign) still allows stopping, mm/s."""
    return min(np.sqrt(2.0 * params.acceleration * abs(distance)), params.fastest)


@part
def displacement(params, difference, last):
    """L of this period within the range, mm, positive downwards.

    Args:
        params: :class:`Params`.
        difference, last: mm, height − set height in this and in the last period.
    """
    lift, lower = difference < -params.accuracy, difference > params.accuracy
    factor = 0.01 * params.s if lift else (params.lower if lower else params.hold)
    kp = factor * allowed(params, difference) / allowed(params, params.distance)
    way = kp * difference + kp / params.r * last
    still = not lift and not lower and abs(way) < params.smallest
    return 0.0 if still else way


@part
def control(params, state, signals, tables):
    """Head velocity, mm/s."""
    d = signals.height - signals.set_height
    last = d if signals.fresh else state.difference
    faster = max(-signals.command, 0.0) + params.acceleration * PERIOD
    planned = min(faster, allowed(params, d))
    beyond = d > params.accuracy and signals.height >= params.range
    return State(d), -planned if beyond else -displacement(params, d, last) / PERIOD
