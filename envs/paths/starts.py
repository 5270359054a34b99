"""Where a contour may begin, and the ways into it that are tried there.

At a start the scrap is a wedge between the contour ahead and the contour behind. Ways are tried in the order of
:data:`STRAIGHT` and :data:`ELSEWHERE`, each as long as asked for or, where another contour is near, half as long as up
to there: the pierce point then lies in the middle of the gap.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .curve import EXACT, Floats, Indices, Points
from .profile import corners_of

POINTS = 9
"""Of a way while it is weighed."""

LEAST_ANGLE = float(np.radians(25.0))
"""rad between a straight way and the contour, ahead and behind. [A]"""

NOTCH = np.radians(120.0)
"""rad; starts in a narrower wedge of scrap are passed over. [A]"""

CORNER = np.radians(200.0)
"""rad; a wider wedge of scrap is an outer corner, which hides the mark of a start best. [A]"""

STRAIGHT = (np.pi / 2, None, np.pi, 3 * np.pi / 4)
"""rad from the contour ahead, of the ways that are tried where the drawing begins: at a right angle, halfway between
ahead and behind (None), straight on into the contour, slanting."""

ELSEWHERE = (np.pi, 3 * np.pi / 4, np.pi / 2, None)
"""The same at other starts."""

BEHIND_JOINTS = (np.pi / 2, np.pi / 3, np.pi / 4)
"""The same behind a joint."""

ACROSS = float(np.radians(85.0))
"""rad that a way keeps from the contour behind where there is a joint: it would cut the joint off. [A]"""


@dataclass(frozen=True)
class Starts:
    """Points on contours at which they may begin; arrays of equal length.

    ``own``: the contour; ``leg``: its segment that comes next; ``at``: mm; ``ahead``: unit vector; ``side``: 1 if the
    scrap is on the left of it, else −1; ``wedge``: rad of scrap from ahead to behind.
    """

    own: Indices
    leg: Indices
    at: Points
    ahead: Points
    side: Floats
    wedge: Floats

    def __len__(self) -> int:
        return len(self.own)

    def some(self, which: npt.NDArray) -> "Starts":
        """Those of a mask or of indices."""
        return Starts(*(getattr(self, name)[which] for name in self.__dataclass_fields__))

    def towards(self, angle: float | None, behind: Floats) -> tuple[Points, npt.NDArray[np.bool_]]:
        """Unit vectors into the scrap, ``angle`` rad from ahead or (None) halfway, and whether the edge ahead is
        :data:`LEAST_ANGLE` from it and that behind ``behind`` rad."""
        theta = np.full(len(self), angle) if angle is not None else 0.5 * self.wedge
        turn = self.side * theta
        x, y = self.ahead.T
        rotated = np.stack([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)], axis=1)
        return rotated, (theta >= LEAST_ANGLE) & (self.wedge - theta >= behind)

    @property
    def normal(self) -> Points:
        """Unit vectors into the scrap, at a right angle to the contour ahead."""
        x, y = self.ahead.T
        return np.stack([-y, x], axis=1) * self.side[:, None]


def together(parts: list[Starts]) -> Starts:
    """One after the other."""
    return Starts(*(np.concatenate([getattr(p, name) for p in parts]) for name in Starts.__dataclass_fields__))


def as_given(own: Indices, pieces: list[Points], side: Floats) -> Starts:
    """Where the drawing begins the contours ``own``."""
    first = np.array([pieces[i][0] for i in own]).reshape(-1, 2)
    legs = np.array([[pieces[i][1] - pieces[i][0], pieces[i][-2] - pieces[i][-1]] for i in own]).reshape(-1, 2, 2)
    ahead = legs[:, 0] / np.hypot(*legs[:, 0].T)[:, None]
    return Starts(own, np.zeros(len(own), np.int64), first, ahead, side, _wedge(ahead, legs[:, 1], side))


def others(own: int, piece: Points, side: float, count: int, corners: int) -> Starts:
    """Other starts of a contour: its outer corners with the longest edges, the middles of its longest edges, and
    points evenly spread over it; none in a notch.

    Args:
        own: the contour.
        piece: its points, closed.
        side: see :class:`Starts`.
        count: of the points that are spread.
        corners: most corners, and most middles.
    """
    legs = np.diff(piece, axis=0)
    length = np.hypot(*legs.T)
    ahead = legs / length[:, None]
    wedge = _wedge(ahead, -np.roll(legs, 1, axis=0), np.full(len(legs), side))
    room = np.minimum(length, np.roll(length, 1))
    outer = np.flatnonzero(wedge > CORNER)
    outer = outer[np.argsort(-room[outer], kind="stable")][:corners]
    long = np.argsort(-length, kind="stable")[:corners]
    way = np.append(0.0, np.cumsum(length))
    spread = (np.arange(count) + 0.5) * way[-1] / count
    on = np.clip(np.searchsorted(way, spread, side="right") - 1, 0, len(legs) - 1)
    leg = np.concatenate([outer, long, on])
    along = np.concatenate([np.zeros(len(outer)), 0.5 * length[long], spread - way[on]])
    at = piece[leg] + ahead[leg] * along[:, None]
    open_ = np.concatenate([wedge[outer], np.full(len(long) + len(on), np.pi)])
    found = Starts(np.full(len(leg), own), leg, at, ahead[leg], np.full(len(leg), side), open_)
    return found.some(found.wedge > NOTCH)


def onto(own: int, piece: Points, side: float, at: Points) -> Starts:
    """A start where the contour passes ``at``."""
    legs = np.diff(piece, axis=0)
    along = np.clip(((at - piece[:-1]) * legs).sum(axis=1) / (legs**2).sum(axis=1), 0.0, 1.0)
    leg = int(np.hypot(*(piece[:-1] + legs * along[:, None] - at).T).argmin())
    ahead = legs[leg] / np.hypot(*legs[leg])
    return Starts(np.array([own]), np.array([leg]), at[None], ahead[None], np.array([side]), np.array([np.pi]))


def _wedge(ahead: Points, behind: Points, side: Floats) -> Floats:
    turn = np.arctan2(behind[:, 1], behind[:, 0]) - np.arctan2(ahead[:, 1], ahead[:, 0])
    return np.mod(side * turn, 2.0 * np.pi)


def straight(starts: Starts, towards: Points, length: Floats) -> Floats:
    """Ways straight into the contours, shape (n, POINTS, 2), the pierce point first."""
    back = np.linspace(1.0, 0.0, POINTS)[None, :, None]
    return starts.at[:, None] + towards[:, None] * (length[:, None, None] * back)


def arcs(starts: Starts, radius: Floats) -> Floats:
    """Quarter circles that meet the contours at a tangent, shape (n, POINTS, 2), the pierce point first."""
    angle = np.linspace(np.pi / 2, 0.0, POINTS)[None, :, None]
    r = radius[:, None, None]
    aside, along = starts.normal[:, None], starts.ahead[:, None]
    return starts.at[:, None] + r * (aside * (1.0 - np.cos(angle)) - along * np.sin(angle))


def begun(piece: Points, corners: Indices, leg: int, at: Points) -> tuple[Points, Indices]:
    """A closed contour from the point ``at`` of its segment ``leg`` on, and its corners there."""
    new = np.hypot(*(at - piece[leg])) > EXACT
    if leg == 0 and not new:
        return piece, corners
    points, sharp = piece[:-1], np.zeros(len(piece) - 1, bool)
    sharp[corners] = True
    sharp[0] |= len(corners_of(piece[[-2, 0, 1]])) > 0
    if new:
        leg += 1
        points, sharp = np.insert(points, leg, at, axis=0), np.insert(sharp, leg, False)
    points, sharp = np.roll(points, -leg, axis=0), np.roll(sharp, -leg)
    return np.concatenate([points, points[:1]]), np.flatnonzero(sharp)
