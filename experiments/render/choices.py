"""How the commands read the drawing of ``--path``, and what they say about it."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import UseAppendAction, arg

from ..store import typed

if TYPE_CHECKING:
    from ...envs.scenarios import Reading


@dataclass(frozen=True)
class Options:
    """How the drawing of --path is read.

    Rules for layers and colours: NAME,NAME or cut=NAME,NAME cuts these and nothing else; engrave=… and ignore=… leave
    the rest as it is. Names may hold * and ?. This machine only cuts: what is engraved is counted and kept out.
    """

    units: Annotated[str | None, arg(metavar="UNIT", help_behavior_hint="")] = None
    """mm, cm, m, inches, feet, mils and others, instead of what the drawing says."""

    layers: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="RULE")] = ()
    """what becomes of which layer, such as OUTLINE,HOLES or ignore=DIM*; may be given several times. Default: all that
    are shown and plotted are cut."""

    colours: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="RULE")] = ()
    """the same by colour, such as cut=red or engrave=5: of a DXF 1 to 255, a name or #rrggbb, of an SVG the stroke."""

    join: Annotated[float | None, arg(metavar="MM", help_behavior_hint="")] = None
    """largest gap between two ends that are joined. Default: 0.05."""

    text: bool = False
    """cut letters as outlines."""

    hatches: bool = False
    """cut the filled areas of a DXF as outlines."""

    def reading(self) -> "Reading":
        """The same as scenarios have it.

        Raises:
            InvalidInput: a gap that is out of range.
        """
        from ...envs.scenarios import Reading

        return Reading(**{name: value for name, value in vars(self).items() if value not in (None, ())})


def tell(path: Path, reading: "Reading") -> None:
    """Says what is in a drawing, and how it was read otherwise than a user may expect."""
    from ...envs.scenarios import read_drawing

    drawing = read_drawing(str(path), reading)
    for line in (drawing.summary, *drawing.notes):
        typed.say(f"{path}: {line}")
