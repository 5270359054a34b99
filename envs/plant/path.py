"""Path: where the nozzle is, along a straight line or along the contours of a drawing.

The feed is constant, or it slows down for *corners*: each within its ``pitch`` of the path at a place of its own. There
it is ``corner_feed``, elsewhere no more than what the acceleration lets it reach or leave it from.

Drawings are resampled at a uniform arc length when they are read, so that the machine finds its place by one
multiplication. The axes that travel it are ideal here: they are where the path says.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from ..engine.lanes import U1, clip, part
from ..engine.quantity import Quantity

SPACING = 0.05
"""mm between the samples of a contour."""


class Params(NamedTuple):
    """A journey."""

    feed: float = 200.0  # mm/s
    contour: float = -1.0  # index of the first sample in the contours' table; −1: straight along x
    samples: float = 0.0  # their number
    profile: float = -1.0  # index of the first sample in the profiles' table; −1: none
    profile_samples: float = 0.0  # 0: a height map begins there
    profile_spacing: float = 1.0  # mm
    lap: float = 0.0  # mm, length of a lap of a path that is travelled again and again; 0: it is not
    corner: float = 0.0  # mm, pitch of the corners; 0: none
    corner_feed: Annotated[float, Quantity("mm/s", 1, 2000, "in a corner")] = 20.0
    corner_acceleration: Annotated[float, Quantity("mm/s²", 100, 1e5, "of the axes")] = 5000.0
    corner_phase: float = 0.0  # where the corners lie in their pitches, 0–1


class State(NamedTuple):
    """Place and time; both run ahead of the machine by the preview, so that the sheet ahead is known."""

    time: float = 0.0  # s
    distance: float = 0.0  # mm along the path
    x: float = 0.0  # mm
    y: float = 0.0  # mm
    middle_x: float = 0.0  # mm, half a control period earlier
    middle_y: float = 0.0  # mm
    feed: float = 0.0  # mm/s along the path
    here: float = 0.0  # mm along the path, where the machine is now


@part
def corner_at(p, n):
    """Where the ``n``-th corner lies along the path, mm: in the middle three fifths of its pitch."""
    u = p.corner_phase + 0.6180339887498949 * n  # multiples of the golden ratio fill [0, 1) evenly, without a period
    return p.corner * (n + 0.2 + 0.6 * (u - np.floor(u)))


@part
def feed_at(p, distance):
    """Feed at the distance along the path, mm/s: from a corner on v² = corner_feed² + 2·a·distance.

    Before the start it is that at the start, with which the path arrives there.
    """
    s = max(distance, 0.0)
    n = np.floor(s / max(p.corner, 1e-9))
    off = min(abs(s - corner_at(p, n)), min(abs(s - corner_at(p, n - 1.0)), abs(s - corner_at(p, n + 1.0))))
    slow = np.sqrt(p.corner_feed * p.corner_feed + 2.0 * p.corner_acceleration * off)
    return min(p.feed, slow) if p.corner > 0.0 else p.feed


@part
def advance(p, s, dt, ahead):
    """Time and distance one control period of ``dt`` seconds later, on a straight line along x.

    ``ahead``: s by which they run ahead of the machine.
    """
    feed = feed_at(p, s.distance)
    distance = s.distance + feed * dt
    # With corners the machine's own place needs a sum of its own, of the same terms, begun `ahead` later.
    behind = s.here + (feed_at(p, s.here) * dt if s.time + 1.5 * dt >= ahead else 0.0)
    here = behind if p.corner > 0.0 else distance - p.feed * ahead
    return State(s.time + dt, distance, distance, 0.0, s.distance + 0.5 * feed * dt, 0.0, feed, here)


@part
def sample(table, first, samples, spacing, distance):
    """Linear interpolation in a uniformly sampled table; beyond its ends the end value."""
    at = clip(distance / spacing, 0.0, samples - 1.000001)
    low = np.floor(at)
    i = np.uint64(np.int64(first + low))
    return table[i] + (at - low) * (table[i + U1] - table[i])


MAP = 5
"""Numbers before a height map's heights: samples along x and y, its origin (mm), its spacing (mm)."""


@part
def height_of(table, first, x, y):
    """Height of a map at (x, y), mm: bilinear; beyond its borders the border's height.

    ``table[first]`` … hold its head (:data:`MAP`), then its heights, row by row along x.
    """
    i = np.uint64(np.int64(first))
    nx, ny, spacing = table[i], table[i + U1], table[i + np.uint64(4)]
    u = clip((x - table[i + np.uint64(2)]) / spacing, 0.0, nx - 1.000001)
    v = clip((y - table[i + np.uint64(3)]) / spacing, 0.0, ny - 1.000001)
    a, b = np.floor(u), np.floor(v)
    k = i + np.uint64(MAP) + np.uint64(np.int64(b * nx + a))
    row = np.uint64(np.int64(nx))
    low = table[k] + (u - a) * (table[k + U1] - table[k])
    high = table[k + row] + (u - a) * (table[k + row + U1] - table[k + row])
    return low + (v - b) * (high - low)


@dataclass(frozen=True)
class Contour:
    """A polyline resampled at :data:`SPACING`: ``x``, ``y`` in mm and whether the beam is on (``cutting``)."""

    name: str
    x: np.ndarray
    y: np.ndarray
    cutting: np.ndarray

    @property
    def length(self) -> float:
        """mm."""
        return (len(self.x) - 1) * SPACING


def resample(name: str, pieces: list[np.ndarray]) -> Contour:
    """One journey through ``pieces`` (arrays of shape (n, 2), mm) in order, beam off on the straight moves between."""
    points, on = [], []
    for piece in pieces:
        points += list(piece)
        on += [0.0] + [1.0] * (len(piece) - 1)  # the segment that ends at a point
    xy, beam = np.asarray(points, float), np.asarray(on)
    lengths = np.hypot(*np.diff(xy, axis=0).T)
    keep = np.concatenate([[True], lengths > 1e-9])
    xy, beam = xy[keep], beam[keep]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    grid = np.arange(0.0, along[-1], SPACING)
    segment = np.clip(np.searchsorted(along, grid, side="left"), 1, len(along) - 1)
    return Contour(name, np.interp(grid, along, xy[:, 0]), np.interp(grid, along, xy[:, 1]), beam[segment])
