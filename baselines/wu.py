"""Wu: proportional position loops for X and Y, with or without feed-forward.

``v = Kp·Kn·E/T`` with the position error E of each axis at the servo instants, T apart. The loop's gain is
``K = Kp·Kn·K_DA·Km·K_AD``, the last three being the drive's; a ramp of v mm/s leaves the constant lag E = v·T/K. Feed-
forward adds the velocity that is about to be issued, and its change, so that the axis need not lag to move.

Drives whose gains differ from direction to direction distort what is cut; Wu demands that software makes the velocity
gains alike (§5.2). So each direction has a relative gain of its own, which multiplies what is asked of the drive that
way: with the reciprocals of the drive's gains all four directions lag alike.
"""

from typing import Annotated, NamedTuple

from kerfgym.envs.engine.lanes import part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant import idle
from kerfgym.envs.plant.controller import Velocities

SLOT = "xy"


class Params(NamedTuple):
    """Gains."""

    kp: Annotated[float, Quantity("1", 0.01, 6.0, "proportional gain Kp", "[A]", log=True)] = 0.54
    kn: Annotated[float, Quantity("1", 0.01, 2.0, "scale Kn; Wu: 0.2", "Wu")] = 0.2
    velocity: Annotated[float, Quantity("1", 0.0, 1.5, "feed-forward of the reference's velocity")] = 0.0
    acceleration: Annotated[float, Quantity("ms", 0.0, 60.0, "feed-forward of its acceleration")] = 0.0
    x_plus: Annotated[float, Quantity("1", 0.5, 2.0, "relative gain towards x+", "Wu")] = 1.0
    x_minus: Annotated[float, Quantity("1", 0.5, 2.0, "relative gain towards x−", "Wu")] = 1.0
    y_plus: Annotated[float, Quantity("1", 0.5, 2.0, "relative gain towards y+", "Wu")] = 1.0
    y_minus: Annotated[float, Quantity("1", 0.5, 2.0, "relative gain towards y−", "Wu")] = 1.0


State, init = idle.State, idle.init  # it remembers nothing


@part
def control(params, state, signals, tables):
    """Velocities of the axes, mm/s."""
    k = params.kp * params.kn / signals.period
    ahead = 1e-3 * params.acceleration
    x = k * signals.error_x + params.velocity * signals.velocity_x + ahead * signals.acceleration_x
    y = k * signals.error_y + params.velocity * signals.velocity_y + ahead * signals.acceleration_y
    return state, Velocities(
        x * (params.x_plus if x > 0.0 else params.x_minus), y * (params.y_plus if y > 0.0 else params.y_minus)
    )
