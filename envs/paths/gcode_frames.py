"""Where a programme's coordinates lie on the machine: G54 to G59.3, G10, G52, G92, G53, G28, G30 and tool offsets.

A point of the programme is moved by the offset of G52 and G92, turned by the coordinate system's angle, moved by its
origin, and moved by the tool's offset. What is kept is where the machine is; when an offset changes, the machine stays
and the programme's coordinates change. Everything is in mm; a machine's own offsets, which a file cannot know, are 0.
"""

import cmath
import math
from typing import NamedTuple

from .gcode_parameters import Parameters

SYSTEMS = {"G54": 1, "G55": 2, "G56": 3, "G57": 4, "G58": 5, "G59": 6, "G59.1": 7, "G59.2": 8, "G59.3": 9}

HOME = {"G28": 5161, "G30": 5181}
"""First of the parameters with the place that each goes to."""

SHIFT = 5211
"""First of the parameters that keep the offset of G92, behind the one that says whether it is on."""


def origin_of(system: int) -> int:
    """The first of the parameters with a coordinate system's origin; its angle comes ten numbers later, less one."""
    return 5201 + 20 * system


class Point(NamedTuple):
    """In the plane, x + jy, and above it; mm."""

    xy: complex
    z: float

    def but(self, given: dict[str, float]) -> "Point":
        """The same with other X, Y and Z where these are given."""
        x, y = given.get("X", self.xy.real), given.get("Y", self.xy.imag)
        return Point(complex(x, y), given.get("Z", self.z))


class Frames:
    """``at``: where the machine is, mm."""

    def __init__(self, parameters: Parameters) -> None:
        self.stored = parameters.numbers
        self.stored[5220] = 1.0
        self.at = Point(0j, 0.0)
        self.system = 1
        self.origin, self.angle = Point(0j, 0.0), 0.0
        self.shift, self.tool = Point(0j, 0.0), Point(0j, 0.0)

    # Between programme and machine

    @property
    def turn(self) -> complex:
        """The rotation of the coordinate system as a factor."""
        return cmath.rect(1.0, math.radians(self.angle)) if self.angle else 1.0 + 0j

    @property
    def offset(self) -> complex:
        """What is added, in the plane, to a point of the programme that has been turned."""
        return self.turn * self.shift.xy + self.origin.xy + self.tool.xy

    def here(self) -> Point:
        """Where the machine is, in the programme's coordinates."""
        return self.programmed(self.at)

    def programmed(self, place: Point) -> Point:
        """A place of the machine in the programme's coordinates."""
        return Point(
            (place.xy - self.origin.xy - self.tool.xy) / self.turn - self.shift.xy,
            place.z - self.origin.z - self.tool.z - self.shift.z,
        )

    def machine(self, point: Point) -> Point:
        """A point of the programme on the machine."""
        return Point(self.turn * point.xy + self.offset, point.z + self.shift.z + self.origin.z + self.tool.z)

    # Coordinate systems

    def load(self, system: int) -> None:
        """G54 to G59.3."""
        first = origin_of(system)
        self.system, self.stored[5220] = system, float(system)
        self.origin, self.angle = self._stored(first), self.stored.get(first + 9, 0.0)

    def knows(self, system: int) -> bool:
        """Whether the programme has said where a coordinate system lies."""
        first = origin_of(system)
        return any(first + i in self.stored for i in range(10))

    def define(self, system: int, given: dict[str, float], angle: float | None, here: bool) -> None:
        """G10 L2, or with ``here`` L20: the axes that are ``given``, mm, of a coordinate system."""
        first = origin_of(system or self.system)
        turn = self.stored.get(first + 9, 0.0) if angle is None else angle
        if angle is not None:
            self.stored[first + 9] = angle
        if here:
            # As if the point given, with the offset of G92, were where the machine is now.
            old = self._stored(first)
            bare = Point(self.at.xy - self.tool.xy, self.at.z - self.tool.z)
            rotation = cmath.rect(1.0, math.radians(turn))
            now = (bare.xy - old.xy) / rotation - self.shift.xy
            origin = bare.xy - rotation * (Point(now, 0.0).but(given).xy + self.shift.xy)
            given = {"X": origin.real, "Y": origin.imag} | (
                {"Z": bare.z - given["Z"] - self.shift.z} if "Z" in given else {}
            )
        for i, axis in enumerate("XYZ"):
            if axis in given:
                self.stored[first + i] = given[axis]
        if (system or self.system) == self.system:
            self.load(self.system)

    def _stored(self, first: int) -> Point:
        x, y, z = (self.stored.get(first + i, 0.0) for i in range(3))
        return Point(complex(x, y), z)

    # G52 and G92

    def call_here(self, given: dict[str, float]) -> None:
        """G92: where the machine is now has these coordinates."""
        here = self.here()
        there = here.but(given)
        self.set_shift(Point(here.xy + self.shift.xy - there.xy, here.z + self.shift.z - there.z))

    def move_by(self, given: dict[str, float]) -> None:
        """G52."""
        self.set_shift(self.shift.but(given))

    def set_shift(self, shift: Point, keep: bool = True) -> None:
        """The offset of G52 and G92; ``keep``: in the parameters, too."""
        self.shift = shift
        self.stored[SHIFT - 1] = float(keep and shift != Point(0j, 0.0))
        if keep:
            self._store(SHIFT, shift)

    def recall_shift(self) -> None:
        """G92.3."""
        self.set_shift(self._stored(SHIFT))

    # G28 and G30

    def keep_home(self, name: str) -> None:
        """G28.1 or G30.1: here."""
        self._store(HOME[name], self.at)

    def _store(self, first: int, point: Point) -> None:
        self.stored |= zip(range(first, first + 3), (point.xy.real, point.xy.imag, point.z), strict=True)

    def home(self, name: str, axes: set[str]) -> Point:
        """The place on the machine that G28 or G30 goes to; in ``axes`` of the programme only, or in all."""
        stored, here = self._stored(HOME[name]), self.here()
        if not axes:
            return stored
        there = self.programmed(stored)
        x, y = (there if axis in axes else here for axis in "XY")
        return self.machine(Point(complex(x.xy.real, y.xy.imag), (there if "Z" in axes else here).z))
