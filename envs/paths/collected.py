"""What a reader has found so far, within limits: no file may ask for more time or memory than a drawing is worth."""

from collections import Counter
from collections.abc import Iterable

import numpy as np

from ..engine.quantity import InvalidInput
from .choice import SHOWN
from .curve import EXACT, Curve, key

MOST_ENTITIES = 100_000
"""Entities or elements that are looked at, those of blocks once for each place where a block stands."""

MOST_POINTS = 4_000_000
"""Points of all curves together."""

FARTHEST = 1e9
"""mm from the origin. Beyond, numbers cannot tell apart what lies 1 µm apart once they are squared."""

LENGTH_RANGE = (0.1, 1e7)
"""mm of the way through a drawing, moves between its contours included."""

TOLD = 5
"""Warnings of one kind that are told in full; further ones are counted."""


class Collected:
    """The curves of a file as they are found, without those of no length and those that are there already.

    ``curves`` are cut; ``engraved`` are those that a user wants engraved; ``layers`` are the layers of both;
    ``skipped`` counts what was left out and why; ``told`` are the warnings, each with what it is about.
    """

    def __init__(self, where: object) -> None:
        self.where = where
        self.curves: dict[bytes, Curve] = {}
        self.engraved: dict[bytes, Curve] = {}
        self.layers: dict[str, None] = {}
        self.skipped: Counter[str] = Counter()
        self.told: dict[str, dict[str, None]] = {}
        self.entities = self.points = 0
        self.length = self.doubled = 0.0

    def entity(self) -> None:
        """Counts an entity that is looked at.

        Raises:
            InvalidInput: it is one more than a drawing may have.
        """
        self.entities += 1
        self.room_for(0)

    def room_for(self, count: int) -> None:
        """Whether there may be ``count`` entities more.

        Raises:
            InvalidInput: there may not.
        """
        if self.entities + count > MOST_ENTITIES:
            raise InvalidInput(
                f"{self.where}: more than {MOST_ENTITIES} entities, those of repeated blocks counted each time; "
                "allowed: no more; are blocks or elements repeated without end?"
            )

    def add(self, kind: str, curve: Curve, layer: str, role: str = "cut", which: str = "") -> None:
        """Takes a curve, or counts why not; ``kind`` is what a user calls it, ``which`` where he finds it, such as
        ``in line 3``.

        Raises:
            InvalidInput: longer, finer or farther away than a drawing may be.
        """
        into, what = self.engraved if role == "engrave" else self.curves, f"{kind} {which}".rstrip()
        far = float(np.abs(curve.points).max(initial=0.0))
        if far > FARTHEST:  # first: far away numbers cannot tell a circle from a point
            raise InvalidInput(
                f"{self.where}: {what} reaches {far:g} mm away from the origin, out of range; "
                f"allowed: {FARTHEST:g} mm ({FARTHEST / 1e6:g} km); is the unit right?"
            )
        if len(curve.points) < 2 or curve.length < EXACT:
            self.skipped[f"{kind} of zero length"] += 1
            return
        self.points += len(curve.points)
        self.length += curve.length
        if self.points > MOST_POINTS:
            raise InvalidInput(
                f"{self.where}: curves of more than {MOST_POINTS} points up to {what}, out of range; allowed: fewer"
            )
        if self.length > LENGTH_RANGE[1]:
            raise InvalidInput(
                f"{self.where}: more than {LENGTH_RANGE[1]:g} mm to cut up to {what}, out of range; allowed: "
                f"{LENGTH_RANGE[0]:g} to {LENGTH_RANGE[1]:g} mm; is the unit right?"
            )
        if (its_key := key(curve.points)) in into:
            self.skipped[f"duplicate {kind}"] += 1
            self.doubled += curve.length
        else:
            into[its_key] = curve
            self.layers[layer] = None

    def warn(self, kind: str, one: str = "") -> None:
        """Notes a warning: a sentence, and what it is about this time."""
        each = self.told.setdefault(kind, {})
        if one:
            each.setdefault(one)

    def warnings(self) -> list[str]:
        """A line for each kind of warning."""
        return [f"{kind}: {some(each)}" if each else kind for kind, each in self.told.items()]


def listed(counts: Counter[str] | dict[str, int]) -> str:
    """«LINE (3), TEXT (1)», for messages."""
    return some((f"{what} ({n})" for what, n in counts.items()), SHOWN, ", ") or "nothing"


def some(items: Iterable[str], most: int = TOLD, between: str = "; ") -> str:
    """The first of ``items``, and how many more there are, for messages."""
    every = list(items)
    return between.join(every[:most]) + (f" and {len(every) - most} more" if len(every) > most else "")
