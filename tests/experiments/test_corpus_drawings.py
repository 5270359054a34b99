"""Drawings of a corpus are judged by another reading, which finds what is wrong."""

import re
from dataclasses import replace

import ezdxf
import pytest

from kerfgym.experiments.studies.corpus import drawings

svgelements = pytest.importorskip("svgelements", reason="the other reader of SVG is not here")

PICTURE = """<svg xmlns="http://www.w3.org/2000/svg" width="200mm" height="100mm" viewBox="0 0 200 100">
<g transform="rotate(20)"><path d="M10 10C10 40 60 40 60 10z"/><circle cx="100" cy="0" r="10"/></g></svg>"""


@pytest.fixture(params=["dxf", "svg"])
def file(request, tmp_path):
    path = tmp_path / f"part.{request.param}"
    if request.param == "svg":
        path.write_text(PICTURE)
        return path
    document = ezdxf.new()
    document.header["$INSUNITS"] = 4
    block = document.blocks.new("b")
    block.add_circle((0, 0), 10)
    block.add_lwpolyline([(20, 0, 1), (40, 0, 0)], format="xyb", close=True)
    document.modelspace().add_blockref("b", (5, 5), dxfattribs={"xscale": 2, "yscale": 1, "rotation": 30})
    document.saveas(path)
    return path


def test_a_drawing_that_is_read_right_is_accepted(file):
    verdict = drawings.check(file)
    assert (verdict.outcome, verdict.reason) == ("accepted", "")
    assert verdict.reference in ("ezdxf", "svgelements")
    assert verdict.deviation_mm < 0.01


def scaled(drawing, factor):
    return replace(drawing, pieces=[factor * piece for piece in drawing.pieces])


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (lambda d: scaled(d, 1.01), "mm to cut; the other reading has"),
        (lambda d: replace(d, pieces=d.pieces[1:]), "mm to cut; the other reading has"),
        (lambda d: replace(d, pieces=[piece + 5.0 for piece in d.pieces]), "box .* that of the other reading"),
    ],
)
def test_a_drawing_that_is_read_wrong_has_failed(file, monkeypatch, wrong, reason):
    read = drawings.read
    monkeypatch.setattr(drawings, "read", lambda path: wrong(read(path)))
    verdict = drawings.check(file)
    assert verdict.outcome == "failed"
    assert re.search(reason, verdict.reason)


def test_refusals_and_empty_drawings_are_told_apart(tmp_path):
    (tmp_path / "empty.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"><text>a</text></svg>')
    verdict = drawings.check(tmp_path / "empty.svg")
    assert (verdict.outcome, verdict.counted) == ("nothing to cut", False)
    (tmp_path / "broken.svg").write_text("<svg")
    verdict = drawings.check(tmp_path / "broken.svg")
    assert (verdict.outcome, verdict.counted) == ("refused", True)
    assert verdict.reason.startswith("line 1: cannot be read as SVG")
