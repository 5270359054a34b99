"""Feed along a curve: as fast as the limits of speed, acceleration and jerk allow, slower in curves and at corners.

The limits hold for vectors, not for each axis: |v| ≤ feed, |dv/dt| ≤ acceleration and |d²v/dt²| ≤ jerk. Along a curve
with curvature κ and its change κ' these are, with path speed v, path acceleration a and path jerk j::

    acceleration² = a² + (κv²)²
    jerk² = (j − κ²v³)² + (3κva + κ'v³)²

The curve is cut into blocks in each of which the speed, acceleration and jerk along the path have one limit, such that
any combination within them keeps the vectors within theirs. On straight lines these are the full limits. Between
blocks the speed is one that both allow and that can be reached; every change is an S-curve (:mod:`.scurve`).

At a corner the direction jumps, and with it the velocity, by no more than the corner jump. With a corner jump of 0
every corner is a full stop, and then the limit of acceleration holds there too.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..engine.quantity import InvalidInput
from . import scurve
from .curve import CHORD, Floats, Indices, lengths
from .driven import Driven, joined, smooth
from .feeds import of_spans, turns

MILLISECOND = 1e-3

ACROSS = 0.8
"""Share of the acceleration that may stand across the path [A]; sqrt(1 − 0.8²) = 0.6 remains along it."""

TWIST = (0.5, 0.3, 0.3)
"""Shares of the jerk for κ'v³, 3κva and κ²v³ [A]; at least 0.3 remains along the path."""

FOLD = 1.0
"""rad; vertices that turn more are corners even where the corners are given."""

EASE = (1.0, 0.75, 0.55)
"""Shares of the speed that a bend allows: less speed there leaves more acceleration. The fastest of these is taken."""

STEPS = ((0.9, 0.7), (0.6, 0.4), (0.3, 0.3))
"""Limits of speed, and of acceleration and jerk, within these ratios of each other make one block. Few blocks save the
time to ease in and out of the acceleration, many follow the limits more closely; the fastest of these is taken."""


@dataclass(frozen=True)
class Limits:
    """mm/s, mm/s², mm/s³ of vectors; ``jump``: mm/s, of the velocity in a corner; 0: stop there."""

    speed: float
    acceleration: float
    jerk: float
    jump: float

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "jerk"):
            if not getattr(self, name) > 0:
                raise InvalidInput(f"{name} = {getattr(self, name)}; it must be above 0")


def stretches(points: Floats, corners: Indices | None = None) -> list[Driven]:
    """The curve that is driven along a polyline.

    Args:
        points: shape (n, 2), mm.
        corners: indices of the true corners; None: those of :func:`corners_of`.
    """
    p = np.asarray(points, float)
    if not np.isfinite(p).all():
        raise InvalidInput("the path has coordinates that are not numbers")
    sharp = np.zeros(len(p), bool)
    sharp[corners_of(p) if corners is None else corners] = True
    kept = np.append(True, lengths(p) > 1e-9)
    p, sharp = p[kept], sharp[kept]
    if len(p) < 2:
        raise InvalidInput("the path has no length")
    sharp[1:-1] |= np.abs(turns(np.diff(p, axis=0))) > FOLD
    return [smooth(p, np.flatnonzero(sharp[1:-1]) + 1)]


def corners_of(points: Floats) -> Indices:
    """Inner vertices of a polyline that cannot be the trace of a curve flattened to CHORD.

    The direction's jump times the shorter neighbour exceeds what such a curve leaves.
    """
    legs = np.diff(np.asarray(points, float), axis=0)
    length = np.hypot(*legs.T)
    turn = turns(legs)
    shorter = np.minimum(length[:-1], length[1:])
    return np.flatnonzero((np.abs(turn) * shorter > 10.0 * CHORD) | (np.abs(turn) > 1.0)) + 1


def timed(path: list[Driven], feed: float, limits: Limits, legs: Floats | None = None) -> tuple[Floats, Floats, Floats]:
    """Positions (n, 2), unit tangents (n, 2) and way (n,), one each millisecond, from rest to rest.

    ``legs``: mm/s of each segment of the polyline, in place of ``feed``; see :mod:`.feeds`.

    Raises:
        InvalidInput: feed not above 0, or above the limit of speed.
    """
    curve, most, limits = _asked(path, feed, limits, legs)
    return _sampled(curve, plan(curve, limits, most))


def at_constant_feed(
    path: list[Driven], feed: float, limits: Limits, legs: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """The same without acceleration, deceleration or care for corners (Wu's uncorrected case)."""
    curve, most, _ = _asked(path, feed, limits, legs)
    ways, speeds = (np.array([curve.length]), np.array([feed])) if most is None else (np.diff(curve.starts), most)
    return _sampled(curve, scurve.steps(ways, speeds))


def _asked(
    path: list[Driven], feed: float, limits: Limits, legs: Floats | None
) -> tuple[Driven, Floats | None, Limits]:
    """The curve, mm/s of each of its spans (None: ``feed`` everywhere), and the limits up to the highest of them."""
    curve = joined(path)
    most = None if legs is None else of_spans(curve, legs)
    highest = feed if most is None else float(most.max())
    if not 0.0 < highest <= limits.speed * (1 + 1e-9):
        raise InvalidInput(f"feed = {highest:g} mm/s is out of range; above 0, at most {limits.speed:g} mm/s")
    return curve, most, replace(limits, speed=highest)


def _sampled(curve: Driven, motion: scurve.Motion) -> tuple[Floats, Floats, Floats]:
    way = motion.at(MILLISECOND * np.arange(np.ceil(motion.duration / MILLISECOND - 1e-9) + 1.0))[0]
    place = curve.at(way)
    return place.xy, place.tangent, way


def plan(curve: Driven, limits: Limits, most: Floats | None = None) -> scurve.Motion:
    """The motion along ``curve`` from rest to rest; ``most``: mm/s of each span, at most."""
    best = _fastest(curve, limits, most)
    while True:
        # A speed that short bends hardly let it reach costs more than it brings.
        limits = replace(limits, speed=0.5 * limits.speed)
        slower = _fastest(curve, limits, most)
        if slower.duration >= best.duration:
            return best
        best = slower


def _fastest(curve: Driven, limits: Limits, most: Floats | None) -> scurve.Motion:
    """The fastest of the motions through different blocks."""
    full = limits.speed if most is None else np.minimum(most, limits.speed)
    changes = np.zeros(0, np.int64) if most is None else np.flatnonzero(np.diff(most)) + 1
    tried: list[scurve.Motion] = []
    for ease in EASE:
        allowed = _along(curve, limits, full, ease)
        found = (_blocks(curve, limits, allowed, changes, steps) for steps in STEPS)
        starts = {starts.tobytes(): starts for starts in found}
        tried += [_through(curve, limits, allowed, each) for each in starts.values()]
        if (allowed[0] >= full).all():
            break
    return min(tried, key=lambda motion: motion.duration)


def corner_speeds(curve: Driven, limits: Limits) -> Floats:
    """mm/s at which the velocity jumps by no more than the corner jump, for each corner."""
    before, after = curve.kinks()
    jump = np.hypot(*(after - before).T)
    return np.minimum(limits.speed, limits.jump / np.maximum(jump, 1e-12))


def _along(curve: Driven, limits: Limits, full: float | Floats, ease: float) -> tuple[Floats, Floats, Floats]:
    """Limits of speed, acceleration and jerk along the path, for each span; slower by ``ease`` where it bends.

    ``full``: mm/s, the speed where it does not bend.
    """
    k, rate = (np.maximum(q, 1e-15) for q in curve.bends())
    a, jerk = limits.acceleration, limits.jerk
    v = np.minimum(full, np.sqrt(ACROSS * a / k))
    v = np.minimum(v, np.minimum(np.cbrt(TWIST[0] * jerk / rate), np.cbrt(TWIST[2] * jerk / k**2)))
    v = np.where(v < full, ease * v, v)
    along = np.minimum(np.sqrt(a**2 - (k * v**2) ** 2), TWIST[1] * jerk / (3.0 * k * v))
    across = rate * v**3 + 3.0 * k * v * along
    return v, along, np.sqrt(jerk**2 - across**2) - k**2 * v**3


def _blocks(
    curve: Driven, limits: Limits, allowed: tuple[Floats, ...], changes: Indices, steps: tuple[float, float]
) -> Indices:
    """First spans of the blocks: where a limit (as a share of the full one) enters another step, at corners, and at
    ``changes`` of the programmed feed."""
    full = limits.speed, limits.acceleration, limits.jerk
    begins = np.zeros(len(curve.first), bool)
    begins[0] = True
    begins[curve.corners] = True
    begins[changes] = True
    for limit, most, ratio in zip(allowed, full, (steps[0], steps[1], steps[1]), strict=True):
        step = np.ceil(np.log(np.maximum(limit / most, 1e-12)) / np.log(ratio) - 1e-9)
        begins[1:] |= step[1:] != step[:-1]
    return np.flatnonzero(begins)


def _through(curve: Driven, limits: Limits, allowed: tuple[Floats, ...], starts: Indices) -> scurve.Motion:
    """The motion through blocks that begin with the spans ``starts``."""
    most, along, twist = (np.minimum.reduceat(limit, starts) for limit in allowed)
    ways = np.diff(np.append(curve.starts[starts], curve.length))
    # The speed at the beginning of each block, and 0 at the end.
    joints = np.append(np.minimum(most, np.insert(most[:-1], 0, 0.0)), 0.0)
    at_corner = np.searchsorted(starts, curve.corners)
    joints[at_corner] = np.minimum(joints[at_corner], corner_speeds(curve, limits))
    joints = _reached(joints, ways, along, twist)
    top = scurve.peak(joints[:-1], joints[1:], most, ways, along, twist)
    return scurve.blocks(joints[:-1], joints[1:], top, ways, along, twist)


def _reached(joints: Floats, ways: Floats, acceleration: Floats, jerk: Floats) -> Floats:
    """``joints`` reduced to what can be braked from and accelerated to."""
    v, way, a, j = (q.tolist() for q in (joints, ways, acceleration, jerk))
    for i in reversed(range(len(way))):
        if v[i] > v[i + 1]:
            v[i] = min(v[i], scurve.reachable(v[i + 1], way[i], a[i], j[i]))
    for i in range(len(way)):
        if v[i + 1] > v[i]:
            v[i + 1] = min(v[i + 1], scurve.reachable(v[i], way[i], a[i], j[i]))
    return np.array(v)
