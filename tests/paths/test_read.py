"""Reading a path of any format, and whether it suits a job."""

import re
from pathlib import Path

import ezdxf
import ezdxf.path
import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths.checks import check_travel
from kerfgym.envs.paths.curve import CHORD
from kerfgym.envs.paths.read import FORMATS, read

REAL = Path(__file__).parents[3] / "shared" / "data" / "paths"
"""Files that nobody here drew; they do not come with the project."""

real = pytest.mark.skipif(not REAL.is_dir(), reason="the real files are not here")

PROGRAMME = "G21 G0 X10 Y20\nM3\nG1 X1210 F600\nY70\nX10\nY20\nM2\n"
PICTURE = """<svg xmlns="http://www.w3.org/2000/svg" width="2in" height="1in" viewBox="0 0 20 10">
<g id="CUT"><path d="M0 0h10v10"/></g><g id="BEND"><rect width="3" height="3"/></g></svg>"""


# Formats


@pytest.mark.parametrize("name", ["part.ngc", "part.nc", "PART.GCODE", "part.tap", "part.cnc"])
def test_programmes_go_by_many_names(tmp_path, name):
    (tmp_path / name).write_text(PROGRAMME)
    drawing = read(str(tmp_path / name))
    assert drawing.cut_length == pytest.approx(2500)
    assert drawing.bounds[0].tolist() == [10, 20]
    assert drawing.bounds[1].tolist() == [1210, 70]


def test_layers_and_units_are_handed_on(tmp_path):
    (tmp_path / "part.svg").write_text(PICTURE)
    assert read(tmp_path / "part.svg", layers=("CUT",)).cut_length == pytest.approx(2 * 25.4)
    assert read(tmp_path / "part.svg", layers=("CUT",), units="mm").cut_length == pytest.approx(20)
    (tmp_path / "PART.DXF").write_bytes(b"")
    with pytest.raises(InvalidInput, match=r"PART\.DXF: cannot be read as DXF"):
        read(tmp_path / "PART.DXF")


@pytest.mark.parametrize(
    ("suffix", "nearest"), [(".dfx", "did you mean '.dxf'"), (".ncg", "did you mean '.nc'"), ("", "(known: .dxf, .svg")]
)
def test_other_formats_are_refused_with_those_that_are_read(tmp_path, suffix, nearest):
    file = tmp_path / f"part{suffix}"
    file.touch()
    with pytest.raises(InvalidInput) as error:
        read(file)
    assert f"'{suffix}' files cannot be read; " in str(error.value)
    assert nearest in str(error.value)
    assert all(known in str(error.value) for known in FORMATS)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InvalidInput, match=r"none\.svg: no such file"):
        read(tmp_path / "none.svg")


# Checks


def test_a_drawing_larger_than_the_travel_is_refused_with_both_sizes(tmp_path):
    (tmp_path / "part.ngc").write_text(PROGRAMME)
    drawing = read(tmp_path / "part.ngc")
    check_travel(drawing, (1500, 1000))
    check_travel(drawing, (1200, 50))
    with pytest.raises(InvalidInput, match=r"'part' is 1200\.0 × 50\.0 mm; allowed: the travel of 1199 × 1000 mm;"):
        check_travel(drawing, (1199, 1000))
    with pytest.raises(InvalidInput, match=r"1000 × 1500 mm; turned by 90° it would fit; it was read in mm$"):
        check_travel(drawing, (1000, 1500))


# Real files


DXF = {
    "Gear": (255, 226, "mm"),
    "RoundedRectangleInside": (2, 2, "mm"),
    "SingleSpline": (1, 1, "mm"),
    "SquareWithCircleHoleSimpleR12": (2, 2, "mm"),
    "full_ellipse": (1, 1, "mm"),
    "square-with-open-curve": (2, 1, "mm"),
    "squares-internal-cusps": (16, 16, "mm"),
}
"""Contours, closed ones, unit."""


@real
@pytest.mark.parametrize("name", DXF)
def test_a_real_drawing_has_the_length_and_the_box_of_another_reading(name):
    drawing = read(REAL / f"{name}.dxf")
    flat = [
        np.array([(v.x, v.y) for v in ezdxf.path.make_path(entity).flattening(1e-4)])
        for entity in ezdxf.readfile(REAL / f"{name}.dxf").modelspace()
    ]
    points = np.concatenate(flat)
    low, high = drawing.bounds
    assert drawing.cut_length == pytest.approx(sum(np.hypot(*np.diff(p, axis=0).T).sum() for p in flat), rel=1e-4)
    assert low == pytest.approx(points.min(axis=0), abs=CHORD)
    assert high == pytest.approx(points.max(axis=0), abs=CHORD)
    assert (len(drawing.pieces), sum(drawing.closed), drawing.units) == DXF[name]
    assert drawing.skipped == {}


@real
@pytest.mark.parametrize(
    ("name", "corners"),
    [
        ("SquareWithCircleHoleSimpleR12", [0, 4]),
        ("RoundedRectangleInside", [2, 4]),
        ("full_ellipse", [0]),
        ("SingleSpline", [0]),
        ("square-with-open-curve", [0, 4]),
    ],
)
def test_a_real_drawing_has_the_corners_that_one_sees(name, corners):
    assert sorted(len(c) for c in read(REAL / f"{name}.dxf").corners) == corners


@real
def test_drawings_without_a_unit_say_so():
    assert read(REAL / "Gear.dxf").warnings[0].startswith("no unit in the header, read as mm")
    assert "although $MEASUREMENT says inches" in read(REAL / "SingleSpline.dxf").warnings[0]
    assert read(REAL / "full_ellipse.dxf").warnings == []


@real
def test_the_wrench_is_as_long_as_counted_by_hand():
    drawing = read(REAL / "imperial_wrench.ngc")

    def turn(radius, chord):  # all of them turn by 180° at most
        return 2 * radius * np.arcsin(min(chord / (2 * radius), 1.0))

    outline = sum(
        [
            0.1968,  # up the left side
            turn(0.1181, np.hypot(0.0386, 0.0874)),
            turn(0.98575, np.hypot(1.4633, 0.1547)),
            turn(0.7803, np.hypot(0.5827, 0.2579)),
            np.hypot(3.5382, 0.0787),
            turn(0.2362, 0.4725),  # the end of the handle
            np.hypot(3.5382, 0.0787),
            turn(0.7874, np.hypot(0.5828, 0.2579)),
            turn(0.9818, np.hypot(1.4633, 0.1546)),
            turn(0.1038, np.hypot(0.0385, 0.0873)),
            0.0988 + 0.6692,
            turn(0.6299, 1.0827),  # the jaw
            0.6692,
        ]
    )
    hole, wrench = drawing.pieces
    assert np.hypot(*np.diff(hole, axis=0).T).sum() == pytest.approx(25.4 * 2 * np.pi * 0.0787, rel=1e-3)
    assert np.hypot(*np.diff(wrench, axis=0).T).sum() == pytest.approx(25.4 * outline, rel=1e-3)
    low, high = drawing.bounds
    assert low == pytest.approx(25.4 * np.array([0.1935, 1.0770 - 0.98183]), abs=0.02)
    assert high == pytest.approx(25.4 * np.array([5.8165 + 0.2362, 1.0784 + 0.98575]), abs=0.02)
    assert (drawing.closed, drawing.units, drawing.feeds) == ([True, False], "inches", None)
    assert [w.split(" (")[0] for w in drawing.warnings] == [
        "G64",
        "M52",
        "F#<_hal[plasmac.cut-feed-rate]> is known to the machine only; the feed is left open",
        "S",
        "line 3: #<holes> is set and not read by this programme",
    ]


@real
def test_circle_diamond_square_is_as_long_as_its_lines_say():
    here, total, motion = np.zeros(2), 0.0, ""
    for line in (REAL / "cds.ngc").read_text().lower().splitlines():
        words = dict(re.findall(r"([gxyr])\+?(-?[\d.]+)", re.sub(r"\(.*|^n\d+", "", line)))
        motion = words.get("g", motion)
        there = np.array([float(words.get(axis, old)) for axis, old in zip("xy", here, strict=True)])
        chord = np.hypot(*(there - here))
        if motion in ("2", "3") and chord:
            total += 2 * float(words["r"]) * np.arcsin(min(chord / (2 * float(words["r"])), 1.0))
        elif motion == "1":
            total += chord
        here = there
    drawing = read(REAL / "cds.ngc")
    assert drawing.cut_length == pytest.approx(25.4 * total, rel=1e-4)
    low, high = drawing.bounds
    assert low == pytest.approx([0, -0.25 * 25.4])
    assert high == pytest.approx([4 * 25.4, 4 * 25.4])
    along = pytest.approx(16 * 25.4 / 60)
    assert drawing.feeds[:-1] == [along] * 7
    assert 0.99 * 16 * 25.4 / 60 < drawing.feeds[-1] < 16 * 25.4 / 60  # its ramp crosses the plane more slowly
    assert len(drawing.pieces) == 8


@real
def test_the_circles_of_a_loop_are_as_long_as_counted_by_hand():
    drawing = read(REAL / "metric_circles.ngc")
    assert [p[0].tolist() for p in drawing.pieces] == [[50, 75], [25, 75], [0, 75]]
    assert drawing.cut_length == pytest.approx(2 * np.pi * (25 + 50 + 75), rel=1e-4)
    assert drawing.closed == [True] * 3
