"""Curves: what a line, an arc or a spline of a file becomes: a polyline that still knows where it is smooth.

Points are complex numbers x + jy while a curve is made and arrays of shape (n, 2) afterwards; everything is in mm. A
polyline alone does not tell a corner from the chords of a small arc, so each curve carries its tangents at both ends
and the vertices at which its own tangent jumps. They come from the curve and not from its chords (of splines: to
0.02°).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import isfinite

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

Points = npt.NDArray[np.float64]
"""A polyline: shape (n, 2), mm."""

Indices = npt.NDArray[np.int64]

Complex = npt.NDArray[np.complex128]

CHORD = 0.002
"""mm, the largest distance between a curve and its chords. [A] far below any axis' following error."""

EXACT = 1e-6
"""mm, below which two points are the same."""

CORNER = np.radians(5.0)
"""rad, the change of the tangent beyond which a vertex is a corner. [A]"""

MOST = 100_000
"""Points of one curve; more are of no use, and a curve of astronomic size would have no end of them."""

HALVINGS = 60
"""Most that the span of a curve is halved; its parameter has no more digits."""

RUN = 500
"""Bézier curves that are flattened together."""


@dataclass(frozen=True)
class Curve:
    """A polyline with the exact tangents of what it stands for.

    ``points``: shape (n, 2), mm; ``corners``: indices of the vertices between its ends at which its tangent turns by
    more than :data:`CORNER`, and 0 where a closed curve turns so in its first and last point; ``start`` and ``end``:
    the tangents there, in the direction of travel, of any length; ``closed``: it ends exactly in its first point.
    """

    points: Points
    corners: Indices
    start: complex
    end: complex
    closed: bool = False

    @cached_property
    def length(self) -> float:
        """mm."""
        legs = self.points[1:] - self.points[:-1]
        return float(np.hypot(legs[:, 0], legs[:, 1]).sum())

    @property
    def leads(self) -> bool:
        """Whether it leads anywhere: it is longer than :data:`EXACT`."""
        if len(self.points) < 2:
            return False
        far = self.points[-1] - self.points[0]
        return bool(abs(far[0]) > EXACT or abs(far[1]) > EXACT) or not self.length <= EXACT

    def reversed(self) -> "Curve":
        """The same, travelled backwards."""
        last = len(self.points) - 1
        corners = np.sort(last - self.corners) % last if self.closed else last - self.corners[::-1]
        return replace(self, points=self.points[::-1], corners=np.sort(corners), start=-self.end, end=-self.start)

    def mapped(self, image: Callable[[Complex], Complex]) -> "Curve":
        """Its image under an affine map of the plane."""
        origin = image(np.zeros(1, complex))[0]
        start, end = image(np.array([self.start, self.end])) - origin
        z = image(self.points[:, 0] + 1j * self.points[:, 1])
        return _curve(z, self.corners, start, end)


def turns(a: complex, b: complex) -> bool:
    """Whether the tangent ``b`` is turned against ``a`` by more than :data:`CORNER`."""
    turned = b * a.conjugate()
    return bool(abs(np.arctan2(turned.imag, turned.real)) > CORNER)


# Making them


def _curve(z: Complex, corners: npt.ArrayLike, start: complex, end: complex) -> Curve:
    """A curve through ``z``; where a tangent is none, as that of a circle seen from its edge, its chord is taken."""
    if len(z) > 1:
        start, end = start or z[1] - z[0], end or z[-1] - z[-2]
    return Curve(np.column_stack([z.real, z.imag]), np.asarray(corners, np.int64), complex(start), complex(end))


def line(start: complex, end: complex) -> Curve:
    """Straight from point to point; a single point where they are the same."""
    way = complex(end - start)
    points = [[start.real, start.imag], [end.real, end.imag]]
    return Curve(np.array(points[:1] if abs(way) <= EXACT else points, float), np.zeros(0, np.int64), way, way)


def polyline(points: npt.ArrayLike) -> Curve:
    """Straight from point to point; points that repeat the one before are left out."""
    z: Complex = np.asarray(points, np.complex128)
    if len(z) == 0:
        return _curve(z, [], 0, 0)
    z = z[np.append(True, ~(np.abs(np.diff(z)) <= EXACT))]
    legs = np.diff(z)
    turned = np.abs(np.angle(legs[1:] * legs[:-1].conj())) > CORNER
    return _curve(z, np.flatnonzero(turned) + 1, 0, 0)


def arc(centre: complex, start: complex, end: complex, angle: float, chord: float = CHORD) -> Curve:
    """From ``start`` to ``end`` around ``centre`` through ``angle`` rad, counter-clockwise if positive.

    Where the two distances from the centre differ, as rounded numbers do, the radius goes over from one to the other.
    """
    r0, r1 = abs(start - centre), abs(end - centre)
    if not isfinite(r0 + r1 + angle):
        return _curve(np.full(2, complex(np.nan, np.nan)), [], 0, 0)
    if max(r0, r1) < EXACT or angle == 0.0:
        return line(start, end)
    step = 2.0 * np.arccos(max(1.0 - chord / max(r0, r1), 0.0))
    part = _parts(int(np.ceil(abs(angle) / max(step, 1e-4))))
    towards = (start - centre) / r0 if r0 else (end - centre) / r1 * np.exp(-1j * angle)
    spoke = towards * np.exp(1j * angle * part)
    z = centre + (r0 + (r1 - r0) * part) * spoke
    z[0], z[-1] = start, end
    ahead = 1j * np.sign(angle)
    return _curve(z, [], ahead * spoke[0], ahead * spoke[-1])


@lru_cache(maxsize=64)
def _parts(count: int) -> Floats:
    """From 0 to 1 in ``count`` equal steps; the holes of a sheet are mostly of a few sizes."""
    return np.linspace(0.0, 1.0, count + 1)


def smooth(at: Callable[[Floats], Complex], breaks: npt.ArrayLike, chord: float = CHORD) -> Curve:
    """The curve ``at(t)`` over the rising ``breaks``, halved until the chords are close enough.

    Only at the breaks may its tangent jump.
    """
    breaks = np.asarray(breaks, float)
    parts = np.linspace(0.0, 1.0, 8, endpoint=False)  # a single chord may touch an S-shaped span in its middle
    t = np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * parts).ravel(), breaks[-1])
    z = at(t)
    chord = max(chord, 1e-9 * float(np.ptp(z.real) + np.ptp(z.imag))) if np.isfinite(z).all() else chord
    coarse = np.ones(len(t) - 1, bool)
    for _ in range(HALVINGS):
        if not coarse.any() or len(t) >= MOST:
            break
        i = np.flatnonzero(coarse)
        middle = 0.5 * (t[i] + t[i + 1])
        there = at(middle)
        bad = np.abs(there - 0.5 * (z[i] + z[i + 1])) > chord
        coarse[i[~bad]] = False
        new = i[bad] + 1
        t, z, coarse = np.insert(t, new, middle[bad]), np.insert(z, new, there[bad]), np.insert(coarse, new, True)
    step = 1e-4 * np.diff(breaks)
    here = at(breaks)
    after, before = at(breaks[:-1] + step) - here[:-1], here[1:] - at(breaks[1:] - step)
    turned = np.abs(np.angle(after[1:] * before[:-1].conj())) > CORNER
    return _curve(z, np.searchsorted(t, breaks[1:-1][turned]), after[0], before[-1])


def beziers(controls: npt.ArrayLike, chord: float = CHORD) -> Curve:
    """Cubic Bézier curves that follow one another, of which each row of ``controls``, shape (n, 4), has the points."""
    rows: Complex = np.asarray(controls, np.complex128)

    def at(t: Floats) -> Complex:
        i = np.minimum(t.astype(np.int64), last)
        u = t - i
        a, b, c, d = part[i].T
        v = 1.0 - u
        return v * v * v * a + 3.0 * v * v * u * b + 3.0 * v * u * u * c + u * u * u * d

    curves = []
    for first in range(0, len(rows), RUN):
        part = rows[first : first + RUN]
        last = len(part) - 1
        curves.append(smooth(at, np.arange(len(part) + 1.0), chord))
    return curves[0] if len(curves) == 1 else linked(curves)


def quadratic(start: complex, bend: complex, end: complex) -> tuple[complex, complex, complex, complex]:
    """The control points of a quadratic Bézier curve as those of a cubic one."""
    return start, start + 2 / 3 * (bend - start), end + 2 / 3 * (bend - end), end


def rational(
    knots: Floats, control: Complex, weights: Floats, degree: int, breaks: npt.ArrayLike, chord: float = CHORD
) -> Curve:
    """A rational B-spline over ``breaks``, some of its knots."""
    from scipy.interpolate import BSpline  # slow

    above, below = BSpline(knots, control * weights, degree), BSpline(knots, weights, degree)
    return smooth(lambda t: above(t) / below(t), breaks, chord)


def strokes(start: complex, steps: Iterable[tuple[complex, ...]], chord: float = CHORD) -> list[Curve]:
    """What a pen draws from ``start``: each step has its control points, if any, and its end."""
    parts = []
    for step in steps:
        if len(step) == 1:
            parts.append(line(start, step[0]))
        else:
            parts.append(beziers([(start, *step) if len(step) == 3 else quadratic(start, *step)], chord))
        start = step[-1]
    return parts


# Putting them together


def linked(curves: Iterable[Curve], closed: bool = False) -> Curve:
    """One curve after the other, with a corner wherever two meet at an angle; a closed one ends in its first point."""
    curves = list(curves)
    if len(curves) == 1 and not closed and len(curves[0].points) == 2 and curves[0].leads:
        return curves[0]
    curves = [c for c in curves if c.leads] or curves[:1]
    corners: list[int] = []
    count = 0
    for before, c in zip([None, *curves], curves, strict=False):
        if before is not None and turns(before.end, c.start):
            corners.append(count - 1)
        if len(c.corners):
            corners += (c.corners + count).tolist()
        count += len(c.points)
    if closed and turns(curves[-1].end, curves[0].start):
        corners.append(0)
    points = np.concatenate([c.points for c in curves] + ([curves[0].points[:1]] if closed else []))
    legs = points[1:] - points[:-1]
    kept = np.append(True, ~(np.hypot(legs[:, 0], legs[:, 1]) <= EXACT)) if len(points) else np.zeros(0, bool)
    place = (np.cumsum(kept) - 1)[np.array(corners, np.int64)]
    left = points[kept]
    if len(left):
        left[-1] = points[-1]
    if closed and len(left) > 1:
        place = place % (len(left) - 1)
    return Curve(left, np.unique(place), curves[0].start, curves[-1].end, closed)


def lengths(points: Points) -> Floats:
    """mm of each segment of a polyline."""
    return np.hypot(*np.diff(points, axis=0).T)


def way_along(points: Points) -> Floats:
    """mm from the beginning of a polyline to each of its points."""
    return np.append(0.0, np.cumsum(lengths(points)))


def point_at(points: Points, way: Floats, place: float) -> Points:
    """Where a polyline is at ``place`` mm; ``way``: see :func:`way_along`."""
    return np.array([np.interp(place, way, points[:, k]) for k in (0, 1)])


def key(points: Points) -> bytes:
    """The same for two polylines that run through the same points, in either direction."""
    grid = np.round(points / EXACT) + 0.0  # no −0, whose bytes differ
    return min(grid.tobytes(), grid[::-1].tobytes())
