"""Words of a G-code programme: one line of RS274/NGC (Kramer et al. 2000), read once, evaluated as often as it is run.

The package index has no reader that could be used: gcodeparser takes what stands in (comments) for commands, drops
lines without a G and makes True of an expression; pygcode, from 2017, knows neither ``#<name>`` nor ``$0``; both would
have to be watched more closely than these lines.

As in LinuxCNC, letters are read in either case and blanks mean nothing, not even within a number: ``X 1 0`` is X10.
"""

import re
from collections.abc import Callable
from typing import NamedTuple

from ..engine.quantity import InvalidInput, in_order
from .gcode_arithmetic import FUNCTIONS, LEVELS, Evaluator, angle, chained, computed
from .gcode_labels import label_of
from .gcode_parameters import Key, Parameters, check

NUMBER = re.compile(r"\d+\.?\d*|\.\d+")
NAME = re.compile(r"<([^<>]*)>")
PLAIN = re.compile(r"([a-z$@^])([+-]?(?:\d+\.?\d*|\.\d+))")
ORDER = re.compile(r"(?:n[\d.]+)?o(?=[\d<\[#])")
COMMENT = re.compile(r"[(;)]")
LABEL = re.compile(r"<[^<>]*>|\d+")
LETTERS = frozenset("abcdefghijklmnpqrstuvwxyz$@^")
KEYWORDS = in_order("endsub endif endwhile endrepeat elseif else sub call return if while do break continue repeat")
"""What may follow an O and its name; longer words before those that they begin with."""

DEEPEST = 60
"""Brackets within each other."""

LONGEST = 4000
"""Characters of a line without its comments and blanks."""

SHOWN = 120
"""Characters of a line that a message shows."""


class Word(NamedTuple):
    """A letter and its value; nan where the value is known to the machine only. ``text``: as it stands in the file."""

    letter: str
    value: float
    text: str


class Order(NamedTuple):
    """What an O word says: ``label`` is its text, ``name`` computes it; ``keyword`` is empty for a bare number."""

    label: str
    name: Callable[[Parameters], str]
    keyword: str
    values: list[Evaluator]


class Block:
    """A line that has been read: its words with their evaluators, its settings, or its O word."""

    __slots__ = ("constant", "number", "order", "raw", "settings", "text", "words")

    def __init__(self, raw: str, where: str, number: int) -> None:
        self.number = number
        self.raw = without_comments(raw, where)
        self.text = "".join(self.raw.split()).lower()
        self.words: list[tuple[str, Evaluator, str]] = []
        self.settings: list[tuple[Callable[[Parameters], Key], Evaluator]] = []
        self.order: Order | None = None
        self.constant: list[Word] | None = None
        text = self.text[1:] if self.text[:1] == "/" else self.text  # the switch for such lines is off: they are run
        if len(text) > LONGEST:
            raise InvalidInput(f"{where}: {len(text)} characters in a line; allowed: {LONGEST} without comments")
        found = PLAIN.findall(text)
        plain = sum(len(letter) + len(number) for letter, number in found) == len(text) and "o" not in text
        if plain and all(letter != "n" for letter, _ in found[1:]):
            self.constant = [Word(a.upper(), float(n), a.upper() + n) for a, n in found if a != "n"]
            return
        try:
            _Reader(self, where).read()
        except RecursionError:
            raise InvalidInput(f"{where}: brackets are nested too deep") from None

    def quoted(self, start: int, end: int) -> str:
        """The part of the line from ``start`` to ``end``, which count characters without blanks, as it stands there."""
        places = [i for i, c in enumerate(self.raw) if not c.isspace()]
        return self.raw[places[start] : places[end - 1] + 1] if end > start else ""

    def evaluated(self, parameters: Parameters) -> list[Word]:
        """The words; parameters that the line sets have their new values from the next line on."""
        if self.constant is not None:
            return self.constant
        found = [Word(letter, value(parameters), text) for letter, value, text in self.words]
        new = []
        for name, value in self.settings:
            key = name(parameters)
            parameters.declare(key)
            new.append((key, value(parameters)))
        for key, number in new:
            parameters.set(key, number, self.number)
        return found


def without_comments(line: str, where: str) -> str:
    """The line with blanks in place of ``(…)`` and without what follows ``;``.

    Raises:
        InvalidInput: a bracket without its other half.
    """
    if "(" not in line and ";" not in line and ")" not in line:
        return line
    kept: list[str] = []
    at = 0
    while match := COMMENT.search(line, at):
        kept.append(line[at : match.start()])
        if match[0] == ";":
            return "".join(kept)
        at = line.find(")", match.end()) + 1
        if match[0] == ")" or not at:
            raise InvalidInput(f"{where}: '{shortened(line)}': a comment has only one of its brackets")
        kept.append(" ")
    return "".join([*kept, line[at:]])


def shortened(text: str) -> str:
    """A line for a message."""
    text = text.strip()
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}…"


class _Reader:
    """One line, from left to right."""

    def __init__(self, block: Block, where: str) -> None:
        self.block, self.text, self.where, self.at, self.depth = block, block.text, where, 0, 0

    def read(self) -> None:
        self.take("/")
        if ORDER.match(self.text, self.at):
            self.block.order = self.order()
            return
        numbered = False
        while letter := self.text[self.at : self.at + 1]:
            start = self.at
            self.at += 1
            if letter == "#":
                self.block.settings.append(self.setting())
            elif letter == "n" and not numbered and not self.block.words and not self.block.settings:
                numbered = True
                self.value("N")
            elif letter in LETTERS:
                value = self.value(letter.upper())
                self.block.words.append((letter.upper(), value, self.block.quoted(start, self.at)))
            else:
                raise self.wrong(letter, "not a word")

    def wrong(self, word: str, problem: str) -> InvalidInput:
        return InvalidInput(f"{self.where}: '{shortened(word)}': {problem}")

    def rest(self) -> str:
        """What stands from here on up to the next blank."""
        text = self.block.quoted(self.at, len(self.text)).split() if self.at < len(self.text) else []
        return text[0] if text else ""

    def take(self, *texts: str) -> str:
        """Steps over the first of ``texts`` that comes next, if any."""
        for text in texts:
            if self.text.startswith(text, self.at):
                self.at += len(text)
                return text
        return ""

    def order(self) -> Order:
        start = self.text.index("o", self.at)
        self.at = start + 1
        if match := LABEL.match(self.text, self.at):
            self.at = match.end()
            label = label_of(match[0])
            name = lambda _: label  # noqa: E731
        else:
            number = self.value("O")
            label = self.text[start + 1 : self.at]
            name = lambda p: f"{number(p):.0f}"  # noqa: E731
        keyword = self.take(*KEYWORDS)
        values = []
        while self.text[self.at : self.at + 1] == "[":
            values.append(self.bracket())
        if self.at < len(self.text):
            raise self.wrong(shortened(self.block.raw), f"what stands after the O word is not read: '{self.rest()}'")
        return Order(label, name, keyword, values)

    def setting(self) -> tuple[Callable[[Parameters], Key], Evaluator]:
        start = self.at - 1
        name = self.name(write=True)
        if not self.take("="):
            raise self.wrong(self.block.quoted(start, self.at), "a parameter stands alone; '=' is missing")
        return name, self.value(f"{self.block.quoted(start, self.at - 1)} =")

    def name(self, write: bool = False) -> Callable[[Parameters], Key]:
        """What follows a ``#``: a number, or a name in ``<>``."""
        if match := NAME.match(self.text, self.at):
            self.at = match.end()
            named = f"<{match[1]}>"
            return lambda _: named
        index, where = self.value("#"), self.where

        def numbered(parameters: Parameters) -> Key:
            value = index(parameters)
            if not float(value).is_integer():
                raise InvalidInput(f"{where}: '#{value:g}': parameters have whole numbers")
            check(int(value), where, write)
            return int(value)

        return numbered

    def value(self, of: str) -> Evaluator:
        """A number, a parameter, an expression in ``[]`` or a function of one."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise RecursionError
        try:
            sign = self.take("+", "-")
            first = self.text[self.at : self.at + 1]
            value: Evaluator
            if sign and first and first in "+-":
                value = self.value(of)
            elif match := NUMBER.match(self.text, self.at):
                self.at = match.end()
                number = float(match[0])
                if number == float("inf"):
                    raise self.wrong(f"{match[0][:20]}…", "it is too large")
                value = lambda _: number  # noqa: E731
            elif first == "#":
                self.at += 1
                value = self.parameter()
            elif first == "[":
                value = self.bracket()
            elif name := self.take(*FUNCTIONS, "atan", "exists"):
                value = self.function(name)
            else:
                raise self.wrong(of + sign + self.rest(), "a number is expected")
        finally:
            self.depth -= 1
        if sign == "-":
            return lambda p: -value(p)
        return value

    def parameter(self) -> Evaluator:
        name, where = self.name(), self.where
        return lambda p: p.get(name(p), where)

    def bracket(self) -> Evaluator:
        if not self.take("["):
            raise self.wrong(self.rest() or shortened(self.block.raw), "'[' is expected")
        value = self.sum(0)
        if not self.take("]"):
            raise self.wrong(
                self.rest()[:1] or shortened(self.block.raw),
                "an operator (+ - * / ** MOD EQ NE GT GE LT LE AND OR XOR) or ']' is expected",
            )
        return value

    def sum(self, level: int) -> Evaluator:
        """Operators of that precedence and tighter ones."""
        if level == len(LEVELS):
            return self.value("[")
        first = self.sum(level + 1)
        rest: list[tuple[str, Evaluator]] = []
        while word := self.take(*LEVELS[level]):
            rest.append((word, self.sum(level + 1)))
        return chained(first, LEVELS[level], rest, self.where) if rest else first

    def function(self, name: str) -> Evaluator:
        if name == "exists":
            return self.exists()
        if name != "atan":
            return computed(name.upper(), FUNCTIONS[name], self.where, self.bracket())
        over = self.bracket()
        if not self.take("/"):
            raise self.wrong("ATAN", "it reads ATAN[y]/[x]")
        return computed("ATAN", angle, self.where, over, self.bracket())

    def exists(self) -> Evaluator:
        name = self.name() if self.take("[#") else None
        if name is None or not self.take("]"):
            raise self.wrong("EXISTS", "it reads EXISTS[#<name>]")
        return lambda p: float(p.exists(name(p)))
