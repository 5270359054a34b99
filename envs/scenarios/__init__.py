"""Scenarios: named, seeded distributions over machine, sheet and journey.

A scenario is physics only; what a user tunes belongs to the controller's stack. It is frozen and validated; unknown or
misspelt keys and values out of range are errors that name what is allowed. :func:`load` reads one from TOML,
:meth:`Scenario.to_toml` writes it, :func:`suite` gives the frozen suites.

What users write is validated by pydantic, which is imported only then: it takes 0.2 s. What is made in Python checks
itself, with plainer messages, and so do the shipped suites.

Seeds: tune 0–999, train 10 000 and up, test 1000–1199 (report) and 1200–1999 (reserve). They are disjoint, and a seed
fixes an episode completely: machine, sheet, and every random number of its noise.
"""

# ruff: noqa: RUF009  (the distributions that are defaults are frozen)

import functools
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

import numpy as np

from ..engine.lanes import mix
from ..engine.quantity import InvalidInput, Quantity, did_you_mean
from ..plant import heads, sensor, sheet, spot, xy_axes, z_axis
from ..plant.calibration import read_columns
from ..plant.controller import PERIOD
from ..plant.fleet import Fleet
from ..plant.path import SPACING, Contour
from ..safety import files, names
from .distributions import Choice, Draws, LogUniform, Number, Uniform, as_number, bounds, draw

if TYPE_CHECKING:
    from ..paths.drawing import Drawing

SPLITS = {
    "tune": range(0, 1000),
    "test": range(1000, 1200),
    "reserve": range(1200, 2000),
    "train": range(10_000, 2**40),
}
"""Seeds of each split."""

PAIRS = 8
"""Pairs of tables of random sheets that the seeds of a split share."""

SETTLED = 0.25
"""Most of a journey along a drawing that is left out of the score, for the machine to settle."""

SHEET = (4000.0, 2000.0)
"""mm, the sheet that axes reach over when a user's drawing is cut [A]: the largest usual format."""


@dataclass(frozen=True, kw_only=True)
class _Section:
    """A table of a scenario: frozen, no unknown keys, every field of its kind, every number within its declared range.

    Fields may be given as TOML has them: tables, arrays, whole numbers.
    """

    __pydantic_config__ = {"extra": "forbid"}  # unknown keys are errors

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, _fitting(field.type, getattr(self, field.name), field.name))


def _fitting(kind: Any, value: Any, name: str) -> Any:
    """``value`` as the field ``name`` of type ``kind`` holds it.

    Raises:
        InvalidInput: not of that kind, or out of its range.
    """
    inner = get_args(kind)
    if get_origin(kind) is Annotated:
        what, *_, quantity = inner
        if what in (int, float):
            return what(quantity.check(value, name))
        try:
            value = as_number(value)
        except ValueError as error:
            raise InvalidInput(f"{name}: {error}") from None
        for end in bounds(value):
            quantity.check(end, name)
        return value
    if type(None) in inner:
        return None if value is None else _fitting(inner[0], value, name)
    if get_origin(kind) is tuple and isinstance(value, list | tuple):
        return tuple(_fitting(inner[0], each, name) for each in value)
    if isinstance(value, dict) and isinstance(kind, type) and issubclass(kind, _Section):
        return kind(**value)
    literal, plain = get_origin(kind) is Literal, get_origin(kind) or kind
    if not (value in inner if literal else isinstance(value, plain)):
        allowed = " or ".join(map(repr, inner)) if literal else plain.__name__
        raise InvalidInput(f"{name} = {value!r} is not allowed; allowed: {allowed}")
    return value


def _q(unit: str, low: float, high: float, doc: str, source: str = "[A]", whole: bool = False) -> Any:
    return Quantity(unit, low, high, doc, source, whole)


@dataclass(frozen=True, kw_only=True)
class Axis(_Section):
    """The Z axis; defaults are the following suite's plants (docs/physics.md#the-z-axis)."""

    bandwidth: Annotated[Number, _q("Hz", 5, 500, "velocity loop")] = Uniform(uniform=(50, 120))
    zeta: Annotated[Number, _q("1", 0.2, 2, "its damping ratio")] = Uniform(uniform=(0.6, 1.0))
    dead_time: Annotated[Number, _q("s", 0, 0.004, "command to drive")] = Choice(choice=(0.001, 0.002))
    latency: Annotated[Number, _q("s", 0, 0.002, "of computing and field bus, beside the dead time")] = Uniform(
        uniform=(0.0001, 0.0009)
    )
    acceleration: Annotated[Number, _q("mm/s²", 500, 1e5, "limit")] = Uniform(uniform=(10_000, 18_000))
    jerk: Annotated[Number, _q("mm/s³", 1e4, 1e8, "limit of the drive")] = 2e6
    speed: Annotated[Number, _q("mm/s", 10, 2000, "limit", "Xi2023")] = 500.0
    resonance: Annotated[Number, _q("Hz", 10, 1000, "structural mode")] = Uniform(uniform=(60, 150))
    resonance_zeta: Annotated[Number, _q("1", 0.005, 1, "its damping ratio")] = 0.05
    compliance: Annotated[Number, _q("1", 0, 1, "its share of the load path")] = 0.1
    friction: Annotated[Number, _q("mm/s²", 0, 1e4, "Coulomb friction over mass")] = Uniform(uniform=(600, 1000))
    bristle: Annotated[
        Number, _q("mm", 0, 0.1, "that Coulomb friction bends before it slides (LuGre); 0: viscous below 1 mm/s")
    ] = Uniform(uniform=(0.002, 0.010))
    stiction: Annotated[Number, _q("1", 1, 3, "static over Coulomb friction")] = Uniform(uniform=(1.2, 1.6))
    stribeck: Annotated[Number, _q("mm/s", 0.1, 100, "speed at which half that difference is gone")] = Uniform(
        uniform=(1, 5)
    )
    backlash: Annotated[Number, _q("mm", 0, 0.2, "free play, closed by gravity")] = 0.005
    encoder: Annotated[Number, _q("mm", 0, 0.1, "per count; 0: ideal")] = 1e-3
    dac_bits: Annotated[Number, _q("bit", 0, 24, "of ±speed; 0: ideal")] = 16.0

    def __post_init__(self) -> None:
        super().__post_init__()
        shortest = z_axis.SHORTEST_BRISTLE
        given = self.bristle.choice if isinstance(self.bristle, Choice) else [bounds(self.bristle)[0]]
        some = bounds(self.bristle)[1] > 0
        for each in given:
            if some and each < shortest and not (each == 0 and isinstance(self.bristle, Choice)):
                raise ValueError(f"bristle = {each} is out of range; allowed: 0, or {shortest:g} to 0.1 mm")


@dataclass(frozen=True, kw_only=True)
class Head(_Section):
    """The sensor's noise and disturbances (docs/physics.md#disturbances); the head is one of the pool's."""

    plate: Annotated[
        float, _q("mm", sheet.FOOTPRINT, sensor.WIDEST, "radius of the plate's footprint; the score's is 2 mm")
    ] = sheet.PLATE
    noise: Annotated[Number, _q("pF", 0, 1, "capacitance noise, sigma")] = LogUniform(log_uniform=(5e-4, 5e-3))
    jitter: Annotated[Number, _q("1", 0, 1e-3, "relative oscillator noise per sample, sigma")] = 1e-6
    drift: Annotated[Number, _q("1", -0.05, 0.05, "relative change of L·C when warm")] = 0.0
    warming: Annotated[Number, _q("s", 1, 1e5, "time constant of the drift")] = 600.0
    impulses: Annotated[Number, _q("1/s", 0, 500, "rate of impulses")] = 2.0
    impulse_samples: Annotated[Number, _q("samples", 1, 50, "longest impulse, lengths uniform from 1")] = 1.0
    impulse_height: Annotated[Number, _q("mm", 0, 5, "apparent height at zero gap, A(h) = this/(1 + h/falloff)")] = (
        0.137
    )
    impulse_falloff: Annotated[Number, _q("mm", 0.01, 100, "see impulse_height")] = 0.894
    impulse_spread: Annotated[Number, _q("1", 0, 1, "relative spread of the height")] = 0.3
    bursts: Annotated[Number, _q("1/s", 0, 100, "rate of plasma bursts")] = 0.0
    burst: Annotated[Number, _q("pF", 0, 5, "largest burst")] = 0.1
    burst_length: Annotated[Number, _q("s", 0.001, 10, "mean length of a burst")] = 0.02
    plasma: Annotated[Number, _q("pF", 0, 5, "constant offset while cutting")] = 0.0
    oscillator: Literal["eq3", "eq1"] = "eq3"  # preset: without or with the series capacitors of Xi2023 eq. 1
    nominal: bool = False  # the nominal head, instead of one drawn from the pool
    table: str | None = None  # CSV with frequency_Hz and height_mm, in place of the head's own calibration
    signal: str | None = None  # CSV with frequency_Hz, one row each ms, in place of what the sensor would count


@dataclass(frozen=True, kw_only=True)
class Wave(_Section):
    """A sine of the sheet's shape; amplitude · (wavelength/reference)^exponent."""

    amplitude: Annotated[Number, _q("mm", 0, 10, "before the factor of the wavelength")]
    wavelength: Annotated[Number, _q("mm", 5, 1e5, "")]
    direction: Annotated[Number, _q("deg", -180, 180, "of its wave vector, from x")] = 0.0
    exponent: Annotated[Number, _q("1", 0, 4, "how the amplitude grows with the wavelength")] = 0.0
    reference: Annotated[Number, _q("mm", 1, 1e5, "wavelength at which the factor is 1")] = 60.0


@dataclass(frozen=True, kw_only=True)
class Vibration(_Section):
    """A motion in time of the whole sheet: a tone, or with ``zeta`` a band, the mode of a plate that noise shakes."""

    frequency: Annotated[Number, _q("Hz", 0, 400, "")]
    amplitude: Annotated[Number, _q("mm", 0, 5, "of a band √2 times its RMS")]
    zeta: Annotated[Number, _q("1", 0, 0.7, "damping ratio of a band; 0: a tone")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        highest = bounds(self.frequency)[1]
        if bounds(self.zeta)[1] > 0 and highest > sheet.HIGHEST_BAND:
            allowed = f"0 to {sheet.HIGHEST_BAND:g} Hz for a band"
            raise ValueError(f"frequency = {highest} is out of range; allowed: {allowed}")


@dataclass(frozen=True, kw_only=True)
class Random(_Section):
    """A sheet of continuous spectrum: power density ~ 1/(k² + k0²)^(exponent/2), k0 = 2π/rolloff."""

    rms: Annotated[Number, _q("mm", 0, 5, "under the nozzle's tip")]
    exponent: Annotated[float, _q("1", 1, 5, "with which the density falls over the wavenumber")] = 2.0
    rolloff: Annotated[float, _q("mm", 10, 5000, "wavelength beyond which it no longer rises")] = 300.0


@dataclass(frozen=True, kw_only=True)
class Corners(_Section):
    """Corners for which the feed slows down; the path goes straight on."""

    pitch: Annotated[Number, _q("mm", 10, 1e4, "one corner in each")]
    feed: Annotated[Number, _q("mm/s", 1, 2000, "in a corner")] = 20.0
    acceleration: Annotated[Number, _q("mm/s²", 100, 1e5, "of the axes")] = 5000.0


@dataclass(frozen=True, kw_only=True)
class Turns(_Section):
    """An episode in several turns; what is named is on in the turns whose numbers (from 0) it has, and else off."""

    length: Annotated[float, _q("s", 2, 600, "of a turn")]
    count: Annotated[int, _q("", 1, 32, "turns, after which they begin anew", whole=True)]
    waves: tuple[int, ...] = ()
    random: tuple[int, ...] = ()
    vibrations: tuple[int, ...] = ()
    impulses: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("waves", "random", "vibrations", "impulses"):
            for turn in getattr(self, name):
                if not 0 <= turn < self.count:
                    raise ValueError(f"{name} = {turn} is out of range; allowed: 0 to {self.count - 1}, the turns")

    def mask(self, name: str) -> float:
        """A bit for each turn in which ``name`` is on."""
        return float(sum(1 << turn for turn in set(getattr(self, name))))


@dataclass(frozen=True, kw_only=True)
class Steps(_Section):
    """Steps along the path."""

    count: Annotated[int, _q("", 1, sheet.FEATURES, "steps", whole=True)] = 12
    height: Annotated[Number, _q("mm", -5, 5, "of each")]
    spacing: Annotated[Number, _q("mm", sheet.LATEST + sheet.FOOTPRINT, 1e4, "from step to step")]


@dataclass(frozen=True, kw_only=True)
class Holes(_Section):
    """Voids or raised parts along the path, one in each ``pitch``, beginning within its first half."""

    pitch: Annotated[Number, _q("mm", 30, 1e5, "distance of their middles on average")]
    jitter: Annotated[Number, _q("mm", -1e4, 1e4, "of each middle")] = 0.0
    length: Annotated[Number, _q("mm", 0.5, 1e4, "along the path")]
    round: bool = False  # as wide across as long, instead of a slot
    rise: Annotated[Number, _q("mm", 0, 20, "a part standing proud instead of a void; 0: a void")] = 0.0
    count: Annotated[int, _q("", 1, sheet.FEATURES, "at most", whole=True)] = sheet.FEATURES


@dataclass(frozen=True, kw_only=True)
class Bulge(_Section):
    """A thermal bulge."""

    height: Annotated[Number, _q("mm", 0, 5, "in the end")]
    width: Annotated[Number, _q("mm", 2, 1000, "full, at half height")]
    growth: Annotated[Number, _q("s", 0.01, 1000, "time constant τ")]
    x: Annotated[Number, _q("mm", -1e4, 1e4, "centre")] = 300.0
    y: Annotated[Number, _q("mm", -1e4, 1e4, "centre")] = 0.0


@dataclass(frozen=True, kw_only=True)
class Profile(_Section):
    """A measured surface: CSV with the columns ``position_mm`` and ``height_mm``."""

    file: str  # relative to the scenario's
    spacing: Annotated[float, _q("mm", 0.01, 100, "to which it is resampled")] = 0.1


@dataclass(frozen=True, kw_only=True)
class Map(_Section):
    """A measured surface: CSV with the columns ``x_mm``, ``y_mm`` and ``height_mm``, a regular grid."""

    file: str  # relative to the scenario's


@dataclass(frozen=True, kw_only=True)
class Sheet(_Section):
    """The sheet's shape and motion."""

    tilt: Annotated[Number, _q("mm/mm", -0.3, 0.3, "slope along x")] = 0.0
    tilt_y: Annotated[Number, _q("mm/mm", -0.3, 0.3, "slope along y")] = 0.0
    length: Annotated[float, _q("mm", 1000, 1e6, "along x, after which the slope goes the other way, and so on")] = (
        3000.0
    )
    waves: tuple[Wave, ...] = ()
    vibrations: tuple[Vibration, ...] = ()
    random: Random | None = None
    steps: Steps | None = None
    holes: Holes | None = None
    bulge: Bulge | None = None
    profile: Profile | None = None
    map: Map | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.waves) > sheet.WAVES:
            raise ValueError(f"{len(self.waves)} waves; at most {sheet.WAVES}")
        if len(self.vibrations) > sheet.VIBRATIONS:
            raise ValueError(f"{len(self.vibrations)} vibrations; at most {sheet.VIBRATIONS}")
        if self.steps and self.holes:
            raise ValueError("steps and holes exclude each other in one sheet")
        if self.profile and self.map:
            raise ValueError("profile and map exclude each other in one sheet")


@dataclass(frozen=True, kw_only=True)
class Circle(_Section):
    """A circle travelled again and again; it begins and ends at x = y = 0, with its centre on the x axis."""

    radius: Annotated[float, _q("mm", 1, 500, "of the circle")] = 30.0
    laps: Annotated[int, _q("", 1, 100, "in an episode, at the feed of the scenario", whole=True)] = 8

    @property
    def length(self) -> float:
        """mm of a lap."""
        return 2 * np.pi * self.radius


@dataclass(frozen=True, kw_only=True)
class Reading(_Section):
    """How the drawing of ``path``, or of a job's ``part``, is read."""

    units: str | None = None  # mm, cm, m, inches …, instead of what the drawing says
    layers: tuple[str, ...] = ()  # what becomes of which: cut=A,B, engrave=C*, ignore=DIM*; none: all are cut
    colours: tuple[str, ...] = ()  # the same for colours (DXF) and strokes (SVG)
    join: Annotated[float, _q("mm", 0, 10, "largest gap between two ends that are joined")] = SPACING
    text: bool = False  # cut letters as outlines
    hatches: bool = False  # cut filled areas as outlines

    def drawing(self, file: str) -> "Drawing":
        """The drawing in a DXF, SVG or G-code file, read so.

        Raises:
            InvalidInput: whatever is wrong in it, where, and what is allowed.
        """
        from ..paths.read import read as read_path

        return read_path(
            file, layers=self.layers or None, units=self.units, colours=self.colours or None, join=self.join,
            text=self.text, hatches=self.hatches,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Job(_Section):
    """What is cut, from what, and how the programme around the cuts looks; axes follow it with an error."""

    part: str = "square"  # a built-in part, or a file: DXF, SVG, G-code
    size: Annotated[float, _q("mm", 0, 1500, "first size of a built-in part; 0: its own")] = 0.0
    material: str = "c45-10"  # a file of envs/materials
    thickness: Annotated[float, _q("mm", 0, 50, "of a material that comes in several; 0: its thinnest")] = 0.0
    feed: Annotated[float, _q("mm/s", 0, 2000, "of the cuts; 0: the material's recipe")] = 0.0
    kerf: Annotated[float, _q("mm", 0, 5, "compensated; 0: the path is the drawing")] = 0.0
    lead_in: Annotated[float, _q("mm", 0, 50, "at most, from the waste into a closed contour; 0: none")] = 3.0
    joints: Annotated[int, _q("", 0, 100, "micro-joints in each outline", whole=True)] = 0
    joint_spacing: Annotated[float, _q("mm", 0, 1e4, "from joint to joint; 0: their number decides")] = 0.0
    joint_width: Annotated[float, _q("mm", 0.05, 10, "of sheet that a joint leaves")] = 0.5
    clearance: Annotated[float, _q("mm", 0, 6, "above the cutting height in rapids")] = 4.0
    frog_leap: bool = True  # rise and fall during the rapid instead of before and after
    pierce: bool = True  # each cut begins with a pierce
    override: Annotated[float, _q("1", 1, 3, "largest feed override that the process control may ask for")] = 2.0
    power: Annotated[float, _q("1", 0, 2, "largest power, of the nominal one")] = 1.2
    pressure: Annotated[Number, _q("1", 0.1, 3, "of the gas, of the nominal one")] = 1.0
    standoff: Annotated[Number, _q("mm", -0.5, 0.5, "by which the machine is set off the recipe's standoff")] = 0.0
    extrapolate: bool = False  # process commands may leave the settings that were published of the material


@dataclass(frozen=True, kw_only=True)
class Gantry(_Section):
    """The X and Y axes, see ``plant/xy_axes.py``; defaults are Wu's."""

    preset: Literal["wu", "modern"] = "wu"
    literal: bool = False  # Wu's difference equation, which sums sampled speeds
    x_plus: Annotated[Number, _q("1", 0.2, 5, "gain of +x, of the nominal one")] = 1.0
    x_minus: Annotated[Number, _q("1", 0.2, 5, "gain of −x")] = 1.0
    y_plus: Annotated[Number, _q("1", 0.2, 5, "gain of +y")] = 1.0
    y_minus: Annotated[Number, _q("1", 0.2, 5, "gain of −y")] = 1.0
    slower: Annotated[Number, _q("1", 0.2, 5, "time constants of the drives, of the nominal ones")] = 1.0
    travel_x: Annotated[float, _q("mm", 10, 1e5, "", "Wu")] = 1500.0
    travel_y: Annotated[float, _q("mm", 10, 1e5, "", "Wu")] = 1000.0


@dataclass(frozen=True, kw_only=True)
class Optics(_Section):
    """Galvo and piezo that dither the spot, see ``plant/spot.py``."""

    galvo: Annotated[Number, _q("Hz", 100, 1e5, "natural frequency of the galvo")] = 5000.0
    galvo_range: Annotated[float, _q("mm", 0.001, 5, "±, along each axis", "Huang2024")] = 0.3
    piezo: Annotated[Number, _q("Hz", 100, 1e5, "natural frequency of the focus drive")] = 8000.0
    piezo_range: Annotated[float, _q("mm", 0.01, 50, "±", "Huang2024")] = 5.0
    hysteresis: Annotated[Number, _q("1", 0, 0.3, "width of the piezo's loop over its stroke")] = 0.02
    highest: Annotated[float, _q("Hz", 1, 1e5, "frequency of the dither", "Huang2024")] = 4000.0
    shape: Literal["circular", "hat", "elliptical"] = "circular"  # of the dither (Huang2024 eq. 12)
    along: bool = False  # x of the dither along the path instead of along the machine's x


@dataclass(frozen=True, kw_only=True)
class Scenario(_Section):
    """A frozen scenario; see the module's text."""

    name: str  # in tables and plots
    summary: str = ""  # what happens, in a line
    version: int = 2  # of the suite that it belongs to
    duration: Annotated[float, _q("s", 0.05, 600, "of an episode")] = 3.0
    settle: Annotated[float, _q("s", 0, 60, "at the start, not scored")] = 0.3
    share: Annotated[float, _q("1", 0.01, 1, "of a run's seeds that it is run on, because an episode is long")] = 1.0
    feed: Annotated[Number, _q("mm/s", 0, 2000, "along the path")] = 200.0
    set_height: Annotated[Number, _q("mm", 0.05, 9, "")] = Choice(choice=(0.5, 0.8, 1.0))
    start_above: Annotated[Number, _q("mm", 0, 30, "head above the set height at the start")] = 0.0
    guard: bool = False  # the supervisor's hole and edge guard is on
    exempt: bool = False  # built to defeat followers: collisions are expected and not counted
    path: str | None = None  # a drawing (DXF, SVG, G-code) along whose contours the nozzle travels
    drawing: Reading = Reading()
    circle: Circle | None = None
    corners: Corners | None = None
    turns: Turns | None = None
    axis: Axis = Axis()
    head: Head = Head()
    sheet: Sheet = Sheet()
    job: Job | None = None
    gantry: Gantry = Gantry()
    optics: Optics = Optics()

    def __post_init__(self) -> None:
        super().__post_init__()
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
        shortest, longest = _duration_range()
        if not shortest <= duration <= longest:
            raise InvalidInput(
                f"scenario '{self.name}': {drawing} takes {duration:g} s at {slowest:g} mm/s; allowed: {shortest:g} to "
                f"{longest:g} s; a {'slower' if duration < shortest else 'faster'} feed, or a suite of jobs, such as "
                "contour"
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
        import tomli_w

        tables = asdict(self)
        for name, default in (("gantry", Gantry()), ("optics", Optics())):
            if self.job is None and getattr(self, name) == default:  # of no use to a follower
                del tables[name]
        if self.drawing == Reading():
            del tables["drawing"]
        return tomli_w.dumps(_without_none(tables))

    def varied(self, **changes: Any) -> "Scenario":
        """A copy with some fields changed, validated anew: ``varied(feed=400, head={"noise": 0.01})`` merges tables."""
        return _validated(_merged(asdict(self), changes), self.name)


def _duration_range() -> tuple[float, float]:
    """s, shortest and longest episode."""
    kind = next(field.type for field in fields(Scenario) if field.name == "duration")
    quantity = get_args(kind)[-1]
    return quantity.low, quantity.high


def _merged(base: dict, changes: dict) -> dict:
    out = dict(base)
    for key, value in changes.items():
        both = isinstance(value, dict) and isinstance(out.get(key), dict)
        same_kind = both and not (set(value) & {"uniform", "log_uniform", "choice"})
        out[key] = _merged(out[key], value) if same_kind else value
    return out


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_none(v) for k, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list | tuple) else value


# ---------------------------------------------------------------------------------------------------- reading


def _section_at(location: tuple) -> type[_Section] | None:
    """The section whose key an error is about; None: it is a distribution's."""
    section: type[_Section] | None = Scenario
    for key in location:
        kind = next((f.type for f in fields(section) if f.name == key), None) if section else None
        if kind is not None:
            kinds = [k for k in (kind, *get_args(kind)) if isinstance(k, type) and issubclass(k, _Section)]
            section = kinds[0] if kinds else None
    return section


@functools.cache
def _validator() -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(Scenario)


def _validated(data: dict, where: str, text: str = "") -> Scenario:
    from pydantic import ValidationError

    try:
        return _validator().validate_python(data)
    except ValidationError as error:
        # A misspelt key explains the missing one that usually comes with it.
        first = min(error.errors(), key=lambda e: e["type"] != "unexpected_keyword_argument")
        location = tuple(k for k in first["loc"] if k not in ("float", "Uniform", "LogUniform", "Choice"))
        key = ".".join(str(k) for k in location)
        said = first["msg"].removeprefix("Value error, ")
        about = (said.split(" = ")[0],) if " = " in said else ()  # a range error names its own key
        line = _line_of(text, location + about)
        if first["type"] == "unexpected_keyword_argument":
            section = _section_at(location[:-1])
            known = [f.name for f in fields(section)] if section else ["uniform", "log_uniform", "choice", "sign"]
            message = f"unknown key '{key}'; {did_you_mean(str(location[-1]), known)}"
        else:
            message = f"{key}: {said}" if key else said
        raise InvalidInput(f"{where}{line}: {message}") from None


def _line_of(text: str, location: tuple) -> str:
    """Line of the key, or of the nearest table around it, in TOML text."""
    best, found = 0, ""
    table: tuple = ()
    seen: dict[tuple, int] = {}
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        if line.startswith("["):
            table = tuple(line.split("]")[0].strip("[] ").split("."))
            if line.startswith("[["):
                seen[table] = seen.get(table, -1) + 1
                table = (*table, seen[table])
            path = table
        elif "=" in line and not line.startswith("#"):
            path = (*table, *line.split("=")[0].strip().split("."))
        else:
            continue
        if len(path) > best and location[: len(path)] == path:
            best, found = len(path), f", line {number}"
    return found


def parse(text: str, where: str = "scenario") -> Scenario:
    """A scenario from TOML text.

    Raises:
        InvalidInput: file, line and key of the first mistake.
    """
    return _validated(files.toml_of(text, where), where, text)


def read(path: str | Path) -> Scenario:
    """A scenario from a TOML file; files it names are taken relative to it.

    Raises:
        InvalidInput: file, line and key of the first mistake.
    """
    text = files.text(path, files.SETTINGS)
    scenario = parse(text, str(path))
    folder = Path(path).resolve().parent
    if scenario.sheet.profile:
        scenario = scenario.varied(sheet={"profile": {"file": str(folder / scenario.sheet.profile.file)}})
        profile(scenario.sheet.profile)  # a bad file is an error now, not in the middle of a run
    if scenario.sheet.map:
        scenario = scenario.varied(sheet={"map": {"file": str(folder / scenario.sheet.map.file)}})
        height_map(scenario.sheet.map)
    for name in ("table", "signal"):
        given = getattr(scenario.head, name)
        if given:
            scenario = scenario.varied(head={name: str(folder / given)})
    if scenario.head.table:
        measured_head(scenario.head.table)
    if scenario.head.signal:
        signal(scenario.head.signal)
    if scenario.job and Path(scenario.job.part).suffix:
        scenario = scenario.varied(job={"part": str(folder / scenario.job.part)})
    if scenario.path:
        drawing, named = folder / scenario.path, scenario.name
        timed = "duration" in files.toml_of(text, path)
        scenario = scenario.varied(path=str(drawing)) if timed else scenario.along(drawing).varied(name=named)
    return scenario


@functools.lru_cache(maxsize=8)
def drawn(drawing: str, reading: Reading = Reading()) -> "Drawing":
    """The drawing in a DXF, SVG or G-code file."""
    return reading.drawing(drawing)


@functools.lru_cache(maxsize=8)
def contour(drawing: str, reading: Reading = Reading()) -> Contour:
    """The journey through a drawing, moved so that its lower left corner lies at x = y = 0."""
    from ..paths.drawing import journey as through

    path = through(drawn(drawing, reading))
    return Contour(path.name, path.x - path.x.min(), path.y - path.y.min(), path.cutting)


@functools.lru_cache(maxsize=8)
def laps(circle: Circle) -> Contour:
    """The journey around a circle, all laps one after the other, the beam on throughout."""
    angle = np.arange(0.0, circle.laps * circle.length + SPACING, SPACING) / circle.radius
    x, y = circle.radius * (1 - np.cos(angle)), circle.radius * np.sin(angle)
    return Contour(f"circle-{circle.radius:g}", x, y, np.ones(len(angle)))


def journey(scenario: Scenario) -> Contour | None:
    """What the nozzle travels; None: it goes straight along x."""
    if scenario.circle:
        return laps(scenario.circle)
    return contour(scenario.path, scenario.drawing) if scenario.path else None


MOST_POINTS = 5_000_000
"""Of a profile: 500 m at a tenth of a millimetre."""

MOST_HEIGHT = 1000.0
"""mm of a measured surface, up and down."""


def _columns(file: str, wanted: tuple[str, ...]) -> np.ndarray:
    """Columns of a CSV file, see :func:`read_columns`; surfaces are no mountains."""
    columns = read_columns(files.checked(file, files.TABLE), wanted)
    for name, values in zip(wanted, columns.T, strict=True):
        far = np.flatnonzero(np.abs(values) > MOST_HEIGHT)
        if name == "height_mm" and len(far):
            row, value = far[0] + 2, values[far[0]]
            raise InvalidInput(f"{file}, row {row}, column {name}: {value:g} mm; allowed: ±{MOST_HEIGHT:g} mm")
    return columns


@functools.lru_cache(maxsize=32)
def profile(source: Profile) -> np.ndarray:
    """Heights of a measured profile, resampled at ``source.spacing``, mm, starting at its first position.

    Raises:
        InvalidInput: gaps, text or positions that do not rise, with file, row and column.
    """
    columns = _columns(source.file, ("position_mm", "height_mm"))
    falls = np.flatnonzero(np.diff(columns[:, 0]) <= 0)
    if len(falls):
        raise InvalidInput(
            f"{source.file}, row {falls[0] + 3}, column position_mm: positions must rise from row to row"
        )
    if not (many := (columns[-1, 0] - columns[0, 0]) / source.spacing) <= MOST_POINTS:
        raise InvalidInput(
            f"{source.file}: {columns[0, 0]:g} to {columns[-1, 0]:g} mm every {source.spacing:g} mm are {many:.3g} "
            f"points; allowed: {MOST_POINTS:,}; are the positions in mm? Else give a wider spacing"
        )
    grid = np.arange(columns[0, 0], columns[-1, 0], source.spacing)
    return np.interp(grid, columns[:, 0], columns[:, 1])


@functools.lru_cache(maxsize=32)
def height_map(source: Map) -> tuple[np.ndarray, float, float, float]:
    """Heights (along y, along x), the corner they begin at, and their spacing, all in mm.

    Raises:
        InvalidInput: text, gaps, or points that are no regular grid, with file and row.
    """
    columns = _columns(source.file, ("x_mm", "y_mm", "height_mm"))
    x, y = (np.unique(columns[:, k]) for k in (0, 1))
    if len(x) < 2 or len(y) < 2 or len(x) * len(y) != len(columns):
        raise InvalidInput(
            f"{source.file}: {len(columns)} points at {len(x)} places along x and {len(y)} along y are no full grid"
        )
    spacing = float(np.diff(x)[0])
    uneven = np.abs(np.concatenate([np.diff(x), np.diff(y)]) - spacing) > 1e-6 * spacing
    if uneven.any():
        raise InvalidInput(f"{source.file}: the grid's spacing is not {spacing:g} mm throughout, along x and along y")
    order = np.lexsort((columns[:, 0], columns[:, 1]))
    doubled = np.flatnonzero(np.diff(columns[order, 0] + 1j * columns[order, 1]) == 0)
    if len(doubled):
        raise InvalidInput(f"{source.file}, row {order[doubled[0] + 1] + 2}: this point is there twice")
    return columns[order, 2].reshape(len(y), len(x)).copy(), float(x[0]), float(y[0]), spacing


def measured_head(file: str) -> int:
    """Index of the head whose calibration table is in a CSV file, see :func:`heads.measured`."""
    return heads.measured(str(files.checked(file, files.TABLE)))


@functools.lru_cache(maxsize=32)
def signal(file: str) -> np.ndarray:
    """A recorded signal, Hz, one number each millisecond.

    Raises:
        InvalidInput: text, gaps, or a frequency that is not above 0, with file and row.
    """
    values = _columns(file, ("frequency_Hz",))[:, 0]
    bad = np.flatnonzero(values <= 0)
    if len(bad):
        raise InvalidInput(f"{file}, row {bad[0] + 2}, column frequency_Hz: {values[bad[0]]:g} Hz; it must be above 0")
    return values


# -------------------------------------------------------------------------------------------------- the machine


def prepare(fleet: Fleet, scenario: Scenario, machines: Any, seeds: Any, again: bool = False) -> None:
    """Writes the physics of ``scenario`` into the columns of ``machines``, one seed each.

    Args:
        fleet: whose tables are the pool of :mod:`plant.heads`.
        machines: indices, shape (n,).
        seeds: scenario seeds, shape (n,).
        again: the machines have been prepared for this very scenario before, so what is fixed is there already.
    """
    m, draws = np.atleast_1d(machines), Draws(np.atleast_1d(np.asarray(seeds, np.uint64)), scenario.labels)

    def value(section: _Section, name: str, label: str) -> Any:
        return draw(getattr(section, name), draws, label + name)

    with fleet.writing(m, again):
        _prepare_axis(fleet, m, functools.partial(value, scenario.axis, label="axis."))
        _prepare_head(fleet, scenario.head, m, draws, functools.partial(value, scenario.head, label="head."))
        _prepare_sheet(fleet, scenario, m, draws)
        if fleet.gantries is not None:
            _prepare_gantry(fleet, scenario, m, draws)
        travelled = journey(scenario)
        if travelled:
            fleet.put_contours([travelled], np.zeros(len(m), int), m)
        else:
            fleet.set("path.contour", m, -1.0)
        fleet.set("path.lap", m, scenario.circle.length if scenario.circle else 0.0)
        set_height = value(scenario, "set_height", "")
        fleet.set("path.feed", m, value(scenario, "feed", ""))
        _prepare_corners(fleet, scenario.corners, m, draws)
        _prepare_turns(fleet, scenario.turns, m)
        fleet.set("job.set_height", m, set_height)
        fleet.set("job.hole_guard", m, float(scenario.guard))
        fleet.set("start.gap", m, set_height + value(scenario, "start_above", ""))


def _prepare_axis(fleet: Fleet, m: np.ndarray, value: Any) -> None:
    bits, speed = value("dac_bits"), value("speed")
    columns = {
        "omega": 2 * np.pi * value("bandwidth"),
        "zeta": value("zeta"),
        "speed": speed,
        "acceleration": value("acceleration"),
        "jerk": value("jerk"),
        "dead_time": (value("dead_time") + value("latency")) / PERIOD,
        "dac": np.where(bits > 0, speed / 2.0 ** np.maximum(bits - 1, 0), 0.0),
        "encoder": value("encoder"),
        "friction": value("friction"),
        "bristle": value("bristle"),
        "stiction": value("stiction"),
        "stribeck": value("stribeck"),
        "backlash": value("backlash"),
        "omega_r": 2 * np.pi * value("resonance"),
        "zeta_r": value("resonance_zeta"),
        "compliance": value("compliance"),
    }
    assert set(columns) <= set(z_axis.Params._fields)
    for name, column in columns.items():
        fleet.set(f"z.{name}", m, column)


def _prepare_head(fleet: Fleet, head: Head, m: np.ndarray, draws: Draws, value: Any) -> None:
    which = np.zeros(len(m), int) if head.nominal else (draws.fraction("head") * heads.HEADS).astype(int)
    which = which + heads.HEADS * heads.OSCILLATORS.index(head.oscillator)
    for index in set(which.tolist()):
        heads.table(index)
    index = np.full(len(m), measured_head(head.table)) if head.table else which
    fleet.set("start.head", m, index.astype(float))
    fleet.set("job.most_frequency", m, heads.beyond(index))
    fleet.replay(signal(head.signal) if head.signal else None)
    for name, column in zip(heads.FIELDS, heads.fields()[:, which], strict=True):
        fleet.set(f"sensor.{name}", m, column)
    columns = {
        "noise": value("noise"),
        "jitter": value("jitter"),
        "drift": value("drift"),
        "warming": 1 - np.exp(-PERIOD / value("warming")),
        "impulses": value("impulses") * PERIOD,
        "longest": value("impulse_samples"),
        "impulse": value("impulse_height"),
        "falloff": value("impulse_falloff"),
        "spread": value("impulse_spread"),
        "bursts": value("bursts") * PERIOD,
        "burst": value("burst"),
        "burst_end": 1 - np.exp(-PERIOD / value("burst_length")),
        "plasma": value("plasma"),
    }
    assert {*columns, *heads.FIELDS} == set(sensor.Params._fields)
    for name, column in columns.items():
        fleet.set(f"sensor.{name}", m, column)


def _prepare_sheet(fleet: Fleet, scenario: Scenario, m: np.ndarray, draws: Draws) -> None:
    shape = scenario.sheet
    plate = scenario.head.plate
    fleet.put_plate(m, plate)
    fleet.set("sheet.tilt_x", m, draw(shape.tilt, draws, "sheet.tilt"))
    fleet.set("sheet.length", m, shape.length)
    fleet.set("sheet.tilt_y", m, draw(shape.tilt_y, draws, "sheet.tilt_y"))
    for i in range(sheet.WAVES):
        if i < len(shape.waves):
            w, label = shape.waves[i], f"sheet.waves.{i}."
            length = draw(w.wavelength, draws, label + "wavelength")
            relative = (length / draw(w.reference, draws, label + "reference")) ** draw(
                w.exponent, draws, label + "exponent"
            )
            angle = np.deg2rad(draw(w.direction, draws, label + "direction"))
            k, phase = 2 * np.pi / length, 2 * np.pi * draws.fraction(label + "phase")
            amplitude = draw(w.amplitude, draws, label + "amplitude") * relative
            fleet.put_wave(m, i, amplitude, k * np.cos(angle), k * np.sin(angle), phase, plate)
        elif i < fleet.waves:
            fleet.put_wave(m, i, 0.0, 0.0, 0.0, 0.0)
    for i in range(sheet.VIBRATIONS):
        if i < len(shape.vibrations):
            v, label = shape.vibrations[i], f"sheet.vibrations.{i}."
            fleet.put_vibration(
                m, i, draw(v.amplitude, draws, label + "amplitude"), draw(v.frequency, draws, label + "frequency"),
                2 * np.pi * draws.fraction(label + "phase"), draw(v.zeta, draws, label + "zeta"),
            )  # fmt: skip
        elif i < fleet.vibrations:
            fleet.put_vibration(m, i, 0.0, 0.0, 0.0)
    _put_random(fleet, shape.random, plate, m, draws)
    fleet.clear_features(m)
    if shape.steps:
        _put_steps(fleet, shape.steps, m, draws)
    if shape.holes:
        _put_holes(fleet, shape.holes, m, draws)
    b = shape.bulge
    fleet.set("sheet.bulge", m, draw(b.height, draws, "sheet.bulge.height") if b else 0.0)
    if b:
        fleet.set("sheet.bulge_width", m, draw(b.width, draws, "sheet.bulge.width"))
        fleet.set("sheet.bulge_growth", m, 1 - np.exp(-PERIOD / draw(b.growth, draws, "sheet.bulge.growth")))
        fleet.set("sheet.bulge_x", m, draw(b.x, draws, "sheet.bulge.x"))
        fleet.set("sheet.bulge_y", m, draw(b.y, draws, "sheet.bulge.y"))
        fleet.use_bulges()
    if shape.map:
        fleet.put_map(*height_map(shape.map), m)
    elif shape.profile:
        fleet.put_profile(profile(shape.profile), shape.profile.spacing, m)
    else:
        fleet.set("path.profile", m, -1.0)


GANTRIES = {
    "wu": xy_axes.Params(),
    # A machine of today: servo and interpolation every millisecond, 100 m/min, 1.5 g [A].
    "modern": xy_axes.Params(
        servo=1.0, interpolation=1.0, t1=0.003, t2=0.001, gain=1.0, speed=1666.7, acceleration=15000.0,
        dac=1666.7 / 32768.0, encoder=1e-3,
    ),
}  # fmt: skip
"""Axes by name."""


def _prepare_gantry(fleet: Fleet, scenario: Scenario, m: np.ndarray, draws: Draws) -> None:
    assert fleet.gantries
    g, shape = scenario.gantry, scenario.optics
    base = GANTRIES[g.preset]
    slower = draw(g.slower, draws, "gantry.slower")
    fleet.gantries.put("xy", m, base._replace(literal=g.literal))
    for name in ("x_plus", "x_minus", "y_plus", "y_minus"):
        fleet.gantries.set(f"xy.{name}", m, draw(getattr(g, name), draws, f"gantry.{name}"))
    for name in ("t1", "t2", "tau"):
        fleet.gantries.set(f"xy.{name}", m, getattr(base, name) * slower)
    for name in ("galvo", "galvo_range", "piezo", "piezo_range", "hysteresis", "highest"):
        fleet.gantries.set(f"optics.{name}", m, draw(getattr(shape, name), draws, f"optics.{name}"))
    fleet.gantries.set("optics.shape", m, float(spot.SHAPES.index(shape.shape)))
    fleet.gantries.set("optics.along", m, float(shape.along))
    if scenario.job:
        fleet.gantries.set("cut.pressure", m, draw(scenario.job.pressure, draws, "job.pressure"))
        fleet.gantries.set("recipe.offset", m, draw(scenario.job.standoff, draws, "job.standoff"))


def _put_random(fleet: Fleet, random: Random | None, plate: float, m: np.ndarray, draws: Draws) -> None:
    if random is None:
        fleet.put_random(m, None)
        return
    rms, angle = draw(random.rms, draws, "sheet.random.rms"), 2 * np.pi * draws.fraction("sheet.random.share")
    begin = [
        n * sheet.RANDOM_SPACING * draws.fraction(f"sheet.random.begin.{i}")
        for i, n in enumerate((sheet.RANDOM_ONE, sheet.RANDOM_TWO))
    ]
    source, sizes = (random.exponent, random.rolloff, plate), (rms * np.cos(angle), rms * np.sin(angle))
    fleet.put_random(m, source, pairs_of(draws.seeds), (*sizes, *begin))


def pairs_of(seeds: np.ndarray) -> np.ndarray:
    """Which pair of tables of random sheets each seed has: splits share none, a split's seeds take theirs in turn."""
    split = np.full(len(seeds), len(SPLITS) - 1)
    for i, known in enumerate(SPLITS.values()):
        split[(seeds >= known.start) & (seeds < known.stop)] = i
    return PAIRS * split + (seeds % np.uint64(PAIRS)).astype(int)


def _prepare_corners(fleet: Fleet, corners: Corners | None, m: np.ndarray, draws: Draws) -> None:
    fleet.set("path.corner", m, draw(corners.pitch, draws, "corners.pitch") if corners else 0.0)
    if corners:
        fleet.set("path.corner_feed", m, draw(corners.feed, draws, "corners.feed"))
        fleet.set("path.corner_acceleration", m, draw(corners.acceleration, draws, "corners.acceleration"))
        fleet.set("path.corner_phase", m, draws.fraction("corners.phase"))


def _prepare_turns(fleet: Fleet, turns: Turns | None, m: np.ndarray) -> None:
    fleet.set("turns.length", m, turns.length if turns else 0.0)
    if turns:
        fleet.set("turns.many", m, float(turns.count))
        for name in ("waves", "random", "vibrations", "impulses"):
            fleet.set(f"turns.{name}", m, turns.mask(name))
        fleet.use_turns()


def _put_steps(fleet: Fleet, steps: Steps, m: np.ndarray, draws: Draws) -> None:
    at = np.zeros(len(m))
    for i in range(steps.count):
        at = at + draw(steps.spacing, draws, f"sheet.steps.{i}.spacing")
        fleet.put_feature(m, i, at, sheet.FAR, draw(steps.height, draws, f"sheet.steps.{i}.height"), 0.0)


def _put_holes(fleet: Fleet, holes: Holes, m: np.ndarray, draws: Draws) -> None:
    previous = np.full(len(m), -sheet.SPACING)
    for i in range(holes.count):
        label = f"sheet.holes.{i}."
        length, rise = draw(holes.length, draws, label + "length"), draw(holes.rise, draws, label + "rise")
        middle = (i + 0.5) * draw(holes.pitch, draws, "sheet.holes.pitch") + draw(holes.jitter, draws, label + "jitter")
        start = np.maximum(middle - length / 2, previous + sheet.SPACING)
        previous = start + length
        # A round hole is as wide across as its mean chord; slots and edges are wider than any sensor.
        across = np.where(rise > 0, 0.0, length * np.pi / 4 if holes.round else sheet.FAR)
        fleet.put_feature(m, i, start, start + length, rise, across)


def noise_keys(seeds: Any) -> np.ndarray:
    """The random stream of each scenario seed."""
    return mix(np.atleast_1d(np.asarray(seeds, np.uint64)), np.uint64(0x6E6F697365))


# ------------------------------------------------------------------------------------------------------- suites

_SUITES = Path(__file__).parents[1] / "suites"


def suites() -> list[str]:
    """Names of the suites, in order."""
    return sorted(p.name for p in _SUITES.iterdir() if p.is_dir())


def suite(name: str) -> dict[str, Scenario]:
    """The scenarios of a suite by name, in the suite's order.

    Raises:
        InvalidInput: no suite of that name; the nearest is offered.
    """
    if name not in suites():
        raise InvalidInput(f"unknown suite '{name}'; {did_you_mean(name, suites())}")
    return dict(_suite(name))


@functools.cache
def _suite(name: str) -> tuple[tuple[str, Scenario], ...]:
    order = rules(name)["scenarios"]
    return tuple((s, _shipped(name, s)) for s in order)


@functools.cache
def _shipped(group: str, name: str) -> Scenario:
    # Without pydantic, so that a start does without it; tests compare this with what :func:`read` makes of the file.
    return Scenario(**files.toml(_SUITES / group / f"{name}.toml"))


@functools.cache
def rules(name: str) -> dict[str, Any]:
    """What a suite's file says beside its scenarios: ``score``, ``reference``, ``controllers``."""
    return checked_rules(_SUITES / f"{name}.toml")


_RULES: dict[str, type] = {
    "version": int, "scenarios": list, "core": list, "slot": str, "environment": str, "seeds": int,
}  # fmt: skip
_MORE_RULES: dict[str, type] = {"score": str, "reference": str, "controllers": list, "along": str}


def checked_rules(file: Path) -> dict[str, Any]:
    """What the file of a suite says.

    Raises:
        InvalidInput: a key is missing, unknown or of the wrong kind.
    """
    found = files.toml(file)
    known = {**_RULES, **_MORE_RULES}
    for key, value in found.items():
        if key not in known:
            raise InvalidInput(f"{file}: unknown key '{key}'; {did_you_mean(key, known)}")
        texts = isinstance(value, list) and all(isinstance(each, str) for each in value)
        if type(value) is not known[key] or (known[key] is list and not texts):
            kind = "list of texts" if known[key] is list else known[key].__name__
            raise InvalidInput(f"{file}: {key} = {str(value)[:80]!r} is no {kind}")
    if missing := [key for key in _RULES if key not in found]:
        raise InvalidInput(f"{file}: '{missing[0]}' is missing")
    return found


@functools.cache
def core(name: str) -> tuple[str, ...]:
    """Names of the scenarios over which the suite's score is taken."""
    return tuple(rules(name)["core"])


def load(name: str | Path | Scenario) -> Scenario:
    """A scenario by name, from a TOML file, or as it is.

    Raises:
        InvalidInput: neither a known name (the nearest is offered) nor a readable file.
    """
    if isinstance(name, Scenario):
        return name
    group, _, own = str(name).partition("/")
    if own and group in suites() and own in rules(group)["scenarios"]:
        return _shipped(group, own)
    for group in suites():
        if str(name) in rules(group)["scenarios"]:
            return _shipped(group, str(name))
    if str(name).endswith(".toml") or files.is_file(name):
        return read(name)
    known = [s for group in suites() for s in suite(group)]
    raise InvalidInput(f"unknown scenario '{name}'; {did_you_mean(str(name), known)}, or a path to a TOML file")
