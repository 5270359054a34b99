"""Tables in Markdown."""

import re
from collections.abc import Iterable
from typing import Any


def row(cells: Iterable[Any]) -> str:
    """A row; upright strokes in cells are escaped."""
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def table(titles: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """A table with a line of titles."""
    head = list(titles)
    return "\n".join([row(head), row(["---"] * len(head)), *map(row, rows)]) + "\n"


def as_code(text: str) -> str:
    """Roles such as ``:func:`x``` and double backquotes of a docstring as plain code."""
    return re.sub(r"``([^`]+)``", r"`\1`", re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text))
