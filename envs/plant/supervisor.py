"""Supervisor: the one command machine between a controller and the drive.

It runs tick by tick: ``stop``, ``home``, ``move``, ``calibrate``, ``follow``, ``hold``, ``protect``, ``alarm``; each
new command first stops the motion under way (CN102528288A). Moves follow a displacement–time plan of limited speed,
acceleration and jerk (:func:`course`) through a position loop. Protection is single-sided: the head stands still and
is only lifted, by the law, where the sheet comes nearer than the protection height. While following it passes the law's
command on, except where one of its guards acts:

- *approach*: until the set height is first reached, the descent is no faster than the speed from which the axis still
  stops in time, ``sqrt(2·α·a·distance)`` less what the loop's ``delay`` costs (Patent2022's descent,
  docs/physics.md#approach-and-holes);
- *hole and edge guard*: when the sheet seems to fall by more than ``rise`` within 5 ms, faster than sheets do, the head
  goes back to where it was before and holds there, until the sheet is back or ``timeout`` has passed (then it
  approaches anew). It looks at encoder − reading, not at the reading: a tight loop hides the rise of the reading by
  following it. A fall of twenty times as much (``SUDDEN``), and to as far below the set height, is no sheet's but an
  edge's or a fault's, and trips where the job has the guard off, too;
- *contact*: the oscillator stops; the head retracts and an alarm is latched;
- *lost sensor*: the frequency is above anything that the head can give, as when its cable is off; likewise;
- *limits*: near the ends of the travel an alarm is latched and the axis stops.

What is asked for in an alarm is refused until ``stop`` has acknowledged it; an unknown command is an alarm too.

When the law takes over again, what the supervisor commanded above the law's wish dies away by ``slew`` per period, so
following is switched on and off without a bump. It is the difference that is limited, not the law's command: a rate
limit in the loop could keep it oscillating for ever.

The supervisor never makes a law's command more dangerous than it is. While it passes the law on, its command is never
below the law's wish: a wish away from the sheet is obeyed at once. So are its own commands away from the sheet, such as
the retraction after contact; only planned moves rise by ``slew`` per period. A wish beyond ``follow_speed`` is cut for
the period in which it is asked, and one that is not a number stops the head for that period: one bad command costs what
that command costs.
"""

from typing import Annotated, NamedTuple

import numpy as np

from ..engine.lanes import clip, part
from ..engine.quantity import Quantity

MODES = ("stop", "home", "move", "calibrate", "follow", "hold", "alarm", "protect")
STOP, HOME, MOVE, CALIBRATE, FOLLOW, HOLD, ALARM, PROTECT = (float(i) for i in range(len(MODES)))

ALARMS = ("none", "collision", "limit", "following error", "sensor lost", "index pulse missing", "unknown command")
NO_ALARM, COLLISION, LIMIT, FOLLOWING_ERROR, SENSOR_LOST, NO_INDEX, UNKNOWN = (float(i) for i in range(len(ALARMS)))

UNJOINED = 1e9
"""mm/s, no difference: the supervisor commands."""

MEMORY = 15
"""ms by which a hold goes back in the head's positions: an edge is felt that much earlier than it trips the guard."""

RISE_WINDOW = 5
"""ms over which the hole guard looks for a fall of the sheet (docs/physics.md#approach-and-holes)."""

SUDDEN = 20.0
"""Times the ``rise`` that trips the hole guard: 1 mm in 5 ms with a rise of 0.05 mm. Below a plate of 5.6 mm a step of
2 mm falls by less even at 300 mm/s [A]; with a smaller rise that margin is smaller, too."""

SECONDS = 1e-3
"""s, one tick."""

LEAD = 10.0
"""mm, screw lead and so the distance of the encoder's index pulses (docs/physics.md#the-z-axis)."""

WITHIN = 1.2
"""Revolutions within which the index pulse must come once the home switch has released."""

POSITION_GAIN = 25.0
"""1/s, of the position loop of moves: no overshoot up to 15 ms of lag in the axis (K·lag < 1/e) [A]."""

IN_POSITION = 1.1e-3
"""mm, from the target at which a move is over; a count of the encoder [A]."""

TOUCH_SPEED = 0.5
"""mm/s at which a calibration feels for the sheet [A]."""


class Params(NamedTuple):
    """Limits of the supervisor; part of the controller's stack as ``guard.…``."""

    plan: Annotated[float, Quantity("1", 0.1, 1.0, "share α of the acceleration that planned moves use")] = 0.5
    acceleration: Annotated[float, Quantity("mm/s²", 1e3, 5e4, "acceleration a that planned moves count on")] = 1e4
    fastest: Annotated[float, Quantity("mm/s", 1.0, 500.0, "fastest planned move")] = 150.0
    delay: Annotated[float, Quantity("ms", 0.0, 50.0, "delay of the whole loop that planned moves count on")] = 25.0
    capture: Annotated[float, Quantity("mm", 0.01, 2.0, "error at which an approach is over")] = 0.1
    rise: Annotated[
        float, Quantity("mm", 0.02, 5.0, "apparent fall of the sheet in 5 ms that trips the hole guard")
    ] = 0.07
    error: Annotated[float, Quantity("mm", 0.0, 5.0, "least error at which the hole guard trips")] = 0.02
    release: Annotated[float, Quantity("mm", 0.01, 5.0, "error below which a hold ends")] = 0.1
    timeout: Annotated[float, Quantity("ms", 1.0, 5000.0, "longest hold")] = 400.0
    slew: Annotated[float, Quantity("mm/s per ms", 0.5, 50.0, "largest change of command at a handover")] = 10.0
    retract: Annotated[float, Quantity("mm", 0.1, 50.0, "way up after a collision")] = 5.0
    alarm_error: Annotated[
        float, Quantity("mm", 0.0, 50.0, "following error that raises an alarm after 100 ms; 0: off")
    ] = 0.0
    jerk: Annotated[float, Quantity("mm/s³", 1e3, 5e6, "jerk of planned moves")] = 1e5
    hysteresis: Annotated[float, Quantity("mm", 0.01, 5.0, "above the protection height, where protection lets go")] = (
        0.2
    )
    follow_speed: Annotated[float, Quantity("mm/s", 1.0, 1000.0, "fastest following", "Xi2023")] = 1000.0


class Orders(NamedTuple):
    """What the operator and the machine's set-up ask for."""

    request: float = FOLLOW  # one of MODES
    target: float = 50.0  # mm, of a move
    set_height: float = 1.0  # mm
    hole_guard: bool = False
    switch: float = 95.0  # mm, height of the home switch
    low: float = -38.0  # mm, limit alarms
    high: float = 108.0  # mm
    protect: float = 2.0  # mm, protection height
    rise: float = 10.0  # mm above the sheet, and mm/s: how far and how fast a calibration goes [S] Xi2023
    rise_speed: float = 10.0
    indexed: bool = True  # the encoder's index pulse comes
    most_frequency: float = 1e12  # Hz, above which the sensor is lost


class State(NamedTuple):
    """What the supervisor remembers."""

    mode: float = STOP
    phase: float = 0.0  # of homing, calibration and alarm
    ticks: float = 0.0  # ms in the mode, or ms of lasting following error
    captured: bool = False  # the approach is over
    override: bool = False  # its command differs from the law's
    alarm: float = NO_ALARM
    zero: float = 0.0  # mm, head position at the last contact
    anchor: float = 0.0  # mm, head position to which a hold goes back, or where the move under way began
    offset: float = 0.0  # mm, added to the encoder; set by homing
    command: float = 0.0  # mm/s, last command sent
    goal: float = 0.0  # mm, where the move under way goes
    apart: float = 0.0  # mm/s, by which the command still differs from the law's


class View(NamedTuple):
    """What the supervisor reads each tick."""

    height: float  # mm
    fall: float  # mm by which encoder − height has fallen in RISE_WINDOW ms
    refuge: float  # mm, head position MEMORY ms ago
    valid: bool
    head_position: float  # mm, encoder with offset
    encoder: float  # mm, encoder without
    last_encoder: float  # mm, one tick ago
    wish: float  # mm/s, the law's command
    frequency: float  # Hz


@part
def course(p, distance, time):
    """Displacement–time plan of a move from rest to rest: speed, acceleration and jerk limited, an S-curve.

    Args:
        p: :class:`Params`.
        distance: mm, 0 or more.
        time: s since the move began.

    Returns:
        ``(way, duration)``: mm from the start at ``time``, and s of the whole move.
    """
    v, a, j = p.fastest, p.plan * p.acceleration, p.jerk
    # Time to reach the top speed, of it with rising acceleration, and time at that speed.
    full = v * j >= a * a
    rising = a / j if full else np.sqrt(v / j)
    ramp = rising + v / a if full else 2.0 * rising
    cruise = distance / v - ramp
    if cruise < 0.0:  # too short for the top speed
        full = distance * j * j >= 2.0 * a * a * a
        rising = a / j if full else (0.5 * distance / j) ** (1.0 / 3.0)
        ramp = 0.5 * rising + np.sqrt(0.25 * rising * rising + distance / a) if full else 2.0 * rising
        cruise = 0.0
    top = j * rising * (ramp - rising)
    duration = 2.0 * ramp + cruise
    # The second half is the first, mirrored.
    early = time < 0.5 * duration
    t = min(max(time if early else duration - time, 0.0), duration)
    t1 = min(t, rising)  # rising acceleration
    t2 = min(max(t - rising, 0.0), ramp - 2.0 * rising)  # constant acceleration
    t3 = min(max(t - ramp + rising, 0.0), rising)  # falling acceleration
    t4 = max(t - ramp, 0.0)  # constant speed
    v1, peak = 0.5 * j * t1 * t1, j * rising
    way = j * t1 * t1 * t1 / 6.0 + v1 * t2 + 0.5 * peak * t2 * t2
    v2 = v1 + peak * t2
    way += v2 * t3 + 0.5 * peak * t3 * t3 - j * t3 * t3 * t3 / 6.0 + top * t4
    return way if early else distance - way, duration


@part
def planned(p, distance):
    """Speed from which the axis still stops within ``distance`` (mm), with its sign, mm/s."""
    a = p.plan * p.acceleration
    lost = a * p.delay * SECONDS  # from v²/2a + v·delay = distance
    v = min(np.sqrt(lost * lost + 2.0 * a * abs(distance)) - lost, p.fastest)
    return v if distance > 0.0 else -v


@part
def allowed(p, wish):
    """The law's command within ``follow_speed``, mm/s; at rest if it is not a number."""
    return clip(wish, -p.follow_speed, p.follow_speed) if wish == wish else 0.0


@part
def follow(p, s, job, x):
    """The tick of a machine that follows or holds; any other is left as it is.

    Returns:
        ``(state, command)``, mm/s, before :func:`join`.
    """
    e = x.height - job.set_height
    holding = s.mode == HOLD

    released = e < p.release
    expired = s.ticks >= p.timeout

    late = p.alarm_error > 0.0 and s.captured and abs(e) > p.alarm_error
    # A reading that comes back from far below falls, too, but to where the sheet is.
    sudden = min(x.fall, e) > SUDDEN * p.rise
    trips = s.captured and (sudden or (job.hole_guard and e > p.error and x.fall > p.rise))
    captured = (s.captured or e < p.capture) and job.request != HOLD  # after a pause it approaches again
    wish = allowed(p, x.wish)
    passed = wish if captured else max(wish, planned(p, -max(e, 0.0)))
    alarmed = s.ticks >= 100.0 and not holding

    if holding:
        mode = FOLLOW if released or expired else HOLD
        ticks = 0.0 if released or expired else s.ticks + 1.0
        captured = (released or not expired) and job.request != HOLD
        u = wish if released else planned(p, s.anchor - x.head_position)
    else:
        mode = HOLD if trips else (ALARM if alarmed else FOLLOW)
        ticks = s.ticks + 1.0 if late and not trips else 0.0
        u = planned(p, x.refuge - x.head_position) if trips else (0.0 if alarmed else passed)
    alarm = FOLLOWING_ERROR if alarmed else s.alarm
    anchor = x.refuge if trips and not holding else s.anchor
    phase = 1.0 if alarmed else s.phase
    after = s._replace(mode=mode, phase=phase, ticks=ticks, captured=captured, alarm=alarm, anchor=anchor)
    mine = s.mode == FOLLOW or s.mode == HOLD
    return after if mine else s, (0.0 if job.request == HOLD else u) if mine else 0.0


@part
def is_following(s, job):
    """Whether :func:`errand` has nothing to do."""
    follows = s.mode == FOLLOW or s.mode == HOLD
    return follows and (job.request == FOLLOW or job.request == HOLD)


@part
def _home(p, phase, job, x):
    """Up to the switch, stop, down at 2 mm/s until it releases, then on to the index pulse (CN102528288A)."""
    at_switch = x.encoder >= job.switch
    # Encoders count, so a place lies on the pulse or not; the last bits of a float must not decide it.
    now, before = np.floor((x.encoder + 1e-6) / LEAD), np.floor((x.last_encoder + 1e-6) / LEAD)
    indexed = job.indexed and now != before
    still = abs(x.encoder - x.last_encoder) < 1e-3
    u = p.fastest
    if phase == 0.0:
        phase = 1.0 if at_switch else 0.0
    elif phase == 1.0:
        u = 0.0
        phase = 2.0 if still else 1.0
    elif phase == 2.0:
        u = -2.0
        phase = 3.0 if not at_switch else 2.0
    else:
        u = -2.0
        phase = 4.0 if indexed else 3.0
    return u, phase


@part
def errand(p, s, job, x, u):
    """The tick of a machine in any other mode, and every change of mode that the operator asks for.

    Args:
        p, s, job, x: :class:`Params`, :class:`State`, :class:`Orders`, :class:`View`.
        u: command of :func:`follow`, mm/s.

    Returns:
        ``(state, command)``, mm/s, before :func:`join`.
    """
    mode, phase, ticks, captured, alarm = s.mode, s.phase, s.ticks, s.captured, s.alarm
    zero, offset, anchor, goal = s.zero, s.offset, s.anchor, s.goal
    asked = FOLLOW if job.request == HOLD else job.request
    running = FOLLOW if mode == HOLD else mode
    still, apart = abs(s.command) < 1e-9, s.apart
    if asked != running and (mode != ALARM or asked == STOP):
        # A new command first stops the current one; following and protection may start from any speed (they are joined
        # bumplessly).
        known = asked == np.floor(asked) and asked >= STOP and asked <= PROTECT and asked != ALARM
        stopped = still or asked == FOLLOW or asked == STOP or asked == PROTECT
        mode = (asked if stopped else STOP) if known else ALARM
        phase, ticks, captured, apart = 0.0 if known else 1.0, 0.0, False, UNJOINED
        alarm = (NO_ALARM if asked == STOP else alarm) if known else UNKNOWN
        u = 0.0
    if mode == MOVE:
        if phase == 0.0 or job.target != goal:  # another target first stops the move, too
            u = 0.0
            if still:
                phase, ticks, anchor, goal = 1.0, 0.0, x.head_position, job.target
            elif phase != 0.0:
                phase = 0.0
        if phase == 1.0:
            ticks += 1.0
            way, duration = course(p, abs(goal - anchor), ticks * SECONDS)
            u = POSITION_GAIN * (anchor + (way if goal > anchor else -way) - x.head_position)
            arrived = ticks * SECONDS >= duration and abs(goal - x.head_position) <= IN_POSITION
            phase = 2.0 if arrived else 1.0
        elif phase == 2.0:
            off = goal - x.head_position
            u = POSITION_GAIN * off if abs(off) > IN_POSITION else 0.0
    elif mode == PROTECT and asked == running:  # in the first tick the law has not seen the protection height yet
        near = x.height < job.protect
        lets_go = x.height > job.protect + p.hysteresis
        phase = 1.0 if near else (0.0 if lets_go else phase)
        captured = phase == 1.0
        u = max(allowed(p, x.wish), 0.0) if captured else 0.0
    elif mode == HOME and phase < 4.0:
        before = phase
        u, phase = _home(p, phase, job, x)
        zero = x.encoder if phase == 3.0 and before != 3.0 else zero  # where the switch released
        if phase == 4.0:
            u, offset = 0.0, 0.0  # the drive latches its counter at the index pulse
        elif phase == 3.0 and zero - x.encoder > WITHIN * LEAD:
            mode, phase, alarm, u = ALARM, 1.0, NO_INDEX, 0.0
    elif mode == CALIBRATE and phase == 0.0:
        u = -TOUCH_SPEED
        if not x.valid:
            phase, zero, u = 1.0, x.head_position, job.rise_speed
    elif mode == CALIBRATE and phase == 1.0:
        done = x.head_position - zero > job.rise + 0.1
        phase, u = (2.0, 0.0) if done else (1.0, job.rise_speed)
    elif mode == ALARM:
        going = phase == 0.0 and x.head_position < zero + p.retract
        u = planned(p, zero + p.retract + 0.5 - x.head_position) if going else 0.0
        phase = 0.0 if going else 1.0
    s = s._replace(mode=mode, phase=phase, ticks=ticks, captured=captured, alarm=alarm, zero=zero)
    return s._replace(anchor=anchor, offset=offset, goal=goal, apart=apart), u


@part
def join(p, s, job, x, u):
    """Alarms of contact, sensor and limits, then the bumpless handover.

    Returns:
        ``(state, command)``, mm/s, what goes to the drive.
    """
    armed = s.mode != ALARM
    outside = (x.head_position < job.low and u < 0.0) or (x.head_position > job.high and u > 0.0)
    # Before homing the encoder's zero is unknown, but the switch at the upper end is where it is.
    over = s.mode == HOME and x.encoder > job.high and u > 0.0
    limit = armed and (over if s.mode == HOME else outside)
    contact = not x.valid and armed and s.mode != CALIBRATE
    looks = s.mode == FOLLOW or s.mode == HOLD or s.mode == PROTECT or s.mode == CALIBRATE
    lost = looks and x.frequency > job.most_frequency
    flees = contact or lost
    mode = ALARM if limit or flees else s.mode
    alarm = COLLISION if contact else (SENSOR_LOST if lost else (LIMIT if limit else s.alarm))
    phase = 0.0 if flees else (1.0 if limit else s.phase)
    zero = x.head_position if flees else s.zero
    u = p.fastest if flees else (0.0 if limit else u)

    passes = (mode == FOLLOW or mode == PROTECT) and u == allowed(p, x.wish)
    difference = s.command - u if s.apart == UNJOINED else s.apart
    left = max(difference - p.slew, 0.0)  # below the wish nothing is left: it is obeyed at once
    joined = min(u + left, max(u, s.command))  # a law that jumps about must not be led beyond what either asks for
    planned_move = mode == MOVE or mode == HOME or mode == CALIBRATE
    own = clip(u, s.command - p.slew, s.command + p.slew if planned_move else u)
    command = joined if passes else own
    override = not passes or joined != x.wish
    s = s._replace(mode=mode, phase=phase, override=override, alarm=alarm, zero=zero, command=command)
    return s._replace(apart=joined - u if passes else UNJOINED), command
