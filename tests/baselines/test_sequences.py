"""Command sequences: where they end, and what they do when the sensor, the edge or the room is missing."""

import numpy as np
import pytest

from kerfgym.baselines import sequences
from kerfgym.envs import scenarios
from kerfgym.envs.control.panel import LEVEL, Panel
from kerfgym.envs.engine.quantity import InvalidInput

CALM = LEVEL.varied(head={"noise": 0.0, "jitter": 0.0, "nominal": True})


def edged(at: float) -> scenarios.Scenario:
    """A level sheet that ends ``at`` mm along x."""
    void = {"pitch": 2.0 * (at + 50.0), "length": 100.0, "count": 1}
    return LEVEL.varied(sheet={"holes": void})


def test_a_staged_pierce_holds_each_stage_and_ends_at_the_cutting_height():
    panel = Panel(scenario=CALM, gap=10.0)
    outcome = sequences.staged_pierce(panel, 1.0, ((3.0, 0.3), (1.5, 0.2)))
    assert outcome.done
    gap = panel.log()["gap"]
    for height, seconds in ((3.0, 0.3), (1.5, 0.2)):
        assert (np.abs(gap - height) < 0.11).sum() >= 1e3 * seconds
    assert panel["gap"] == pytest.approx(1.0, abs=0.11)
    assert panel.lowest > 0.9
    assert panel.mode == "follow"


def test_pierce_stages_that_rise_are_refused():
    with pytest.raises(InvalidInput, match="each must be at or below"):
        sequences.staged_pierce(Panel(scenario=CALM), 1.0, ((1.5, 0.1), (3.0, 0.1)))


@pytest.mark.parametrize("distance", [15.0, 60.0, 300.0])
def test_a_frog_leap_ends_where_lift_travel_and_land_end_only_sooner(distance):
    ends = {}
    for leap in (sequences.frog_leap, sequences.lift_travel_land):
        panel = Panel(scenario=CALM, gap=1.0)
        panel.follow(1.0)
        start = panel["distance"]
        outcome = leap(panel, distance, 5.0, 1.0)
        assert outcome.done
        assert panel["distance"] - start == pytest.approx(distance, abs=0.01)
        assert panel["gap"] == pytest.approx(1.0, abs=0.11)
        assert panel.lowest > 0.9
        assert panel.mode == "follow"
        assert panel.log()["gap"].max() == pytest.approx(6.0, abs=0.15)
        ends[leap] = outcome.seconds
    assert ends[sequences.frog_leap] < ends[sequences.lift_travel_land] - 0.1


@pytest.mark.parametrize("at", [42.0, 61.3])
def test_the_edge_is_found_where_it_is(at):
    panel = Panel(scenario=edged(at), seed=5, gap=1.0)
    edge = sequences.find_edge(panel, 1.0, 50.0, 150.0)
    assert edge.outcome.done
    assert edge.place == pytest.approx(at, abs=0.1)
    assert not panel.collided
    assert panel.lowest > 0.9


def test_no_edge_within_reach_is_said_so_and_x_stands_still():
    panel = Panel(scenario=edged(400.0), gap=1.0)
    edge = sequences.find_edge(panel, 1.0, 50.0, 60.0)
    assert not edge.outcome.done
    assert np.isnan(edge.place)
    assert panel.feed == 0.0
    assert panel.mode == "protect"


def test_focus_compensation_keeps_the_focus_at_its_depth():
    def shift(x: float) -> float:
        return 0.002 * x  # mm: 0.4 mm over 200 mm

    panel = Panel(scenario=CALM, gap=1.0)
    assert sequences.focus_compensation(panel, 200.0, 50.0, 1.0, shift).done
    log = panel.log()
    under_way = (log["distance"] > 20.0) & (log["distance"] < 199.0)
    focus = log["gap"] + shift(log["distance"])
    assert np.abs(focus[under_way] - 1.0).max() < 0.05
    assert np.ptp(log["gap"][under_way]) > 0.3


def test_a_focus_that_moves_too_far_is_refused():
    with pytest.raises(InvalidInput, match="corrections up to 1 mm"):
        sequences.focus_compensation(Panel(scenario=CALM), 200.0, 50.0, 1.0, lambda x: 0.01 * x)


@pytest.mark.parametrize(
    "sequence",
    [
        lambda p: sequences.staged_pierce(p, 1.0),
        lambda p: sequences.frog_leap(p, 60.0, 5.0, 1.0),
        lambda p: sequences.focus_compensation(p, 100.0, 50.0, 1.0, lambda x: 0.001 * x),
        lambda p: sequences.find_edge(p, 1.0, 50.0, 100.0).outcome,
    ],
)
def test_a_sequence_ends_with_the_alarm_when_the_sensor_is_lost(sequence):
    panel = Panel(scenario=CALM, gap=1.0)
    panel.follow(1.0)
    panel.break_("cable")
    outcome = sequence(panel)
    assert not outcome.done
    assert outcome.alarm == "sensor lost"
    assert panel.feed == 0.0
    panel.wait(0.5)
    assert panel["gap"] > 4.0
    assert not panel.collided
