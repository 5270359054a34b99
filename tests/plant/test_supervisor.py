"""Supervisor: its modes, guards, alarms and handovers, on the machine (CN102528288A, Xi2023, docs/physics.md)."""

from typing import NamedTuple

import numpy as np
import pytest

from kerfgym.envs.engine.lanes import part
from kerfgym.envs.plant import filters, heads, idle, sensor, sheet, supervisor, z_axis
from kerfgym.envs.plant.controller import make_law
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.plant.supervisor import (
    ALARM,
    CALIBRATE,
    COLLISION,
    FOLLOW,
    FOLLOWING_ERROR,
    HOLD,
    HOME,
    LIMIT,
    MOVE,
    NO_ALARM,
    STOP,
)


class Settings(NamedTuple):
    """Gain, 1/s."""

    kp: float = 50.0


class Memory(NamedTuple):
    """None."""

    nothing: float = 0.0


@part
def nothing(params):
    """The initial state."""
    return Memory(0.0)


@part
def proportional(params, state, signals, tables):
    """Speed in proportion to the error of height."""
    return state, params.kp * (signals.set_height - signals.height)


class Proportional:
    """P law on the reported height."""

    Params, State = Settings, Memory
    init, control = staticmethod(nothing), staticmethod(proportional)


IDLE = make_law(idle, "idle")
P_LAW = make_law(Proportional, "proportional for tests")

Z = z_axis.Params()
STIFF = Z._replace(omega=2 * np.pi * 120.0, zeta=0.6)
SLOW = Z._replace(omega=2 * np.pi * 50.0, zeta=1.0, dead_time=2.0, acceleration=1e4)


def machine_with(law=P_LAW, gap: float = 1.0, feed: float = 200.0, z: z_axis.Params = Z, kp: float = 50.0, **settings):
    """One machine without noise; ``settings`` are fields of parts, ``job__request=…``."""
    fleet = Fleet(1, law, heads.ensure([0]))
    fleet.put_filter(0, filters.Params())
    fleet.put("sensor", 0, sensor.EQ3._replace(noise=0.0, jitter=0.0))
    fleet.put("z", 0, z)
    fleet.set("path.feed", 0, feed)
    fleet.set("start.gap", 0, gap)
    if law is P_LAW:
        fleet.set_law("kp", 0, kp)
    for name, value in settings.items():
        fleet.set(name.replace("__", "."), 0, value)
    return fleet


def run(fleet: Fleet, steps: int, *fields: str) -> np.ndarray:
    """Numbers of the first machine after each of ``steps`` further periods, shape (fields, steps)."""
    views = [fleet.row(field) for field in fields]
    out = np.empty((len(fields), steps))
    for step in range(steps):
        fleet.advance()
        for i, view in enumerate(views):
            out[i, step] = view[0]
    return out


def started(fleet: Fleet) -> Fleet:
    fleet.begin(np.arange(fleet.size), np.arange(1, fleet.size + 1))
    return fleet


def now(fleet: Fleet, field: str) -> float:
    return float(fleet.column(field)[0])


# ------------------------------------------------------------------------------------------------------ planned moves


@pytest.mark.parametrize("delay", [1.0, 12.0, 40.0])
def test_a_planned_speed_stops_within_the_distance_after_the_delay(delay):
    p = supervisor.Params(plan=0.4, acceleration=12000.0, fastest=1e9, delay=delay)
    for distance in (1e-3, 0.1, 3.0, 80.0):
        v = supervisor.planned(p, distance)
        assert v * v / (2 * 0.4 * 12000.0) + v * delay * 1e-3 == pytest.approx(distance)
        assert supervisor.planned(p, -distance) == -v
        assert v < np.sqrt(2 * 0.4 * 12000.0 * distance)
    assert supervisor.planned(p, 0.0) == 0.0
    assert supervisor.planned(p._replace(fastest=30.0), 80.0) == 30.0


@pytest.mark.parametrize(("start", "target"), [(20.0, 50.0), (50.0, 20.0), (50.0, 50.5), (50.0, 49.99), (5.0, 105.0)])
@pytest.mark.parametrize("axis", ["default", "stiff", "slow, planned for"])
def test_a_move_ends_at_its_target_without_overshoot(axis, start, target):
    z, delay = {"default": (Z, 12.0), "stiff": (STIFF, 12.0), "slow, planned for": (SLOW, 25.0)}[axis]
    fleet = machine_with(IDLE, start, z=z, job__request=MOVE, job__target=target, guard__delay=delay)
    (position,) = run(started(fleet), 1800, "motion.position")
    assert (np.sign(target - start) * (position - target)).max() < 0.02
    assert position[-1] == pytest.approx(target, abs=2e-3)
    assert np.ptp(position[-100:]) < 2e-3
    assert now(fleet, "supervisor.mode") == MOVE
    assert now(fleet, "supervisor.alarm") == NO_ALARM


def test_a_new_target_is_taken_at_once():
    fleet = started(machine_with(IDLE, 20.0, job__request=MOVE, job__target=60.0))
    fleet.advance(150)
    fleet.set("job.target", 0, 30.0)
    (position,) = run(fleet, 1500, "motion.position")
    assert position.max() < 45.0
    assert position[-1] == pytest.approx(30.0, abs=2e-3)


# ------------------------------------------------------------------------------------------------------------ homing


def homed(coast: float, switch: float) -> tuple[Fleet, np.ndarray]:
    """A machine that has just ended homing, and its velocities and positions on the way."""
    fleet = started(machine_with(IDLE, 60.0, start__coast=coast, job__request=HOME, job__switch=switch))
    views = [fleet.row(f) for f in ("signals.velocity", "motion.position", "supervisor.mode", "supervisor.phase")]
    way = []
    for _ in range(8000):
        fleet.advance()
        way.append([v[0] for v in views])
        if len(way) > 100 and (way[-1][2] != HOME or way[-1][3] == 4.0):
            break
    return fleet, np.array(way).T


@pytest.mark.parametrize(("coast", "switch"), [(3.2174, 93.0), (-7.9, 93.0), (0.0, 96.5)])
def test_after_homing_the_reported_position_is_the_true_one_to_a_count(coast, switch):
    fleet, _ = homed(coast, switch)
    fleet.set("job.request", 0, STOP)
    fleet.advance(100)
    assert now(fleet, "signals.head_position") == pytest.approx(now(fleet, "motion.position"), abs=1e-3)


def test_before_homing_the_reported_position_is_off_by_what_the_encoder_coasted():
    fleet = started(machine_with(IDLE, 60.0, start__coast=3.2174, job__request=STOP))
    fleet.advance(10)
    assert now(fleet, "signals.head_position") - now(fleet, "motion.position") == pytest.approx(3.2174, abs=1e-3)


def test_homing_goes_up_to_the_switch_and_down_at_2_mm_per_s_to_the_index():
    fleet, (velocity, position, *_) = homed(1.5, 93.0)
    assert velocity.max() == pytest.approx(150.0, rel=0.02)
    top = int(position.argmax())
    assert 93.0 < position[top] < 97.0
    down = velocity[top + 100 : -5]
    assert down == pytest.approx(-2.0, abs=0.05)
    assert position[-1] == pytest.approx(90.0, abs=0.03)  # the first index pulse below the switch
    assert now(fleet, "supervisor.alarm") == NO_ALARM


def test_homing_ends_by_itself_and_does_not_start_again():
    fleet, _ = homed(0.0, 93.0)
    mode, phase, position = run(fleet, 500, "supervisor.mode", "supervisor.phase", "motion.position")
    assert np.ptp(mode[1:]) == 0.0
    assert np.ptp(phase[1:]) == 0.0
    assert position[-1] == pytest.approx(90.0, abs=0.03)
    assert np.ptp(position[100:]) < 1e-3


# ------------------------------------------------------------------------------------------------------- calibration


def test_a_calibration_touches_the_sheet_and_rises_at_10_mm_per_s_past_10_mm():
    fleet = started(machine_with(IDLE, 0.2, feed=0.0, job__request=CALIBRATE))
    phase, frequency, velocity, gap = run(
        fleet, 1700, "supervisor.phase", "signals.frequency", "signals.velocity", "signals.gap"
    )
    touch = int(np.argmax(frequency == 0.0))
    assert np.all(phase[:touch] == 0.0)
    assert np.all(phase[touch + 1] == 1.0)
    assert velocity[50:touch] == pytest.approx(-0.5, abs=0.02)
    rising = (phase == 1.0) & (gap > 0.3) & (gap < 10.0)
    assert velocity[rising] == pytest.approx(10.0, abs=0.01)  # one D/A step is 0.015 mm/s
    assert phase[-1] == 2.0
    assert 10.1 < gap[-1] < 10.3
    assert velocity[-1] == pytest.approx(0.0, abs=1e-3)
    assert gap.min() > -5e-3  # it does not press on the sheet
    assert now(fleet, "supervisor.mode") == CALIBRATE
    assert now(fleet, "supervisor.alarm") == NO_ALARM


# ------------------------------------------------------------------------------------------------ follow, hold, stop


@pytest.mark.parametrize("kp", [20.0, 50.0, 100.0])
def test_following_a_slope_leaves_the_lag_of_speed_over_gain(kp):
    fleet = started(machine_with(kp=kp, sheet__tilt_x=0.005))
    fleet.advance(1500)
    (gap,) = run(fleet, 100, "signals.gap")
    assert 1.0 - gap.mean() == pytest.approx(0.005 * 200.0 / kp, abs=1e-3)
    assert now(fleet, "signals.captured") == 1.0
    assert now(fleet, "signals.override") == 0.0
    assert now(fleet, "supervisor.mode") == FOLLOW


def test_a_hold_keeps_the_head_where_it_is_and_following_goes_on_after_it():
    fleet = started(machine_with(sheet__tilt_x=0.002))
    fleet.advance(500)
    fleet.set("job.request", 0, HOLD)
    fleet.advance(60)
    head, override = run(fleet, 400, "signals.head", "signals.override")
    assert np.ptp(head) < 1e-4
    assert np.all(override == 1.0)
    fleet.set("job.request", 0, FOLLOW)
    fleet.advance(400)
    assert now(fleet, "signals.gap") == pytest.approx(1.0 - 0.002 * 200.0 / 50.0, abs=2e-3)
    assert now(fleet, "signals.override") == 0.0


def test_stop_brings_the_head_to_rest_and_follow_takes_it_up_again():
    fleet = started(machine_with(sheet__tilt_x=0.01))
    fleet.advance(500)
    fleet.set("job.request", 0, STOP)
    fleet.advance(60)
    head, command, mode = run(fleet, 50, "signals.head", "signals.command", "supervisor.mode")
    assert np.ptp(head) < 1e-4
    assert not command.any()
    assert np.all(mode == STOP)
    fleet.set("job.request", 0, FOLLOW)
    fleet.advance(500)
    assert now(fleet, "supervisor.mode") == FOLLOW
    assert now(fleet, "signals.gap") == pytest.approx(1.0 - 0.01 * 200.0 / 50.0, abs=2e-3)


def test_a_move_asked_for_while_following_first_stops_the_head():
    fleet = machine_with(IDLE, 5.0, feed=0.0)
    fleet = started(fleet)
    fleet.set("hand.residual", 0, 90.0)
    fleet.advance(40)
    assert now(fleet, "signals.command") == 90.0
    fleet.set("job.request", 0, MOVE)
    fleet.set("job.target", 0, 3.0)
    command, mode = run(fleet, 1500, "signals.command", "supervisor.mode")
    assert command[:9] == pytest.approx(np.arange(80.0, -1.0, -10.0))
    assert np.all(mode[:8] == STOP)
    assert mode[-1] == MOVE
    assert now(fleet, "motion.position") == pytest.approx(3.0, abs=2e-3)


# ---------------------------------------------------------------------------------------------------------- approach


@pytest.mark.parametrize("kp", [20.0, 50.0, 100.0])
@pytest.mark.parametrize("set_height", [0.5, 1.0])
@pytest.mark.parametrize("axis", ["default", "stiff"])
def test_an_approach_from_15_mm_is_never_faster_than_it_can_stop(axis, set_height, kp):
    z = {"default": Z, "stiff": STIFF}[axis]
    fleet = started(machine_with(gap=15.0 + set_height, z=z, kp=kp, job__set_height=set_height))
    gap, velocity = run(fleet, 1200, "signals.gap", "signals.velocity")
    distance = gap - set_height
    guarded = distance > supervisor.Params().capture
    limit = np.sqrt(2.0 * 0.5 * 1e4 * distance[guarded])
    assert np.all(-velocity[guarded] <= 1.02 * limit)
    assert velocity.min() < -140.0  # and not slower than it must
    assert gap.min() > 0.5 * set_height
    assert gap[-1] == pytest.approx(set_height, abs=2e-3)
    assert now(fleet, "supervisor.alarm") == NO_ALARM


@pytest.mark.parametrize("kp", [20.0, 50.0, 100.0])
def test_even_the_slowest_axis_approaches_without_contact(kp):
    fleet = started(machine_with(gap=15.5, z=SLOW, kp=kp, job__set_height=0.5))
    (gap,) = run(fleet, 1500, "signals.gap")
    assert gap.min() > 0.1
    assert gap[-1] == pytest.approx(0.5, abs=5e-3)


@pytest.mark.parametrize("pause", [HOLD, STOP])
def test_following_after_a_pause_above_a_pit_is_an_approach_again(pause):
    # The sheet falls by 8 mm while the head stands still.
    fleet = machine_with(kp=100.0)
    fleet.put_feature(0, 0, 60.0, sheet.FAR, -8.0, 0.0)
    started(fleet).advance(100)
    fleet.set("job.request", 0, pause)
    fleet.advance(400)
    assert now(fleet, "signals.gap") == pytest.approx(9.0, abs=0.05)
    fleet.set("job.request", 0, FOLLOW)
    gap, velocity = run(fleet, 600, "signals.gap", "signals.velocity")
    assert velocity.min() > -1.02 * supervisor.Params().fastest
    assert gap.min() > 0.5
    assert gap[-1] == pytest.approx(1.0, abs=2e-3)


# ---------------------------------------------------------------------------------------------------------- handover


@pytest.mark.parametrize("slew", [2.0, 10.0, 50.0])
def test_a_handover_never_lowers_the_command_by_more_than_the_slew_and_what_the_law_does(slew):
    n, steps = 32, 1500
    fleet, every, rng = Fleet(n, IDLE, heads.ensure([0])), np.arange(n), np.random.default_rng(21)
    fleet.put_filter(every, filters.Params())
    for field, value in (("path.feed", 0.0), ("start.gap", 3.0), ("guard.slew", slew)):
        fleet.set(field, every, value)
    started(fleet)
    wish, asked, modes = np.zeros(n), np.zeros(n), set()
    command, override = fleet.column("supervisor.command"), fleet.column("supervisor.override") > 0.5
    followed = np.zeros(n, bool)
    for _ in range(steps):
        turned = rng.random(n) < 0.02
        requests = rng.choice([STOP, MOVE, FOLLOW, FOLLOW, FOLLOW, HOLD, CALIBRATE], n)
        fleet.set("job.request", every[turned], requests[turned])
        fleet.set("job.target", every[turned], rng.uniform(1.0, 30.0, n)[turned])
        pushed = rng.random(n) < 0.05
        wish[pushed] = rng.uniform(-60.0, 60.0, n)[pushed]
        fleet.set("hand.residual", every, wish)
        fleet.advance()
        before, last = command, asked
        asked = wish.copy()
        command, override = fleet.column("supervisor.command"), fleet.column("supervisor.override") > 0.5
        change, own = command - before, asked - last  # no more than the slew beyond what the law itself does
        mode = fleet.column("supervisor.mode")
        moves = (mode == MOVE) | (mode == CALIBRATE)
        assert np.all(change[moves] <= np.maximum(own, 0.0)[moves] + slew + 1e-9)
        follows = (mode == FOLLOW) & (fleet.column("job.request") == FOLLOW)
        # Away from the sheet at once, but for the period in which following is switched on.
        held = follows & followed
        assert np.all(command[held] >= wish[held] - 1e-9)
        followed = follows
        assert np.all(change >= np.minimum(own, 0.0) - slew - 1e-9)
        assert np.all(np.abs(command) <= 150.0 + 1e-9)  # of moves; the law asks for less
        assert np.array_equal(command[~override], wish[~override])
        modes |= set(mode)
    assert modes == {STOP, MOVE, CALIBRATE, FOLLOW, ALARM}


@pytest.mark.parametrize("bad", [-1001.0, -1e9, -np.inf, 1e9, np.inf, np.nan])
@pytest.mark.parametrize("before", [0.0, -700.0])
def test_one_bad_command_costs_what_that_command_costs(bad, before):
    """What the drive makes of it within a period, by its own limits; the next command of the law is obeyed at once."""
    fleet = started(machine_with(IDLE, gap=3.0, job__set_height=3.0, path__feed=0.0))
    fleet.advance(5)
    for asked in (before, bad, 0.0):
        fleet.set("hand.residual", 0, asked)
        fleet.advance()
        sent = now(fleet, "supervisor.command")
        assert sent == pytest.approx(0.0 if np.isnan(asked) else np.clip(asked, -1000.0, 1000.0))
    gap = run(fleet, 100, "signals.gap")[0]
    # Two periods at the drive's acceleration of 14 000 mm/s²: at most 28 mm/s, which its loop takes 8 ms to stop.
    assert np.abs(gap - 3.0).max() < 0.25
    assert now(fleet, "signals.override") == 0.0


def test_after_contact_the_head_goes_up_at_once():
    fleet = started(machine_with(IDLE, gap=0.5, path__feed=0.0))
    fleet.set("hand.residual", 0, -60.0)
    invalid, command = run(fleet, 60, "signals.valid", "supervisor.command")
    touched = int(np.argmax(invalid < 0.5))
    assert command[touched] == pytest.approx(-60.0)
    assert command[touched + 1] == pytest.approx(supervisor.Params().fastest)


# ------------------------------------------------------------------------------------------------------------ alarms


def collided() -> Fleet:
    """A machine whose law has just driven the nozzle into the sheet at 30 mm/s."""
    fleet = started(machine_with(IDLE, 0.5, feed=0.0, job__set_height=0.5))
    fleet.set("hand.residual", 0, -30.0)
    mode, valid = run(fleet, 60, "supervisor.mode", "signals.valid")
    touched, alarmed = int(np.argmax(valid == 0.0)), int(np.argmax(mode == ALARM))
    assert touched > 0
    assert alarmed == touched + 1
    return fleet


def test_contact_latches_a_collision_and_retracts_by_its_way():
    fleet = collided()
    assert now(fleet, "supervisor.alarm") == COLLISION
    assert now(fleet, "tally.collided") == 1.0
    (position,) = run(fleet, 1000, "signals.head_position")
    way = position - now(fleet, "supervisor.zero")
    assert abs(now(fleet, "supervisor.zero")) < 0.05
    assert 5.0 <= way[-1] < 5.5
    assert np.ptp(way[-300:]) < 2e-3
    assert now(fleet, "supervisor.mode") == ALARM


def test_a_reading_that_is_not_valid_leaves_the_last_one_in_force():
    fleet = started(machine_with(IDLE, 0.3, feed=0.0, job__set_height=0.3))
    fleet.set("hand.residual", 0, -30.0)
    frequency, height, raw = run(fleet, 40, "signals.frequency", "signals.height", "signals.raw_height")
    touch = int(np.argmax(frequency == 0.0))
    assert raw[touch] == raw[touch - 1] > 0.0
    assert np.all(np.isfinite(height))


@pytest.mark.parametrize("request_", [FOLLOW, HOLD, MOVE, HOME, CALIBRATE])
def test_only_stop_clears_a_collision(request_):
    fleet = collided()
    fleet.advance(400)
    fleet.set("job.request", 0, request_)
    mode, alarm, velocity = run(fleet, 400, "supervisor.mode", "supervisor.alarm", "signals.velocity")
    assert np.all(mode == ALARM)
    assert np.all(alarm == COLLISION)
    assert np.abs(velocity[-100:]).max() < 0.01
    fleet.set("hand.residual", 0, 0.0)
    fleet.set("job.request", 0, STOP)
    fleet.advance(2)
    assert now(fleet, "supervisor.mode") == STOP
    assert now(fleet, "supervisor.alarm") == NO_ALARM
    fleet.set("job.request", 0, FOLLOW)
    fleet.advance(2)
    assert now(fleet, "supervisor.mode") == FOLLOW


@pytest.mark.parametrize(("target", "limit", "back"), [(109.5, 108.0, 60.0), (15.0, 20.0, 40.0)])
def test_at_the_limits_of_the_travel_an_alarm_is_latched_and_the_axis_stops(target, limit, back):
    fleet = started(machine_with(IDLE, 50.0, job__request=MOVE, job__target=target, job__low=20.0))
    position, velocity, mode = run(fleet, 1500, "motion.position", "signals.velocity", "supervisor.mode")
    assert mode[-1] == ALARM
    assert now(fleet, "supervisor.alarm") == LIMIT
    assert np.ptp(position[-200:]) < 1e-3
    # From its speed at the limit the command falls by `slew` a period; reading, dead time, loop and jerk cost 10 ms.
    speed = abs(velocity[np.argmax(mode == ALARM)])
    beyond = np.sign(target - 50.0) * (position[-1] - limit)
    assert 0.0 < beyond < speed**2 / (2.0 * 1e4) + speed * 10e-3
    fleet.set("job.target", 0, back)
    fleet.advance(200)
    assert now(fleet, "motion.position") == pytest.approx(position[-1], abs=1e-3)
    fleet.set("job.request", 0, STOP)
    fleet.advance(2)
    fleet.set("job.request", 0, MOVE)  # back inside is allowed
    fleet.advance(1500)
    assert now(fleet, "motion.position") == pytest.approx(back, abs=2e-3)
    assert now(fleet, "supervisor.alarm") == NO_ALARM


def test_a_following_error_that_lasts_100_ms_raises_its_alarm():
    fleet = machine_with(IDLE, guard__alarm_error=0.5)
    fleet.put_feature(0, 0, 20.0, sheet.FAR, -0.8, 0.0)
    started(fleet)
    fleet.set("hand.residual", 0, 0.0)
    height, mode, alarm = run(fleet, 400, "signals.height", "supervisor.mode", "supervisor.alarm")
    late = int(np.argmax(height > 1.5))
    alarmed = int(np.argmax(mode == ALARM))
    assert 100 <= alarmed - late <= 102
    assert alarm[alarmed] == FOLLOWING_ERROR
    assert np.all(mode[alarmed:] == ALARM)
    fleet.set("job.request", 0, STOP)
    fleet.advance(2)
    assert now(fleet, "supervisor.alarm") == NO_ALARM


@pytest.mark.parametrize(("alarm_error", "length"), [(0.5, 16.0), (0.0, 1000.0)])
def test_a_short_following_error_raises_none_and_neither_does_any_when_it_is_off(alarm_error, length):
    fleet = machine_with(IDLE, guard__alarm_error=alarm_error)
    fleet.put_feature(0, 0, 20.0, 20.0 + length, -0.8, 0.0)
    height, alarm = run(started(fleet), 500, "signals.height", "supervisor.alarm")
    assert height.max() > 1.7
    assert not alarm.any()


# --------------------------------------------------------------------------------------------------- holes and edges


def over_a_hole(guard: bool, kp: float = 50.0, length: float = 10.0, steps: int = 700) -> dict[str, np.ndarray]:
    never = {} if guard else {"guard__rise": 5.0}  # not where the sheet falls as none does, either
    fleet = machine_with(kp=kp, job__hole_guard=guard, **never)
    fleet.put_feature(0, 0, 60.0, 60.0 + length, 0.0, length)
    fields = ("signals.head", "supervisor.mode", "signals.gap", "supervisor.alarm", "signals.override")
    return dict(zip(("head", "mode", "gap", "alarm", "override"), run(started(fleet), steps, *fields), strict=True))


@pytest.mark.parametrize("kp", [30.0, 50.0, 100.0])
@pytest.mark.parametrize("length", [3.0, 5.0, 8.0, 10.0, 15.0, 50.0])
def test_with_the_guard_no_hole_lets_the_head_down(length, kp):
    guarded = over_a_hole(True, kp, length)
    assert guarded["head"].min() > 0.6  # docs/physics.md#approach-and-holes
    assert guarded["head"].max() < 1.1
    assert guarded["gap"][-1] == pytest.approx(1.0, abs=2e-3)
    assert not guarded["alarm"].any()
    if length >= 8.0:
        held = np.flatnonzero(guarded["mode"] == HOLD)
        assert np.all(np.diff(held) == 1)  # one hold, from before the hole until behind it
        assert 0.2 * (held[0] + 1) < 60.0
        assert 0.2 * (held[-1] + 1) > 60.0 + length
        assert np.all(guarded["override"][held] == 1.0)


@pytest.mark.parametrize("kp", [30.0, 50.0, 100.0])
@pytest.mark.parametrize("length", [10.0, 15.0])
def test_without_the_guard_the_head_dives_through_the_plane_of_the_sheet(length, kp):
    free = over_a_hole(False, kp, length)
    assert free["head"].min() < 0.0
    assert not np.any(free["mode"] == HOLD)
    assert free["alarm"][-1] == COLLISION  # the nozzle meets the far edge of the hole


def test_the_guard_lets_waves_and_slopes_pass():
    fleet = machine_with(kp=100.0, job__hole_guard=True, sheet__tilt_x=-0.01)
    fleet.put_wave(0, 0, 0.5, 2 * np.pi / 80.0, 0.0, 0.0)
    (mode,) = run(started(fleet), 2000, "supervisor.mode")
    assert np.all(mode == FOLLOW)


@pytest.mark.parametrize("timeout", [100.0, 400.0])
def test_a_hold_over_a_slot_ends_with_its_timeout_and_the_head_approaches_anew(timeout):
    fleet = machine_with(job__hole_guard=True, guard__timeout=timeout, job__low=-3.0)
    fleet.put_feature(0, 0, 60.0, 260.0, 0.0, 50.0)
    head, mode, captured, velocity = run(
        started(fleet), 1000, "signals.head", "supervisor.mode", "supervisor.captured", "signals.velocity"
    )
    held = np.flatnonzero(mode == HOLD)
    assert np.all(np.diff(held) == 1)
    assert held.size == pytest.approx(timeout, abs=1)
    assert head[held].min() > 0.6
    assert captured[held[-1] + 1] == 0.0
    assert velocity[held[-1] : held[-1] + 60].min() < -50.0
    assert velocity.min() > -1.02 * supervisor.Params().fastest
