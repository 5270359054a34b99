"""The elements of an SVG file, each with its line, and what their attributes say."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax import SAXException, SAXParseException, handler, make_parser

import numpy as np

from ..plant.quantity import InvalidInput

PIXEL = 25.4 / 96.0
"""mm of a user unit that nothing else is said about. [P] CSS"""

PIXELS = {
    "": 1.0, "px": 1.0, "mm": 1 / PIXEL, "cm": 10 / PIXEL, "Q": 0.25 / PIXEL, "in": 96.0, "pt": 96 / 72, "pc": 16.0,
}  # fmt: skip
"""Pixels of each unit of length. [P] CSS"""

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
NUMBERS = re.compile(rf"[\s,]*(?:{NUMBER}[\s,]*)*")
LENGTH = re.compile(rf"\s*({NUMBER})\s*([a-zA-Z%]*)\s*")

DEEPEST = 200
"""Elements within elements."""

SPACES = {
    None: "", "": "", "http://www.w3.org/2000/svg": "", "http://www.w3.org/1999/xlink": "xlink:",
    "http://www.inkscape.org/namespaces/inkscape": "inkscape:",
}  # fmt: skip
"""Prefixes in the names of elements and attributes; all other names begin with "other:"."""


@dataclass(eq=False)
class Node:
    """An element of ``file``, in line ``line``."""

    file: Path
    tag: str
    attributes: dict[str, str]
    line: int
    children: list["Node"] = field(default_factory=list)
    text: str = ""

    def wrong(self, problem: str) -> InvalidInput:
        """An error that names the element."""
        return InvalidInput(f"{self.file}, line {self.line}: {self.tag}: {problem}")

    def get(self, name: str, default: str = "") -> str:
        """An attribute, as such or in the ``style``, which wins."""
        for item in self.attributes.get("style", "").split(";"):
            key, _, value = item.partition(":")
            if key.strip() == name:
                return value.strip()
        return self.attributes.get(name, default).strip()

    def unit(self, name: str) -> str:
        """The unit in which a length is given; empty if there is none."""
        match = LENGTH.fullmatch(self.get(name))
        return match[2] if match else ""

    def length(self, name: str, whole: float, default: str = "0") -> float:
        """A length in px; ``whole`` is what 100 % are."""
        text = self.get(name, default) or default
        match = LENGTH.fullmatch(text)
        if not match or match[2] not in (*PIXELS, "%") or not np.isfinite(float(match[1])):
            allowed = ", ".join(unit for unit in PIXELS if unit)
            raise self.wrong(f"{name} = '{text}' is not a length; allowed: a number with {allowed} or %")
        return float(match[1]) * (whole / 100.0 if match[2] == "%" else PIXELS[match[2]])

    def numbers(self, name: str) -> list[float]:
        """A list of numbers."""
        text = self.attributes.get(name, "")
        match = NUMBERS.match(text)
        if not match or match.end() < len(text):
            raise self.wrong(f"{name} = '{short(text)}' are not all numbers")
        return [float(number) for number in re.findall(NUMBER, text)]

    def view_box(self) -> list[float] | None:
        """x, y, width and height of its view box, if it has one."""
        if not self.attributes.get("viewBox", "").strip():
            return None
        box = self.numbers("viewBox")
        if len(box) != 4 or min(box[2:]) <= 0.0:
            raise self.wrong(f"viewBox = '{self.attributes['viewBox']}' is not x, y, width > 0, height > 0")
        return box

    def all(self) -> list["Node"]:
        """The element and all within it, in the order of the file."""
        found = [self]
        for child in self.children:
            found += child.all()
        return found


def tree(file: Path) -> Node:
    """The outermost element of an SVG file.

    Raises:
        InvalidInput: not XML, or not SVG.
    """
    builder, parser = _Builder(file), make_parser()
    parser.setFeature(handler.feature_namespaces, True)
    parser.setContentHandler(builder)
    try:
        with file.open("rb") as stream:
            parser.parse(stream)
    except SAXParseException as error:
        problem = f"{file}, line {error.getLineNumber()}: cannot be read as SVG: {error.getMessage()}"
        raise InvalidInput(problem) from None
    except (SAXException, ValueError, OSError) as error:
        raise InvalidInput(f"{file}: cannot be read as SVG: {error}") from None
    if builder.root is None or builder.root.tag != "svg":
        raise InvalidInput(f"{file}: cannot be read as SVG: its outermost element is no svg")
    return builder.root


class _Builder(handler.ContentHandler):
    """Makes the tree, with the line of every element, which other readers of XML do not tell."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.open: list[Node] = []
        self.root: Node | None = None
        self.locator: Any = None

    def setDocumentLocator(self, locator: Any) -> None:
        self.locator = locator

    def startElementNS(self, name: Any, qname: Any, attrs: Any) -> None:
        attributes = {_name(*key): value for key, value in attrs.items()}
        node = Node(self.file, _name(*name), attributes, self.locator.getLineNumber())
        if len(self.open) > DEEPEST:
            raise SAXException(f"elements lie more than {DEEPEST} deep within each other")
        if self.open:
            self.open[-1].children.append(node)
        else:
            self.root = node
        self.open.append(node)

    def endElementNS(self, name: Any, qname: Any) -> None:
        self.open.pop()

    def characters(self, content: str) -> None:
        self.open[-1].text += content


def _name(space: str | None, local: str) -> str:
    return SPACES.get(space, "other:") + local


def short(text: str) -> str:
    """The beginning of a text, for messages."""
    text = " ".join(text.split())
    return text if len(text) <= 30 else f"{text[:30]}…"
