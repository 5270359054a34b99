"""The run's record: versions, seeds, hashes, costs."""

from typing import Any

from .suite import Suite

SHOWN = ("command", "kerfgym", "git", "python", "packages", "machine", "wall_seconds")
"""What holds for all grids, first in the record."""


def record(suites: list[Suite], meta: dict[str, Any]) -> dict[str, Any]:
    """What the page's end shows: the run's own, then each grid's: seeds, budgets, parameters, hashes of its tables."""
    own = {key: meta[key] for key in SHOWN if key in meta}
    own |= {key: value for key, value in meta.items() if key not in own}
    grids = {s.title: {k: v for k, v in s.results.meta.items() if k not in meta and k != "command"} for s in suites}
    return {**own, **(next(iter(grids.values())) if len(grids) == 1 else grids)}
