"""Cut: from beam, speed and errors to melt margin, roughness, dross and kerf, once per control period.

The streaming form of the quality model (docs/physics.md#the-cut); :mod:`envs.figures.quality` holds the full one, which
deposits the beam's energy along the whole trajectory. Here the energy's lateral density at a depth z is taken in closed
form:

* Beam radius ``w(z)² = w0²·(1 + ((z − zf)² + κ·az²)/zR²)``, focus depth ``zf``, amplitude ``az`` of its dither; κ is
  such that ∫p² comes out for a uniformly swept focus.
* A Gaussian of σ = w/2 swept by a sine of amplitude a has ``∫p² = h(a/σ)/(2σ√π)``, h(r) = 2F2(½, ½; 1, 1; −r²)
  (:func:`flattened`). Its inverse is the effective width ``w_eff``; ``φ(z)`` is ∫p² over its mean over the depth.
* Front length ``Lx = 4·sqrt(w0²/4 + ax²/2)``, absorptivity A = Fresnel at the angle atan(t/Lx).
* Melt margin ``m(z) = (A·P·φ/t + burn·v·w_eff)/(v·w_eff·melt + 4λΔT·(Pe/2)^0.36)``, ``Pe = v·w_eff/(2κ)``. Its
  mean m̄ over the depth balances what is absorbed with what must be melted: m̄ < 1 does not cut through. (At the bottom
  alone m may lie below 1, also in cuts that are known to succeed: melt from above carries heat down.)
* Kerf at a depth: ``b = 2·sqrt((4 + 2·ln m)·σ² + a² + c·a·σ)``, c = 3.16·r²/(r² + 2.4) (fitted to the full form); it is
  the paper's 2·ω0 for m = 1 without dither.

Melt and gas leave through that kerf:

* Gas shears the melt down the walls as a film. What flows in at a depth u = z/t is v·z per width, so shear τ makes it
  ``δ = sqrt(2·μ·v·z/τ)`` thick; μ falls as the melt gets hotter, μ ∝ 1/m̂ [A], with
  ``1/m̂ = ∫(1 + carry·(1 − 2u))/m du``: the weakest depth counts most, and the upper half more than the lower, which it
  feeds with heat.
* The film leaves the gas a slot of width ``g = b − 2δ`` and depth t. Nozzle pressure is spent on the inlet, on wall
  friction, and on the loss of a slot that widens downwards (Borda–Carnot); what is left drives the flow::

      K = 1/(1 + slot·∫t/g du + max(0, b_bottom/b_top − 1)²),   τ ∝ K

  With friction factor f and inlet loss ½, ``slot = 2f/1.5``; over a wavy film a correlation for annular flow (Wallis
  1969), f = 0.005·(1 + 300·δ/D), gives about 0.08 for the films found here. For g ≪ slot·t it is the balance of forces
  τ = Δp·g/(2t), in which f no longer occurs: however rough the walls, a kerf half as wide has half the shear. So a
  narrow kerf has a thick film, which narrows it further; what is too narrow cannot be cleared. δ in K is that of the
  kerf without film, one step of the iteration.
* Roughness ``Rz² = (R0·(δ/δ0)^k·G^−γ)² + R_geo² + (k_h·rms e_h)² + (R_u·max(0, m̄ − m_u))²``, δ at the bottom and with
  K, not below the limit of ISO 9013's range 1. Roughness that follows the gas' shear, and a kerf that decides more than
  the gas' settings, was measured on 10 mm stainless steel (Mahrle et al. 2021).
  The last term is the upturn at very low speed, where the melt burns beyond the beam; γ lets the gas smooth the cut.
* Dross ``a·(b̄/b0)^⅓·(K/K0·G)^−½``: what the film leaves at the lower edge, δ ∝ τ^−½; a wider kerf brings more melt, and
  a bead grows with the cube root of its volume [A]. Gas at the nozzle ``G = (p/p0)/(1 + (e_h/hs)²)`` with its own hs on
  either side.
* δ0, K0 and b0 are those of Huang2024's fastest static cut, so that R0 and a are about what it came to.
* A dither so slow that the front does not average it, v/f > Lx, counts in these densities with the amplitude
  ``a·sqrt(1 − exp(−(kLx)²/12))``, k = 2πf/v.

R_geo, what the path itself writes on the edge, is the mean of five peak-to-valleys of the contour error behind a high-
pass of ``CUTOFF`` mm, plus that of the dither as far as the beam does not average it.

What it misses: heat that builds up in corners and narrow webs, striations as a process of their own, shocks and
supersonic flow of the gas, surface tension, preheating by neighbouring cuts. Roughness and dross are proxies:
calibrated on three published cuts (C45) or assumed (the others), validated nowhere. The three cuts do not tell whether
a dither smooths because more is absorbed or because the kerf gets wider: a power of m̄ alone meets them as well as this
form does and says the opposite about a narrow kerf. :mod:`envs.figures.evidence` says how far a run lies from those
cuts.
"""

from typing import NamedTuple

import numpy as np

from ..engine.lanes import clip, exponential, fma, logarithm, part, power

CUTOFF = 2.5
"""mm, wavelength above which a contour error counts as waviness (λc of ISO 4288 for Rz 10–50 µm)."""

LENGTH = 0.8
"""mm, over which a peak-to-valley is taken; five of them make R_geo and its rms e_h."""

FILM, FLOW, WIDTH = 0.033, 0.137, 0.26
"""δ0 in mm, K0, and b0 in mm: film, flow and kerf of Huang2024's fastest static cut."""

OPEN = 0.05
"""Share of the kerf that stays open to the gas, however thick the film."""

_KAPPA = 0.22
_SQRT_PI = 1.772453850905516
_SLOWEST = 0.05  # mm/s; slower is a standstill


class Params(NamedTuple):
    """A material, its recipe and the model's coefficients. Defaults: those of materials/c45-10.toml, 10 mm, oxygen."""

    thickness: float = 10.0  # mm [S] Huang2024
    focus: float = 3.333  # mm below the surface, t/3 [S] CN102528288A
    w0: float = 0.075  # mm, beam radius in focus [A]
    zr: float = 2.5  # mm, Rayleigh length [A]
    melt: float = 9.504  # J/mm³, ρ(c·ΔT + L) [P] steel
    burn: float = 11.28693  # J/mm³, share of the oxidation's heat that helps [C]
    conduct: float = 198.0  # W/mm, 4λΔT [P]
    diffusivity: float = 7.0  # mm²/s [P]
    refraction: float = 3.81  # refractive index [P]
    extinction: float = 4.44  # [P]
    film: float = 1.9e-6  # s, 2μ/τ at K = 1: μ 5e-9 N·s/mm² [P], τ = f·Δp/1.5, f 0.08 [P], Δp 0.1 N/mm² [A]
    slot: float = 0.107  # 2f/1.5, f 0.08: Wallis' interfacial friction over a film of a twentieth of the slot [P]
    carry: float = 0.93039  # how much more the upper half counts for the film [C]
    rough: float = 0.17576  # mm, R0 [C]
    rough_power: float = 1.84547  # k [C]
    rough_gas: float = 0.25  # γ [A]
    follow: float = 0.10  # k_h [A]
    upturn: float = 0.02  # mm, R_u [A]
    upturn_from: float = 2.0  # m_u [A]
    floor: float = 0.016  # mm, 10 + 0.6·t µm [P] ISO 9013
    dross: float = 1.07201  # mm, a [C]
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
    # Where nothing is melted the kerf is a tenth of the beam's radius, so that what is divided by it stays finite.
    return 2.0 * np.sqrt(max(0.01, 4.0 + 2.0 * logarithm(max(margin, 1e-6))) * sigma2 + a2 + swept)


@part
def _mean(x0, x1, x2, x3, x4):
    """Mean over the depth of what is known at 0, ¼, ½, ¾ and 1 of it (Boole's rule)."""
    return (7.0 * (x0 + x4) + 32.0 * (x1 + x3) + 12.0 * x2) / 90.0


@part
def film2(p, v, hotness, flow):
    """Square of the melt film's thickness at the bottom, mm²; ``hotness`` is m̂, ``flow`` K."""
    return p.film * v * p.thickness / (max(hotness, 0.02) * flow)


@part
def resistance(k0, k1, k2, k3, k4, film):
    """Mean over the depth of one over what a film of ``film`` mm at the bottom, ∝ √z, leaves open of the kerf, 1/mm.

    ``k0`` … ``k4`` are the kerf's widths at 0, ¼, ½, ¾ and 1 of the depth, mm.
    """
    g0, g1 = k0, max(k1 - film, OPEN * k1)
    g2, g3 = max(k2 - 1.4142135623730951 * film, OPEN * k2), max(k3 - 1.7320508075688772 * film, OPEN * k3)
    g4 = max(k4 - 2.0 * film, OPEN * k4)
    return (7.0 * (1.0 / g0 + 1.0 / g4) + 32.0 * (1.0 / g1 + 1.0 / g3) + 12.0 / g2) / 90.0


@part
def widening(top, low):
    """Loss of a kerf that widens downwards, in dynamic pressures (Borda–Carnot)."""
    x = max(0.0, low / top - 1.0)
    return x * x


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
    error2 = s.error2 + share * (error * error - s.error2)
    return State(base, high, low, 0.0 if full else along, lengths, geometric, error2, weight)


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
    mean = _mean(d0.density, d1.density, d2.density, d3.density, d4.density)
    absorbed = b.absorbed * b.power / t
    m0, m1 = _margin(p, absorbed, v, d0.density, mean), _margin(p, absorbed, v, d1.density, mean)
    m2, m3 = _margin(p, absorbed, v, d2.density, mean), _margin(p, absorbed, v, d3.density, mean)
    m4 = _margin(p, absorbed, v, d4.density, mean)
    margin = _mean(m0, m1, m2, m3, m4)
    k0, k1, k2 = _kerf(m0, d0.sigma2, a), _kerf(m1, d1.sigma2, a), _kerf(m2, d2.sigma2, a)
    k3, k4 = _kerf(m3, d3.sigma2, a), _kerf(m4, d4.sigma2, a)
    mean_kerf = _mean(k0, k1, k2, k3, k4)

    c = p.carry
    ends = 7.0 * ((1.0 + c) / max(m0, 0.02) + (1.0 - c) / max(m4, 0.02))
    inner = 32.0 * ((1.0 + 0.5 * c) / max(m1, 0.02) + (1.0 - 0.5 * c) / max(m3, 0.02))
    cold = (ends + inner + 12.0 / max(m2, 0.02)) / 90.0
    losses = 1.0 + widening(k0, k4)
    empty = 1.0 / (losses + p.slot * t * resistance(k0, k1, k2, k3, k4, 0.0))
    film = np.sqrt(film2(p, v, 1.0 / cold, empty))
    flow = 1.0 / (losses + p.slot * t * resistance(k0, k1, k2, k3, k4, film))
    log_g = logarithm(gas(p, e))

    thick = logarithm(film2(p, v, 1.0 / cold, flow) / (FILM * FILM))
    melted = p.rough * exponential(0.5 * p.rough_power * thick - p.rough_gas * log_g)
    # The beam averages a ripple of wavenumber k along the path by exp(−(kσ)²/2).
    x = 0.5 * k * p.w0
    written = s.geometric + b.ripple * exponential(-0.5 * x * x)
    burnt = p.upturn * max(0.0, margin - p.upturn_from)
    rough2 = melted * melted + written * written + p.follow * p.follow * s.error2 + burnt * burnt
    dross = p.dross * exponential(logarithm(mean_kerf / WIDTH) / 3.0 - 0.5 * (logarithm(flow / FLOW) + log_g))
    return s, Figures(
        margin, max(np.sqrt(rough2), p.floor), dross, k0, k4, 0.5 * abs(k0 - k4), 1.0 if margin >= 1.0 else 0.0
    )
