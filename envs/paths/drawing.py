"""Drawing: the contours that are cut, whatever file they come from."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..plant.path import Contour, resample
from ..plant.quantity import InvalidInput, did_you_mean
from .curve import EXACT, Curve, Indices, Points, key

LENGTH_RANGE = (1.0, 50e3)
"""mm, of a journey with its moves between contours."""

UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inches": 25.4}
"""mm of each unit that a file can be drawn in."""


@dataclass(frozen=True)
class Drawing:
    """The contours of a file in cutting order.

    ``pieces`` are arrays of shape (n, 2) in mm, one contour each; ``closed`` tells for each whether it ends where it
    began; ``units`` is the name of the unit in which the file was drawn; ``layers`` are the layers that are cut, in
    order of appearance; ``skipped`` counts what was left out, such as ``{"TEXT": 2, "LINE of zero length": 1}``.

    ``corners`` has for each piece the indices of its true corners: vertices at which the drawn tangent turns by more
    than 5°, 0 for one in the first and last point of a closed piece; all other vertices are chords of something
    smooth. ``feeds`` are the programmed feeds in mm/s, nan where the programme leaves it to the machine, None where
    there is no programme. ``warnings`` are sentences on what was read otherwise than a user may expect.
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

    @property
    def cut_length(self) -> float:
        """mm with the beam on."""
        return float(sum(np.hypot(*np.diff(p, axis=0).T).sum() for p in self.pieces))

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
        """Everything a user should know about how the file was read: the warnings, and what was skipped."""
        return [*self.warnings, *(f"{what} is left out ({n})" for what, n in self.skipped.items())]


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
        left_out = ", ".join(f"{what} ({n})" for what, n in (skipped or {}).items()) or "nothing"
        raise InvalidInput(f"{where}: nothing to cut in it; what is cut: {cuts}; skipped: {left_out}")
    found = Drawing(
        name, [c.points for c in contours], [c.closed for c in contours], units, list(layers or []),
        dict(skipped or {}), [c.corners for c in contours], feeds, list(warnings or []),
    )  # fmt: skip
    low, high = LENGTH_RANGE
    length = found.cut_length + found.move_length
    if not low <= length <= high:
        raise InvalidInput(
            f"{where}: a journey of {length:g} mm ({found.cut_length:g} mm of it cut) is out of range; "
            f"allowed: {low:g} to {high:g} mm; the drawing was read in {units}"
        )
    return found


def journey(drawing: Drawing) -> Contour:
    """The whole drawing as one path, resampled, with the beam off between contours."""
    return resample(drawing.name, list(drawing.pieces))


def unit(name: str) -> tuple[str, float]:
    """A unit that a user asked for: its name and its size in mm.

    Raises:
        InvalidInput: not one of :data:`UNITS` (``in`` and ``inch`` are inches).
    """
    known = {"in": "inches", "inch": "inches"}.get(name, name)
    if known not in UNITS:
        raise InvalidInput(f"units = '{name}' is not known; {did_you_mean(name, UNITS)}")
    return known, UNITS[known]


def chosen(where: object, layers: tuple[str, ...] | list[str] | str | None, known: list[str]) -> set[str] | None:
    """The layers that a user asked for, in lower case; None where all are cut.

    Raises:
        InvalidInput: a layer that is not in the file; the nearest is offered.
    """
    if layers is None:
        return None
    wanted = [layers] if isinstance(layers, str) else list(layers)
    if not wanted:
        raise InvalidInput(f"{where}: layers is empty; name at least one of {', '.join(known) or '(there are none)'}")
    for layer in wanted:
        if layer.casefold() not in {k.casefold() for k in known}:
            raise InvalidInput(f"{where}: no layer '{layer}'; {did_you_mean(layer, known)}")
    return {layer.casefold() for layer in wanted}


class Collected:
    """The curves of a file as they are found, without those of no length and those that are there already."""

    def __init__(self) -> None:
        self.curves: dict[bytes, Curve] = {}
        self.layers: dict[str, None] = {}
        self.skipped: Counter[str] = Counter()

    def add(self, kind: str, curve: Curve, layer: str) -> None:
        """Takes a curve, or counts why not; ``kind`` is what a user calls it."""
        if len(curve.points) < 2 or curve.length < EXACT:
            self.skipped[f"{kind} of zero length"] += 1
        elif (its_key := key(curve.points)) in self.curves:
            self.skipped[f"duplicate {kind}"] += 1
        else:
            self.curves[its_key] = curve
            self.layers[layer] = None
