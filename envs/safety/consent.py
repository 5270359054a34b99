"""Whether files may name Python code that is then run.

What a user types on the command line, or writes in a program, is run: ``-c mine.py:Mine``. A file that comes from
somewhere else, such as a ``tuned.toml`` or a preset, may name code too; that is refused until the user agrees, with
``--allow-code`` or the environment variable that it sets, which worker processes inherit.
"""

import contextlib
import os
from pathlib import Path

from ..engine.quantity import InvalidInput

VARIABLE = "KERFGYM_ALLOW_CODE"

EXPORTED = "export.json"
"""A folder with this file holds C, which is compiled and run."""

_SLOTTED = ("z=", "xy=", "process=")


def given() -> bool:
    """Whether the user has agreed."""
    return os.environ.get(VARIABLE) == "1"


def names_code(words: str) -> str:
    """Which code a controller's words, as :func:`stack.resolve` and :func:`stack.team` read them, name: ``Python``, or
    ``C`` of an exported folder; empty if none."""
    for part in words.split(","):
        rest = next((part[len(slot) :] for slot in _SLOTTED if part.startswith(slot)), part)
        pieces = rest.split(":")
        if len(pieces) > 1 and "=" not in pieces[1]:
            return "Python"
        with contextlib.suppress(OSError, ValueError):  # no name of a folder
            if (Path(pieces[0]) / EXPORTED).is_file():
                return "C"
    return ""


def required(words: object, where: str) -> None:
    """Raises :class:`InvalidInput` if a file's words for a controller name code and the user has not agreed."""
    if isinstance(words, str) and (language := names_code(words)) and not given():
        raise InvalidInput(
            f"{where} is '{words}': that is {language} code, which would be run, and a file may not ask for that by "
            f"itself. If you trust its author, add --allow-code (in a program: {VARIABLE}=1)"
        )
