"""G-code programmes: what the beam, torch or tool cuts in the plane.

Understood are G0, G1, G2, G3 (I, J relative to the start or absolute, or R; full circles), G4, G17, G20, G21, G90, G91,
G90.1, G91.1, F, M2, M3, M4, M5, M30, comments and line numbers; positions are modal. Z only moves the head. Words that
change nothing about the path are listed as warnings; anything else is an error with its line and word.

The rules are those of RS274/NGC (NIST, Kramer et al. 2000). No library is used for them: those that exist read words,
but neither modes nor mistakes.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..plant.quantity import InvalidInput, did_you_mean
from .drawing import CHORD, EXACT, Curves, Drawing, arc, assembled

UNITS = {"mm": 1.0, "inches": 25.4}

HARMLESS_G = (40.0, 43.0, 49.0, *(54.0 + i for i in range(6)), 61.0, 64.0, 80.0, 94.0)
HARMLESS_M = (0, 1, 6, 7, 8, 9, 48, 49, 50, 51, 52, 53, 64, 65)
"""Words that do not change the path: compensation off, offsets of length, work coordinates, path modes, coolant …"""

_WORD = re.compile(r"\s*(?:([A-Za-z])\s*([+-]?(?:\d+\.?\d*|\.\d+))|([A-Za-z]?#<[^>]*>|[A-Za-z$]?\s*\S))")
_TOLERANCE = 0.02
"""mm by which the end of an arc may miss its radius: programmes are rounded."""


@dataclass
class _State:
    """What is modal."""

    scale: float
    position: complex = 0j  # mm
    motion: float | None = None
    absolute: bool = True
    absolute_centre: bool = False
    cutting: bool = False
    feed: float | None = None  # mm/s
    line: list[complex] = field(default_factory=list)
    units: str | None = None
    over: bool = False


def read_gcode(path: str | Path, units: str | None = None) -> Drawing:
    """The contours of a programme: what G1, G2 and G3 trace while M3 or M4 is on.

    Args:
        path: the file.
        units: ``"mm"`` or ``"inches"`` until the programme says G20 or G21; None: mm, with a warning.

    Raises:
        InvalidInput: with file, line and word: what is not understood, an arc that does not close, a number that is
            missing; or nothing to cut.
    """
    file = Path(path)
    if units is not None and units not in UNITS:
        raise InvalidInput(f"{file}: unknown units '{units}'; {did_you_mean(units, UNITS)}")
    state, curves, warnings = _State(UNITS[units or "mm"], units=units), Curves(), []
    text = file.read_text(encoding="utf-8", errors="replace")
    for number, raw in enumerate(text.splitlines(), start=1):
        where = f"{file}, line {number}"
        words = _words(raw, where, warnings)
        if words and not state.over:
            _execute(words, state, curves, where, warnings)
    _finish(state, curves)
    if state.units is None:
        warnings.append(f"{file}: neither G20 nor G21; read in mm")
    return assembled(file, curves, state.units or "mm", "G1, G2, G3 while M3 or M4 is on", tuple(warnings))


def _words(raw: str, where: str, warnings: list[str]) -> list[tuple[str, float]]:
    """Letters and numbers of a line."""
    line = re.sub(r"\([^)]*\)", "", raw).split(";")[0].strip()
    if "(" in line:
        raise InvalidInput(f"{where}: a comment that begins with '(' does not end")
    if line in ("", "%") or line.startswith("/"):
        return []
    if re.fullmatch(r"#<\w+>\s*=\s*[+-]?[\d.]+", line):
        warnings.append(f"{where}: '{line}' is not used")
        return []
    if re.match(r"[oO]\s*[\d<]", line):
        raise InvalidInput(f"{where}: '{line.split()[0]}': subroutines and loops are not understood; unroll them first")
    found: list[tuple[str, float]] = []
    at = 0
    while at < len(line):
        match = _WORD.match(line, at)
        if match is None:
            break
        letter, value, other = match.groups()
        if letter:
            found.append((letter.upper(), float(value)))
        elif other[0] in "Ff" and "#<" in other:
            warnings.append(f"{where}: '{line[at:].strip()}' is the machine's own feed; left to the job")
        elif other[0] == "$":
            digits = re.match(r"\$\s*\d+", line[match.start(3) :])
            if digits is None:
                raise InvalidInput(f"{where}: '$' without a number")
            at = match.start(3) + digits.end()
            continue
        elif "#" in other or "[" in line[at : match.end() + 1]:
            word = line[at:].split()[0]
            raise InvalidInput(f"{where}: '{word}': parameters and expressions are not understood; use numbers")
        else:
            raise InvalidInput(f"{where}: '{line[at:].split()[0]}' is not a word of a letter and a number")
        at = match.end()
    return found


def _execute(words: list[tuple[str, float]], s: _State, curves: Curves, where: str, warnings: list[str]) -> None:
    """One line of the programme."""
    values: dict[str, float] = {}
    given: list[float] = []
    switch: bool | None = None
    dwell = False
    for letter, value in words:
        if letter == "G":
            if value in (0.0, 1.0, 2.0, 3.0):
                given.append(value)
            elif value == 4.0:
                dwell = True
            elif value in (20.0, 21.0):
                s.units = "inches" if value == 20.0 else "mm"
                s.scale = UNITS[s.units]
            elif value in (90.0, 91.0):
                s.absolute = value == 90.0
            elif value in (90.1, 91.1):
                s.absolute_centre = value == 90.1
            elif value in HARMLESS_G:
                warnings.append(f"{where}: 'G{value:g}' does not change the path")
            elif value != 17.0:
                raise InvalidInput(f"{where}: 'G{value:g}' is not understood")
        elif letter == "M":
            if value in (3.0, 4.0, 5.0):
                switch = value != 5.0
            elif value in (2.0, 30.0):
                s.over = True
            elif value in HARMLESS_M:
                warnings.append(f"{where}: 'M{value:g}' does not change the path")
            else:
                raise InvalidInput(f"{where}: 'M{value:g}' is not understood")
        elif letter in "XYZIJRF":
            if letter in values:
                raise InvalidInput(f"{where}: '{letter}' is given twice")
            values[letter] = value
        elif letter not in "NSTHPDK":
            raise InvalidInput(f"{where}: '{letter}{value:g}' is not understood")
        elif letter == "K":
            raise InvalidInput(f"{where}: 'K{value:g}': arcs outside the plane of X and Y are not understood")
    if len(given) > 1:
        raise InvalidInput(f"{where}: two motions, G{given[0]:g} and G{given[1]:g}, in one line")
    s.motion = given[0] if given else s.motion
    if "F" in values:
        s.feed = values["F"] * s.scale / 60.0
    if switch is not None:
        _finish(s, curves)
        s.cutting = switch
    moves = "X" in values or "Y" in values or ("I" in values or "J" in values)
    if moves and not dwell:
        _move(values, s, curves, where)


def _move(values: dict[str, float], s: _State, curves: Curves, where: str) -> None:
    if s.motion is None:
        raise InvalidInput(f"{where}: a position, but no G0, G1, G2 or G3 before it")
    base = 0j if s.absolute else s.position
    end = complex(
        base.real + values["X"] * s.scale if "X" in values else s.position.real,
        base.imag + values["Y"] * s.scale if "Y" in values else s.position.imag,
    )
    if s.motion == 0.0 or not s.cutting:
        if s.motion >= 2.0:
            _arc(values, s, end, where)  # mistakes are mistakes without the beam too
        _finish(s, curves)
    else:
        s.line = s.line or [s.position]
        s.line += [end] if s.motion == 1.0 else _arc(values, s, end, where)
    s.position = end


def _arc(values: dict[str, float], s: _State, end: complex, where: str) -> list[complex]:
    """Points after the start of the arc to ``end``."""
    start, sense = s.position, 1.0 if s.motion == 3.0 else -1.0
    if "R" in values:
        radius, half = values["R"] * s.scale, 0.5 * abs(end - start)
        if half < EXACT:
            raise InvalidInput(f"{where}: an arc with R that ends where it starts has no centre; use I and J")
        if half > abs(radius) + _TOLERANCE:
            raise InvalidInput(f"{where}: R = {values['R']:g} is too small: the end lies {2 * half / s.scale:g} away")
        rise = np.sqrt(max(radius * radius - half * half, 0.0)) * (1.0 if radius > 0 else -1.0)
        centre = 0.5 * (start + end) + sense * 1j * rise * (end - start) / (2.0 * half)
    elif "I" in values or "J" in values:
        offset = complex(values.get("I", 0.0), values.get("J", 0.0)) * s.scale
        centre = offset if s.absolute_centre else start + offset
        radius = abs(start - centre)
        if radius < EXACT:
            raise InvalidInput(f"{where}: the arc's centre is its start")
        if abs(abs(end - centre) - radius) > max(_TOLERANCE, 1e-3 * radius):
            raise InvalidInput(
                f"{where}: the arc's end lies {abs(end - centre) / s.scale:.4f} from its centre, its start "
                f"{radius / s.scale:.4f}"
            )
    else:
        raise InvalidInput(f"{where}: an arc needs I and J, or R")
    turn = sense * float(np.angle((end - centre) / (start - centre)))
    turn = turn if turn > 1e-9 else turn + 2 * np.pi
    if turn > 1.9 * np.pi or abs(end - start) < EXACT:  # in two, because a bulge cannot be a full turn
        middle = centre + (start - centre) * np.exp(0.5j * sense * turn)
        bulge = sense * float(np.tan(turn / 8.0))
        return [*arc(start, middle, bulge, CHORD).tolist(), *arc(middle, end, bulge, CHORD).tolist()]
    return arc(start, end, sense * float(np.tan(turn / 4.0)), CHORD).tolist()


def _finish(s: _State, curves: Curves) -> None:
    """The present cut is over."""
    if len(s.line) > 1:
        curves.add(np.array([(z.real, z.imag) for z in s.line]), "cut")
    s.line = []
