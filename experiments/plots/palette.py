"""Colours of every picture, and how a controller is drawn in all of them."""

from collections.abc import Iterable
from typing import NamedTuple

INK, QUIET, GRID, SHADE = "#1a1d20", "#5f666d", "#e1e4e8", "#eceef0"

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#882255", "#7A7A00", "#6655CC")
"""Okabe and Ito's palette without yellow, which does not show on white; then a wine, an olive and an indigo."""

DASHES = ("solid", "dash", "dashdot", "dot", "longdash")
"""Five, so that with ten colours the first 50 controllers differ in one or the other."""

SYMBOLS = (
    *("circle", "square", "diamond", "triangle-up", "triangle-down"),
    *("pentagon", "x", "star", "hexagon", "triangle-right"),
)
"""Of plotly; one for each colour, so that points are told apart without it."""

MARKERS = "osD^vPX*h>"
"""The same of matplotlib."""

DIVERGING = ((0.0, "#08519c"), (0.25, "#6baed6"), (0.5, "#f7f7f5"), (0.75, "#f4a35f"), (1.0, "#a63603"))
"""From much better by blue over equal to much worse by orange; told apart by every kind of eye."""


class Look(NamedTuple):
    """How a controller is drawn: colour, dash of its lines, symbol of its points."""

    colour: str
    dash: str
    symbol: str


def looks(names: Iterable[str]) -> dict[str, Look]:
    """The look of each controller, in order of appearance."""
    return {
        name: Look(COLOURS[i % len(COLOURS)], DASHES[i // len(COLOURS) % len(DASHES)], SYMBOLS[i % len(SYMBOLS)])
        for i, name in enumerate(dict.fromkeys(names))
    }


def faded(colour: str, alpha: float) -> str:
    """A colour of which something shines through."""
    r, g, b = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},{alpha:g})"
