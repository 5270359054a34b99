"""SVG: the outlines of a picture, as curves.

Path data and lists of transforms are read by svgpathtools, which is kept up; svgelements reads whole documents, but
passes over commands it does not know without a word. The document is walked here, as svgpathtools knows neither view
boxes, units and ``use`` nor where in the file a mistake is.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .contours import joined, ordered
from .drawing import Collected, Drawing, chosen, drawing, unit
from .svg_shapes import CUT, Matrix, curves
from .svg_tree import PIXEL, Node, tree

GROUPS = ("g", "a", "svg", "switch", "use")

NOT_DRAWN = (
    "defs", "symbol", "clipPath", "mask", "marker", "pattern", "linearGradient", "radialGradient", "filter", "style",
    "script", "metadata", "title", "desc", "view", "cursor", "animate", "animateTransform", "animateMotion", "set",
)  # fmt: skip
"""Elements that show nothing where they stand."""

IGNORED = {
    "clip-path": "clips nothing: whole shapes are cut",
    "mask": "hides nothing: whole shapes are cut",
    "stroke-dasharray": "is left out: dashes are cut as one line",
}
"""Attributes that change what is seen and not what is cut."""

NESTING = 64
"""Groups within groups; more means that something uses itself."""

STYLED = re.compile(r"\b(display|visibility|transform|clip-path|mask)\s*:")


@dataclass(frozen=True)
class Place:
    """Where in the picture an element is: its axes in mm, the size of the viewport in its units, its layer."""

    matrix: Matrix
    width: float
    height: float
    layer: str = ""
    shown: bool = True
    depth: int = 0


def read_svg(
    path: str | Path, *, layers: tuple[str, ...] | list[str] | str | None = None, units: str | None = None
) -> Drawing:
    """The contours of an SVG picture, inner ones before those that contain them, otherwise the nearest next.

    Cut are the outlines of paths and basic shapes, whatever their stroke and fill. The y axis is turned up, so that the
    page's lower left corner is the origin. Layers are Inkscape's, or in files without them the outermost groups that
    have an id.

    Args:
        path: an SVG file.
        layers: names of the layers that are cut, in any case; None: all.
        units: what one unit of the view box is, instead of what follows from the size of the page.

    Raises:
        InvalidInput: not an SVG file, unknown units or layer, an element that cannot be read (with its line), nothing
            to cut, or a journey whose length is out of range.
    """
    return _Picture(Path(path), layers, units).drawing()


class _Picture:
    """An SVG file on its way to a drawing."""

    def __init__(self, file: Path, layers: tuple[str, ...] | list[str] | str | None, units: str | None) -> None:
        self.file = file
        self.root = tree(file)
        self.named = {n.attributes["id"]: n for n in self.root.all() if "id" in n.attributes}
        self.inkscape = any(n.attributes.get("inkscape:groupmode") == "layer" for n in self.root.all())
        groups = self.root.all() if self.inkscape else self.root.children
        self.layer_of = {id(n): name for n in groups if (name := self._own_layer(n))}
        self.wanted = chosen(file, layers, list(dict.fromkeys(self.layer_of.values())))
        self.warnings: dict[str, list[int]] = {}
        self.found = Collected()
        self.units, self.page = self._page(units)

    def drawing(self) -> Drawing:
        for node in self.root.all():
            if node.tag == "style" and (styled := STYLED.search(node.text)):
                self._warn(node, f"style sheet: '{styled[1]}' is not read")
        self._group(self.root, self.page)
        contours = ordered(joined(list(self.found.curves.values())))
        warnings = [f"{text} (line {', '.join(map(str, lines))})" for text, lines in self.warnings.items()]
        layers = [layer for layer in self.found.layers if layer]
        return drawing(
            self.file, self.file.stem, contours, self.units, layers, self.found.skipped, warnings=warnings,
            cuts=", ".join(CUT),
        )  # fmt: skip

    # The document

    def _own_layer(self, node: Node) -> str:
        """The name of the layer that a group is, or nothing."""
        if node.tag != "g" or (self.inkscape and node.attributes.get("inkscape:groupmode") != "layer"):
            return ""
        return node.attributes.get("inkscape:label", node.attributes.get("id", ""))

    def _warn(self, node: Node, text: str) -> None:
        self.warnings.setdefault(text, []).append(node.line)

    def _page(self, units: str | None) -> tuple[str, Place]:
        """Name of the file's unit, and the page with its y axis up."""
        root = self.root
        box = root.view_box()
        sizes = [self._size(root, side) for side in ("width", "height")]
        if units is not None:
            name, scale = unit(units)
            width, height = box[2:] if box else [s if s is not None else 0.0 for s in sizes]
            corner = box[:2] if box else (0.0, 0.0)
            fit = _moved(-corner[0], -corner[1])
            return name, Place(_scaled(scale, -scale, 0.0, scale * height) @ fit, width, height)
        name = "px"
        if sizes == [None, None]:
            self._warn(root, "no usable size of the page, px read as 1/96 inch; units= reads them otherwise")
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
                self._warn(root, "size of the page in px, read as 1/96 inch; units= reads them otherwise")
            elif not box:
                self._warn(root, "no viewBox: coordinates are px, read as 1/96 inch; units= reads them otherwise")
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
        shown = {"visible": True, "hidden": False, "collapse": False}.get(node.get("visibility"), place.shown)
        layer = self.layer_of.get(id(node), place.layer)
        if node.get("display") == "none" or (not shown and node.tag not in GROUPS):
            self.found.skipped[f"hidden {node.tag}"] += 1
            return
        if place.depth > NESTING:
            raise node.wrong(f"nested more than {NESTING} deep; does something use itself?")
        for name, consequence in IGNORED.items():
            if node.get(name, "none") not in ("none", ""):
                self._warn(node, f"{name} {consequence}")
        matrix = place.matrix @ self._transform(node)
        inside = Place(matrix, place.width, place.height, layer, shown, place.depth + 1)
        if node.tag in ("g", "a", "switch"):
            self._group(node, inside)
        elif node.tag == "svg":
            self._nested(node, inside, node)
        elif node.tag == "use":
            self._use(node, inside)
        elif self.wanted is not None and layer.casefold() not in self.wanted:
            self.found.skipped[f"{node.tag} on layer '{layer}'" if layer else f"{node.tag} on no layer"] += 1
        elif node.tag not in CUT:
            self.found.skipped[node.tag] += 1
        else:
            found = list(curves(node, matrix, place.width, place.height))
            for curve in found:
                self.found.add(node.tag, curve, layer)
            if not found and node.attributes.get("d") != "":
                self.found.skipped[f"{node.tag} of zero length"] += 1

    def _transform(self, node: Node) -> Matrix:
        from svgpathtools import parse_transform  # slow

        try:
            return parse_transform(node.get("transform"), strict=True)
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
        link = node.attributes.get("href", node.attributes.get("xlink:href", "")).strip()
        target = self.named.get(link[1:]) if link.startswith("#") else None
        if target is None:
            raise node.wrong(f"href = '{link}' is nothing in this file")
        if target.tag == "symbol":
            return self._nested(target, place, node)
        x, y = node.length("x", place.width), node.length("y", place.height)
        return self._element(target, replace(place, matrix=place.matrix @ _moved(x, y)))


# Geometry


def _scaled(sx: float, sy: float, x: float, y: float) -> Matrix:
    return np.array([[sx, 0.0, x], [0.0, sy, y], [0.0, 0.0, 1.0]])


def _moved(x: float, y: float) -> Matrix:
    return _scaled(1.0, 1.0, x, y)
