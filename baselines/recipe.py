"""Process settings that stay as they are: the material's recipe, or a published one.

The static methods of Huang2024's Table 2 are such settings, and so is its dynamic compound method: the dither is fast,
but it does not change.
"""

from typing import Annotated, NamedTuple

from kerfgym.envs.engine.lanes import part
from kerfgym.envs.engine.quantity import Quantity
from kerfgym.envs.plant import idle
from kerfgym.envs.plant.controller import Process

SLOT = "process"


class Params(NamedTuple):
    """The settings."""

    override: Annotated[float, Quantity("1", 0.05, 2.0, "of the planned feed")] = 1.0
    power: Annotated[float, Quantity("1", 0.05, 1.2, "of the nominal power")] = 1.0
    frequency: Annotated[float, Quantity("Hz", 0.0, 4000.0, "of the dither; 0: none", "Huang2024")] = 0.0
    x: Annotated[float, Quantity("mm", 0.0, 0.3, "amplitude of the dither", "Huang2024")] = 0.0
    y: Annotated[float, Quantity("mm", 0.0, 0.3, "amplitude of the dither", "Huang2024")] = 0.0
    z: Annotated[float, Quantity("mm", 0.0, 5.0, "amplitude of the focus' dither", "Huang2024")] = 0.0
    focus: Annotated[float, Quantity("mm", -5.0, 5.0, "offset of the focus, up positive")] = 0.0
    standoff: Annotated[float, Quantity("mm", -1.0, 1.0, "added to the nominal standoff")] = 0.0


State, init = idle.State, idle.init  # it remembers nothing


@part
def control(params, state, signals, tables):
    """The process' command."""
    return state, Process(
        params.override, params.power, params.frequency, params.x, params.y, params.z, params.focus, params.standoff
    )
