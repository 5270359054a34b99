"""Cut: from beam, speed and errors to melt margin, roughness, dross and kerf, once per control period.

The streaming form of the quality model (PHYSICS §4); :mod:`envs.quality` holds the full one, which deposits the beam's
energy along the whole trajectory. Here the energy's lateral density at a depth z is taken in closed form:

* Beam radius ``w(z)² = w0²·(1 + ((z − zf)² + κ·az²)/zR²)``, focus depth ``zf``, amplitude ``az`` of its dither; κ is
  such that ∫p² comes out for a uniformly swept focus.
* A Gaussian of σ = w/2 swept by a sine of amplitude a has ``∫p² = h(a/σ)/(2σ√π)``, h(r) = 2F2(½, ½; 1, 1; −r²)
  (:func:`flattened`). Its inverse is the effective width ``w_eff``; ``φ(z)`` is ∫p² over its mean over the depth.
* Front length ``Lx = 4·sqrt(w0²/4 + ax²/2)``, absorptivity A = Fresnel at the angle atan(t/Lx).
* Melt margin ``m(z) = (A·P·φ/t + burn·v·w_eff)/(v·w_eff·melt + 4λΔT·(Pe/2)^0.36)``, ``Pe = v·w_eff/(2κ)``. Its
  mean m̄ over the depth balances what is absorbed with what must be melted: m̄ < 1 does not cut through. (At the bottom
  alone m may lie below 1, also in cuts that are known to succeed: melt from above carries heat down.)
* Roughness ``Rz² = (R0·m̄^−n·G^−γ)² + R_geo² + (k_h·rms e_h)² + (R_u·max(0, m̄ − m_u))²``, not below the limit of ISO
  9013's range 1. The last term is the upturn at very low speed, where the melt burns beyond the beam;
  γ lets the gas smooth the cut.
* Dross ``a·m_b^−q·G^−½``, m_b over the bottom fifth, gas ``G = (p/p0)/(1 + (e_h/hs)²)`` with its own hs on either side.
* Kerf at a depth: ``2·sqrt((4 + 2·ln m)·σ² + a² + c·a·σ)``, c = 3.16·r²/(r² + 2.4) (fitted to the full form); it is the
  paper's 2·ω0 for m = 1 without dither.
* A dither so slow that the front does not average it, v/f > Lx, counts in these densities with the amplitude
  ``a·sqrt(1 − exp(−(kLx)²/12))``, k = 2πf/v.

R_geo, what the path itself writes on the edge, is the mean of five peak-to-valleys of the contour error behind a high-
pass of ``CUTOFF`` mm, plus that of the dither as far as the beam does not average it.

What it misses: heat that builds up in corners and narrow webs, striations as a process of their own, the gas' dynamics,
preheating by neighbouring cuts. Roughness and dross are proxies: calibrated on three published cuts (C45) or assumed
(the others), validated nowhere.
"""

from typing import NamedTuple

import numpy as np

from .lanes import clip, exponential, fma, logarithm, part, power

CUTOFF = 2.5
"""mm, wavelength above which a contour error counts as waviness (λc of ISO 4288 for Rz 10–50 µm)."""

LENGTH = 0.8
"""mm, over which a peak-to-valley is taken; five of them make R_geo and its rms e_h."""

_KAPPA = 0.22
_SQRT_PI = 1.772453850905516
_SLOWEST = 0.05  # mm/s; slower is a standstill


class Params(NamedTuple):
    """A material, its recipe and the model's coefficients. Defaults: C45, 10 mm, oxygen."""

    thickness: float = 10.0  # mm [S] Huang2024
    focus: float = 3.333  # mm below the surface, t/3 [S] CN102528288A
    w0: float = 0.075  # mm, beam radius in focus [A]
    zr: float = 2.5  # mm, Rayleigh length [A]
    melt: float = 9.504  # J/mm³, ρ(c·ΔT + L) [P] steel
    burn: float = 4.94  # J/mm³, share of the oxidation's heat that helps [C]
    conduct: float = 198.0  # W/mm, 4λΔT [P]
    diffusivity: float = 7.0  # mm²/s [P]
    refraction: float = 3.81  # refractive index [P]
    extinction: float = 4.44  # [P]
    rough: float = 0.170  # mm, R0 [C]
    rough_power: float = 3.494  # n [C]
    rough_gas: float = 0.25  # γ [A]
    follow: float = 0.10  # k_h [A]
    upturn: float = 0.02  # mm, R_u [A]
    upturn_from: float = 2.5  # m_u [A]
    floor: float = 0.016  # mm, 10 + 0.6·t µm [P] ISO 9013
    dross: float = 0.919  # mm, a [C]
    dross_power: float = 0.149  # q [C]
    pressure: float = 1.0  # of the nominal gas pressure
    gas_above: float = 1.0  # mm, hs [A]
    gas_below: float = 0.5  # mm, hs [A]


class Beam(NamedTuple):
    """What the process settings make of the beam."""

    power: float = 0.0  # W
    absorbed: float = 0.0  # absorptivity of the front
    across: float = 0.0  # mm, amplitude of the dither
    length: float = 0.0  # mm, of the front
    sweep2: float = 0.0  # mm², κ·az²
    focus: float = 0.0  # mm, offset, up positive
    ripple: float = 0.0  # mm, what the dither writes on the edge, peak to valley, if it is not averaged
    frequency: float = 0.0  # Hz


class State(NamedTuple):
    """What the last millimetres of the cut have been like."""

    base: float = 0.0  # mm, waviness of the contour error
    high: float = 0.0  # mm, largest and smallest since the present length began
    low: float = 0.0
    way: float = 0.0  # mm of the present length
    lengths: float = 0.0  # how many are complete, up to 5
    geometric: float = 0.0  # mm, mean peak-to-valley
    error2: float = 0.0  # mm², mean square of the standoff error
    weight: float = 0.0  # mm of cut that it rests on


class Figures(NamedTuple):
    """The cut now."""

    margin: float = 0.0  # melt margin m̄, mean over the depth
    roughness: float = 0.0  # mm, Rz
    dross: float = 0.0  # mm
    kerf_top: float = 0.0  # mm
    kerf_bottom: float = 0.0  # mm
    taper: float = 0.0  # mm, perpendicularity u
    through: float = 0.0  # 1: cut through


class _Depth(NamedTuple):
    """One depth of the cut."""

    density: float = 0.0  # 1/mm, ∫p²
    sigma2: float = 0.0  # mm², of the beam


@part
def fresh():
    """Nothing cut yet."""
    return State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@part
def nothing():
    """No cut."""
    return Figures(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@part
def flattened(r):
    """h(r) = 2F2(½, ½; 1, 1; −r²) to 0.6 % for r ≤ 16: how a sine of r·σ flattens a Gaussian of σ."""
    q = r * r
    return fma(q, fma(q, 0.58093949, 2.18316201), 1.0) / fma(q, fma(q, fma(r, 0.26214703, 0.9331167), 2.46994122), 1.0)


@part
def absorptivity(p, length):
    """Share of the beam that a front of this length (mm) over the thickness absorbs, unpolarised (Fresnel, |n| ≫ 1)."""
    c = length / np.sqrt(length * length + p.thickness * p.thickness)  # cosine of the angle of incidence
    k2 = p.extinction * p.extinction
    s_less, s_more, p_less, p_more = p.refraction - c, p.refraction + c, p.refraction - 1.0 / c, p.refraction + 1.0 / c
    return 1.0 - 0.5 * (
        (s_less * s_less + k2) / (s_more * s_more + k2) + (p_less * p_less + k2) / (p_more * p_more + k2)
    )


@part
def beam(p, power, along, across, z, focus, frequency):
    """The :class:`Beam` of process settings: power in W, amplitudes of the sines of the dither in mm, focus offset in
    mm, its frequency in Hz."""
    length = 4.0 * np.sqrt(0.25 * p.w0 * p.w0 + 0.5 * along * along)
    return Beam(power, absorptivity(p, length), across, length, _KAPPA * 1.5 * z * z, focus, 2.0 * across, frequency)


@part
def _depth(p, b, across, zf, z):
    w2 = p.w0 * p.w0 * (1.0 + ((z - zf) * (z - zf) + b.sweep2) / (p.zr * p.zr))
    w = np.sqrt(w2)
    return _Depth(flattened(2.0 * across / w) / (w * _SQRT_PI), 0.25 * w2)


@part
def _margin(p, absorbed, v, density, mean):
    """Melt margin at one depth; ``absorbed`` in W/mm."""
    width = 1.0 / density
    peclet = 0.25 * v * width / p.diffusivity
    needed = fma(v * width, p.melt, p.conduct * power(peclet, 0.36))
    return (absorbed * density / mean + v * width * p.burn) / needed


@part
def _kerf(margin, sigma2, across):
    a2 = across * across
    swept = 3.16 * across * np.sqrt(sigma2) * a2 / (a2 + 2.4 * sigma2)
    return 2.0 * np.sqrt(max(0.0, 4.0 + 2.0 * logarithm(max(margin, 1e-6))) * sigma2 + a2 + swept)


@part
def gas(p, error):
    """How well the gas blows the kerf out, 1 at the nominal standoff; ``error`` of the standoff in mm."""
    x = error / (p.gas_above if error > 0.0 else p.gas_below)
    return p.pressure / (1.0 + x * x)


@part
def remembered(s, way, error, contour):
    """The state after ``way`` mm of cut with this standoff error and contour error, mm."""
    keep = exponential(-way / (5.0 * LENGTH))
    weight = s.weight + way
    share = max(1.0 - keep, way / max(weight, 1e-9)) if way > 0.0 else 0.0
    passed = way * 6.283185307179586 / CUTOFF
    base = s.base + (contour - s.base) * passed / (1.0 + passed) if s.weight > 0.0 else contour
    rest = contour - base
    began = s.way <= 0.0
    high, low = (rest if began else max(s.high, rest)), (rest if began else min(s.low, rest))
    along = s.way + way
    full = along >= LENGTH
    lengths = min(s.lengths + 1.0, 5.0) if full else s.lengths
    geometric = s.geometric + (high - low - s.geometric) / lengths if full else s.geometric
    return State(
        base, high, low, 0.0 if full else along, lengths, geometric, s.error2 + share * (error * error - s.error2),
        weight,
    )  # fmt: skip


@part
def step(p, b, s, speed, error, contour, dt):
    """The cut of one control period.

    Args:
        p, b, s: :class:`Params`, :class:`Beam`, :class:`State`.
        speed: mm/s of the carrier.
        error: mm, standoff error, actual − nominal.
        contour: mm, contour error beside the path.
        dt: s.

    Returns:
        ``(state, figures)``.
    """
    v, t = max(speed, _SLOWEST), p.thickness
    e = clip(error, -10.0, 10.0)
    s = remembered(s, speed * dt if speed > _SLOWEST else 0.0, e, contour)
    zf = p.focus - e - b.focus
    k = 6.283185307179586 * b.frequency / v
    a = b.across * np.sqrt(1.0 - exponential(-k * k * b.length * b.length / 12.0))
    d0, d1, d2 = _depth(p, b, a, zf, 0.0), _depth(p, b, a, zf, 0.25 * t), _depth(p, b, a, zf, 0.5 * t)
    d3, d4 = _depth(p, b, a, zf, 0.75 * t), _depth(p, b, a, zf, t)
    mean = (7.0 * (d0.density + d4.density) + 32.0 * (d1.density + d3.density) + 12.0 * d2.density) / 90.0
    absorbed = b.absorbed * b.power / t
    m0, m1 = _margin(p, absorbed, v, d0.density, mean), _margin(p, absorbed, v, d1.density, mean)
    m2, m3 = _margin(p, absorbed, v, d2.density, mean), _margin(p, absorbed, v, d3.density, mean)
    m4 = _margin(p, absorbed, v, d4.density, mean)
    margin = (7.0 * (m0 + m4) + 32.0 * (m1 + m3) + 12.0 * m2) / 90.0
    bottom = 0.4 * m3 + 0.6 * m4
    log_g = logarithm(gas(p, e))

    melted = p.rough * exponential(-p.rough_power * logarithm(max(margin, 0.02)) - p.rough_gas * log_g)
    # The beam averages a ripple of wavenumber k along the path by exp(−(kσ)²/2).
    x = 0.5 * k * p.w0
    written = s.geometric + b.ripple * exponential(-0.5 * x * x)
    burnt = p.upturn * max(0.0, margin - p.upturn_from)
    rough2 = melted * melted + written * written + p.follow * p.follow * s.error2 + burnt * burnt
    dross = p.dross * exponential(-p.dross_power * logarithm(max(bottom, 0.02)) - 0.5 * log_g)
    top, low = _kerf(m0, d0.sigma2, a), _kerf(m4, d4.sigma2, a)
    return s, Figures(
        margin, max(np.sqrt(rough2), p.floor), dross, top, low, 0.5 * abs(top - low), 1.0 if margin >= 1.0 else 0.0
    )
