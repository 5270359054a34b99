"""Contours by name: what a warning calls them, so that a user finds them in his drawing."""

from collections.abc import Sequence

from .drawing import Drawing

NAMED = 5
"""Contours that a warning names; of more it tells how many there are."""


def named(drawing: Drawing, contours: Sequence[int], what: str) -> list[str]:
    """A sentence for each of the first contours, with its number and its place in the file, and one for the rest.

    Args:
        drawing: of which they are.
        contours: indices.
        what: what is true of each.
    """
    out = []
    for i in contours[:NAMED]:
        x, y = drawing.pieces[i][0] + drawing.origin
        out.append(f"contour {drawing.number(i)}, which begins at x = {x:.2f}, y = {y:.2f} mm, {what}")
    if len(contours) > NAMED:
        rest = len(contours) - NAMED
        out.append(f"the same is true of {rest} more contour{'s' if rest > 1 else ''}")
    return out
