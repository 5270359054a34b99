"""The command as it was typed, for whoever records it; in a module of its own, because help needs nothing else."""

import shlex
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from contextvars import ContextVar

from ..envs.secrets import masked_word

TYPED: ContextVar[tuple[str, ...]] = ContextVar("typed", default=())
"""Its words; empty where a program calls, which says itself whether a run is to go on."""

AFTERWARDS: ContextVar[ExitStack | None] = ContextVar("afterwards", default=None)
"""What is done when the command is over; none where a program calls."""

_MANNER = ("--resume", "--overwrite")


def line() -> str:
    """The command, or that of the process, without passwords."""
    return joined(TYPED.get() or ("kerfgym", *sys.argv[1:]))


def same(words: Sequence[str]) -> str:
    """A command without what tells a run to go on or to begin anew, and without passwords."""
    return joined([word for word in words if word not in _MANNER])


def joined(words: Sequence[str]) -> str:
    """A command as a shell takes it; where passwords were it has …."""
    return shlex.join(masked_word(word) for word in words)
