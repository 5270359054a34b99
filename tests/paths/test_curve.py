"""Curves: chords, tangents and corners, against closed forms."""

import numpy as np
import pytest

from kerfgym.envs.paths.curve import CHORD, arc, key, linked, polyline, smooth, turns


@pytest.mark.parametrize("angle", [0.3, -1.0, np.pi, -2 * np.pi])
@pytest.mark.parametrize("radius", [0.01, 3.0, 4000.0])
def test_an_arc_keeps_its_radius_its_ends_and_its_tangents(radius, angle):
    start = 5 + 2j + radius
    end = 5 + 2j + radius * np.exp(1j * angle)
    curve = arc(5 + 2j, start, end, angle)
    z = curve.points @ [1, 1j]
    assert (z[0], z[-1]) == (start, pytest.approx(end))
    assert abs(z - (5 + 2j)) == pytest.approx(radius)
    assert abs(0.5 * (z[1:] + z[:-1]) - (5 + 2j)).min() >= radius - 1.001 * CHORD
    assert curve.start == pytest.approx(1j * np.sign(angle))
    assert curve.end == pytest.approx(1j * np.sign(angle) * np.exp(1j * angle))
    assert curve.corners.tolist() == []


def test_an_arc_whose_radii_differ_ends_where_it_is_told():
    curve = arc(0, 10, 10.2j, np.pi / 2)
    assert curve.points[-1].tolist() == [0, 10.2]
    radii = np.hypot(*curve.points.T)
    assert (np.diff(radii) > 0).all()


def test_a_smooth_curve_stays_within_the_chord_error():
    def at(t):
        return 50 * t + 20j * np.sin(3 * t)

    curve = smooth(at, [0.0, 4.0])
    t = np.linspace(0, 4, 200_001)
    height = np.interp(50 * t, *curve.points.T)
    steep = np.hypot(1, 60 * np.cos(3 * t) / 50)  # the error across the curve is that in height over this
    assert abs((height - 20 * np.sin(3 * t)) / steep).max() <= CHORD
    assert len(curve.points) < 500


def test_an_s_that_its_chord_halves_is_not_taken_for_straight():
    curve = smooth(lambda t: 10 * t + 1j * np.sin(2 * np.pi * t), [0.0, 1.0])
    assert curve.points[:, 1].max() == pytest.approx(1.0, abs=CHORD)
    assert curve.points[:, 1].min() == pytest.approx(-1.0, abs=CHORD)


def test_a_smooth_curve_has_corners_only_at_breaks_where_it_turns():
    def at(t):
        return t + 1j * np.abs(t - 2) + 1j * (t - 1) ** 2

    curve = smooth(at, [0.0, 1.0, 2.0, 3.0])
    assert curve.points[curve.corners] == pytest.approx(np.array([[2, 1]]))


def test_curves_are_linked_with_corners_between_them_and_at_the_closing_point():
    half = arc(0, 10, -10, np.pi)
    moon = linked([half, polyline([-10, 10])], closed=True)
    last = len(half.points) - 1
    assert moon.corners.tolist() == [0, last]
    assert (moon.points[0] == moon.points[-1]).all()
    assert len(moon.points) == last + 2
    disc = linked([half, arc(0, -10, 10, np.pi)], closed=True)
    assert disc.corners.tolist() == []


def test_repeated_points_and_curves_of_no_length_change_nothing():
    plain = linked([polyline([0, 10]), polyline([10, 10 + 5j])])
    doubled = linked([polyline([0, 0, 10, 10]), polyline([10, 10]), polyline([10, 10, 10 + 5j, 10 + 5j])])
    assert doubled.points.tolist() == plain.points.tolist()
    assert doubled.corners.tolist() == plain.corners.tolist() == [1]


@pytest.mark.parametrize("closed", [False, True])
def test_backwards_and_backwards_again_is_the_same(closed):
    curve = linked([polyline([0, 10, 10 + 10j, 7 + 15j, 10j])], closed)
    back = curve.reversed()
    again = back.reversed()
    assert back.points.tolist() == curve.points[::-1].tolist()
    assert sorted(map(tuple, back.points[back.corners])) == sorted(map(tuple, curve.points[curve.corners]))
    assert again.corners.tolist() == curve.corners.tolist()
    assert (again.start, again.end) == (curve.start, curve.end)
    assert (0 in curve.corners.tolist()) == (0 in back.corners.tolist()) == closed


def test_an_affine_image_keeps_corners_and_turns_tangents():
    curve = linked([arc(0, 10, 10j, np.pi / 2), polyline([10j, -5 + 10j, -5])])
    image = curve.mapped(lambda z: 3 * z.real + 1j * z.imag + 7)
    assert image.points == pytest.approx(curve.points * [3, 1] + [7, 0])
    assert image.corners.tolist() == curve.corners.tolist()
    assert not turns(image.start, 1j)


def test_a_curve_and_its_reverse_have_one_key():
    curve = arc(0, 10, 10j, np.pi / 2)
    assert key(curve.points) == key(curve.reversed().points)
    assert key(curve.points) != key(arc(0, 10, 10j, -3 * np.pi / 2).points)
