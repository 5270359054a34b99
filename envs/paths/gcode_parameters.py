"""Parameters of a G-code programme: ``#5``, ``#<width>`` of a subroutine, ``#<_width>`` of all.

As in LinuxCNC: #1 to #30 and names without a leading underscore belong to the running subroutine; a numbered parameter
that nobody has set is 0; a name that nobody has set is an error, and one with an underscore is the machine's, which is
nan here: it may stand where only the machine need know it.
"""

import math
from collections.abc import Callable

from ..engine.quantity import InvalidInput

Key = int | str
"""A number, or a name in lower case with its ``<>``."""

MOST = 5601
"""The highest number. [P] LinuxCNC"""

LOCAL = range(1, 31)

READ_ONLY = (*range(5400, 5414), *range(5420, 5429))
"""What the machine tells of tool and position."""


class Parameters:
    """``told(key)`` is what the machine knows of itself, None where it knows nothing."""

    def __init__(self, told: Callable[[Key], float | None]) -> None:
        self.told = told
        self.numbers: dict[int, float] = {}
        self.names: dict[str, float] = {}
        self.frames: list[tuple[dict[int, float], dict[str, float]]] = [({}, {})]
        self.set_in: dict[Key, int] = {}
        self.read: set[Key] = set()
        self.unset: set[int] = set()

    def _place(self, key: Key) -> dict:
        if isinstance(key, int):
            return self.frames[-1][0] if key in LOCAL else self.numbers
        return self.names if key.startswith("<_") else self.frames[-1][1]

    def exists(self, key: Key) -> bool:
        """Whether a name has a value."""
        return key in self._place(key) or self.told(key) is not None

    def declare(self, key: Key) -> None:
        """Before its first value is computed: a name in its own expression is 0."""
        if isinstance(key, str) and key not in self._place(key):
            self._place(key)[key] = 0.0

    def set(self, key: Key, value: float, line: int) -> None:
        """Gives a parameter its value, which may be nan."""
        self._place(key)[key] = value
        self.set_in.setdefault(key, line)

    def get(self, key: Key, where: str) -> float:
        """The value.

        Raises:
            InvalidInput: a name without a value, or a number out of range.
        """
        self.read.add(key)
        place = self._place(key)
        if key in place:
            return place[key]
        value = self.told(key)
        if value is not None:
            return value
        if isinstance(key, int):
            self.unset.add(key)
            return 0.0
        if key.startswith("<_"):
            return math.nan
        raise InvalidInput(f"{where}: '#{key}': a parameter that has no value yet")

    def enter(self, values: list[float]) -> None:
        """A subroutine begins with these as #1, #2 and so on."""
        self.frames.append(({i + 1: value for i, value in enumerate(values)}, {}))

    def leave(self) -> None:
        """Back to the parameters of its caller."""
        self.frames.pop()

    def unused(self) -> list[str]:
        """Warnings on parameters that mean something to another reader only."""
        return [
            f"line {line}: #{key} is set and not read by this programme"
            for key, line in self.set_in.items()
            if key not in self.read
        ]


def check(key: int, where: str, write: bool = False) -> None:
    """Whether a parameter has this number, and may be set.

    Raises:
        InvalidInput: it has not.
    """
    if not 1 <= key <= MOST:
        raise InvalidInput(f"{where}: '#{key}': parameters have numbers from 1 to {MOST}")
    if write and key in READ_ONLY:
        raise InvalidInput(f"{where}: '#{key}': it is the machine's, and cannot be set")
