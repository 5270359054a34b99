"""Words of a G-code programme: lines, comments, numbers, parameters and expressions of RS274/NGC.

The package index has no reader that could be used: gcodeparser takes what stands in (comments) for commands, drops
lines without a G and makes True of an expression; pygcode, from 2017, knows neither ``#<name>`` nor ``$0``; both would
have to be watched more closely than these lines.
"""

import math
import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

from ..plant.quantity import InvalidInput

NUMBER = re.compile(r"\d+\.?\d*|\.\d+")
PARAMETER = re.compile(r"#\s*<\s*([^<>]*?)\s*>")
OPERATORS: tuple[dict[str, Callable[[float, float], float]], ...] = (
    {"+": lambda a, b: a + b, "-": lambda a, b: a - b},
    {"*": lambda a, b: a * b, "/": lambda a, b: a / b, "MOD": lambda a, b: a % b},
    {"**": lambda a, b: a**b},
)
"""From the loosest to the tightest; each from left to right."""
FUNCTIONS: dict[str, Callable[[float], float]] = {
    "ABS": abs, "SQRT": math.sqrt, "EXP": math.exp, "LN": math.log, "ROUND": round, "FIX": math.floor, "FUP": math.ceil,
    "SIN": lambda a: math.sin(math.radians(a)), "ASIN": lambda a: math.degrees(math.asin(a)),
    "COS": lambda a: math.cos(math.radians(a)), "ACOS": lambda a: math.degrees(math.acos(a)),
    "TAN": lambda a: math.tan(math.radians(a)),
}  # fmt: skip


class Word(NamedTuple):
    """A letter and its value; nan where the value is known to the machine only. ``text``: as it stands in the file."""

    letter: str
    value: float
    text: str


class Line(NamedTuple):
    """A line that says something; ``number`` counts from 1."""

    number: int
    words: list[Word]


class Programme:
    """The lines of a programme, read in order, with the values of their parameters at that time.

    Parameters may be set to expressions (``#1 = [#2 * 0.5]``, ``#<width> = 30``); ``#<_name>``, which is the machine's
    own, is nan. Loops, conditions and subroutines (O words) are refused.
    """

    def __init__(self, file: object, text: str) -> None:
        self.file = file
        self.text = text
        self.parameters: dict[str, float] = {}
        self.set_in: dict[str, int] = {}
        self.read: set[str] = set()

    def __iter__(self) -> Iterator[Line]:
        percents = 0
        for number, raw in enumerate(re.split(r"\r\n|\r|\n", self.text), start=1):
            text = _without_comments(raw, self.where(number))
            if text.strip() == "%":
                percents += 1
                if percents == 2:
                    return
            elif text.strip():
                try:
                    words = _Reader(text, self, number).words()
                except RecursionError:
                    raise InvalidInput(f"{self.where(number)}: brackets are nested too deep") from None
                if words:
                    yield Line(number, words)

    def where(self, number: int) -> str:
        """«file, line 3», for messages."""
        return f"{self.file}, line {number}"

    def unused(self) -> list[str]:
        """Warnings on parameters that mean something to another reader only."""
        return [
            f"line {line}: #{name} is set and not read by this programme"
            for name, line in self.set_in.items()
            if name not in self.read
        ]


def _without_comments(line: str, where: str) -> str:
    """The line with blanks in place of ``(…)`` and without what follows ``;``."""
    kept, rest = "", line
    while match := re.search(r"[(;)]", rest):
        kept, mark, rest = kept + rest[: match.start()], match[0], rest[match.end() :]
        if mark == ";":
            return kept
        if mark == ")" or ")" not in rest:
            raise InvalidInput(f"{where}: '{line.strip()}': a comment has only one of its brackets")
        kept, rest = kept + " ", rest.partition(")")[2]
    return kept + rest


class _Reader:
    """One line, from left to right."""

    def __init__(self, text: str, programme: Programme, number: int) -> None:
        self.text, self.programme, self.number, self.at = text.upper(), programme, number, 0
        self.original = text

    def words(self) -> list[Word]:
        """The words; parameters that the line sets have their new values from the next line on."""
        first = self.text.strip()[:1]
        if first == "O":
            raise self.wrong(self.original.strip(), "O words (loops, conditions, subroutines) are not read")
        if first == "/":
            raise self.wrong("/", "lines that a switch of the machine skips are not read")
        found: list[Word] = []
        settings: list[tuple[str, float]] = []
        while letter := self.next():
            start = self.at
            if letter == "#":
                settings.append(self.setting())
                continue
            if not (letter.isascii() and letter.isalpha()) and letter != "$":
                raise self.wrong(letter, "not a word")
            self.at += 1
            value = self.value(letter)
            found.append(Word(letter, value, self.original[start : self.at].strip()))
        for name, value in settings:
            self.programme.parameters[name] = value
            self.programme.set_in.setdefault(name, self.number)
        return found

    def wrong(self, word: str, problem: str) -> InvalidInput:
        return InvalidInput(f"{self.programme.where(self.number)}: '{word}': {problem}")

    def next(self) -> str:
        """The next character that is not a blank; empty at the end."""
        while self.at < len(self.text) and self.text[self.at].isspace():
            self.at += 1
        return self.text[self.at : self.at + 1]

    def take(self, *texts: str) -> str:
        """Steps over the first of ``texts`` that comes next, if any."""
        self.next()
        for text in texts:
            if self.text.startswith(text, self.at):
                self.at += len(text)
                return text
        return ""

    def setting(self) -> tuple[str, float]:
        name = self.name()
        if not self.take("="):
            raise self.wrong(f"#{name}", "a parameter stands alone; '=' is missing")
        return name, self.value(f"#{name} =")

    def name(self) -> str:
        """What follows a ``#``: a number, or a name in ``<>``."""
        self.next()
        if match := PARAMETER.match(self.text, self.at):
            self.at = match.end()
            return f"<{''.join(match[1].lower().split())}>"
        self.take("#")
        index = self.value("#")
        if not index.is_integer():
            raise self.wrong(f"#{index:g}", "parameters have whole numbers")
        return str(int(index))

    def value(self, of: str) -> float:
        """A number, a parameter, an expression in ``[]`` or a function of one."""
        sign = self.take("+", "-")
        first = self.next()
        if sign and first and first in "+-":
            return (-1.0 if sign == "-" else 1.0) * self.value(of)
        if match := NUMBER.match(self.text, self.at):
            self.at = match.end()
            value = float(match[0])
        elif first == "#":
            value = self.parameter()
        elif first == "[":
            value = self.bracket()
        elif first.isalpha() and (name := self.take(*FUNCTIONS, "ATAN")):
            value = self.function(name)
        else:
            rest = self.original[self.at :].split()
            raise self.wrong(of + sign + (rest[0] if rest else ""), "a number is expected")
        return -value if sign == "-" else value

    def parameter(self) -> float:
        name = self.name()
        self.programme.read.add(name)
        if name in self.programme.parameters:
            return self.programme.parameters[name]
        if name.startswith("<_"):
            return math.nan
        raise self.wrong(f"#{name}", "a parameter that has no value yet")

    def bracket(self) -> float:
        if not self.take("["):
            raise self.wrong(self.next() or self.original.strip(), "'[' is expected")
        value = self.sum(0)
        if not self.take("]"):
            raise self.wrong(self.next() or self.original.strip(), "an operator (+ - * / ** MOD) or ']' is expected")
        return value

    def sum(self, level: int) -> float:
        """Operators of that precedence and tighter ones."""
        if level == len(OPERATORS):
            return self.value("[")
        value = self.sum(level + 1)
        while operator := self.take(*OPERATORS[level]):
            value = self.computed(operator, OPERATORS[level][operator], value, self.sum(level + 1))
        return value

    def function(self, name: str) -> float:
        if name != "ATAN":
            return self.computed(name, FUNCTIONS[name], self.bracket())
        over = self.bracket()
        if not self.take("/"):
            raise self.wrong("ATAN", "it reads ATAN[y]/[x]")
        return self.computed(name, lambda y, x: math.degrees(math.atan2(y, x)), over, self.bracket())

    def computed(self, name: str, function: Callable[..., float], *values: float) -> float:
        if any(map(math.isnan, values)):
            return math.nan
        try:
            value = float(function(*values))
        except (ArithmeticError, ValueError, TypeError):  # TypeError: a complex power
            value = math.inf
        if not math.isfinite(value):
            raise self.wrong(name, f"cannot be computed of {' and '.join(f'{v:g}' for v in values)}")
        return value
