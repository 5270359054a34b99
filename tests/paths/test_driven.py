"""The driven curve: close to the contour, with curvature that does not jump."""

import numpy as np
import pytest

from kerfgym.envs.paths import driven, parts, profile
from kerfgym.envs.paths.curve import CHORD


def box_distance(xy, width, height, radius):
    """Signed distance of points from a rectangle with rounded corners, lower left at (0, 0)."""
    half = np.array([width, height]) / 2
    q = np.abs(xy - half) - half + radius
    return np.hypot(*np.maximum(q, 0).T) + np.minimum(q.max(axis=1), 0) - radius


def arc(x, y, radius, start, stop, chord):
    count = int(np.ceil(abs(stop - start) / (2 * np.arccos(1 - chord / radius))))
    angle = np.linspace(start, stop, count + 1)
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1)


def rectangle(chord):
    """100 × 60 mm with radii of 10 mm, from the middle of a side."""
    h = np.pi / 2
    centres = [(90, 10), (90, 50), (10, 50), (10, 10)]
    arcs = [arc(x, y, 10, (k - 1) * h, k * h, chord) for k, (x, y) in enumerate(centres)]
    return np.concatenate([[(50, 0)], *arcs, [(50, 0)]])


@pytest.mark.parametrize("chord", [5e-4, CHORD])
@pytest.mark.parametrize("tolerance", [0.002, 0.02])
def test_it_stays_within_the_tolerance_on_both_sides(chord, tolerance):
    assert len(profile.corners_of(rectangle(chord))) == 0
    made = driven.smooth(rectangle(chord), [], tolerance)
    off = box_distance(made.at(np.linspace(0, made.length, 20001)).xy, 100, 60, 10)
    assert abs(off).max() <= tolerance + 1e-4
    assert abs(off).max() > 0.3 * tolerance  # it uses what it may


def test_curvature_goes_from_line_to_arc_without_a_jump():
    made = driven.smooth(rectangle(CHORD), [])
    s = np.linspace(0, made.length, 50001)
    place = made.at(s)
    assert place.curvature.max() < 1.12 / 10
    assert place.curvature.min() > -0.01
    assert abs(np.diff(place.curvature)).max() < 0.12 * s[1]
    off = np.abs(np.gradient(place.curvature, s) - place.curvature_rate)
    assert np.quantile(off, 0.99) < 1e-3  # it jumps at the knots


def test_it_is_travelled_by_arc_length():
    made = driven.smooth(parts.part("rosette").pieces[0], [])
    s = np.linspace(0, made.length, 40001)
    place = made.at(s)
    step = np.diff(place.xy, axis=0)
    np.testing.assert_allclose(np.hypot(*step.T) / np.diff(s), 1.0, atol=3e-5)
    np.testing.assert_allclose(np.hypot(*place.tangent.T), 1.0, atol=1e-12)
    turn = np.diff(np.unwrap(np.arctan2(*place.tangent.T[::-1])))
    np.testing.assert_allclose(turn / np.diff(s), 0.5 * (place.curvature[1:] + place.curvature[:-1]), atol=2e-4)


@pytest.mark.parametrize("radius", [0.5, 5.0, 200.0])
def test_a_coarsely_flattened_circle_is_round_again(radius):
    made = driven.smooth(arc(0, 0, radius, 0, 2 * np.pi, CHORD), [])
    place = made.at(np.linspace(0, made.length, 5001))
    assert abs(np.hypot(*place.xy.T) - radius).max() < 1e-3
    assert abs(place.curvature * radius - 1).max() < (0.15 if radius < 1 else 0.05)
    assert made.length == pytest.approx(2 * np.pi * radius, rel=1e-3)


def test_corners_are_met_exactly_and_lines_are_straight():
    points = np.array([(0, 0), (100, 0), (100, 60), (0, 60), (0, 0)], float)
    made = driven.smooth(points, [1, 2, 3])
    np.testing.assert_allclose(made.distance(made.vertices), [0, 100, 160, 260, 320], atol=1e-9)
    np.testing.assert_allclose(made.at([0, 100, 160, 260, 320]).xy, points, atol=1e-9)
    assert len(made.first) == 4
    before, after = made.kinks()
    np.testing.assert_allclose(before, [(1, 0), (0, 1), (-1, 0)], atol=1e-12)
    np.testing.assert_allclose(after, [(0, 1), (-1, 0), (0, -1)], atol=1e-12)


def test_noise_on_dense_points_does_not_become_curvature():
    at = np.arange(0, 100, 0.05)
    points = np.stack([at, np.round(np.random.default_rng(0).normal(0, 3e-4, len(at)), 3)], axis=1)
    made = driven.smooth(points, [])
    raw = np.abs(profile.turns(np.diff(points, axis=0))).max() / 0.05
    assert np.abs(made.at(np.linspace(1, 98, 9999)).curvature).max() < 0.25 * raw


def test_vertices_keep_their_places_along_the_curve():
    points = rectangle(CHORD)
    made = driven.smooth(points, [])
    there = made.at(made.distance(made.vertices)).xy
    assert np.hypot(*(there - points).T).max() < 0.02
