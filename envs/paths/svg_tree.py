"""The elements of an SVG file, each with its line, and what their attributes say."""

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from ..engine.quantity import InvalidInput
from .collected import MOST_ENTITIES

PIXEL = 25.4 / 96.0
"""mm of a user unit that nothing else is said about. [P] CSS"""

PIXELS = {
    **{"": 1.0, "px": 1.0, "mm": 1 / PIXEL, "cm": 10 / PIXEL, "Q": 0.25 / PIXEL},
    **{"in": 96.0, "pt": 96 / 72, "pc": 16.0},
}
"""Pixels of each unit of length. [P] CSS"""

OF_FONT = {"em": 1.0, "rem": 1.0, "ex": 0.5, "ch": 0.5}
"""Of the font's size. [P] CSS; ex and ch as for a font that does not say."""

FONT = 16.0
"""px, the size of a font that nothing is said about. [P] CSS: medium"""

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
NUMBERS = re.compile(rf"[\s,]*(?:{NUMBER}[\s,]*)*")
LENGTH = re.compile(rf"\s*({NUMBER})\s*([a-zA-Z%]*)\s*")

DECLARED = re.compile(rb"\s*<\?xml[^>]*\bencoding\b")
"""The beginning of a file that names its encoding."""

DEEPEST = 200
"""Elements within elements."""

LONGEST_ENTITY = 10_000
"""Characters that an entity of the file's own may stand for; Illustrator's are addresses."""

SPACES = {
    "": "",
    "http://www.w3.org/2000/svg": "",
    "http://www.w3.org/1999/xlink": "xlink:",
    "http://www.inkscape.org/namespaces/inkscape": "inkscape:",
}
"""Prefixes in the names of elements and attributes; all other names begin with "other:"."""

USUAL = {"svg": "", "xlink": "xlink:", "inkscape": "inkscape:"}
"""What prefixes stand for that a file uses without saying so; none of others."""

TEXTS = ("style", "text", "tspan", "textPath")
"""Elements whose text is kept."""


class Mistake(InvalidInput):
    """An element that cannot be read; ``plain`` says so without the file."""

    def __init__(self, file: Path, plain: str) -> None:
        super().__init__(f"{file}, {plain}")
        self.plain = plain


@dataclass(eq=False)
class Node:
    """An element of ``file``, in line ``line``; ``css`` is what style sheets say about it."""

    file: Path
    tag: str
    attributes: dict[str, str]
    line: int
    parent: "Node | None" = None
    children: list["Node"] = field(default_factory=list)
    texts: list[tuple[int, str]] = field(default_factory=list)
    css: dict[str, str] = field(default_factory=dict)

    def wrong(self, problem: str) -> Mistake:
        """An error that names the element."""
        return Mistake(self.file, f"line {self.line}: {self.tag}: {problem}")

    @property
    def text(self) -> str:
        """Its own text, without that of the elements within it."""
        return "".join(text for _, text in self.texts)

    def get(self, name: str, default: str = "") -> str:
        """An attribute: as such, in a style sheet, which wins, or in the ``style``, which wins over both."""
        for item in self.attributes.get("style", "").split(";"):
            key, _, value = item.partition(":")
            if key.strip() == name:
                return value.replace("!important", "").strip()
        return self.css.get(name, self.attributes.get(name, default)).strip()

    def inherited(self, name: str, default: str = "") -> str:
        """An attribute of its own, or else of the nearest element around it that has one."""
        here: Node | None = self
        while here is not None:
            value = here.get(name)
            if value and value != "inherit":
                return value
            here = here.parent
        return default

    def unit(self, name: str) -> str:
        """The unit in which a length is given; empty if there is none."""
        match = LENGTH.fullmatch(self.get(name))
        return match[2] if match else ""

    def length(self, name: str, whole: float, default: str = "0") -> float:
        """A length in px; ``whole`` is what 100 % are."""
        text = self.get(name, default) or default
        match = LENGTH.fullmatch(text)
        if match and match[2] in OF_FONT:
            return float(match[1]) * OF_FONT[match[2]] * (FONT if match[2] == "rem" else self.font_size())
        if not match or match[2] not in (*PIXELS, "%") or not np.isfinite(float(match[1])):
            allowed = ", ".join(unit for unit in (*PIXELS, *OF_FONT) if unit)
            raise self.wrong(f"{name} = '{short(text)}' is not a length; allowed: a number with {allowed} or %")
        return float(match[1]) * (whole / 100.0 if match[2] == "%" else PIXELS[match[2]])

    def font_size(self) -> float:
        """px of the font's em."""
        match = LENGTH.fullmatch(self.get("font-size"))
        around = self.parent.font_size() if self.parent is not None else FONT
        if not match:
            return around
        if match[2] in OF_FONT or match[2] == "%":
            of = FONT if match[2] == "rem" else around
            return float(match[1]) * OF_FONT.get(match[2], 0.01) * of
        return float(match[1]) * PIXELS.get(match[2], 1.0)

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

    def all(self) -> Iterator["Node"]:
        """The element and all within it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.all()


def tree(file: Path) -> Node:
    """The outermost element of an SVG file.

    Raises:
        InvalidInput: not XML, not SVG, or more elements or longer entities than a drawing may have.
    """
    builder, data = _Builder(file), file.read_bytes()
    try:
        # All at once: expat looks at a long attribute anew for each piece of the file that it is given.
        builder.parser.Parse(data, True)
    except expat.ExpatError as error:
        said = _no_utf8(data) or expat.ErrorString(error.code)
        raise InvalidInput(f"{file}, line {error.lineno}: cannot be read as SVG: {said}") from None
    except (ValueError, LookupError, OSError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"{file}: cannot be read as SVG: {error}") from None
    if builder.root is None or builder.root.tag != "svg":
        raise InvalidInput(f"{file}: cannot be read as SVG: its outermost element is no svg")
    return builder.root


def _no_utf8(data: bytes) -> str:
    """What is wrong with the letters of a file that says nothing of its encoding; empty if nothing is."""
    if DECLARED.match(data) or data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return ""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        return (
            f"byte 0x{data[error.start]:02x} is no UTF-8, and the file names no other encoding; save it as UTF-8, or "
            'begin it with its encoding, such as <?xml version="1.0" encoding="ISO-8859-1"?>'
        )
    return ""


class _Builder:
    """Makes the tree, with the line of every element, which other readers of XML do not tell.

    Prefixes are resolved here, since the parser would refuse a file that uses one without declaring it.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.open: list[Node] = []
        self.spaces: list[dict[str, str]] = [USUAL]
        self.root: Node | None = None
        self.count = 0
        self.parser: Any = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.characters
        self.parser.EntityDeclHandler = self.entity

    def wrong(self, problem: str) -> InvalidInput:
        return InvalidInput(f"{self.file}, line {self.parser.CurrentLineNumber}: cannot be read as SVG: {problem}")

    def entity(self, name: str, parameter: bool, value: str | None, *_: Any) -> None:
        if value is not None and (len(value) > LONGEST_ENTITY or "&" in value):
            raise self.wrong(
                f"its entity '{name}' stands for others or for more than {LONGEST_ENTITY} characters; allowed: plain "
                "short text"
            )

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self.count += 1
        if self.count > MOST_ENTITIES:
            raise self.wrong(f"more than {MOST_ENTITIES} elements; allowed: no more")
        if len(self.open) > DEEPEST:
            raise self.wrong(f"elements lie more than {DEEPEST} deep within each other")
        own = {
            key.partition(":")[2]: SPACES.get(value, "other:")
            for key, value in attributes.items()
            if key.partition(":")[0] == "xmlns"
        }
        spaces = {**self.spaces[-1], **own} if own else self.spaces[-1]
        named = {
            _name(spaces, key, "") if ":" in key else key: value
            for key, value in attributes.items()
            if key.partition(":")[0] != "xmlns"
        }
        parent = self.open[-1] if self.open else None
        node = Node(self.file, _name(spaces, name, spaces.get("", "")), named, self.parser.CurrentLineNumber, parent)
        if parent is not None:
            parent.children.append(node)
        else:
            self.root = node
        self.open.append(node)
        self.spaces.append(spaces)

    def end(self, name: str) -> None:
        self.open.pop()
        self.spaces.pop()

    def characters(self, content: str) -> None:
        node = self.open[-1]
        if node.tag in TEXTS:
            node.texts.append((len(node.children), content))


def _name(spaces: dict[str, str], name: str, default: str) -> str:
    prefix, colon, local = name.rpartition(":")
    return (spaces.get(prefix, "other:") if colon else default) + local


def short(text: str) -> str:
    """The beginning of a text, for messages."""
    text = " ".join(text[:200].split())
    return text if len(text) <= 30 else f"{text[:30]}…"
