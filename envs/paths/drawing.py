"""Drawing: the contours that are cut, whatever file they come from."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..engine.quantity import InvalidInput, did_you_mean
from ..plant.path import Contour, resample
from . import report
from .cleaning import Cleaned, TooMany, without_doubles, without_overlaps
from .collected import LENGTH_RANGE, Collected, listed
from .crossings import Meetings, meetings
from .curve import Curve, Indices, Points, lengths
from .joining import Joints, joined
from .order import ordered
from .overlaps import without_curves_on_others

JOIN_RANGE = (0.0, 10.0)
"""mm, of gaps that may be joined."""

UNITS = {
    **{"mm": 1.0, "cm": 10.0, "m": 1000.0, "inches": 25.4, "feet": 304.8, "yards": 914.4, "mils": 0.0254},
    **{"microns": 1e-3, "dm": 100.0, "dam": 1e4, "hm": 1e5, "km": 1e6, "miles": 1609344.0, "microinches": 25.4e-6},
    **{"US survey feet": 1200e3 / 3937, "US survey inches": 100e3 / 3937, "US survey yards": 3600e3 / 3937},
}
"""mm of each unit that a file can be drawn in."""

SHORT = {"in": "inches", "inch": "inches", "ft": "feet", "mil": "mils", "thou": "mils", "um": "microns", "yd": "yards"}
"""Other names of units."""

LONGEST_JOURNEY = 1e6
"""mm that a nozzle can travel in one run: sampled, 1 km fills half a gigabyte."""


@dataclass(frozen=True)
class Drawing:
    """The contours of a file in cutting order.

    ``pieces`` are arrays of shape (n, 2) in mm, one contour each; ``closed`` tells for each whether it ends where it
    began; ``units`` is the name of the unit in which the file was drawn; ``layers`` are the layers that are cut, in
    order of appearance; ``skipped`` counts what was left out, such as ``{"TEXT": 2, "LINE of zero length": 1}``.

    ``corners`` has for each piece the indices of its true corners: vertices at which the drawn tangent turns by more
    than 5°, 0 for one in the first and last point of a closed piece; all other vertices are chords of something
    smooth. ``feeds`` are the programmed feeds in mm/s, the mean over each piece's time, nan where the programme leaves
    it to the machine, None where there is no programme; ``leg_feeds`` are those of every segment, shape (n − 1,) for a
    piece of n points. ``warnings`` are sentences on what was read otherwise than a user may expect.

    ``engraved`` are pieces that a user wants engraved; the machine only cuts, so they are in no job. ``joints`` tells
    which gaps were joined and which ends stay apart, ``cleaned`` what was there twice, ``meetings`` which contours
    cross or lie on one another.

    Messages number contours in cutting order as they were read, and have their places where the file has them, whatever
    is moved, left out or cut in pieces later: ``numbers`` are the pieces' (None: 1, 2, …), ``origin`` is where in the
    file the pieces' x = y = 0 is, mm.
    """

    name: str
    pieces: list[Points]
    closed: list[bool]
    units: str
    layers: list[str]
    skipped: dict[str, int]
    corners: list[Indices]
    feeds: list[float] | None = None
    warnings: list[str] = field(default_factory=list)
    programmed: bool = False  # a programme's path: cut as it is, in its order, with nothing added
    engraved: list[Points] = field(default_factory=list)
    joints: Joints = field(default_factory=Joints)
    cleaned: tuple[Cleaned, ...] = ()
    leg_feeds: list[npt.NDArray[np.float64]] | None = None
    meetings: Meetings = field(default_factory=Meetings)
    numbers: list[int] | None = None
    origin: tuple[float, float] = (0.0, 0.0)

    def number(self, piece: int) -> int:
        """What messages and pictures call a piece."""
        return self.numbers[piece] if self.numbers else piece + 1

    @property
    def cut_length(self) -> float:
        """mm with the beam on."""
        return float(sum(lengths(p).sum() for p in self.pieces))

    @property
    def move_length(self) -> float:
        """mm between the end of one contour and the start of the next."""
        return float(sum(np.hypot(*(b[0] - a[-1])) for a, b in zip(self.pieces, self.pieces[1:], strict=False)))

    @property
    def bounds(self) -> tuple[Points, Points]:
        """The lower left and the upper right corner of all pieces, mm."""
        points = np.concatenate(self.pieces)
        return points.min(axis=0), points.max(axis=0)

    @property
    def notes(self) -> list[str]:
        """Everything a user should know about how the file was read: warnings, what was cleaned and joined, what
        crosses, what was skipped."""
        told = report.of(self.cleaned, self.joints, self.meetings, self.engraved)
        return [*self.warnings, *told, *(f"{what} is left out ({n})" for what, n in self.skipped.items())]

    @property
    def summary(self) -> str:
        """What there is, in a line."""
        (x, y), opened = self.bounds[1] - self.bounds[0], self.closed.count(False)
        many = f"{len(self.pieces)} contours" if len(self.pieces) > 1 else "1 contour"
        apart = f", {opened} open" if opened else ""
        return f"{many}{apart}, {self.cut_length:.1f} mm to cut, {x:.2f} × {y:.2f} mm, read in {self.units}"


def drawing(
    where: object,
    name: str,
    contours: list[Curve],
    units: str = "mm",
    layers: list[str] | None = None,
    skipped: Mapping[str, int] | None = None,
    feeds: list[float] | None = None,
    warnings: list[str] | None = None,
    cuts: str = "",
) -> Drawing:
    """The drawing of ``contours``, which are in cutting order.

    Args:
        where: the file, for messages.
        cuts: what is cut in such files, for messages.

    Raises:
        InvalidInput: nothing to cut, or a journey whose length is outside :data:`LENGTH_RANGE`.
    """
    if not contours:
        also = "".join(f"; {warning}" for warning in warnings or ())
        left_out = listed(dict(skipped or {}))
        raise InvalidInput(f"{where}: nothing to cut in it; what is cut: {cuts}; skipped: {left_out}{also}")
    points, closed, corners = [c.points for c in contours], [c.closed for c in contours], [c.corners for c in contours]
    others = list(layers or []), dict(skipped or {}), corners, feeds, list(warnings or [])
    found = Drawing(name, points, closed, units, *others)
    low, high = LENGTH_RANGE
    length = found.cut_length + found.move_length
    if not low <= length <= high:
        raise InvalidInput(
            f"{where}: a journey of {length:g} mm ({found.cut_length:g} mm of it cut) is out of range; "
            f"allowed: {low:g} to {high:g} mm; the drawing was read in {units}"
        )
    return found


def finished(file: Path, found: Collected, units: str, join: float, cuts: str) -> Drawing:
    """The drawing of what a reader has collected: cleaned, joined, in cutting order.

    Args:
        file: where it stands, for its name and for messages.
        units: the unit that it was read in, for messages.
        join: mm, the largest gap between two ends that are joined.
        cuts: what is cut in such files, for messages.

    Raises:
        InvalidInput: a gap that is out of range, or as :func:`drawing`.
    """
    low, high = JOIN_RANGE
    if not low <= join <= high:
        raise InvalidInput(f"join = {join:g} mm is out of range; allowed: {low:g} to {high:g} mm")
    curves, steps = list(found.curves.values()), []
    try:
        curves, straight = without_overlaps(curves)
        curves, curved = without_curves_on_others(curves)
        contours, joints = joined(curves, join)
        contours, doubles = without_doubles(contours)
        contours, chains = without_curves_on_others(contours)
        steps = [straight, curved, doubles, chains]
    except TooMany:
        found.warn("too many lines lie on one another to be cleaned: what is there twice is cut twice")
        contours, joints = joined(curves, join)
    layers, warnings = [layer for layer in found.layers if layer], found.warnings()
    made = drawing(file, file.stem, ordered(contours), units, layers, found.skipped, None, warnings, cuts)
    engraved = [curve.points for curve in joined(list(found.engraved.values()), join)[0]]
    twice = Cleaned(length=found.doubled)
    return replace(
        made, engraved=engraved, joints=joints, cleaned=(*steps, twice), meetings=meetings(made.pieces, made.closed)
    )


def journey(drawing: Drawing) -> Contour:
    """The whole drawing as one path, resampled, with the beam off between contours.

    Raises:
        InvalidInput: longer than :data:`LONGEST_JOURNEY`.
    """
    length = drawing.cut_length + drawing.move_length
    if length > LONGEST_JOURNEY:
        raise InvalidInput(
            f"drawing '{drawing.name}': a journey of {length:g} mm is out of range; allowed: up to "
            f"{LONGEST_JOURNEY:g} mm; it was read in {drawing.units}"
        )
    return resample(drawing.name, list(drawing.pieces))


def unit(name: str) -> tuple[str, float]:
    """A unit that a user asked for: its name and its size in mm.

    Raises:
        InvalidInput: not one of :data:`UNITS` or :data:`SHORT`.
    """
    known = name if name in UNITS else SHORT.get(name.lower(), name.lower())
    if known not in UNITS:
        raise InvalidInput(f"units = '{name}' is not known; {did_you_mean(name, UNITS)}")
    return known, UNITS[known]
