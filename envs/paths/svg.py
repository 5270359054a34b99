"""SVG: the outlines of a picture, as contours in cutting order.

Path data and lists of transforms are read by svgpathtools, which is kept up; svgelements reads whole documents, but
passes over commands it does not know without a word. The document is walked here, as svgpathtools knows neither view
boxes, units and ``use`` nor where in the file a mistake is.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..engine.quantity import InvalidInput, in_order
from . import svg_style
from .choice import Choice, Reading, merged
from .collected import Collected
from .colours import NONE, in_svg, of_css
from .drawing import Drawing, finished, unit
from .svg_shapes import CUT, Matrix, curves
from .svg_text import letters
from .svg_tree import DEEPEST, PIXEL, Mistake, Node, tree

GROUPS = ("g", "a", "svg", "switch", "use")

NOT_DRAWN = in_order(
    "defs symbol clipPath mask marker pattern linearGradient radialGradient filter style script metadata title desc "
    "view cursor animate animateTransform animateMotion set animateColor font font-face color-profile solidColor "
    "meshgradient tspan textPath"
)
"""Elements that show nothing where they stand."""

IGNORED = {
    "clip-path": "clip-path clips nothing, whole shapes are cut",
    "mask": "mask hides nothing, whole shapes are cut",
    "stroke-dasharray": "stroke-dasharray is left out, dashes are cut as one line",
}
"""Attributes that change what is seen and not what is cut."""

MOST_DATA, MOST_STEPS, MOST_TRANSFORMS = 5_000_000, 500_000, 1000
"""Characters of path data and letters among them, those that are used several times counted as often; parts of one
transform."""

NESTING = 64
"""Groups within groups; more means that something uses itself."""


@dataclass(frozen=True)
class Place:
    """Where in the picture an element is: its axes in mm, the size of the viewport in its units, its layer, the colour
    of its stroke."""

    matrix: Matrix
    width: float
    height: float
    layer: str = ""
    stroke: str = NONE
    shown: bool = True
    depth: int = 0


def read_svg(path: str | Path, asked: Reading = Reading()) -> Drawing:  # noqa: B008
    """The contours of an SVG picture, inner ones before those that contain them, otherwise the nearest next.

    Cut are the outlines of paths and basic shapes, whatever their stroke and fill. The y axis is turned up, so that the
    page's lower left corner is the origin. Layers are Inkscape's, or in files without them the outermost groups that
    have an id. An element that cannot be read is left out and named with its line.

    Args:
        path: an SVG file.
        asked: how it is read. Units are those of the view box, instead of what follows from the size of the page;
            colours are those of strokes: a name, #rrggbb, or none. Outlines of filled areas are always cut.

    Raises:
        InvalidInput: not an SVG file, unknown units, layer or colour, nothing to cut, or more than a drawing may have.
    """
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # what comes out as no number, or far away, is told where it is drawn
        return _Picture(Path(path), asked).drawing()


class _Picture:
    """An SVG file on its way to a drawing."""

    def __init__(self, file: Path, asked: Reading) -> None:
        self.file, self.asked, self.data, self.steps = file, asked, 0, 0
        self.layer_choice = Choice("layer", asked.layers)
        self.colour_choice = Choice("colour", asked.colours, in_svg)
        self.root = tree(file)
        self.found = Collected(file)
        for node, selector in svg_style.apply(self.root):
            self.found.warn("style sheet: some rules are not read", f"'{selector}' in line {node.line}")
        self.named = {n.attributes["id"]: n for n in self.root.all() if "id" in n.attributes}
        self.inkscape = any(n.attributes.get("inkscape:groupmode") == "layer" for n in self.root.all())
        groups = self.root.all() if self.inkscape else self.root.children
        self.layer_of = {id(n): name for n in groups if (name := self._own_layer(n))}
        self.layer_choice.check(file, dict.fromkeys(self.layer_of.values()))
        self.units, self.page = self._page(asked.units)

    def drawing(self) -> Drawing:
        self.found.room_for(self._count(self.root, {}, 0))
        self._group(self.root, replace(self.page, stroke=self._stroke(self.root, NONE)))
        self.colour_choice.check(self.file, self.colour_choice.seen)
        if not self.asked.text and not self.found.curves and "text" in self.found.skipped:
            self.found.warn("--text cuts letters as outlines")
        return finished(self.file, self.found, self.units, self.asked.join, ", ".join(CUT))

    def _count(self, node: Node, known: dict[int, int], depth: int) -> int:
        """How many elements there are within an element and what it uses: a bomb is known before it goes off."""
        if id(node) not in known:
            if depth > DEEPEST:
                self._endless(node)
            target = self._target(node) if node.tag == "use" else None
            within = node.children if target is None else [*node.children, target]
            known[id(node)] = 1 + sum(self._count(child, known, depth + 1) for child in within)
        return known[id(node)]

    def _endless(self, node: Node) -> None:
        problem = f"{node.tag}: nested more than {NESTING} deep; does something use itself?"
        raise InvalidInput(f"{self.file}, line {node.line}: {problem}")

    def _target(self, node: Node) -> Node | None:
        """What a ``use`` refers to, if it is in the file."""
        link = _link(node)
        return self.named.get(link[1:]) if link.startswith("#") else None

    # The document

    def _own_layer(self, node: Node) -> str:
        """The name of the layer that a group is, or nothing."""
        if node.tag != "g" or (self.inkscape and node.attributes.get("inkscape:groupmode") != "layer"):
            return ""
        return node.attributes.get("inkscape:label", node.attributes.get("id", ""))

    def _warn(self, node: Node, text: str) -> None:
        self.found.warn(text, f"line {node.line}")

    def _page(self, units: str | None) -> tuple[str, Place]:
        """Name of the file's unit, and the page with its y axis up."""
        root = self.root
        box = root.view_box()
        sizes = [self._size(root, side) for side in ("width", "height")]
        if units is not None:
            name, scale = unit(units)
            x, y, width, height = box or (0.0, 0.0, *(s or 0.0 for s in sizes))
            return name, Place(_scaled(scale, -scale, 0.0, scale * height) @ _moved(-x, -y), width, height)
        name = "px"
        if sizes == [None, None]:
            self._warn(root, "no usable size of the page, px read as 1/96 inch; --units reads them otherwise")
            width, height = box[2:] if box else (0.0, 0.0)
        else:
            if box:  # one side gives the other
                sizes = [
                    s if s is not None else max(t or 0.0, 0.0) * b / c
                    for s, t, b, c in zip(sizes, sizes[::-1], box[2:], box[:1:-1], strict=True)
                ]
            width, height = (s or 0.0 for s in sizes)
            given = (root.unit("width"), root.unit("height"))
            name = next((n for n in ("mm", "cm", "in", "pt", "pc", "Q") if n in given), "px")
            name = {"in": "inches"}.get(name, name)
            if name == "px":
                self._warn(root, "size of the page in px, read as 1/96 inch; --units reads them otherwise")
            elif not box:
                self._warn(root, "no viewBox: coordinates are px, read as 1/96 inch; --units reads them otherwise")
        up = _scaled(PIXEL, -PIXEL, 0.0, PIXEL * height) @ self._transform(root)
        return name, self._viewport(root, Place(up, width, height), width, height)

    def _size(self, node: Node, side: str) -> float | None:
        """Width or height in px, None where it depends on what the picture is put into."""
        text = node.attributes.get(side, "").strip()
        if text in ("", "auto") or text.endswith("%"):
            return None
        size = node.length(side, 0.0)
        if size <= 0.0:
            raise node.wrong(f"{side} = '{text}' is out of range; allowed: more than 0")
        return size

    def _viewport(self, node: Node, place: Place, width: float, height: float) -> Place:
        """The inside of an svg or symbol of that size: its view box fitted in."""
        box = node.view_box()
        if not box or not (width and height):
            return replace(place, width=width, height=height)
        align, _, how = node.attributes.get("preserveAspectRatio", "xMidYMid").partition(" ")
        scale = np.array([width / box[2], height / box[3]])
        if align != "none":
            scale[:] = scale.max() if how.strip() == "slice" else scale.min()
        rest = np.array([width, height]) - scale * box[2:]
        share = [{"Min": 0.0, "Mid": 0.5, "Max": 1.0}.get(align[i : i + 3], 0.0) for i in (1, 5)]
        shift = rest * share - scale * box[:2]
        fit = _scaled(*scale, *shift)
        return replace(place, matrix=place.matrix @ fit, width=box[2], height=box[3])

    # Elements

    def _group(self, node: Node, place: Place) -> None:
        for child in node.children:
            self._element(child, place)
            if node.tag == "switch" and child.tag in (*GROUPS, *CUT):
                return  # the first that can be shown

    def _element(self, node: Node, place: Place) -> None:
        if node.tag in NOT_DRAWN or ":" in node.tag:
            return
        self.found.entity()
        if place.depth > NESTING:
            self._endless(node)
        shown = {"visible": True, "hidden": False, "collapse": False}.get(node.get("visibility"), place.shown)
        named = self.layer_choice.named(self.layer_of.get(id(node), ""))  # who names a hidden layer wants it cut
        if (node.get("display") == "none" and not named) or (not shown and node.tag not in GROUPS):
            self.found.skipped[f"hidden {node.tag}"] += 1
            return
        for name, consequence in IGNORED.items():
            if node.get(name, "none") not in ("none", ""):
                self._warn(node, consequence)
        try:
            self._shown(node, replace(place, shown=shown, depth=place.depth + 1))
        except Mistake as error:
            self.found.skipped[f"{node.tag} that cannot be read"] += 1
            self.found.warn("elements that cannot be read are left out", error.plain)

    def _shown(self, node: Node, place: Place) -> None:
        layer, stroke = self.layer_of.get(id(node), place.layer), self._stroke(node, place.stroke)
        place = replace(place, matrix=place.matrix @ self._transform(node), layer=layer, stroke=stroke)
        if node.tag in ("g", "a", "switch"):
            self._group(node, place)
        elif node.tag == "svg":
            self._nested(node, place, node)
        elif node.tag == "use":
            self._use(node, place)
        else:
            self._shape(node, place)

    def _shape(self, node: Node, place: Place) -> None:
        skipped = self.found.skipped
        by_layer, by_colour = self.layer_choice.role(place.layer), self.colour_choice.role(place.stroke)
        role = merged(by_layer, by_colour)
        if node.tag not in CUT and not (node.tag == "text" and self.asked.text):
            skipped[node.tag] += 1
        elif role == "ignore":
            where = f"on layer '{place.layer}'" if place.layer else "on no layer"
            skipped[f"{node.tag} {where if by_layer == 'ignore' else f'with stroke {place.stroke}'}"] += 1
        elif node.tag == "text":
            for curve in letters(node, place.matrix, self.found):
                self.found.add("letter", curve, place.layer, role, f"in line {node.line}")
        else:
            self._heavy(node)
            found = list(curves(node, place.matrix, place.width, place.height))
            for curve in found:
                self.found.add(node.tag, curve, place.layer, role, f"in line {node.line}")
            if not found and node.attributes.get("d") != "":
                skipped[f"{node.tag} of zero length"] += 1

    def _heavy(self, node: Node) -> None:
        """Counts what path data come to before they are read: each lift of the pen is an entity."""
        data = node.attributes.get("d", "") if node.tag == "path" else ""
        self.data += len(data)
        self.steps += sum(map(data.count, "LlHhVvCcSsQqTtAaZz"))
        self.found.room_for(data.count("M") + data.count("m"))
        self.found.entities += max(data.count("M") + data.count("m") - 1, 0)
        if self.data > MOST_DATA or self.steps > MOST_STEPS:
            raise InvalidInput(
                f"{self.file}, line {node.line}: path data of more than {MOST_DATA / 1e6:g} million characters or "
                f"{MOST_STEPS} steps, out of range; allowed: fewer"
            )

    def _stroke(self, node: Node, around: str) -> str:
        """The colour of an element's stroke: ``#rrggbb``, none, or as the file has it, such as ``url(#gradient)``."""
        own = node.get("stroke")
        if own in ("", "inherit"):
            return around
        if own.lower() == "currentcolor":
            own = node.inherited("color", "black")
        return of_css(own) or own

    def _transform(self, node: Node) -> Matrix:
        from svgpathtools import parse_transform  # slow

        count = node.get("transform").count("(")
        if count > MOST_TRANSFORMS:
            raise node.wrong(f"a transform of {count} parts, out of range; allowed: {MOST_TRANSFORMS}")
        try:
            return parse_transform(node.get("transform").replace("none", ""), strict=True)
        except ValueError as error:
            raise node.wrong(f"transform cannot be read: {error}") from None

    def _nested(self, node: Node, place: Place, sized: Node) -> None:
        """An svg within the svg, or a symbol whose place and size are those of the ``use``."""
        x, y = (sized.length(n, w) for n, w in (("x", place.width), ("y", place.height)))
        width = sized.length("width", place.width, "100%")
        height = sized.length("height", place.height, "100%")
        moved = replace(place, matrix=place.matrix @ _moved(x, y))
        self._group(node, self._viewport(node, moved, width, height))

    def _use(self, node: Node, place: Place) -> None:
        target = self._target(node)
        if target is None:
            raise node.wrong(f"href = '{_link(node)}' is nothing in this file")
        if target.tag == "symbol":
            return self._nested(target, place, node)
        x, y = node.length("x", place.width), node.length("y", place.height)
        return self._element(target, replace(place, matrix=place.matrix @ _moved(x, y)))


def _link(node: Node) -> str:
    return node.attributes.get("href", node.attributes.get("xlink:href", "")).strip()


# Geometry


def _scaled(sx: float, sy: float, x: float, y: float) -> Matrix:
    return np.array([[sx, 0.0, x], [0.0, sy, y], [0.0, 0.0, 1.0]])


def _moved(x: float, y: float) -> Matrix:
    return _scaled(1.0, 1.0, x, y)
