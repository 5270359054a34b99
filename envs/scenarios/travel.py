"""The journey in a scenario: where the nozzle goes and when what is on, or the job that is cut.

The nozzle travels the contours of a drawing, or laps of a circle, or straight along x.
"""

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from ..engine.quantity import Quantity, quantities
from ..plant import path
from ..plant.path import SPACING, Contour
from .distributions import Number
from .section import Section

if TYPE_CHECKING:
    from ..paths.drawing import Drawing

_PATH, _USUAL = quantities(path.Params), path.Params()


@dataclass(frozen=True, kw_only=True)
class Corners(Section):
    """Corners for which the feed slows down; the path goes straight on."""

    pitch: Annotated[Number, Quantity("mm", 10, 1e4, "one corner in each")]
    feed: Annotated[Number, _PATH["corner_feed"]] = _USUAL.corner_feed
    acceleration: Annotated[Number, _PATH["corner_acceleration"]] = _USUAL.corner_acceleration


@dataclass(frozen=True, kw_only=True)
class Turns(Section):
    """An episode in several turns; what is named is on in the turns whose numbers (from 0) it has, and else off."""

    length: Annotated[float, Quantity("s", 2, 600, "of a turn")]
    count: Annotated[int, Quantity("", 1, 32, "turns, after which they begin anew", whole=True)]
    waves: tuple[int, ...] = ()
    random: tuple[int, ...] = ()
    vibrations: tuple[int, ...] = ()
    impulses: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("waves", "random", "vibrations", "impulses"):
            for turn in getattr(self, name):
                if not 0 <= turn < self.count:
                    raise ValueError(f"{name} = {turn} is out of range; allowed: 0 to {self.count - 1}, the turns")

    def mask(self, name: str) -> float:
        """A bit for each turn in which ``name`` is on."""
        return float(sum(1 << turn for turn in set(getattr(self, name))))


@dataclass(frozen=True, kw_only=True)
class Circle(Section):
    """A circle travelled again and again; it begins and ends at x = y = 0, with its centre on the x axis."""

    radius: Annotated[float, Quantity("mm", 1, 500, "of the circle")] = 30.0
    laps: Annotated[int, Quantity("", 1, 100, "in an episode, at the feed of the scenario", whole=True)] = 8

    @property
    def length(self) -> float:
        """mm of a lap."""
        return 2 * np.pi * self.radius


@dataclass(frozen=True, kw_only=True)
class Reading(Section):
    """How the drawing of ``path``, or of a job's ``part``, is read."""

    units: str | None = None  # mm, cm, m, inches …, instead of what the drawing says
    layers: tuple[str, ...] = ()  # what becomes of which: cut=A,B, engrave=C*, ignore=DIM*; none: all are cut
    colours: tuple[str, ...] = ()  # the same for colours (DXF) and strokes (SVG)
    join: Annotated[float, Quantity("mm", 0, 10, "largest gap between two ends that are joined")] = SPACING
    text: bool = False  # cut letters as outlines
    hatches: bool = False  # cut filled areas as outlines

    def drawing(self, file: str) -> "Drawing":
        """The drawing in a DXF, SVG or G-code file, read so.

        Raises:
            InvalidInput: whatever is wrong in it, where, and what is allowed.
        """
        from ..paths.read import read as read_path

        return read_path(
            file,
            layers=self.layers or None,
            units=self.units,
            colours=self.colours or None,
            join=self.join,
            text=self.text,
            hatches=self.hatches,
        )


PLAIN = Reading()
"""A drawing as it is."""


@dataclass(frozen=True, kw_only=True)
class Job(Section):
    """What is cut, from what, and how the programme around the cuts looks; axes follow it with an error."""

    part: str = "square"  # a built-in part, or a file: DXF, SVG, G-code
    size: Annotated[float, Quantity("mm", 0, 1500, "first size of a built-in part; 0: its own")] = 0.0
    material: str = "c45-10"  # a file of envs/materials
    thickness: Annotated[float, Quantity("mm", 0, 50, "of a material that comes in several; 0: its thinnest")] = 0.0
    feed: Annotated[float, Quantity("mm/s", 0, 2000, "of the cuts; 0: the material's recipe")] = 0.0
    kerf: Annotated[float, Quantity("mm", 0, 5, "compensated; 0: the path is the drawing")] = 0.0
    lead_in: Annotated[float, Quantity("mm", 0, 50, "at most, from the waste into a closed contour; 0: none")] = 3.0
    joints: Annotated[int, Quantity("", 0, 100, "micro-joints in each outline", whole=True)] = 0
    joint_spacing: Annotated[float, Quantity("mm", 0, 1e4, "from joint to joint; 0: their number decides")] = 0.0
    joint_width: Annotated[float, Quantity("mm", 0.05, 10, "of sheet that a joint leaves")] = 0.5
    clearance: Annotated[float, Quantity("mm", 0, 6, "above the cutting height in rapids")] = 4.0
    frog_leap: bool = True  # rise and fall during the rapid instead of before and after
    pierce: bool = True  # each cut begins with a pierce
    override: Annotated[float, Quantity("1", 1, 3, "largest feed override that the process control may ask for")] = 2.0
    power: Annotated[float, Quantity("1", 0, 2, "largest power, of the nominal one")] = 1.2
    pressure: Annotated[Number, Quantity("1", 0.1, 3, "of the gas, of the nominal one")] = 1.0
    standoff: Annotated[Number, Quantity("mm", -0.5, 0.5, "by which the machine is set off the recipe's standoff")] = (
        0.0
    )
    extrapolate: bool = False  # process commands may leave the settings that were published of the material


@functools.lru_cache(maxsize=8)
def read_drawing(drawing: str, reading: Reading = PLAIN) -> "Drawing":
    """The drawing in a DXF, SVG or G-code file."""
    return reading.drawing(drawing)


@functools.lru_cache(maxsize=8)
def contour(drawing: str, reading: Reading = PLAIN) -> Contour:
    """The journey through a drawing, moved so that its lower left corner lies at x = y = 0."""
    from ..paths.drawing import journey as through

    way = through(read_drawing(drawing, reading))
    return Contour(way.name, way.x - way.x.min(), way.y - way.y.min(), way.cutting)


@functools.lru_cache(maxsize=8)
def laps(circle: Circle) -> Contour:
    """The journey around a circle, all laps one after the other, the beam on throughout."""
    angle = np.arange(0.0, circle.laps * circle.length + SPACING, SPACING) / circle.radius
    x, y = circle.radius * (1 - np.cos(angle)), circle.radius * np.sin(angle)
    return Contour(f"circle-{circle.radius:g}", x, y, np.ones(len(angle)))
