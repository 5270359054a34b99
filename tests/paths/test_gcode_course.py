"""The course of G-code programmes: subroutines, loops, offsets, the beam, and programmes without end."""

import time

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths import gcode_motion
from kerfgym.envs.paths.choice import Reading
from kerfgym.envs.paths.gcode import read_gcode


@pytest.fixture
def programme(tmp_path):
    """Writes a programme of these lines and reads it."""

    def read(*lines, **choices):
        (tmp_path / "part.ngc").write_text("\n".join(lines), encoding="utf-8")
        return read_gcode(tmp_path / "part.ngc", Reading(**choices))

    return read


def ends(drawing):
    return [p[[0, -1]].round(6).tolist() for p in drawing.pieces]


# Subroutines and loops


def test_a_loop_cuts_as_often_as_it_runs(programme):
    drawing = programme(
        "G21 F600",
        "#1 = 0",
        "o1 while [#1 LT 5]",
        "G0 X[#1 * 10] Y0",
        "M3",
        "G1 Y4",
        "M5",
        "#1 = [#1 + 1]",
        "o1 endwhile",
    )
    assert ends(drawing) == [[[10 * i, 0], [10 * i, 4]] for i in range(5)]


def test_a_subroutine_has_its_own_parameters_and_gives_a_value_back(programme):
    drawing = programme(
        "G21 F600 M3",
        "#1 = 7 #<a> = 3 #31 = 1",
        "o<side> sub",
        "#31 = [#31 + #1]",
        "#1 = 99 #<a> = 99",
        "o<side> endsub [#2 * 2]",
        "o<side> call [5] [10]",
        "G1 X#<_value> Y#1",
        "X#31 Y#<a>",
    )
    assert drawing.pieces[0].tolist() == [[0, 0], [20, 7], [6, 3]]


def test_a_subroutine_may_stand_behind_its_call_and_in_a_file_beside(programme, tmp_path):
    (tmp_path / "side.ngc").write_text("o<side> sub\nG1 X#1\no<side> endsub\n")
    drawing = programme("G21 F600 M3", "o2 call [4]", "O<SIDE> call [9]", "M2", "o2 sub", "G1 Y#1", "o2 endsub")
    assert drawing.pieces[0].tolist() == [[0, 0], [0, 4], [9, 4]]


def test_files_beside_are_plain_files_of_the_same_folder(programme, tmp_path):
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "side.ngc").write_text("o<side> sub\no<side> endsub\n")
    (tmp_path / "link.ngc").symlink_to(tmp_path / "below" / "side.ngc")
    for name in ("side", "link", "below/side", "../part", "/etc/passwd", "nul\0"):
        with pytest.raises(InvalidInput, match=r"part\.ngc, line 1"):
            programme(f"o<{name}> call")


def test_conditions_take_the_first_branch_that_holds(programme):
    lines = ["o1 if [#2 GT 1]", "G1 X1", "o1 elseif [#2 EQ 1]", "G1 X2", "o1 else", "G1 X3", "o1 endif"]
    for value, x in ((2, 1), (1, 2), (0, 3)):
        assert programme("G21 F600 M3", f"#2 = {value}", *lines).pieces[0][-1].tolist() == [x, 0]


def test_a_break_leaves_its_own_loop_only(programme):
    drawing = programme(
        "G21 G91 F600 M3",
        "o1 repeat [3]",
        "o2 do",
        "G1 X1",
        "o3 if [1]",
        "o2 break",
        "o3 endif",
        "o2 while [1]",
        "G1 Y1",
        "o1 endrepeat",
    )
    assert drawing.pieces[0][-1].tolist() == [3, 3]


def test_after_a_break_a_later_loop_runs_to_its_end(programme):
    # rs274 2.9 leaves such a loop after its first round
    drawing = programme(
        "G21 G91 F600 M3",
        "o1 while [1]",
        "o1 break",
        "o1 endwhile",
        "#1 = 3",
        "o2 do",
        "#1 = [#1 - 1]",
        "G1 X1",
        "o2 while [#1 GT 0]",
    )
    assert drawing.cut_length == pytest.approx(3)


def test_m98_runs_a_subprogramme_so_often_with_the_parameters_of_its_caller(programme):
    drawing = programme(
        "O1 (main)",
        "G21 G91 F600 M3",
        "#1 = 2",
        "M98 P0005 L3",
        "G1 Y#1",
        "M30",
        "O0005",
        "G1 X#1",
        "#1 = [#1 + 1]",
        "M99",
    )
    assert drawing.pieces[0].tolist() == [[0, 0], [2, 0], [5, 0], [9, 0], [9, 5]]


def test_what_stands_behind_the_end_is_not_read(programme):
    assert programme("G21 F600 M3", "G1 X5", "M2", "o1 while [", "o2 endif", "nonsense").cut_length == 5


@pytest.mark.parametrize(
    "lines",
    [
        ["o1 while [1]", "#1 = [#1 + 1]", "o1 endwhile"],
        ["o1 sub", "o2 if [#1 GT 0]", "o1 call [#1 - 1]", "o1 call [#1 - 1]", "o2 endif", "o1 endsub", "o1 call [28]"],
        ["M98 P1 L99999999", "M2", "O1", "G91 G1 X0.0001 F100", "M99"],
        ["o1 repeat [99999999]", "o1 endrepeat"],
        ["G81 X1 Z-1 R1 L9999"] * 100,
        ["o1 sub", "o1 call", "o1 endsub", "o1 call"],
        ["F100", "G2 I1000 P99999999"],
        ["F100", "o1 repeat [99999]", "G2 I0.01 P1000", "o1 endrepeat"],
        ["G1 F100 X" + "9" * 300],
        ["#1 = " + "-" * 3000 + "1"],
        ["#1 = [9 ** 9 ** 9 ** 9]"],
        ["#1 = [1" + " + 1" * 100_000 + "]"],
    ],
)
def test_a_hostile_programme_gets_an_error_with_its_line_within_seconds(programme, lines):
    began = time.process_time()
    with pytest.raises(InvalidInput, match=r"part\.ngc, line \d+: "):
        programme(*lines)
    assert time.process_time() - began < 5.0


def test_long_sums_and_many_comments_are_read(programme):
    many = "G1 " + "(a)" * 20_000 + " X[" + "1 + " * 900 + "1]"
    assert programme("G21 F600 M3", many).cut_length == pytest.approx(901)


# Coordinates


def test_coordinate_systems_lie_where_g10_says(programme):
    drawing = programme(
        "G21 F600 M3", "G10 L2 P1 X10 Y20 R90", "G1 X5", "G10 L2 P3 X-5", "G56 X0 Y0", "G10 L20 P3 X1 Y1", "X2 Y1"
    )
    assert drawing.pieces[0][-2:] == pytest.approx(np.array([[-5, 0], [-4, 0]]), abs=1e-9)


def test_g92_moves_the_coordinates_and_not_the_machine(programme):
    drawing = programme(
        "G21 F600 M3",
        "G1 X10",
        "G92 X0 Y0",
        "X5",
        "G92.2",
        "X20",
        "G92.3",
        "X20",
        "G92.1",
        "X0",
        "G52 Y3",
        "Y0",
        "G53 G1 Y0",
    )
    assert drawing.pieces[0].tolist() == [[0, 0], [10, 0], [15, 0], [20, 0], [30, 0], [0, 0], [0, 3], [0, 0]]


def test_g28_and_g30_go_home_without_cutting_by_way_of_the_point_they_name(programme):
    drawing = programme("G21 F600", "G0 X7 Y8", "G28.1 M3", "G1 X9", "G28 Y3", "G1 X20", "G30", "G1 X1 Y1")
    assert ends(drawing) == [[[7, 8], [9, 8]], [[9, 8], [20, 8]], [[0, 0], [1, 1]]]


def test_splines_run_through_their_points(programme):
    drawing = programme(
        "G21 F600 M3",
        "G5 X10 Y0 I0 J10 P0 Q10",
        "G5.1 X20 Y0 I5 J10",
        "G5.2 P1 L3",
        "X25 Y5 P1",
        "X30 Y5 P2",
        "X35 Y0 P1",
        "G5.3",
    )
    (piece,) = drawing.pieces
    for point in ((5, 7.5), (10, 0), (15, 5), (20, 0), (35, 0)):
        assert np.hypot(*(piece - point).T).min() < 0.02
    assert drawing.corners[0].size == 3 or drawing.corners[0].size == 2


def test_arcs_of_the_other_planes_are_seen_from_above(programme):
    drawing = programme("G21 G18 F600 M3", "G2 X10 Z0 I5 K0", "G19 G3 Y6 Z0 J3 K0 P2", "G17 G1 X0")
    (piece,) = drawing.pieces
    assert piece[:, 0].max() == 10
    assert drawing.cut_length == pytest.approx(
        10 + 6 + 12 + np.hypot(0, 10), abs=0.01
    )  # 1½ turns go 3 times to and fro


# Feed


def test_f_counts_in_space_by_time_or_by_revolution(programme):
    drawing = programme(
        "G21 M3 S300 F600", "G1 X30 Z40", "G93 G1 X60 F2", "G95 F0.5", "G1 X70", "G94 F1200", "G18 G2 X80 I5 K0"
    )
    assert drawing.leg_feeds[0][:3] == pytest.approx([6.0, 1.0, 2.5])  # 3/5 of 10 mm/s; 30 mm in 1/2 min; 150 mm/min
    assert drawing.leg_feeds[0][-1] == pytest.approx(
        20 * 10 / (5 * np.pi), rel=1e-6
    )  # 10 mm in the time of half a circle


# The beam


@pytest.mark.parametrize(
    ("words", "cut", "rule"),
    [
        (["", "", "", ""], [1, 1, 1, 1], "no word in it switches a beam: every feed move is read as cut"),
        (["S1", "S0", "S5", ""], [1, 0, 1, 1], "on in feed moves, except while S is 0"),
        (["", "M3", "M5", "M4"], [0, 1, 0, 1], ""),
        (["M3 S0", "S9", "S0", "S1"], [0, 1, 0, 1], ""),
        (["M62 P0", "M63 P0", "M64 P0", "M65 P0"], [1, 0, 1, 0], "on while M62 or M64 has P0 on"),
        (["M64 P1", "M67 E0 Q0", "M67 E0 Q3", "M65 P1"], [1, 0, 1, 0], "on while M62 or M64 has P1 on"),
        (["", "M67 E0 Q5", "M68 E0 Q0", "M68 E0 Q1"], [0, 1, 0, 1], "on while Q of M67 or M68 is not 0"),
        (["M3", "M62 P3", "M63 P3", "M64 P2"], [1, 0, 1, 1], ""),
        (["M3 $1", "M5 $1", "M3 $1", "M5 $-1"], [1, 0, 1, 0], ""),
        (["M3 $1", "M5 $1", "M3 $0", "M3 $1"], [0, 0, 1, 1], ""),
    ],
)
def test_the_beam_is_what_the_programme_switches(programme, words, cut, rule):
    drawing = programme("G21 F600", *(line for i, word in enumerate(words) for line in (word, f"G1 X{10 * (i + 1)}")))
    burnt = np.zeros(4, int)
    for piece in drawing.pieces:
        burnt[round(piece[0, 0] / 10) : round(piece[-1, 0] / 10)] = 1
    assert burnt.tolist() == cut
    told = [w for w in drawing.warnings if "beam" in w]
    assert (rule in told[0]) if rule else not told


def test_drilling_is_counted_and_not_cut(programme):
    drawing = programme("G21 F600", "G81 X5 Y5 Z-1 R1", "X9", "G91 X1 L3", "G80 G90", "M3", "G1 X0")
    assert drawing.skipped == {"G81 (drilled hole)": 5}
    assert ends(drawing) == [[[12, 5], [0, 5]]]


def test_lines_that_the_block_delete_switch_would_skip_are_run(programme):
    assert programme("G21 F600 M3", "/G1 X5", "/N3 Y5").pieces[0].tolist() == [[0, 0], [5, 0], [5, 5]]


def test_modes_are_kept_and_restored(programme):
    drawing = programme("G21 F600 M3", "M70", "G91 G20 F1", "G1 X1", "M72", "X30")
    assert drawing.pieces[0].tolist() == [[0, 0], [25.4, 0], [30, 0]]
    assert drawing.leg_feeds[0].tolist() == pytest.approx([1 / 60, 10])  # F counts in the units before its line


def test_a_tools_offset_goes_with_the_modes_that_had_none(programme):
    drawing = programme("G21 F600 M3", "M70", "G43.1 X5", "G1 X10", "M72", "X20 Y1", "X0 Y0")
    assert drawing.pieces[0].tolist() == [[0, 0], [15, 0], [20, 1], [0, 0]]


def test_modes_of_a_subroutine_are_restored_at_its_end_if_it_says_m73(programme):
    sub = ["o1 sub", "{}", "G91 G1 X1", "o1 endsub"]
    for word, x in (("M73", 5), ("(none)", 6)):
        drawing = programme("G21 G90 F600 M3", *(line.format(word) for line in sub), "o1 call", "G1 X5")
        assert drawing.pieces[0][-1].tolist() == [x, 0]


def test_a_programme_of_more_moves_than_can_be_cut_is_refused_while_it_runs(programme, monkeypatch):
    monkeypatch.setattr(gcode_motion, "MOST_MOVES", 3)
    with pytest.raises(InvalidInput, match=r"line 5.*more than 3 feed moves up to here"):
        programme("G21 M3 S1 F600", "G1 X1", "X2", "X3", "X4", "M2")
