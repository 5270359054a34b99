"""Lead-ins: each closed contour is pierced in the scrap beside it and entered from there.

The scrap of an outline is outside, that of a hole inside. What is tried, until there is room (:mod:`.room`):

1. straight into where the drawing begins, as long as asked for, then shorter;
2. there a quarter circle, which meets the contour at a tangent;
3. the same at other starts: outer corners, the middles of long edges, points all around;
4. all of this with the pierce point nearer to an edge, but never with its hole in one;
5. in a small hole from where it is widest;
6. pierced on the contour, with a warning that names it.

Open contours have no scrap; they are pierced where they begin. Beside a joint (:mod:`.joints`) no way leads over what
is left of the contour behind the start.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import geos as shapely
from .curve import CHORD, Floats, Indices, Points, arc, lengths
from .room import Room
from .starts import (
    ACROSS,
    BEHIND_JOINTS,
    ELSEWHERE,
    LEAST_ANGLE,
    POINTS,
    STRAIGHT,
    Starts,
    arcs,
    as_given,
    begun,
    onto,
    others,
    straight,
    together,
)

HOW = ("none", "drawn", "shorter", "arc", "elsewhere", "on the contour")
"""Ways in which a contour is begun: without lead-in because none is wanted; where the drawing begins, at full length,
shorter or on an arc; from another start; pierced on the contour because there is no room."""

PIERCE = 3.0
"""Pierce points keep this many half kerfs from every edge, where there is room: a pierce leaves a hole about twice as
wide as the kerf. [A] Where there is none they keep one."""

SHORTEST = 0.02
"""mm, of a lead-in, however narrow the kerf."""

SPREAD, DENSE = (16, 6), (96, 24)
"""Other starts that are tried: points spread over the contour, and most corners; the second if the first do not do."""

STARTS = 20_000
"""Other starts that are tried of all contours together, where that leaves each the first of :data:`LEAST_STARTS`; who
draws thousands of contours that have no room does not wait for minutes."""

LEAST_STARTS = (6, 2)
"""Other starts of a contour that are tried however many contours there are."""

BLOCK = 128
"""Contours that are weighed at a time: all at once would fill the memory."""


@dataclass(frozen=True)
class Lead:
    """How a contour is begun.

    ``way``: shape (n, 2), mm, from the pierce point to the contour, a single point if it is pierced on it; ``piece``
    and ``corners``: the contour from there on, as a drawing has them; ``how``: one of :data:`HOW`.
    """

    way: Points
    piece: Points
    corners: Indices
    how: str


def leads(
    pieces: list[Points], corners: list[Indices], room: Room, length: float, joined: npt.NDArray[np.bool_]
) -> list[Lead]:
    """A lead-in for each contour.

    Args:
        pieces: arrays of shape (n, 2), mm; those that enclose nothing get none.
        corners: of the pieces, see :class:`.drawing.Drawing`.
        room: around these pieces.
        length: mm, at most; 0: no lead-ins.
        joined: for each piece whether there is a joint behind its start.
    """
    found = [Lead(p[:1], p, c, "none") for p, c in zip(pieces, corners, strict=True)]
    wanted = np.flatnonzero(room.nesting.area) if length > 0 else np.zeros(0, np.int64)
    if not len(wanted):
        return found
    search = _Search(pieces, corners, room, length, joined)
    stages = (
        search.first,
        lambda left: search.as_drawn(left, search.keep),
        lambda left: search.elsewhere(left, SPREAD, search.keep),
        lambda left: search.as_drawn(left, search.nearer),
        lambda left: search.elsewhere(left, DENSE, search.nearer),
        search.from_the_middle,
    )
    left = wanted
    for number, stage in enumerate(stages):
        if not len(left) or (number > 1 and not room.worth_asking):
            break
        for own, lead in stage(left).items():
            found[own] = lead
        left = np.array([i for i in left if found[i].how == "none"], np.int64)
    for i in left:
        found[i] = Lead(pieces[i][:1], pieces[i], corners[i], "on the contour")
    return found


def restarts(pieces: list[Points], room: Room, length: float, starts: list[tuple[int, Points]]) -> list[Points]:
    """Ways into contours behind joints, a single point where there is no room.

    Args:
        pieces: all contours.
        room: around them.
        length: mm, at most; 0: no lead-ins.
        starts: each a contour and the point on it, mm.
    """
    found = [point[None] for _, point in starts]
    if length > 0 and starts:
        search = _Search(pieces, [np.zeros(0, np.int64)] * len(pieces), room, length, np.ones(len(pieces), bool))
        for first in range(0, len(starts), BLOCK):
            some = starts[first : first + BLOCK]
            own, at = np.array([i for i, _ in some]), np.array([point for _, point in some])
            for k, lead in search.behind_joints(own, at).items():
                found[first + k] = lead.way
    return found


class _Search:
    """Starts and ways that are weighed against the room there is."""

    def __init__(
        self, pieces: list[Points], corners: list[Indices], room: Room, length: float, joined: npt.NDArray[np.bool_]
    ) -> None:
        self.pieces, self.corners, self.room = pieces, corners, room
        self.behind = LEAST_ANGLE + (ACROSS - LEAST_ANGLE) * joined.astype(np.float64)
        nesting = room.nesting
        area, around = np.abs(nesting.area), np.array([lengths(p).sum() for p in pieces])
        self.side = np.sign(nesting.area) * np.where(nesting.hole, 1.0, -1.0)
        # Of a circle 0.7 radii: up to there a hole is still wide.
        self.most = np.where(nesting.hole, np.minimum(length, 0.7 * area / (0.5 * around)), length)
        # Of a long slot 0.6 of half its width, of a circle 0.3 of its radius.
        narrow = np.clip(0.6 * area / around, room.half, PIERCE * room.half)
        self.keep = np.where(nesting.hole, narrow, PIERCE * room.half)
        self.nearer = np.full(len(pieces), room.half)
        self.least = max(room.half, SHORTEST)  # mm, of a way

    def first(self, left: Indices) -> dict[int, Lead]:
        """The first way of all contours alone, which mostly does: at a right angle, as long as asked for."""
        starts = as_given(left, self.pieces, self.side[left])
        ways = straight(starts, starts.normal, self.most[left])
        good = np.flatnonzero(self.room.clear(left, ways, self.keep[left]))
        return {int(left[k]): self._lead(starts, int(k), ways[k, [0, -1]], "drawn") for k in good}

    def as_drawn(self, left: Indices, keep: Floats) -> dict[int, Lead]:
        """Where the drawing begins the contours; ``keep``: mm from the pierce points to every edge."""
        return self._best(as_given(left, self.pieces, self.side[left]), STRAIGHT, keep)

    def from_the_middle(self, left: Indices) -> dict[int, Lead]:
        """From the middle of the largest circle within a hole to where it touches."""
        found: dict[int, Lead] = {}
        for i in left[self.room.nesting.hole[left]].tolist():
            ring = self.pieces[i]
            outline = shapely.polygons(ring)
            if not outline.is_valid or not self.room.worth_asking:
                continue
            spoke = shapely.get_coordinates(shapely.maximum_inscribed_circle(outline, 1e-3 * self.room.half or 1e-4))
            start = onto(i, ring, self.side[i], spoke[1])
            way = np.linspace(spoke[0], start.at[0], POINTS)
            if self.room.clear(start.own, way[None], np.array([self.room.half]))[0]:
                found[i] = self._lead(start, 0, way[[0, -1]], "elsewhere")
        return found

    def behind_joints(self, own: Indices, at: Points) -> dict[int, Lead]:
        """At starts on contours, each for itself."""
        starts = together([onto(int(i), self.pieces[i], self.side[i], p) for i, p in zip(own, at, strict=True)])
        every = np.arange(len(own))
        found = self._best(starts, BEHIND_JOINTS, self.keep, "drawn", every)
        left = np.array([k for k in every if k not in found], np.int64)
        return found | self._best(starts.some(left), BEHIND_JOINTS, self.nearer, "drawn", left)

    def elsewhere(self, left: Indices, many: tuple[int, int], keep: Floats) -> dict[int, Lead]:
        """From other starts, ``many`` of them if there are not too many contours."""
        found: dict[int, Lead] = {}
        share = STARTS / (len(left) * (many[0] + 2 * many[1])) if len(left) else 1.0
        spread, corners = (
            max(min(n, least), int(n * min(share, 1.0))) for n, least in zip(many, LEAST_STARTS, strict=True)
        )
        for at in range(0, len(left), BLOCK):
            if not self.room.worth_asking:
                break
            block = left[at : at + BLOCK].tolist()
            starts = together([others(i, self.pieces[i], self.side[i], spread, corners) for i in block])
            found |= self._best(starts, ELSEWHERE, keep, "elsewhere")
        return found

    def _best(
        self, starts: Starts, angles: tuple[float | None, ...], keep: Floats, how: str = "", key: Indices | None = None
    ) -> dict[int, Lead]:
        """The first clear way into each contour, start by start; or, with a ``key`` of each start, for each key."""
        if not len(starts):
            return {}
        key = starts.own if key is None else key
        own, most = starts.own, self.most[starts.own]
        tried: list[tuple[Floats, Floats]] = []  # ways, and radii of arcs or 0
        fits: list[npt.NDArray[np.bool_]] = []
        for angle in angles:
            towards, wide = starts.towards(angle, self.behind[own])
            length = self._length(starts, towards, most)
            tried.append((straight(starts, towards, length), np.zeros(len(own))))
            fits.append(wide & (length >= self.least))
        radius = self._length(starts, starts.normal, 0.5 * most)
        tried.append((arcs(starts, radius), radius))
        fits.append((radius >= self.least) & (self.behind[own] < ACROSS))
        ways, radii = (np.stack(q, axis=1) for q in zip(*tried, strict=True))  # by start, then by way
        which = np.flatnonzero(np.stack(fits, axis=1).ravel())
        flat, start = ways.reshape(-1, *ways.shape[2:]), which // len(tried)
        good = which[self.room.clear(own[start], flat[which], keep[own[start]])]
        found: dict[int, Lead] = {}
        for k in good.tolist():
            at, r = k // len(tried), radii.ravel()[k]
            if int(key[at]) in found:
                continue
            way = self._arc(starts, at, r, flat[k]) if r else flat[k][[0, -1]]
            full = np.hypot(*(way[0] - way[-1])) > 0.999 * most[at]
            found[int(key[at])] = self._lead(starts, at, way, how or ("arc" if r else "drawn" if full else "shorter"))
        return found

    def _length(self, starts: Starts, towards: Points, most: Floats) -> Floats:
        """mm: as far as wanted, or half as far as the next contour."""
        there = self.room.reach(starts.at, towards * (most + self.keep[starts.own])[:, None])
        return np.minimum(most, 0.5 * there)

    def _arc(self, starts: Starts, at: int, radius: float, way: Points) -> Points:
        """An arc in as many chords as a drawing's."""
        centre, begin, end = (complex(*p) for p in (starts.at[at] + radius * starts.normal[at], way[0], way[-1]))
        return arc(centre, begin, end, float(starts.side[at]) * np.pi / 2, CHORD).points

    def _lead(self, starts: Starts, at: int, way: Points, how: str) -> Lead:
        own = int(starts.own[at])
        piece, corners = begun(self.pieces[own], self.corners[own], int(starts.leg[at]), starts.at[at])
        way = way.copy()
        way[-1] = piece[0]
        return Lead(way, piece, corners, how)
