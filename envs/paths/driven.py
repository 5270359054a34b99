"""The curve that is driven: between corners a cubic B-spline along the contour, with curvature that never jumps.

Where a line meets an arc the curvature of a drawing jumps, and with it the acceleration of whoever follows it; the
points of a flattened curve make it jump everywhere. So between two corners the path is a uniform cubic B-spline
(Huang2024 eq. 6) with control points along the contour, a distance h apart that adapts to the curvature κ. Such a
spline keeps straight lines and arcs, and spreads a jump of the curvature over about 4h, the more smoothly the farther
it may leave the contour there: h = sqrt(24·tolerance/κ). Corners are met exactly.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from .bspline import MATRIX
from .curve import CHORD, Floats, Indices, Points

TOLERANCE = 0.005
"""mm, the largest distance of the curve from the contour [A]: a tenth of Wu's ±0.05 mm."""

WIDE = 24.0
"""κh²/tolerance: where a line meets an arc the spline then leaves them by 0.8 of the tolerance."""

COARSEST = 5.0
"""mm between control points."""

GRADE = 0.15
"""Change of that distance per distance, so that neighbours differ little."""

BEND = 0.35
"""rad, the largest turn from one control point to the next."""

NODES = 8
"""Intervals of a span in the table of arc lengths."""

_GAUSS_AT, _GAUSS_WEIGHT = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True)
class Place:
    """Points of a curve; arrays of equal length."""

    xy: Points
    tangent: Points  # unit vectors
    curvature: Floats  # 1/mm, left positive
    curvature_rate: Floats  # 1/mm², per distance


@dataclass(frozen=True)
class Driven:
    """Spans one after the other; ``first[k]`` is the index of the first of the four control points of span k.

    ``corners`` are the spans that begin with a jump of direction, in order; ``vertices`` tells the place of each vertex
    of the contour in spans (span + parameter t).
    """

    control: Points
    first: Indices
    corners: Indices
    vertices: Floats

    @cached_property
    def _powers(self) -> npt.NDArray[np.float64]:
        """The spans as polynomials in t: shape (4, 2, spans), from t³ down (Huang2024 eq. 6)."""
        return np.einsum("pk,nkd->pdn", MATRIX[::-1], self.control[self.first[:, None] + np.arange(4)])

    @cached_property
    def _nodes(self) -> tuple[Floats, Floats]:
        """Arc length and speed |dS/dt| at the ends of all intervals; the latter from both sides."""
        t = np.arange(NODES + 1) / NODES
        speed = self._speed(np.arange(len(self.first))[:, None], t[None, :])
        at = (t[:-1, None] + (0.5 + 0.5 * _GAUSS_AT) / NODES).ravel()
        inside = self._speed(np.arange(len(self.first))[:, None], at[None, :])
        pieces = inside.reshape(-1, len(_GAUSS_AT)) @ _GAUSS_WEIGHT * (0.5 / NODES)
        return np.insert(np.cumsum(pieces), 0, 0.0), np.stack([speed[:, :-1], speed[:, 1:]], axis=-1).reshape(-1, 2)

    @property
    def length(self) -> float:
        """mm."""
        return float(self._nodes[0][-1])

    @property
    def starts(self) -> Floats:
        """mm along the curve where each span begins, and where the last one ends."""
        return self._nodes[0][::NODES]

    def distance(self, spans: npt.ArrayLike) -> Floats:
        """mm along the curve of places given in spans."""
        along, speed = self._nodes
        at: Floats = np.asarray(spans, float) * NODES
        i = np.clip(np.floor(at), 0, len(speed) - 1).astype(np.int64)
        return _hermite(along[i], along[i + 1], speed[i, 0] / NODES, speed[i, 1] / NODES, at - i)

    def at(self, s: npt.ArrayLike) -> Place:
        """Where the curve is at ``s`` mm; at a corner, what comes after it."""
        along, speed = self._nodes
        there: Floats = np.clip(np.asarray(s, float), 0.0, along[-1])
        i = np.clip(np.searchsorted(along, there, side="right") - 1, 0, len(speed) - 1)
        way = along[i + 1] - along[i]
        part = (there - along[i]) / way
        t = (i % NODES) / NODES + _hermite(0.0, 1.0 / NODES, way / speed[i, 0], way / speed[i, 1], part)
        span = i // NODES
        return self._place(span, t)

    def bends(self) -> tuple[Floats, Floats]:
        """Largest curvature, 1/mm, and largest change of curvature, 1/mm², of each span."""
        place = self._place(np.arange(len(self.first))[:, None], np.arange(NODES + 1)[None, :] / NODES)
        return np.abs(place.curvature).max(axis=1), np.abs(place.curvature_rate).max(axis=1)

    def kinks(self) -> tuple[Points, Points]:
        """Unit tangents before and after each corner."""
        before = self._place(self.corners - 1, np.ones(len(self.corners)))
        return before.tangent, self._place(self.corners, np.zeros(len(self.corners))).tangent

    def _derivatives(self, span: Indices, t: Floats) -> list[Floats]:
        """The spline and its derivatives of order 1 to 3 at ``t`` of ``span``: x and y of each."""
        a, b, c, d = self._powers[:, :, span]
        return [
            ((a * t + b) * t + c) * t + d,
            (3.0 * a * t + 2.0 * b) * t + c,
            6.0 * a * t + 2.0 * b,
            6.0 * a + 0.0 * t,
        ]

    def _speed(self, span: Indices, t: Floats) -> Floats:
        a, b, c, _ = self._powers[:, :, span]
        return np.hypot(*((3.0 * a * t + 2.0 * b) * t + c))

    def _place(self, span: Indices, t: Floats) -> Place:
        xy, d1, d2, d3 = self._derivatives(span, t)
        speed = np.hypot(*d1)
        cross, cross_rate = d1[0] * d2[1] - d1[1] * d2[0], d1[0] * d3[1] - d1[1] * d3[0]
        speed_rate = (d1[0] * d2[0] + d1[1] * d2[1]) / speed
        rate = (cross_rate - 3.0 * cross * speed_rate / speed) / speed**4
        return Place(np.stack(list(xy), axis=-1), np.stack(list(d1 / speed), axis=-1), cross / speed**3, rate)


def smooth(points: Points, corners: Indices, tolerance: float = TOLERANCE) -> Driven:
    """The curve along an open polyline (or a closed one from its first point back to it).

    Args:
        points: shape (n, 2), mm, no two successive ones the same.
        corners: vertices where the direction may jump; the ends need not be among them.
        tolerance: mm, the largest distance of the curve from the contour.
    """
    last = len(points) - 1
    breaks = np.unique(np.concatenate([[0], np.asarray(corners, np.int64), [last]]))
    leg = _Legs(points, breaks)
    u = leg.parameter(tolerance)
    first_u, last_u = u[breaks[:-1] * 3], u[breaks[1:] * 3]
    straight = np.maximum.reduceat(np.abs(leg.bend), breaks[:-1]) < 1e-9
    spans = np.where(straight & (np.diff(breaks) == 1), 1, np.maximum(np.ceil(last_u - first_u), 4)).astype(np.int64)
    stretch = np.repeat(np.arange(len(spans)), spans + 1)
    base = np.insert(np.cumsum(spans + 1), 0, 0)
    within = np.arange(len(stretch)) - base[stretch]
    at_u = first_u[stretch] + (last_u - first_u)[stretch] * within / spans[stretch]
    on_contour = leg.at(at_u, u, breaks[:-1][stretch], breaks[1:][stretch])
    on_contour[base[:-1]], on_contour[base[1:] - 1] = points[breaks[:-1]], points[breaks[1:]]

    # A span begins C''/6 beside its second control point (eq. 7); so much are they moved to the outside, and so the
    # spline runs through the ends of a stretch and near the points in it. At the ends it bends as it does beside them.
    control = np.empty((len(on_contour) + 2 * len(spans), 2))
    at = np.arange(len(on_contour)) + 2 * stretch + 1
    control[at] = on_contour
    head, tail = at[base[:-1]], at[base[1:] - 1]
    inner = at[(within > 0) & (within < spans[stretch])]
    second = np.zeros_like(control)
    second[inner] = control[inner + 1] - 2.0 * control[inner] + control[inner - 1]
    curved = spans > 1
    second[head[curved]], second[tail[curved]] = second[head[curved] + 1], second[tail[curved] - 1]
    control[at] -= second[at] / 6.0
    control[head - 1] = 2.0 * control[head] - control[head + 1] + second[head]
    control[tail + 1] = 2.0 * control[tail] - control[tail - 1] + second[tail]

    of_span = np.repeat(np.arange(len(spans)), spans)
    first = np.arange(len(of_span)) + 3 * of_span
    begins = np.insert(np.cumsum(spans), 0, 0)
    vertex_stretch = np.clip(np.searchsorted(breaks, np.arange(last + 1), side="right") - 1, 0, len(spans) - 1)
    part = (u[::3] - first_u[vertex_stretch]) / (last_u - first_u)[vertex_stretch]
    return Driven(control, first, begins[1:-1], begins[vertex_stretch] + part * spans[vertex_stretch])


def joined(curves: list[Driven]) -> Driven:
    """One after the other, each beginning where the one before ends, with a corner between."""
    spans = np.cumsum([0] + [len(c.first) for c in curves])
    points = np.cumsum([0] + [len(c.control) for c in curves])
    corners = [np.append(at, c.corners + at) if at else c.corners for c, at in zip(curves, spans[:-1], strict=True)]
    return Driven(
        np.concatenate([c.control for c in curves]),
        np.concatenate([c.first + at for c, at in zip(curves, points[:-1], strict=True)]),
        np.concatenate(corners).astype(np.int64),
        np.concatenate([c.vertices + at for c, at in zip(curves, spans[:-1], strict=True)]),
    )


class _Legs:
    """The segments of a polyline as cubic Hermite curves whose directions meet except at ``breaks``."""

    def __init__(self, points: Points, breaks: Indices) -> None:
        steps = np.diff(points, axis=0)
        self.points, self.breaks, self.length = points, breaks, np.hypot(*steps.T)
        heading = np.arctan2(steps[:, 1], steps[:, 0])
        turn = np.zeros(len(points))
        turn[1:-1] = (np.diff(heading) + np.pi) % (2.0 * np.pi) - np.pi
        turn[breaks] = 0.0
        before, after = np.append(1.0, self.length), np.append(self.length, 1.0)
        bend = 2.0 * np.abs(turn) / (before + after)
        # Too long to be a chord of a curve that bends as its ends do: a straight line that keeps its direction.
        straight = self.length**2 * np.maximum(bend[1:], bend[:-1]) / 8.0 > 2.0 * CHORD
        a, b = np.where(np.append(True, straight), 0.0, before), np.where(np.append(straight, True), 0.0, after)
        share = np.where(a + b > 0.0, a / np.where(a + b > 0.0, a + b, 1.0), 0.5)
        # Directions at both ends, relative to the chord. At a break the other end's mirror image makes it an arc.
        enters, leaves = -turn[:-1] * (1.0 - share[:-1]), turn[1:] * share[1:]
        broken = np.zeros(len(points), bool)
        broken[breaks] = True
        arc = ~straight
        self.enters = np.where(broken[:-1] & arc, np.where(broken[1:], 0.0, -leaves), enters)
        self.leaves = np.where(broken[1:] & arc, np.where(broken[:-1], 0.0, -enters), leaves)
        self.heading = heading
        self.bend = 2.0 * np.maximum(np.abs(self.enters), np.abs(self.leaves)) / self.length

    def parameter(self, tolerance: float) -> Floats:
        """Running number of control points at the three nodes of each leg and at the end.

        The spacing grows from both ends of a leg at :data:`GRADE` until it reaches what the leg's own curvature allows;
        the two inner nodes stand where it does.
        """
        k = np.maximum(self.bend, 1e-12)
        most = np.minimum(np.minimum(np.sqrt(WIDE * tolerance / k), BEND / k), COARSEST)
        at_vertex = np.minimum(np.append(most, COARSEST), np.insert(most, 0, COARSEST))
        along = GRADE * np.insert(np.cumsum(self.length), 0, 0.0)
        after = np.minimum.accumulate(at_vertex - along) + along
        graded = np.minimum(after, np.minimum.accumulate((at_vertex + along)[::-1])[::-1] - along)
        ha, hb = graded[:-1], graded[1:]
        s1 = np.clip((most - ha) / GRADE, 0.0, self.length)
        s2 = self.length - np.clip((most - hb) / GRADE, 0.0, self.length)
        peak = np.clip(0.5 * (self.length + (hb - ha) / GRADE), 0.0, self.length)
        s1, s2 = np.where(s1 > s2, peak, s1), np.where(s1 > s2, peak, s2)
        self._node = np.stack([0.0 * s1, s1, s2, self.length], axis=1)
        to_end = self.length[:, None] - self._node
        graded = np.minimum(ha[:, None] + GRADE * self._node, hb[:, None] + GRADE * to_end)
        self._spacing = np.minimum(graded, most[:, None])
        h1, h2, way = self._spacing[:, :-1], self._spacing[:, 1:], np.diff(self._node, axis=1)
        ratio = h2 / h1 - 1.0
        even = np.abs(ratio) < 1e-9
        steps = np.where(even, way / h1, way / h1 * np.log1p(ratio) / np.where(even, 1.0, ratio))
        return np.insert(np.cumsum(steps), 0, 0.0)

    def at(self, at_u: Floats, u: Floats, low: Indices, high: Indices) -> Points:
        """Points where the running number is ``at_u``, on the legs from ``low`` up to ``high``."""
        i = np.clip(np.searchsorted(u, at_u, side="right") - 1, 3 * low, 3 * high - 1)
        leg, node = i // 3, i % 3
        h1, h2 = self._spacing[leg, node], self._spacing[leg, node + 1]
        way = self._node[leg, node + 1] - self._node[leg, node]
        count = at_u - u[i]
        grade = np.where(way > 0.0, (h2 - h1) / np.where(way > 0.0, way, 1.0), 0.0)
        flat = np.abs(grade * count) < 1e-9
        s = self._node[leg, node] + h1 * np.where(flat, count, np.expm1(grade * count) / np.where(flat, 1.0, grade))
        t = np.clip(s / self.length[leg], 0.0, 1.0)
        d1, d2 = (self._direction(leg, self.enters), self._direction(leg, self.leaves))
        return _hermite(self.points[leg].T, self.points[leg + 1].T, d1, d2, t).T

    def _direction(self, leg: Indices, off: Floats) -> Floats:
        """Derivative by the leg's parameter, of the size that makes the leg an arc if both ends turn alike."""
        size = self.length[leg] / np.cos(0.25 * (self.leaves[leg] - self.enters[leg])) ** 2
        angle = self.heading[leg] + off[leg]
        return size * np.stack([np.cos(angle), np.sin(angle)])


def _hermite(p0: npt.ArrayLike, p1: npt.ArrayLike, d0: npt.ArrayLike, d1: npt.ArrayLike, t: Floats) -> Floats:
    """The cubic with the values p and slopes d at 0 and 1."""
    p0, p1, d0, d1 = (np.asarray(v, float) for v in (p0, p1, d0, d1))
    rest = 1.0 - t
    return p0 * (1 + 2 * t) * rest**2 + d0 * t * rest**2 + p1 * t**2 * (3 - 2 * t) - d1 * t**2 * rest
