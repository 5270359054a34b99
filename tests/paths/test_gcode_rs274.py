"""G-code against LinuxCNC's own interpreter, ``rs274``.

``rs274/*.ngc`` are programmes of our own, ``*.rs274`` what the one of Debian's linuxcnc-uspace
2.9.0~pre1+git20230208.f1270d6ed7-1+deb12u2 prints of them (``rs274 -g``, with a table of tools without length), so that
the comparison bites where it is not installed. Where it is, they are run anew, and so are programmes made at random.
"""

import random
from pathlib import Path

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths.gcode import read_gcode
from kerfgym.experiments.studies.corpus import canonical, rs274
from kerfgym.experiments.studies.corpus.compare import apart

OURS = sorted((Path(__file__).parent / "rs274").glob("*.ngc"))
MICROMETRE = 1e-3

installed = pytest.mark.skipif(rs274.command() is None, reason="rs274 is not installed")


def pieces(path):
    return [piece[:, 0] + 1j * piece[:, 1] for piece in read_gcode(path).pieces]


def same(path, printed):
    theirs = canonical.cut(printed)
    assert theirs.pieces
    distance = apart(pieces(path), theirs.pieces)
    assert distance <= MICROMETRE + theirs.rounding, f"{1e3 * distance:.2f} µm apart"


@pytest.mark.parametrize("path", OURS, ids=lambda path: path.stem)
def test_the_path_is_that_which_rs274_printed(path):
    same(path, path.with_suffix(".rs274").read_text(encoding="latin-1"))


def test_the_comparison_sees_a_micrometre_and_an_exchanged_piece():
    path = OURS[-1]
    theirs = canonical.cut(path.with_suffix(".rs274").read_text(encoding="latin-1"))
    ours = pieces(path)
    bent = [p.copy() for p in ours]
    bent[0][len(bent[0]) // 2] += 0.004j
    assert apart(ours, theirs.pieces) < MICROMETRE < 0.003 < apart(bent, theirs.pieces) < 0.005
    flow = next(p for p in OURS if p.stem == "flow")
    ordered = canonical.cut(flow.with_suffix(".rs274").read_text(encoding="latin-1")).pieces
    assert apart(ordered, [ordered[1], ordered[0], *ordered[2:]]) > 1.0
    assert apart(ordered, ordered[1:]) == np.inf
    assert apart([ordered[0][::-1]], ordered[:1]) > MICROMETRE


@pytest.mark.parametrize("path", OURS, ids=lambda path: path.stem)
def test_feeds_are_those_that_rs274_printed(path):
    if path.stem == "inches":
        pytest.skip("rs274 prints F before its units change, and one for each move of inverse time")
    theirs = canonical.cut(path.with_suffix(".rs274").read_text(encoding="latin-1")).feeds
    drawing = read_gcode(path)
    ours = {}
    for piece, feeds in zip(drawing.pieces, drawing.leg_feeds, strict=True):
        for step, feed in zip(np.hypot(*np.diff(piece, axis=0).T), feeds, strict=True):
            ours[round(60 * feed, 6)] = ours.get(round(60 * feed, 6), 0.0) + step
    if path.stem == "planes":  # F counts in space, so that the plane is crossed more slowly
        assert max(ours) == max(theirs)
        assert min(ours) < min(theirs)
    else:
        assert ours == pytest.approx(theirs, rel=1e-4)


@installed
@pytest.mark.parametrize("path", OURS, ids=lambda path: path.stem)
def test_the_path_is_that_of_rs274_here(path):
    same(path, rs274.run(path).text)


@installed
@pytest.mark.parametrize("seed", range(12))
def test_random_programmes_have_the_path_of_rs274(tmp_path, seed):
    path = tmp_path / "random.ngc"
    path.write_text(programme(seed))
    output = rs274.run(path)
    if output is None or output.refused:
        pytest.skip(f"rs274 does not take it: {output and output.refused}")
    same(path, output.text)


@installed
@pytest.mark.parametrize(
    "wrong",
    [
        "G2 X5 R1",
        "G1 X5 X6",
        "G41 D-1 X3",
        "G53 G2 X1 R5",
        "M3 M5",
        "G0 G1 X1",
        "#5420 = 1",
        "G1 X[1/0]",
        "G2 X5 I1 K1",
        "o1 return",
        "G4 X2",
        "G1 X[2",
        "G3 X9 I2 P0",
        "G91 G53 G0 X1",
        "G10 L2 P10 X0",
        "G1 X#<nothing>",
        "F-1",
    ],
)
def test_what_rs274_refuses_is_refused(tmp_path, wrong):
    path = tmp_path / "wrong.ngc"
    path.write_text(f"G21 F100\nG1 X20\n{wrong}\nG1 X30\nM2\n")
    assert rs274.run(path).refused
    with pytest.raises(InvalidInput, match="line 3"):
        read_gcode(path)


def programme(seed):
    """A programme of straight lines, arcs, offsets, loops and a subroutine."""
    r = random.Random(seed)
    size = r.choice([1.0, 4.0])

    def n():
        return f"{r.uniform(-size, size):.3f}"

    def motion():
        return r.choice(
            [
                f"G1 X{n()} Y{n()}",
                f"G0 X{n()}",
                f"G1 Y{n()} Z{n()}",
                f"G17 G3 I{n()} J{n()} P{r.randint(1, 3)}",
                f"G18 G2 I{n()} K{n()} Y{n()}",
                f"G19 G3 J{n()} K{n()}",
                f"G17 G91 G2 X{n()} Y{n()} R{4 * size}\nG90",
                f"G53 G1 X{n()} Y{n()}",
                f"G28 X{n()}",
                "G30.1",
                f"G30 Y{n()}",
                f"G17 G81 X{n()} Y{n()} R1 Z-1\nG80",
            ]
        )

    def offset():
        return r.choice(
            [
                f"G10 L2 P{r.randint(0, 9)} X{n()} Y{n()}",
                f"G92.1\nG10 L2 P{r.randint(0, 2)} R{r.randint(-180, 180)}",
                f"G10 L20 P{r.randint(0, 3)} Y{n()}",
                f"G92 X{n()}",
                "G92.2",
                f"G52 X{n()} Y{n()}",
                r.choice(["G54", "G55", "G59.1"]),
                f"G43.1 X{n()}",
                "G49",
                "G20",
                "G21",
            ]
        )

    lines = [
        r.choice(["G20", "G21"]),
        f"G90 G17 F{r.randint(100, 900)} S1 M3",
        "o1 sub",
        motion(),
        "G1 X#1",
        "o1 endsub",
    ]
    for i in range(r.randint(5, 15)):
        body = [r.choice([motion, motion, offset])(), f"o1 call [{n()}]", motion()]
        lines += [f"o{i + 10} repeat [{r.randint(1, 3)}]", *body, f"o{i + 10} endrepeat"] if i % 3 == 0 else body
    return "\n".join([*lines, "G92.1", "G90 G1 X1 Y1", "M2", ""])
