"""Study of the search for a filter against a full grid."""

import shutil
from typing import Any

from ..store.stamp import LAWS, LOADED, suite
from . import filter_grid
from .registry import Trial, study


@study(
    "filter-grid",
    "the filter that a search finds, against the best of a full grid",
    "python -m kerfgym.experiments.studies.filter_grid",
    8.0,
    (*LOADED, *LAWS, *suite("following")),
)
def of_filters(trial: Trial) -> dict[str, Any]:
    """An interrupted one begins anew: the search is a small part of it."""
    if trial.folder.exists():
        shutil.rmtree(trial.folder)
    found = filter_grid.compare(trial.folder, filter_grid.TRIALS, trial.workers)
    for name, ratio in found["search_over"].items():
        found["search_over"][name] = {end: 100.0 * (value - 1.0) for end, value in ratio.items()}
    return {"numbers": found}
