"""G-code: what a programme cuts, with lengths counted by hand."""

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths.choice import Reading
from kerfgym.envs.paths.curve import CHORD
from kerfgym.envs.paths.gcode import read_gcode


@pytest.fixture
def programme(tmp_path):
    """Writes a programme of these lines and reads it."""

    def read(*lines, **choices):
        (tmp_path / "part.ngc").write_text("\n".join(lines), encoding="utf-8")
        return read_gcode(tmp_path / "part.ngc", Reading(**choices))

    return read


def length(points):
    return np.hypot(*np.diff(points, axis=0).T).sum()


def ends(drawing):
    return [p[[0, -1]].round(6).tolist() for p in drawing.pieces]


SQUARE = ["G21 G90", "G0 X10 Y10", "M3 S100", "G1 X40 F3000", "Y40", "X10", "Y10", "M5", "M2"]


# Motion


def test_a_square_is_cut_as_programmed(programme):
    drawing = programme(*SQUARE)
    (piece,) = drawing.pieces
    assert piece.tolist() == [[10, 10], [40, 10], [40, 40], [10, 40], [10, 10]]
    assert (drawing.closed, drawing.units, drawing.layers) == ([True], "mm", [])
    assert drawing.feeds == [50.0]  # 3000 mm/min
    assert drawing.corners[0].tolist() == [0, 1, 2, 3]
    assert drawing.name == "part"


@pytest.mark.parametrize(
    "line",
    ["N30G1X40F3000", "n30 g01 x 40. f3000", "g1x+40f3000", "G1 (to the (right) X40 F3000 ; there"],
)
def test_words_are_read_however_they_are_written(programme, line):
    plain = programme(*SQUARE)
    drawing = programme(*(line if word.startswith("G1") else word for word in SQUARE))
    assert drawing.pieces[0].tolist() == plain.pieces[0].tolist()
    assert drawing.feeds == plain.feeds


def test_percent_signs_bound_the_programme_and_m30_ends_it(programme):
    bounded = programme("%", *SQUARE[:-1], "%", "this is no code")
    ended = programme(*SQUARE[:-1], "M30", "nor is this")
    assert bounded.cut_length == ended.cut_length == 120


def test_several_words_of_a_line_are_done_in_the_standard_order(programme):
    drawing = programme("X9 Y9 G0 G20", "M3 F60 G1 X10 G91", "M5 X5", "M30")
    assert ends(drawing) == [[[228.6, 228.6], [482.6, 228.6]]]  # M5 goes before the motion of its line
    assert drawing.feeds == [25.4]


def test_incremental_moves_start_where_the_last_one_ended(programme):
    drawing = programme("G21 G91 G0 X5 Y5", "M3 G1 X10 F600", "Y10", "G90 X0 Y0")
    assert drawing.pieces[0].tolist() == [[5, 5], [15, 5], [15, 15], [0, 0]]


def test_inches_are_converted_also_in_the_middle(programme):
    drawing = programme("G20 G0 X1 Y1", "M3 G1 X2 F10", "G21", "X100 F600")
    assert drawing.pieces[0].tolist() == [[25.4, 25.4], [50.8, 25.4], [100, 25.4]]
    assert drawing.units == "inches and mm"
    assert drawing.leg_feeds[0] == pytest.approx([10 * 25.4 / 60, 10])
    assert drawing.feeds[0] == pytest.approx((25.4 + 49.2) / (6 + 4.92))  # way over time


def test_f_counts_in_the_units_before_its_line_except_in_the_line_that_says_the_first(programme):
    changed = programme("G20 G0 X1 Y1", "M3 G1 X2 F10", "G21 X100 F60")
    assert changed.leg_feeds[0] == pytest.approx([10 * 25.4 / 60, 25.4])
    assert "F60 counts in inches, the units before its line, as in LinuxCNC (line 3)" in changed.warnings
    first = programme("G0 X1", "G20 F60", "M3 G1 X2 Y2")
    assert first.feeds == [pytest.approx(1.0)]  # X1 was read as mm
    assert programme("G20 F60", "M3 G1 X2 Y2").feeds == [pytest.approx(25.4)]


# Arcs


@pytest.mark.parametrize(
    ("arc", "degrees", "far"),
    [
        ("G3 X0 Y10 I-10 J0", 90, (7.0711, 7.0711)),
        ("G2 X0 Y10 I-10 J0", 270, (-7.0711, -7.0711)),
        ("G3 X0 Y10 R10", 90, (7.0711, 7.0711)),
        ("G3 X0 Y10 R-10", 270, (17.0711, 17.0711)),
        ("G2 X0 Y10 R10", 90, (2.9289, 2.9289)),
        ("G2 X0 Y10 R-10", 270, (-7.0711, -7.0711)),
        ("G3 X-10 Y0 R10", 180, (0, 10)),
        ("G2 X-10 Y0 R10", 180, (0, -10)),
        ("G3 I-10", 360, (-10, 0)),
        ("G2 X10 Y0 I-10", 360, (-10, 0)),
        ("G90.1 G3 X0 Y10 I0 J0", 90, (7.0711, 7.0711)),
        ("G91 G3 X-10 Y10 I-10", 90, (7.0711, 7.0711)),
        ("G91 G91.1 G3 X-10 Y10 I-10", 90, (7.0711, 7.0711)),
        ("G3 X0 Y10 Z5 I-10 P1", 90, (7.0711, 7.0711)),
    ],
)
def test_an_arc_of_ten_millimetres_has_its_angle_and_runs_on_its_side(programme, arc, degrees, far):
    drawing = programme("G21 G90 G0 X10 Y0", "M3 F600", arc)
    (piece,) = drawing.pieces
    assert length(piece) == pytest.approx(10 * np.radians(degrees), rel=2e-4)
    assert np.hypot(*(piece - far).T).min() == pytest.approx(0.0, abs=0.25)
    assert drawing.closed == [degrees == 360]
    assert drawing.corners[0].tolist() == []


def test_an_arc_keeps_the_chord_error(programme):
    (piece,) = programme("G21 G0 X100 Y0", "M3 F600", "G3 I-100").pieces
    assert np.hypot(*piece.T) == pytest.approx(100.0)
    assert np.hypot(*(0.5 * (piece[1:] + piece[:-1])).T).min() >= 100 - 1.001 * CHORD


def test_rounded_numbers_of_an_arc_are_taken(programme):
    rounded = programme("G21 G0 X10 Y0", "M3 F600", "G3 X7.07 Y7.08 I-10 J0").pieces[0]
    assert rounded[-1].tolist() == [7.07, 7.08]
    assert length(rounded) == pytest.approx(10 * np.pi / 4, abs=0.01)
    half = programme("G21 G0 X10 Y0", "M3 F600", "G3 X-10.01 Y0 R10").pieces[0]
    assert half[:, 1].max() == pytest.approx(10.005, abs=CHORD)


@pytest.mark.parametrize(
    ("radius", "apart", "fits"),
    [
        (5, 0.02, True),
        (5, 0.04, False),
        (100, 0.09, True),
        (100, 0.11, False),
        (2000, 1.9, True),
        (2000, 2.1, False),
        (10000, 2.8, True),
        (10000, 2.9, False),
    ],
)
def test_the_radii_of_an_arc_may_differ_by_what_rounding_does(programme, radius, apart, fits):
    lines = [f"G21 G0 X{radius} Y0", "M3 F600", f"G3 X0 Y{radius + apart} I-{radius}"]
    if fits:
        assert programme(*lines).cut_length == pytest.approx(radius * np.pi / 2, rel=3e-3)
    else:
        with pytest.raises(InvalidInput, match=r"line 3: .* from its centre; they may differ by"):
            programme(*lines)


def test_tangents_of_arcs_tell_corners(programme):
    slot = ["G21 G0 X0 Y0", "M3 F600", "G1 X30", "G3 Y10 J5", "G1 X0", "G3 Y0 J-5"]
    assert programme(*slot).corners[0].tolist() == []
    bone = ["G21 G0 X0 Y0", "M3 F600", "G1 X30", "G2 Y10 J5", "G1 X0", "G2 Y0 J-5"]
    (piece,), (corners,) = (d := programme(*bone)).pieces, d.corners
    assert piece[corners] == pytest.approx(np.array([[0, 0], [30, 0], [30, 10], [0, 10]]))


# The beam


def test_only_g1_to_g3_cut_and_only_while_the_beam_is_on(programme):
    drawing = programme(
        "G21 G0 X0 Y0 F600",
        "G1 X10",
        "M4",
        "G1 X20",
        "G0 X30",
        "G1 X40",
        "M5",
        "G1 X50",
        "M3 S0",
        "G1 X60",
        "S9",
        "G1 X70",
    )
    assert ends(drawing) == [[[10, 0], [20, 0]], [[30, 0], [40, 0]], [[60, 0], [70, 0]]]
    assert "G0 while M3 or M4 is on: read as a move without cutting (line 5)" in drawing.warnings


def test_pieces_keep_the_order_and_the_direction_of_the_programme(programme):
    outer_first = ["G21 F600", "G0 X0 Y0", "M3", "G1 X50", "Y50", "X0", "Y0", "M5"]
    inner = ["G0 X30 Y20", "M3", "G1 X20", "M5", "G0 X20 Y20", "M3", "G1 Y30"]
    assert ends(programme(*outer_first, *inner)) == [[[0, 0], [0, 0]], [[30, 20], [20, 20]], [[20, 20], [20, 30]]]


def test_heights_do_not_interrupt_a_cut(programme):
    drawing = programme("G21 G0 X0 Y0 Z5", "M3 F600", "G1 Z-1", "G1 X10", "G1 Z-2", "G0 Z-3", "G1 Y10 Z-4")
    assert drawing.pieces[0].tolist() == [[0, 0], [10, 0], [10, 10]]
    assert "Z (heights: the head follows the sheet) is left out (line 1, 3, 5 and 2 more)" in drawing.warnings
    assert drawing.skipped == {}


def test_moves_of_no_length_are_counted_and_repeated_cuts_named(programme):
    drawing = programme(
        "G21 F600", "G0 X0 Y0", "M3", "G1 X0", "G1 X9", "M5", "G0 X0", "M3", "G1 X9", "M5", "M3", "G1 X0"
    )
    assert drawing.skipped == {"G1 of zero length": 1}
    assert len(drawing.pieces) == 3
    assert "the cut from line 5 is made again (line 9, 12)" in drawing.warnings


# Feeds, parameters


def test_feeds_are_kept_with_each_piece(programme):
    drawing = programme(
        "G21 G0 X0 Y0", "M3", "G1 X3", "M5", "G0 X5", "M3 F1200", "G1 X9", "F2400 X99", "M5", "G0 Y5", "M3 F60 G1 X0"
    )
    assert drawing.feeds == [pytest.approx(np.nan, nan_ok=True), pytest.approx(94 / (4 / 20 + 90 / 40)), 1.0]
    assert drawing.leg_feeds[1].tolist() == [20.0, 40.0]
    assert "no F before it; the feed is left open (line 3)" in drawing.warnings


def test_a_feed_that_only_the_machine_knows_is_left_open(programme):
    drawing = programme("G21 F#<_hal[plasmac.cut-feed-rate]>", "G0 X0 Y0", "M3 $0 S1", "G1 X9", "M5 $0")
    assert drawing.feeds is None
    assert drawing.warnings[0] == (
        "F#<_hal[plasmac.cut-feed-rate]> is known to the machine only; the feed is left open (line 1)"
    )


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("[2 + 3 * 4]", 14),
        ("[[2 + 3] * 4]", 20),
        ("[2 ** 3 ** 2]", 64),
        ("[7 MOD 4 - 1 / 4]", 2.75),
        ("-[1 - 5]", 4),
        ("+-#4", -8),
        ("[#<side> / 2 + #[1 + 3]]", 23),
        ("##5", 8),
        ("SQRT[9] ", 3),
        ("[10 * SIN[30] + COS[60]]", 5.5),
        ("ATAN[1]/[1]", 45),
        ("ABS[-FIX[2.7]]", 2),
    ],
)
def test_parameters_and_expressions_are_computed(programme, expression, value):
    drawing = programme(
        "#<side> = 30 #4 = 8", "#5 = 4", "#9=[#<SIDE>+#4+#5]", "G21 F600", "G0 X0 Y100", "M3", f"G1 X{expression}"
    )
    assert drawing.pieces[0][-1] == pytest.approx([value, 100])


def test_parameters_change_after_their_line(programme):
    drawing = programme("#1 = 10", "G21 F600 G0 X0 Y0", "M3", "#1 = 20 G1 X#1", "Y#1")
    assert drawing.pieces[0].tolist() == [[0, 0], [10, 0], [10, 20]]


def test_parameters_that_the_programme_does_not_read_are_named(programme):
    assert "line 1: #<holes> is set and not read by this programme" in programme("#<holes> = 4", *SQUARE).warnings


# Warnings


@pytest.mark.parametrize(
    "line",
    [
        "G40",
        "G49",
        "G43 H1",
        "G64 P0.005",
        "G94",
        "T3 M6",
        "M7",
        "M8",
        "M9",
        "G4 P0.5",
        "M52 P1",
        "G61",
        "M0",
        "M48",
        "G97",
        "G98",
    ],
)
def test_harmless_words_are_listed_with_their_line(programme, line):
    drawing = programme("(part)", line, *SQUARE)
    name = "M6" if "M6" in line else line.split()[0]
    (warning,) = [w for w in drawing.warnings if w.startswith(f"{name} (")]
    assert warning.endswith("is left out (line 2)")
    assert drawing.cut_length == 120


def test_a_plain_programme_has_one_warning(programme):
    assert programme(*SQUARE).warnings == ["S (spindle speed or power) is left out; S0 is off (line 3)"]


def test_missing_units_and_starts_are_named(programme):
    bare = ["M3 F600", "G1 X30", "Y30"]
    assert programme(*bare).warnings == [
        "neither G20 nor G21 before it, numbers read as mm; units= reads them otherwise (line 2)",
        "the first cut begins at X0 Y0 mm without having been sent there (line 2)",
    ]
    inches = programme(*bare, units="in")
    assert inches.cut_length == pytest.approx(60 * 25.4)
    assert not any("G20" in w for w in inches.warnings)
    assert programme(*SQUARE, units="in").cut_length == 120  # G21 prevails


# Errors


@pytest.mark.parametrize(
    ("line", "word", "problem"),
    [
        ("o100 repeat [3]", "o100 repeat [3]", "o<100> repeat has no endrepeat"),
        ("O<cut> call", "O<cut> call", "neither this file nor its folder has it (looked for cut.ngc there)"),
        ("O<../cut> call", "O<../cut> call", "this file has no subroutine '../cut'"),
        ("O100 endif", "O100 endif", "it does not belong here: nothing is open"),
        ("O100 leap", "O100 leap", "what stands after the O word is not read: 'leap'"),
        ("O100 break", "O100 break", "it stands in no loop of this name"),
        ("O100 return", "O100 return", "it stands in no subroutine"),
        ("G41 D1", "G41", "it is not read: cutter compensation is not computed"),
        ("G42.1 D1", "G42.1", "it is not read: cutter compensation is not computed"),
        ("G33 Z3 K1", "G33", "it is not read: a lathe's cycle or thread"),
        ("G38.2 X3", "G38.2", "it is not read: a probe's answer"),
        ("G17.1", "G17.1", "it is not read: this machine has no U, V and W"),
        ("G0.5", "G0.5", "it is not read"),
        ("M110", "M110", "it is not read"),
        ("M98 P100", "M98", "this file has no line O100"),
        ("M62", "M62", "it needs P"),
        ("M67 E0", "M67", "it needs E and Q"),
        ("G1 X5 A90", "A90", "it moves A; this machine moves in X and Y"),
        ("G91 G1 C1", "C1", "it moves C; this machine moves in X and Y"),
        ("G1 X5 I3", "I3", "it is not read, or not"),
        ("G1 X5 K3", "K3", "it is not read, or not"),
        ("G1 X5 E0.3", "E0.3", "it is not read, or not"),
        ("X1e3", "E3", "it is not read, or not"),
        ("G4 X2", "X2", "it stands with a dwell, G4"),
        ("G1 X5 X6", "X6", "it stands twice in this line"),
        ("G0 G1 X5", "G1", "G0 stands in the same line"),
        ("G20 G21", "G21", "G20 stands in the same line"),
        ("G80\nX5", "X5", "no G0, G1, G2 or G3 says how to move there"),
        ("M3 M5", "M5", "M3 stands in the same line"),
        ("F0 X50", "F0", "a feed must be more than 0"),
        ("G93 G1 X50", "G1", "after G93 each feed move needs an F"),
        ("G95 G1 X50 F1", "G1", "after G95 a feed move needs S"),
        ("G53 G2 X50 R50", "G53", "it needs G0 or G1"),
        ("G91 G53 G1 X50", "G53", "it does not go with G91"),
        ("G92", "G92", "it needs an axis"),
        ("G10 P1 X3", "G10", "read are L2 and L20"),
        ("G10 L2 P10 X3", "P10", "P must be a coordinate system"),
        ("G5 X20 Y10", "G5", "it needs P and Q"),
        ("G5.3", "G5.3", "0 control points of G5.2 are before it; it needs 3"),
        ("G1 @5 X3", "X3", "it stands with @ or ^"),
        ("F-100", "F-100", "a feed must be more than 0"),
        ("G1 Xnan", "Xnan", "a number is expected"),
        ("G1 X", "X", "a number is expected"),
        ("G1 X1..2", ".", "not a word"),
        ("G1 X5 ?", "?", "not a word"),
        ("G1 X5 (there", "G1 X5 (there", "a comment has only one of its brackets"),
        ("G1 X5 there)", "G1 X5 there)", "a comment has only one of its brackets"),
        ("G1 X#6000", "#6000", "parameters have numbers from 1 to 5601"),
        ("#5420 = 3", "#5420", "it is the machine's, and cannot be set"),
        ("G1 X#<with>", "#<with>", "a parameter that has no value yet"),
        ("G1 X#<_hal[x]>", "X#<_hal[x]>", "its value is known to the machine only"),
        ("o1 if [#<_ini[a]b>]\no1 endif", "o1 if [#<_ini[a]b>]", "its value is known to the machine only"),
        ("G1 X[#<_hal[x]> + 1]", "X[#<_hal[x]> + 1]", "its value is known to the machine only"),
        ("G1 X[1/0]", "/", "cannot be computed of 1 and 0"),
        ("G1 XSQRT[-1]", "SQRT", "cannot be computed of -1"),
        ("G1 X[1 + 2", "G1 X[1 + 2", "an operator (+ - * / ** MOD EQ"),
        ("G1 X[1 IS 2]", "I", "an operator"),
        ("#1", "#1", "a parameter stands alone; '=' is missing"),
        ("#1.5 = 3", "#1.5", "parameters have whole numbers"),
        ("G2 X20 Y10", "X20", "G2 needs I, J or R"),
        ("G3", "G3", "an arc without X, Y, I, J or R"),
        ("G2 X20 Y10 I5 R5", "R5", "an arc has either R or I and J"),
        ("G2 X20 Y10 R4", "R4", "the ends of the arc are 10.0000 mm apart, more than twice its radius"),
        ("G2 R4", "R4", "an arc by its radius must end elsewhere than it begins"),
        ("G2 I0 J0", "I0", "an arc without radius"),
        ("G2 X20 Y10 I3 J0", "X20 Y10 I3 J0", "the ends of the arc are 3.0000 and 7.0000 mm from its centre; they may"),
        ("G2 I5 P0", "P0", "the number of turns must be a whole number from 1 on"),
        ("G2 I5 P1.5", "P1.5", "the number of turns must be a whole number from 1 on"),
        ("G2 X20 I5 K1", "K1", "an arc in the plane of G17 has no K"),
        ("G18 G2 X20 J5", "J5", "an arc in the plane of G18 has no J"),
        ("G90.1 G2 X20 I15", "X20", "after G90.1 an arc needs both I and J"),
    ],
)
def test_what_cannot_be_read_is_named_with_line_and_word(programme, line, word, problem):
    with pytest.raises(InvalidInput) as error:
        programme("G21 G54 F600", "G0 X10 Y10", "M3", line, "G1 X99")
    number = 5 if line.startswith("G80\n") else 4
    assert f"part.ngc, line {number}: '{word}': {problem}" in str(error.value)


def test_the_line_is_the_one_an_editor_shows(programme):
    with pytest.raises(InvalidInput, match="line 4: 'G41'"):
        programme("%\r", "(form\x0cfeed)", "", "G41")


def test_brackets_without_end_are_refused(programme):
    with pytest.raises(InvalidInput, match="line 1: brackets are nested too deep"):
        programme(f"#1 = {'[' * 100}1{']' * 100}")


@pytest.mark.parametrize("lines", [["G21 G0 X0 Y0", "X50 F600", "M2"], ["(empty)"], ["G21 M3 S0", "G1 X50 F600"]])
def test_a_programme_that_cuts_nothing_says_what_would_be_cut(programme, lines):
    with pytest.raises(
        InvalidInput, match=r"nothing to cut in it; what is cut: G1, G2, G3 and splines while the beam is on"
    ):
        programme(*lines)


def test_layers_cannot_be_chosen_in_a_programme(programme):
    with pytest.raises(InvalidInput, match=r"layers = \('CUT',\): a programme has none"):
        programme(*SQUARE, layers=("CUT",))


def test_a_journey_beyond_all_sheets_is_refused(programme):
    with pytest.raises(InvalidInput, match=r"a journey of 1e\+08 mm .* was read in mm"):
        programme("G21 F600 G0 X0 Y0", "M3", "G1 X100000000")


def test_a_cut_of_less_than_a_millimetre_is_read(programme):
    assert programme("G21 G0 X1 Y1", "M3", "G1 X1.4 F600", "M5", "M2").cut_length == pytest.approx(0.4)


@pytest.mark.parametrize("number", ["1" + "0" * 300, "1" + "0" * 999, "-1" + "0" * 12])
@pytest.mark.parametrize(
    "words", ["G1 X{}", "G0 X{}", "G92 X{}\nG1 X5", "G10 L2 P1 X{}\nG1 X5", "G2 X5 Y5 R{}", "G2 X5 Y5 I{} J0"]
)
def test_a_place_beyond_numbers_is_told_with_line_and_limit_and_without_a_word_from_a_library(
    programme, words, number, recwarn
):
    with pytest.raises(InvalidInput, match=r"part.ngc, line [34]: .*") as error:
        programme("G21 G90 F600", "M3 S1", words.format(number))
    assert not recwarn.list
    assert len(str(error.value)) < 400
    assert any(word in str(error.value) for word in ("allowed", "points", "may differ", "shorter than"))
