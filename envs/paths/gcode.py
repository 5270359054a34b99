"""G-code: what a programme cuts, in its own order and direction, at its own feed.

A programme is run as LinuxCNC's interpreter runs it (:mod:`.gcode_machine`), and what it does in X and Y while the beam
is on (:mod:`.gcode_beam`) is the drawing. Nothing is added, joined or put into another order. Heights are left to the
machine, which follows the sheet. A word that is not understood is an error, so that nothing is cut otherwise than
programmed; words that change nothing about the path are listed.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..engine.quantity import InvalidInput
from .choice import Reading
from .collected import some
from .drawing import Drawing, drawing, unit
from .gcode_beam import Piece, repeats
from .gcode_machine import Machine

CUTS = "G1, G2, G3 and splines while the beam is on: M3 or M4 with S not 0, or M62 to M68, or no such word"
"""What is cut, for messages."""


def read_gcode(path: str | Path, asked: Reading = Reading()) -> Drawing:  # noqa: B008
    """The cuts of a G-code programme as they stand in it: neither joined nor put into another order.

    Feed moves cut while the beam is on; G0 does not. A piece ends where the beam goes off or a G0 moves. ``feeds`` has
    the programmed feed of every segment.

    Args:
        path: a G-code file.
        asked: units that numbers are in until the programme says G20 or G21; all else is for drawings.

    Raises:
        InvalidInput: something asked that is for drawings; file, line and word of the first that cannot be read; an arc
            whose numbers do not fit each other; a programme without end; nothing to cut; or a journey whose length is
            out of range.
    """
    file = Path(path)
    for name in ("layers", "colours", "join", "text", "hatches"):
        if (given := getattr(asked, name)) != getattr(Reading, name):
            raise InvalidInput(f"{file}: {name} = {given!r}: a programme has none; that is for drawings (DXF, SVG)")
    machine = Machine(file, unit(asked.units)[0] if asked.units is not None else None)
    with np.errstate(over="ignore", invalid="ignore"):  # what comes out as no number is told where it is led to
        machine.run()
    pieces = machine.beam.pieces()
    _tell(machine, pieces)
    feeds = [piece.mean_feed for piece in pieces]
    notes = [f"{text} (line {some(map(str, lines), 3, ', ')})" for text, lines in machine.listed.items()]
    curves, units = [piece.curve for piece in pieces], " and ".join(machine.used) or machine.modes.units
    warnings = notes + machine.programme.parameters.unused()
    known = feeds if np.isfinite(feeds).any() else None
    found = drawing(file, file.stem, curves, units, None, machine.skipped, known, warnings, CUTS)
    return replace(found, programmed=True, leg_feeds=[piece.feeds for piece in pieces] if found.feeds else None)


def _tell(machine: Machine, pieces: list[Piece]) -> None:
    """Lists what is known at the end only."""
    listed = machine.listed
    rule = machine.beam.rule()
    if rule and pieces:
        listed[rule].append(pieces[0].line)
    if pieces and (at := machine.motion.unplaced.get(pieces[0].line)) is not None:
        text = f"the first cut begins at X{at.real:g} Y{at.imag:g} mm without having been sent there"
        listed[text].append(pieces[0].line)
    first = next((piece.line for piece in pieces if np.isnan(piece.feeds).any()), None)
    if first is not None and not any("feed is left open" in text for text in listed):
        listed["no F before it; the feed is left open"].append(first)
    for before, line in repeats(pieces):
        listed[f"the cut from line {before} is made again"].append(line)
    unset = sorted(machine.programme.parameters.unset)
    if unset:
        names = ", ".join(f"#{n}" for n in unset[:5]) + (" …" if len(unset) > 5 else "")
        listed[f"{names}: read before a value was set; they count as 0"].append(0)
