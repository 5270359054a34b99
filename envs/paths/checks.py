"""Whether a drawing suits a machine and a job; what does not is an error."""

import numpy as np

from ..engine.quantity import InvalidInput
from .drawing import Drawing


def check_travel(drawing: Drawing, travel: tuple[float, float]) -> None:
    """Whether the drawing, moved to the machine's corner, lies within its axes' travel in x and y, mm.

    Raises:
        InvalidInput: it does not; a quarter turn is offered if that helps.
    """
    low, high = drawing.bounds
    size, room = high - low, np.asarray(travel, float)
    if (size > room).any():
        turned = "; turned by 90° it would fit" if (size[::-1] <= room).all() else ""
        raise InvalidInput(
            f"drawing '{drawing.name}' is {size[0]:.1f} × {size[1]:.1f} mm; allowed: the travel of "
            f"{room[0]:g} × {room[1]:g} mm{turned}; it was read in {drawing.units}"
        )
