"""Contours by name: what a warning calls them, so that a user finds them in his drawing."""

from collections.abc import Sequence

from .drawing import Drawing
from .report import first_of


def named(drawing: Drawing, contours: Sequence[int], what: str) -> list[str]:
    """A sentence for each of the first contours, with its number and its place in the file, and one for the rest.

    Args:
        drawing: of which they are.
        contours: indices.
        what: what is true of each.
    """
    places = ((drawing.number(i), *(drawing.pieces[i][0] + drawing.origin)) for i in contours)
    return first_of(
        [f"contour {n}, which begins at x = {x:.2f}, y = {y:.2f} mm, {what}" for n, x, y in places], "contour"
    )
