"""The state that a programme leads through: what its words have set, and what is to be told of it."""

from collections import Counter, defaultdict
from pathlib import Path

from ..engine.quantity import InvalidInput
from .gcode_beam import Beam
from .gcode_flow import Line, Programme
from .gcode_frames import Frames
from .gcode_modes import Modes
from .gcode_parameters import Key
from .gcode_words import Word, shortened


class State:
    """What all words of a programme share; ``units``: mm or inches until the programme says."""

    def __init__(self, file: Path, units: str | None) -> None:
        self.modes = Modes(units=units or "mm")
        self.told = units is not None
        self.programme = Programme(file, self.known)
        self.frames = Frames(self.programme.parameters)
        self.beam = Beam()
        self.listed: defaultdict[str, list[int]] = defaultdict(list)
        self.skipped: Counter[str] = Counter()
        self.used: dict[str, None] = {}
        self.feed_word: tuple[Line, Word] | None = None

    def known(self, key: Key) -> float | None:
        """What the machine tells of itself when a parameter is read."""
        run = self.programme
        own = {
            "<_value>": run.value,
            "<_value_returned>": float(run.returned),
            "<_call_level>": float(len(run.calls)),
            "<_line>": float(run.at + 1),
        }
        return own[key] if isinstance(key, str) and key in own else self.modes.told(key, self.frames)

    def wrong(self, line: Line, word: Word | str, problem: str) -> InvalidInput:
        """An error about a word of a line."""
        text = word if isinstance(word, str) else word.text
        return InvalidInput(f"{line.where}: '{shortened(text)}': {problem}")

    def note(self, line: Line, text: str) -> None:
        """Lists a line under a warning."""
        lines = self.listed[text]
        if line.number not in lines[-1:]:
            lines.append(line.number)

    def axes(self, values: dict[str, Word]) -> dict[str, float]:
        """X, Y and Z as far as they are given, mm."""
        return {axis: self.mm(values, axis) for axis in "XYZ" if axis in values}

    def mm(self, values: dict[str, Word], letter: str) -> float:
        """The value of a length."""
        value = values[letter].value * self.modes.size
        return 0.5 * value if letter == "X" and self.modes.diameter else value
