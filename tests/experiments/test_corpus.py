"""The corpus script: what becomes of each file, in a process of its own."""

import json

import pytest

from kerfgym.experiments.studies.corpus import __main__ as script
from kerfgym.experiments.studies.corpus import accepted, canonical, each, programmes, rs274
from kerfgym.experiments.studies.corpus.judged import ACCEPTED, FAILED, NOTHING, REFUSED, Verdict

SQUARE = "G21 F600 M3\nG1 X40\nY40\nX0\nY0\nM2\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "within").mkdir()
    (tmp_path / "square.ngc").write_text(SQUARE)
    (tmp_path / "within" / "comp.nc").write_text("G21 F600 M3\nG41 D1\nG1 X40 Y3\nM2\n")
    (tmp_path / "thread.tap").write_text("G21 F600 S100 M3\nG33 Z-10 K1\nM2\n")
    (tmp_path / "empty.gcode").write_text("(nothing)\nM2\n")
    (tmp_path / "notes.txt").write_text("not a programme")
    return tmp_path


def test_each_file_of_a_folder_gets_a_verdict(folder):
    found = {v.path.name: v for v in each.verdicts(each.files(folder))}
    assert {name: v.outcome for name, v in found.items()} == {
        "square.ngc": ACCEPTED,
        "comp.nc": REFUSED,
        "thread.tap": REFUSED,
        "empty.gcode": NOTHING,
    }
    assert found["square.ngc"].length_mm == pytest.approx(160)
    assert found["square.ngc"].box == pytest.approx((40, 40))
    assert found["comp.nc"].reason.startswith("line 2: 'G41'")
    assert (found["comp.nc"].counted, found["thread.tap"].counted) == (True, False)


def test_a_file_that_takes_too_long_or_raises_fails_with_a_word(folder, monkeypatch):
    context = each.multiprocessing.get_context("fork")
    monkeypatch.setattr(each, "REFERENCE_TIME", 0.0)
    monkeypatch.setattr(programmes, "check", lambda path: 1 / 0)
    failed = each.one(folder / "square.ngc", 20.0, context)
    assert failed.outcome == FAILED
    assert failed.reason.startswith("ZeroDivisionError: division by zero (test_corpus.py, line ")
    monkeypatch.setattr(programmes, "check", lambda path: each.multiprocessing.Event().wait())
    assert each.one(folder / "square.ngc", 0.2, context).reason == "not read within 0.2 s"


def test_the_table_counts_what_should_be_accepted():
    def verdict(outcome, **more):
        return Verdict(accepted.Path("a.ngc"), "gcode", outcome, **more)

    found = [
        verdict(ACCEPTED, deviation_mm=0.0005, seconds=2.0),
        verdict(ACCEPTED, deviation_mm=0.002),
        verdict(REFUSED),
        verdict(REFUSED, counted=False),
        verdict(NOTHING),
        verdict(FAILED, counted=False),
    ]
    (row,) = accepted.summary(found).sections[0]
    assert row == ["gcode", "6", "2", "2", "1", "1", "2/3 (66.7%)", "2", "1", "2.00"]


def test_the_script_writes_verdicts_and_refuses_an_empty_folder(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    script.main(folder)
    written = json.loads((tmp_path / "runs" / "corpus" / "verdicts.json").read_text())
    assert len(written) == 4
    assert "line 2: 'G41'" in capsys.readouterr().out
    (tmp_path / "none").mkdir()
    with pytest.raises(script.InvalidInput, match="no DXF, SVG or G-code file in it"):
        script.main(tmp_path / "none")


PRINTED = """    1 N..... USE_LENGTH_UNITS(CANON_UNITS_MM)
    2 N..... START_SPINDLE_CLOCKWISE(0)
    3 N..... SET_XY_ROTATION(90.0000)
    4 N..... SET_G5X_OFFSET(1, 5.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)
    5 N..... STRAIGHT_TRAVERSE(0.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)
    6 N..... STRAIGHT_FEED(10.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)
    7 N..... ARC_FEED(0.0000, 10.0000, 0.0000, 0.0000, 2, 0.0000, 0.0000, 0.0000, 0.0000)
"""


def test_canonical_commands_are_a_path_on_the_machine():
    (piece,) = canonical.cut(PRINTED).pieces
    assert piece[[0, 1, -1]] == pytest.approx([5, 5 + 10j, -5])
    assert abs(piece[1:] - 5) == pytest.approx(10)
    assert abs(piece[1:] - piece[:-1]).sum() == pytest.approx(10 + 2.5 * 3.14159265 * 10, rel=1e-5)
    assert canonical.moves_in_plane(PRINTED)
    assert not canonical.moves_in_plane(PRINTED.replace("10.0000, 0.0000, 0.0000, 0.0000", "10.0, 0.0, 0.0, 30.0"))


def test_without_rs274_the_verdict_says_so(folder, monkeypatch):
    monkeypatch.setattr(rs274, "command", lambda: None)
    verdict = programmes.check(folder / "square.ngc")
    assert (verdict.reference, verdict.deviation_mm) == ("rs274 is not installed", None)
