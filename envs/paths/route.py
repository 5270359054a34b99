"""The route through a drawing: what is cut in which order, where it is pierced, how it is entered, what stays uncut.

A route is what a CAM system hands to a machine; :mod:`.job` drives it. Programmes are cut as they were programmed:
nothing is added to them, moved or left out.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..engine.quantity import InvalidInput
from .curve import Indices, Points, lengths
from .drawing import Drawing
from .joints import away_from_corners, joints, runs
from .leads import leads, restarts
from .naming import named
from .nesting import Nesting, nested
from .room import MOST_WORK, Room

REPEAT = 1e-9
"""mm, from which on two points are two."""


@dataclass(frozen=True)
class Cutting:
    """How a drawing is cut.

    ``lead_in``: mm, at most, from the scrap into a closed contour; 0: none. ``kerf``: mm, width of what the beam takes
    away, from which lead-ins keep clear. ``joints``: micro-joints in each outline; ``joint_spacing``: mm between them
    instead, 0: their number decides; ``joint_width``: mm of sheet that a joint leaves.
    """

    lead_in: float = 3.0
    kerf: float = 0.25
    joints: int = 0
    joint_spacing: float = 0.0
    joint_width: float = 0.5

    def __post_init__(self) -> None:
        for name in ("lead_in", "kerf", "joints", "joint_spacing"):
            if not getattr(self, name) >= 0:
                raise InvalidInput(f"{name} = {getattr(self, name):g}; it must be 0 or more")
        if not self.joint_width > 0:
            raise InvalidInput(f"joint_width = {self.joint_width:g} mm; it must be above 0")


@dataclass(frozen=True)
class Cut:
    """One cut: ``way`` from the pierce point to the first point of ``path``, a single point if it is pierced there.

    ``contour``: its index in the drawing; ``corners``: of the path; ``how``: one of :data:`.leads.HOW`; ``feed``: mm/s
    as programmed, nan: the machine decides.
    """

    contour: int
    way: Points
    path: Points
    corners: Indices
    how: str
    feed: float = np.nan


@dataclass(frozen=True, eq=False)
class Route:
    """The route through ``drawing``: its cuts in order.

    ``joints``: what stays uncut, polylines of shape (n, 2), mm, each a joint and half a kerf on either side;
    ``warnings``: sentences that name contours.
    """

    drawing: Drawing
    cutting: Cutting
    cuts: list[Cut]
    joints: list[Points] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @cached_property
    def nesting(self) -> Nesting:
        """Of the drawing's contours."""
        return nested(self.drawing.pieces, self.drawing.closed)

    @property
    def cut_length(self) -> float:
        """mm with the beam on, lead-ins included."""
        return float(sum(lengths(p).sum() for cut in self.cuts for p in (cut.way, cut.path)))

    @property
    def move_length(self) -> float:
        """mm from the end of each cut to the next pierce point."""
        ends, starts = np.array([c.path[-1] for c in self.cuts]), np.array([c.way[0] for c in self.cuts])
        return float(np.hypot(*(starts[1:] - ends[:-1]).T).sum())


def routed(drawing: Drawing, cutting: Cutting) -> Route:
    """The route through a drawing, whose contours are in cutting order.

    Raises:
        InvalidInput: joints in a programme.
    """
    if drawing.programmed:
        return _as_programmed(drawing, cutting)
    drawing, warnings = _without_repeats(drawing), []
    pieces = drawing.pieces
    nesting = nested(pieces, drawing.closed)
    # Where thousands of contours lie on top of each other hardly anything is a part.
    room = Room(pieces, nesting, cutting.kerf, MOST_WORK // 4 if drawing.meetings.cut_short else MOST_WORK)
    gap = cutting.joint_width + cutting.kerf
    count = np.zeros(len(pieces), np.int64)
    if cutting.joints or cutting.joint_spacing:
        outlines = np.flatnonzero((nesting.area != 0) & ~nesting.hole)
        for k in outlines.tolist():
            length = float(lengths(pieces[k]).sum())
            count[k] = joints(length, cutting.joints, cutting.joint_spacing, gap)
        few = [k for k in outlines.tolist() if count[k] < max(cutting.joints, 1)]
        wanted = cutting.joints or "its"
        warnings += named(drawing, few, f"is too short for {wanted} joints of {gap:.3g} mm with their kerf")
    begun = [
        away_from_corners(p, c, gap) if n else (p, c)
        for p, c, n in zip(pieces, drawing.corners, count.tolist(), strict=True)
    ]
    pieces, corners = [p for p, _ in begun], [c for _, c in begun]
    found = leads(pieces, corners, room, cutting.lead_in, count > 0)
    cuts: list[Cut] = []
    uncut: list[Points] = []
    parted = {i: runs(found[i].piece, found[i].corners, int(count[i]), gap) for i in np.flatnonzero(count).tolist()}
    later = [(i, run.points[0]) for i, parts in parted.items() for run in parts[1:]]
    ways = iter(restarts(pieces, room, cutting.lead_in, later))
    for i, lead in enumerate(found):
        if i not in parted:
            cuts.append(Cut(i, lead.way, lead.piece, lead.corners, lead.how))
            continue
        parts = parted[i]
        begins = [run.points[0] for run in parts]
        for k, run in enumerate(parts):
            way = next(ways) if k else lead.way
            how = lead.how if not k else "drawn" if len(way) > 1 else "on the contour"
            cuts.append(Cut(i, way, run.points, run.corners, how if cutting.lead_in > 0 else "none"))
        uncut += [np.array([a.points[-1], b]) for a, b in zip(parts, [*begins[1:], begins[0]], strict=True)]
    flat = [i for i, c in enumerate(drawing.closed) if c and not nesting.area[i]]
    warnings += named(drawing, flat, "encloses nothing: it is cut as a line, without a lead-in")
    tight = list(dict.fromkeys(cut.contour for cut in cuts if cut.how == "on the contour"))
    no_room = "has no room for a lead-in"
    if not room.worth_asking:
        no_room = "has no lead-in, for too much lies on top of each other to look for room everywhere"
    warnings += named(drawing, tight, f"{no_room}: it is pierced on the contour")
    route = Route(drawing, cutting, cuts, uncut, warnings)
    vars(route)["nesting"] = nesting  # of thousands of contours it takes a second to find again
    return route


def _without_repeats(drawing: Drawing) -> Drawing:
    """The drawing without points that repeat the one before: no leg without a direction is left."""
    pieces, every = list(drawing.pieces), list(drawing.corners)
    sizes = np.array([len(p) for p in pieces])
    owners = np.repeat(np.arange(len(pieces)), sizes)
    repeated = ~(lengths(np.concatenate(pieces)) > REPEAT) & (owners[1:] == owners[:-1])
    for i in np.unique(owners[1:][repeated]).tolist():
        piece, corners = drawing.pieces[i], drawing.corners[i]
        kept = np.append(True, lengths(piece) > REPEAT)
        if kept.sum() < 2:
            continue
        sharp = np.zeros(len(piece), bool)
        sharp[corners] = True
        pieces[i], every[i] = piece[kept].copy(), np.flatnonzero(sharp[kept])
        pieces[i][-1] = piece[-1]
    return replace(drawing, pieces=pieces, corners=every)


def _as_programmed(drawing: Drawing, cutting: Cutting) -> Route:
    if cutting.joints or cutting.joint_spacing:
        raise InvalidInput(
            f"'{drawing.name}' is a programme and is cut as programmed; allowed: no joints, or a drawing (DXF, SVG)"
        )
    feeds = drawing.feeds or [np.nan] * len(drawing.pieces)
    cuts = [
        Cut(i, piece[:1], piece, corners, "none", feed)
        for i, (piece, corners, feed) in enumerate(zip(drawing.pieces, drawing.corners, feeds, strict=True))
    ]
    return Route(drawing, cutting, cuts)
