"""DXF: what a shop's drawing shows, where it lies, and what is left out of it; places from ezdxf's own matrices."""

import time

import ezdxf
import numpy as np
import pytest
from ezdxf import path as paths
from ezdxf.math import OCS
from ezdxf.xclip import XClip
from scipy.special import ellipe

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths.choice import Reading
from kerfgym.envs.paths.curve import CHORD
from kerfgym.envs.paths.dxf import read_dxf


@pytest.fixture
def sheet(tmp_path):
    """Draws on a new sheet with the function given, saves it, edits its text, reads it."""

    def read(draw, insunits=4, edit=None, version="R2010", **choices):
        document = ezdxf.new(version, setup=True)
        document.header["$INSUNITS"] = insunits
        draw(document.modelspace())
        document.saveas(tmp_path / "part.dxf")
        if edit:
            text = (tmp_path / "part.dxf").read_text(encoding="utf-8")
            assert edit(text) != text
            (tmp_path / "part.dxf").write_text(edit(text), encoding="utf-8")
        return read_dxf(tmp_path / "part.dxf", Reading(**choices))

    return read


def box(space, x, y, width, height=None, **attributes):
    height = width if height is None else height
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return space.add_lwpolyline(corners, close=True, dxfattribs=attributes)


def everything(space):
    """One of each kind of curve, none of them straight above the origin."""
    space.add_line((0, 0), (30, 0))
    space.add_circle((15, 10), 5)
    space.add_arc((40, 10), 8, 20, 200)
    space.add_lwpolyline([(0, 20, 0.5), (10, 20, -0.3), (10, 30, 0), (0, 30, 1)], format="xyb", close=True)
    space.add_ellipse((20, 50), (12, 4), 0.4, 0.3, 4.5)
    space.add_open_spline([(0, 60, 0), (10, 90, 5), (40, 90, 9), (50, 60, 2), (80, 70, 0)])
    space.add_polyline3d([(0, 100, 0), (10, 110, 10), (20, 100, 5)])


# Places


@pytest.mark.parametrize("extrusion", [(0, 0.6, 0.8), (0, 0, -1), (1, 1, 1)])
def test_a_tilted_circle_lies_where_its_own_axes_and_its_elevation_put_it(sheet, extrusion):
    drawing = sheet(lambda space: space.add_circle((10, 20, 30), 7, dxfattribs={"extrusion": extrusion}))
    centre = OCS(extrusion).to_wcs((10, 20, 30))
    low, high = drawing.bounds
    assert 0.5 * (low + high) == pytest.approx([centre.x, centre.y], abs=CHORD)
    flat = abs(extrusion[2]) / np.sqrt(np.dot(extrusion, extrusion))  # as high as it is wide, seen from above
    assert drawing.cut_length == pytest.approx(4 * 7 * ellipe(1 - flat**2), rel=1e-3)


@pytest.mark.parametrize("extrusion", [(0, 0.6, 0.8), (0, 0, -1)])
def test_a_polyline_is_lifted_by_its_elevation(sheet, extrusion):
    attributes = {"extrusion": extrusion, "elevation": 12}
    drawing = sheet(lambda space: space.add_lwpolyline([(0, 0), (10, 0), (10, 5)], dxfattribs=attributes))
    corners = [OCS(extrusion).to_wcs((x, y, 12)) for x, y in ((0, 0), (10, 0), (10, 5))]
    expected = np.array([(v.x, v.y) for v in corners])
    assert np.sort(drawing.pieces[0], axis=0) == pytest.approx(np.sort(expected, axis=0))


@pytest.mark.parametrize(
    "placed",
    [
        {"xscale": -1},
        {"xscale": -2, "yscale": 0.7, "rotation": -70},
        {"extrusion": (0, 0, -1), "rotation": 20},
        {"insert": (5, 6, 70), "extrusion": (0.3, 0.6, 0.8), "xscale": 1.5, "rotation": 20},
    ],
)
def test_blocks_within_blocks_lie_where_both_matrices_put_them(sheet, placed):
    inserts = []

    def draw(space):
        inner, outer = space.doc.blocks.new("inner", base_point=(3, 4, 0)), space.doc.blocks.new("outer")
        everything(inner)
        inserts.append(outer.add_blockref("inner", placed.get("insert", (100, 0)), dxfattribs=placed))
        inserts.append(space.add_blockref("outer", (0, 0), dxfattribs={"xscale": 1.3, "yscale": 0.8, "rotation": 15}))

    drawing = sheet(draw)
    flat = []
    for entity in inserts[0].block():
        curved = entity.dxftype() in ("SPLINE", "ELLIPSE")
        vertices = entity.flattening(1e-3) if curved else paths.make_path(entity).flattening(1e-3, segments=16)
        moved = inserts[1].matrix44().transform_vertices(list(inserts[0].matrix44().transform_vertices(vertices)))
        flat.append(np.array([(v.x, v.y) for v in moved]))
    points, (low, high) = np.concatenate(flat), drawing.bounds
    assert low == pytest.approx(points.min(axis=0), abs=2 * CHORD)
    assert high == pytest.approx(points.max(axis=0), abs=2 * CHORD)
    expected = sum(np.hypot(*np.diff(p, axis=0).T).sum() for p in flat)
    assert drawing.cut_length == pytest.approx(expected, rel=1e-3)


def test_a_grid_of_blocks_keeps_its_spacing_whatever_the_scale(sheet):
    def draw(space):
        box(space.doc.blocks.new("hole"), 0, 0, 5)
        grid = {"row_count": 2, "row_spacing": 10, "column_count": 2, "column_spacing": 20, "xscale": 2, "rotation": 90}
        space.add_blockref("hole", (0, 0), dxfattribs=grid)

    corners = sorted(tuple(piece.min(axis=0).round(6).tolist()) for piece in sheet(draw).pieces)
    assert corners == [(-15, 0), (-15, 20), (-5, 0), (-5, 20)]


# Clipping


@pytest.mark.parametrize(("inverted", "length"), [(False, 20.0 + 20.0), (True, 80.0 + 80.0)])
def test_a_clipped_block_is_cut_where_it_shows(sheet, inverted, length):
    def draw(space):
        block = space.doc.blocks.new("bars")
        for y in (5, 15):
            block.add_line((0, y), (50, y))
        clip = XClip(space.add_blockref("bars", (100, 0), dxfattribs={"xscale": 2, "yscale": 2}))
        clip.set_block_clipping_path([(10, 0), (20, 20)])
        if inverted:
            clip.invert_clipping_path(ignore_acad_compatibility=True)

    drawing = sheet(draw)
    assert drawing.cut_length == pytest.approx(length)
    assert drawing.warnings == ["of clipped blocks (XCLIP) only what shows is cut: 'bars'"]
    if not inverted:
        assert [drawing.bounds[0][0], drawing.bounds[1][0]] == pytest.approx([120, 140])


def test_a_clipped_circle_is_an_arc_without_corners(sheet):
    def draw(space):
        space.doc.blocks.new("disc").add_circle((0, 0), 10)
        XClip(space.add_blockref("disc", (0, 0))).set_block_clipping_path([(-20, 0), (20, 20)])

    drawing = sheet(draw)
    assert (drawing.closed, [len(c) for c in drawing.corners]) == ([False], [0])
    assert drawing.cut_length == pytest.approx(10 * np.pi, rel=1e-3)


# What is not plotted, dashed, or somewhere else


def test_layers_that_are_not_plotted_are_left_out_and_named(sheet):
    def draw(space):
        space.doc.layers.add("Notes").dxf.plot = 0
        box(space, 0, 0, 10)
        box(space, 20, 0, 10, layer="Notes")
        box(space, 40, 0, 10, layer="Defpoints")

    drawing = sheet(draw)
    assert drawing.cut_length == pytest.approx(40)
    assert drawing.skipped == {
        "LWPOLYLINE on layer 'Notes', which is not plotted": 1,
        "LWPOLYLINE on layer 'Defpoints', which is not plotted": 1,
    }


def test_dashed_lines_are_left_out_whether_the_line_the_layer_or_the_block_says_so(sheet):
    def draw(space):
        space.doc.layers.add("Axes", linetype="CENTER")
        box(space, 0, 0, 10)
        space.add_line((0, 20), (10, 20), dxfattribs={"linetype": "HIDDEN"})
        space.add_line((0, 30), (10, 30), dxfattribs={"layer": "Axes"})
        space.doc.blocks.new("b").add_line((0, 40), (10, 40), dxfattribs={"linetype": "BYBLOCK"})
        space.add_blockref("b", (0, 0), dxfattribs={"linetype": "DASHED"})
        space.add_line((0, 50), (10, 50), dxfattribs={"layer": "Axes", "linetype": "CONTINUOUS"})

    drawing = sheet(draw)
    assert drawing.cut_length == pytest.approx(50)
    assert drawing.skipped == {f"LINE with line type {name}": 1 for name in ("HIDDEN", "CENTER", "DASHED")}


def test_a_drawing_of_dashed_lines_only_is_cut_and_says_so(sheet):
    drawing = sheet(lambda space: space.add_line((0, 0), (10, 0), dxfattribs={"linetype": "DASHED"}))
    assert drawing.cut_length == pytest.approx(10)
    assert drawing.warnings[0].startswith("all lines are dashed, so they are cut")


@pytest.mark.parametrize("state", ["off", "freeze", "dashed", "unplotted"])
def test_a_layer_that_is_named_is_cut_whatever_its_state(sheet, state):
    def draw(space):
        layer = space.doc.layers.add("Bend", linetype="CENTER" if state == "dashed" else "CONTINUOUS")
        if state == "unplotted":
            layer.dxf.plot = 0
        elif state != "dashed":
            getattr(layer, state)()
        box(space, 0, 0, 10, layer="bend")
        box(space, 20, 0, 30)

    assert sheet(draw).cut_length == pytest.approx(120)
    assert sheet(draw, layers="Bend").cut_length == pytest.approx(40)


def test_another_drawing_is_named_and_not_read(sheet):
    def draw(space):
        space.doc.add_xref_def("parts/bolt.dxf", "bolt")
        space.add_blockref("bolt", (0, 0))
        box(space, 0, 0, 10)

    drawing = sheet(draw)
    assert drawing.warnings == ["other drawings (XREF) are not read; bind them to cut them: 'parts/bolt.dxf'"]
    assert drawing.skipped == {"INSERT of another drawing": 1}


WALL = "  0\nAEC_WALL\n  5\nFFF1\n330\n1F\n100\nAcDbEntity\n  8\nWalls\n100\nAecDbEntity\n 90\n1\n100\nAecDbWall\n"


def test_an_entity_of_an_unknown_kind_is_counted_by_its_name(sheet):
    drawing = sheet(lambda space: box(space, 0, 0, 10), edit=lambda t: t.replace("ENTITIES\n", "ENTITIES\n" + WALL, 1))
    assert drawing.skipped == {"AEC_WALL (unknown)": 1}
    assert "Walls" not in drawing.layers


# Roles


def three_roles(space):
    space.doc.layers.add("Red", color=1)
    box(space, 0, 0, 10, layer="Red")
    box(space, 20, 0, 20, color=5)
    box(space, 60, 0, 30, true_color=0x00FF00)
    block = space.doc.blocks.new("b")
    box(block, 0, 0, 1, color=0)
    space.add_blockref("b", (200, 0), dxfattribs={"color": 1})


@pytest.mark.parametrize(
    ("colours", "length"),
    [
        ("red", 44),
        ("1", 44),
        ("cut=#ff0000,blue", 124),
        (("ignore=3",), 124),
        (("ignore=lime", "engrave=blue"), 44),
        ("cut=*", 244),
    ],
)
def test_colours_are_those_of_the_entity_its_layer_or_its_block(sheet, colours, length):
    assert sheet(three_roles, colours=colours).cut_length == pytest.approx(length)


def test_a_colour_that_is_not_there_is_refused_with_those_that_are(sheet):
    with pytest.raises(InvalidInput, match=r"no colour 'yellow'; .*#ff0000, #0000ff, #00ff00"):
        sheet(three_roles, colours="yellow")
    with pytest.raises(InvalidInput, match=r"colours: 'reddish': not a colour; allowed: a name such as red, #rrggbb"):
        sheet(three_roles, colours="reddish")


def test_what_is_engraved_is_counted_and_kept_out_of_the_job(sheet):
    drawing = sheet(three_roles, colours=("engrave=blue",))
    assert drawing.cut_length == pytest.approx(164)
    assert [np.hypot(*np.diff(p, axis=0).T).sum() for p in drawing.engraved] == pytest.approx([80])
    assert "1 contour, 80.0 mm, to be engraved: this machine only cuts, so kept out of the job" in (drawing.notes)


# Letters and filled areas


def test_letters_are_cut_on_request_and_filled_areas_too(sheet):
    def draw(space):
        space.add_text("I", height=10)
        space.add_mtext("I", {"char_height": 10, "insert": (50, 0)})
        space.add_hatch().paths.add_polyline_path([(100, 0), (120, 0), (120, 10), (100, 10)], is_closed=True)
        space.add_solid([(200, 0), (210, 0), (200, 10), (210, 10)])

    with pytest.raises(InvalidInput, match=r"--text cuts letters as outlines; --hatches cuts filled areas as outlines"):
        sheet(draw)
    areas = sheet(draw, hatches=True)
    assert sorted(np.hypot(*np.diff(p, axis=0).T).sum() for p in areas.pieces) == pytest.approx([40, 60])
    letters = sheet(draw, text=True)
    assert letters.closed == [True, True]
    assert [np.ptp(p[:, 1]) for p in letters.pieces] == pytest.approx([10, 10], rel=0.05)
    assert letters.warnings[0].startswith("letters are drawn with fonts of this computer: ")


# Units


@pytest.mark.parametrize(("insunits", "name", "mm"), [(9, "mils", 0.0254), (14, "dm", 100), (2, "feet", 304.8)])
def test_unusual_units_are_read(sheet, insunits, name, mm):
    drawing = sheet(lambda space: space.add_line((0, 0), (100, 0)), insunits)
    assert (drawing.units, drawing.cut_length) == (name, pytest.approx(100 * mm))


# Damage


def without(text, first, last):
    return text[: text.index(first)] + text[text.index(last) :]


@pytest.mark.parametrize(
    "edit",
    [
        lambda t: t.replace("100\nAcDbPolyline\n", ""),
        lambda t: without(t, "  0\nSECTION\n  2\nTABLES", "  0\nSECTION\n  2\nBLOCKS"),
        lambda t: t.replace("  2\nTABLES\n", "  2\nTABLES\nno code\n", 1),
        lambda t: t.replace(" 70\n1\n", " 70\nxx\n", 3),
        lambda t: t[: t.index("  0\nENDSEC", t.index("ENTITIES"))],
        lambda t: t.replace("\nModel\n", "\nNodel\n"),
    ],
    ids=["no AcDbPolyline", "no tables", "a stray line", "a flag that is none", "no end", "no model space"],
)
def test_a_damaged_drawing_is_repaired(sheet, edit):
    drawing = sheet(lambda space: box(space, 0, 0, 10), edit=edit)
    assert drawing.cut_length == pytest.approx(40)
    assert drawing.closed == [True]


def test_an_insert_without_a_name_shows_nothing(sheet):
    def draw(space):
        space.doc.blocks.new("hole").add_circle((0, 0), 3)
        space.add_blockref("hole", (10, 10))
        space.add_line((0, 0), (30, 0))

    drawing = sheet(draw, edit=lambda t: t.replace("AcDbBlockReference\n  2\nhole\n", "AcDbBlockReference\n"))
    assert drawing.cut_length == pytest.approx(30)
    assert any("INSERT" in line for line in drawing.warnings + drawing.notes)


def test_a_repair_is_told(sheet):
    drawing = sheet(lambda space: box(space, 0, 0, 10), edit=lambda t: t.replace("100\nAcDbPolyline\n", ""))
    assert drawing.warnings[0].startswith("the file is damaged and was repaired: missing 'AcDbPolyline' subclass")


@pytest.mark.parametrize(
    ("wrong", "left", "told"),
    [
        ("12.x", [30], "LINE in line "),
        ("1 2.0", [30], "LINE in line "),
        ("12,5", [30, 32.5], "numbers with a comma in place of a point are read as meant (1)"),
    ],
)
def test_a_coordinate_that_is_no_number_is_never_taken_as_another(sheet, wrong, left, told):
    def draw(space):
        space.add_line((0, 0), (30, 0))
        space.add_line((12.125, 50), (45, 50))

    drawing = sheet(draw, edit=lambda t: t.replace("\n12.125\n", f"\n{wrong}\n"))
    assert sorted(np.hypot(*np.diff(p, axis=0).T).sum() for p in drawing.pieces) == pytest.approx(left)
    assert any(told in line for line in drawing.warnings)


def test_a_polyline_with_a_vertex_that_is_no_number_goes_as_a_whole(sheet):
    def draw(space):
        space.add_polyline2d([(0, 0), (12.125, 0), (20, 10)])
        space.add_line((0, 50), (30, 50))

    drawing = sheet(draw, edit=lambda t: t.replace("\n12.125\n", "\n?\n"), version="R12")
    assert [p.tolist() for p in drawing.pieces] in ([[[0, 50], [30, 50]]], [[[30, 50], [0, 50]]])
    assert any("numbers that cannot be read is left out: POLYLINE in line" in line for line in drawing.warnings)


# Bombs


def endless_grid(space):
    space.doc.blocks.new("dot").add_circle((0, 0), 1)
    grid = {"row_count": 32767, "column_count": 32767, "row_spacing": 3, "column_spacing": 3}
    space.add_blockref("dot", (0, 0), dxfattribs=grid)


def tower(space):
    inner = None
    for level in range(12):
        block = space.doc.blocks.new(f"level{level}")
        for i in range(10):
            block.add_blockref(inner, (i, 0)) if inner else block.add_line((0, i), (1, i))
        inner = f"level{level}"
    space.add_blockref(inner, (0, 0))


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (endless_grid, "more than 100000 entities, those of repeated blocks counted each time"),
        (tower, "more than 100000 entities, those of repeated blocks counted each time"),
        (lambda space: [space.add_circle((i, 0), 1e7) for i in range(300)], r"more than 1e\+07 mm to cut"),
        (lambda space: space.add_line((0, 0), (1e12, 0)), r"LINE #\w+ reaches 1e\+12 mm away from the origin"),
        (lambda space: space.add_line((0, 0), (1e300, 0)), r"LINE #\w+ reaches 1e\+300 mm away from the origin"),
    ],
)
def test_a_drawing_beyond_all_measure_is_refused_at_once(sheet, draw, message):
    began = time.process_time()
    with pytest.raises(InvalidInput, match=message):
        sheet(draw)
    assert time.process_time() - began < 5.0


def inserted(**attributes):
    def draw(space):
        space.doc.blocks.new("wheel").add_circle((0, 0), 1)
        space.add_blockref("wheel", attributes.pop("at", (0, 0)), dxfattribs=attributes)

    return draw


FAR = {
    "circle": ("CIRCLE", lambda v: lambda space: space.add_circle((0, 0), v)),
    "its centre": ("CIRCLE", lambda v: lambda space: space.add_circle((v, 0), 5)),
    "arc": ("ARC", lambda v: lambda space: space.add_arc((0, 0), v, 0, 90)),
    "ellipse": ("ELLIPSE", lambda v: lambda space: space.add_ellipse((v, 0), (1, 0), 0.5)),
    "spline": ("SPLINE", lambda v: lambda space: space.add_open_spline([(0, 0), (v, 0), (1, 1), (2, 2)])),
    "polyline": ("LWPOLYLINE", lambda v: lambda space: space.add_lwpolyline([(0, 0), (v, 0), (1, 1)])),
    "bulge": ("LWPOLYLINE", lambda v: lambda space: space.add_lwpolyline([(0, 0, v), (5, 0, v)], format="xyb")),
    "old polyline": ("POLYLINE", lambda v: lambda space: space.add_polyline2d([(0, 0), (v, 0), (1, 1)])),
    "line": ("LINE", lambda v: lambda space: space.add_line((v, 0), (v, 1))),
    "scale": ("CIRCLE", lambda v: inserted(xscale=v, yscale=v)),
    "place": ("CIRCLE", lambda v: inserted(at=(v, 0))),
    "spacing": ("CIRCLE", lambda v: inserted(column_count=2, column_spacing=v)),
}


@pytest.mark.parametrize("value", [1e12, 1e300, float("inf"), float("nan")])
@pytest.mark.parametrize("what", FAR)
def test_what_lies_beyond_numbers_is_named_with_its_handle_and_the_limit(sheet, what, value, recwarn):
    kind, draw = FAR[what]
    said = rf"part.dxf: {kind} #\w+ reaches \S+ mm away from the origin, out of range; allowed: 1e\+09 mm \(1000 km\)"
    none = rf"{kind} that cannot be read \(\d\); entities that cannot be read are left out: {kind}\(#\w+\): coord"
    with pytest.raises(InvalidInput, match=said if np.isfinite(value) or (what == "bulge" and value > 0) else none):
        sheet(draw(value))
    assert not recwarn.list


def test_a_spline_pulled_into_a_corner_is_read_at_once(sheet):
    began = time.process_time()
    ends = [(0, 0), (3, 0), (1, 1), (2, 2)]
    drawing = sheet(lambda space: space.add_rational_spline(ends, weights=[1, 1e300, 1, 1]))
    assert time.process_time() - began < 3.0
    assert drawing.cut_length == pytest.approx(3.0 + np.hypot(1, 2), abs=1e-6)  # from its start to there and on


def test_a_block_that_the_reader_has_dropped_is_left_out_with_its_name(sheet, monkeypatch):
    """As it does with some that are damaged, although their names stay."""
    from ezdxf.entities import Insert

    known = Insert.block

    def block(insert):
        found = known(insert)
        found.block.destroy()
        return found

    monkeypatch.setattr(Insert, "block", block)
    drawing = sheet(lambda space: (inserted()(space), box(space, 0, 0, 10)))
    assert drawing.skipped == {"INSERT of a missing block": 1}
    assert any("'wheel'" in note for note in drawing.notes)


def test_a_file_of_more_entities_than_are_read_is_refused_before_they_are(tmp_path):
    line = "  0\nLINE\n  8\n0\n 10\n0\n 20\n0\n 11\n1\n 21\n1\n"
    file = tmp_path / "many.dxf"
    file.write_text(f"  0\nSECTION\n  2\nENTITIES\n{line * 100_001}  0\nENDSEC\n  0\nEOF\n", encoding="utf-8")
    began = time.process_time()
    with pytest.raises(InvalidInput, match="more than 100000 entities; allowed: no more"):
        read_dxf(file)
    assert time.process_time() - began < 2.0
