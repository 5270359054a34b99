"""What is said of a file of a corpus."""

from dataclasses import dataclass
from pathlib import Path

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
