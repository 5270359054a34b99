"""Study of intervals: how often they hold the truth."""

from typing import Any

from . import coverage
from .registry import Trial, study

REPEATS = 1000


@study(
    "coverage", "how often 95 % intervals hold the truth",
    f"python -m kerfgym.experiments.studies.coverage --repeats {REPEATS}", 10.0,
    (),
)  # fmt: skip
def of_intervals(trial: Trial) -> dict[str, Any]:
    """One row for each cell of the table, in percent."""
    lines = coverage.table(coverage.KINDS, REPEATS, trial.workers).strip().split("\n")
    titles, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in (lines[0], *lines[2:]))
    found: dict[str, Any] = {}
    for kind, figure, count, *shares in rows:
        cells = {title: _percent(share) for title, share in zip(titles[3:], shares, strict=True)}
        found.setdefault(kind, {}).setdefault(figure, {})[count] = cells
    return {"numbers": found, "repeats": REPEATS}


def _percent(text: str) -> float | None:
    return float(text.removesuffix("%")) if text.endswith("%") else None
