"""The sheet in a scenario: its shape, its motion, and what it lacks."""

from dataclasses import dataclass
from typing import Annotated

from ..engine.quantity import Quantity, quantities
from ..plant import sheet
from .distributions import Number, bounds
from .section import Section

_SHEET, _USUAL = quantities(sheet.Params), sheet.Params()


@dataclass(frozen=True, kw_only=True)
class Wave(Section):
    """A sine of the sheet's shape; amplitude · (wavelength/reference)^exponent."""

    amplitude: Annotated[Number, Quantity("mm", 0, 10, "before the factor of the wavelength")]
    wavelength: Annotated[Number, Quantity("mm", 5, 1e5, "")]
    direction: Annotated[Number, Quantity("deg", -180, 180, "of its wave vector, from x")] = 0.0
    exponent: Annotated[Number, Quantity("1", 0, 4, "how the amplitude grows with the wavelength")] = 0.0
    reference: Annotated[Number, Quantity("mm", 1, 1e5, "wavelength at which the factor is 1")] = 60.0


@dataclass(frozen=True, kw_only=True)
class Vibration(Section):
    """A motion in time of the whole sheet: a tone, or with ``zeta`` a band, the mode of a plate that noise shakes."""

    frequency: Annotated[Number, Quantity("Hz", 0, 400, "")]
    amplitude: Annotated[Number, Quantity("mm", 0, 5, "of a band √2 times its RMS")]
    zeta: Annotated[Number, quantities(sheet.Vibration)["zeta"]] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        highest = bounds(self.frequency)[1]
        if bounds(self.zeta)[1] > 0 and highest > sheet.HIGHEST_BAND:
            allowed = f"0 to {sheet.HIGHEST_BAND:g} Hz for a band"
            raise ValueError(f"frequency = {highest} is out of range; allowed: {allowed}")


@dataclass(frozen=True, kw_only=True)
class Random(Section):
    """A sheet of continuous spectrum: power density ~ 1/(k² + k0²)^(exponent/2), k0 = 2π/rolloff."""

    rms: Annotated[Number, Quantity("mm", 0, 5, "under the nozzle's tip")]
    exponent: Annotated[float, Quantity("1", 1, 5, "with which the density falls over the wavenumber")] = 2.0
    rolloff: Annotated[float, Quantity("mm", 10, 5000, "wavelength beyond which it no longer rises")] = 300.0


@dataclass(frozen=True, kw_only=True)
class Steps(Section):
    """Steps along the path."""

    count: Annotated[int, Quantity("", 1, sheet.FEATURES, "steps", whole=True)] = 12
    height: Annotated[Number, Quantity("mm", -5, 5, "of each")]
    spacing: Annotated[Number, Quantity("mm", sheet.LATEST + sheet.FOOTPRINT, 1e4, "from step to step")]


@dataclass(frozen=True, kw_only=True)
class Holes(Section):
    """Voids or raised parts along the path, one in each ``pitch``, beginning within its first half."""

    pitch: Annotated[Number, Quantity("mm", 30, 1e5, "distance of their middles on average")]
    jitter: Annotated[Number, Quantity("mm", -1e4, 1e4, "of each middle")] = 0.0
    length: Annotated[Number, Quantity("mm", 0.5, 1e4, "along the path")]
    round: bool = False  # as wide across as long, instead of a slot
    rise: Annotated[Number, Quantity("mm", 0, 20, "a part standing proud instead of a void; 0: a void")] = 0.0
    count: Annotated[int, Quantity("", 1, sheet.FEATURES, "at most", whole=True)] = sheet.FEATURES


@dataclass(frozen=True, kw_only=True)
class Bulge(Section):
    """A thermal bulge."""

    height: Annotated[Number, _SHEET["bulge"]]
    width: Annotated[Number, _SHEET["bulge_width"]]
    growth: Annotated[Number, Quantity("s", 0.01, 1000, "time constant τ")]
    x: Annotated[Number, _SHEET["bulge_x"]] = 300.0
    y: Annotated[Number, _SHEET["bulge_y"]] = _USUAL.bulge_y


@dataclass(frozen=True, kw_only=True)
class Profile(Section):
    """A measured surface: CSV with the columns ``position_mm`` and ``height_mm``."""

    file: str  # relative to the scenario's
    spacing: Annotated[float, Quantity("mm", 0.01, 100, "to which it is resampled")] = 0.1


@dataclass(frozen=True, kw_only=True)
class Map(Section):
    """A measured surface: CSV with the columns ``x_mm``, ``y_mm`` and ``height_mm``, a regular grid."""

    file: str  # relative to the scenario's


@dataclass(frozen=True, kw_only=True)
class Sheet(Section):
    """The sheet's shape and motion."""

    tilt: Annotated[Number, _SHEET["tilt_x"]] = _USUAL.tilt_x
    tilt_y: Annotated[Number, _SHEET["tilt_y"]] = _USUAL.tilt_y
    length: Annotated[float, _SHEET["length"]] = _USUAL.length
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
