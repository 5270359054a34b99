"""Routes through many sheets and drawings, and what becomes of every lead-in, as tables."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import pandas as pd

from ....envs.engine.quantity import InvalidInput
from ....envs.paths.drawing import Drawing
from ....envs.paths.read import FORMATS, PROGRAMMES, read
from ....envs.paths.route import Cutting, Route, routed
from ...report.terminal import TextTable
from .random_parts import KINDS, sheets
from .trespass import WRONG, Material, parts_of, wrong

KERF, LEAD_IN = 0.25, 3.0
"""mm of drawings from files."""

WAYS = {"drawn": "as drawn", "shorter": "shorter", "arc": "on an arc", "elsewhere": "from another start"}
"""Lead-ins by how they were found, and the titles of their columns."""


def random(contours: int, seed: int) -> Iterator[pd.DataFrame]:
    """Sheets made at random, with at least so many contours together: a table of lead-ins for each."""
    for sheet in sheets(seed, contours):
        cutting = Cutting(sheet.lead_in, sheet.kerf)
        yield judged(sheet.kind, routed(sheet.drawing, cutting), Material(sheet.parts), sheet.kerf)


def files(folders: Iterable[Path]) -> Iterator[tuple[Path, pd.DataFrame | str]]:
    """Every drawing below the folders: a table of lead-ins, or why it is refused; programmes are left out."""
    for folder in folders:
        for place, _, names in sorted(os.walk(folder)):
            for name in sorted(names):
                file = Path(place) / name
                if FORMATS.get(file.suffix.lower(), PROGRAMMES[0]) in PROGRAMMES:
                    continue
                try:
                    yield file, of_file(read(file))
                except InvalidInput as error:
                    yield file, str(error)


def of_file(drawing: Drawing) -> pd.DataFrame:
    """The lead-ins of a drawing from a file, whose parts are what its closed contours enclose."""
    solid = [p for p, closed in zip(drawing.pieces, drawing.closed, strict=True) if closed]
    material = Material(list(parts_of(solid).geoms)) if solid else Material([])
    return judged("files", routed(drawing, Cutting(LEAD_IN, KERF)), material, KERF)


def judged(kind: str, route: Route, material: Material, kerf: float) -> pd.DataFrame:
    """One row for each closed contour: ``kind``, ``how`` it begins, ``wrong`` (of :data:`.trespass.WRONG`, joined)."""
    rows = []
    for cut in route.cuts:
        if route.nesting.area[cut.contour]:
            fault = ", ".join(wrong(cut, material, kerf))
            rows.append({"kind": kind, "contour": cut.contour, "how": cut.how, "wrong": fault})
    return pd.DataFrame(rows, columns=["kind", "contour", "how", "wrong"])


def sheet_of(frame: pd.DataFrame, refused: int = 0, read_: int = 0) -> TextTable:
    """The campaign's table."""
    titles = ["sheets", "contours", *WAYS.values(), "on the contour, with a warning", *WRONG]
    sheet = TextTable("Lead-ins", titles)
    kinds = [kind for kind in (*KINDS, "files") if kind in set(frame["kind"])]
    sheet.sections = [[_row(kind, frame[frame["kind"] == kind]) for kind in kinds], [_row("all", frame)]]
    sheet.notes = [
        "in a part, on an edge: the pierce point, whose hole is half a kerf wide on either side; along an edge: half "
        "of the way or more; through a part: the way; in a neighbour: its kerf takes something from a part that the "
        "contour's own kerf does not take. Of those pierced on the contour nothing of this is asked."
    ]
    if read_:
        sheet.notes.append(f"files: {read_} drawings with closed contours; {refused} more cannot be read.")
    return sheet


def _row(name: str, part: pd.DataFrame) -> list[str]:
    faults = part["wrong"].str.split(", ").explode().value_counts()
    hows = part["how"].value_counts()
    found = [int(hows.get(how, 0)) for how in (*WAYS, "on the contour")] + [int(faults.get(w, 0)) for w in WRONG]
    return [name, str(len(part)), *map(str, found)]
