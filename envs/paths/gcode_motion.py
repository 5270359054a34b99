"""Motion of a G-code programme: what its lines do in the plane, at which feed.

This machine cuts in X and Y. Z is followed in the programme's head only: it tells how fast the plane is crossed, for F
counts along the way in space. Other axes may be named, but not moved.
"""

import math

from ..engine.quantity import InvalidInput
from .collected import FARTHEST
from .curve import EXACT, Curve
from .drawing import LENGTH_RANGE
from .gcode_arcs import LEAST, PLANES, SLACK, Turn, bezier, by_radius, in_plane, nurbs, slack, swept
from .gcode_beam import Stroke
from .gcode_codes import AXES, CYCLES, STAY
from .gcode_flow import Line
from .gcode_frames import Point
from .gcode_state import State
from .gcode_words import Word

Values = dict[str, Word]

FULL = 1e-6
"""rad, below which an arc is a full turn. [P] LinuxCNC, CIRCLE_FUZZ"""

MOST_MOVES = 300_000
"""Feed moves of a programme; each is a segment of a contour, and a second is spent on some 40 000."""

MOST_POINTS = 4e6
"""Points of all arcs of a programme."""

GUARD = 4.0
"""Times the longest journey, at which reading stops early."""


class Motion:
    """The motion of ``machine``."""

    def __init__(self, machine: State) -> None:
        self.m = machine
        self.placed = {"X": False, "Y": False}
        self.unplaced: dict[int, complex] = {}
        self.away = dict.fromkeys(STAY, 0.0)  # where the axes that do not exist would be
        self.way = self.points = 0.0
        self.moves = 0
        self.last_pull: complex | None = None  # from the end of the last G5 to its control point
        self.control: list[complex] = []  # points of G5.2, in the programme's plane, and their weights
        self.weights: list[float] = []
        self.order = 3

    def move(self, line: Line, codes: dict[str, Word], values: Values) -> None:
        """What the line's axes do."""
        m, modes = self.m, self.m.modes
        pull, self.last_pull = self.last_pull, None
        if "G5.3" in codes:
            self.end_nurbs(line, codes["G5.3"], values)
            return
        arcs = modes.motion in ("G2", "G3")
        given = [values[a] for a in (*AXES, *("IJKR" if arcs else ""), "@", "^") if a in values]
        if not given and modes.motion != "G5.2":
            if "G2" in codes or "G3" in codes:
                raise m.wrong(line, codes[modes.motion], "an arc without X, Y, I, J or R")
            return
        if not modes.motion:
            raise m.wrong(line, given[0], "no G0, G1, G2 or G3 says how to move there")
        for word in given:
            if math.isnan(word.value):
                raise m.wrong(line, word, "its value is known to the machine only")
        if not m.told:
            m.told = True
            m.note(line, "neither G20 nor G21 before it, numbers read as mm; units= reads them otherwise")
        m.used.setdefault(modes.units)
        self.stay(line, values)
        if "G53" in codes:
            self.in_machine(line, codes["G53"], values)
        elif modes.motion in ("G0", "G1"):
            self.straight(line, values, m.frames.machine(self.target(line, values)))
        elif arcs:
            self.arc(line, values)
        elif modes.motion in CYCLES:
            self.cycle(line, values)
        elif modes.motion == "G5.2":
            self.add_control(line, values)
        else:
            self.spline(line, values, pull)
            modes.motion = ""
        for axis in ("X", "Y"):
            self.placed[axis] |= axis in values or "@" in values

    # Where to

    def target(self, line: Line, values: Values) -> Point:
        """The end of the line's motion in the programme's coordinates, mm."""
        here, given = self.m.frames.here(), self.m.axes(values)
        if "@" in values or "^" in values:
            return self.polar(line, values, here)
        old = {} if self.m.modes.absolute else {"X": here.xy.real, "Y": here.xy.imag, "Z": here.z}
        return here.but({axis: value + old.get(axis, 0.0) for axis, value in given.items()})

    def polar(self, line: Line, values: Values, here: Point) -> Point:
        """``@`` is the distance from the origin and ``^`` the angle, degrees."""
        m = self.m
        for axis in "XY":
            if axis in values:
                raise m.wrong(line, values[axis], "it stands with @ or ^")
        radius, angle = abs(here.xy), math.atan2(here.xy.imag, here.xy.real)
        step = not m.modes.absolute
        if "@" in values:
            radius = m.mm(values, "@") + (radius if step else 0.0)
        if "^" in values:
            angle = math.radians(values["^"].value) + (angle if step else 0.0)
        z = m.mm(values, "Z") + (here.z if step else 0.0) if "Z" in values else here.z
        return Point(complex(radius * math.cos(angle), radius * math.sin(angle)), z)

    def stay(self, line: Line, values: Values) -> None:
        """Axes that this machine does not have must stay where they are."""
        for axis in STAY:
            if axis in values:
                there = values[axis].value + (0.0 if self.m.modes.absolute else self.away[axis])
                if abs(there - self.away[axis]) > 1e-9:
                    raise self.m.wrong(
                        line, values[axis], f"it moves {axis}; this machine moves in X and Y, and the head follows in Z"
                    )

    def in_machine(self, line: Line, word: Word, values: Values) -> None:
        """G53: a straight move in the machine's own coordinates."""
        m = self.m
        if m.modes.motion not in ("G0", "G1"):
            raise m.wrong(line, word, "it needs G0 or G1")
        if not m.modes.absolute:
            raise m.wrong(line, word, "it does not go with G91")
        self.straight(line, values, m.frames.at.but(m.axes(values)))

    def home(self, line: Line, name: str, values: Values) -> None:
        """G28 and G30: by way of the point in the line, in its axes only; or in all."""
        m = self.m
        named = {axis for axis in AXES if axis in values}
        if named:
            self.travel(line, m.frames.machine(self.target(line, values)))
        if not named or named & set("XYZ"):
            self.travel(line, m.frames.home(name, named))
        self.placed = {"X": True, "Y": True}

    # Ways

    def straight(self, line: Line, values: Values, end: Point) -> None:
        """To a place on the machine."""
        m = self.m
        if m.modes.motion == "G0":
            self.travel(line, end)
            return
        start = m.frames.at
        length = abs(end.xy - start.xy)
        if length <= EXACT:
            m.frames.at = end
            self.nothing(values)
            return
        self.stroke(line, values, end, None, length, length / math.hypot(length, end.z - start.z))

    def travel(self, line: Line, end: Point) -> None:
        """A rapid move to a place on the machine."""
        m, switches = self.m, self.m.modes.switches
        self.check_place(line, end)
        if abs(end.xy - m.frames.at.xy) > EXACT:
            if switches.spindles and switches.speed != 0.0:
                m.note(line, "G0 while M3 or M4 is on: read as a move without cutting")
            m.beam.travel()
        m.frames.at = end

    def stroke(self, line: Line, values: Values, end: Point, curve: Curve | None, length: float, share: float) -> None:
        """A feed move, ``length`` mm in the plane, which is this share of the way in space."""
        m, start = self.m, self.m.frames.at.xy
        self.moves += 1
        if self.moves > MOST_MOVES:
            raise InvalidInput(f"{line.where}: more than {MOST_MOVES} feed moves up to here; allowed: no more")
        self.check_place(line, end)
        self.way += length
        if not self.way <= GUARD * LENGTH_RANGE[1]:
            raise InvalidInput(
                f"{line.where}: a journey of {self.way:g} mm up to here is out of range; allowed: {LENGTH_RANGE[0]:g} "
                f"to {LENGTH_RANGE[1]:g} mm; the drawing was read in {' and '.join(m.used)}"
            )
        if not all(self.placed.values()):
            self.unplaced.setdefault(line.number, start)
        rate = self.rate(line, values, length, share)
        m.beam.strokes.append(Stroke(line.number, start, end.xy, curve, rate, m.modes.switches))
        m.frames.at = end

    def nothing(self, values: Values) -> None:
        """A feed move that goes nowhere in the plane."""
        m = self.m
        if ("X" in values or "Y" in values or m.modes.motion != "G1") and m.beam.on(m.modes.switches):
            m.skipped[f"{m.modes.motion} of zero length"] += 1

    def check_place(self, line: Line, end: Point) -> None:
        """Whether the place is one that numbers can tell."""
        if not (abs(end.xy) < FARTHEST and abs(end.z) < FARTHEST):
            raise InvalidInput(
                f"{line.where}: it leads to X{end.xy.real:g} Y{end.xy.imag:g} Z{end.z:g} mm, out of range; allowed: up "
                f"to {FARTHEST:g} mm ({FARTHEST / 1e6:g} km) from the origin"
            )

    def rate(self, line: Line, values: Values, length: float, share: float) -> float:
        """mm/s in the plane; nan: left open."""
        m, modes = self.m, self.m.modes
        if modes.feed_mode == "G93" and "F" not in values:
            raise m.wrong(line, modes.motion, "after G93 each feed move needs an F")
        feed = modes.feed
        if feed == 0.0 and m.feed_word:
            raise m.wrong(*m.feed_word, "a feed must be more than 0")
        if modes.feed_mode == "G93":
            return feed * length / 60.0
        if modes.feed_mode == "G95":
            if not modes.switches.speed > 0.0:
                raise m.wrong(line, modes.motion, "after G95 a feed move needs S, revolutions per minute")
            feed *= modes.switches.speed
        return feed / 60.0 * share

    # Arcs and splines

    def arc(self, line: Line, values: Values) -> None:
        """G2 and G3."""
        m, modes = self.m, self.m.modes
        start, end = m.frames.here(), self.target(line, values)
        first, second, third, centre = PLANES[modes.plane]
        word = next(values[a] for a in (first, second, *centre, "R", third, *AXES) if a in values)
        turns = values["P"].value if "P" in values else 1.0
        if turns < 1 or not turns.is_integer():
            raise m.wrong(line, values["P"], "the number of turns must be a whole number from 1 on")
        wrong = next((a for a in "IJK" if a in values and a not in centre), None)
        if wrong:
            raise m.wrong(line, values[wrong], f"an arc in the plane of {modes.plane} has no {wrong}")
        sense = 1.0 if modes.motion == "G3" else -1.0
        (a, low), (b, high) = in_plane(modes.plane, start), in_plane(modes.plane, end)
        if "R" in values:
            if any(letter in values for letter in "IJK"):
                raise m.wrong(line, values["R"], "an arc has either R or I and J")
            middle = self.middle_by_radius(line, values["R"], a, b, sense)
        else:
            middle = self.middle(line, word, values, a, b)
        angle = swept(a - middle, b - middle, sense)
        if abs(b - a) < EXACT or abs(angle) <= FULL:
            angle = sense * 2 * math.pi
        turn = Turn(modes.plane, a, b, middle, angle + sense * 2 * math.pi * (turns - 1), low, high - low)
        self.points += turn.points
        if not self.points <= MOST_POINTS:
            raise m.wrong(line, values.get("P", word), f"the arcs up to here have more than {MOST_POINTS:g} points")
        curve = turn.curve()
        share = (turn.around if modes.plane == "G17" else curve.length) / turn.length
        self.along(line, values, curve, m.frames.machine(end), min(share, 1.0))

    def along(self, line: Line, values: Values, curve: Curve, end: Point, share: float = 1.0) -> None:
        """A feed move along a curve in the programme's plane, which is this share of the way in space."""
        frames = self.m.frames
        length = curve.length
        if len(curve.points) < 2 or length <= EXACT:
            frames.at = end
            self.nothing(values)
            return
        turn, offset = frames.turn, frames.offset
        if turn != 1.0 or offset:
            curve = curve.mapped(lambda z: z * turn + offset)
        self.stroke(line, values, end, curve, length, share)

    def middle(self, line: Line, word: Word, values: Values, a: complex, b: complex) -> complex:
        """The centre that I, J and K give."""
        m, modes = self.m, self.m.modes
        letters = PLANES[modes.plane][3]
        named = [letter for letter in letters if letter in values]
        if not named:
            raise m.wrong(line, word, f"{modes.motion} needs {letters[0]}, {letters[1]} or R")
        if modes.absolute_centre and len(named) < 2:
            raise m.wrong(line, word, f"after G90.1 an arc needs both {letters[0]} and {letters[1]}")
        i, j = (values[letter].value * modes.size if letter in values else 0.0 for letter in letters)
        centre = complex(i, j) + (0j if modes.absolute_centre else a)
        inner, outer = sorted((abs(a - centre), abs(b - centre)))
        allowed = slack(outer, modes.units == "inches")
        if outer - inner > allowed:
            text = " ".join(values[c].text for c in "XYZIJK" if c in values)
            raise m.wrong(
                line,
                text,
                f"the ends of the arc are {abs(a - centre):.4f} and {abs(b - centre):.4f} mm from its centre; "
                f"they may differ by {allowed:.4f} mm",
            )
        if outer < LEAST:
            raise m.wrong(line, values[named[0]], "an arc without radius")
        return centre

    def middle_by_radius(self, line: Line, word: Word, a: complex, b: complex, sense: float) -> complex:
        """The centre that R gives."""
        m = self.m
        radius, half = word.value * m.modes.size, 0.5 * abs(b - a)
        if half < EXACT / 2:
            raise m.wrong(line, word, "an arc by its radius must end elsewhere than it begins; a circle needs I or J")
        if half - abs(radius) > SLACK:
            raise m.wrong(line, word, f"the ends of the arc are {2 * half:.4f} mm apart, more than twice its radius")
        return by_radius(a, b, radius, sense)

    def spline(self, line: Line, values: Values, pull: complex | None) -> None:
        """G5 and G5.1."""
        m, modes = self.m, self.m.modes
        if modes.plane != "G17":
            raise m.wrong(line, modes.motion, "it is for the plane of G17")
        start, end = m.frames.here(), self.target(line, values)

        def pair(letters: str) -> complex | None:
            if not any(letter in values for letter in letters):
                return None
            return complex(*(values[c].value * modes.size if c in values else 0.0 for c in letters))

        out = pair("IJ")
        if modes.motion == "G5.1":
            if out is None:
                raise m.wrong(line, "G5.1", "it needs I or J")
            self.along(line, values, bezier([start.xy, start.xy + out, end.xy]), m.frames.machine(end))
            return
        back = pair("PQ")
        out = out if out is not None else None if pull is None else -pull
        if back is None or out is None:
            raise m.wrong(line, "G5", "it needs P and Q, and after another motion I and J")
        curve = bezier([start.xy, start.xy + out, end.xy + back, end.xy])
        self.along(line, values, curve, m.frames.machine(end))
        self.last_pull = back

    def add_control(self, line: Line, values: Values) -> None:
        """A line of G5.2: a control point with its weight."""
        m = self.m
        weight = values["P"].value if "P" in values else None
        both = "X" in values and "Y" in values
        if not self.control:
            self.order = 3
            first = weight if weight and not both else 1.0
            self.control, self.weights = [m.frames.here().xy], [first]
        if "L" in values:
            self.order = max(self.order, min(int(values["L"].value), 20))
        if both:
            if weight is None or not weight > 0.0:
                raise m.wrong(line, values["X"], "a control point needs a weight P above 0")
            self.control.append(self.target(line, values).xy)
            self.weights.append(weight)
        elif "X" in values or "Y" in values:
            raise m.wrong(line, values.get("X") or values["Y"], "a control point needs X and Y")

    def end_nurbs(self, line: Line, word: Word, values: Values) -> None:
        """G5.3: the curve of the control points is cut."""
        m, control = self.m, self.control
        self.control = []
        if len(control) < self.order or m.modes.plane != "G17":
            raise m.wrong(
                line, word, f"{len(control)} control points of G5.2 are before it; it needs {self.order} in G17"
            )
        self.points += 1000.0 * len(control)
        if self.points > MOST_POINTS:
            raise m.wrong(line, word, "the curves up to here have too many points")
        m.used.setdefault(m.modes.units)
        curve = nurbs(control, self.weights, self.order)
        end = m.frames.machine(Point(control[-1], m.frames.here().z))
        self.along(line, values, curve, end)
        m.modes.motion = ""

    # Drilling

    def cycle(self, line: Line, values: Values) -> None:
        """A canned cycle: the machine goes to its places; a beam drills nothing there."""
        m, modes, frames = self.m, self.m.modes, self.m.frames
        if modes.plane != "G17":
            raise m.wrong(line, modes.motion, "drilling is for the plane of G17")
        here = frames.here()
        for letter in "RZ":
            if letter in values:
                modes.cycle[letter] = m.mm(values, letter)
        times = int(values["L"].value) if "L" in values else 1
        if not 1 <= times <= 10_000:
            raise m.wrong(line, values["L"], "the number of repeats must be from 1 to 10000")
        m.programme.ran += times  # repeats count as lines
        clear = modes.cycle.get("R", 0.0) + (0.0 if modes.absolute else modes.old_z)
        z = max(modes.old_z, clear) if modes.retract_old else max(clear, here.z if modes.absolute else clear)
        flat_values = {letter: word for letter, word in values.items() if letter != "Z"}
        for _ in range(times):
            there = self.target(line, flat_values)
            self.travel(line, frames.machine(Point(there.xy, z)))
        m.skipped[f"{modes.motion} (drilled hole)"] += times
