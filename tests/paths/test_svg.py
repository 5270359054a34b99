"""SVG: outlines in mm with the y axis up, against closed forms and svgpathtools' own lengths."""

import re

import numpy as np
import pytest
import svgpathtools
from scipy.special import ellipe

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths.choice import Reading
from kerfgym.envs.paths.curve import CHORD
from kerfgym.envs.paths.svg import read_svg

XML = (
    'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
    'xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"'
)
PAGE = 'width="200mm" height="100mm" viewBox="0 0 200 100"'


@pytest.fixture
def picture(tmp_path):
    """Writes what stands in an svg element on lines of its own, from line 2 on, and reads it."""

    def read(*lines, page=PAGE, **choices):
        (tmp_path / "part.svg").write_text("\n".join([f"<svg {XML} {page}>", *lines, "</svg>"]), encoding="utf-8")
        return read_svg(tmp_path / "part.svg", Reading(**choices))

    return read


def boxes(drawing):
    return [[*p.min(axis=0).round(6).tolist(), *p.max(axis=0).round(6).tolist()] for p in drawing.pieces]


# Shapes


@pytest.mark.parametrize(
    ("shape", "length", "box", "corners"),
    [
        ('<rect x="10" y="20" width="30" height="40"/>', 140, [10, 40, 40, 80], 4),
        ('<rect x="10" y="20" width="30" height="40" rx="5"/>', 100 + 10 * np.pi, [10, 40, 40, 80], 0),
        ('<rect x="10" y="20" width="30" height="40" rx="50" ry="0"/>', 140, [10, 40, 40, 80], 4),
        ('<rect x="10" y="20" width="30" height="40" rx="50"/>', 80 * ellipe(1 - 0.75**2), [10, 40, 40, 80], 0),
        ('<circle cx="50" cy="30" r="10"/>', 20 * np.pi, [40, 60, 60, 80], 0),
        ('<ellipse cx="50" cy="30" rx="20" ry="10"/>', 80 * ellipe(0.75), [30, 60, 70, 80], 0),
        ('<line x1="1" y1="2" x2="31" y2="42"/>', 50, [1, 58, 31, 98], 0),
        ('<polyline points="0,0 30,0 30,40"/>', 70, [0, 60, 30, 100], 1),
        ('<polygon points="0 0 30 0 30 40"/>', 120, [0, 60, 30, 100], 3),
        ('<path d="M10 10h20v20z"/>', 40 + np.hypot(20, 20), [10, 70, 30, 90], 3),
        ('<path d="M 0 0 A 10 10 0 0 1 20 0 L 20 30"/>', 10 * np.pi + 30, [0, 70, 20, 110], 0),
    ],
)
def test_basic_shapes_have_their_length_place_and_corners(picture, shape, length, box, corners):
    drawing = picture(shape)
    assert drawing.cut_length == pytest.approx(length, rel=2e-4)
    assert boxes(drawing) == [pytest.approx(box, abs=CHORD)]
    assert [len(c) for c in drawing.corners] == [corners]
    assert drawing.notes == []
    assert drawing.units == "mm"


@pytest.mark.parametrize(
    "data",
    [
        "M10 10 C 40 10 0 60 50 50 S 80 10 90 90",
        "m10,10 q30,0 20,40 t30,10 T 90 50",
        "M10 10 a 25 10 30 1 1 20 5 A 40 20 -15 0 0 90 60",
        "M10-10.5.5 20e0L 90.25,1e1 H5V.5",
    ],
)
def test_path_data_is_as_long_as_the_library_says(picture, data):
    drawing = picture(f'<path d="{data}"/>')
    path = svgpathtools.parse_path(data)
    left, right, top, bottom = path.bbox()
    assert drawing.cut_length == pytest.approx(path.length(), rel=2e-4)
    assert boxes(drawing) == [pytest.approx([left, 100 - bottom, right, 100 - top], abs=CHORD)]


def test_every_subpath_is_a_contour_and_holes_come_first(picture):
    drawing = picture('<path d="M0 0h90v90h-90z m20 20h10v10h-10z M60 60l9 0 0 9 M100 100 z"/>')
    assert drawing.closed == [False, True, True] or drawing.closed == [True, False, True]
    assert boxes(drawing)[-1] == [0, 10, 90, 100]
    assert drawing.cut_length == pytest.approx(360 + 40 + 18)


def test_a_path_that_goes_on_from_where_it_closed_leaves_two_contours(picture):
    drawing = picture('<path d="M50 50h10v10z l-20 0"/>')
    assert sorted(drawing.closed) == [False, True]


def test_separate_lines_are_joined_as_those_of_other_drawings(picture):
    drawing = picture('<line x2="30" y2="40"/>', '<path d="M30 0L30 40"/>', '<line x1="30" x2="0"/>')
    assert drawing.closed == [True]
    assert drawing.cut_length == pytest.approx(120)


def test_a_cusp_of_bezier_curves_is_a_corner_and_a_smooth_joint_is_none(picture):
    drawing = picture('<path d="M10 50C10 10 40 10 40 50 40 90 70 90 70 50C70 90 90 90 90 50"/>')
    (piece,), (found,) = drawing.pieces, drawing.corners
    assert piece[found] == pytest.approx(np.array([[70, 50]]))


# Units and places


@pytest.mark.parametrize(
    ("page", "mm", "name"),
    [
        ('width="200mm" height="100mm" viewBox="0 0 200 100"', 1.0, "mm"),
        ('width="20cm" height="10cm" viewBox="0 0 200 100"', 1.0, "cm"),
        ('width="2in" height="1in" viewBox="0 0 200 100"', 0.254, "inches"),
        ('width="144pt" viewBox="0 0 200 100"', 0.254, "pt"),
        ('width="200px" height="100px" viewBox="0 0 200 100"', 25.4 / 96, "px"),
        ('width="200" height="100"', 25.4 / 96, "px"),
        ('viewBox="0 0 200 100"', 25.4 / 96, "px"),
        ('width="100%" height="100%" viewBox="0 0 200 100"', 25.4 / 96, "px"),
        ("", 25.4 / 96, "px"),
        ('width="200mm" height="200mm" viewBox="0 0 200 100"', 1.0, "mm"),
    ],
)
def test_the_size_of_the_page_and_its_view_box_give_the_scale(picture, page, mm, name):
    drawing = picture('<circle cx="50" cy="50" r="30"/>', page=page)
    assert drawing.cut_length == pytest.approx(60 * np.pi * mm, rel=1e-3)
    assert drawing.units == name
    warned = [w for w in drawing.warnings if "px" in w and "1/96 inch" in w]
    assert len(warned) == len(drawing.warnings) == (name == "px")


def test_without_a_usable_size_the_warning_says_so(picture):
    drawing = picture('<circle cx="50" cy="50" r="30"/>', page='viewBox="0 0 200 100"')
    (warning,) = drawing.warnings
    assert warning.startswith("no usable size of the page, px read as 1/96 inch")


@pytest.mark.parametrize(("units", "mm"), [("mm", 1), ("inches", 25.4)])
def test_a_chosen_unit_is_that_of_the_view_box(picture, units, mm):
    drawing = picture('<rect x="10" y="10" width="20" height="10"/>', page='viewBox="10 0 200 100"', units=units)
    assert boxes(drawing) == [pytest.approx([0, 80 * mm, 20 * mm, 90 * mm])]
    assert (drawing.warnings, drawing.units) == ([], units)


def test_lengths_may_have_units_and_percentages_of_their_own(picture):
    drawing = picture('<rect x="10mm" y="0" width="25%" height="10%"/>', page='width="100mm" height="50mm"')
    assert boxes(drawing) == [pytest.approx([10, 45, 35, 50], abs=1e-5)]
    assert "no viewBox" in drawing.warnings[0]


@pytest.mark.parametrize(
    ("ratio", "box"),
    [
        ("", [60, 0, 140, 80]),
        ("xMinYMin", [10, 0, 90, 80]),
        ("none", [20, 0, 180, 80]),
        ("xMaxYMid slice", [20, -50, 180, 110]),
    ],
)
def test_the_view_box_is_fitted_as_its_aspect_ratio_says(picture, ratio, box):
    page = f'width="200mm" height="100mm" viewBox="-1 2 10 10" preserveAspectRatio="{ratio}"'
    if ratio == "":
        page = page.replace('preserveAspectRatio=""', "")
    drawing = picture('<rect x="0" y="4" width="8" height="8"/>', page=page)
    assert boxes(drawing) == [pytest.approx(box)]


@pytest.mark.parametrize(
    "transform",
    ["rotate(30) scale(2 0.5)", "matrix(0 1 1 0 5 5)", "skewX(40) translate(10, 20) rotate(-70 3 4)", "scale(-1,1)"],
)
def test_a_circle_is_transformed_as_its_matrix_says(picture, transform):
    m = svgpathtools.parse_transform(transform)
    drawing = picture(f'<g transform="{transform}"><circle cx="40" cy="30" r="20"/></g>')
    x, y, _ = m @ (40, 30, 1)
    half = 20 * np.hypot(*m[:2, :2].T)
    assert boxes(drawing) == [
        pytest.approx([x - half[0], 100 - y - half[1], x + half[0], 100 - y + half[1]], abs=CHORD)
    ]
    a, b = 20 * np.linalg.svd(m[:2, :2])[1]
    assert drawing.cut_length == pytest.approx(4 * a * ellipe(1 - (b / a) ** 2), rel=1e-3)
    assert drawing.corners[0].tolist() == []


def test_a_turned_arc_in_a_mirrored_group_stays_the_same_curve(picture):
    data = "M40 40 A 20 8 35 0 1 70 45"
    plain = picture(f'<path d="{data}"/>').pieces[0]
    mirrored = picture(f'<g transform="matrix(0,-1,-1,0,100,100)"><path d="{data}"/></g>').pieces[0]
    x, y = plain[:, 0], 100 - plain[:, 1]
    expected = np.column_stack([100 - y, x])
    ends = expected[[0, -1]] if np.hypot(*(expected[0] - mirrored[0])) < 1 else expected[[-1, 0]]
    assert mirrored[[0, -1]] == pytest.approx(ends)
    assert mirrored.min(axis=0) == pytest.approx(expected.min(axis=0), abs=CHORD)
    assert mirrored.max(axis=0) == pytest.approx(expected.max(axis=0), abs=CHORD)


def test_uses_and_symbols_are_drawn_where_they_are_used(picture):
    drawing = picture(
        '<defs><rect id="r" width="10" height="10"/></defs>',
        '<symbol id="s" viewBox="0 0 2 1"><rect width="1" height="1"/></symbol>',
        '<use href="#r" x="50" y="20"/>',
        '<use xlink:href="#r" transform="translate(100 0) scale(2)"/>',
        '<use href="#s" x="150" y="50" width="20" height="10"/>',
    )
    assert sorted(boxes(drawing)) == [[50, 70, 60, 80], [100, 80, 120, 100], [150, 40, 160, 50]]


def test_a_picture_in_the_picture_has_axes_of_its_own(picture):
    drawing = picture(
        '<svg x="20" y="10" width="50%" height="50" viewBox="0 0 10 5"><rect width="1" height="1"/></svg>'
    )
    assert boxes(drawing) == [[20, 80, 30, 90]]


# Layers, and what is left out


def test_layers_of_inkscape_are_chosen_by_their_label(picture):
    lines = [
        '<g id="g1" inkscape:groupmode="layer" inkscape:label="Cut"><g id="x"><rect width="10" height="10"/></g></g>',
        '<g id="g2" inkscape:groupmode="layer" inkscape:label="Engrave"><rect x="20" width="10" height="10"/></g>',
        '<rect x="40" width="10" height="10"/>',
    ]
    assert picture(*lines).layers == ["Cut", "Engrave"]
    assert len(picture(*lines).pieces) == 3
    drawing = picture(*lines, layers=("cut",))
    assert (drawing.layers, boxes(drawing)) == (["Cut"], [[0, 90, 10, 100]])
    assert drawing.skipped == {"rect on layer 'Engrave'": 1, "rect on no layer": 1}
    with pytest.raises(InvalidInput, match=r"no layer 'Cutt'; did you mean 'Cut'\? \(known: Cut, Engrave\)"):
        picture(*lines, layers=("Cutt",))


def test_other_pictures_have_their_outermost_groups_for_layers(picture):
    lines = ['<g id="A"><g id="B"><rect width="9" height="9"/></g></g>', '<g id="C"><rect width="7" height="7"/></g>']
    assert picture(*lines).layers == ["C", "A"] or picture(*lines).layers == ["A", "C"]
    assert picture(*lines, layers="C").cut_length == pytest.approx(28)


def test_what_is_not_cut_is_counted(picture):
    drawing = picture(
        "<title>part</title><metadata/><style>rect{fill:red}</style>",
        '<text x="1" y="2">part 7</text><text>8</text><image href="a.png"/><foreignObject/>',
        '<rect width="10" height="10"/><rect width="10" height="10"/><line x1="1" y1="1" x2="1" y2="1"/>',
        '<rect width="0" height="5"/><path d="M3 3"/><path d=""/>',
        '<g style="display:none"><rect x="20" width="5" height="5"/></g>',
        '<g visibility="hidden"><rect width="5" height="5"/>',
        '<rect visibility="visible" x="50" width="5" height="5"/></g>',
    )
    assert boxes(drawing) == [[0, 90, 10, 100], [50, 95, 55, 100]]
    assert drawing.skipped == {
        "text": 2,
        "image": 1,
        "foreignObject": 1,
        "duplicate rect": 1,
        "line of zero length": 1,
        "rect of zero length": 1,
        "path of zero length": 1,
        "hidden g": 1,
        "hidden rect": 1,
    }
    assert drawing.warnings == []


def test_what_changes_only_the_looks_is_named(picture):
    drawing = picture(
        "<style>g &gt; rect { display: none } /* g */</style>",
        '<rect width="10" height="10" clip-path="url(#c)"/>',
        '<rect x="20" width="10" height="10" style="stroke-dasharray: 1,1"/>',
        '<rect x="40" width="10" height="10" style="stroke-dasharray:none" mask="none"/>',
    )
    assert drawing.warnings == [
        "style sheet: some rules are not read: 'g > rect' in line 2",
        "clip-path clips nothing, whole shapes are cut: line 3",
        "stroke-dasharray is left out, dashes are cut as one line: line 4",
    ]


# Errors


@pytest.mark.parametrize(
    ("element", "message"),
    [
        ('<path d="M0 0 L nan 3"/>', r"line 3: path: path data cannot be read from 'nan 3'"),
        ('<path d="L 3 4"/>', r"line 3: path: path data cannot be read from 'L 3 4'"),
        ('<path d="M0 0 L 10px 5"/>', r"cannot be read from 'px 5'"),
        ('<path d="M0 0 L 10"/>', r"line 3: path: path data cannot be read: .*expects 2 values"),
        ('<path d="M0 0 L 1e400 5"/>', r"line 3: path: coordinates that are not numbers"),
        ('<path d="M0 0 A 5 5 0 1 1 0 0"/>', r"cannot be read: an arc that ends where it begins"),
        ('<circle r="ten"/>', r"line 3: circle: r = 'ten' is not a length; allowed: a number with px, mm, cm"),
        ('<circle r="2lh"/>', r"r = '2lh' is not a length"),
        ('<rect width="-3" height="5"/>', r"line 3: rect: its size is negative"),
        ('<polygon points="0 0 1 1 2"/>', r"line 3: polygon: points has 5 numbers; they must come in pairs"),
        ('<polygon points="0 0 1 nan"/>', r"line 3: polygon: points = '0 0 1 nan' are not all numbers"),
        ('<g transform="turn(30)"><rect width="5" height="5"/></g>', r"line 3: g: transform cannot be read: .*turn"),
        ('<g style="transform:rotate(9deg)"/>', r"line 3: g: transform cannot be read"),
        ('<use href="#none"/>', r"line 3: use: href = '#none' is nothing in this file"),
        ('<use href="other.svg#a"/>', r"line 3: use: href = 'other.svg#a' is nothing in this file"),
        ('<svg viewBox="0 0 0 5"/>', r"line 3: svg: viewBox = '0 0 0 5' is not"),
    ],
)
def test_elements_that_cannot_be_read_are_left_out_and_named_with_their_line(picture, element, message):
    drawing = picture('<rect x="50" width="5" height="5"/>', element)
    assert drawing.cut_length == pytest.approx(20)
    (warning,) = drawing.warnings
    assert re.search(rf"elements that cannot be read are left out: .*{message}", warning)
    with pytest.raises(InvalidInput, match=message.replace("line 3", "line 2")):
        picture(element)


@pytest.mark.parametrize(
    ("element", "message"),
    [
        ('<g id="me"><use href="#me"/></g>', r"line 3: \w+: nested more than 64 deep; does something use itself\?"),
        ("<rect>", r"line 4: cannot be read as SVG: mismatched tag"),
    ],
)
def test_mistakes_of_the_whole_file_are_refused_with_their_line(picture, element, message):
    with pytest.raises(InvalidInput, match=rf"part\.svg, {message}"):
        picture('<rect x="50" width="5" height="5"/>', element)


@pytest.mark.parametrize("bracket", ["(", "["])
def test_a_style_sheet_of_brackets_within_brackets_is_left_out_and_told(picture, bracket):
    style = "a{fill:" + 5000 * bracket
    drawing = picture(f"<style>{style}</style>", '<rect x="50" width="5" height="5"/>')
    assert drawing.cut_length == pytest.approx(20)
    assert any(f"all of {len(style)} characters" in warning for warning in drawing.warnings)


@pytest.mark.parametrize("content", ["", "no picture", "<html></html>", "\0\0", "<g>" * 5000 + "</g>" * 5000])
def test_what_is_not_svg_is_refused(tmp_path, content):
    (tmp_path / "part.svg").write_text(content)
    with pytest.raises(InvalidInput, match=r"part\.svg.*: cannot be read as SVG: "):
        read_svg(tmp_path / "part.svg")


def test_a_picture_with_nothing_to_cut_says_what_is_in_it(picture):
    with pytest.raises(InvalidInput, match=r"nothing to cut in it; what is cut: path, rect, .*; skipped: text \(1\)"):
        picture("<text>empty</text>")


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ('width="0mm" height="5mm"', "width = '0mm' is out of range"),
        ('width="wide"', "width = 'wide' is not a length"),
        ('viewBox="0 0 1"', "viewBox = '0 0 1' is not x, y"),
    ],
)
def test_a_page_of_no_size_is_refused(picture, page, message):
    with pytest.raises(InvalidInput, match=rf"part\.svg, line 1: svg: {message}"):
        picture('<rect width="5" height="5"/>', page=page)
