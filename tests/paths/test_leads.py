"""Lead-ins: pierced in the scrap, clear of every part, entered where there is room; judged by shapely alone."""

import numpy as np
import pytest
from shapely import LineString, Point, Polygon, box

from kerfgym.envs.paths import parts, route
from kerfgym.envs.paths.curve import Curve
from kerfgym.envs.paths.drawing import drawing
from kerfgym.envs.paths.profile import corners_of
from kerfgym.envs.paths.route import Cut, Cutting, routed
from kerfgym.experiments.studies.leads import sheets_of_parts
from kerfgym.experiments.studies.leads.random_parts import KINDS
from kerfgym.experiments.studies.leads.trespass import WRONG, Material, wrong

HOLE = [(40, 60), (60, 60), (50, 30), (40, 60)]  # its first corner is acute: a right angle there leads into the part


def sheet(*rings, name="sheet"):
    """A drawing of closed rings, in this order."""
    curves = []
    for ring in rings:
        points = np.array(ring, float)
        legs = np.diff(points, axis=0)
        curves.append(Curve(points, corners_of(points), complex(*legs[0]), complex(*legs[-1]), closed=True))
    return drawing(name, name, curves)


def square(x, y, side, begin=0):
    corners = [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]
    corners = corners[begin:] + corners[:begin]
    return [*corners, corners[0]]


def at_a_right_angle(points, hole, length):
    """The rule of version 0.1: at a right angle to the first leg, outside an outline, inside a hole."""
    leg = points[1] - points[0]
    t = leg / np.hypot(*leg)
    outward = np.array([t[1], -t[0]]) * (1.0 if Polygon(points).exterior.is_ccw else -1.0)
    return np.array([points[0] + (-outward if hole else outward) * length, points[0]])


# --------------------------------------------------------------------------------------------------- at random


@pytest.fixture(scope="module")
def judged():
    """Lead-ins of sheets of all kinds."""
    import pandas as pd

    return pd.concat(list(sheets_of_parts.random(500, seed=14)), ignore_index=True)


def test_no_lead_in_of_500_contours_at_random_starts_in_a_part_or_on_an_edge_or_takes_from_a_neighbour(judged):
    assert len(judged) >= 500
    assert set(judged["kind"]) == set(KINDS)
    assert judged["wrong"].unique().tolist() == [""]


def test_only_holes_narrower_than_the_kerf_are_pierced_on_the_contour(judged):
    from shapely import maximum_inscribed_circle

    from kerfgym.experiments.studies.leads.random_parts import sheets

    tight = 0
    for each in sheets(14, 500):
        route = routed(each.drawing, Cutting(each.lead_in, each.kerf))
        for cut in route.cuts:
            if cut.how == "on the contour":
                tight += 1
                widest = 2 * maximum_inscribed_circle(Polygon(each.drawing.pieces[cut.contour])).length
                assert route.nesting.hole[cut.contour]
                assert widest < each.kerf
        named = sum(w.endswith("has no room for a lead-in: it is pierced on the contour") for w in route.warnings)
        assert named == min(sum(cut.how == "on the contour" for cut in route.cuts), 5)
    assert tight == (judged["how"] == "on the contour").sum()


def test_the_verdict_finds_what_version_0_1_did():
    from kerfgym.experiments.studies.leads.random_parts import sheets

    found = []
    for each in sheets(14, 300):
        route, material = routed(each.drawing, Cutting(0.0, each.kerf)), Material(each.parts)
        for cut in route.cuts:
            way = at_a_right_angle(cut.path, route.nesting.hole[cut.contour], each.lead_in)
            found += wrong(Cut(cut.contour, way, cut.path, cut.corners, "drawn"), material, each.kerf)
    assert {fault for fault in WRONG if found.count(fault) >= 10} == set(WRONG)


# ------------------------------------------------------------------------------------------------------ by hand


def test_an_acute_hole_is_not_pierced_in_the_part_around_it():
    route = routed(sheet(HOLE, square(0, 0, 100)), Cutting(lead_in=3.0))
    hole, plate = Polygon(HOLE), box(0, 0, 100, 100)
    assert not hole.contains(LineString(at_a_right_angle(np.array(HOLE, float), True, 3.0)))
    (first, second) = route.cuts
    assert hole.contains(Point(first.way[0]))
    assert hole.covers(LineString(first.way).buffer(-1e-9)) or hole.buffer(1e-9).covers(LineString(first.way))
    assert hole.exterior.distance(Point(first.way[0])) >= 1.5 * 0.25
    assert not plate.intersects(Point(second.way[0]))


@pytest.mark.parametrize("begin", range(4))
def test_a_square_hole_is_not_entered_along_its_edge(begin):
    ring = square(10, 10, 20, begin)
    (hole, _) = routed(sheet(ring, square(0, 0, 40)), Cutting(lead_in=3.0)).cuts
    edge = Polygon(ring).exterior
    away = [edge.distance(Point(hole.way[-1] + s * (hole.way[0] - hole.way[-1]))) for s in (0.25, 0.5, 1.0)]
    assert away == pytest.approx([away[2] / 4, away[2] / 2, away[2]], rel=1e-6)
    assert away[2] > 1.2


def test_parts_a_millimetre_apart_are_pierced_in_the_middle_between_them():
    left, right = square(0, 0, 20, begin=1), square(21, 0, 20)
    left = [(20, 10), (20, 20), (0, 20), (0, 0), (20, 0), (20, 10)]  # begins in the gap
    route = routed(sheet(left, right), Cutting(lead_in=3.0))
    start = route.cuts[0].way[0]
    assert route.cuts[0].how == "shorter"
    assert start == pytest.approx([20.5, 10.0])


def test_where_there_is_no_room_the_contour_is_pierced_on_itself_and_named():
    slit = [(10.0, 10.0), (30.0, 10.0), (30.0, 10.1), (10.0, 10.1), (10.0, 10.0)]
    route = routed(sheet(slit, square(0, 0, 40)), Cutting(lead_in=3.0, kerf=0.25))
    assert [cut.how for cut in route.cuts] == ["on the contour", "drawn"]
    assert route.cuts[0].way.tolist() == [[10.0, 10.0]]
    assert route.warnings == [
        "contour 1, which begins at x = 10.00, y = 10.00 mm, has no room for a lead-in: it is pierced on the contour"
    ]


def test_a_part_in_a_hole_is_entered_from_the_ring_of_scrap_around_it():
    route = routed(sheet(square(18, 18, 4), square(16, 16, 8), square(0, 0, 40)), Cutting(lead_in=5.0))
    island, hole, _ = (Point(cut.way[0]) for cut in route.cuts)
    ring = box(16, 16, 24, 24).difference(box(18, 18, 22, 22))
    assert ring.contains(island)
    assert ring.contains(hole)


def test_a_contour_that_goes_there_and_back_is_cut_as_a_line():
    flat = [(10.0, 10.0), (30.0, 10.0), (10.0, 10.0)]
    route = routed(sheet(flat, square(0, 0, 40)), Cutting())
    assert len(route.cuts[0].way) == 1
    assert "encloses nothing: it is cut as a line" in route.warnings[0]


@pytest.mark.parametrize("name", parts.PARTS)
def test_shipped_parts_keep_the_lead_in_of_version_0_1_unless_it_led_into_the_part(name):
    made = parts.part(name)
    route = routed(made, Cutting(lead_in=3.0, kerf=0.2))
    for cut in route.cuts:
        piece, hole = made.pieces[cut.contour], bool(route.nesting.hole[cut.contour])
        shape = Polygon(piece)
        length = min(3.0, 0.7 * shape.area / (0.5 * shape.length)) if hole else 3.0
        before = at_a_right_angle(piece, hole, length)
        inside = shape.contains(Point(before[0]))
        if name == "gear" and not hole:
            assert inside  # its pierce point lay in the next tooth
            assert not shape.intersects(Point(cut.way[0]))
        else:
            assert inside == hole
            assert np.abs(cut.way - before).max() < 1e-9


def test_where_too_much_lies_on_top_of_each_other_the_search_ends_and_says_so(monkeypatch):
    crowd = sheet(*([[*p] for p in square(3 * i, 3 * j, 20)] for i in range(4) for j in range(4)))
    patient = routed(crowd, Cutting(lead_in=2.0))
    monkeypatch.setattr(route, "MOST_WORK", 1)
    hasty = routed(crowd, Cutting(lead_in=2.0))
    pierced = [sum(cut.how == "on the contour" for cut in r.cuts) for r in (patient, hasty)]
    assert pierced[0] < pierced[1] < 16
    assert not any("too much lies on top" in line for line in patient.warnings)
    assert "has no lead-in, for too much lies on top of each other to look for room everywhere: it" in hasty.warnings[0]
