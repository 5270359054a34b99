"""Study of intervals: how often they hold the truth."""

from typing import Any

from . import coverage
from .registry import Trial, study

REPEATS = 1000


@study(
    "coverage",
    "how often 95 % intervals hold the truth",
    f"python -m kerfgym.experiments.studies.coverage --repeats {REPEATS}",
    10.0,
    (),
)
def of_intervals(trial: Trial) -> dict[str, Any]:
    """One row for each cell of the table, in percent."""
    found: dict[str, Any] = {}
    for (kind, figure, count), shares in coverage.measured_cells(coverage.KINDS, REPEATS, trial.workers).items():
        found.setdefault(kind, {}).setdefault(figure, {})[str(count)] = shares
    return {"numbers": found, "repeats": REPEATS}
