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
    """The sensor's noise and disturbances (docs/physics.md#disturbances); the head is one of the pool's."""

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
    nominal: bool = False  # the nominal head, instead of one drawn from the pool
    table: str | None = None  # CSV with frequency_Hz and height_mm, in place of the head's own calibration
    signal: str | None = None  # CSV with frequency_Hz, one row each ms, in place of what the sensor would count


@dataclass(frozen=True, kw_only=True)
class Gantry(Section):
    """The X and Y axes, see ``plant/xy_axes.py``; defaults are Wu's."""

    preset: Literal["wu", "modern"] = "wu"
    literal: bool = False  # Wu's difference equation, which sums sampled speeds
    x_plus: Annotated[Number, _XY["x_plus"]] = _USUAL_XY.x_plus
    x_minus: Annotated[Number, _XY["x_minus"]] = _USUAL_XY.x_minus
    y_plus: Annotated[Number, _XY["y_plus"]] = _USUAL_XY.y_plus
    y_minus: Annotated[Number, _XY["y_minus"]] = _USUAL_XY.y_minus
    slower: Annotated[Number, Quantity("1", 0.2, 5, "time constants of the drives, of the nominal ones")] = 1.0
    travel_x: Annotated[float, Quantity("mm", 10, 1e5, "", "Wu")] = 1500.0
    travel_y: Annotated[float, Quantity("mm", 10, 1e5, "", "Wu")] = 1000.0


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
