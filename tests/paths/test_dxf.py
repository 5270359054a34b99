"""DXF: contours in cutting order, with lengths from closed forms."""

import re
from itertools import pairwise

import ezdxf
import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.special import ellipe

from kerfgym.envs.paths.choice import Reading
from kerfgym.envs.paths.curve import CHORD
from kerfgym.envs.paths.drawing import journey
from kerfgym.envs.paths.dxf import read_dxf
from kerfgym.envs.paths.dxf_walk import NESTING
from kerfgym.envs.paths.joining import GAP
from kerfgym.envs.plant.path import SPACING
from kerfgym.envs.plant.quantity import InvalidInput


@pytest.fixture
def sheet(tmp_path):
    """Draws on a new sheet with the function given, saves it, reads it."""

    def read(draw, insunits=4, measurement=1, **choices):
        document = ezdxf.new("R2010")
        document.header["$INSUNITS"], document.header["$MEASUREMENT"] = insunits, measurement
        draw(document.modelspace())
        document.saveas(tmp_path / "part.dxf")
        return read_dxf(tmp_path / "part.dxf", Reading(**choices))

    return read


def length(points):
    return np.hypot(*np.diff(points, axis=0).T).sum()


def box(space, x, y, width, height=None, **attributes):
    height = width if height is None else height
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return space.add_lwpolyline(corners, close=True, dxfattribs=attributes)


def left_edges(drawing):
    return [round(float(piece[:, 0].min()), 6) for piece in drawing.pieces]


# Joining


def test_four_lines_in_any_order_and_direction_are_one_rectangle(sheet):
    def draw(space):
        space.add_line((30, 20), (0, 20))
        space.add_line((0, 0), (30, 0))
        space.add_line((0, 0), (0, 20))
        space.add_line((30, 20), (30, 0))

    drawing = sheet(draw)
    (piece,) = drawing.pieces
    assert drawing.closed == [True]
    assert len(piece) == 5
    assert (piece[0] == piece[-1]).all()
    assert length(piece) == pytest.approx(100.0, abs=1e-9)
    assert drawing.cut_length == pytest.approx(100.0, abs=1e-9)


@pytest.mark.parametrize(("gap", "closed"), [(0.8 * GAP, [True]), (1.2 * GAP, [False])])
def test_a_gap_is_bridged_up_to_the_tolerance(sheet, gap, closed):
    def draw(space):
        space.add_line((0, 0), (10, 0))
        space.add_line((0, gap), (5, 8))
        space.add_line((5, 8), (10, 0))

    drawing = sheet(draw)
    assert drawing.closed == closed
    assert drawing.cut_length == pytest.approx(10 + np.hypot(5, 8) + np.hypot(5, 8 - gap) + gap * closed[0])


def test_gaps_in_every_corner_are_bridged(sheet):
    corners = np.array([(0, 0), (20, 0), (10, 15), (0, 0)], float)

    def draw(space):
        for a, b in pairwise(corners):
            space.add_line(a, (b[0], b[1] + 0.5 * GAP))

    drawing = sheet(draw)
    assert drawing.closed == [True]
    assert drawing.cut_length == pytest.approx(length(corners), abs=6 * GAP)


def test_lines_in_any_order_and_direction_are_one_open_contour(sheet):
    def draw(space):
        space.add_line((20, 0), (10, 0))
        space.add_line((0, 0), (10, 0))
        space.add_line((30, 5), (20, 0))

    drawing = sheet(draw)
    assert drawing.closed == [False]
    assert drawing.pieces[0].tolist() == [[0, 0], [10, 0], [20, 0], [30, 5]]


def test_a_speck_shorter_than_the_gap_is_no_contour(sheet):
    def draw(space):
        box(space, 0, 0, 10)
        space.add_line((5, 5), (5 + 0.5 * GAP, 5))
        space.add_circle((2, 2), 0.1 * GAP)

    assert sheet(draw).closed == [True]


def test_a_curve_in_lines_far_shorter_than_the_gap_keeps_its_shape(sheet):
    angles = np.linspace(0, 2 * np.pi, 401)
    x, y = 0.5 * np.cos(angles), 0.5 * np.sin(angles)
    x[-1], y[-1] = x[0], y[0]

    def draw(space):
        for i in np.random.default_rng(1).permutation(400):
            space.add_line((x[i], y[i]), (x[i + 1], y[i + 1]))

    drawing = sheet(draw)
    assert drawing.closed == [True]
    assert drawing.cut_length == pytest.approx(np.pi, rel=1e-4)


def test_squares_that_share_a_corner_stay_two_contours(sheet):
    def draw(space):
        for x, y in ((0, 0), (10, 10)):
            corners = [(x, y), (x + 10, y), (x + 10, y + 10), (x, y + 10), (x, y)]
            for a, b in pairwise(corners):
                space.add_line(a, b)

    drawing = sheet(draw)
    assert drawing.closed == [True, True]
    assert [length(p) for p in drawing.pieces] == pytest.approx([40.0, 40.0])


def test_a_lead_in_stays_apart_from_the_contour_it_leads_to(sheet):
    def draw(space):
        space.add_line((-5, 0), (0, 0))
        for a, b in pairwise([(0, 0), (10, 0), (5, 8), (0, 0)]):
            space.add_line(a, b)

    drawing = sheet(draw)
    assert sorted(drawing.closed) == [False, True]
    assert drawing.cut_length == pytest.approx(5 + 10 + 2 * np.hypot(5, 8))


def test_two_half_circles_are_one_closed_contour(sheet):
    def draw(space):
        space.add_arc((0, 0), 10, 0, 180)
        space.add_arc((0, 0), 10, 180, 360)

    drawing = sheet(draw)
    assert drawing.closed == [True]
    assert np.hypot(*drawing.pieces[0].T) == pytest.approx(10.0)


# Curves


@pytest.mark.parametrize("radius", [5.0, 40.0, 900.0])
def test_a_circle_is_two_pi_r_long_and_leaves_its_chords_by_the_tolerance_at_most(sheet, radius):
    drawing = sheet(lambda space: space.add_circle((3, 4), radius))
    (piece,) = drawing.pieces
    assert drawing.closed == [True]
    assert length(piece) == pytest.approx(2 * np.pi * radius, rel=1e-3)
    assert np.hypot(*(piece - (3, 4)).T) == pytest.approx(radius)
    middles = 0.5 * (piece[1:] + piece[:-1]) - (3, 4)
    assert radius - np.hypot(*middles.T).min() <= CHORD * 1.001


@pytest.mark.parametrize("radius", [1e-4, 0.5 * CHORD, CHORD, 0.2 * GAP, GAP])
def test_a_circle_nearly_as_small_as_the_tolerance_is_round_or_a_speck(sheet, radius):
    def draw(space):
        space.add_circle((0, 0), radius)
        box(space, -5, -5, 10)

    *circle, square = [length(p) for p in sheet(draw).pieces]
    assert square == pytest.approx(40.0)
    assert circle == ([pytest.approx(2 * np.pi * radius, rel=0.1)] if 2 * np.pi * radius > GAP else [])


@pytest.mark.timeout(20)
@pytest.mark.parametrize("kind", ["circle", "ellipse", "bulge"])
def test_a_curve_of_astronomic_size_is_refused_in_no_time(sheet, kind):
    def draw(space):
        if kind == "circle":
            space.add_circle((0, 0), 1e15)
        elif kind == "ellipse":
            space.add_ellipse((0, 0), (1e15, 0), 0.5)
        else:
            space.add_lwpolyline([(0, 0, 1), (1e15, 0, 0)], format="xyb")

    with pytest.raises(InvalidInput, match="out of range"):
        sheet(draw)


def test_an_arc_with_its_axis_down_is_mirrored(sheet):
    drawing = sheet(lambda space: space.add_arc((0, 0), 10, 0, 90, dxfattribs={"extrusion": (0, 0, -1)}))
    ends = drawing.pieces[0][[0, -1]]
    assert ends[ends[:, 0].argsort()] == pytest.approx(np.array([[-10, 0], [0, 10]]))


@pytest.mark.parametrize("kind", ["LWPOLYLINE", "POLYLINE"])
@pytest.mark.parametrize("angle", [90.0, -90.0, 180.0, -270.0])
def test_a_bulge_is_an_arc_of_four_times_its_arctangent(sheet, kind, angle):
    radians = np.radians(angle)
    points = [(0, 0, np.tan(radians / 4)), (20, 0, 0)]
    radius = 10 / abs(np.sin(radians / 2))

    def draw(space):
        if kind == "LWPOLYLINE":
            space.add_lwpolyline(points, format="xyb")
        else:
            space.add_polyline2d(points, format="xyb")

    drawing = sheet(draw)
    (piece,) = drawing.pieces
    assert drawing.closed == [False]
    assert piece[[0, -1]] == pytest.approx(np.array([[0, 0], [20, 0]]))
    assert length(piece) == pytest.approx(radius * abs(radians), rel=1e-3)
    # counter-clockwise from left to right runs below the chord
    deepest = -np.sign(angle) * radius * (1 - np.cos(radians / 2))
    assert piece[np.abs(piece[:, 1]).argmax(), 1] == pytest.approx(deepest, abs=CHORD)


def test_the_bulge_of_the_last_vertex_closes_the_polyline(sheet):
    slot = [(0, 0, 0), (30, 0, 1), (30, 10, 0), (0, 10, 1)]
    drawing = sheet(lambda space: space.add_lwpolyline(slot, format="xyb", close=True))
    assert drawing.closed == [True]
    assert drawing.cut_length == pytest.approx(60 + 10 * np.pi, rel=1e-3)
    assert drawing.pieces[0][:, 0].min() == pytest.approx(-5.0, abs=CHORD)


def test_the_control_points_of_a_fitted_polyline_are_not_cut(sheet):
    def draw(space):
        line = space.add_polyline2d([(0, 0), (10, 0), (20, 0)])
        line.append_vertex((10, 50), dxfattribs={"flags": 16})

    assert sheet(draw).cut_length == pytest.approx(20.0)


def test_the_perimeter_of_an_ellipse_is_the_elliptic_integral(sheet):
    drawing = sheet(lambda space: space.add_ellipse((5, 5), major_axis=(0, 30), ratio=0.4))
    assert drawing.closed == [True]
    assert drawing.cut_length == pytest.approx(4 * 30 * ellipe(1 - 0.4**2), rel=1e-3)


def test_a_clamped_spline_runs_from_its_first_to_its_last_control_point(sheet):
    control = np.array([(0, 0), (10, 30), (40, 30), (50, 0), (80, 10)], float)
    drawing = sheet(lambda space: space.add_open_spline(np.c_[control, np.zeros(5)]))
    (piece,) = drawing.pieces
    assert drawing.closed == [False]
    assert piece[[0, -1]] == pytest.approx(control[[0, -1]])
    curve = BSpline([0, 0, 0, 0, 1, 2, 2, 2, 2], control, 3)(np.linspace(0, 2, 5001))
    assert length(piece) == pytest.approx(length(curve), rel=1e-4)


def test_a_closed_spline_without_clamped_ends_is_cut_only_where_it_is_defined(sheet):
    corners = np.array([(100, 0), (110, 0), (110, 10), (100, 10)], float)
    control = np.r_[corners, corners[:3]]

    def draw(space):
        space.add_spline(degree=3).set_closed([(x, y, 0) for x, y in corners], degree=3)

    drawing = sheet(draw)
    curve = BSpline(np.arange(11.0), control, 3)(np.linspace(3, 7, 5001))
    assert drawing.closed == [True]
    assert drawing.cut_length == pytest.approx(length(curve), rel=1e-3)
    assert drawing.pieces[0].min(axis=0) == pytest.approx(curve.min(axis=0), abs=CHORD)


def test_a_rational_spline_can_be_a_circle(sheet):
    square = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)]

    def draw(space):
        spline = space.add_spline(degree=2)
        spline.control_points = [(10 * x, 10 * y, 0) for x, y in square]
        spline.knots = [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4]
        spline.weights = [1, np.sqrt(0.5)] * 4 + [1]

    drawing = sheet(draw)
    assert drawing.closed == [True]
    assert np.hypot(*drawing.pieces[0].T) == pytest.approx(10.0)
    assert drawing.cut_length == pytest.approx(20 * np.pi, rel=1e-3)


# Units


@pytest.mark.parametrize(
    ("insunits", "measurement", "name", "mm"),
    [
        (1, 1, "inches", 25.4),
        (4, 0, "mm", 1),
        (5, 1, "cm", 10),
        (6, 1, "m", 1000),
        (0, 0, "inches", 25.4),
        (0, 1, "mm", 1),
    ],
)
def test_lengths_are_converted_to_mm(sheet, insunits, measurement, name, mm):
    drawing = sheet(lambda space: space.add_circle((2, 0), 1), insunits, measurement)
    assert drawing.units == name
    assert drawing.pieces[0][0] == pytest.approx([3 * mm, 0])
    assert drawing.cut_length == pytest.approx(2 * np.pi * mm, abs=2.1 * CHORD)


BARE = "0 SECTION 2 ENTITIES 0 LINE 8 0 10 0 20 0 11 30 21 40 0 ENDSEC 0 EOF"
IMPERIAL = f"0 SECTION 2 HEADER 9 $MEASUREMENT 70 0 0 ENDSEC {BARE}"


def test_a_file_without_header_is_in_mm_and_says_so(tmp_path):
    (tmp_path / "bare.dxf").write_text(BARE.replace(" ", "\n") + "\n")
    drawing = read_dxf(tmp_path / "bare.dxf")
    assert (drawing.name, drawing.units) == ("bare", "mm")
    assert drawing.cut_length == pytest.approx(50.0)
    assert drawing.warnings == ["no unit in the header, read as mm; --units reads it otherwise"]


def test_a_measurement_that_contradicts_the_guess_is_named(tmp_path):
    (tmp_path / "part.dxf").write_text(IMPERIAL.replace(" ", "\n") + "\n")
    drawing = read_dxf(tmp_path / "part.dxf")
    assert drawing.cut_length == pytest.approx(50.0)
    (warning,) = drawing.warnings
    assert warning.startswith("no unit in the header, read as mm, although $MEASUREMENT says inches")


@pytest.mark.parametrize(("insunits", "warned"), [(0, True), (4, False), (1, False)])
def test_only_a_missing_unit_is_warned_of(sheet, insunits, warned):
    warnings = sheet(lambda space: space.add_line((0, 0), (9, 9)), insunits).warnings
    assert [w.startswith("no unit in the header") for w in warnings] == [True] * warned


@pytest.mark.parametrize(("units", "name", "mm"), [("mm", "mm", 1), ("in", "inches", 25.4), ("m", "m", 1000)])
def test_a_chosen_unit_goes_before_the_header(sheet, units, name, mm):
    drawing = sheet(lambda space: space.add_line((0, 0), (9, 0)), insunits=20, units=units)
    assert (drawing.units, drawing.warnings) == (name, [])
    assert drawing.cut_length == pytest.approx(9 * mm)


def test_an_unknown_unit_is_refused(sheet):
    with pytest.raises(InvalidInput, match=r"units = 'inch es' is not known; did you mean 'inches'\? \(known: mm, cm"):
        sheet(lambda space: space.add_line((0, 0), (9, 0)), units="inch es")


# Layers


def two_layers(space):
    box(space, 0, 0, 10, layer="Cut")
    box(space, 20, 0, 10, layer="Engrave")
    block = space.doc.blocks.new("slot")
    box(block, 0, 0, 5)
    box(block, 0, 8, 1, layer="Engrave")
    space.add_blockref("slot", (60, 0), dxfattribs={"layer": "CUT"})


@pytest.mark.parametrize("layers", [("Cut",), ["cut"], "CUT"])
def test_only_chosen_layers_are_cut(sheet, layers):
    drawing = sheet(two_layers, layers=layers)
    assert left_edges(drawing) == [0, 60]
    assert drawing.layers == ["Cut", "CUT"]
    assert drawing.skipped == {"LWPOLYLINE on layer 'Engrave'": 2}
    assert drawing.notes == ["LWPOLYLINE on layer 'Engrave' is left out (2)"]


def test_an_unknown_layer_is_refused_with_the_nearest(sheet):
    with pytest.raises(InvalidInput, match=r"part\.dxf: no layer 'Engraved'; did you mean 'Engrave'\? \(known: "):
        sheet(two_layers, layers=("Cut", "Engraved"))
    with pytest.raises(InvalidInput, match="layers is empty"):
        sheet(two_layers, layers=())


# Corners


def corners(drawing):
    return [c.tolist() for c in drawing.corners]


def test_a_closed_contour_has_a_corner_where_it_begins(sheet):
    drawing = sheet(lambda space: box(space, 0, 0, 10))
    assert corners(drawing) == [[0, 1, 2, 3]]
    assert drawing.feeds is None


@pytest.mark.parametrize("radius", [0.05, 0.3, 20.0])
def test_the_chords_of_a_circle_are_no_corners(sheet, radius):
    def draw(space):
        space.add_circle((0, 0), radius)
        space.add_arc((100, 0), radius, 0, 180)
        space.add_arc((100, 0), radius, 180, 0)
        space.add_lwpolyline([(200, 0, 1), (200 + 2 * radius, 0, 1)], format="xyb", close=True)
        space.add_ellipse((300, 0), (2 * radius, 0), 0.5)

    assert corners(sheet(draw)) == [[], [], [], []]


def test_a_slot_has_no_corners_and_a_half_moon_two(sheet):
    def draw(space):
        space.add_lwpolyline([(0, 0, 0), (30, 0, 1), (30, 10, 0), (0, 10, 1)], format="xyb", close=True)
        space.add_lwpolyline([(100, 0, 0), (110, 0, 1)], format="xyb", close=True)

    drawing = sheet(draw)
    assert [len(c) for c in drawing.corners] == [0, 2]
    assert drawing.pieces[1][drawing.corners[1]] == pytest.approx(np.array([[100, 0], [110, 0]]))


@pytest.mark.parametrize(("degrees", "count"), [(4.5, 0), (5.5, 1)])
@pytest.mark.parametrize("flipped", [False, True])
def test_entities_that_meet_at_more_than_five_degrees_make_a_corner(sheet, degrees, count, flipped):
    angle = np.radians(degrees)

    def draw(space):
        ends = [(10, 0), (10 + 10 * np.cos(angle), 10 * np.sin(angle))]
        space.add_line((0, 0), (10, 0))
        space.add_line(*(ends[::-1] if flipped else ends))

    drawing = sheet(draw)
    assert corners(drawing) == [[1] * count]


@pytest.mark.parametrize(("degrees", "count"), [(4.5, 0), (5.5, 1)])
def test_an_arc_meets_its_neighbour_with_its_tangent_and_not_its_chord(sheet, degrees, count):
    radius = 0.5  # chords of 10° and more

    def draw(space):
        space.add_arc((0, radius), radius, 270, 360)
        direction = np.exp(1j * np.radians(180 + degrees))
        space.add_line((0, 0), (direction.real, direction.imag))

    assert [len(c) for c in corners(sheet(draw))] == [count]


def test_a_contour_travelled_backwards_keeps_its_corners(sheet):
    def draw(space):
        space.add_line((0, 0), (100, 0))
        space.add_lwpolyline([(0, 10), (0, 20), (40, 20), (100, 10)])

    drawing = sheet(draw)
    assert drawing.pieces[1][0].tolist() == [100, 10]
    assert drawing.pieces[1][drawing.corners[1]].tolist() == [[40, 20], [0, 20]]


def test_a_mirrored_arc_meets_its_line_smoothly(sheet):
    def draw(space):
        space.add_arc((0, 0), 10, 0, 90, dxfattribs={"extrusion": (0, 0, -1)})
        space.add_line((0, 10), (20, 10))

    assert corners(sheet(draw)) == [[]]


def test_a_spline_has_a_corner_only_where_its_control_points_make_one(sheet):
    smooth = [(0, 0), (10, 20), (20, -20), (30, 0), (40, 20), (50, -10), (60, 0)]
    peaked = [(0, 100), (10, 110), (20, 120), (30, 130), (30, 130), (30, 130), (40, 120), (50, 110), (60, 100)]

    def draw(space):
        for control in (smooth, peaked):
            space.add_open_spline([(x, y, 0) for x, y in control])

    drawing = sheet(draw)
    tips = [piece[c] for piece, c in zip(drawing.pieces, drawing.corners, strict=True)]
    assert len(tips[0]) == 0
    assert tips[1] == pytest.approx(np.array([[30, 130]]))


# Order


def test_a_hole_is_cut_before_what_is_around_it(sheet):
    def draw(space):
        box(space, 0, 0, 100)
        box(space, 40, 40, 20)
        space.add_line((45, 50), (55, 50))

    drawing = sheet(draw)
    assert left_edges(drawing) == [45, 40, 0]
    assert drawing.closed == [False, True, True]


def test_a_shape_inside_the_hull_but_outside_the_outline_is_not_a_hole(sheet):
    def draw(space):
        space.add_lwpolyline([(0, 0), (100, 0), (100, 10), (10, 10), (10, 100), (0, 100)], close=True)
        box(space, 50, 50, 20)

    assert left_edges(sheet(draw)) == [0, 50]


def test_a_hole_may_touch_its_outline(sheet):
    def draw(space):
        box(space, 0, 0, 100)
        space.add_lwpolyline([(0, 0), (50, 30), (30, 50)], close=True)

    assert [len(p) for p in sheet(draw).pieces] == [4, 5]


def test_a_slot_may_share_an_edge_with_its_outline(sheet):
    def draw(space):
        box(space, 0, 0, 100)
        box(space, 80, 40, 20)

    assert left_edges(sheet(draw)) == [80, 0]


def test_the_nearest_contour_is_next(sheet):
    def draw(space):
        for x in (60, 20, 80, 40):
            box(space, x, 0, 10)

    assert left_edges(sheet(draw)) == [20, 40, 60, 80]


def test_an_open_contour_is_cut_from_its_nearer_end(sheet):
    def draw(space):
        space.add_line((0, 0), (100, 0))
        space.add_line((0, 10), (100, 10))

    drawing = sheet(draw)
    assert drawing.pieces[1].tolist() == [[100, 10], [0, 10]]
    assert drawing.move_length == pytest.approx(10.0)


# What is left out, what is looked into


def test_what_is_not_cut_is_counted(sheet):
    def draw(space):
        box(space, 0, 0, 10, layer="outline")
        space.add_text("part 7")
        space.add_text("part 8")
        space.add_point((1, 1))
        space.add_hatch()
        space.add_polymesh((3, 3))

    drawing = sheet(draw)
    assert drawing.layers == ["outline"]
    assert drawing.skipped == {"TEXT": 2, "POINT": 1, "HATCH": 1, "POLYLINE (mesh)": 1}


@pytest.mark.parametrize("state", ["off", "freeze"])
def test_hidden_layers_are_not_cut(sheet, state):
    def draw(space):
        getattr(space.doc.layers.add("Bend"), state)()
        box(space, 0, 0, 10)
        box(space, 20, 0, 10, layer="bend")
        box(space, 40, 0, 10, invisible=1)
        block = space.doc.blocks.new("slot")
        box(block, 0, 0, 5)
        space.add_blockref("slot", (60, 0), dxfattribs={"layer": "BEND"})

    drawing = sheet(draw)
    assert left_edges(drawing) == [0]
    assert drawing.skipped == {
        "LWPOLYLINE on hidden layer 'bend'": 1,
        "invisible LWPOLYLINE": 1,
        # Of a block on a layer that is off what lies on other layers would still show.
        f"{'INSERT' if state == 'freeze' else 'LWPOLYLINE'} on hidden layer 'BEND'": 1,
    }


@pytest.mark.parametrize(("state", "shown"), [("off", [0, 10]), ("freeze", [0])])
def test_of_a_block_on_a_layer_that_is_off_other_layers_show_and_on_a_frozen_one_nothing_does(sheet, state, shown):
    def draw(space):
        getattr(space.doc.layers.add("Bend"), state)()
        box(space, 0, 0, 5)
        block = space.doc.blocks.new("slot")
        box(block, 0, 0, 5)
        box(block, 10, 0, 5, layer="slots")
        space.add_blockref("slot", (0, 0), dxfattribs={"layer": "Bend"})

    assert left_edges(sheet(draw)) == shown


def test_duplicates_and_entities_of_no_length_are_dropped(sheet):
    def draw(space):
        space.add_line((0, 0), (10, 0))
        space.add_line((0, 0), (10, 0))
        space.add_line((10, 0), (0, 0))
        space.add_line((3, 3), (3, 3))
        space.add_arc((5, 5), 2, 30, 30)
        space.add_lwpolyline([(7, 7), (7, 7), (7, 7)])
        space.add_circle((5, 5), 2)
        space.add_circle((5, 5), 2)

    drawing = sheet(draw)
    assert drawing.cut_length == pytest.approx(10 + 4 * np.pi, abs=2.1 * CHORD)
    assert drawing.skipped == {
        "duplicate LINE": 2,
        "LINE of zero length": 1,
        "ARC of zero length": 1,
        "LWPOLYLINE of zero length": 1,
        "duplicate CIRCLE": 1,
    }


def test_blocks_are_placed_turned_and_scaled(sheet):
    def draw(space):
        inner = space.doc.blocks.new("inner")
        box(inner, 0, 0, 10, 1)
        outer = space.doc.blocks.new("outer")
        outer.add_blockref("inner", (100, 0), dxfattribs={"rotation": 90})
        space.add_blockref("outer", (0, 50), dxfattribs={"xscale": 2, "yscale": 2, "layer": "holes"})

    drawing = sheet(draw)
    (piece,) = drawing.pieces
    assert drawing.layers == ["holes"]
    assert piece.min(axis=0) == pytest.approx([198, 50])
    assert piece.max(axis=0) == pytest.approx([200, 70])


def test_a_grid_of_blocks_is_cut_in_every_place(sheet):
    def draw(space):
        box(space.doc.blocks.new("hole"), 0, 0, 5)
        grid = {"row_count": 2, "row_spacing": 10, "column_count": 3, "column_spacing": 20}
        space.add_blockref("hole", (0, 0), dxfattribs=grid)

    assert sorted(left_edges(sheet(draw))) == [0, 0, 20, 20, 40, 40]


def test_a_circle_in_a_block_scaled_unevenly_is_an_ellipse(sheet):
    def draw(space):
        space.doc.blocks.new("hole").add_circle((0, 0), 10)
        space.add_blockref("hole", (0, 0), dxfattribs={"xscale": 3, "yscale": 1})

    assert sheet(draw).cut_length == pytest.approx(4 * 30 * ellipe(1 - 1 / 9), rel=1e-3)


# The journey


def test_the_journey_is_sampled_uniformly(sheet):
    drawing = sheet(lambda space: space.add_circle((0, 0), 50))
    path = journey(drawing)
    steps = np.hypot(np.diff(path.x), np.diff(path.y))
    assert steps == pytest.approx(SPACING, rel=1e-3)
    assert path.length == pytest.approx(drawing.cut_length, abs=SPACING)
    assert path.cutting.all()


def test_the_beam_is_off_between_contours(sheet):
    def draw(space):
        box(space, 0, 0, 10)
        box(space, 30, 0, 10)

    path = journey(sheet(draw))
    moving = path.cutting == 0
    assert moving.sum() == pytest.approx(30 / SPACING, abs=2)
    assert path.y[moving] == pytest.approx(0.0)
    assert path.x[moving].min() > 0
    assert path.x[moving].max() <= 30 + 1e-9
    assert (~moving).sum() == pytest.approx(80 / SPACING, abs=2)
    assert path.name == "part"


# Errors


@pytest.mark.parametrize("content", [b"", b"solid\n", bytes(range(256))])
def test_what_is_not_dxf_is_refused(tmp_path, content):
    (tmp_path / "part.dxf").write_bytes(content)
    with pytest.raises(InvalidInput, match=r"part\.dxf: cannot be read as DXF: "):
        read_dxf(tmp_path / "part.dxf")


def test_a_drawing_with_nothing_to_cut_says_what_is_in_it(sheet):
    with pytest.raises(InvalidInput, match=r"nothing to cut in it; what is cut: LINE, .*; skipped: TEXT \(1\)"):
        sheet(lambda space: space.add_text("empty"))
    with pytest.raises(InvalidInput, match=r"nothing to cut in it; .* skipped: nothing"):
        sheet(lambda space: None)


def test_unknown_units_are_refused_with_the_known_ones(sheet):
    with pytest.raises(InvalidInput, match=r"\$INSUNITS = 20 .* allowed: 0 \(unitless\), 1 \(inches\), 2 \(feet\), 3"):
        sheet(lambda space: space.add_line((0, 0), (9, 9)), insunits=20)


@pytest.mark.parametrize(("side", "insunits"), [(4000.0, 6), (0.02, 4)])
def test_absurd_lengths_are_refused_with_the_range_and_the_unit(sheet, side, insunits):
    unit = {6: "m", 4: "mm"}[insunits]
    with pytest.raises(
        InvalidInput,
        match=rf"out of range; allowed: 0\.1 to 1e\+07 mm; (the drawing was read in {unit}|is the unit right\?)$",
    ):
        sheet(lambda space: box(space, 0, 0, side), insunits)


def test_moves_count_towards_the_length(sheet):
    def draw(space):
        box(space, 0, 0, 10)
        box(space, 1.2e6, 0, 10)

    with pytest.raises(InvalidInput, match=r"a journey of 1\.20008e\+06 mm is out of range; allowed: up to 1e\+06 mm"):
        journey(sheet(draw))


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda space: space.add_spline(), r"SPLINE\(#\w+\): .*control- or fit points"),
        (lambda space: space.add_line((0, float("nan")), (1, 1)), r" LINE\(#\w+\): coordinates that are not numbers"),
        (lambda space: space.add_circle((0, 0), float("nan")), r"CIRCLE\(#\w+\): coordinates that are not numbers"),
        (
            lambda space: space.add_lwpolyline([(0, 0, 1), (float("inf"), 1, 0)], format="xyb"),
            r"LWPOLYLINE\(#\w+\): coordinates that are not numbers",
        ),
        (
            lambda space: space.add_blockref("absent", (0, 0)),
            r"not in the file are left out: 'absent' \(INSERT\(#\w+\)",
        ),
    ],
)
def test_an_entity_that_cannot_be_read_is_left_out_and_named(sheet, draw, message):
    with pytest.raises(InvalidInput, match=rf"nothing to cut in it; .*{message}"):
        sheet(draw)

    def also(space):
        draw(space)
        box(space, 0, 0, 10)

    drawing = sheet(also)
    assert drawing.cut_length == pytest.approx(40.0)
    assert re.search(message, " " + drawing.notes[0])
    assert sum(drawing.skipped.values()) == 1


def test_a_block_that_contains_itself_is_refused(sheet):
    def draw(space):
        block = space.doc.blocks.new("loop")
        block.add_blockref("loop", (1, 1))
        space.add_blockref("loop", (0, 0))

    with pytest.raises(InvalidInput, match=f"nested more than {NESTING} deep"):
        sheet(draw)
