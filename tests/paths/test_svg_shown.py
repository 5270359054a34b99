"""SVG: style sheets, strokes, letters, and files that are meant to do harm."""

import time

import numpy as np
import pytest

from kerfgym.envs.engine.quantity import InvalidInput
from kerfgym.envs.paths.choice import Reading
from kerfgym.envs.paths.svg import read_svg

HEAD = (
    '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
    'width="200mm" height="100mm" viewBox="0 0 200 100">'
)


@pytest.fixture
def picture(tmp_path):
    """Writes what stands in an svg element, after ``before``, and reads it."""

    def read(*lines, before="", head=HEAD, **choices):
        (tmp_path / "part.svg").write_text("\n".join([before + head, *lines, "</svg>"]), encoding="utf-8")
        return read_svg(tmp_path / "part.svg", Reading(**choices))

    return read


# Strokes and style sheets


STROKES = (
    "<style>.cut, #me { stroke: rgb(255,0,0) } path { stroke: blue } path.fold { stroke: lime; display: none }</style>",
    '<rect class="cut" width="10" height="10"/>',
    '<g stroke="#F00"><rect x="20" width="5" height="5"/><rect x="30" width="5" height="5" stroke="black"/></g>',
    '<path d="M0 50h7"/><path d="M0 60h100" class="fold"/><path d="M0 70h3" style="stroke:none"/>',
    '<circle id="me" cx="100" cy="50" r="1" style="stroke:#00f"/>',
)


@pytest.mark.parametrize(
    ("colours", "length"),
    [
        ("red", 40 + 20),
        ("blue", 7 + 2 * np.pi),
        ("none", 3),
        (("ignore=red", "engrave=#000"), 7 + 3 + 2 * np.pi),
        (None, 40 + 20 + 20 + 7 + 3 + 2 * np.pi),
    ],
)
def test_a_stroke_is_that_of_the_style_the_sheet_the_attribute_or_the_group(picture, colours, length):
    drawing = picture(*STROKES, colours=colours)
    assert drawing.cut_length == pytest.approx(length, rel=1e-3)
    assert drawing.skipped["hidden path"] == 1


def test_what_a_style_sheet_hides_is_left_out_unless_its_layer_is_named(picture):
    lines = ['<g id="A" display="none"><path d="M0 0h10"/></g>', '<g id="B"><path d="M0 5h20"/></g>']
    assert picture(*lines).cut_length == pytest.approx(20)
    assert picture(*lines, layers="a").cut_length == pytest.approx(10)


def test_an_unknown_stroke_is_refused_with_those_there_are(picture):
    with pytest.raises(InvalidInput, match=r"no colour 'yellow'; .*known: #ff0000, #000000, #0000ff, none"):
        picture(*STROKES, colours="yellow")


def test_layers_can_be_engraved(picture):
    drawing = picture('<g id="A"><path d="M0 0h10"/></g><g id="B"><path d="M0 5h20"/></g>', layers=("engrave=b",))
    assert drawing.cut_length == pytest.approx(10)
    assert drawing.notes == ["1 contour, 20.0 mm, to be engraved: this machine only cuts, so kept out of the job"]


# Lengths, prefixes, letters


@pytest.mark.parametrize(
    ("element", "length"),
    [
        ('<line x2="2em" font-size="10"/>', 20),
        (
            '<g style="font-size:5px"><line x2="200%" style="font-size:2em"/><line x2="1ex" y1="9" y2="9"/></g>',
            400 + 2.5,
        ),
        ('<line x2="2rem"/>', 32),
    ],
)
def test_lengths_may_be_in_sizes_of_the_font(picture, element, length):
    assert picture(element).cut_length == pytest.approx(length)


def test_a_prefix_that_the_file_does_not_explain_refuses_nothing(picture):
    drawing = picture('<sodipodi:thing/><svg:rect width="10" height="10" inkscape:label="x"/>')
    assert drawing.cut_length == pytest.approx(40)


def test_letters_are_cut_on_request(picture):
    lines = ['<text x="50" y="60" font-size="20" text-anchor="middle">I<tspan dx="30">I</tspan></text>']
    with pytest.raises(InvalidInput, match=r"skipped: text \(1\); --text cuts letters as outlines"):
        picture(*lines)
    drawing = picture(*lines, text=True)
    low, high = drawing.bounds
    assert drawing.closed == [True, True]
    assert low[1] == pytest.approx(40, abs=0.01)  # on the base line
    assert high[1] - low[1] == pytest.approx(20 * 0.729, rel=0.01)  # DejaVu's capitals
    assert drawing.warnings == ["letters are drawn with fonts of this computer: DejaVu Sans"]


# Harm


ENTITIES = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10))
LAUGHS = f"<!DOCTYPE svg [<!ENTITY e0 \"<rect width='1' height='1'/>\">{ENTITIES}]>"
ADDRESS = '<!DOCTYPE svg [<!ENTITY ns_svg "http://www.w3.org/2000/svg">]>'
DOUBLING = "".join(f'<g id="g{k}"><use href="#g{k - 1}"/><use href="#g{k - 1}" x="1"/></g>' for k in range(1, 40))


@pytest.mark.parametrize(
    ("lines", "before", "message"),
    [
        (["&e9;"], LAUGHS, r"line 1: cannot be read as SVG: its entity 'e1' stands for others or for more than 10000"),
        (
            [f'<defs><g id="g0"><rect width="1" height="1"/></g>{DOUBLING}</defs><use href="#g39"/>'],
            "",
            "more than 100000 entities",
        ),
        (["<path d='" + "M0 0h1" * 200_000 + "'/>"], "", "more than 100000 entities"),
        (["<path d='M0 0" + "h1" * 3_000_000 + "'/>"], "", "path data of more than 5 million characters"),
        (["<path d='M0 0" + "h1v1" * 260_000 + "'/>"], "", "or 500000 steps, out of range"),
        ([f"<path d='M0 0h9' transform='{'translate(1 1)' * 1001}'/>"], "", "a transform of 1001 parts"),
        (["<g/>" * 100_001], "", "more than 100000 elements"),
        (['<circle r="1e8"/>' * 300], "", r"more than 1e\+07 mm to cut"),
    ],
)
def test_a_picture_beyond_all_measure_is_refused_at_once(picture, lines, before, message):
    began = time.process_time()
    with pytest.raises(InvalidInput, match=message):
        picture(*lines, before=before)
    assert time.process_time() - began < 5.0


def test_entities_that_only_shorten_are_read(picture):
    head = '<svg xmlns="&ns_svg;" width="200mm" height="100mm" viewBox="0 0 200 100">'
    assert picture('<path d="M0 0h10"/>', before=ADDRESS, head=head).cut_length == pytest.approx(10)


def test_text_that_is_not_drawn_is_read_in_no_time(picture):
    lines = "\n".join(["x" * 76] * 50_000)
    began = time.process_time()
    drawing = picture(f'<i:pgf xmlns:i="http://ns.adobe.com/i">{lines}</i:pgf><path d="M0 0h10"/>')
    assert time.process_time() - began < 5.0
    assert drawing.cut_length == pytest.approx(10)
