"""O words of a G-code file: which lines belong together.

A file is looked through once, before it is run, for the lines that begin with an O word. What does not fit is an error
only where the programme comes by: behind its end anything may stand.
"""

import re
from typing import NamedTuple

LABELLED = re.compile(r"/?(?:n[\d.]+)?o(<[^<>]*>|\d+|[#\[][^a-z]*(?:<[^<>]*>[^a-z]*)*)([a-z]*)")
OPENING = {"sub": "endsub", "if": "endif", "while": "endwhile", "repeat": "endrepeat", "do": "while"}
LOOPS = ("while", "repeat", "do")


class Place(NamedTuple):
    """What a line with an O word leads to; line indices count from 0.

    ``end``: the line that ends what the line opens or belongs to, or the ``endif`` of a branch; ``start``: the line
    that opened it; ``next``: for ``if`` and ``elseif`` the next branch.
    """

    keyword: str
    start: int
    end: int
    next: int


class Labels:
    """The structure of a file: ``places`` by line, subroutines and bare numbers by name, problems by line."""

    def __init__(self, lines: list[str]) -> None:
        self.places: dict[int, Place] = {}
        self.subs: dict[str, int] = {}
        self.bare: dict[str, int] = {}
        self.problems: dict[int, str] = {}
        self._open: list[tuple[str, str, list[int]]] = []  # keyword, label, lines: branches of an if, else one
        self._waiting: list[tuple[int, str, int]] = []  # break and continue: line, keyword, start of its loop
        for i, line in enumerate(lines):
            if "o" in line or "O" in line:
                compact = "".join(_bare(line).split()).lower()
                if match := LABELLED.match(compact):
                    self._line(i, label_of(match[1]), match[2], compact[match.end() :])
        for keyword, label, starts in self._open:
            if keyword != "if":
                self.problems[starts[0]] = f"o<{label}> {keyword} has no {OPENING[keyword]}"
            else:
                for start in starts:
                    self.problems[start] = f"o<{label}> if has no endif"
        for at, word, begin in self._waiting:
            if begin in self.places:
                self.places[at] = Place(word, begin, self.places[begin].end, -1)

    def _line(self, i: int, label: str, keyword: str, rest: str) -> None:
        within = self._open[-1] if self._open else None
        closing = (OPENING[within[0]], within[1]) if within else None
        match keyword:
            case "":
                if not rest:
                    self.bare.setdefault(label, i)
            case "while" if within and within[:2] == ("do", label):
                self._close(i)
            case "sub" if any(k == "sub" for k, *_ in self._open):
                self.problems[i] = "a subroutine within another, or one without its endsub before"
            case "sub" if label in self.subs:
                self.problems[i] = f"the subroutine has been defined before, in line {self.subs[label] + 1}"
            case "sub" | "if" | "while" | "repeat" | "do":
                if keyword == "sub":
                    self.subs[label] = i
                self._open.append((keyword, label, [i]))
            case "elseif" | "else" if within and within[:2] == ("if", label):
                within[2].append(i)
            case "endsub" | "endif" | "endwhile" | "endrepeat" if closing == (keyword, label):
                self._close(i)
            case "break" | "continue":
                loops = [starts[0] for k, name, starts in self._open if k in LOOPS and name == label]
                if loops:
                    self._waiting.append((i, keyword, loops[-1]))
                else:
                    self.problems[i] = "it stands in no loop of this name"
            case "return":
                subs = [starts[0] for k, name, starts in self._open if k == "sub"]
                if subs:
                    self.places[i] = Place(keyword, subs[-1], -1, -1)
                else:
                    self.problems[i] = "it stands in no subroutine"
            case "call":
                self.places[i] = Place(keyword, i, i, -1)
            case "elseif" | "else" | "endsub" | "endif" | "endwhile" | "endrepeat":
                opened = (
                    f"o<{within[1]}> {within[0]} of line {within[2][0] + 1} is open" if within else "nothing is open"
                )
                self.problems[i] = f"it does not belong here: {opened}"
            case _:
                self.problems[i] = (
                    f"'{keyword}' is not read after an O word; read are sub, endsub, return, call, if, elseif, else, "
                    "endif, while, endwhile, do, break, continue, repeat, endrepeat"
                )

    def _close(self, i: int) -> None:
        opened, _, lines = self._open.pop()
        for line, following in zip(lines, [*lines[1:], i], strict=True):
            self.places[line] = Place(opened, lines[0], i, following)
        self.places[i] = Place(f"end {opened}", lines[0], i, -1)


def label_of(name: str) -> str:
    """What an O word's name, ``<name>``, a number or an expression, is compared by."""
    return name[1:-1] if name[0] == "<" else name.lstrip("0") or "0" if name.isdigit() else name


def _bare(line: str) -> str:
    """The line without comments, as far as they are whole."""
    return re.sub(r"\([^)]*\)?|;.*", " ", line)
