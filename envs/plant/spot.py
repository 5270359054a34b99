"""Spot: the galvo and the piezo that dither it fast about the carrier path (Huang2024 eqs. 9, 12 and 13).

A dither of frequency f has the phase φ = 2πft and one of the three shapes of eq. 12::

    circular    x = r·cos φ                y = r·sin φ                  z = 2φ
    hat         x = a·sin φ + b·φ·cos φ    y = −d·φ·sin φ + c·cos φ     z = φ
    elliptical  x = a·cos φ                y = b·sin φ                  z = 2φ

As printed z grows without bound; here the ramp is folded, up and down evenly, to ±``z``. The hat's φ in the factors is
folded in the same way over its five turns and scaled so that the spiral reaches the commanded amplitudes. Frequencies
lie far above the control rate, so the optics are phasors: in the steady state the galvo, a second-order system, makes
of each amplitude A the amplitude A·|H(f)| and lags by its phase; the piezo likewise, with a hysteresis whose loop
delays it further. Changes of the dither are immediate.

``V = A·f`` is the scan head's speed in Huang2024 (eq. 2); the peak speed of a sine is 2πAf. Both are given
(:func:`speeds`). ±1 mm at 2 kHz and ±5 mm at 4 kHz would be 1.6e4 g and 3.2e5 g for a lens: z is a shift of the focus
by optics, not by a mass. Eqs. 10 and 11 are not reproducible as printed: with eq. 9 they collapse to expressions whose
dimensions disagree; where power and speed must be coupled, the cut uses the line energy P/(v·2ω0).
"""

from typing import Annotated, NamedTuple

import numpy as np

from ..engine.lanes import clip, part, sine
from ..engine.quantity import InvalidInput, Quantity

CIRCULAR, HAT, ELLIPTICAL = 0, 1, 2
SHAPES = ("circular", "hat", "elliptical")
TURNS = 5.0
"""Turns of the hat's spiral, φ ∈ [0, 10π] (Huang2024 eq. 12)."""

_PI = 3.141592653589793


class Params(NamedTuple):
    """The optics."""

    galvo: Annotated[float, Quantity("Hz", 100, 1e5, "natural frequency of the galvo")] = 5000.0
    galvo_zeta: float = 0.7  # [A]
    galvo_range: Annotated[float, Quantity("mm", 0.001, 5, "±, along each axis", "[S] Huang2024 Table 1")] = 0.3
    piezo: Annotated[float, Quantity("Hz", 100, 1e5, "natural frequency of the focus drive")] = 8000.0
    piezo_zeta: float = 0.7  # [A]
    piezo_range: Annotated[float, Quantity("mm", 0.01, 50, "±", "[S] Huang2024 Table 1, thick stock")] = 5.0
    hysteresis: Annotated[
        float, Quantity("1", 0, 0.3, "width of the piezo's loop over its stroke", "[A] closed loop")
    ] = 0.02
    highest: Annotated[float, Quantity("Hz", 1, 1e5, "frequency of the dither", "[S] Huang2024 Table 1")] = 4000.0
    shape: float = CIRCULAR
    along: bool = False  # x along the path instead of the machine's x


class Command(NamedTuple):
    """What the dither is asked to be."""

    frequency: float = 0.0  # Hz; 0: none
    x: float = 0.0  # mm, amplitudes
    y: float = 0.0
    z: float = 0.0  # mm of focus
    focus: float = 0.0  # mm, offset of the focus, up positive


class Realised(NamedTuple):
    """What the optics make of it."""

    frequency: float = 0.0  # Hz
    x: float = 0.0  # mm, amplitudes
    y: float = 0.0
    z: float = 0.0
    lag: float = 0.0  # rad, of x and y
    lag_z: float = 0.0  # rad
    focus: float = 0.0  # mm


@part
def response(frequency, natural, zeta):
    """|H| of a second-order system of unit gain at ``frequency`` Hz."""
    r = frequency / natural
    a, b = 1.0 - r * r, 2.0 * zeta * r
    return 1.0 / np.sqrt(a * a + b * b)


@part
def phase_lag(frequency, natural, zeta):
    """Its phase lag, rad, 0 to π."""
    r = frequency / natural
    return np.arctan2(2.0 * zeta * r, 1.0 - r * r)


@part
def played(wanted, before, width):
    """A play of ``width`` mm between what the piezo is told and where its focus goes (hysteresis of slow moves)."""
    return clip(before, wanted - 0.5 * width, wanted + 0.5 * width)


@part
def realised(p, c, before):
    """The optics' answer to a command; ``before`` is the focus offset so far, mm."""
    f = clip(c.frequency, 0.0, p.highest)
    on = 1.0 if f > 0.0 else 0.0
    xy, z = on * response(f, p.galvo, p.galvo_zeta), on * response(f, p.piezo, p.piezo_zeta)
    wanted = clip(c.focus, -p.piezo_range, p.piezo_range)
    return Realised(
        frequency=f,
        x=xy * clip(c.x, 0.0, p.galvo_range),
        y=xy * clip(c.y, 0.0, p.galvo_range),
        z=z * clip(c.z, 0.0, p.piezo_range),
        lag=on * phase_lag(f, p.galvo, p.galvo_zeta),
        lag_z=on * (phase_lag(f, p.piezo, p.piezo_zeta) + p.hysteresis),
        focus=played(wanted, before, 2.0 * p.hysteresis * p.piezo_range),
    )


@part
def folded(u):
    """A ramp folded to [−1, 1]: a triangle of period 1 in ``u`` that rises from 0."""
    v = u + 0.25 - np.floor(u + 0.25)
    return 4.0 * v - 1.0 if v < 0.5 else 3.0 - 4.0 * v


@part
def offset(p, r, t):
    """Where the spot is beside the carrier path ``t`` seconds after the dither began: ``(x, y, z)``, mm (eq. 12)."""
    phase = 2.0 * _PI * r.frequency * t - r.lag
    s, c = sine(phase), sine(phase + 0.5 * _PI)
    if p.shape == HAT:
        grown = abs(folded(r.frequency * t / (2.0 * TURNS)))
        x, y = r.x * (0.2 * s + 0.8 * grown * c), r.y * (0.2 * c - 0.8 * grown * s)
        turn = r.frequency * t / (2.0 * TURNS)
    else:
        x, y = r.x * c, r.y * s
        turn = r.frequency * t
    return x, y, r.z * folded(turn - r.lag_z / (2.0 * _PI)) + r.focus


@part
def spread(p, r, tx, ty):
    """Amplitudes of the sines that spread the spot as much along and across the path: ``(along, across, z)``, mm.

    √2 of the RMS deviation; the folded ramp of z counts as the sine of its variance.
    """
    # The hat's mean square is that of 0.2·sin + 0.8·g·cos with g uniform in [0, 1].
    share = np.sqrt(0.04 + 0.64 / 3.0) if p.shape == HAT else 1.0
    x, y = share * r.x, share * r.y
    if p.along:
        along, across = x, y
    else:
        along = np.sqrt((x * tx) * (x * tx) + (y * ty) * (y * ty))
        across = np.sqrt((x * ty) * (x * ty) + (y * tx) * (y * tx))
    return along, across, r.z * 0.816496580927726


# ----------------------------------------------------------------------------------------------- figures for people


def speeds(amplitude, frequency):
    """``(A·f, 2πAf)``: the scan head's speed as Huang2024 eq. 2 has it, and the peak speed of the sine, mm/s."""
    return amplitude * frequency, 2.0 * np.pi * amplitude * frequency


def angles(depth, spot, beta):
    """``(α, θ)`` of Huang2024 eq. 9, rad: sin α = (l/ω)·sin β, θ = α + β.

    Args:
        depth: l, mm.
        spot: ω, mm.
        beta: β, rad.

    Raises:
        InvalidInput: |l·sin β/ω| > 1, where eq. 9 has no solution.
    """
    sine_of = np.asarray(depth) / np.asarray(spot) * np.sin(beta)
    if np.any(np.abs(sine_of) > 1.0):
        worst = float(np.abs(sine_of).max())
        raise InvalidInput(f"Huang2024 eq. 9 needs |l·sin β/ω| ≤ 1; it is {worst:.3g}")
    alpha = np.arcsin(sine_of)
    return alpha, alpha + beta


def offsets(p, r, turn):
    """:func:`offset` for arrays: where the spot is after ``turn`` turns of the dither."""
    phase = 2.0 * np.pi * turn - r.lag
    s, c = np.sin(phase), np.cos(phase)
    ramp = turn - r.lag_z / (2.0 * np.pi)
    if p.shape == HAT:
        grown = np.abs(_folded(turn / (2.0 * TURNS)))
        x, y = r.x * (0.2 * s + 0.8 * grown * c), r.y * (0.2 * c - 0.8 * grown * s)
        ramp = turn / (2.0 * TURNS) - r.lag_z / (2.0 * np.pi)
    else:
        x, y = r.x * c, r.y * s
    return x, y, r.z * _folded(ramp) + r.focus


def _folded(u):
    v = (u + 0.25) % 1.0
    return np.where(v < 0.5, 4.0 * v - 1.0, 3.0 - 4.0 * v)


def check(p, c):
    """Raises :class:`InvalidInput` for a dither that the optics cannot do."""
    for name, value, most in (
        ("frequency", c.frequency, p.highest),
        ("x", c.x, p.galvo_range),
        ("y", c.y, p.galvo_range),
        ("z", c.z, p.piezo_range),
        ("focus", abs(c.focus), p.piezo_range),
    ):
        if not 0.0 <= value <= most:
            unit = "Hz" if name == "frequency" else "mm"
            raise InvalidInput(f"dither.{name} = {value} {unit} is out of the optics' range; at most {most} {unit}")
