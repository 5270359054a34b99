"""Cleaning and joining: what is there twice is cut once, gaps are bridged as far as one wants, and both are told."""

import numpy as np
import pytest
import shapely

from kerfgym.envs.paths.cleaning import without_doubles, without_overlaps
from kerfgym.envs.paths.crossings import meetings
from kerfgym.envs.paths.curve import Curve, arc, line, polyline, smooth
from kerfgym.envs.paths.joining import joined


def lines(*pairs):
    return [line(complex(*a), complex(*b)) for a, b in pairs]


def rectangle(x=0.0, y=0.0, width=100.0, height=60.0):
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)]
    return polyline([complex(*c) for c in corners])


def sides(*corners):
    return lines(*zip(corners, [*corners[1:], corners[0]], strict=True))


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.5707, 3.1])
def test_lines_on_one_another_are_cut_once(angle):
    turn = np.exp(1j * angle)
    spans = ((0, 70), (50, 100), (10, 20), (200, 230), (230, 200.5))
    drawn = [line(turn * (a + 5j), turn * (b + 5j)) for a, b in spans]
    kept, told = without_overlaps(drawn)
    flat = shapely.unary_union([shapely.LineString([(a, 5), (b, 5)]) for a, b in spans])
    assert sum(c.length for c in kept) == pytest.approx(flat.length) == pytest.approx(130)
    assert told.length == pytest.approx(sum(c.length for c in drawn) - 130)
    contours, _ = joined(kept)
    assert sorted(c.length for c in contours) == pytest.approx([30, 100])


def test_a_line_on_a_side_of_an_outline_goes_and_the_outline_stays():
    kept, told = without_overlaps([rectangle(), *lines(((0, 0), (70, 0)), ((90, 60), (130, 60)))])
    assert [round(c.length, 6) for c in kept] == [320, 30]
    assert told.overlapping == 2


def test_lines_that_meet_others_keep_a_vertex_there():
    drawn = [*lines(((0, 0), (60, 0)), ((40, 0), (100, 0)), ((40, 0), (40, 30)), ((60, 0), (60, 30)))]
    kept, _ = without_overlaps(drawn)
    ends = {tuple(end) for c in kept for end in c.points.round(6).tolist()}
    assert {(40.0, 0.0), (60.0, 0.0)} <= ends
    assert sum(c.length for c in kept) == pytest.approx(160)


def test_lines_that_only_meet_or_cross_or_run_beside_each_other_stay():
    star = [line(0, 100 * np.exp(1j * a)) for a in np.linspace(0.0, 0.002, 30)]
    near = lines(((0, -5), (100, -5)), ((0, -5.01), (100, -5.01)), ((100, -5), (200, -5)))
    drawn = [*star, *near]
    kept, told = without_overlaps(drawn)
    assert sum(c.length for c in kept) == pytest.approx(sum(c.length for c in drawn))
    assert told.overlapping == 0


def test_the_chords_of_a_circle_are_no_lines_to_be_cleaned():
    circles = [arc(0j, 10 + 0j, 10 + 0j, 2 * np.pi), arc(0j, 10j, 10j, 2 * np.pi)]
    assert without_overlaps(circles)[0] == circles


def test_two_parts_that_share_an_edge_keep_it_and_it_is_told():
    pair = [closed(rectangle()), closed(rectangle(x=100.0))]
    kept, told = without_overlaps(pair)
    assert (sum(c.length for c in kept), told.overlapping) == (pytest.approx(640), 0)
    (meeting,) = meetings([c.points for c in kept], [True, True]).found
    assert (meeting.first, meeting.second, meeting.along) == (0, 1, pytest.approx(60, abs=0.05))
    assert (meeting.x, meeting.y) == pytest.approx((100, 30), abs=0.05)


def closed(curve):
    return Curve(curve.points, curve.corners, curve.start, curve.end, True)


def test_closed_contours_that_are_the_same_are_cut_once_wherever_they_begin():
    shifted = polyline([100, 100 + 60j, 60j, 0, 100])
    circle = smooth(lambda t: 200 + 5 * np.exp(1j * t), np.linspace(0, 2 * np.pi, 5))
    other = smooth(lambda t: 200 + 5 * np.exp(-1j * (t + 1)), np.linspace(0, 2 * np.pi, 5))
    beside = rectangle(x=0.5)
    kept, told = without_doubles([closed(c) for c in (rectangle(), shifted, circle, other, beside)])
    assert len(kept) == 3
    assert (told.doubled, told.length) == (2, pytest.approx(320 + 10 * np.pi, rel=1e-3))


def test_a_closed_contour_that_encloses_nothing_is_cut_as_a_line():
    kept, told = without_doubles([closed(polyline([20 + 50j, 80 + 50j, 60 + 50j, 20 + 50j])), closed(rectangle())])
    assert (kept[0].closed, kept[0].points.tolist()) == (False, [[20, 50], [80, 50]])
    assert (told.flat, told.length) == (1, pytest.approx(60))


# Joining


@pytest.mark.parametrize(("tolerance", "shut"), [(0.05, False), (0.29, False), (0.31, True), (2.0, True)])
def test_gaps_are_joined_up_to_the_tolerance_and_told(tolerance, shut):
    drawn = lines(((0, 0), (10, 0)), ((10, 0.3), (10, 10)), ((10, 10), (0, 10)), ((0, 10), (0, 0)))
    (contour,), joints = joined(drawn, tolerance)
    assert contour.closed == shut
    told = joints.bridged if shut else joints.apart
    assert [gap for *_, gap in told if gap > 1e-9] == ([] if tolerance == 0.0 else [pytest.approx(0.3)] * len(told))
    assert len([g for g in joints.bridged if g[2] > 0.1]) == shut
    assert len(joints.apart) == (not shut)


def test_of_three_ends_the_nearest_two_are_joined():
    drawn = lines(((0, 0), (10, 0)), ((10.02, 0), (20, 0)), ((10, 0.04), (10, 10)))
    contours, joints = joined(drawn)
    assert sorted(c.length for c in contours) == pytest.approx([9.96, 20])
    assert [gap for *_, gap in joints.bridged] == pytest.approx([0.02])


def test_a_wide_tolerance_does_not_close_a_short_line_on_itself():
    contours, joints = joined(lines(((0, 0), (0.5, 0)), ((50, 0), (60, 0))), 1.0)
    assert [c.closed for c in contours] == [False, False]
    assert joints.bridged == ()


def test_thousands_of_ends_in_one_place_take_no_time():
    contours, _ = joined([line(0, 100 * np.exp(1j * a)) for a in np.linspace(0, 6.0, 4001)])
    assert sum(c.length for c in contours) == pytest.approx(400100)
