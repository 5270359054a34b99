"""Corner plants: the ends of whatever a scenario draws of its machine, and nothing of what it cuts."""

import itertools

import numpy as np
import pytest

from kerfgym.envs.control.stack import get
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.plant import heads
from kerfgym.envs.plant.fleet import Fleet
from kerfgym.envs.scenarios import Scenario, load, prepare, suite
from kerfgym.experiments.measure.plants import FULL, MOST, STANDARD, crossed, design, drawn, machines, of


def written(machine, scenario):
    """A fleet with the corner plants of a machine."""
    fleet = Fleet(machine.size, get("pid").law, heads.ensure([0]))
    machine.prepare(fleet, scenario, np.arange(machine.size))
    return fleet


def test_a_machine_is_what_follows_the_sheet_and_not_what_is_cut():
    assert {of(s) for s in suite("following").values()} == {STANDARD}
    assert of(load("wavy").varied(feed=400, set_height=0.3, head={"noise": 0.02, "impulses": 50})) == STANDARD
    assert of(load("wavy").varied(axis={"dead_time": 0.003})) != STANDARD
    assert of(load("wavy").varied(head={"plasma": 0.05})) != STANDARD


def test_the_machines_of_a_suite_are_named_by_what_differs():
    found = {machine.label: names for machine, names in machines(suite("ood").values()).items()}
    assert found["axis.dead_time 0.003"] == ["late-flutter", "late-rough"]
    assert found["axis.bandwidth 40"] == ["soft-step", "soft-rough"]
    assert "fast-step" in found["standard"]
    drawn = of(Scenario(name="x", axis={"bandwidth": {"uniform": [20, 30]}, "dead_time": {"choice": [0.001, 0.004]}}))
    assert drawn.label == "axis.bandwidth 20 … 30, axis.dead_time 0.001 or 0.004"


def test_the_corners_are_the_ends_of_all_that_is_drawn():
    """Among a thousand machines that the scenario draws none lies beyond, in any number of the axis."""
    fixed = {"zeta": 0.7, "latency": 0.0, "friction": 800.0, "bristle": 0.0, "stiction": 1.0, "stribeck": 2.0}
    drawn_ = {"compliance": {"uniform": [0.05, 0.2]}, "backlash": {"log_uniform": [0.001, 0.02]}}
    scenario = Scenario(name="x", axis=fixed | drawn_)
    machine = of(scenario)
    assert machine.size == 2**5
    corners = written(machine, scenario)
    some = Fleet(1000, get("pid").law, heads.POOL)
    prepare(some, scenario, np.arange(1000), np.arange(1000))
    for name in ("omega", "zeta", "dead_time", "omega_r", "friction", "backlash", "compliance", "encoder"):
        ends, drawn = corners.column(f"z.{name}"), some.column(f"z.{name}")
        assert ends.min() <= drawn.min() + 1e-12
        assert drawn.max() <= ends.max() + 1e-12
        assert ends.max() - ends.min() <= 1.02 * np.ptp(drawn) + 1e-12
    varied = [corners.column(f"z.{name}") for name in ("omega", "dead_time", "omega_r", "compliance", "backlash")]
    assert len(np.unique(varied, axis=1).T) == machine.size


def test_limits_of_the_drive_stay_in_the_middle():
    fleet = written(STANDARD, Scenario(name="x"))
    assert set(fleet.column("z.acceleration")) == {14000.0}


def test_the_head_is_nominal_and_quiet():
    machine = of(load("impulses").varied(head={"noise": 0.01, "bursts": 3, "plasma": 0.02}))
    fleet = written(machine, Scenario(name="x"))
    for name in ("noise", "jitter", "impulses", "bursts"):
        assert not fleet.column(f"sensor.{name}").any()
    assert set(fleet.column("sensor.plasma")) == {0.02}


@pytest.mark.parametrize("factors", [0, 1, 4, 6, 7, 10, 20])
def test_any_three_numbers_meet_in_all_combinations_and_there_are_never_too_many_corners(factors):
    table = design(factors)
    assert table.shape == (min(2**factors, MOST), factors)
    for three in itertools.combinations(range(factors), min(3, factors)):
        assert len(np.unique(table[:, list(three)], axis=0)) == 2 ** len(three)


def test_a_machine_that_draws_more_than_can_be_tried_is_refused():
    with pytest.raises(InvalidInput, match="the machine draws 40 numbers; corner plants can be made of at most 32"):
        design(40)
    assert FULL == 6


TABLE = {"bandwidth": (24.0, 30.0, 27.0, 26.0), "zeta": (0.9, 0.7, 0.6, 0.8), "speed": (400.0, 410.0, 390.0, 500.0)}
"""Three numbers that are known together, four rows."""

TOGETHER = {name: {"choice": list(values), "joint": "motion"} for name, values in TABLE.items()}


def test_of_numbers_that_are_known_together_only_rows_are_tried_and_those_with_an_end():
    machine = of(
        Scenario(
            name="x", axis={**TOGETHER, "dead_time": {"uniform": [0.001, 0.002]}, "resonance": 300.0, "latency": 0.0}
        )
    )
    fleet = written(machine, Scenario(name="x"))
    rows = list(zip(*TABLE.values(), strict=True))
    there = {
        tuple(row)
        for row in zip(
            fleet.column("z.omega") / (2 * np.pi), fleet.column("z.zeta"), fleet.column("z.speed"), strict=True
        )
    }
    assert {tuple(np.round(row, 9)) for row in there} == {rows[0], rows[1], rows[2]}  # the last has no end of its own
    assert machine.size == 3 * 2  # each of them at both ends of the dead time
    for words in (
        "axis.bandwidth 24 … 30",
        "axis.zeta 0.6 … 0.9",
        "axis.dead_time 0.001 … 0.002",
        "axis.resonance 300",
    ):
        assert words in machine.label


def test_a_table_of_limits_alone_is_one_row():
    machine = of(Scenario(name="x", axis={"speed": TOGETHER["speed"], "zeta": 0.7, "bandwidth": 60, "dead_time": 0.001,
                                          "resonance": 300.0, "latency": 0.0}))  # fmt: skip
    assert [corner["axis.speed"] for corner in machine.corners] == [400.0]


def test_too_many_combinations_have_each_level_as_often_as_any_other():
    factors = [list(range(n)) for n in (32, 7, 5)]
    found = crossed(factors)
    assert len(found) == MOST
    for i, levels in enumerate(factors):
        counts = np.bincount([row[i] for row in found], minlength=len(levels))
        assert counts.max() - counts.min() <= 1
        assert counts.min() >= 1
    assert crossed([[1, 2], ["a", "b"]]) == [(1, "a"), (1, "b"), (2, "a"), (2, "b")]
    with pytest.raises(InvalidInput, match="numbers of one joint have 65 rows with ends"):
        crossed([list(range(65)), [1, 2]])


def test_machines_that_are_drawn_are_those_of_the_runs_on_the_same_seeds():
    scenario = Scenario(name="x", axis={**TOGETHER, "backlash": {"log_uniform": [0.001, 0.02]}})
    those = drawn(of(scenario), range(1000, 1040))
    fleets = [Fleet(those.size, get("pid").law, heads.ensure([0])) for _ in range(2)]
    those.prepare(fleets[0], Scenario(name="margins", feed=0.0), np.arange(those.size))
    prepare(fleets[1], scenario, np.arange(40), np.array(those.seeds, np.uint64))
    for name in ("omega", "zeta", "speed", "dead_time", "omega_r", "friction", "backlash"):
        assert np.array_equal(fleets[0].column(f"z.{name}"), fleets[1].column(f"z.{name}"))
    assert len(np.unique(fleets[0].column("z.omega"))) == len(TABLE["bandwidth"])
    assert not fleets[0].column("sensor.noise").any()


def test_a_machine_of_which_all_is_known_is_drawn_once():
    fixed = {"bandwidth": 60, "zeta": 0.7, "dead_time": 0.001, "resonance": 300.0, "acceleration": 9000, "latency": 0.0,
             "friction": 800, "stiction": 1.2, "stribeck": 2.0, "bristle": 0.005}  # fmt: skip
    assert not of(Scenario(name="x", axis=fixed)).varies
    assert drawn(of(Scenario(name="x", axis=fixed)), range(1000, 1064)).seeds == (1000,)
    assert drawn(of(Scenario(name="x", axis={**fixed, "zeta": {"uniform": [0.6, 0.8]}})), range(1000, 1064)).size == 64
