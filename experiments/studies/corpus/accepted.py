"""What a corpus says: how many files of each format are accepted, how near the reference, and every refusal."""

from collections import Counter
from pathlib import Path

from ...report.terminal import TextTable
from .judged import ACCEPTED, FAILED, NOTHING, REFUSED, Verdict

NEAR = 1e-3
"""mm from the path of the reference that count as the same."""


def summary(found: list[Verdict]) -> TextTable:
    """A row for each format."""
    verdicts = ["accepted", "refused", "nothing to cut", "failed", "accepted of those that count"]
    references = ["compared with a reference", "within 1 µm of it"]
    sheet = TextTable("Drawings and programmes", ["format", "files", *verdicts, *references, "slowest, s"])
    rows = []
    for kind in sorted({v.kind for v in found}):
        mine = [v for v in found if v.kind == kind]
        count = Counter(v.outcome for v in mine)
        counted = [v for v in mine if v.counted and v.outcome != NOTHING]
        good = sum(v.outcome == ACCEPTED for v in counted)
        compared = [v.deviation_mm for v in mine if v.deviation_mm is not None]
        verdicts = [str(count[o]) for o in (ACCEPTED, REFUSED, NOTHING, FAILED)]
        share = f"{good}/{len(counted)} ({good / len(counted):.1%})" if counted else "–"
        near, slowest = str(sum(d <= NEAR for d in compared)), f"{max(v.seconds for v in mine):.2f}"
        rows.append([kind, str(len(mine)), *verdicts, share, str(len(compared)), near, slowest])
    sheet.sections.append(rows)
    failed = [v for v in found if v.outcome == FAILED]
    sheet.notes = [
        "accepted of those that count: without files that have nothing to cut, and without programmes that are not for "
        "planar motion or that the reference refuses, too.",
        f"failed (a traceback, too much time, too much memory, or a drawing whose length or box differs from the other "
        f"reading's by more than 0.5 %): {len(failed)}.",
    ]
    return sheet


def list_of(found: list[Verdict], folder: Path, outcome: str) -> TextTable:
    """Each file of an outcome, with its reason."""
    sheet = TextTable(outcome.capitalize(), ["file", "format", "counts", "reason"])
    sheet.sections.append(
        [[_name(v, folder), v.kind, "yes" if v.counted else "no", v.reason] for v in found if v.outcome == outcome]
    )
    return sheet


def farthest(found: list[Verdict], folder: Path, most: int = 10) -> TextTable:
    """The accepted programmes that are farthest from the reference."""
    sheet = TextTable("Farthest from the reference", ["file", "µm", "length, mm", "box, mm", "reference"])
    with_one = sorted((v for v in found if v.deviation_mm is not None), key=lambda v: -(v.deviation_mm or 0.0))
    lines = []
    for v in with_one[:most]:
        box = " × ".join(f"{side:.3f}" for side in v.box or ())
        apart = f"{1e3 * (v.deviation_mm or 0.0):.3f}"
        lines.append([_name(v, folder), apart, f"{v.length_mm:.3f}", box, v.reference or ""])
    sheet.sections.append(lines)
    return sheet


def _name(v: Verdict, folder: Path) -> str:
    return v.path.relative_to(folder).as_posix() if v.path.is_relative_to(folder) and v.path != folder else v.path.name
