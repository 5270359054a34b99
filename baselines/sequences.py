"""Command sequences on the panel: what CN102528288A names as advanced processes.

Each is a plain function of a :class:`~kerfgym.envs.control.panel.Panel`: it gives commands, moves X, and says how it
ended. A sequence that meets an alarm stops X and ends there; the supervisor has the head by then. Jobs of the suites
``contour`` and ``cutting`` pierce and leap in the compiled machine; here the same is done from outside, command by
command, as a numerical control does.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from kerfgym.envs.control.panel import Outcome, Panel
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import supervisor
from kerfgym.envs.plant.controller import PERIOD

ACCELERATION = 2000.0
"""mm/s² of X in rapid moves [A]."""

INTERPOLATION = 8
"""ms between two corrections of the set height (Wu's interpolation period)."""


@dataclass(frozen=True)
class Edge:
    """Where the sheet ends along x, mm, and how the search ended."""

    place: float
    outcome: Outcome


def rapid(panel: Panel, distance: float, speed: float, acceleration: float = ACCELERATION) -> Callable[[], bool]:
    """X goes ``distance`` mm with limited acceleration; the function that is returned is called before every period,
    and says whether X is still on its way."""
    start, pace = panel["distance"], 0.0

    def step() -> bool:
        nonlocal pace
        left = distance - (panel["distance"] - start) - _LATE * pace * PERIOD
        brake = np.sqrt(max(2.0 * acceleration * left, 0.0))
        pace = min(pace + acceleration * PERIOD, speed, float(brake))
        panel.feed = pace if left > 0.0 else 0.0
        return left > 0.0 and pace > 0.0

    return step


_LATE = 6.0
"""Control periods that the path runs ahead of what ``distance`` shows, and the one that is about to be given."""


def staged_pierce(
    panel: Panel, height: float, stages: tuple[tuple[float, float], ...] = ((3.0, 0.3), (1.5, 0.2))
) -> Outcome:
    """Pierces from above in stages, then goes to the cutting height.

    Args:
        panel: the machine; X stands still.
        height: cutting height, mm.
        stages: heights (mm) and how long each is held (s); not below the cutting height, none above the one before.
    """
    heights = [stage for stage, _ in stages] + [height]
    if any(after > before for before, after in zip(heights, heights[1:], strict=False)):
        raise InvalidInput(f"pierce stages {heights} mm; each must be at or below the one before, and end at the cut")
    spent = 0.0
    for stage, seconds in (*stages, (height, 0.0)):
        outcome = panel.follow(stage)
        spent += outcome.seconds
        if not outcome.done:
            return replace(outcome, seconds=spent)
        dwell = _watched(panel, lambda: False, seconds)
        spent += dwell.seconds
        if dwell.alarm != "none":
            return replace(dwell, seconds=spent)
    return Outcome(True, spent)


def frog_leap(panel: Panel, distance: float, lift: float, height: float, speed: float = 166.0) -> Outcome:
    """Rises and comes down again while X goes to the next contour, instead of before and after.

    The head comes down so that both arrive together, but not before it has risen by all of the lift.

    Args:
        panel: the machine, following.
        distance: mm along x.
        lift: mm by which the head rises.
        height: set height after landing, mm.
        speed: mm/s of X.
    """
    if lift <= 0.0 or distance <= 0.0:
        raise InvalidInput(f"lift = {lift:g} mm and distance = {distance:g} mm; both must be above 0")
    start, top = panel.time, panel["head"] + lift
    panel.request("move", target=top)
    step, place = rapid(panel, distance, speed), panel["distance"]
    down, falling = _fall_time(panel, lift), False

    def over() -> bool:
        nonlocal falling
        moving = step()
        left = distance - (panel["distance"] - place)
        braking = panel.feed / ACCELERATION  # s that X needs to stop
        late = left <= max(panel.feed, 1.0) * max(down - 0.5 * braking, 0.0)
        if not falling and late and panel["head"] > top - _RISEN:
            panel.request("follow", set_height=height)
            falling = True
        return falling and not moving

    leapt = panel.until(over)
    panel.feed = 0.0
    if not leapt.done:
        return replace(leapt, seconds=panel.time - start)
    landed = panel.follow(height)
    return replace(landed, seconds=panel.time - start)


_RISEN = 0.1
"""mm short of the lift at which it counts as reached."""


def lift_travel_land(panel: Panel, distance: float, lift: float, height: float, speed: float = 166.0) -> Outcome:
    """What a frog-leap replaces: up, along, down, one after the other."""
    start = panel.time
    risen = panel.move(panel["head"] + lift)
    if not risen.done:
        return risen
    step = rapid(panel, distance, speed)
    travelled = panel.until(lambda: not step())
    panel.feed = 0.0
    if not travelled.done:
        return travelled
    return replace(panel.follow(height), seconds=panel.time - start)


def find_edge(panel: Panel, height: float, feed: float, longest: float) -> Edge:
    """Goes along x at a steady head position until the sheet ends, and says where.

    Half of the plate hangs over the edge where the capacitance has fallen half-way from what it is over the sheet to
    what it is beside it; 1/f² is the capacitance, up to a factor (Xi2023 eq. 3). The head does not follow meanwhile: it
    stands still under single-side protection, so that it neither dives nor touches.

    Args:
        panel: the machine, over the sheet.
        height: of the nozzle during the search, mm.
        feed: mm/s.
        longest: mm after which the search is given up.
    """
    start = panel.time
    over = panel.follow(height)
    if not over.done:
        return Edge(float("nan"), over)
    panel.protect(0.5 * height)
    places: list[float] = []
    capacitances: list[float] = []
    place, first = panel["distance"], len(places)
    panel.feed = feed

    def ended() -> bool:
        frequency = panel["frequency"]
        if frequency > 0.0:
            places.append(panel["distance"])
            capacitances.append(frequency**-2.0)
        return panel["distance"] - place >= longest or _has_ended(capacitances, feed)

    found = panel.until(ended, longest / feed + 1.0)
    panel.feed = 0.0
    outcome = replace(found, seconds=panel.time - start)
    c, x = np.asarray(capacitances), np.asarray(places)
    window = max(3, round(1.0 / (feed * PERIOD)))  # 1 mm
    if not found.done or len(c) < 4 * window:
        return Edge(float("nan"), replace(outcome, done=False))
    inside, outside = float(np.median(c[first : first + window])), float(np.median(c[-window:]))
    if inside - outside < _STEP * inside:
        return Edge(float("nan"), replace(outcome, done=False))
    # The last crossing of the middle, between two samples; a sample belongs to the centre of its gate.
    level = 0.5 * (inside + outside)
    i = int(np.flatnonzero(c > level)[-1])
    i = min(i, len(c) - 2)
    share = (c[i] - level) / (c[i] - c[i + 1])
    return Edge(float(x[i] + share * (x[i + 1] - x[i]) - 0.5 * _gate(panel) * feed), outcome)


_STEP = 0.02
"""Least share by which the capacitance falls at an edge, at heights up to a few millimetres [A]."""


def _gate(panel: Panel) -> float:
    """s, length of the sensor's gate."""
    return float(panel.stack.part("gate").length) * 1e-3


def _has_ended(c: list[float], feed: float) -> bool:
    """Whether the capacitance fell, and has not changed over the last 3 mm."""
    window = max(3, round(3.0 / (feed * PERIOD)))
    if len(c) < 3 * window:
        return False
    late = np.asarray(c[-window:])
    return bool(late.mean() < (1.0 - _STEP) * np.median(c[:window]) and np.ptp(late) < 0.1 * _STEP * c[0])


def focus_compensation(
    panel: Panel, length: float, feed: float, height: float, shift: Callable[[float], float], most: float = 1.0
) -> Outcome:
    """Follows along x while the set height makes up for a focus that moves with the length of the beam's way.

    With flying optics the beam grows longer as the head travels, and its focus moves. The set height is changed by as
    much, every interpolation period, so that the focus keeps its depth in the sheet.

    Args:
        panel: the machine, over the sheet.
        length: mm along x.
        feed: mm/s.
        height: set height at the start, mm.
        shift: by how much the focus has moved up, mm, at x mm from the start.
        most: mm, largest correction.
    """
    shifts = np.array([shift(x) for x in np.linspace(0.0, length, 101)])
    if np.abs(shifts).max() > most or (height - shifts).min() < 0.2:
        raise InvalidInput(
            f"focus shifts of {shifts.min():g} to {shifts.max():g} mm ask for heights of {(height - shifts).min():g} "
            f"to {(height - shifts).max():g} mm; corrections up to {most:g} mm and heights from 0.2 mm are allowed"
        )
    start = panel.time
    first = panel.follow(height - shift(0.0))
    if not first.done:
        return first
    place, count = panel["distance"], 0
    panel.feed = feed

    def arrived() -> bool:
        nonlocal count
        x = panel["distance"] - place
        if count % INTERPOLATION == 0:
            panel.request("follow", set_height=height - shift(min(max(x, 0.0), length)))
        count += 1
        return x >= length

    travelled = panel.until(arrived, length / feed + 1.0)
    panel.feed = 0.0
    return replace(travelled, seconds=panel.time - start)


def _fall_time(panel: Panel, lift: float) -> float:
    """s in which the head comes down by ``lift`` mm under the supervisor's approach."""
    p, left, time = panel.stack.part("guard"), lift, 0.0
    while left > p.capture and time < 5.0:
        left += supervisor.planned(p, -left) * PERIOD
        time += PERIOD
    return time + 1e-3 * p.delay


def _watched(panel: Panel, reached: Callable[[], bool], seconds: float) -> Outcome:
    """Lets ``seconds`` pass; an alarm ends it."""
    return panel.until(reached, seconds) if seconds > 0.0 else Outcome(True, 0.0)
