"""Scripts of the project, ``python -m kerfgym.experiments.…``, as commands: words to arguments, errors to a line."""

import sys
from collections.abc import Callable
from typing import Any

import tyro

from ...envs.engine.quantity import InvalidInput, check_choice
from . import typed

MOST = 100
"""Exit code for as many problems, or more; codes above have meanings of their own."""


def run(function: Callable[..., Any], module: str) -> None:
    """Runs a function with what was typed, and ends the process: 0, the number of problems that it found, or 2 and a
    line about bad input.

    Args:
        function: its docstring is the help; what it returns is a number of problems, or nothing.
        module: where it stands, as typed after ``python -m``.
    """
    try:
        problems = tyro.cli(function, prog=f"python -m {module}")
    except InvalidInput as error:
        print(f"{module.rpartition('.')[2]}: error: {typed.told(error)}", file=sys.stderr)
        raise SystemExit(2) from None
    raise SystemExit(min(problems or 0, MOST))


def known(names: tuple[str, ...], every: dict[str, Any], what: str) -> list[str]:
    """Those that were named; all if none was.

    Raises:
        InvalidInput: an unknown one; the nearest is offered.
    """
    for name in names:
        check_choice(name, every, what)
    return list(names or every)
