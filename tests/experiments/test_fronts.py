"""Fronts of a cut: hypervolume, learned policies, what nothing can beat."""

import numpy as np
import pytest

from kerfgym.agents.policy import Policy
from kerfgym.baselines import recipe
from kerfgym.envs.control import stack as stacks
from kerfgym.envs.plant import published
from kerfgym.experiments.studies.fronts import bound, comparing, learn, points, policies
from kerfgym.experiments.tune import study_file
from kerfgym.experiments.tune.evaluate import Evaluator

ZERO, ONE = np.zeros(4), np.ones(4)


def test_one_point_encloses_the_product_of_its_distances_from_the_corner():
    at = np.array([[0.25, 0.5, 0.1, 0.2]])
    assert points.hypervolume(at, ZERO, ONE) == pytest.approx(0.75 * 0.5 * 0.9 * 0.8, rel=1e-12)


def test_a_hypervolume_is_the_share_of_random_points_that_the_front_betters():
    random = np.random.default_rng(3)
    front = random.random((20, 4))
    thrown = random.random((200_000, 4))
    covered = (front[None] <= thrown[:, None]).all(axis=2).any(axis=1).mean()
    assert points.hypervolume(front, ZERO, ONE) == pytest.approx(covered, abs=4 * np.sqrt(0.25 / len(thrown)))


def test_a_hypervolume_does_not_depend_on_units_and_not_on_points_outside_the_box():
    front = np.random.default_rng(4).random((8, 4))
    scale = np.array([1e3, 1e-3, 7.0, 2.0])
    more = np.vstack([front * scale + 5.0, [[1e9, -1e9, 0.0, 0.0]], np.full((1, 4), np.nan)])
    same = points.hypervolume(more, 5.0 * ONE, 5.0 + scale)
    assert same == pytest.approx(points.hypervolume(front, ZERO, ONE), rel=1e-9)


def test_failed_and_bettered_and_repeated_points_are_not_on_a_front():
    table = np.array([[1.0, 2.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0], [np.nan, 0.0], [0.0, np.inf]])
    assert points.efficient(table) == [0, 1]


def test_thinning_keeps_what_encloses_most_as_trying_every_pair_would():
    front = np.random.default_rng(5).random((7, 4))
    first = comparing.chosen(front, ZERO, ONE, 1)
    alone = [points.hypervolume(front[[i]], ZERO, ONE) for i in range(7)]
    assert first == [int(np.argmax(alone))]
    second = [i for i in comparing.chosen(front, ZERO, ONE, 2) if i not in first]
    pairs = [points.hypervolume(front[[first[0], i]], ZERO, ONE) for i in range(7)]
    assert second == [int(np.argmax(pairs))]


def _member(values: np.ndarray, outside: str = "") -> comparing.Member:
    return comparing.Member("m", values, outside)


def test_a_member_that_failed_once_or_left_the_calibrated_settings_encloses_nothing():
    values = np.full((6, 2, 4), 0.5)
    lost = values.copy()
    lost[2, 1] = np.nan
    found = comparing.volumes([[_member(values)], [_member(lost)], [_member(values, "feed by 1 mm/s")]], ZERO, ONE)
    assert [round(each.value, 12) for each in found[:3]] == [0.0625, 0.0, 0.0]
    assert found[3].value == pytest.approx(-0.0625)


def test_the_interval_of_a_hypervolume_holds_it_and_is_none_where_all_seeds_are_alike():
    random = np.random.default_rng(6)
    front = [_member(0.2 + 0.5 * random.random((20, 3, 4))) for _ in range(5)]
    found = comparing.volumes([front], ZERO, ONE)[0]
    assert found.value == pytest.approx(points.hypervolume(np.array([m.figures() for m in front]), ZERO, ONE))
    assert found.low < found.value < found.high
    still = comparing.volumes([[_member(np.full((6, 2, 4), 0.5))]], ZERO, ONE)[0]
    assert still.low == still.value == still.high


def test_the_weightings_mean_best_value_is_proportional_to_the_hypervolume():
    random = np.random.default_rng(7)
    fronts = [random.random((6, 4)), 0.3 + 0.7 * random.random((6, 4))]
    fronts = [
        np.vstack([front, [[0.0, 1.0, 1.0, 1.0], [1.0, 0.0, 1.0, 1.0]], np.eye(4)[2:] * -1 + 1]) for front in fronts
    ]
    means = []
    for front in fronts:
        drawn = np.abs(np.random.default_rng(8).normal(size=(20_000, 4)))
        drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
        means.append(np.mean([max(learn.values(front, w, ONE).max(), 0.0) ** 4 for w in drawn]))
    volumes = [points.hypervolume(front, ZERO, ONE) for front in fronts]
    assert means[0] / means[1] == pytest.approx(volumes[0] / volumes[1], rel=0.05)


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    """The plain method's figures on two tune seeds."""
    team = stacks.asked(policies.BASE)
    return learn.figures(Evaluator(team, learn.SUITE, range(2)), team)


def test_a_policy_that_never_slows_down_cuts_as_the_plain_method_does(plain, tmp_path):
    numbers = np.zeros(policies.SIZE)
    numbers[:2] = 1.0
    found = policies.policy(numbers)
    evaluator = Evaluator(policies.team(found), learn.SUITE, range(2))
    assert learn.figures(evaluator, policies.team(found)) == pytest.approx(plain, rel=1e-12)
    assert evaluator.outside == ""
    found.save(tmp_path / "policy")
    again = stacks.asked(str(tmp_path / "policy"))
    assert learn.figures(evaluator, again) == pytest.approx(plain, rel=1e-12)
    assert Policy.load(tmp_path / "policy").document.control == "direct"


def test_no_numbers_of_a_policy_leave_the_calibrated_settings():
    random = np.random.default_rng(9)
    for _ in range(3):
        numbers = random.uniform(learn.LEAST, learn.MOST, policies.SIZE)
        numbers[0] = 0.6
        team = policies.team(policies.policy(numbers))
        evaluator = Evaluator(team, learn.SUITE, range(1))
        learn.figures(evaluator, team)
        assert evaluator.outside == ""


def test_the_catalogue_has_no_feed_beyond_what_was_published_for_its_dither():
    settings = bound.catalogue()
    assert settings.feed.max() == pytest.approx(1000 / 60)  # Huang2024 Table 2, with ±0.3 mm
    assert (np.diff(settings.feed) >= 0).all()
    assert published.fastest(bound.evidence.calibrated("c45-10"), 0.0) == pytest.approx(500 / 60)


def test_a_bound_on_one_feed_is_the_best_setting_of_it():
    settings = bound.Catalogue(np.array([2.0, 4.0, 4.0]), np.array([0.5, 0.7, 0.6]), np.array([10.0, 30.0, 40.0]))
    way = bound.Way(np.array([4.0]), np.array([8.0]), 1.5)
    assert bound.best(way, settings, np.array([1.0, 0.0, 0.0])) == pytest.approx([3.5, 0.7, 30.0])
    assert bound.best(way, settings, np.array([0.0, 1.0, 0.0])) == pytest.approx([5.5, 0.5, 10.0])
    assert bound.best(way, settings, np.array([0.0, 0.0, 1.0])) == pytest.approx([5.5, 0.5, 10.0])


def test_the_plain_method_is_not_better_than_the_bound(plain):
    from kerfgym.envs import scenarios

    way = bound.way(scenarios.load("cut-square"), 0)
    least = bound.best(way, bound.catalogue(), np.array([1.0, 0.0, 1e-3]))
    team = stacks.asked(policies.BASE)
    own = Evaluator(team, learn.SUITE, range(1)).whole(team, points.METRICS)["cut-square"]
    assert least[0] <= own["time"][0] <= 1.02 * least[0]
    assert 0.97 * own["roughness"][0] < least[2] <= own["roughness"][0]


def test_the_study_of_the_front_searches_within_the_calibrated_settings():
    task = study_file.read("cutting-front").searches["rules"]
    assert task.metrics == points.METRICS
    ends = {axis.name: (axis.low, axis.high) for axis in task.space.axes}
    assert ends["law.x"][1] <= 0.3
    assert ends["law.override"][1] <= 1.0
    fixed = {name: p.value for name, p in task.base.parameters().items()}
    assert fixed["law.frequency"] == 2000.0
    assert fixed["law.overlap"] == 0.0
    assert fixed["law.z"] <= 1.0
    assert task.base.process.law.Params is not recipe.Params
