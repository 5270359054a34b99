"""What is cut when: within before around, and on a short way."""

import itertools
import time

import numpy as np
import pytest

from kerfgym.envs.paths.curve import Curve
from kerfgym.envs.paths.nesting import nested
from kerfgym.envs.paths.order import nearest, ordered
from kerfgym.envs.paths.tour import improved


def length(order, turned, ends):
    first, last = ends[order, turned], ends[order, 1 - turned]
    return np.hypot(*first[0]) + np.hypot(*(first[1:] - last[:-1]).T).sum()


def ring(x, y, r, points=24):
    angle = np.linspace(0.0, 2 * np.pi, points + 1)
    p = np.stack([x + r * np.cos(angle), y + r * np.sin(angle)], axis=1)
    p[-1] = p[0]
    return Curve(p, np.zeros(0, np.int64), 1j, 1j, closed=True)


def random_case(seed, n=30):
    """Open and closed contours, some of which must wait for others."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(0, 100, (n, 2, 2))
    ends[::2, 1] = ends[::2, 0]
    around = [[int(rng.integers(i + 1, n))] if i < n - 5 and rng.random() < 0.6 else [] for i in range(n)]
    return ends, around


@pytest.mark.parametrize("seed", range(20))
def test_what_must_come_first_does_and_the_way_gets_no_longer(seed):
    ends, around = random_case(seed)
    start = nearest(ends, around)
    better = improved(*start, ends, around)
    for order, _ in (start, better):
        place = np.argsort(order)
        assert sorted(order.tolist()) == list(range(len(ends)))
        assert all(place[inner] < place[outer] for inner, outers in enumerate(around) for outer in outers)
    assert length(*better, ends) <= length(*start, ends) + 1e-9


def brute_force(ends, around):
    """The same as ``nearest``, by looking at every end every time."""
    order, turned, here = [], [], np.zeros(2)
    waits = [sum(i in outers for outers in around) for i in range(len(ends))]
    while len(order) < len(ends):
        free = [i for i in range(len(ends)) if i not in order and not waits[i]]
        way = {(i, e): np.hypot(*(ends[i, e] - here)) for i in free for e in (0, 1)}
        i, e = min(way, key=lambda k: (way[k], k))
        order.append(i)
        turned.append(e)
        here = ends[i, 1 - e]
        for outer in around[i]:
            waits[outer] -= 1
    return order, turned


def on_a_grid(seed, n=150):
    """Many ends in one place and many as far as each other; a third of the contours wait."""
    rng = np.random.default_rng(seed)
    ends = rng.integers(0, 5, (n, 2, 2)).astype(float)
    around = [[int(rng.integers(i + 1, n))] if i < n - 5 and rng.random() < 0.3 else [] for i in range(n)]
    return ends, around


@pytest.mark.parametrize("case", [random_case(3, 150), random_case(4, 60), on_a_grid(0), on_a_grid(1)])
def test_the_next_contour_is_the_nearest_that_is_free_and_of_several_the_first(case):
    order, turned = nearest(*case)
    assert (order.tolist(), turned.tolist()) == brute_force(*case)


def test_few_contours_come_close_to_the_shortest_of_all_orders():
    shares = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        points = rng.uniform(0, 100, (7, 2))
        ends, around = np.stack([points, points], axis=1), [[] for _ in points]
        shortest = min(length(np.array(p), np.zeros(7, np.int64), ends) for p in itertools.permutations(range(7)))
        shares.append(length(*improved(*nearest(ends, around), ends, around), ends) / shortest)
    assert np.mean(shares) < 1.03
    assert max(shares) < 1.2


def test_a_tenth_of_the_way_is_saved_on_a_sheet_of_holes():
    points = np.random.default_rng(0).uniform(0, 1000, (600, 2))
    ends, around = np.stack([points, points], axis=1), [[] for _ in points]
    start = nearest(ends, around)
    assert length(*improved(*start, ends, around), ends) < 0.92 * length(*start, ends)


def test_rings_in_rings_are_holes_and_parts_in_turn():
    rings = [ring(0, 0, r) for r in (5, 30, 10, 20)] + [ring(0, 25, 1)]
    found = nested([c.points for c in rings], [True] * 5)
    assert found.depth.tolist() == [3, 0, 2, 1, 1]
    assert found.hole.tolist() == [True, False, False, True, True]
    assert found.around == [[2], [], [3], [1], [1]]


def test_open_contours_wait_for_nothing_and_are_waited_for():
    scratch = Curve(np.array([[1.0, 0.0], [2.0, 0.0]]), np.zeros(0, np.int64), 1, 1)
    order = ordered([ring(0, 0, 10), scratch, ring(0, 0, 5)])
    assert [len(c.points) for c in order] == [2, 25, 25]
    assert np.hypot(*order[1].points[0]) == pytest.approx(5.0)


def test_a_sheet_of_four_thousand_holes_is_ordered_in_seconds():
    grid = [ring(20.0 * i, 20.0 * j, 4.0, 12) for i in range(80) for j in range(50)]
    frame = np.array([[-10, -10], [1600, -10], [1600, 1000], [-10, 1000], [-10, -10]], float)
    began = time.process_time()
    order = ordered([Curve(frame, np.array([1, 2, 3]), 1, -1j, closed=True), *grid])
    assert time.process_time() - began < 10.0  # CPU-seconds; it takes about one
    assert len(order) == 4001
    assert len(order[-1].points) == 5
    steps = [np.hypot(*(b.points[0] - a.points[-1])) for a, b in itertools.pairwise(order[:-1])]
    assert np.mean(steps) < 1.15 * 20.0  # no order is shorter than 20 mm a hole


def test_what_is_level_within_a_part_is_cut_before_it():
    square = np.array([[0, 0], [50, 0], [50, 50], [0, 50], [0, 0]], float)
    level = Curve(np.array([[40.0, 25.0], [45.0, 25.0]]), np.zeros(0, np.int64), 5, 5)
    outline = Curve(square, np.arange(4), 50, -50j, closed=True)
    assert nested([square, level.points], [True, False]).around == [[], [0]]
    assert [c.closed for c in ordered([outline, level])] == [False, True]
