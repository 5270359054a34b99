"""A command that dies: ``python -m kerfgym.experiments.studies.kills.steps N COMMAND …``.

It ends with all that it has started at its N-th step of writing: before or after a file takes its name, gets its first
bytes, is cut or removed. With 0 it lives, and writes how many such steps it made into the file that ``KERFGYM_STEPS``
names.

Moments drawn at random hardly ever meet these, which take microseconds.
"""

import atexit
import functools
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

COUNTED = "KERFGYM_STEPS"

CALLS = ("replace", "pwrite", "ftruncate", "unlink")
"""Of :mod:`os`; before each and after each is a step."""


class Steps:
    """Counts them.

    Args:
        last: at which the process and its group are killed; 0: at none.
    """

    def __init__(self, last: int) -> None:
        self.last, self.made = last, 0

    def one(self) -> None:
        """A step."""
        self.made += 1
        if self.made == self.last:
            os.killpg(0, signal.SIGKILL)

    def around(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """The call with a step before it and one after it."""

        @functools.wraps(call)
        def counted(*arguments: Any, **options: Any) -> Any:
            self.one()
            out = call(*arguments, **options)
            self.one()
            return out

        return counted


def main() -> None:
    """Entry point."""
    steps = Steps(int(sys.argv.pop(1)))
    for name in CALLS:
        setattr(os, name, steps.around(getattr(os, name)))
    if counted := os.environ.get(COUNTED):
        atexit.register(lambda: Path(counted).write_text(str(steps.made), encoding="utf-8"))
    from ...cli import main as command  # after the changes

    command()


if __name__ == "__main__":
    main()
