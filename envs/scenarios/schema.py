"""The scenario: all its tables together, what excludes what, and how it is varied."""

# ruff: noqa: RUF009  (sections and distributions that are defaults are frozen)

import functools
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from ..engine.quantity import InvalidInput, Quantity
from ..plant import sheet
from ..plant.controller import PERIOD
from ..plant.path import Contour
from ..safety import names
from . import dead, writing
from .distributions import Choice, Number, bounds, check_joint
from .hardware import Axis, Gantry, Head, Optics
from .section import Section, line_of, of_table
from .surface import Sheet
from .travel import Circle, Corners, Job, Reading, Turns, contour, laps
from .writing import STANDARD_MACHINE

SETTLED = 0.25
"""Most of a journey along a drawing that is left out of the score, for the machine to settle."""


DURATION = Quantity("s", 0.05, 600, "of an episode")

SHEET = (4000.0, 2000.0)
"""mm, the sheet that axes reach over when a user's drawing is cut [A]: the largest usual format."""


@dataclass(frozen=True, kw_only=True)
class Scenario(Section):
    """A frozen scenario; see the package's text."""

    name: str  # in tables and plots
    summary: str = ""  # what happens, in a line
    version: int = 2  # of the suite that it belongs to
    duration: Annotated[float, DURATION] = 3.0
    settle: Annotated[float, Quantity("s", 0, 60, "at the start, not scored")] = 0.3
    share: Annotated[
        float, Quantity("1", 0.01, 1, "of a run's seeds that it is run on, because an episode is long")
    ] = 1.0
    feed: Annotated[Number, Quantity("mm/s", 0, 2000, "along the path")] = 200.0
    set_height: Annotated[Number, Quantity("mm", 0.05, 9, "")] = Choice(choice=(0.5, 0.8, 1.0))
    start_above: Annotated[Number, Quantity("mm", 0, 30, "head above the set height at the start")] = 0.0
    guard: bool = False  # the supervisor's hole and edge guard is on
    exempt: bool = False  # built to defeat followers: collisions are expected and not counted
    path: str | None = None  # a drawing (DXF, SVG, G-code) along whose contours the nozzle travels
    drawing: Reading = Reading()
    circle: Circle | None = None
    corners: Corners | None = None
    turns: Turns | None = None
    cut_by: str = STANDARD_MACHINE  # name of the machine that it was put on; what counts are the tables below
    axis: Axis = Axis()
    head: Head = Head()
    sheet: Sheet = Sheet()
    job: Job | None = None
    gantry: Gantry = Gantry()
    optics: Optics = Optics()

    def __post_init__(self) -> None:
        super().__post_init__()
        given = (field.name for field in fields(self) if getattr(self, field.name) != field.default)
        dead.refuse(given, self.job)
        check_joint(self, self.head, self.axis, self.gantry, self.optics)
        names.checked(self.cut_by, "cut_by")
        names.checked(self.name, "name")  # a run keeps the scenario in a file of this name
        if self.path and self.circle:
            raise ValueError("path and circle exclude each other in one scenario")
        if self.corners and (self.path or self.circle or self.job):
            raise ValueError("corners are for straight paths; path, circle and job exclude them")
        steps, least = self.sheet.steps, sheet.LATEST + self.head.plate
        if steps and bounds(steps.spacing)[0] < least:
            plate, close = self.head.plate, bounds(steps.spacing)[0]
            raise ValueError(f"steps lie {close:g} mm apart; with a plate of {plate:g} mm at least {least:g}")
        if self.job and self.circle:
            raise ValueError("job and circle exclude each other in one scenario")

    @functools.cached_property
    def labels(self) -> dict[str, int]:
        """Names of its random numbers, as they have become known (:class:`Draws`)."""
        return {}

    @property
    def steps(self) -> int:
        """Control periods of an episode."""
        return round(self.duration / PERIOD)

    @property
    def settle_steps(self) -> int:
        """Control periods at the start that are not scored."""
        return round(self.settle / PERIOD)

    def some(self, seeds: Any) -> Any:
        """The first ``share`` of the seeds (a sequence or array), at least one."""
        return seeds[: max(1, round(self.share * len(seeds)))]

    def along(self, drawing: str | Path, reading: Reading | None = None) -> "Scenario":
        """The scenario along the contours of a DXF, SVG or G-code file, once through at the (slowest) feed; with a job,
        the job that cuts them, on axes that reach over a sheet of 4 × 2 m at least.

        Args:
            drawing: the file.
            reading: how it is read; None: as the scenario says.

        Raises:
            InvalidInput: the drawing cannot be read, or the feed may be 0.
        """
        how, file = reading or self.drawing, str(drawing)
        name, told = f"{self.name}@{names.of_file(Path(drawing).stem)}", asdict(how)
        if self.job:
            travel = {
                f"travel_{a}": max(getattr(self.gantry, f"travel_{a}"), s) for a, s in zip("xy", SHEET, strict=True)
            }
            return self.varied(name=name, job={"part": file, "size": 0.0}, drawing=told, gantry=travel)
        slowest = bounds(self.feed)[0]
        if slowest <= 0:
            raise InvalidInput(f"scenario '{self.name}': a path needs a feed above 0 mm/s")
        length = contour(file, how).length
        duration = round(length / slowest, 3)
        if not DURATION.low <= duration <= DURATION.high:
            raise InvalidInput(
                f"scenario '{self.name}': {drawing} takes {duration:g} s at {slowest:g} mm/s; allowed: "
                f"{DURATION.range}; a {'slower' if duration < DURATION.low else 'faster'} feed, or a suite of jobs, "
                "such as contour"
            )
        return self.varied(
            path=file,
            drawing=told,
            circle=None,
            duration=duration,
            settle=min(self.settle, round(SETTLED * duration, 3)),  # of a small drawing something must be scored
            name=name,
        )

    def to_toml(self) -> str:
        """The scenario as TOML that :func:`parse` reads back to an equal scenario."""
        return writing.text_of(self)

    def varied(self, **changes: Any) -> "Scenario":
        """A copy with some fields changed, validated anew: ``varied(feed=400, head={"noise": 0.01})`` merges tables.

        Raises:
            InvalidInput: what is wrong and what is allowed; a key that changes nothing in such a scenario, and why.
        """
        may_die, usual = dead.IN_JOBS | dead.IN_FOLLOWERS, {field.name: field.default for field in fields(self)}
        said = {k: v for k, v in asdict(self).items() if k not in may_die or getattr(self, k) != usual[k]}
        return of_tables(_merged(said, changes), self.name)


def of_tables(tables: dict[str, Any], where: str, text: str = "") -> Scenario:
    """A scenario from tables.

    Args:
        tables: as TOML has them.
        where: what they come from, such as a file.
        text: their TOML, so that an error can name its line.

    Raises:
        InvalidInput: where, line and key of the first mistake, and what is allowed.
    """
    try:
        dead.refuse(tables, tables.get("job"))
        return of_table(Scenario, tables)
    except InvalidInput as error:
        raise InvalidInput(f"{where}{line_of(text, str(error))}: {error}") from None


def _merged(base: dict, changes: dict) -> dict:
    out = dict(base)
    for key, value in changes.items():
        both = isinstance(value, dict) and isinstance(out.get(key), dict)
        same_kind = both and not (set(value) & {"uniform", "log_uniform", "choice"})
        out[key] = _merged(out[key], value) if same_kind else value
    return out


def journey(scenario: Scenario) -> Contour | None:
    """What the nozzle travels; None: it goes straight along x."""
    if scenario.circle:
        return laps(scenario.circle)
    return contour(scenario.path, scenario.drawing) if scenario.path else None
