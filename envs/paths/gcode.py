"""G-code: what a programme cuts, in its own order and direction.

Read is the plane part of RS274/NGC: straight lines and arcs in the XY plane, with the beam switched by M3, M4 and M5.
Heights are left to the machine, which follows the sheet. A word that is not understood is an error, so that nothing
is cut otherwise than programmed; words that change nothing about the path are listed.
"""

import math
from pathlib import Path

import numpy as np

from ..plant.quantity import InvalidInput
from .contours import GAP
from .curve import EXACT, Curve, arc, key, linked
from .curve import line as straight
from .drawing import UNITS, Drawing, drawing, unit
from .gcode_words import Line, Programme, Word

MOTION = ("G0", "G1", "G2", "G3")

HARMLESS = {
    "G4": ("dwell", "P"),
    "G15": ("no polar coordinates", ""),
    "G40": ("no cutter compensation", ""),
    "G43": ("tool length", "H"),
    "G49": ("no tool length", ""),
    "G61": ("exact path", ""),
    "G61.1": ("exact stop", ""),
    "G64": ("path blending", "PQ"),
    "G69": ("no rotation", ""),
    "G80": ("no canned cycle", ""),
    "G94": ("feed per minute", ""),
    "G97": ("constant spindle speed", ""),
    "G98": ("retract of cycles", ""),
    "G99": ("retract of cycles", ""),
    "M0": ("pause", ""),
    "M1": ("pause", ""),
    "M6": ("tool change", ""),
    "M7": ("coolant or gas", ""),
    "M8": ("coolant or gas", ""),
    "M9": ("coolant or gas", ""),
    "M48": ("overrides", ""),
    "M49": ("overrides", ""),
    "M50": ("feed override", "P"),
    "M51": ("spindle override", "P"),
    "M52": ("adaptive feed", "P"),
    "M53": ("feed stop", "P"),
    "M60": ("pause", ""),
    "T": ("tool", ""),
    "S": ("spindle speed or power", ""),
    "Z": ("heights: the head follows the sheet", ""),
}
"""Words that change nothing about the path: what they are, and the letters that may come with them."""

SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
MODES = ("G17", "G18", "G19", "G20", "G21", "G90", "G91", "G90.1", "G91.1")
SWITCHES = ("M2", "M3", "M4", "M5", "M30")
READ = "G0 to G3, G17, G20, G21, G90, G91, G90.1, G91.1, F, M2 to M5, M30"

SLACK = 2 * 0.01 * math.sqrt(2.0)
"""mm by which the two radii of an arc may differ, or its ends be too far apart: numbers rounded to 0.01 mm.
[P] LinuxCNC, CENTER_ARC_RADIUS_TOLERANCE_MM"""

SLACK_SHARE = 0.001
"""Of the radius, by which they may differ all the same, [P] LinuxCNC, SPIRAL_RELATIVE_TOLERANCE …"""

SLACK_MOST = 0.5
"""mm, … up to this. [P] Grbl"""


def read_gcode(
    path: str | Path, *, layers: tuple[str, ...] | list[str] | str | None = None, units: str | None = None
) -> Drawing:
    """The cuts of a G-code programme as they stand in it: neither joined nor put into another order.

    G1, G2 and G3 cut while M3 or M4 is on (S0 is off); G0 does not. A piece ends where the beam goes off or a G0 moves.

    Args:
        path: a G-code file.
        layers: None; programmes have no layers.
        units: what numbers are in until the programme says G20 or G21.

    Raises:
        InvalidInput: file, line and word of the first that cannot be read; an arc whose numbers do not fit each other;
            nothing to cut; or a journey whose length is out of range.
    """
    file = Path(path)
    if layers is not None:
        raise InvalidInput(f"{file}: layers = {layers!r}: G-code has no layers")
    return _Machine(file, unit(units)[0] if units is not None else None).run()


class _Machine:
    """The state that a programme leads through."""

    def __init__(self, file: Path, units: str | None) -> None:
        self.file = file
        self.units, self.told = units or "mm", units is not None
        self.used: dict[str, None] = {}
        self.motion = ""
        self.plane = "G17"
        self.absolute, self.absolute_centre = True, False
        self.at, self.placed = 0j, {"X": False, "Y": False}
        self.feed = math.nan
        self.spindle, self.power = False, math.nan
        self.system = ""
        self.listed: dict[str, list[int]] = {}
        self.skipped: dict[str, int] = {}
        self.strokes: list[tuple[int, Curve, float]] = []  # of the piece that is being cut: line, curve, mm/s
        self.pieces: list[tuple[int, Curve, float]] = []
        self.programme = Programme(file, _text(file))

    def run(self) -> Drawing:
        for line in self.programme:
            if self.line(line):
                break
        self.finish()
        self.name_repeats()
        feeds = [feed for *_, feed in self.pieces]
        if feeds and not any(math.isfinite(f) for f in feeds):
            feeds = []
        notes = [f"{text} (line {_lines(lines)})" for text, lines in self.listed.items()] + self.programme.unused()
        return drawing(
            self.file, self.file.stem, [curve for _, curve, _ in self.pieces], " and ".join(self.used) or self.units,
            skipped=self.skipped, feeds=feeds or None, warnings=notes,
            cuts="G1, G2 and G3 while M3 or M4 is on and S is not 0",
        )  # fmt: skip

    # A line

    def line(self, line: Line) -> bool:
        """Does what a line says, in the order of RS274/NGC; whether the programme ends with it."""
        codes: dict[str, Word] = {}
        values: dict[str, Word] = {}
        for word in line.words:
            name = f"{word.letter}{word.value:g}" if word.letter in "GM" else word.letter
            group = codes if word.letter in "GM" else values
            if name in group:
                raise self.wrong(line, word, "it stands twice in this line")
            group[name] = word
        self.check(line, codes, values)
        self.set_modes(line, codes, values)
        self.switch(line, codes, values)
        self.move(line, codes, values)
        return "M2" in codes or "M30" in codes

    def wrong(self, line: Line, word: Word | str, problem: str) -> InvalidInput:
        text = word if isinstance(word, str) else word.text
        return InvalidInput(f"{self.programme.where(line.number)}: '{text}': {problem}")

    def note(self, line: Line, text: str) -> None:
        self.listed.setdefault(text, []).append(line.number)

    def check(self, line: Line, codes: dict[str, Word], values: dict[str, Word]) -> None:
        """Every word must be known, and every letter belong to a word of the line."""
        letters = set("NXYZFST$")
        for name, word in codes.items():
            if name in HARMLESS:
                what, with_it = HARMLESS[name]
                letters |= set(with_it)
                self.note(line, f"{name} ({what}) is left out")
            elif name in SYSTEMS:
                if self.system not in ("", name):
                    raise self.wrong(
                        line, word, f"after {self.system}: where one lies from the other is not known here"
                    )
                self.system = name
                self.note(line, f"{name} (coordinate system) is left out")
            elif name not in (*MOTION, *MODES, *SWITCHES):
                raise self.wrong(line, word, f"it is not read; read are {READ} and words that change no path")
        motions = [name for name in codes if name in (*MOTION, "G80")]
        if len(motions) > 1:
            raise self.wrong(line, codes[motions[1]], f"{motions[0]} stands in the same line")
        for a, b in (("G20", "G21"), ("G90", "G91"), ("G90.1", "G91.1"), ("M3", "M5"), ("M4", "M5"), ("M3", "M4")):
            if a in codes and b in codes:
                raise self.wrong(line, codes[b], f"{a} stands in the same line")
        if (motions[0] if motions else self.motion) in ("G2", "G3"):
            letters |= set("IJRP")
        for letter, word in values.items():
            if letter not in letters:
                raise self.wrong(line, word, "it is not read, or not with the other words of this line")
            if math.isnan(word.value) and letter not in "FS":
                raise self.wrong(line, word, "its value is known to the machine only")
        if "$" in values and values["$"].value != 0:
            raise self.wrong(line, values["$"], "only spindle $0 is the beam")
        for letter in ("T", "Z"):
            if letter in values:
                self.note(line, f"{letter} ({HARMLESS[letter][0]}) is left out")

    def set_modes(self, line: Line, codes: dict[str, Word], values: dict[str, Word]) -> None:
        for name in codes:
            match name:
                case "G17" | "G18" | "G19":
                    self.plane = name
                case "G20" | "G21":
                    self.units, self.told = ("inches" if name == "G20" else "mm"), True
                case "G90" | "G91":
                    self.absolute = name == "G90"
                case "G90.1" | "G91.1":
                    self.absolute_centre = name == "G90.1"
                case "G80":
                    self.motion = ""
                case _ if name in MOTION:
                    self.motion = name
        if "F" in values:
            self.feed = values["F"].value * UNITS[self.units] / 60.0
            if math.isnan(self.feed):
                self.note(line, f"{values['F'].text} is known to the machine only; the feed is left open")
            elif self.feed <= 0.0:
                raise self.wrong(line, values["F"], "a feed must be more than 0")

    def switch(self, line: Line, codes: dict[str, Word], values: dict[str, Word]) -> None:
        """The beam: before the motion of the line, as in RS274/NGC."""
        if "S" in values:
            self.power = values["S"].value
            self.note(line, f"S ({HARMLESS['S'][0]}) is left out; S0 is off")
        if "M3" in codes or "M4" in codes:
            self.spindle = True
        if "M5" in codes:
            self.spindle = False
        if not self.cutting:
            self.finish()

    @property
    def cutting(self) -> bool:
        return self.spindle and self.power != 0.0

    # Motion

    def move(self, line: Line, codes: dict[str, Word], values: dict[str, Word]) -> None:
        axes = [values[a] for a in ("X", "Y", "Z", "I", "J", "R") if a in values]
        if not axes:
            if any(name in ("G2", "G3") for name in codes):
                raise self.wrong(line, codes[self.motion], "an arc without X, Y, I, J or R")
            return
        if "G4" in codes:
            raise self.wrong(line, axes[0], "it stands with a dwell, G4")
        if not self.motion:
            raise self.wrong(line, axes[0], "no G0, G1, G2 or G3 says how to move there")
        if not self.told:
            self.told = True
            self.note(line, "neither G20 nor G21 before it, numbers read as mm; units= reads them otherwise")
        self.used.setdefault(self.units)
        start, end = self.at, self.target(values)
        if self.motion in ("G0", "G1"):
            stroke = straight(start, end)
        else:
            stroke = self.arc(line, values, start, end)
        if self.motion == "G0":
            self.pause(line, stroke)
        elif self.cutting:
            self.cut(line, stroke, moves="X" in values or "Y" in values or self.motion != "G1")
        self.at = end
        for axis in ("X", "Y"):
            self.placed[axis] |= axis in values

    def target(self, values: dict[str, Word]) -> complex:
        x, y = (self.mm(values, a) for a in "XY")
        if not self.absolute:
            return self.at + complex(x or 0.0, y or 0.0)
        return complex(self.at.real if x is None else x, self.at.imag if y is None else y)

    def mm(self, values: dict[str, Word], letter: str) -> float | None:
        return values[letter].value * UNITS[self.units] if letter in values else None

    def pause(self, line: Line, stroke: Curve) -> None:
        """A rapid move."""
        if len(stroke.points) > 1:
            if self.cutting:
                self.note(line, "G0 while M3 or M4 is on: read as a move without cutting")
            self.finish()

    def cut(self, line: Line, stroke: Curve, moves: bool) -> None:
        if len(stroke.points) < 2:
            if moves:
                self.skipped[f"{self.motion} of zero length"] = self.skipped.get(f"{self.motion} of zero length", 0) + 1
            return
        if not all(self.placed.values()) and not self.strokes and not self.pieces:
            self.note(
                line, f"the first cut begins at X{self.at.real:g} Y{self.at.imag:g} mm without having been sent there"
            )
        if math.isnan(self.feed) and not any("feed is left open" in text for text in self.listed):
            self.note(line, "no F before it; the feed is left open")
        self.strokes.append((line.number, stroke, self.feed))

    def arc(self, line: Line, values: dict[str, Word], start: complex, end: complex) -> Curve:
        word = next(values[a] for a in ("X", "Y", "I", "J", "R", "Z") if a in values)
        if self.plane != "G17":
            raise self.wrong(line, word, f"an arc in the plane of {self.plane}; only those of G17 are read")
        if "P" in values and values["P"].value != 1:
            raise self.wrong(line, values["P"], "an arc of more than one turn")
        sense = 1.0 if self.motion == "G3" else -1.0
        i, j, r = (self.mm(values, a) for a in "IJR")
        if r is not None:
            if i is not None or j is not None:
                raise self.wrong(line, values["R"], "an arc has either R or I and J")
            return self.by_radius(line, values["R"], start, end, r, sense)
        if i is None and j is None:
            raise self.wrong(line, word, f"{self.motion} needs I, J or R")
        if self.absolute_centre and (i is None or j is None):
            raise self.wrong(line, word, "after G90.1 an arc needs both I and J")
        centre = complex(i or 0.0, j or 0.0) + (0j if self.absolute_centre else start)
        inner, outer = sorted((abs(start - centre), abs(end - centre)))
        if outer - inner > SLACK_MOST or outer - inner > max(SLACK, SLACK_SHARE * outer):
            raise self.wrong(
                line, " ".join(values[a].text for a in "XYIJ" if a in values),
                f"the ends of the arc are {abs(start - centre):.4f} and {abs(end - centre):.4f} mm from its centre; "
                f"they may differ by {max(SLACK, min(SLACK_SHARE * outer, SLACK_MOST)):.4f} mm",
            )  # fmt: skip
        if outer < EXACT:
            raise self.wrong(line, word, "an arc without radius")
        if abs(end - start) < EXACT:
            return arc(centre, start, start, sense * 2 * math.pi)
        return arc(centre, start, end, _swept(start - centre, end - centre, sense))

    def by_radius(self, line: Line, word: Word, start: complex, end: complex, r: float, sense: float) -> Curve:
        """The arc of radius ``r``; of the two, the shorter if it is positive, else the longer."""
        half = 0.5 * abs(end - start)
        if half < EXACT / 2:
            raise self.wrong(
                line, word, "an arc by its radius must end elsewhere than it begins; a circle needs I or J"
            )
        if half - abs(r) > SLACK:
            raise self.wrong(line, word, f"the ends of the arc are {2 * half:.4f} mm apart, more than twice its radius")
        rise = math.sqrt(max(r * r - half * half, 0.0)) * math.copysign(sense, sense * r)
        centre = 0.5 * (start + end) + 1j * rise * (end - start) / (2 * half)
        return arc(centre, start, end, _swept(start - centre, end - centre, sense))

    # Pieces

    def finish(self) -> None:
        """What has been cut since the beam came on becomes a piece."""
        if not self.strokes:
            return
        curves = [curve for _, curve, _ in self.strokes]
        line = self.strokes[0][0]
        curve = linked(curves)
        gap = float(np.hypot(*(curve.points[-1] - curve.points[0])))
        if gap <= GAP < curve.length:
            curve = linked(curves, closed=True)
        spent: dict[float, float] = {}
        for _, stroke, feed in self.strokes:
            feed = -1.0 if math.isnan(feed) else feed
            spent[feed] = spent.get(feed, 0.0) + stroke.length
        feed = max(spent, key=lambda f: spent[f])
        if len(spent) > 1:
            text = "F changes within a cut; the feed of its longest part is taken for all of it"
            self.listed.setdefault(text, []).append(line)
        self.pieces.append((line, curve, math.nan if feed < 0 else feed))
        self.strokes = []

    def name_repeats(self) -> None:
        """Lists the pieces that are cut where another has been cut before."""
        seen: dict[bytes, int] = {}
        for line, curve, _ in self.pieces:
            before = seen.setdefault(key(curve.points), line)
            if before != line:
                self.listed.setdefault(f"the cut from line {before} is made again", []).append(line)


def _swept(a: complex, b: complex, sense: float) -> float:
    """The angle from ``a`` to ``b`` in that sense, rad: more than 0 and at most 2π, with the sign of ``sense``."""
    angle = sense * float(np.angle(b * np.conj(a)))
    return sense * (angle if angle > 0.0 else angle + 2 * math.pi)


def _lines(numbers: list[int]) -> str:
    """«3, 5, 8 and 12 more»."""
    shown = ", ".join(map(str, numbers[:3]))
    return shown if len(numbers) <= 3 else f"{shown} and {len(numbers) - 3} more"


def _text(file: Path) -> str:
    raw = file.read_bytes()
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")
