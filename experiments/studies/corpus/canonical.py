"""What LinuxCNC's interpreter makes of a programme: its canonical commands as paths on the machine.

``rs274`` prints one command a line, such as ``STRAIGHT_FEED(10.0000, 0.0000, …)``, in the programme's coordinates and
units. This module turns that into what is cut, by no code of the reader that it is compared with.
"""

import cmath
import math
import re
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

COMMAND = re.compile(r"^\s*\d+ \S+\s+([A-Z_0-9]+)\((.*)\)\s*$")
NUMBER = re.compile(r"-?\d+(?:\.\d*)?")
CHORD = 1e-4
"""mm, the largest distance of an arc from its chords."""

Complex = npt.NDArray[np.complex128]
Place = tuple[complex, float]


@dataclass
class Path:
    """What is cut: polylines of complex numbers x + jy, mm; ``rounding``: mm, what the four decimals leave open.

    ``splines``: splines among it, of which ``rs274`` prints no points; ``feeds``: mm/min, as printed, with the length
    that was cut at each.
    """

    pieces: list[Complex] = field(default_factory=list)
    rounding: float = 0.0
    splines: int = 0
    feeds: dict[float, float] = field(default_factory=dict)


@dataclass
class _State:
    """The canonical machine, mm. Offsets are (x + jy, z); ``at`` is on the machine and stays when one changes."""

    size: float = 1.0
    plane: str = "XY"
    at: Place = (0j, 0.0)
    origin: Place = (0j, 0.0)
    shift: Place = (0j, 0.0)
    tool: Place = (0j, 0.0)
    turn: complex = 1 + 0j
    feed: float = 0.0
    speeds: dict[int, float] = field(default_factory=dict)
    spindles: set[int] = field(default_factory=set)
    outputs: set[int] = field(default_factory=set)
    levels: dict[int, float] = field(default_factory=dict)


@dataclass
class _Stroke:
    points: Complex
    feed: float
    spindles: frozenset[int]
    speed: float | None
    outputs: frozenset[int]
    levels: tuple[float, ...]


def cut(text: str) -> Path:
    """The path that is cut in an output of ``rs274``."""
    state, path = _State(), Path()
    strokes: list[_Stroke | None] = []
    used: set[str] = set()
    started: set[int] = set()
    for raw in text.splitlines():
        match = COMMAND.match(raw)
        if not match:
            continue
        name, words = match[1], [w for w in re.split(r"[,\s]+", match[2]) if w]
        _one(name, words, state, path, strokes, used, started)
    run: list[_Stroke] = []
    for stroke in [*strokes, None]:
        if stroke is not None and _burns(stroke, used, started):
            run.append(stroke)
        elif run:
            path.pieces.append(_joined([s.points for s in run]))
            for s in run:
                path.feeds[s.feed] = path.feeds.get(s.feed, 0.0) + float(np.abs(np.diff(s.points)).sum())
            run = []
    return path


def _one(name: str, words: list[str], s: _State, path: Path, strokes: list, used: set[str], started: set[int]) -> None:
    """One command."""
    numbers = [float(w) for w in words] if all(NUMBER.fullmatch(w) for w in words) else []
    match name:
        case "USE_LENGTH_UNITS":
            s.size = 25.4 if "INCHES" in words[0] else 10.0 if "CM" in words[0] else 1.0
        case "SELECT_PLANE":
            s.plane = words[0].rpartition("_")[2]
        case "SET_G5X_OFFSET":
            s.origin = _place(s, numbers[1:])
        case "SET_G92_OFFSET":
            s.shift = _place(s, numbers)
        case "SET_XY_ROTATION":
            s.turn = cmath.rect(1.0, math.radians(numbers[0]))
        case "USE_TOOL_LENGTH_OFFSET":
            s.tool = _place(s, numbers)
        case "SET_FEED_RATE":
            s.feed = numbers[0] * s.size
        case "SET_SPINDLE_SPEED":
            used.add("S")
            s.speeds[int(numbers[0])] = numbers[1]
            strokes.append(None)
        case "START_SPINDLE_CLOCKWISE" | "START_SPINDLE_COUNTERCLOCKWISE":
            s.spindles.add(int(numbers[0]))
            started.add(int(numbers[0]))
            strokes.append(None)
        case "STOP_SPINDLE_TURNING":
            s.spindles.discard(int(numbers[0]))
            strokes.append(None)
        case "SET_MOTION_OUTPUT_BIT" | "SET_AUX_OUTPUT_BIT":
            s.outputs.add(int(numbers[0]))
            used.add(f"P{int(numbers[0])}")
            strokes.append(None)
        case "CLEAR_MOTION_OUTPUT_BIT" | "CLEAR_AUX_OUTPUT_BIT":
            s.outputs.discard(int(numbers[0]))
            used.add(f"P{int(numbers[0])}")
            strokes.append(None)
        case "SET_MOTION_OUTPUT_VALUE" | "SET_AUX_OUTPUT_VALUE":
            s.levels[int(numbers[0])] = numbers[1]
            used.add("Q")
            strokes.append(None)
        case "STRAIGHT_TRAVERSE":
            there = _machine(s, _place(s, numbers))
            if abs(there[0] - s.at[0]) > 1e-6:
                strokes.append(None)
            s.at = there
        case "STRAIGHT_FEED":
            there = _machine(s, _place(s, numbers))
            _feed(s, strokes, np.array([s.at[0], there[0]]), path)
            s.at = there
        case "ARC_FEED":
            _feed(s, strokes, _arc(s, numbers), path)
        case "NURBS_FEED":
            path.splines += 1


def _place(s: _State, numbers: list[float]) -> Place:
    x, y, z = (s.size * n for n in numbers[:3])
    return complex(x, y), z


def _machine(s: _State, p: Place) -> Place:
    """A place of the programme on the machine."""
    return s.turn * (p[0] + s.shift[0]) + s.origin[0] + s.tool[0], p[1] + s.shift[1] + s.origin[1] + s.tool[1]


def _programme(s: _State, p: Place) -> tuple[float, float, float]:
    """A place of the machine in the programme's coordinates."""
    xy = (p[0] - s.origin[0] - s.tool[0]) / s.turn - s.shift[0]
    return xy.real, xy.imag, p[1] - s.shift[1] - s.origin[1] - s.tool[1]


def _feed(s: _State, strokes: list, points: Complex, path: Path) -> None:
    if np.abs(np.diff(points)).sum() <= 1e-6:
        return
    path.rounding = max(path.rounding, 0.5e-4 * s.size * (2.0 if len(points) > 2 else 1.0) * math.sqrt(2.0))
    speed = s.speeds.get(min(s.spindles)) if s.spindles else next(iter(s.speeds.values()), None)
    levels = tuple(s.levels.values())
    strokes.append(_Stroke(points, s.feed, frozenset(s.spindles), speed, frozenset(s.outputs), levels))


def _arc(s: _State, n: list[float]) -> Complex:
    """ARC_FEED(first_end, second_end, first_axis, second_axis, rotation, axis_end, …), seen from above."""
    first, second, third = {"XY": (0, 1, 2), "XZ": (2, 0, 1), "YZ": (1, 2, 0)}[s.plane]
    here = _programme(s, s.at)
    begin, end = complex(here[first], here[second]), s.size * complex(n[0], n[1])
    centre, turns = s.size * complex(n[2], n[3]), round(n[4])
    r0, r1 = abs(begin - centre), abs(end - centre)
    a0, a1 = cmath.phase(begin - centre), cmath.phase(end - centre)
    full = max(1e-6, 1.42e-4 * s.size / max(r0, r1))  # rad: nearer to each other than the print tells
    if turns > 0:
        while a1 - a0 <= full:
            a1 += 2 * math.pi
        a1 += 2 * math.pi * (turns - 1)
    else:
        while a1 - a0 >= -full:
            a1 -= 2 * math.pi
        a1 += 2 * math.pi * (turns + 1)
    step = 2 * math.acos(max(1 - CHORD / max(r0, r1, CHORD), 0.0))
    t = np.linspace(0.0, 1.0, max(2, math.ceil(abs(a1 - a0) / step) + 1))
    spoke = centre + (r0 + (r1 - r0) * t) * np.exp(1j * (a0 + (a1 - a0) * t))
    low, high = here[third], s.size * n[5]
    axes = {first: spoke.real, second: spoke.imag, third: low + (high - low) * t}
    end_at = {first: end.real, second: end.imag, third: high}
    for axis in range(3):
        axes[axis][0], axes[axis][-1] = here[axis], end_at[axis]
    s.at = _machine(s, (complex(end_at[0], end_at[1]), end_at[2]))
    points: Complex = s.turn * (axes[0] + 1j * axes[1] + s.shift[0]) + s.origin[0] + s.tool[0]
    return points


def _burns(stroke: _Stroke, used: set[str], started: set[int]) -> bool:
    """The rules of the manual: a spindle, else outputs, else levels, else everything but S0."""
    outputs = {int(u[1:]) for u in used if u[0] == "P"} - {2, 3}
    if started:
        return min(started) in stroke.spindles and stroke.speed != 0.0 and 3 not in stroke.outputs
    dark = bool(stroke.levels) and not any(stroke.levels)
    if outputs:
        return bool(outputs & stroke.outputs) and not dark
    if "Q" in used:
        return bool(stroke.levels) and not dark
    return stroke.speed != 0.0


def _joined(strokes: list[Complex]) -> Complex:
    return np.concatenate([strokes[0], *(s[1:] for s in strokes[1:])])


def moves_in_plane(text: str) -> bool:
    """Whether an output moves X, Y and Z only, probes nothing and cuts no thread, and cuts something at all.

    What stays at one Y in the plane XZ is a lathe's.
    """
    cuts = False
    if "CANON_PLANE_XZ" in text and len(set(re.findall(r"STRAIGHT_FEED\([^,]*, ([^,]*),", text))) < 2:
        return False
    for raw in text.splitlines():
        match = COMMAND.match(raw)
        if not match:
            continue
        if match[1] in ("START_SPEED_FEED_SYNCH", "STRAIGHT_PROBE", "RIGID_TAP"):
            return False
        if match[1] in ("STRAIGHT_FEED", "STRAIGHT_TRAVERSE"):
            numbers = [float(w) for w in re.split(r"[,\s]+", match[2]) if w]
            if any(numbers[3:]):
                return False
        cuts = cuts or match[1] in ("STRAIGHT_FEED", "ARC_FEED", "NURBS_FEED")
    return cuts
