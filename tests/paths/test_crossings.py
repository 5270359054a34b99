"""Contours that cross or lie on one another: curves are cut once where that can be, and what remains is told."""

import time

import ezdxf
import numpy as np
import pytest
import shapely

from kerfgym.envs.paths import kerf
from kerfgym.envs.paths.crossings import Meetings, meetings
from kerfgym.envs.paths.curve import arc, line, polyline
from kerfgym.envs.paths.nesting import nested
from kerfgym.envs.paths.overlaps import without_curves_on_others
from kerfgym.envs.paths.read import read
from kerfgym.envs.paths.route import Cutting, routed
from kerfgym.envs.plant.quantity import InvalidInput

BOW = [(20, 20), (80, 80), (80, 20), (20, 80)]
UNEQUAL = [(20, 20), (80, 80), (80, 20), (20, 70)]


@pytest.fixture
def dxf(tmp_path):
    """Reads a drawing in mm that a function fills."""

    def made(fill):
        document = ezdxf.new("R2010")
        document.header["$INSUNITS"] = 4
        fill(document.modelspace())
        document.saveas(tmp_path / "part.dxf")
        return read(tmp_path / "part.dxf")

    return made


def square(space, x, y, side):
    space.add_lwpolyline([(x, y), (x + side, y), (x + side, y + side), (x, y + side)], close=True)


def ring(x, y, radius, count=127):
    angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
    points = np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)])
    points[-1] = points[0]
    return points


# ------------------------------------------------------------------------------------------------- curves on curves


@pytest.mark.parametrize(("begin", "end"), [(0, 90), (33, 200), (300, 60)])
def test_an_arc_on_a_circle_is_cut_once_and_told(dxf, begin, end):
    drawing = dxf(lambda s: (s.add_circle((100, 0), 10), s.add_arc((100, 0), 10, begin, end)))
    assert drawing.closed == [True]
    assert drawing.cut_length == pytest.approx(20 * np.pi, rel=1e-3)
    saved = np.radians((end - begin) % 360) * 10
    (note,) = drawing.notes
    saved = float(note.removeprefix("1 curve lies wholly on another: cut once, ").removesuffix(" mm less"))
    assert saved == pytest.approx(np.radians((end - begin) % 360) * 10, rel=1e-3)


def test_an_open_contour_on_an_outline_of_lines_and_arcs_goes_and_the_outline_stays(dxf):
    def fill(space):
        slot = [(0, 0, 0), (40, 0, 1), (40, 10, 0), (0, 10, 1)]
        space.add_lwpolyline(slot, format="xyb", close=True)
        space.add_lwpolyline([(20, 0, 0), (40, 0, 1), (40, 10, 0), (30, 10, 0)], format="xyb")

    drawing = dxf(fill)
    assert drawing.closed == [True]
    assert drawing.cut_length == pytest.approx(80 + 10 * np.pi, rel=1e-3)
    assert "1 curve lies wholly on another: cut once, 45.7" in drawing.notes[0]


def test_curves_that_only_touch_or_run_beside_each_other_or_are_short_stay():
    touching = [arc(0j, 10 + 0j, 10j, np.pi / 2), arc(20 + 0j, 10 + 0j, 20 + 10j, -np.pi / 2)]
    beside = [arc(100 + 0j, 110 + 0j, 100 + 10j, np.pi / 2), arc(100 + 0j, 110.02 + 0j, 100 + 10.02j, np.pi / 2)]
    fine = [polyline([x, x + 0.001, x + 0.002]) for x in 50 + 0.002 * np.arange(40)]
    drawn = [*touching, *beside, *fine]
    assert without_curves_on_others(drawn)[0] == drawn


def test_arcs_that_lie_partly_on_one_another_are_told_with_their_place(dxf):
    drawing = dxf(lambda s: (s.add_arc((0, 0), 20, 0, 120), s.add_arc((0, 0), 20, 60, 180)))
    assert drawing.cut_length == pytest.approx(2 * 120 / 180 * np.pi * 20, rel=1e-3)
    (meeting,) = drawing.meetings.found
    assert meeting.along == pytest.approx(np.pi / 3 * 20, rel=1e-2)
    assert np.hypot(meeting.x, meeting.y) == pytest.approx(20, abs=0.01)
    assert 60 <= np.degrees(np.arctan2(meeting.y, meeting.x)) <= 120
    (note,) = drawing.notes
    assert note.startswith("contours 1 and 2 lie on one another over 20.9 mm, at x = ")
    assert note.endswith(" mm: cut for each of them")


def test_what_is_taken_away_is_not_told_to_be_cut_twice(dxf):
    def fill(space):
        square(space, 20, 10, 20)
        space.add_lwpolyline([(40, 10), (40, 30), (20, 30), (20, 10)], close=True)

    assert dxf(fill).notes == ["1 closed contour is there twice: cut once"]


# --------------------------------------------------------------------------------------------------------- crossing


@pytest.mark.parametrize(("corners", "place"), [(BOW, (50, 50)), (UNEQUAL, (47.27, 47.27))])
def test_a_bow_tie_is_a_hole_of_two_lobes_and_is_told_with_its_place(dxf, corners, place):
    drawing = dxf(lambda s: (square(s, 0, 0, 100), s.add_lwpolyline(corners, close=True)))
    assert drawing.closed == [True, True]
    where = f"x = {place[0]:.2f}, y = {place[1]:.2f} mm"
    rule = "what it goes around an even number of times is taken as outside"
    assert drawing.notes == [f"contour 1 crosses or touches itself at {where}: {rule}"]
    route = routed(drawing, Cutting(lead_in=3.0))
    lobes = shapely.make_valid(shapely.Polygon(corners))
    assert route.nesting.hole.tolist() == [True, False]
    assert len(route.cuts[0].way) > 1
    assert lobes.contains(shapely.Point(route.cuts[0].way[0]))


def test_what_a_bow_tie_encloses_is_that_of_both_lobes():
    bow = np.array([*BOW, BOW[0]], float)
    assert abs(nested([bow], [True]).area[0]) == pytest.approx(2 * 0.5 * 60 * 30)
    there_and_back = np.array([(0, 0), (50, 0), (50, 30), (50, 0), (0, 0)], float)
    assert nested([there_and_back], [True]).area[0] == 0.0


def test_outlines_that_cut_into_each_other_are_told_with_a_place_on_both(tmp_path):
    file = tmp_path / "two.svg"
    file.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="200mm" height="100mm" viewBox="0 0 200 100">'
        '<path d="M10 10H90V90H10Z"/><path d="M5 40H20V60H5Z"/></svg>'
    )
    drawing = read(file)
    (meeting,) = drawing.meetings.found
    for piece in drawing.pieces:
        assert shapely.LineString(piece).distance(shapely.Point(meeting.x, meeting.y)) < 1e-9
    assert drawing.notes == [
        f"contours 1 and 2 cross at x = {meeting.x:.2f}, y = {meeting.y:.2f} mm: each cuts into the other"
    ]


def test_an_open_cut_through_an_outline_crosses_it_and_open_cuts_may_cross_one_another():
    through = np.array([[-10.0, 50.0], [50.0, 50.0]])
    across = np.array([[20.0, 20.0], [20.0, 90.0]])
    outline = np.array([[0, 0], [100, 0], [100, 100], [0, 100], [0, 0]], float)
    (meeting,) = meetings([through, across, outline], [False, False, True]).found
    assert (meeting.first, meeting.second, meeting.x, meeting.y) == (0, 2, 0, 50)


def test_contours_that_touch_do_not_cross(dxf):
    def fill(space):
        square(space, 0, 0, 100)
        space.add_circle((10, 50), 10)
        space.add_circle((30, 50), 10)
        square(space, 60, 0, 20)

    (meeting,) = dxf(fill).meetings.found  # the square on the outline's edge
    assert meeting.along == pytest.approx(20, abs=0.05)


@pytest.mark.parametrize("kind", ["apart", "crossing"])
def test_thousands_of_contours_are_looked_through_in_seconds(kind):
    rings = [ring(20 + 26.5 * i, 20 + 24.7 * j, 6.5 if kind == "apart" else 14.0) for i in range(50) for j in range(40)]
    began = time.process_time()
    found = meetings(rings, [True] * len(rings))
    assert time.process_time() - began < 8.0
    if kind == "apart":
        assert found == Meetings()
    else:
        assert len(found.found) > 500


# ------------------------------------------------------------------------------------------- numbers, places, limits


def test_messages_keep_the_numbers_and_places_of_the_drawing_when_contours_vanish(dxf):
    def fill(space):
        square(space, 0, 0, 50)
        for i, radius in enumerate([0.1, 0.05, 0.2, 0.3]):
            space.add_circle((5 + 6 * i, 25), radius)

    drawing = kerf.compensated(dxf(fill), 0.3)
    told = [*drawing.warnings, *routed(drawing, Cutting(kerf=0.3)).warnings]
    numbers = [int(line.split()[1].rstrip(",")) for line in told]
    assert [line.split("mm, ")[1][:8] for line in told] == ["vanishes"] * 2 + ["has no r"] * 2
    assert numbers == [1, 2, 3, 4]
    assert ["y = 25.00" in line for line in told] == [True] * 4


def test_a_tiny_circle_far_beyond_every_sheet_is_an_error(dxf):
    with pytest.raises(InvalidInput, match=r"a CIRCLE reaches 1e\+300 mm away from the origin, out of range; allowed"):
        dxf(lambda s: (square(s, 0, 0, 100), s.add_circle((1e300, 0), 10)))


def test_scales_that_leave_no_number_are_told_without_a_word_from_the_library(tmp_path, recwarn):
    file = tmp_path / "far.svg"
    scale = '<g transform="scale(1e300)">'
    file.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="9mm" height="9mm" viewBox="0 0 9 9">{scale}{scale}'
        '<rect width="5" height="5"/></g></g></svg>'
    )
    with pytest.raises(InvalidInput, match="coordinates that are not numbers"):
        read(file)
    assert [str(w.message) for w in recwarn if issubclass(w.category, RuntimeWarning)] == []


def test_letters_that_are_no_utf8_are_told_as_such(tmp_path):
    text = '<svg xmlns="http://www.w3.org/2000/svg" width="9mm" height="9mm"><rect width="5" height="5" id="ä"/></svg>'
    plain, named = tmp_path / "plain.svg", tmp_path / "named.svg"
    plain.write_bytes(text.encode("latin-1"))
    named.write_bytes(b'<?xml version="1.0" encoding="ISO-8859-1"?>' + text.encode("latin-1"))
    with pytest.raises(InvalidInput, match=r"line 1: .*byte 0xe4 is no UTF-8, and the file names no other encoding"):
        read(plain)
    assert len(read(named).pieces) == 1


def test_a_line_on_a_line_is_left_to_the_cleaning_of_lines():
    assert len(without_curves_on_others([line(0, 10), line(2, 8)])[0]) == 2
