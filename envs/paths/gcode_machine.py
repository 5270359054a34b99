"""The machine that a G-code programme leads: it does each line's words in the order of RS274/NGC.

[P] LinuxCNC 2.9, "Order of execution", and its stand-alone interpreter ``rs274``, with which a test and the corpus
script compare.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from .gcode_codes import AXES, CODES, CYCLES, HARMLESS, READ
from .gcode_flow import Line
from .gcode_frames import SYSTEMS, Point
from .gcode_modes import SET_BY, Modes
from .gcode_motion import Motion
from .gcode_state import State
from .gcode_words import Word

Codes = dict[str, Word]


class Kept(NamedTuple):
    """What M70 and M73 keep; ``by_itself``: it is restored when its subroutine ends."""

    modes: Modes
    system: int
    tool: Point
    by_itself: bool


class Machine(State):
    """Runs a programme; ``units``: mm or inches until the programme says."""

    def __init__(self, file: Path, units: str | None) -> None:
        super().__init__(file, units)
        self.motion = Motion(self)
        self.kept: dict[int, Kept] = {}

    def run(self) -> None:
        """Runs the programme to its end."""
        for line in self.programme:
            if self.line(line):
                return

    # A line

    def line(self, line: Line) -> bool:
        """Does what a line says; whether the programme ends with it."""
        for depth in [d for d in self.kept if d > line.depth]:
            left = self.kept.pop(depth)
            if left.by_itself:
                self.restore(left)
        codes: Codes = {}
        values: dict[str, Word] = {}
        for word in line.words:
            name = f"{word.letter}{word.value:g}" if word.letter in "GM" else word.letter
            group = codes if word.letter in "GM" else values
            if name in group:
                raise self.wrong(line, word, "it stands twice in this line")
            group[name] = word
        if codes or len(values) > 2 or not values.keys() <= {"X", "Y"}:
            self.check(line, codes, values)
            self.feed(line, codes, values)
            self.switch(line, codes, values)
            self.set_modes(line, codes)
            if self.special(line, codes, values):
                return self.stop(line, codes, values)
        self.motion.move(line, codes, values)
        return self.stop(line, codes, values)

    def check(self, line: Line, codes: Codes, values: dict[str, Word]) -> None:
        """Every word must be known, exclude no other of the line, and every letter belong to a word of the line."""
        letters = set("FST")
        groups: dict[str, str] = {}
        for name, word in codes.items():
            code = CODES.get(name)
            if code is None:
                raise self.wrong(line, word, f"it is not read; read are {READ}, and words that change no path")
            if code.refused:
                raise self.wrong(line, word, f"it is not read: {code.refused}")
            if code.group in groups:
                raise self.wrong(line, word, f"{groups[code.group]} stands in the same line")
            groups[code.group] = name
            letters |= set(code.letters)
            if code.harmless:
                self.note(line, f"{name} ({code.harmless}) is left out")
        if "motion" not in groups and self.modes.motion:
            letters |= set(CODES[self.modes.motion].letters)
        if not codes or "S" in values:
            letters |= set("$")
        for letter, word in values.items():
            if letter not in letters and letter not in AXES:
                raise self.wrong(line, word, "it is not read, or not with the other words of this line")
            if math.isnan(word.value) and letter not in "FS":
                raise self.wrong(line, word, "its value is known to the machine only")
        for letter in ("T", "Z"):
            if letter in values:
                self.note(line, f"{letter} ({HARMLESS[letter]}) is left out")
        if "T" in values:
            self.modes.tool = values["T"].value

    # Feed, spindle, outputs

    def feed(self, line: Line, codes: Codes, values: dict[str, Word]) -> None:
        """G93 to G95 and F; F counts in the units before the line, unless the programme has said none yet."""
        modes = self.modes
        for name in ("G93", "G94", "G95"):
            if name in codes and modes.feed_mode != name:
                modes.feed_mode, modes.feed = name, math.nan
        if "F" in values:
            if not self.told and ("G20" in codes or "G21" in codes):
                modes.units = "inches" if "G20" in codes else "mm"
            word = values["F"]
            if ("G20" in codes and modes.units == "mm") or ("G21" in codes and modes.units != "mm"):
                self.note(line, f"{word.text} counts in {modes.units}, the units before its line, as in LinuxCNC")
            modes.feed = word.value * (1.0 if modes.feed_mode == "G93" else modes.size)
            self.feed_word = (line, word)
            if math.isnan(modes.feed):
                self.note(line, f"{word.text} is known to the machine only; the feed is left open")
            elif modes.feed < 0.0:
                raise self.wrong(line, word, "a feed must be more than 0")

    def switch(self, line: Line, codes: Codes, values: dict[str, Word]) -> None:
        """What may switch the beam: before the motion of the line, as in RS274/NGC."""
        modes, old = self.modes, self.modes.switches
        now = old
        if "S" in values:
            now = replace(now, speed=values["S"].value)
            self.beam.used.add("S")
            self.note(line, f"S ({HARMLESS['S']}) is left out; S0 is off")
        for name in ("M62", "M63", "M64", "M65"):
            if name in codes:
                if "P" not in values:
                    raise self.wrong(line, codes[name], "it needs P")
                number, before = round(values["P"].value), self.modes.switches.outputs
                self.beam.used.add(f"P{number}")
                now = replace(now, outputs=before | {number} if name in ("M62", "M64") else before - {number})
        for name in ("M67", "M68"):
            if name in codes:
                if "E" not in values or "Q" not in values:
                    raise self.wrong(line, codes[name], "it needs E and Q")
                now = now.leveled(round(values["E"].value), values["Q"].value)
                self.beam.used.add("M67")
        spindle = round(values["$"].value) if "$" in values else 0
        if "M3" in codes or "M4" in codes:
            self.beam.used.add("M3")
            self.beam.spindles.add(max(spindle, 0))
            now = replace(now, spindles=now.spindles | {max(spindle, 0)})
        if "M5" in codes:
            now = replace(now, spindles=frozenset() if spindle < 0 else now.spindles - {spindle})
        if now != old:
            modes.switches = now
            self.beam.travel()

    # Modes

    def set_modes(self, line: Line, codes: Codes) -> None:
        """Plane, units, distance modes, lathe modes, coordinate system."""
        modes = self.modes
        depth = len(self.programme.calls)
        if "M70" in codes or "M73" in codes:
            self.kept[depth] = Kept(replace(modes), self.frames.system, self.frames.tool, "M73" in codes)
        if "M71" in codes:
            self.kept.pop(depth, None)
        if "M72" in codes:
            if depth not in self.kept:
                raise self.wrong(line, codes["M72"], "no M70 or M73 of this subroutine is before it")
            self.restore(self.kept[depth])
            modes = self.modes
        self.told = self.told or "G20" in codes or "G21" in codes
        for name in codes:
            if name in SET_BY:
                setattr(modes, *SET_BY[name])
            if name in SYSTEMS:
                system = SYSTEMS[name]
                if system != self.frames.system and not self.frames.knows(system):
                    self.note(
                        line, f"{name}: where it lies is not said before it; it is read as lying at 0 of the machine"
                    )
                self.frames.load(system)
        for name in codes:
            if CODES[name].group == "motion":
                if name in CYCLES and modes.motion not in CYCLES:
                    modes.old_z, modes.cycle = self.frames.here().z, {}
                modes.motion = name

    def restore(self, kept: Kept) -> None:
        """M72: modes, feed, spindle and coordinate system, but not the motion (G0, G1 …)."""
        now = self.modes
        spindle = replace(now.switches, spindles=kept.modes.switches.spindles, speed=kept.modes.switches.speed)
        if spindle != now.switches:
            self.beam.travel()
        self.modes = replace(kept.modes, motion=now.motion, cycle=now.cycle, old_z=now.old_z, switches=spindle)
        if kept.system != self.frames.system:
            self.frames.load(kept.system)
        if kept.tool == Point(0j, 0.0):
            self.frames.tool = kept.tool

    # Words that take the axes for themselves

    def special(self, line: Line, codes: Codes, values: dict[str, Word]) -> bool:
        """G10, G28, G30, G43.1, G52 and G92 with their axes; whether the line has one of them."""
        frames = self.frames
        if "G49" in codes or "G43" in codes:
            frames.tool = Point(0j, 0.0)
        if "G92.1" in codes or "G92.2" in codes:
            frames.set_shift(Point(0j, 0.0), keep="G92.1" in codes)
        if "G92.3" in codes:
            frames.recall_shift()
        given = self.axes(values)
        if "G4" in codes and not any(CODES[name].group == "motion" for name in codes):
            for axis in AXES:
                if axis in values:
                    raise self.wrong(line, values[axis], "it stands with a dwell, G4")
        if "G10" in codes:
            self.data(line, codes["G10"], values, given)
        elif "G43.1" in codes or "G43.2" in codes:
            # G43.1 gives the tool's offset in words; G43.2 adds that of a tool in the table, or one in words.
            old, more = frames.tool, Point(0j, 0.0).but(given)
            frames.tool = Point(old.xy + more.xy, old.z + more.z) if "G43.2" in codes else old.but(given)
        elif "G92" in codes or "G52" in codes:
            if not any(axis in values for axis in AXES):
                raise self.wrong(line, codes.get("G92") or codes["G52"], "it needs an axis")
            (frames.call_here if "G92" in codes else frames.move_by)(given)
        elif "G28" in codes or "G30" in codes:
            self.motion.home(line, "G28" if "G28" in codes else "G30", values)
        elif "G28.1" in codes or "G30.1" in codes:
            frames.keep_home("G28" if "G28.1" in codes else "G30")
        else:
            return False
        return True

    def data(self, line: Line, word: Word, values: dict[str, Word], given: dict[str, float]) -> None:
        """G10: L2 and L20 set a coordinate system; L1, L10 and L11 the table of tools, which has no say here."""
        kind = values["L"].value if "L" in values else math.nan
        if kind in (1, 10, 11):
            self.note(line, f"G10 L{kind:g} (table of tools) is left out")
            return
        if kind not in (2, 20):
            raise self.wrong(line, values.get("L", word), "read are L2 and L20, which set coordinate systems")
        system = values["P"].value if "P" in values else math.nan
        if system not in range(10):
            raise self.wrong(
                line, values.get("P", word), "P must be a coordinate system, 1 to 9, or 0: the current one"
            )
        angle = values["R"].value if "R" in values else None
        self.frames.define(int(system), given, angle, here=kind == 20)

    def stop(self, line: Line, codes: Codes, values: dict[str, Word]) -> bool:
        """M2, M30, M98 and M99; whether the programme ends."""
        if "M98" in codes:
            if "P" not in values:
                raise self.wrong(line, codes["M98"], "it needs P")
            self.programme.call_number(values["P"].value, values["L"].value if "L" in values else 1.0)
        if "M99" in codes:
            return not self.programme.back_to_caller()
        return "M2" in codes or "M30" in codes
