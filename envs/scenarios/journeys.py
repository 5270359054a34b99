"""What the nozzle travels: the contours of a drawing, or laps of a circle."""

import functools
from typing import TYPE_CHECKING

import numpy as np

from ..plant.path import SPACING, Contour
from .travel import PLAIN, Circle, Reading

if TYPE_CHECKING:
    from ..paths.drawing import Drawing


@functools.lru_cache(maxsize=8)
def drawn(drawing: str, reading: Reading = PLAIN) -> "Drawing":
    """The drawing in a DXF, SVG or G-code file."""
    return reading.drawing(drawing)


@functools.lru_cache(maxsize=8)
def contour(drawing: str, reading: Reading = PLAIN) -> Contour:
    """The journey through a drawing, moved so that its lower left corner lies at x = y = 0."""
    from ..paths.drawing import journey as through

    path = through(drawn(drawing, reading))
    return Contour(path.name, path.x - path.x.min(), path.y - path.y.min(), path.cutting)


@functools.lru_cache(maxsize=8)
def laps(circle: Circle) -> Contour:
    """The journey around a circle, all laps one after the other, the beam on throughout."""
    angle = np.arange(0.0, circle.laps * circle.length + SPACING, SPACING) / circle.radius
    x, y = circle.radius * (1 - np.cos(angle)), circle.radius * np.sin(angle)
    return Contour(f"circle-{circle.radius:g}", x, y, np.ones(len(angle)))
