"""The machine in a scenario: Z axis, sensor, X and Y axes, optics."""

# ruff: noqa: RUF009  (the distributions that are defaults are frozen)

from dataclasses import dataclass
from typing import Annotated, Literal

from ..engine.quantity import Quantity, quantities
from ..plant import sensor, sheet, spot, xy_axes, z_axis
from .distributions import Choice, LogUniform, Number, Uniform, bounds
from .section import Section

_Z, _USUAL_Z = quantities(z_axis.Params), z_axis.Params()
_HEAD, _USUAL_HEAD = quantities(sensor.Params), sensor.Params()
_XY, _USUAL_XY = quantities(xy_axes.Params), xy_axes.Params()
_OPTICS, _USUAL_OPTICS = quantities(spot.Params), spot.Params()


@dataclass(frozen=True, kw_only=True)
class Axis(Section):
    """The Z axis; defaults are the following suite's plants (docs/physics.md#the-z-axis)."""

    bandwidth: Annotated[Number, Quantity("Hz", 5, 500, "velocity loop")] = Uniform(uniform=(50, 120))
    zeta: Annotated[Number, _Z["zeta"]] = Uniform(uniform=(0.6, 1.0))
    dead_time: Annotated[Number, Quantity("s", 0, 0.02, "command to drive")] = Choice(choice=(0.001, 0.002))
    latency: Annotated[Number, Quantity("s", 0, 0.002, "of computing and field bus, beside the dead time")] = Uniform(
        uniform=(0.0001, 0.0009)
    )
    acceleration: Annotated[Number, _Z["acceleration"]] = Uniform(uniform=(10_000, 18_000))
    jerk: Annotated[Number, _Z["jerk"]] = _USUAL_Z.jerk
    speed: Annotated[Number, _Z["speed"]] = _USUAL_Z.speed
    resonance: Annotated[Number, Quantity("Hz", 10, 1000, "structural mode")] = Uniform(uniform=(60, 150))
    resonance_zeta: Annotated[Number, _Z["zeta_r"]] = _USUAL_Z.zeta_r
    compliance: Annotated[Number, _Z["compliance"]] = _USUAL_Z.compliance
    friction: Annotated[Number, _Z["friction"]] = Uniform(uniform=(600, 1000))
    bristle: Annotated[Number, _Z["bristle"]] = Uniform(uniform=(0.002, 0.010))
    stiction: Annotated[Number, _Z["stiction"]] = Uniform(uniform=(1.2, 1.6))
    stribeck: Annotated[Number, _Z["stribeck"]] = Uniform(uniform=(1, 5))
    backlash: Annotated[Number, _Z["backlash"]] = _USUAL_Z.backlash
    encoder: Annotated[Number, _Z["encoder"]] = _USUAL_Z.encoder
    dac_bits: Annotated[Number, Quantity("bit", 0, 24, "of ±speed; 0: ideal")] = 16.0

    def __post_init__(self) -> None:
        super().__post_init__()
        shortest = z_axis.SHORTEST_BRISTLE
        given = self.bristle.choice if isinstance(self.bristle, Choice) else [bounds(self.bristle)[0]]
        some = bounds(self.bristle)[1] > 0
        for each in given:
            if some and each < shortest and not (each == 0 and isinstance(self.bristle, Choice)):
                raise ValueError(f"bristle = {each} is out of range; allowed: 0, or {shortest:g} to 0.1 mm")


@dataclass(frozen=True, kw_only=True)
class Head(Section):
    """The sensor: plate, nozzle, oscillator, noise, disturbances (docs/physics.md#disturbances); a head of the pool."""

    plate: Annotated[
        float, Quantity("mm", sheet.FOOTPRINT, sensor.WIDEST, "radius of the plate's footprint; the score's is 2 mm")
    ] = sheet.PLATE
    noise: Annotated[Number, _HEAD["noise"]] = LogUniform(log_uniform=(5e-4, 5e-3))
    jitter: Annotated[Number, _HEAD["jitter"]] = _USUAL_HEAD.jitter
    drift: Annotated[Number, _HEAD["drift"]] = _USUAL_HEAD.drift
    warming: Annotated[Number, Quantity("s", 1, 1e5, "time constant of the drift")] = 600.0
    impulses: Annotated[Number, Quantity("1/s", 0, 500, "rate of impulses")] = 2.0
    impulse_samples: Annotated[Number, _HEAD["longest"]] = _USUAL_HEAD.longest
    impulse_height: Annotated[Number, _HEAD["impulse"]] = _USUAL_HEAD.impulse
    impulse_falloff: Annotated[Number, _HEAD["falloff"]] = _USUAL_HEAD.falloff
    impulse_spread: Annotated[Number, _HEAD["spread"]] = _USUAL_HEAD.spread
    bursts: Annotated[Number, Quantity("1/s", 0, 100, "rate of plasma bursts")] = 0.0
    burst: Annotated[Number, _HEAD["burst"]] = _USUAL_HEAD.burst
    burst_length: Annotated[Number, Quantity("s", 0.001, 10, "mean length of a burst")] = 0.02
    plasma: Annotated[Number, _HEAD["plasma"]] = _USUAL_HEAD.plasma
    oscillator: Literal["eq3", "eq1"] = "eq3"  # preset: without or with the series capacitors of Xi2023 eq. 1
    face: Annotated[Number, Quantity("mm", 3, 24, "diameter of the nozzle's face, the plate that senses")] | None = None
    bore: Annotated[Number, Quantity("mm", 0.2, 8, "diameter of the nozzle's bore")] | None = None
    body: Annotated[Number, Quantity("pF", 1, 100, "capacitance of the head's body")] | None = None
    inductance: Annotated[Number, Quantity("µH", 5, 5000, "of the oscillator's coil")] | None = None
    nominal: bool = False  # the nominal head, instead of one drawn from the pool
    table: str | None = None  # CSV with frequency_Hz and height_mm, in place of the head's own calibration
    signal: str | None = None  # CSV with frequency_Hz, one row each ms, in place of what the sensor would count

    def __post_init__(self) -> None:
        super().__post_init__()
        widest, narrowest = bounds(self.bore or 2 * _USUAL_HEAD.bore), bounds(self.face or 2 * _USUAL_HEAD.radius)
        if widest[1] > 0.8 * narrowest[0]:
            raise ValueError(
                f"bore = {widest[1]:g} is out of range; allowed: 0.8 of the face, {0.8 * narrowest[0]:g} mm"
            )

    @property
    def geometry(self) -> dict[str, Number]:
        """What it says of nozzle and oscillator in place of the preset's, by key."""
        said = {name: getattr(self, name) for name in GEOMETRY}
        return {name: number for name, number in said.items() if number is not None}


GEOMETRY = ("face", "bore", "body", "inductance")
"""Keys of a head that make it one of the user's own, with tables of its own."""

DISTURBANCES = (
    *("drift", "warming", "impulses", "impulse_samples", "impulse_height", "impulse_falloff", "impulse_spread"),
    *("bursts", "burst", "burst_length", "plasma", "signal"),
)
"""Keys of a head that tell what happens to it. A scenario that says them is about them, whatever machine cuts it."""


@dataclass(frozen=True, kw_only=True)
class Gantry(Section):
    """The X and Y axes, see ``plant/xy_axes.py``; defaults are Wu's."""

    preset: Literal["wu", "modern"] = "wu"  # loops, time constants and limits that are not said below
    literal: bool = False  # Wu's difference equation, which sums sampled speeds
    x_plus: Annotated[Number, _XY["x_plus"]] = _USUAL_XY.x_plus
    x_minus: Annotated[Number, _XY["x_minus"]] = _USUAL_XY.x_minus
    y_plus: Annotated[Number, _XY["y_plus"]] = _USUAL_XY.y_plus
    y_minus: Annotated[Number, _XY["y_minus"]] = _USUAL_XY.y_minus
    slower: Annotated[Number, Quantity("1", 0.2, 5, "time constants of the drives, of the nominal ones")] = 1.0
    t1: Annotated[Number, Quantity("s", 1e-4, 0.5, "slower time constant of the drives")] | None = None
    t2: Annotated[Number, Quantity("s", 5e-5, 0.5, "quicker time constant")] | None = None
    speed: Annotated[float, Quantity("mm/s", 10, 5000, "limit of an axis")] | None = None
    acceleration: Annotated[float, Quantity("mm/s²", 100, 1e5, "limit of an axis")] | None = None
    travel_x: Annotated[float, Quantity("mm", 10, 1e5, "of x", "Wu")] = 1500.0
    travel_y: Annotated[float, Quantity("mm", 10, 1e5, "of y", "Wu")] = 1000.0


@dataclass(frozen=True, kw_only=True)
class Optics(Section):
    """Galvo and piezo that dither the spot, see ``plant/spot.py``."""

    galvo: Annotated[Number, _OPTICS["galvo"]] = _USUAL_OPTICS.galvo
    galvo_range: Annotated[float, _OPTICS["galvo_range"]] = _USUAL_OPTICS.galvo_range
    piezo: Annotated[Number, _OPTICS["piezo"]] = _USUAL_OPTICS.piezo
    piezo_range: Annotated[float, _OPTICS["piezo_range"]] = _USUAL_OPTICS.piezo_range
    hysteresis: Annotated[Number, _OPTICS["hysteresis"]] = _USUAL_OPTICS.hysteresis
    highest: Annotated[float, _OPTICS["highest"]] = _USUAL_OPTICS.highest
    shape: Literal["circular", "hat", "elliptical"] = "circular"  # of the dither (Huang2024 eq. 12)
    along: bool = False  # x of the dither along the path instead of along the machine's x
