"""Keys that change nothing in a scenario of a kind, and why: with a job, and without one.

A key that did nothing without a word would let its writer believe that it had done something, so it is an error.
"""

from collections.abc import Iterable
from typing import Any

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


def reasons(job: bool) -> dict[str, str]:
    """Why each dead key changes nothing, in scenarios with a job or without one."""
    return IN_JOBS if job else IN_FOLLOWERS


def refusal(keys: Iterable[str], job: Any) -> tuple[str, str] | None:
    """The first dead one among ``keys`` of a scenario with this ``job`` (None: without one), and what to say of it."""
    why = reasons(job is not None)
    kind = "with a job" if job is not None else "without a job"
    return next(((key, f"{key} changes nothing {kind}: {why[key]}") for key in keys if key in why), None)
