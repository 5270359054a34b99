"""What a controller decides about a job before it starts: how its path is planned."""

from typing import Annotated, NamedTuple

from ..engine.quantity import Quantity


class Axes(NamedTuple):
    """Planning for the axes, part of a stack in the slot ``xy``; limits of the machine hold beside it."""

    corners: Annotated[
        float,
        Quantity(
            "1", 0, 1, "1: acceleration and deceleration, slow through corners; 0: constant feed", "Wu", whole=True
        ),
    ] = 1.0
    acceleration: Annotated[float, Quantity("mm/s²", 10, 50000, "along the path", "[A]", log=True)] = 1000.0
    jerk: Annotated[float, Quantity("mm/s³", 100, 1e7, "along the path", "[A]", log=True)] = 2e4
    corner_jump: Annotated[float, Quantity("mm/s", 0, 500, "jump of an axis' velocity allowed at a corner", "[A]")] = (
        1.0
    )


class Feed(NamedTuple):
    """Planning for the cut, part of a stack in the slot ``process``."""

    feed: Annotated[float, Quantity("mm/s", 0, 2000, "of the cuts; 0: what the scenario says", "[A]")] = 0.0
