"""Feed along a path: how fast, when, within limits of speed, acceleration and jerk.

The path is a curve between *corners*, where its direction jumps. Speed is planned over the way s with the acceleration
left beside the centripetal one, ``v ≤ sqrt(a_n/κ)`` in bends and ``v ≤ jump/(2·sin(θ/2))`` in corners, forward and
backward (the classical two passes); smoothing the way over time with a box of ``T = 2a/jerk`` then bounds the jerk.
Corners that would have to be crept through are stopped in.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.interpolate import Akima1DInterpolator, CubicSpline

from ..plant.quantity import InvalidInput
from .curve import CHORD, Indices

Floats = npt.NDArray[np.float64]

STEP = 0.02
"""mm, of the grid on which speeds are planned."""

MILLISECOND = 1e-3
_SHARE = np.sqrt(0.5)
"""Of the acceleration for bends, and for speeding up and slowing down: both together stay within it."""


@dataclass(frozen=True)
class Limits:
    """mm/s, mm/s², mm/s³ along the path; ``jump``: mm/s, of the velocity in a corner."""

    speed: float
    acceleration: float
    jerk: float
    jump: float

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "jerk"):
            if not getattr(self, name) > 0:
                raise InvalidInput(f"{name} = {getattr(self, name)}; it must be above 0")

    @property
    def box(self) -> float:
        """s over which the way is smoothed."""
        return 2.0 * self.acceleration * _SHARE / self.jerk


@dataclass(frozen=True)
class Stretch:
    """A path without corners: position by the way s, mm."""

    way: Floats  # of the grid, from 0 on
    at: Floats  # its parameter
    x: Akima1DInterpolator | CubicSpline
    y: Akima1DInterpolator | CubicSpline

    @property
    def length(self) -> float:
        """mm."""
        return float(self.way[-1])

    def positions(self, s: Floats) -> Floats:
        """Points at the way ``s``, shape (n, 2)."""
        u = np.interp(s, self.way, self.at)
        return np.stack([self.x(u), self.y(u)], axis=1)

    def directions(self, s: Floats) -> Floats:
        """Unit tangents at the way ``s``, shape (n, 2)."""
        u = np.interp(s, self.way, self.at)
        d = np.stack([self.x(u, 1), self.y(u, 1)], axis=1)
        return d / np.maximum(np.hypot(*d.T), 1e-12)[:, None]


def stretches(points: Floats, corners: Indices | None = None) -> list[Stretch]:
    """A polyline cut at its corners; between them a smooth curve through its vertices.

    Where there are straight lines too, they stay straight (Akima 1970).

    Args:
        points: shape (n, 2), mm.
        corners: indices of the true corners; None: those of :func:`corners_of`.
    """
    p = np.asarray(points, float)
    if not np.isfinite(p).all():
        raise InvalidInput("the path has coordinates that are not numbers")
    sharp = np.zeros(len(p), bool)
    sharp[corners_of(p) if corners is None else corners] = True
    kept = np.append(True, np.hypot(*np.diff(p, axis=0).T) > 1e-9)
    p, sharp = p[kept], sharp[kept]
    if len(p) < 2:
        raise InvalidInput("the path has no length")
    sharp[0] = sharp[-1] = True
    cuts = np.flatnonzero(sharp)
    return [_stretch(p[a : b + 1]) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]


def corners_of(points: Floats) -> Indices:
    """Inner vertices of a polyline that cannot be the trace of a curve flattened to CHORD.

    The direction's jump times the shorter neighbour exceeds what such a curve leaves.
    """
    legs = np.diff(np.asarray(points, float), axis=0)
    length = np.hypot(*legs.T)
    turn = turns(legs)
    shorter = np.minimum(length[:-1], length[1:])
    return np.flatnonzero((np.abs(turn) * shorter > 10.0 * CHORD) | (np.abs(turn) > 1.0)) + 1


def turns(legs: Floats) -> Floats:
    """Change of direction from leg to leg, rad, left positive."""
    a, b = legs[:-1], legs[1:]
    return np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))


def _stretch(p: Floats) -> Stretch:
    length = np.hypot(*np.diff(p, axis=0).T)
    # Long legs get points near their ends, so that the interpolation knows that they are straight.
    near = np.minimum(0.2 * length, 0.5)
    shares = (near, 2 * near, length - 2 * near, length - near)
    inner = [p[:-1] + np.diff(p, axis=0) * (share / length)[:, None] for share in shares]
    straight = length > 8.0 * np.median(length) if len(length) > 2 else np.ones(len(length), bool)
    rows = [p[:1]]
    for i in range(len(length)):
        if straight[i]:
            rows.append(np.array([points[i] for points in inner]))
        rows.append(p[i + 1 : i + 2])
    q = np.concatenate(rows)
    u = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(q, axis=0).T))])
    if straight.any():
        x, y = (Akima1DInterpolator(u, q[:, k], method="makima") for k in (0, 1))
    else:
        x, y = (CubicSpline(u, q[:, k]) for k in (0, 1))
    count = max(4, int(np.ceil(u[-1] / STEP)))
    at = np.linspace(0.0, u[-1], count + 1)
    points = np.stack([x(at), y(at)], axis=1)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    return Stretch(way, at, x, y)


def timed(path: list[Stretch], feed: float, limits: Limits) -> tuple[Floats, Floats, Floats]:
    """Positions (n, 2), unit tangents (n, 2) and way (n,), one each millisecond, from rest to rest.

    Raises:
        InvalidInput: feed not above 0, or above the limit of speed.
    """
    check_feed(feed, limits)
    ends = [(s.directions(np.array([0.0]))[0], s.directions(np.array([s.length]))[0]) for s in path]
    joints = []
    for (_, out), (into, _) in zip(ends[:-1], ends[1:], strict=True):
        bend = abs(turns(np.stack([out, into]))[0])
        joints.append(limits.jump / max(2.0 * np.sin(0.5 * bend), 1e-9))
    kick = 0.25 * limits.acceleration * _SHARE * limits.box  # what smoothing adds to the lowest speed in a corner
    speeds = [0.0 if v < kick else min(v, feed) - kick for v in joints]
    speeds = [0.0 if v < kick else v for v in speeds]
    # From stop to stop.
    begin, run, out = 0, [], []
    for i in range(len(path)):
        if i == len(path) - 1 or speeds[i] == 0.0:
            run.append((path[begin : i + 1], speeds[begin:i]))
            begin = i + 1
    offset = 0.0
    for part, inner in run:
        whole = _way(part, inner, feed, limits)
        out.append(_placed(part, whole, offset))
        offset += sum(s.length for s in part)
    return _chained([o[0] for o in out]), _chained([o[1] for o in out]), _chained([o[2] for o in out])


def _chained(pieces: list[Floats]) -> Floats:
    """One after the other; each begins where the one before ends."""
    return np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])


def at_constant_feed(path: list[Stretch], feed: float, limits: Limits) -> tuple[Floats, Floats, Floats]:
    """The same without acceleration, deceleration or care for corners (Wu's uncorrected case)."""
    check_feed(feed, limits)
    total = sum(s.length for s in path)
    way = np.append(np.arange(0.0, total, feed * MILLISECOND), total)
    return _placed(path, way, 0.0)


def check_feed(feed: float, limits: Limits) -> None:
    """Raises :class:`InvalidInput` for a feed that is not above 0 or beyond the limit, mm/s."""
    if not 0.0 < feed <= limits.speed * (1 + 1e-9):
        raise InvalidInput(f"feed = {feed:g} mm/s is out of range; above 0, at most {limits.speed:g} mm/s")


def _placed(path: list[Stretch], way: Floats, offset: float) -> tuple[Floats, Floats, Floats]:
    borders = np.concatenate([[0.0], np.cumsum([s.length for s in path])])
    which = np.clip(np.searchsorted(borders, way, side="right") - 1, 0, len(path) - 1)
    positions, tangents = np.empty((len(way), 2)), np.empty((len(way), 2))
    for i, stretch in enumerate(path):
        mine = which == i
        local = np.clip(way[mine] - borders[i], 0.0, stretch.length)
        positions[mine], tangents[mine] = stretch.positions(local), stretch.directions(local)
    return positions, tangents, way + offset


def _way(path: list[Stretch], corner_speeds: list[float], feed: float, limits: Limits) -> Floats:
    """The way at each millisecond from rest to rest."""
    a = limits.acceleration * _SHARE
    grid, most = [], []
    offset = 0.0
    for i, stretch in enumerate(path):
        s = stretch.way
        between = np.abs(turns(stretch.directions(s))) / np.maximum(np.diff(s), 1e-9)
        curvature = np.maximum(np.append(between, between[-1]), np.append(between[0], between))
        speed = np.minimum(feed, np.sqrt(a / np.maximum(curvature, 1e-9)))
        reach = int(np.ceil(0.5 * feed * limits.box / STEP))
        if reach and curvature.max() > 1e-6:
            speed = ndimage.minimum_filter1d(speed, 2 * reach + 1, mode="nearest")
        if i > 0:
            speed[0] = min(speed[0], corner_speeds[i - 1])
        if i < len(path) - 1:
            speed[-1] = min(speed[-1], corner_speeds[i])
        grid.append(s + offset if i == 0 else s[1:] + offset)
        most.append(speed if i == 0 else speed[1:])
        if i > 0:
            most[i - 1][-1] = min(most[i - 1][-1], speed[0])
        offset += stretch.length
    s, v2 = np.concatenate(grid), np.concatenate(most) ** 2
    v2[0] = v2[-1] = 0.0
    ds = np.diff(s)
    v2 = _passed(v2, ds, a)
    v2 = _passed(v2[::-1], ds[::-1], a)[::-1]
    v = np.sqrt(v2)
    t = np.concatenate([[0.0], np.cumsum(2.0 * ds / np.maximum(v[:-1] + v[1:], 1e-9))])
    clock = np.arange(0.0, t[-1] + MILLISECOND, MILLISECOND)
    # Between grid points the speed squared is linear in s: constant acceleration.
    k = np.clip(np.searchsorted(t, clock, side="right") - 1, 0, len(ds) - 1)
    tau, acceleration = clock - t[k], (v2[k + 1] - v2[k]) / (2.0 * np.maximum(ds[k], 1e-12))
    way = np.minimum(s[k] + v[k] * tau + 0.5 * acceleration * tau * tau, s[-1])
    way = np.maximum.accumulate(np.where(clock >= t[-1], s[-1], way))
    box = max(1, round(limits.box / MILLISECOND))
    padded = np.concatenate([np.zeros(box), way, np.full(box, s[-1])])
    summed = np.concatenate([[0.0], np.cumsum(padded)])
    return np.maximum.accumulate(np.append((summed[box:] - summed[:-box]) / box, s[-1]))


def _passed(v2: Floats, ds: Floats, a: float) -> Floats:
    """Speeds squared, lowered where they would rise faster than ``a`` allows: the running minimum of v² − 2as."""
    s = np.concatenate([[0.0], np.cumsum(ds)])
    return np.minimum.accumulate(v2 - 2.0 * a * s) + 2.0 * a * s
