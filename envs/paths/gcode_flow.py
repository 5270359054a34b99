"""The course of a G-code programme: its lines in the order in which they are run, with O words, M98 and M99.

Subroutines that the file does not hold are looked for beside it, as ``name.ngc`` in the same folder and nowhere else.
"""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from ..engine.quantity import InvalidInput
from .gcode_labels import Labels
from .gcode_parameters import Key, Parameters
from .gcode_words import Block, Word, shortened, without_comments

MOST_LINES = 200_000
"""Lines that may be run again, in loops and subroutines; a programme without end stops there."""

DEEPEST = 30
"""Subroutines within each other."""

LARGEST = 200_000_000
"""Bytes of a file."""

BESIDE = re.compile(r"[\w-]{1,80}", re.ASCII)
"""Names of subroutines that may be files."""


class Line(NamedTuple):
    """A line that says something; ``number`` counts from 1, ``where`` is «file, line 3», ``depth`` counts the
    subroutines around it."""

    number: int
    words: list[Word]
    where: str
    depth: int


@dataclass
class _File:
    """A file of the programme; blocks are read when they are first run."""

    path: Path
    lines: list[str]
    labels: Labels
    blocks: dict[int, Block] = field(default_factory=dict)


@dataclass
class _Call:
    """Where to go on after a subroutine; ``counts``: what is left of the repeats of the caller."""

    file: _File
    at: int
    counts: dict[int, int]
    again: int  # times that an M98 has still to be done
    target: int
    fanuc: bool


class Programme:
    """The lines of a programme, in the order in which they are run.

    ``told`` is what the machine knows of itself when a parameter is read.
    """

    def __init__(self, file: Path, told: Callable[[Key], float | None]) -> None:
        self.parameters = Parameters(told)
        self.main = _read(file)
        self.files = {file.stem.lower(): self.main}
        self.file, self.at = self.main, 0
        self.calls: list[_Call] = []
        self.counts: dict[int, int] = {}
        self.ran = 0
        self.budget = MOST_LINES + len(self.main.lines)
        self.value, self.returned = 0.0, False

    @property
    def where(self) -> str:
        """«file, line 3», for messages."""
        return f"{self.file.path}, line {self.at + 1}"

    def __iter__(self) -> Iterator[Line]:
        while self.at < len(self.file.lines):
            self.ran += 1
            if self.ran > self.budget:
                raise InvalidInput(
                    f"{self.where}: the programme does not end: {MOST_LINES} lines were run again in loops and "
                    "subroutines; allowed: that many"
                )
            block = self._block()
            if block.order is not None:
                self._order(block)
                continue
            words = block.evaluated(self.parameters)
            self.at += 1
            if words:
                yield Line(self.at, words, f"{self.file.path}, line {self.at}", len(self.calls))
            if self.at >= len(self.file.lines) and self.calls:
                raise self._wrong(self.file.lines[self.at - 1].strip(), "the file ends within a subroutine", -1)

    def _block(self) -> Block:
        """The line that comes next, which is read when it is first run."""
        blocks = self.file.blocks
        if self.at not in blocks:
            blocks[self.at] = Block(self.file.lines[self.at], self.where, self.at + 1)
        return blocks[self.at]

    # O words

    def _wrong(self, word: str, problem: str, ahead: int = 0) -> InvalidInput:
        return InvalidInput(f"{self.file.path}, line {self.at + 1 + ahead}: '{shortened(word)}': {problem}")

    def _order(self, block: Block) -> None:
        order, labels = block.order, self.file.labels
        assert order is not None
        if self.at in labels.problems:
            raise self._wrong(block.raw, labels.problems[self.at])
        place = labels.places.get(self.at)
        if order.keyword == "" or place is None:
            self.at += 1
            return
        match place.keyword:
            case "call":
                self._call(block, order.name(self.parameters), [v(self.parameters) for v in order.values])
            case "sub":
                self.at = place.end + 1
            case "end sub" | "return":
                self._return(block, order.values)
            case "if":
                self._branch(block)
            case "repeat":
                count = self._number(block)
                self.counts[self.at] = math.floor(count + 0.5)
                self.at = self.at + 1 if self.counts[self.at] > 0 else place.end + 1
            case "end repeat":
                self.counts[place.start] = self.counts.get(place.start, 0) - 1
                self.at = (place.start if self.counts[place.start] > 0 else self.at) + 1
            case "while":
                self.at = self.at + 1 if self._number(block) else place.end + 1
            case "end while":
                self.at = place.start
            case "end do":
                self.at = place.start + 1 if self._number(block) else self.at + 1
            case "break":
                self.at = place.end + 1
            case "continue":
                self.at = place.start if labels.places[place.start].keyword == "while" else place.end
            case _:  # do, endif
                self.at += 1

    def _number(self, block: Block) -> float:
        """The number in the brackets of an O word."""
        assert block.order is not None
        if len(block.order.values) != 1:
            raise self._wrong(block.raw, "one number in brackets is expected")
        value = block.order.values[0](self.parameters)
        if math.isnan(value):
            raise self._wrong(block.raw, "its value is known to the machine only")
        return value

    def _branch(self, block: Block) -> None:
        """An ``if``, or one of the branches behind the one that was run."""
        order = block.order
        assert order is not None
        place = self.file.labels.places[self.at]
        if order.keyword != "if":
            self.at = place.end + 1
            return
        while not self._number(block):
            self.at = self.file.labels.places[self.at].next
            if self.at == place.end:
                break
            block = self._block()
            if block.order is None or block.order.keyword == "else":
                break
        self.at += 1

    # Subroutines

    def _call(self, block: Block, name: str, values: list[float]) -> None:
        file, start = self._sub(block, name)
        self._enter(block.raw, file, start, 1, fanuc=False)
        self.parameters.enter(values)
        self.value, self.returned = 0.0, False

    def _enter(self, word: str, file: _File, start: int, times: int, fanuc: bool) -> None:
        if len(self.calls) >= DEEPEST:
            raise self._wrong(word, f"more than {DEEPEST} subroutines within each other")
        self.calls.append(_Call(self.file, self.at + 1, self.counts, times - 1, start + 1, fanuc))
        self.file, self.at, self.counts = file, start + 1, {}

    def _sub(self, block: Block, name: str) -> tuple[_File, int]:
        """The subroutine of that name: in this file, in one that was read before, or beside the programme."""
        for file in (self.file, *self.files.values()):
            if name in file.labels.subs:
                return file, file.labels.subs[name]
        beside = self.main.path.parent / f"{name}.ngc"
        if not BESIDE.fullmatch(name):
            raise self._wrong(block.raw, f"this file has no subroutine '{name}'")
        if beside.is_symlink() or not beside.is_file():
            raise self._wrong(block.raw, f"neither this file nor its folder has it (looked for {beside.name} there)")
        file = self.files[name] = _read(beside)
        self.budget += len(file.lines)
        if name not in file.labels.subs:
            raise self._wrong(block.raw, f"{beside.name} has no o<{name}> sub")
        return file, file.labels.subs[name]

    def _return(self, block: Block, values: list) -> None:
        if not self.calls or self.calls[-1].fanuc:
            raise self._wrong(block.raw, "no call led into this subroutine")
        if values:
            self.value, self.returned = values[0](self.parameters), True
        self.parameters.leave()
        self._back()

    def _back(self) -> None:
        call = self.calls[-1]
        if call.again > 0:
            call.again -= 1
            self.at, self.counts = call.target, {}
            return
        self.calls.pop()
        self.file, self.at, self.counts = call.file, call.at, call.counts

    def call_number(self, number: float, times: float) -> None:
        """M98: the subprogramme behind a bare O number, so many times.

        Raises:
            InvalidInput: there is none.
        """
        label = f"{number:.0f}"
        self.at -= 1
        start = self.file.labels.bare.get(label)
        if start is None:
            raise self._wrong("M98", f"this file has no line O{label} (with nothing else in it)")
        if times < 1:
            self.at += 1
            return
        self._enter("M98", self.file, start, int(times), fanuc=True)

    def back_to_caller(self) -> bool:
        """M99: back behind the M98; whether there was one."""
        if not self.calls or not self.calls[-1].fanuc:
            return False
        self._back()
        return True


def _read(file: Path) -> _File:
    size = file.stat().st_size
    if size > LARGEST:
        raise InvalidInput(f"{file}: {size / 1e6:.0f} MB; allowed: {LARGEST / 1e6:.0f} MB")
    raw = file.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    lines = re.split(r"\r\n|\r|\n", text)
    marks = [i for i, line in enumerate(lines) if "%" in line and _percent(line)]
    if len(marks) > 1:
        lines = lines[: marks[1]]
    for i in marks[:2]:
        if i < len(lines):
            lines[i] = ""
    return _File(file, lines, Labels(lines))


def _percent(line: str) -> bool:
    try:
        return without_comments(line, "").strip() == "%"
    except InvalidInput:
        return False
