"""Programmed feeds: from mm/s of every segment of a piece to limits of the curve that is driven along it."""

import numpy as np

from ..engine.quantity import InvalidInput
from .curve import Floats, Indices, Points, lengths
from .drawing import Drawing
from .driven import Driven

STRAIGHT = 1e-6
"""rad, below which two segments are one line."""

LONGEST = 5400.0
"""s of a piece at its programmed feeds; of a job each millisecond is kept."""


def of_piece(drawing: Drawing, number: int, feed: float, most: float) -> Floats | None:
    """mm/s of each segment of a piece: as programmed, ``feed`` where that is left open, ``most`` at most.

    None where no programme says any.

    Raises:
        InvalidInput: so slow that the piece takes longer than :data:`LONGEST`.
    """
    if drawing.leg_feeds is None:
        return None
    legs = drawing.leg_feeds[number]
    legs = np.minimum(np.where(np.isfinite(legs), legs, feed), most)
    seconds = float((lengths(drawing.pieces[number]) / legs).sum())
    if seconds > LONGEST:
        raise InvalidInput(
            f"the programmed feed, {60.0 * legs.min():g} mm/min at its least, takes {seconds:.0f} s; allowed: "
            f"{LONGEST:.0f} s for a piece"
        )
    return legs


def breaks(points: Points, corners: Indices, legs: Floats | None) -> Indices:
    """``corners``, and the vertices of straight lines where the feed changes: there it changes just there."""
    if legs is None:
        return corners
    turn = np.abs(turns(np.diff(points, axis=0)))
    changes = np.flatnonzero((legs[1:] != legs[:-1]) & (turn < STRAIGHT)) + 1
    return np.union1d(corners, changes).astype(np.int64)


def turns(legs: Floats) -> Floats:
    """Change of direction from leg to leg, rad, left positive."""
    a, b = legs[:-1], legs[1:]
    return np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))


def of_spans(curve: Driven, legs: Floats) -> Floats:
    """mm/s of each span of the curve along a polyline with one feed for each segment: the least that it touches."""
    if len(legs) + 1 != len(curve.vertices):
        raise ValueError(f"{len(legs)} feeds for {len(curve.vertices) - 1} segments")
    first = np.floor(curve.vertices[:-1] + 1e-9).astype(np.int64)
    last = np.maximum(np.ceil(curve.vertices[1:] - 1e-9).astype(np.int64) - 1, first)
    count = last - first + 1
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    spans = np.minimum(np.repeat(first, count) + within, len(curve.first) - 1)
    found = np.full(len(curve.first), np.inf)
    np.minimum.at(found, spans, np.repeat(legs, count))
    return found
