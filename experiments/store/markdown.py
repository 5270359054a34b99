"""Tables in Markdown."""

import re
from collections.abc import Iterable
from typing import Any


def row(cells: Iterable[Any]) -> str:
    """A row; upright strokes in cells are escaped."""
    return "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def table(titles: Iterable[str], rows: Iterable[Iterable[Any]], right: Iterable[int] = ()) -> str:
    """A table with a line of titles; the columns ``right`` are aligned there."""
    head = list(titles)
    ruler = ["---:" if i in right else "---" for i in range(len(head))]
    return "\n".join([row(head), row(ruler), *map(row, rows)]) + "\n"


def as_code(text: str) -> str:
    """Roles such as ``:func:`x``` and double backquotes of a docstring as plain code."""
    return re.sub(r"``([^`]+)``", r"`\1`", re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text))
