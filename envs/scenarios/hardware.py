"""The machine in a scenario: Z axis, sensor, X and Y axes, optics."""

# ruff: noqa: RUF009  (the distributions that are defaults are frozen)

from dataclasses import dataclass
from typing import Annotated, Literal

from ..engine.quantity import Quantity, quantities
from ..plant import sensor, sheet, spot, z_axis
from .distributions import Choice, LogUniform, Number, Uniform, bounds
from .section import Section

_OPTICS, _USUAL_OPTICS = quantities(spot.Params), spot.Params()


@dataclass(frozen=True, kw_only=True)
class Axis(Section):
    """The Z axis; defaults are the following suite's plants (docs/physics.md#the-z-axis)."""

    bandwidth: Annotated[Number, Quantity("Hz", 5, 500, "velocity loop")] = Uniform(uniform=(50, 120))
    zeta: Annotated[Number, Quantity("1", 0.2, 2, "its damping ratio")] = Uniform(uniform=(0.6, 1.0))
    dead_time: Annotated[Number, Quantity("s", 0, 0.004, "command to drive")] = Choice(choice=(0.001, 0.002))
    latency: Annotated[Number, Quantity("s", 0, 0.002, "of computing and field bus, beside the dead time")] = Uniform(
        uniform=(0.0001, 0.0009)
    )
    acceleration: Annotated[Number, Quantity("mm/s²", 500, 1e5, "limit")] = Uniform(uniform=(10_000, 18_000))
    jerk: Annotated[Number, Quantity("mm/s³", 1e4, 1e8, "limit of the drive")] = 2e6
    speed: Annotated[Number, Quantity("mm/s", 10, 2000, "limit", "Xi2023")] = 500.0
    resonance: Annotated[Number, Quantity("Hz", 10, 1000, "structural mode")] = Uniform(uniform=(60, 150))
    resonance_zeta: Annotated[Number, Quantity("1", 0.005, 1, "its damping ratio")] = 0.05
    compliance: Annotated[Number, Quantity("1", 0, 1, "its share of the load path")] = 0.1
    friction: Annotated[Number, Quantity("mm/s²", 0, 1e4, "Coulomb friction over mass")] = Uniform(uniform=(600, 1000))
    bristle: Annotated[
        Number, Quantity("mm", 0, 0.1, "that Coulomb friction bends before it slides (LuGre); 0: viscous below 1 mm/s")
    ] = Uniform(uniform=(0.002, 0.010))
    stiction: Annotated[Number, Quantity("1", 1, 3, "static over Coulomb friction")] = Uniform(uniform=(1.2, 1.6))
    stribeck: Annotated[Number, Quantity("mm/s", 0.1, 100, "speed at which half that difference is gone")] = Uniform(
        uniform=(1, 5)
    )
    backlash: Annotated[Number, Quantity("mm", 0, 0.2, "free play, closed by gravity")] = 0.005
    encoder: Annotated[Number, Quantity("mm", 0, 0.1, "per count; 0: ideal")] = 1e-3
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
    noise: Annotated[Number, Quantity("pF", 0, 1, "capacitance noise, sigma")] = LogUniform(log_uniform=(5e-4, 5e-3))
    jitter: Annotated[Number, Quantity("1", 0, 1e-3, "relative oscillator noise per sample, sigma")] = 1e-6
    drift: Annotated[Number, Quantity("1", -0.05, 0.05, "relative change of L·C when warm")] = 0.0
    warming: Annotated[Number, Quantity("s", 1, 1e5, "time constant of the drift")] = 600.0
    impulses: Annotated[Number, Quantity("1/s", 0, 500, "rate of impulses")] = 2.0
    impulse_samples: Annotated[Number, Quantity("samples", 1, 50, "longest impulse, lengths uniform from 1")] = 1.0
    impulse_height: Annotated[
        Number, Quantity("mm", 0, 5, "apparent height at zero gap, A(h) = this/(1 + h/falloff)")
    ] = 0.137
    impulse_falloff: Annotated[Number, Quantity("mm", 0.01, 100, "see impulse_height")] = 0.894
    impulse_spread: Annotated[Number, Quantity("1", 0, 1, "relative spread of the height")] = 0.3
    bursts: Annotated[Number, Quantity("1/s", 0, 100, "rate of plasma bursts")] = 0.0
    burst: Annotated[Number, Quantity("pF", 0, 5, "largest burst")] = 0.1
    burst_length: Annotated[Number, Quantity("s", 0.001, 10, "mean length of a burst")] = 0.02
    plasma: Annotated[Number, Quantity("pF", 0, 5, "constant offset while cutting")] = 0.0
    oscillator: Literal["eq3", "eq1"] = "eq3"  # preset: without or with the series capacitors of Xi2023 eq. 1
    nominal: bool = False  # the nominal head, instead of one drawn from the pool
    table: str | None = None  # CSV with frequency_Hz and height_mm, in place of the head's own calibration
    signal: str | None = None  # CSV with frequency_Hz, one row each ms, in place of what the sensor would count


@dataclass(frozen=True, kw_only=True)
class Gantry(Section):
    """The X and Y axes, see ``plant/xy_axes.py``; defaults are Wu's."""

    preset: Literal["wu", "modern"] = "wu"
    literal: bool = False  # Wu's difference equation, which sums sampled speeds
    x_plus: Annotated[Number, Quantity("1", 0.2, 5, "gain of +x, of the nominal one")] = 1.0
    x_minus: Annotated[Number, Quantity("1", 0.2, 5, "gain of −x")] = 1.0
    y_plus: Annotated[Number, Quantity("1", 0.2, 5, "gain of +y")] = 1.0
    y_minus: Annotated[Number, Quantity("1", 0.2, 5, "gain of −y")] = 1.0
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
