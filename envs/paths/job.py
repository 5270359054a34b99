"""Jobs: from a drawing to everything the machine does, millisecond by millisecond.

Each contour is *rapid → approach → pierce (staged) → lead-in → cut → lift*, or a frog-leap in place of lift, rapid and
approach; all of it is cutting time. A job is sampled at every millisecond of nominal time, the time that it takes at a
feed override of 1.
"""

from dataclasses import dataclass, field

import numpy as np

from ..engine.quantity import InvalidInput
from .curve import Floats, Indices, Points, lengths
from .drawing import Drawing
from .feeds import breaks, of_piece
from .lift import duration, leap, rise
from .profile import MILLISECOND, Limits, at_constant_feed, stretches, timed
from .route import Cutting, Route, routed

RAPID, APPROACH, PIERCE, LEAD_IN, CUT, LIFT = range(6)
PHASES = ("rapid", "approach", "pierce", "lead-in", "cut", "lift")

SETTLE = 0.1
"""s at the cutting height before the cut begins [A]."""

HALT = 0.02
"""s at the end of a cut, more than an interpolation at the highest override: there the programme waits for the axes."""

HIGHEST = 6.0
"""mm above the cutting height, as far as a height follower can still see the sheet well enough."""


SMOOTH = np.zeros(0, np.int64)
"""Corners of what has none."""

LONGEST = 5400.0
"""s of a job at a feed override of 1: with all that is kept of each millisecond it fills 2 GB."""


@dataclass(frozen=True)
class Settings:
    """How a drawing becomes a job; mm, s, mm/s."""

    feed: float = 30.0  # mm/s of the cuts
    rapid: float = 166.0  # mm/s [S] Wu: 10 m/min
    speed: float = 133.4  # mm/s, highest feed of a cut [S] Wu: 8 m/min
    acceleration: float = 1000.0
    jerk: float = 5e4
    jump: float = 1.0  # mm/s in corners
    corners: bool = True  # acceleration, deceleration and slow corners; off: constant feed
    lead_in: float = 3.0  # mm; 0: pierce on the contour
    as_programmed: bool = True  # a programme's feeds prevail
    pierce: tuple[tuple[float, float], ...] = ((3.0, 0.3), (1.5, 0.2))  # mm above the sheet, s
    standoff: float = 1.0  # mm, nominal
    clearance: float = 4.0  # mm above the cutting height in rapids
    frog_leap: bool = True  # rise and fall during the rapid instead of before and after
    lift_speed: float = 60.0  # mm/s of lifts and approaches [A]
    lift_acceleration: float = 3000.0  # mm/s² of the same, a third of what the slowest drive has [A]
    patience: float = 0.5  # s that the programme waits at a standstill until the axes are in position [A]
    most_speed: float = 166.6667  # mm/s and mm/s² that the axes allow, for the feed override
    most_acceleration: float = 2000.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.clearance <= HIGHEST:
            raise InvalidInput(f"clearance = {self.clearance:g} mm is out of range; allowed: 0 to {HIGHEST:g} mm")
        for height, seconds in self.pierce:
            if not 0.0 < height <= self.standoff + HIGHEST or seconds < 0:
                raise InvalidInput(
                    f"pierce stage ({height:g} mm, {seconds:g} s): heights above 0 and up to "
                    f"{self.standoff + HIGHEST:g} mm, times of 0 s and more are allowed"
                )


@dataclass(frozen=True, eq=False)
class PlannedJob:
    """A job; arrays have one entry for each millisecond of nominal time.

    ``x``, ``y``: commanded position of the carrier, mm; ``s``: way along the whole programme, mm; ``cut_s``: mm cut so
    far; ``feed``: planned speed, mm/s; ``tx``, ``ty``: unit tangent; ``beam``: 1 where the laser is on; ``phase``: into
    :data:`PHASES`; ``lift``: mm by which the set height lies above the cutting height; ``most``: largest feed
    override at which speed and acceleration of the axes still suffice. ``contours``: rows (first, last sample of a
    cut and its lead-in), one for each of the route's cuts. ``outlines``: the contours as drawn, for pictures.
    """

    name: str
    x: Floats
    y: Floats
    s: Floats
    cut_s: Floats
    feed: Floats
    tx: Floats
    ty: Floats
    beam: Floats
    phase: Floats
    lift: Floats
    most: Floats
    contours: Indices
    settings: Settings
    outlines: list[Points] = field(repr=False)
    warnings: list[str] = field(default_factory=list)
    route: Route | None = field(default=None, repr=False)
    cut_feed: float = 0.0  # mm/s that the cuts were planned with, of several their mean by length

    @property
    def patience(self) -> float:
        """ms that it waits at a standstill."""
        return self.settings.patience / MILLISECOND

    @property
    def duration(self) -> float:
        """s at a feed override of 1."""
        return (len(self.x) - 1) * MILLISECOND

    @property
    def cut_length(self) -> float:
        """mm of contours, lead-ins included."""
        return float(self.cut_s[-1])


class _Tape:
    """What a job is made of so far."""

    def __init__(self, start: Floats) -> None:
        self.rows: list[tuple[Floats, ...]] = []  # positions, tangents, phase, beam, lift
        self.count = 0  # samples
        self.here, self.lift, self.tangent = np.asarray(start, float), 0.0, np.array([1.0, 0.0])

    def stand(self, seconds: float, phase: int, beam: float, lift: float) -> None:
        """Stays where it is while the set height goes to ``lift``."""
        count = max(1, round(seconds / MILLISECOND))
        self._add(
            np.tile(self.here, (count, 1)), np.tile(self.tangent, (count, 1)), phase, beam, rise(self.lift, lift, count)
        )

    def lifted(self, lift: float, phase: int, limits: tuple[float, float]) -> None:
        """Stays where it is for as long as the head needs to ``lift`` with a speed and an acceleration."""
        if abs(lift - self.lift) > 1e-9:
            self.stand(np.ceil(duration(lift - self.lift, *limits) / MILLISECOND) * MILLISECOND, phase, 0.0, lift)

    def move(self, positions: Floats, tangents: Floats, phase: int, beam: float, lift: Floats | None = None) -> None:
        """Goes along; the first position is where it is."""
        count = len(positions) - 1
        self._add(positions[1:], tangents[1:], phase, beam, np.full(count, self.lift) if lift is None else lift)

    def leap(
        self, positions: Floats, tangents: Floats, lift: float, clearance: float, limits: tuple[float, float]
    ) -> None:
        """Goes along while the head rises and falls to ``lift``, and waits there if the head takes longer."""
        needed = np.ceil(duration(lift - self.lift, *limits) / MILLISECOND)
        late = max(0, int(needed) - (len(positions) - 1))
        positions, tangents = (np.pad(each, ((0, late), (0, 0)), mode="edge") for each in (positions, tangents))
        count = len(positions) - 1
        heights = leap(self.lift, lift, clearance, count * MILLISECOND, count, limits)
        self.move(positions, tangents, RAPID, 0.0, heights)

    def _add(self, positions: Floats, tangents: Floats, phase: int, beam: float, lift: Floats) -> None:
        count = len(positions)
        if count:
            self.rows.append((positions, tangents, np.full(count, float(phase)), np.full(count, beam), lift))
            self.here, self.tangent, self.lift = positions[-1], tangents[-1], float(lift[-1])
            self.count += count


def plan(drawing: Drawing, settings: Settings) -> PlannedJob:
    """The job that cuts ``drawing``, which begins above its first pierce point.

    Raises:
        InvalidInput: a feed beyond the limits, a contour that cannot be travelled, or a job beyond :data:`LONGEST`.
    """
    return driven(routed(drawing, Cutting(settings.lead_in)), settings)


def driven(route: Route, settings: Settings) -> PlannedJob:
    """The job that follows a route; see :func:`plan`."""
    s = settings
    cutting = Limits(s.speed, s.acceleration, s.jerk, s.jump)
    moving, limits = Limits(s.rapid, s.acceleration, s.jerk, s.jump), (s.lift_speed, s.lift_acceleration)
    feeds, warnings = _feeds(route, s)
    _check_duration(route, feeds, s)
    tape, contours = _Tape(route.cuts[0].way[0]), []
    tape.lift = s.clearance
    tape.stand(0.02, RAPID, 0.0, s.clearance)
    travel = timed if s.corners else at_constant_feed
    for number, (cut, feed) in enumerate(zip(route.cuts, feeds, strict=True)):
        start = cut.way[0]
        if np.hypot(*(start - tape.here)) > 1e-6:
            positions, tangents, _ = timed(stretches(np.array([tape.here, start])), s.rapid, moving)
            first = (s.pierce[0][0] if s.pierce else s.standoff) - s.standoff
            tape.leap(positions, tangents, first, s.clearance, limits)
        for height, seconds in s.pierce:
            tape.lifted(height - s.standoff, APPROACH, limits)
            if seconds > 0:
                tape.stand(seconds, PIERCE, 1.0, height - s.standoff)
        tape.lifted(0.0, APPROACH, limits)
        tape.stand(SETTLE, APPROACH, 0.0, 0.0)
        first_sample = tape.count
        try:
            legs = of_piece(route.drawing, cut.contour, s.feed, s.speed) if s.as_programmed else None
            path = stretches(cut.path, breaks(cut.path, cut.corners, legs))
            into = stretches(cut.way, SMOOTH) if len(cut.way) > 1 else []
            positions, tangents, way = travel([*into, *path], feed, cutting, legs)
        except InvalidInput as error:
            raise InvalidInput(
                f"'{route.drawing.name}', contour {route.drawing.number(cut.contour)}: {error}"
            ) from None
        led = int(np.searchsorted(way, sum(x.length for x in into), side="right")) if into else 1
        if led > 1:
            tape.move(positions[:led], tangents[:led], LEAD_IN, 1.0)
        tape.move(positions[max(led - 1, 0) :], tangents[max(led - 1, 0) :], CUT, 1.0)
        tape.stand(HALT, CUT, 1.0, tape.lift)
        contours.append((first_sample, tape.count - 1))
        if number == len(route.cuts) - 1 or not s.frog_leap:
            tape.lifted(s.clearance, LIFT, limits)
    tape.stand(0.05, RAPID, 0.0, tape.lift)
    return _job(route, settings, tape, np.array(contours), _mean(route, feeds), warnings)


def _feeds(route: Route, s: Settings) -> tuple[list[float], list[str]]:
    """mm/s of each cut: as programmed, at most what the axes do; and what a user should know about that."""
    if not s.as_programmed:
        return [s.feed] * len(route.cuts), []
    wanted = [cut.feed if np.isfinite(cut.feed) and cut.feed > 0 else s.feed for cut in route.cuts]
    legs = [leg[np.isfinite(leg)].max(initial=0.0) for leg in route.drawing.leg_feeds or []]
    fastest = float(max([*wanted, *legs]))
    if fastest <= s.speed or fastest == s.feed:  # a feed that a user asked for is an error, not reduced
        return wanted, []
    note = f"feeds of up to {fastest:g} mm/s are programmed; the axes go at {s.speed:g} mm/s at most"
    return [min(feed, s.speed) for feed in wanted], [note]


def _mean(route: Route, feeds: list[float]) -> float:
    if len(set(feeds)) == 1:
        return feeds[0]
    return float(np.average(feeds, weights=[lengths(cut.path).sum() for cut in route.cuts]))


def _check_duration(route: Route, feeds: list[float], s: Settings) -> None:
    """Before a minute is spent on it.

    Raises:
        InvalidInput: the job takes longer than :data:`LONGEST`.
    """
    ways = [sum(lengths(p).sum() for p in (cut.way, cut.path)) for cut in route.cuts]
    pierces = len(route.cuts) * (SETTLE + sum(seconds for _, seconds in s.pierce))
    seconds = float(np.divide(ways, feeds).sum()) + route.move_length / s.rapid + pierces
    if seconds > LONGEST:
        raise InvalidInput(
            f"'{route.drawing.name}': a job of at least {seconds:.0f} s ({len(route.cuts)} cuts, "
            f"{route.cut_length / 1000:.1f} m) is out of range; allowed: {LONGEST:.0f} s, of which each millisecond is "
            "simulated; cut fewer contours, or faster"
        )


def _job(
    route: Route, settings: Settings, tape: _Tape, contours: Indices, feed: float, warnings: list[str]
) -> PlannedJob:
    drawing = route.drawing
    at, t, phase, beam, lift = map(np.concatenate, zip(*tape.rows, strict=True))
    steps = np.append(0.0, lengths(at))
    cutting = (phase == LEAD_IN) | (phase == CUT)
    speed = np.append(steps[1:], 0.0) / MILLISECOND
    velocity = np.diff(at, axis=0, prepend=at[:1]) / MILLISECOND
    acceleration = np.append(lengths(velocity) / MILLISECOND, 0.0)
    speed_room = settings.most_speed / np.maximum(speed, 1e-3)
    acceleration_room = np.sqrt(settings.most_acceleration / np.maximum(acceleration, 1e-3))
    most = np.clip(np.minimum(speed_room, acceleration_room), 1.0, 3.0)
    x, y, tx, ty = at[:, 0].copy(), at[:, 1].copy(), t[:, 0].copy(), t[:, 1].copy()
    samples = x, y, np.cumsum(steps), np.cumsum(np.where(cutting, steps, 0.0)), speed, tx, ty, beam, phase, lift, most
    warnings = [*drawing.notes, *route.warnings, *warnings]
    return PlannedJob(drawing.name, *samples, contours, settings, list(drawing.pieces), warnings, route, feed)
