"""The command as it was typed, for whoever records it; in a module of its own, because help needs nothing else."""

import shlex
import sys
from collections.abc import Sequence
from contextvars import ContextVar

TYPED: ContextVar[tuple[str, ...]] = ContextVar("typed", default=())
"""Its words; empty where a program calls, which says itself whether a run is to go on."""

_MANNER = ("--resume", "--overwrite")


def line() -> str:
    """The command, or that of the process."""
    return shlex.join(TYPED.get() or ("kerfgym", *sys.argv[1:]))


def same(words: Sequence[str]) -> str:
    """A command without what tells a run to go on or to begin anew."""
    return shlex.join(word for word in words if word not in _MANNER)
