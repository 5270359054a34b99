"""What a user should know about how a drawing was cleaned and joined, a sentence each."""

from collections.abc import Iterable, Iterator, Sequence

from .cleaning import Cleaned
from .collected import TOLD, some
from .crossings import Meeting, Meetings
from .curve import Points, lengths
from .joining import GAP, Gap, Joints

LARGE = 0.1 * GAP
"""mm, a gap beyond what the rounding of a file's numbers leaves."""


def of(cleaned: Iterable[Cleaned], joints: Joints, meetings: Meetings, engraved: Sequence[Points]) -> list[str]:
    """Sentences on what was there twice, what was joined and stays open, what crosses, and what is to be engraved."""
    return [*_cleaned(cleaned), *_joined(joints), *_crossing(meetings), *_engraved(engraved)]


def _cleaned(cleaned: Iterable[Cleaned]) -> Iterator[str]:
    for step in cleaned:
        if step.overlapping:
            yield f"{_many(step.overlapping, 'line lies', 'lines lie')} on others: cut once, {step.length:.3f} mm less"
        if step.curves:
            what = _many(step.curves, "curve lies wholly on another", "curves lie wholly on others")
            yield f"{what}: cut once, {step.length:.3f} mm less"
        if step.doubled:
            yield f"{_many(step.doubled, 'closed contour is', 'closed contours are')} there twice: cut once"
        if step.flat:
            yield f"{_many(step.flat, 'closed contour encloses', 'closed contours enclose')} nothing: cut as open"


def _crossing(meetings: Meetings) -> Iterator[str]:
    """Contours have their numbers as they were read, which are those of ``meetings``."""
    found = meetings.found
    own = "crosses or touches itself at {}: what it goes around an even number of times is taken as outside"
    yield from first_of(
        [f"contour {m.first + 1} {own.format(_at(m))}" for m in found if m.first == m.second], "contour"
    )
    pairs = [(m, f"contours {m.first + 1} and {m.second + 1}") for m in found if m.first != m.second]
    crossing = [f"{both} cross at {_at(m)}: each cuts into the other" for m, both in pairs if not m.along]
    yield from first_of(crossing, "pair")
    on = "lie on one another over {:.1f} mm, at {}: cut for each of them"
    yield from first_of([f"{both} {on.format(m.along, _at(m))}" for m, both in pairs if m.along], "pair")
    if meetings.cut_short:
        yield "too many contours meet to look at all: there may be more that cross or lie on one another"


def first_of(lines: list[str], what: str) -> list[str]:
    """The first sentences, and how many more there are."""
    rest = len(lines) - TOLD
    return lines if rest <= 0 else [*lines[:TOLD], f"the same is true of {rest} more {what}{'s' if rest > 1 else ''}"]


def _at(meeting: Meeting) -> str:
    return f"x = {meeting.x:.2f}, y = {meeting.y:.2f} mm"


def _joined(joints: Joints) -> Iterator[str]:
    wide = [gap for gap in reversed(joints.bridged) if gap[2] > LARGE]
    if wide:
        yield f"{_many(len(wide), 'gap', 'gaps')} of up to {wide[0][2]:.3f} mm joined: {_places(wide)}"
    if joints.apart:
        gaps = f"{_many(len(joints.apart), 'gap stays', 'gaps stay')} open: {_places(joints.apart)}"
        yield f"{gaps}; --join {joints.apart[0][2] + 5e-4:.3f} would join the narrowest"
    if joints.specks:
        yield f"{_many(joints.specks, 'curve is', 'curves are')} shorter than {GAP:g} mm and left out"


def _many(count: int, one: str, several: str) -> str:
    return f"{count} {one if count == 1 else several}"


def _places(gaps: Sequence[Gap]) -> str:
    """«0.043 mm at (10.000, 5.000)», several."""
    return some(f"{gap:.3f} mm at ({x:.3f}, {y:.3f})" for x, y, gap in gaps)


def _engraved(pieces: Sequence[Points]) -> Iterator[str]:
    if pieces:
        length = sum(float(lengths(piece).sum()) for piece in pieces)
        what = _many(len(pieces), "contour", "contours")
        yield f"{what}, {length:.1f} mm, to be engraved: this machine only cuts, so kept out of the job"
