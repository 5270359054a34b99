"""Keys that change nothing in a scenario of a kind, and why: with a job, and without one.

A key that did nothing without a word would let its writer believe that it had done something, so it is an error.
"""

from collections.abc import Iterable
from typing import Any

from ..engine.quantity import InvalidInput

IN_JOBS = {
    "duration": "a job lasts until everything is cut",
    "settle": "all that a job cuts is scored",
    "feed": "a job has its feed from job.feed, else from its material",
    "set_height": "a job has its height from its material; job.standoff sets the machine off it",
    "start_above": "a job begins at the height from which it pierces",
}
IN_FOLLOWERS = {
    "gantry": "only a job has X and Y axes that follow with an error; it needs a table [job]",
    "optics": "only a job has a spot to dither; it needs a table [job]",
}


def reasons(job: Any) -> dict[str, str]:
    """Why each dead key changes nothing, in scenarios with this ``job`` (None: without one)."""
    return IN_FOLLOWERS if job is None else IN_JOBS


def refuse(keys: Iterable[str], job: Any) -> None:
    """Raises :class:`InvalidInput` for a dead one among ``keys`` of a scenario with this ``job``."""
    why = reasons(job)
    for key in keys:
        if key in why:
            raise InvalidInput(f"{key} changes nothing {'without' if job is None else 'with'} a job: {why[key]}")


def without(tables: dict[str, Any]) -> dict[str, Any]:
    """A scenario's tables without their dead keys, which runs of earlier versions have stored."""
    return {key: value for key, value in tables.items() if key not in reasons(tables.get("job"))}
