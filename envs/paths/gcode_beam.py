"""What of a programme's motion is cut, and the pieces that it makes.

RS274/NGC knows no beam. Which words switch it depends on what the programme uses:

1. M3 or M4: the beam is that spindle, and S0 is off; of several spindles the one with the lowest number. QtPlasmaC's
   output 3 (M62 P3, M64 P3) keeps it off.
2. else M62 to M65: the beam is on while an output other than QtPlasmaC's 2 and 3 is; M67 or M68 with Q0 is off.
3. else M67 or M68: the beam is on while a Q is not 0.
4. else the beam is on in every feed move, except while S is 0.
"""

import math
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby
from typing import NamedTuple

import numpy as np

from .curve import Curve, Floats, key, lengths, linked, polyline

HEIGHT, TORCH = 2, 3
"""Outputs of QtPlasmaC: height control off, torch off."""


@dataclass(frozen=True)
class Switches:
    """What could switch the beam: spindles that turn, S, outputs that are on, and the last Q of each M67 and M68."""

    spindles: frozenset[int] = frozenset()
    speed: float = math.nan
    outputs: frozenset[int] = frozenset()
    levels: tuple[tuple[int, float], ...] = ()

    def leveled(self, output: int, value: float) -> "Switches":
        """After M67 or M68."""
        return replace(self, levels=(*(pair for pair in self.levels if pair[0] != output), (output, value)))


SHUT = 1e-3
"""mm, the largest gap between the ends of a piece that is closed: nothing longer is added to what is programmed."""


class Stroke(NamedTuple):
    """A feed move: line, way (a curve, or the end of a straight line), mm/s (nan: open), state of the switches."""

    line: int
    start: complex
    end: complex
    curve: Curve | None
    feed: float
    switches: Switches


class Piece(NamedTuple):
    """What is cut in one go: the line where it begins, its curve, and mm/s of each of its segments."""

    line: int
    curve: Curve
    feeds: Floats

    @property
    def mean_feed(self) -> float:
        """mm/s, length over time where a feed is programmed; nan where none is."""
        known = np.isfinite(self.feeds)
        steps = lengths(self.curve.points)[known]
        return float(steps.sum() / (steps / self.feeds[known]).sum()) if known.any() else math.nan


class Beam:
    """Takes the motion of a programme as it is run; tells afterwards what of it is cut."""

    def __init__(self) -> None:
        self.strokes: list[Stroke | None] = []  # None: a way without cutting
        self.used: set[str] = set()
        self.spindles: set[int] = set()

    def travel(self) -> None:
        """A rapid move, or a change of the switches."""
        if self.strokes and self.strokes[-1] is not None:
            self.strokes.append(None)

    def rule(self) -> str:
        """What switches the beam, for a warning; empty where it is M3 or M4."""
        if "M3" in self.used:
            return ""
        outputs = self.outputs
        if outputs:
            names = " or ".join(f"P{n}" for n in sorted(outputs))
            return f"no M3 or M4 in it: the beam is read as on while M62 or M64 has {names} on"
        if "M67" in self.used:
            return "no M3 or M4 in it: the beam is read as on while Q of M67 or M68 is not 0"
        if "S" in self.used:
            return "no M3 or M4 in it: the beam is read as on in feed moves, except while S is 0"
        return "no word in it switches a beam: every feed move is read as cut"

    @property
    def outputs(self) -> set[int]:
        """Those that switch the beam where no spindle does."""
        return {int(name[1:]) for name in self.used if name[0] == "P"} - {HEIGHT, TORCH}

    def on(self, s: Switches) -> bool:
        """Whether it cuts."""
        dark = bool(s.levels) and all(value == 0.0 for _, value in s.levels)
        if "M3" in self.used:
            return min(self.spindles) in s.spindles and s.speed != 0.0 and TORCH not in s.outputs
        if self.outputs:
            return bool(s.outputs & self.outputs) and not dark
        if "M67" in self.used:
            return bool(s.levels) and not dark
        return s.speed != 0.0

    def pieces(self) -> list[Piece]:
        """What is cut, in order; a piece ends where the beam goes off or a rapid move goes elsewhere."""
        on = cache(self.on)
        runs = groupby(self.strokes, lambda stroke: stroke is not None and on(stroke.switches))
        return [_piece([stroke for stroke in run if stroke]) for cut, run in runs if cut]


def repeats(pieces: list[Piece]) -> list[tuple[int, int]]:
    """Lines of pieces that are cut where another has been cut before, each behind that one's."""
    first: dict[bytes, Piece] = {}
    pairs = [(first.setdefault(key(piece.curve.points), piece), piece) for piece in pieces]
    return [(before.line, piece.line) for before, piece in pairs if before is not piece]


def _piece(strokes: list[Stroke]) -> Piece:
    curves: list[Curve] = []
    for straight, run in groupby(strokes, lambda stroke: stroke.curve is None):
        some = list(run)
        lines = [polyline([some[0].start, *(stroke.end for stroke in some)])] if straight else []
        curves += lines or [stroke.curve for stroke in some if stroke.curve]
    curve = linked(curves)
    if float(np.hypot(*(curve.points[-1] - curve.points[0]))) <= SHUT < curve.length:
        curve = linked(curves, closed=True)
    ends = np.cumsum([abs(s.end - s.start) if s.curve is None else s.curve.length for s in strokes])
    steps = lengths(curve.points)
    middles = np.cumsum(steps) - 0.5 * steps
    of = np.minimum(np.searchsorted(ends, middles), len(strokes) - 1)
    return Piece(strokes[0].line, curve, np.array([s.feed for s in strokes])[of])
