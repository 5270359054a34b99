"""The command as it was typed, for whoever records it, and how errors are told; in a module of its own, because help
needs nothing else."""

import re
import shlex
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from contextvars import ContextVar

from ...envs.safety.secrets import masked, masked_word

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


_STEERS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")


def plain(text: str) -> str:
    """Text with � in place of what steers a terminal: a name in somebody else's drawing may hold anything."""
    return _STEERS.sub("�", text)


def say(text: str) -> None:
    """Tells the user something beside a command's result."""
    print(f"kerfgym: {plain(text)}", file=sys.stderr)


_ENDLESS = re.compile(r"(\S{200})\S{800,}")

MOST_TOLD = 4000
"""Characters of an error; what a file holds may be without an end."""


def told(error: Exception) -> str:
    """An error as it is shown: without passwords, and no longer than can be read."""
    words = _ENDLESS.sub(r"\1…", plain(masked(str(error))))
    return words if len(words) <= MOST_TOLD else f"{words[:MOST_TOLD]}…"
