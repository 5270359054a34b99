"""A G-code programme of a corpus: read, and compared with LinuxCNC's ``rs274`` where that is installed.

A programme counts if it is for planar motion, and if the reference takes it: no other axis than X, Y and Z moves in it,
it probes nothing, it does not turn a workpiece, and no machine's own words are needed. Cutter compensation counts.
"""

import re
from dataclasses import replace
from pathlib import Path

from ....envs.paths.gcode import read_gcode
from . import canonical, rs274
from .compare import apart
from .judged import REFUSED, Verdict, seen

TURNED = re.compile(r"(?i)\bG0*(?:33(?:\.1)?|7[0-2](?:\.[12])?|76|38\.[2-5])(?![\d.])")
"""Threads, cycles of a lathe, probes."""

ROTARY = re.compile(r"(?i)(?<![A-Z_<])[ABCUVW]\s*(?:[-+]?[\d.]*[1-9]|[#\[])")
"""Words of other axes that may move something."""


def check(path: Path) -> Verdict:
    """The verdict on a programme."""
    drawing, verdict = seen(path, "gcode", read_gcode)
    output = rs274.run(path)
    reference, path_of_reference, deviation = _told(output), None, None
    if output and not output.refused:
        path_of_reference = canonical.cut(output.text)
    if path_of_reference and path_of_reference.splines:
        reference = f"rs274 prints no points of its {path_of_reference.splines} splines"
    elif path_of_reference and drawing:
        distance = apart([piece[:, 0] + 1j * piece[:, 1] for piece in drawing.pieces], path_of_reference.pieces)
        deviation = max(distance - path_of_reference.rounding, 0.0)
    counted = drawing is not None or (verdict.outcome == REFUSED and planar(path, output))
    return replace(verdict, reference=reference, deviation_mm=deviation, counted=counted)


def planar(path: Path, output: rs274.Output | None) -> bool:
    """Whether a programme that was refused is for planar motion, by its words and by what the reference says of it."""
    if output is not None and (output.refused or not canonical.moves_in_plane(output.text)):
        return False
    text = path.read_bytes().decode("latin-1")
    bare = "\n".join(re.sub(r"\([^)]*\)|;.*", "", line) for line in text.splitlines())
    return not TURNED.search(bare) and not (output is None and ROTARY.search(bare))


def _told(output: rs274.Output | None) -> str:
    if output is None:
        return "rs274 does not end" if rs274.command() else "rs274 is not installed"
    if output.refused:
        return f"rs274 refuses it: {output.refused}"
    return "rs274, with F filled in" if output.filled else "rs274"
