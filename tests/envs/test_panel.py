"""The operator's panel: where every command ends, and what happens when something goes wrong meanwhile."""

import numpy as np
import pytest

from kerfgym.envs.control.panel import LEVEL, Panel
from kerfgym.envs.engine.quantity import InvalidInput

CALM = LEVEL.varied(head={"noise": 0.0, "jitter": 0.0, "nominal": True})
RISING = CALM.varied(sheet={"tilt": 0.02})  # 4 mm over 200 mm


def bumpless(panel: Panel, slew: float = 10.0) -> bool:
    """While the supervisor commands, no command is more than the handover's slew below the one before; in planned moves
    none is so much above it either. Away from the sheet it goes at once elsewhere."""
    log = panel.log()
    own = log["mode"] != 4  # not following: there the law may do what it wants
    moves = np.isin(log["mode"], (1, 2, 3))
    change = np.diff(log["command"])
    falls, rises = own[1:] & own[:-1], moves[1:] & moves[:-1]
    return bool((change[falls] >= -slew - 1e-9).all() and (change[rises] <= slew + 1e-9).all())


# ------------------------------------------------------------------------------------------------------- end states


@pytest.mark.parametrize("seed", [0, 1, 2, 17])
def test_homing_gives_the_encoder_its_zero_and_ends_at_an_index_pulse(seed):
    coast = float(np.random.default_rng(seed).uniform(-5.0, 5.0))
    panel = Panel(scenario=LEVEL, seed=seed, gap=15.0, coast=coast)
    assert panel.home().done
    assert panel["head"] % 10.0 == pytest.approx(0.0, abs=0.02) or panel["head"] % 10.0 > 9.98
    assert panel.position == pytest.approx(panel["head"], abs=2e-3)
    assert bumpless(panel)


@pytest.mark.parametrize("target", [50.0, 5.0, 20.5])
def test_a_move_ends_at_rest_at_its_target(target):
    panel = Panel(scenario=CALM, gap=20.0)
    assert panel.move(target).done
    panel.wait(0.1)
    assert panel["head"] == pytest.approx(target, abs=3e-3)
    assert abs(panel["velocity"]) < 0.05
    assert bumpless(panel)


def test_centring_is_a_move_to_the_middle():
    panel = Panel(scenario=CALM, gap=3.0)
    assert panel.centre().done
    assert panel["head"] == pytest.approx(50.0, abs=3e-3)


@pytest.mark.parametrize(("distance", "speed"), [(10.0, 10.0), (5.0, 20.0)])
def test_after_calibrating_on_the_machine_the_reported_height_is_the_true_one(distance, speed):
    panel = Panel(scenario=LEVEL, seed=3, gap=2.0)
    assert panel.calibrate(distance, speed).done
    assert panel.table.usable == pytest.approx(1000 * distance / speed, rel=0.05)
    assert panel.follow(1.0).done
    panel.wait(0.5)
    log = panel.log()
    assert np.mean(log["height"][-300:] - log["gap"][-300:]) == pytest.approx(0.0, abs=5e-3)
    assert panel["gap"] == pytest.approx(1.0, abs=0.02)


def test_protection_stands_still_while_far_and_lifts_where_the_sheet_comes_near():
    panel = Panel(scenario=RISING, gap=2.0)
    panel.tick()
    assert panel.protect(0.8).done
    head = panel["head"]
    panel.wait(0.2)
    assert panel["head"] == pytest.approx(head, abs=1e-3)
    panel.feed = 50.0
    panel.wait(2.0)
    highest = panel["head"]
    panel.feed = -50.0
    panel.wait(1.0)  # the sheet falls again; the head stays
    log = panel.log()
    assert not panel.collided
    assert panel.lowest > 0.7
    assert np.diff(log["head"]).min() > -2e-3  # it never lowers the head
    assert highest > head + 0.5
    assert panel["head"] == pytest.approx(highest, abs=0.05)
    assert panel["gap"] > 1.5


def test_a_protection_height_above_the_set_height_lifts_and_following_comes_down_again_without_a_bump():
    panel = Panel(scenario=CALM, gap=1.0)
    panel.follow(1.0)
    assert panel.protect(2.0).done
    panel.wait(1.0)
    assert 2.0 <= panel["gap"] < 2.25
    assert panel.follow(1.0).done
    assert not panel.collided
    assert panel.lowest > 0.95
    assert bumpless(panel)


def test_following_goes_no_faster_than_its_speed():
    panel = Panel(scenario=CALM, gap=8.0)
    assert panel.follow(1.0, speed=5.0).done
    assert np.abs(panel.log()["velocity"]).max() < 5.5


# ------------------------------------------------------------------------------------------------- what may go wrong


@pytest.mark.parametrize("second", ["home", "move", "calibrate", "follow", "protect", "stop"])
@pytest.mark.parametrize("first", ["home", "move", "calibrate", "follow"])
def test_a_command_during_a_motion_first_stops_it(first, second):
    panel = Panel(scenario=CALM, gap=15.0)
    panel.request(first, target=60.0)
    panel.wait(0.12)
    before = panel["command"]
    panel.request(second, target=30.0)
    panel.wait(0.2)
    assert panel.mode == second or (second == "calibrate" and panel.mode == "calibrate")
    assert panel.alarm == "none"
    assert bumpless(panel)
    assert not panel.collided
    assert abs(panel["command"]) <= max(abs(before), 150.0) + 1e-9


def test_a_lost_sensor_lifts_the_head_and_is_latched():
    panel = Panel(scenario=CALM, gap=1.0)
    panel.follow(1.0)
    panel.break_("cable")
    outcome = panel.until(lambda: False, 0.5)
    assert outcome.alarm == "sensor lost"
    panel.wait(0.5)
    assert panel["gap"] > 5.0  # up, not down as the reading asks for
    assert panel.lowest > 0.9
    assert not panel.follow(1.0).done
    assert panel.stop().done
    assert panel.alarm == "none"
    assert panel.follow(1.0).alarm == "sensor lost"


def test_a_missing_index_pulse_ends_homing_with_its_alarm_after_a_bit_more_than_a_revolution():
    panel = Panel(scenario=CALM, gap=60.0)
    panel.break_("index")
    outcome = panel.home()
    assert not outcome.done
    assert outcome.alarm == "index pulse missing"
    assert 95.0 - 13.0 < panel["head"] < 95.0 - 11.0
    panel.wait(0.1)
    assert abs(panel["velocity"]) < 0.05


def test_a_home_switch_that_never_closes_ends_homing_at_the_limit():
    panel = Panel(scenario=CALM, gap=60.0)
    panel.break_("switch")
    outcome = panel.home()
    assert not outcome.done
    assert outcome.alarm == "limit"
    panel.wait(0.2)
    assert 108.0 < panel["head"] < 111.0
    assert abs(panel["velocity"]) < 0.05


def test_an_unknown_command_stops_the_machine_with_an_alarm():
    panel = Panel(scenario=CALM, gap=1.0)
    panel.follow(1.0)
    panel.send(23.0)
    panel.wait(0.2)
    assert panel.mode == "alarm"
    assert panel.alarm == "unknown command"
    assert abs(panel["velocity"]) < 0.05


def test_contact_during_a_move_down_retracts():
    panel = Panel(scenario=CALM, gap=5.0)
    outcome = panel.move(panel["head"] - 6.0)
    assert outcome.alarm == "collision"
    panel.wait(0.5)
    assert panel["gap"] > 4.0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda p: p.move(500.0), "target = 500 mm"),
        (lambda p: p.follow(0.0), "height = 0 mm"),
        (lambda p: p.follow(1.0, speed=0.0), "speed = 0 mm/s"),
        (lambda p: p.protect(-1.0), "height = -1 mm"),
        (lambda p: p.calibrate(distance=0.1), "distance = 0.1 mm"),
        (lambda p: p.request("folow"), "follow"),
        (lambda p: p.break_("indx"), "index"),
    ],
)
def test_bad_commands_are_refused_and_nothing_moves(call, words):
    panel = Panel(scenario=CALM, gap=5.0)
    with pytest.raises(InvalidInput, match=words.replace("(", r"\(")):
        call(panel)
    panel.wait(0.05)
    assert panel.mode == "stop"
    assert panel["command"] == 0.0
