"""Sensor: gap → capacitance → oscillator → counted frequency, with its disturbances (Xi2023 eqs. 1–5).

Where the numbers come from: docs/physics.md#the-sensor.

Gap capacitance, a disc over a plane with its fringe field beside the body of the head::

    C5(h) = Cp + ε0·π(R² − rb²)/h + 2·ε0·R·max(0, ln(8πR/h) − 1)                                       [P], [C]

Oscillator (Colpitts, Xi2023 eq. 1): ``1/Cs = 1/(C3 + C1) + 1/(C2 + C0) + 1/C4 + 1/C5``, ``f = 1/(2π·sqrt(L·Cs))``.
With no series capacitors this is Xi2023 eq. 3. Contact (h ≤ 0) shorts the plate: oscillation stops, the reading is
invalid.

Counting (CN102528288A): whole oscillator periods that fit into the gate are timed with a 300 MHz clock. Either all at
once (a *total* count), or period by period and averaged (``mean`` of per-period frequencies, as the patent prints),
which adds a small bias because a mean of reciprocals is not the reciprocal of a mean.
"""

from typing import Annotated, NamedTuple

import numpy as np

from ..engine.lanes import U1, U2, U3, U4, bits, fma, gauss, logarithm, part, uniform
from ..engine.quantity import Quantity

EPSILON0 = 8.8541878128e-3
"""pF/mm, permittivity of vacuum."""

CLOCK = 300e6
"""Hz, counting clock (CN102528288A)."""

LEAST_GAP = 0.005
"""mm; an impulse cannot make the apparent gap smaller than this (only real contact stops the oscillator)."""

WIDEST = 12.0
"""mm, largest radius on which an edge is sensed (R + 1.5·h stops growing there)."""


class Params(NamedTuple):
    """A head and what disturbs it."""

    radius: float = 5.0  # mm, nozzle face R [A]
    bore: float = 1.0  # mm, radius rb of the bore [A]
    body: float = 10.0  # pF, body capacitance Cp [A]
    inductance: float = 168.0  # µH, preset "eq. 3 only": 10–50 pF → 3.88–1.74 MHz [C]
    series: float = 0.0  # 1/pF, 1/(C3+C1) + 1/(C2+C0) + 1/C4; 0 is Xi2023 eq. 3
    noise: Annotated[float, Quantity("pF", 0, 1, "capacitance noise, sigma", "[A] 0.5–5 fF")] = 1.0e-3
    jitter: Annotated[float, Quantity("1", 0, 1e-3, "relative oscillator noise per sample, sigma", "[A] 1–3e-6")] = 1e-6
    drift: Annotated[float, Quantity("1", -0.05, 0.05, "relative change of L·C when warm", "[A] 80 ppm/K · 20 K")] = 0.0
    warming: float = 1.7e-6  # share of the remaining drift per control period; T/600 s [A]
    impulses: float = 0.0  # probability that an impulse starts at a sample [A] 0.001–0.01
    impulse: Annotated[float, Quantity("mm", 0, 5, "apparent height at zero gap, A(h) = this/(1 + h/falloff)")] = 0.137
    falloff: Annotated[float, Quantity("mm", 0.01, 100, "gap at which half that height is left")] = 0.894
    spread: Annotated[float, Quantity("1", 0, 1, "relative spread of the height, uniform")] = 0.3
    longest: Annotated[float, Quantity("samples", 1, 50, "longest impulse, lengths uniform from 1")] = 1.0
    bursts: float = 0.0  # probability that a plasma burst starts at a sample [A]
    burst: Annotated[float, Quantity("pF", 0, 5, "largest burst, uniform from 0")] = 0.1
    burst_end: float = 0.05  # probability that a burst ends at a sample [A]
    plasma: Annotated[float, Quantity("pF", 0, 5, "constant offset while cutting", "[A] 0–0.1")] = 0.0


class Gate(NamedTuple):
    """How a frequency is counted (part of the controller's stack)."""

    length: Annotated[float, Quantity("ms", 0.05, 1.0, "gate length; the sample is tagged at its centre")] = 0.25
    mean: Annotated[
        float,
        Quantity("", 0, 1, "count", "CN102528288A", choices=("total", "mean")),
    ] = 0.0  # total: one count of all periods; mean: average of per-period frequencies


class State(NamedTuple):
    """What the head and its disturbances remember."""

    warm: float = 0.0  # share of the drift reached, 0–1
    remaining: float = 0.0  # samples that the current impulse still lasts
    hit: float = 0.0  # its relative height, signed
    offset: float = 0.0  # pF, current plasma burst


@part
def capacitance(p, gap, cover):
    """C5 in pF at ``gap`` (mm, > 0) when the share ``cover`` of the plate has sheet under it."""
    near = 1.0 / gap
    plate = EPSILON0 * 3.141592653589793 * (p.radius * p.radius - p.bore * p.bore) * near
    fringe = 2.0 * EPSILON0 * p.radius * max(0.0, logarithm(25.132741228718345 * p.radius * near) - 1.0)
    return fma(cover, plate + fringe, p.body)


@part
def oscillator(p, c5, detuning):
    """Frequency in Hz for C5 in pF (Xi2023 eqs. 1 and 3); ``detuning`` is the relative change of L·C."""
    total = c5 / fma(c5, p.series, 1.0)
    return 1e9 / (6.283185307179586 * np.sqrt(p.inductance * total * (1.0 + detuning)))


@part
def sensing_radius(p, gap):
    """Radius of the disc on which an edge is felt, R + 1.5·h, mm (docs/physics.md#footprints)."""
    return min(p.radius + 1.5 * gap, WIDEST)


@part
def counted(gate, frequency, phase):
    """The frequency that the counter reports, Hz.

    Args:
        frequency: true frequency, Hz.
        phase: fraction of a clock period at which the gate opened, uniform in [0, 1).
    """
    periods = max(1.0, np.floor(gate.length * 1e-3 * frequency))
    ticks = np.floor(periods * CLOCK / frequency + phase)
    total = periods * CLOCK / ticks
    # Adjacent per-period counts differ by at most one tick: `more` of them have short + 1, the rest short.
    short = np.floor(ticks / periods)
    more = ticks - short * periods
    mean = CLOCK * ((periods - more) / short + more / (short + 1.0)) / periods
    return mean if gate.mean > 0.5 else total


@part
def step(p, s, gate, gap, cover, spatter, key, n):
    """One sample.

    Args:
        p, s, gate: :class:`Params`, :class:`State`, :class:`Gate`.
        gap: mean true gap over the gate, mm; the curvature of f(h) over a gate is neglected (below 0.1 µm at 100 mm/s).
        cover: share of the plate over sheet, 0–1.
        spatter: factor on the rate of impulses.
        key, n: random stream and sample number.

    Returns:
        ``(state, frequency)``, Hz; 0 when the nozzle touches the sheet.
    """
    at = n * (U4 + U2)  # six words a sample
    a, b, c = bits(key, at), bits(key, at + U1), bits(key, at + U2)
    d, e, g = bits(key, at + U3), bits(key, at + U4), bits(key, at + U4 + U1)
    phase, fill = uniform(bits(a, U1)), uniform(bits(b, U1))

    starts = uniform(c) < p.impulses * spatter and s.remaining <= 0.0
    height = 1.0 + p.spread * (2.0 * uniform(d) - 1.0)
    hit = (height if uniform(bits(d, U1)) < 0.5 else -height) if starts else s.hit
    remaining = 1.0 + np.floor(uniform(e) * p.longest) if starts else s.remaining
    h = max(gap, 0.0)
    pulse = hit * p.impulse / (1.0 + h / p.falloff) if remaining > 0.0 else 0.0

    burst = s.offset if uniform(g) >= p.burst_end else 0.0
    offset = p.burst * uniform(bits(g, U1)) if uniform(bits(g, U2)) < p.bursts else burst

    warm = s.warm + (1.0 - s.warm) * p.warming
    c5 = capacitance(p, max(h + pulse, LEAST_GAP), cover) + p.plasma + offset + p.noise * gauss(a, fill)
    f = oscillator(p, c5, p.drift * warm) * (1.0 + p.jitter * gauss(b, phase))
    reading = counted(gate, f, phase) if gap > 0.0 else 0.0
    return State(warm=warm, remaining=remaining - 1.0, hit=hit, offset=offset), reading


EQ3 = Params()
"""Preset "eq. 3 only": L 168 µH, 3.88–1.74 MHz for C5 = 10–50 pF (the printed band is missed by 4.3 %)."""

EQ1 = Params(inductance=150.0, series=3.0 / 1000.0)
"""Preset "full eq. 1": L 150 µH, C2 = C3 = C4 = 1 nF, printed band 1.665–4.053 MHz for C5 = 74.7–10.6 pF."""

PRESETS = {"eq3": EQ3, "eq1": EQ1}
