"""What is said of a file of a corpus."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ....envs.engine.quantity import InvalidInput
from ....envs.paths.drawing import Drawing

ACCEPTED, REFUSED, NOTHING, FAILED = "accepted", "refused", "nothing to cut", "failed"

OUTCOMES = (ACCEPTED, REFUSED, NOTHING, FAILED)
"""``refused``: a clear error; ``failed``: anything else, such as a traceback, too much time or too much memory."""


@dataclass(frozen=True)
class Verdict:
    """What became of a file.

    ``kind``: dxf, svg or gcode; ``outcome``: one of :data:`OUTCOMES`; ``reason``: why it was not accepted;
    ``length_mm`` and ``box`` (width, height, mm) of what is cut; ``seconds``: to read it. ``reference``: the other
    reading it was compared with, or why with none; ``deviation_mm``: the largest distance from that one's path.
    ``counted``: whether the file is one of those that should be accepted.
    """

    path: Path
    kind: str
    outcome: str
    reason: str = ""
    length_mm: float | None = None
    box: tuple[float, float] | None = None
    seconds: float = 0.0
    reference: str | None = None
    deviation_mm: float | None = None
    counted: bool = True

    def __post_init__(self) -> None:
        if self.outcome not in OUTCOMES:
            raise ValueError(f"outcome = '{self.outcome}'; allowed: {', '.join(OUTCOMES)}")


def seen(path: Path, kind: str, read: Callable[[Path], Drawing]) -> tuple[Drawing | None, Verdict]:
    """What a reader makes of a file, and the verdict as far as it goes without another reading."""
    began = time.perf_counter()
    try:
        drawing = read(path)
    except InvalidInput as error:
        seconds, reason = time.perf_counter() - began, str(error).removeprefix(str(path)).lstrip(",: ")
        outcome = NOTHING if "nothing to cut" in reason else REFUSED
        return None, Verdict(path, kind, outcome, reason, seconds=seconds, counted=outcome == REFUSED)
    seconds, (low, high) = time.perf_counter() - began, drawing.bounds
    size = (float(high[0] - low[0]), float(high[1] - low[1]))
    return drawing, Verdict(path, kind, ACCEPTED, length_mm=drawing.cut_length, box=size, seconds=seconds)
