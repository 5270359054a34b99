"""Where there is room for a way into a contour: not in a part, not along an edge, not near a neighbour."""

from typing import Any

import numpy as np
import numpy.typing as npt

from . import geos as shapely
from .curve import Floats, Indices, Points
from .nesting import Nesting
from .pieces import short_runs

LEAVES = 0.15
"""Half way a lead-in is at least this share of its length away from its contour: one along the edge is not."""

TOUCH = (0.01, 0.05, 0.2)
"""mm from the start within which a lead-in may touch its contour: the second as a share of its length, between the
others. An arc that meets chords at a tangent crosses them there by micrometres."""

MOST_WORK = 8_000_000
"""Questions of one point and one outline after which no more room is looked for: who draws thousands of contours on top
of each other does not wait for minutes. It is a number and not a time, so that every computer finds the same room."""

OF_A_WAY = 16
"""Such questions that one of a way and a run of a contour is worth."""


class Room:
    """The contours of a drawing, to be asked for what is free.

    Args:
        pieces: arrays of shape (n, 2), mm.
        nesting: of these pieces.
        kerf: mm, width of what the beam takes away.
        most: work that may be spent.
    """

    def __init__(self, pieces: list[Points], nesting: Nesting, kerf: float, most: int = MOST_WORK) -> None:
        self.nesting, self.half = nesting, 0.5 * kerf
        self.runs, self.owners = short_runs(pieces)
        self.tree = shapely.STRtree(self.runs)
        self.solid: Indices = np.flatnonzero(nesting.area)
        self.outlines = np.array([shapely.polygons(pieces[i]) for i in self.solid], object)
        shapely.prepare(self.outlines)
        self.boxes = shapely.STRtree(self.outlines) if len(self.solid) else None
        self.work, self.most = 0, most

    @property
    def worth_asking(self) -> bool:
        """Whether less work has been spent than may be."""
        return self.work < self.most

    def _near(self, what: Any, predicate: str, distance: Any = None) -> tuple[Indices, Indices]:
        """Which of ``what`` meets which run."""
        found = self.tree.query(what, predicate=predicate, distance=distance)
        self.work += OF_A_WAY * (found.shape[1] + len(what))
        return found[0], found[1]

    def reach(self, starts: Points, ways: Points) -> Floats:
        """mm from each start along each way to the next contour; no farther than the way goes (inf).

        Args:
            starts: shape (n, 2), mm, on a contour, which does not count there.
            ways: shape (n, 2), mm.
        """
        size = np.hypot(*ways.T)
        begin = starts + ways * (np.minimum(TOUCH[0], 0.1 * size) / np.maximum(size, 1e-12))[:, None]
        rays = shapely.linestrings(np.stack([begin, starts + ways], axis=1))
        ray, run = self._near(rays, "intersects")
        found = np.full(len(starts), np.inf)
        hits = shapely.intersection(rays[ray], self.runs[run])
        np.minimum.at(found, ray, shapely.distance(shapely.points(starts[ray]), hits))
        return found

    def clear(self, own: Indices, ways: Floats, least: Floats) -> npt.NDArray[np.bool_]:
        """Whether lead-ins are clear of everything.

        That is: the pierce point lies in the scrap beside its contour, ``least`` mm from every contour; the way from
        there touches its own contour in its end only, and leaves it; every other contour stays half a kerf away.

        Args:
            own: the contour of each.
            ways: shape (n, k, 2), from the pierce point to the contour, k odd.
            least: shape (n,), mm.
        """
        if not len(own):
            return np.zeros(0, bool)
        good = np.ones(len(own), bool)
        length = np.hypot(*np.moveaxis(np.diff(ways, axis=1), -1, 0)).sum(axis=1)
        pierced, lines = shapely.points(ways[:, 0]), shapely.linestrings(ways)
        good[self._near(pierced, "dwithin", least)[0]] = False
        if self.half > 0:
            near, run = self._near(lines, "dwithin", self.half)
            good[near[self.owners[run] != own[near]]] = False
        away = np.minimum(max(self.half, TOUCH[0]), LEAVES * length)
        outer = shapely.linestrings(ways[:, : ways.shape[1] // 2 + 1])
        good[self._near(outer, "dwithin", away)[0]] = False
        good[good] = self._touches_in_its_end(own[good], ways[good], lines[good], length[good])
        good[good] = self._in_scrap(own[good], ways[good, 0])
        return good

    def _touches_in_its_end(self, own: Indices, ways: Floats, lines: Any, length: Floats) -> npt.NDArray[np.bool_]:
        good = np.ones(len(own), bool)
        which, run = self._near(lines, "intersects")
        good[which[self.owners[run] != own[which]]] = False
        hits = shapely.intersection(lines[which], self.runs[run])
        at, index = shapely.get_coordinates(hits, return_index=True)
        far = np.hypot(*(at - ways[which[index], -1]).T)
        good[which[index][far > np.clip(TOUCH[1] * length[which[index]], TOUCH[0], TOUCH[2])]] = False
        return good

    def _in_scrap(self, own: Indices, points: Points) -> npt.NDArray[np.bool_]:
        """Whether each point lies on the scrap side of its contour: outside an outline, within a hole, and otherwise
        within what the contour lies within."""
        if self.boxes is None:
            return np.ones(len(own), bool)
        which, outline = self.boxes.query(shapely.points(points))
        self.work += len(which)
        within = shapely.contains_xy(self.outlines[outline], points[which])
        which, outline = which[within], self.solid[outline[within]]
        mine = np.zeros(len(own), bool)
        mine[which[outline == own[which]]] = True
        others = np.bincount(which, minlength=len(own)) - mine
        return (mine == self.nesting.hole[own]) & (others == self.nesting.depth[own])
