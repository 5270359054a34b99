"""Path: where the nozzle is, at constant feed along a straight line or along the contours of a drawing.

Drawings are resampled at a uniform arc length when they are read, so that the machine finds its place by one
multiplication. The axes that travel it are ideal here: they are where the path says.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .lanes import U1, clip, part

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
def advance(p, s, dt, ahead):
    """Time and distance one control period of ``dt`` seconds later, on a straight line along x.

    ``ahead``: s by which they run ahead of the machine.
    """
    distance = s.distance + p.feed * dt
    return State(
        s.time + dt, distance, distance, 0.0, s.distance + 0.5 * p.feed * dt, 0.0, p.feed, distance - p.feed * ahead
    )


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
