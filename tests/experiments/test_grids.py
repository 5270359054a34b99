"""Grids: from what a user asks for to what is run against what."""

import pytest

from kerfgym.envs import scenarios
from kerfgym.envs.control import stack
from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.experiments.measure.grids import DEFAULT, SHOWN, Grid, can_do, plan, shipped

TEAM = "z=pid,xy=wu"


def by_suite(**asked):
    return {grid.suite: grid for grid in plan(**asked)}


def test_nothing_asked_for_is_the_following_suite():
    (grid,) = plan()
    assert (grid.suite, grid.controllers, len(grid.seeds)) == ("following", DEFAULT, 200)


def test_several_suites_are_a_grid_each_with_seeds_and_controllers_of_its_own():
    grids = by_suite(suites=["following", "contour", "cutting"])
    assert list(grids) == ["following", "contour", "cutting"]
    assert [len(grid.seeds) for grid in grids.values()] == [200, 20, 20]
    for suite in ("contour", "cutting"):
        assert grids[suite].controllers == tuple(scenarios.rules(suite)["controllers"])
        assert grids[suite].core == scenarios.core(suite)
        assert grids[suite].with_jobs


def test_a_controller_goes_where_it_can_do_something():
    grids = by_suite(suites=SHOWN, controllers=["pid", "wu", "recipe", TEAM])
    assert grids["following"].controllers == ("pid",)
    assert grids["contour"].controllers == grids["cutting"].controllers == ("pid", "wu", "recipe", TEAM)
    assert [can_do(name, False) for name in ("pid:law.kp=30", "z=observer", "xy=wu", TEAM)] == [
        True,
        True,
        False,
        False,
    ]


def test_a_tuned_team_is_known_as_one_without_its_name_saying_so(tmp_path):
    for name, base in (("team", TEAM), ("alone", "pid")):
        (tmp_path / f"{name}.toml").write_text(f'controller = "{base}"\n[parameters]\n', encoding="utf-8")
    assert stack.is_team(str(tmp_path / "team.toml"))
    assert not can_do(str(tmp_path / "team.toml"), False)
    assert can_do(str(tmp_path / "alone.toml"), False)


def test_scenarios_name_their_suites_if_nobody_else_does():
    grids = by_suite(named=["wavy", "cut-square", "fast-step", "step"])
    assert {name: [s.name for s in grid.scenarios] for name, grid in grids.items()} == {
        "following": ["wavy", "step"],
        "cutting": ["cut-square"],
        "ood": ["fast-step"],
    }
    mine, job = scenarios.load("wavy").varied(name="mine"), scenarios.load("cut-square").varied(name="job")
    assert list(by_suite(named=[mine, job])) == ["following", "contour"]
    dealt = by_suite(suites=["ood", "cutting"], named=[mine, job])
    assert [s.name for grid in dealt.values() for s in grid.scenarios] == ["mine", "job"]


def test_one_suite_takes_whatever_scenario_it_is_given():
    (grid,) = plan(suites=["cutting"], named=["contour-circle"])
    assert (grid.suite, grid.scenarios[0].name) == ("cutting", "contour-circle")


def test_a_sheet_of_ones_own_counts_beside_a_suites(tmp_path):
    """As in a search, where all that is named counts; of the suite's own, its core."""
    own = tmp_path / "mine.toml"
    own.write_text('name = "mine"\nduration = 2.0\nsettle = 0.5\nfeed = 200.0\nset_height = 1.0\n', encoding="utf-8")
    (grid,) = plan(named=[str(own), "step"])
    assert grid.core == ("mine", "step")
    (grid,) = plan(named=["step"])
    assert grid.core == scenarios.core("following")
    own.write_text(own.read_text(encoding="utf-8").replace("mine", "holes"), encoding="utf-8")  # which is no core's
    (grid,) = plan(named=[str(own), "step"])
    assert grid.core == ("holes", "step")


def test_the_shipped_comparison_holds_every_controller_once_and_every_policy():
    grids = by_suite(everything=True)
    assert tuple(grids) == SHOWN
    every = {name for grid in grids.values() for name in grid.controllers}
    assert every == ({*stack.names()} - {"idle"}) | {*stack.shelved()}
    assert sum(len(grid.controllers) for grid in grids.values()) == len(every)
    assert grids["following"].controllers[: len(DEFAULT)] == DEFAULT
    assert "height-following-ppo" in grids["following"].controllers
    for grid in grids.values():
        slots = {"following": {"z"}, "contour": {"xy", "process"}, "cutting": {"process"}}[grid.suite]
        assert {stack.resolve(name).slot for name in grid.controllers} <= slots
        assert grid.known()


def test_beyond_the_distribution_nobody_is_left_out():
    """Every shipped follower and policy, ``lqg`` as well, not only those that do well there."""
    (grid,) = plan(suites=["ood"])
    followers = {name for name in stack.names() if stack.get(name).slot == "z"} - {"idle"}
    assert set(grid.controllers) == followers | {n for n in stack.shelved() if n.startswith("height-following")}
    assert "lqg" in grid.controllers
    assert plan(suites=["ood"], controllers=["pid"])[0].controllers == ("pid",)


def test_ones_own_controller_is_compared_with_the_shipped_ones():
    grids = by_suite(suites=["ood"], controllers=["pid:law.kp=30"], everything=True)
    assert grids["ood"].controllers == ("pid:law.kp=30", *shipped("ood"))


def test_a_shipped_policy_goes_by_its_name():
    found = stack.resolve("height-following-ppo")
    assert (found.name, found.slot) == ("height-following-ppo", "z")
    with pytest.raises(InvalidInput, match="did you mean 'height-following-ppo'"):
        stack.resolve("height-folowing-ppo")


def test_a_table_is_either_of_jobs_or_not():
    both = tuple(map(scenarios.load, ("wavy", "cut-square")))
    with pytest.raises(InvalidInput, match="cannot share a table"):
        Grid("following", ("pid",), both, range(1000, 1001))
