"""Names that become file names: a scenario's, a suite's, a run's. They stay in the folder that they are written to."""

import re
from typing import Any

from ..engine.quantity import InvalidInput

LONGEST = 100
"""Characters of a name; with a suffix and a word before it a file system takes it in any script."""

_ALLOWED = r"\w .,+\-@=()#%&'°µ"
_NAME = re.compile(rf"(?![ .\-])[{_ALLOWED}]{{1,{LONGEST}}}(?<![ .])")
_OTHER = re.compile(rf"[^{_ALLOWED}]")

RULE = (
    f"allowed: 1 to {LONGEST} letters, digits, spaces and . , + - _ @ = ( ) # % & ' ° µ, neither beginning with a "
    "space, dot or dash nor ending with a space or dot"
)


def checked(name: Any, what: str) -> str:
    """``name``, if it may be part of a file's name.

    Raises:
        InvalidInput: it may not; the rule is told.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name) or len(name.encode()) > 2 * LONGEST:
        shown = repr(name) if len(repr(name)) <= LONGEST else f"{repr(name)[:LONGEST]}…"
        raise InvalidInput(f"{what} = {shown} is no name; {RULE}")
    return name


def of_file(stem: str) -> str:
    """A name from that of a user's file, which may have any characters."""
    name = _OTHER.sub("_", stem).strip(" .-")[: LONGEST // 2]
    while len(name.encode()) > LONGEST:
        name = name[:-1]
    return name.rstrip(" .") or "drawing"
