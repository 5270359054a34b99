"""SVG text as outlines, for those who want it cut: letters of a font of this computer, drawn by matplotlib.

Each stretch of text begins where its ``x`` and ``y`` say, or where the one before ends; ``dx``, ``dy``,
``text-anchor``, size, family, weight and slope are heeded. Single letters are not placed one by one, and text on a
path is left out.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from .collected import Collected
from .curve import Curve, linked, strokes
from .svg_shapes import Matrix
from .svg_tree import Node

GENERIC = {"sans-serif": "DejaVu Sans", "serif": "DejaVu Serif", "monospace": "DejaVu Sans Mono", "": "DejaVu Sans"}
"""Fonts that come with matplotlib."""


@dataclass
class Pen:
    """Where the next letter begins, px."""

    x: float = 0.0
    y: float = 0.0


def letters(node: Node, matrix: Matrix, found: Collected) -> Iterator[Curve]:
    """The outlines of a ``text`` element, mm; ``matrix``: from its units to mm."""
    yield from _stretches(node, Pen(), matrix, found)


def _stretches(node: Node, pen: Pen, matrix: Matrix, found: Collected) -> Iterator[Curve]:
    if node.tag == "textPath":
        found.warn("text on a path is left out", f"line {node.line}")
        return
    for axis in ("x", "y"):
        if first := node.attributes.get(axis, "").replace(",", " ").split()[:1]:
            setattr(pen, axis, _number(node, axis, first[0]))
        if by := node.attributes.get(f"d{axis}", "").replace(",", " ").split()[:1]:
            setattr(pen, axis, getattr(pen, axis) + _number(node, f"d{axis}", by[0]))
    said = list(node.texts)
    for number in range(len(node.children) + 1):
        words = " ".join("".join(text for at, text in said if at == number).split())
        if words:
            yield from _letters(node, words, pen, matrix, found)
        if number < len(node.children) and node.children[number].tag in ("tspan", "textPath", "a"):
            yield from _stretches(node.children[number], pen, matrix, found)


def _number(node: Node, name: str, text: str) -> float:
    held = Node(node.file, node.tag, {name: text}, node.line, node)
    return held.length(name, 0.0)


def _letters(node: Node, words: str, pen: Pen, matrix: Matrix, found: Collected) -> Iterator[Curve]:
    from matplotlib.font_manager import FontProperties, findfont  # slow
    from matplotlib.textpath import TextPath, text_to_path

    font, size = _font(node, FontProperties), node.font_size()
    found.warn("letters are drawn with fonts of this computer", FontProperties(fname=findfont(font)).get_name())
    font.set_size(size)
    width = text_to_path.get_text_width_height_descent(words.replace("$", r"\$"), font, ismath=False)[0]
    left = pen.x - {"middle": 0.5, "end": 1.0}.get(node.inherited("text-anchor"), 0.0) * width
    path = TextPath((0.0, 0.0), words.replace("$", r"\$"), size=size, prop=font)
    z = left + path.vertices[:, 0] + 1j * (pen.y - path.vertices[:, 1])
    ahead, up, origin = (complex(*column) for column in matrix[:2].T)
    yield from _outlines(z.real * ahead + z.imag * up + origin, path.codes)
    pen.x = left + width


def _font(node: Node, properties: Any) -> Any:
    families = [name.strip(" '\"") for name in node.inherited("font-family").split(",")]
    return properties(
        family=[GENERIC.get(name.lower(), name) for name in families] + [GENERIC[""]],
        style={"italic": "italic", "oblique": "oblique"}.get(node.inherited("font-style"), "normal"),
        weight="bold" if node.inherited("font-weight") in ("bold", "bolder", "600", "700", "800", "900") else "normal",
    )


def _outlines(z: Any, codes: Any) -> Iterator[Curve]:
    """Curves of matplotlib's vertices and codes: 1 moves, 2 to 4 draw with one vertex less, anything else closes."""
    first: complex = 0j
    steps: list[tuple[complex, ...]] = []
    i = 0
    while i < len(codes):
        code = int(codes[i])
        count = code - 1 if 2 <= code <= 4 else 1
        if 2 <= code <= 4:
            steps.append(tuple(z[i : i + count]))
        else:
            yield from _stroke(first, steps if code == 1 else [*steps, (first,)])
            first, steps = z[i] if code == 1 else first, []
        i += count
    yield from _stroke(first, steps)


def _stroke(first: complex, steps: list[tuple[complex, ...]]) -> Iterator[Curve]:
    if parts := [p for p in strokes(first, steps) if len(p.points) > 1]:
        yield linked(parts)
