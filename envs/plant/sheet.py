"""The sheet under the nozzle: height of its surface, and where it has none.

Surface height at time t and at the point (x, y) that lies the distance s along the path::

    z = tilt·(x, y) + Σ waves + random(s) + Σ vibrations(t) + bulge(x, y, t) + features(s) + profile(s)

Everything is a mean over a *footprint*: a disc with the weight of a hemisphere, whose projection on any direction is
¾(1 − u²). So a wave of wavenumber k loses the factor 3(sin κ − κ cos κ)/κ³, κ = k·radius (:func:`attenuation`), and a
step becomes a smooth ramp (:func:`share`). There are two of them: what is scored, and touched, is the sheet under the
nozzle's tip (:data:`FOOTPRINT`); what is measured is the sheet under the sensor's plate (``Params.plate``), which is
wider, so that it sees short waves weakened and steps early and late. A bulge and a profile are the same for both.

A *vibration* is a tone, or a band: then white noise drives a damped mode. A *random* sheet has a continuous spectrum.
In the *turns* of a long episode some of them come and go, each on in its own turns (:func:`turned`).

Holes and edges are *voids*: the surface goes on as a plane for the gap, but the sensor loses part of its plate there
(:func:`coverage`), and the beam has nothing to cut.
"""

import functools
from typing import NamedTuple

import numpy as np

from ..engine.lanes import U1, U, as_number, clip, part, sine

WAVES, VIBRATIONS, FEATURES = 8, 3, 16
"""Most waves, vibrations and features that one sheet can have."""

FAR = 1e9
"""mm, further than any path goes: the far end of a step or an edge."""

FOOTPRINT = 2.0
"""mm, radius of the nozzle tip's footprint [A], see docs/physics.md#footprints."""

PLATE = 5.6
"""mm, radius of the footprint of a plate of 5 mm: the hemisphere whose second moment is the disc's, R·√1.25 [C]. Fringe
widens it, the bore does, too; both are left out [A]."""

LATEST = 14.0
"""mm behind its far end at which a feature is done with; features therefore lie at least ``SPACING`` apart."""

HIGHEST_BAND = 200.0
"""Hz, highest band of vibration; beyond it half a control period is too long a step. At 200 Hz it lies 2 % too high."""

SPACING = 27.0
"""mm, least distance between the end of a feature that holds a void and the start of the next."""


class Wave(NamedTuple):
    """One sine of the sheet's shape."""

    amplitude: float = 0.0  # mm, already attenuated by the footprint
    kx: float = 0.0  # rad/mm
    ky: float = 0.0  # rad/mm
    phase: float = 0.0  # rad
    felt: float = 0.0  # mm, what the plate feels of it above what the tip has


class Vibration(NamedTuple):
    """One motion in time of the whole sheet: a tone, or a band of a damped mode that white noise drives."""

    amplitude: float = 0.0  # mm; of a band √2 times its RMS
    omega: float = 0.0  # rad/s
    phase: float = 0.0  # rad
    zeta: float = 0.0  # damping ratio of a band; 0: a tone


class Shaken(NamedTuple):
    """Where a band of vibration is."""

    height: float = 0.0  # mm
    speed: float = 0.0  # mm/s


class Feature(NamedTuple):
    """A stretch of the path that differs from the sheet around it."""

    start: float = FAR  # mm along the path
    stop: float = FAR  # mm along the path; FAR for a step that stays
    rise: float = 0.0  # mm, height of the surface inside above the surface before
    across: float = 0.0  # mm, width of a void across the path; 0: no void


class Params(NamedTuple):
    """The smooth part of the sheet; waves, vibrations and features are lists beside it."""

    tilt_x: float = 0.0  # mm/mm
    tilt_y: float = 0.0  # mm/mm
    bulge: float = 0.0  # mm, final height of the thermal bulge [A] 0.2–1
    bulge_x: float = 0.0  # mm, its centre
    bulge_y: float = 0.0  # mm
    bulge_width: float = 40.0  # mm, full width at half height [A] 20–60
    bulge_growth: float = 0.0  # share of the remaining growth per control period, 1 − exp(−T/τ), τ 1–10 s [A]
    length: float = 3000.0  # mm along x, after which the slope goes the other way [A]
    plate: float = FOOTPRINT  # mm, radius of the footprint of the sensor's plate


class Random(NamedTuple):
    """A sheet of continuous spectrum: two long tables of that spectrum, each begun somewhere, added up."""

    first: float = -1.0  # index of its first sample in the table; −1: none
    one: float = 0.0  # mm, weight of the first table, …
    two: float = 0.0  # … and of the second; the root of their squares' sum is the RMS
    begin_one: float = 0.0  # mm
    begin_two: float = 0.0


class Turns(NamedTuple):
    """What is on when, in an episode of several turns. Masks have a bit for each turn."""

    length: float = 0.0  # s of a turn; 0: everything is on all the time
    many: float = 1.0  # turns, after which they begin anew
    waves: float = 0.0
    random: float = 0.0
    vibrations: float = 0.0
    impulses: float = 0.0


class State(NamedTuple):
    """What the sheet remembers."""

    grown: float = 0.0  # share of the bulge that has grown, 0–1
    level: float = 0.0  # mm, sum of the steps that lie behind
    upcoming: float = 0.0  # index of the feature after the current one
    current: Feature = Feature()


@part
def share(u):
    """Share of the footprint that lies behind a line at the distance u (in radii) behind its centre.

    The integral of ¾(1 − u²): 0 for u ≤ −1, ½ at 0, 1 for u ≥ 1.
    """
    v = clip(u, -1.0, 1.0)
    return 0.5 + v * (0.75 - 0.25 * v * v)


def attenuation(k, radius=FOOTPRINT):
    """Factor by which a footprint of ``radius`` mm reduces a wave of ``k`` rad/mm: 3(sin κ − κ cos κ)/κ³."""
    kappa = np.maximum(np.abs(np.asarray(k, float)) * radius, 1e-4)
    exact = 3.0 * (np.sin(kappa) - kappa * np.cos(kappa)) / kappa**3
    return np.where(kappa < 0.02, 1.0 - kappa**2 / 10.0, exact)


@part
def wave(w, x, y):
    """One wave at (x, y), as a share of its amplitude."""
    return sine(w.kx * x + w.ky * y + w.phase)


BEND = 300.0
"""mm before and after a turn of the slope in which it turns."""


@part
def sloped(p, x):
    """Way by which the slope along x has risen at ``x``, mm: to and fro over the sheet's length, so that a journey of
    minutes stays within the travel; the slope turns smoothly."""
    n = np.floor(x / p.length)
    w = x - n * p.length
    falls = n - 2.0 * np.floor(0.5 * n) > 0.5
    rises = w if not falls else p.length - w
    top, bottom = p.length - rises, rises
    bent = p.length - (BEND * BEND + top * top) / (2.0 * BEND) if top < BEND else rises
    bent = (BEND * BEND + bottom * bottom) / (2.0 * BEND) if bottom < BEND else bent
    return bent if x > BEND else x


@part
def vibration(v, t):
    """Height of one tone at time t, mm."""
    return v.amplitude * sine(v.omega * t + v.phase)


@part
def shaken(v):
    """A band of vibration when an episode begins: drawn from what it is in the long run, by its phase."""
    return Shaken(v.amplitude * sine(v.phase), v.amplitude * v.omega * sine(v.phase + 1.5707963267948966))


@part
def shake(v, s, noise, dt):
    """A band of vibration ``dt`` seconds later: x″ + 2ζω·x′ + ω²·x = white noise, by semi-implicit steps.

    ``noise`` is normal, of variance 1. The force is such that x has the RMS amplitude/√2 in the long run; that is exact
    for these steps (the discrete Lyapunov equation, solved by hand).
    """
    a, b = 2.0 * v.zeta * v.omega * dt, v.omega * v.omega * dt * dt
    # With speeds in mm per step y, y' = (1 − a)y − b·x + f and x' = x + y': var x = σ²(2 − a)/(a·b(4 − 2a − b)).
    sigma = v.amplitude * 0.7071067811865476 * np.sqrt(a * b * (4.0 - 2.0 * a - b) / (2.0 - a))
    y = (1.0 - a) * s.speed * dt - b * s.height + sigma * noise
    return Shaken(s.height + y, y / dt)


RANDOM_SPACING = 0.25
"""mm between the samples of a random sheet's tables."""

RANDOM_ONE, RANDOM_TWO = 131072, 118099
"""Samples of the two tables, 33 and 30 m long; the second comes to the same place only after kilometres."""


@part
def random_height(table, r, s, plate):
    """Height of a random sheet at the distance ``s`` along the path, mm: tip (``plate`` 0) or plate (1).

    Each table is followed by its first sample. Order: first table for tip and plate, second table for tip and plate.
    """
    n1, n2 = RANDOM_ONE + 1.0, RANDOM_TWO + 1.0
    u1, u2 = (s + r.begin_one) / RANDOM_SPACING, (s + r.begin_two) / RANDOM_SPACING
    u1, u2 = u1 - RANDOM_ONE * np.floor(u1 / RANDOM_ONE), u2 - RANDOM_TWO * np.floor(u2 / RANDOM_TWO)
    k1, k2 = min(np.floor(u1), RANDOM_ONE - 1.0), min(np.floor(u2), RANDOM_TWO - 1.0)
    i = np.uint64(np.int64(r.first + plate * n1 + k1))
    j = np.uint64(np.int64(r.first + 2.0 * n1 + plate * n2 + k2))
    one = table[i] + (u1 - k1) * (table[i + U1] - table[i])
    two = table[j] + (u2 - k2) * (table[j + U1] - table[j])
    return r.one * one + r.two * two


@functools.lru_cache(maxsize=32)
def random_tables(exponent, rolloff, plate, pair=0):
    """Tables of a random sheet of RMS 1 under the tip, in the order of :func:`random_height`.

    The power spectral density over wavenumber is (k² + k0²)^(−exponent/2), k0 = 2π/rolloff, times the square of the
    footprint's factor; phases are random, fixed by ``pair``.

    Args:
        exponent: of the wavenumber beyond the roll-off, 2 or 3.
        rolloff: mm, wavelength beyond which it no longer rises.
        plate: mm, radius of the plate's footprint.
        pair: which of the pairs of tables, 0 or more.
    """
    # NumPy keeps this generator's stream for ever, its newer ones' not.
    out, rng = [], np.random.RandomState(20261122 + int(pair))
    for n in (RANDOM_ONE, RANDOM_TWO):
        k = 2.0 * np.pi * np.fft.rfftfreq(n, RANDOM_SPACING)
        density = (k * k + (2.0 * np.pi / rolloff) ** 2) ** (-0.5 * exponent)
        density[0] = 0.0
        shape = np.sqrt(density) * (rng.standard_normal(len(k)) + 1j * rng.standard_normal(len(k)))
        tip = np.fft.irfft(shape * attenuation(k), n)
        scale = 1.0 / np.sqrt(np.mean(tip * tip))
        felt = np.fft.irfft(shape * attenuation(k, plate), n)
        out += [scale * np.append(tip, tip[0]), scale * np.append(felt, felt[0])]
    return np.concatenate(out)


FADE = 1.0
"""s in which the end of a turn becomes the next."""


@part
def turned(p, mask, t):
    """How much of what has this ``mask`` is on at time ``t`` s: 0 to 1, smoothly; 1 where there are no turns."""
    takes_turns = p.length > 0.0
    length = p.length if takes_turns else 1.0
    whole = np.floor(max(t, 0.0) / length)
    turn = whole - p.many * np.floor(whole / p.many)
    after = turn + 1.0 if turn + 1.0 < p.many else 0.0
    now, then = _is_on(mask, turn), _is_on(mask, after)
    u = clip((max(t, 0.0) - whole * length - (length - FADE)) / FADE, 0.0, 1.0)
    return now + (then - now) * u * u * (3.0 - 2.0 * u) if takes_turns else 1.0


@part
def _is_on(mask, turn):
    """The bit ``turn`` of a mask of up to 32 bits, as a number: 0 or 1."""
    shifted = np.floor(mask * as_number(U(np.int64(1023.0 - turn)) << U(52)))  # mask/2^turn, exactly
    return shifted - 2.0 * np.floor(0.5 * shifted)


@part
def bulge(p, s, x, y):
    """Height of the thermal bulge at (x, y), mm: a raised cosine of full width 2·``bulge_width``."""
    dx, dy = x - p.bulge_x, y - p.bulge_y
    u = clip(np.sqrt(dx * dx + dy * dy) / p.bulge_width, 0.0, 1.0)
    return p.bulge * s.grown * (0.5 + 0.5 * sine(1.5707963267948966 - 3.141592653589793 * u))


@part
def features(s, along, radius):
    """Height of the steps behind and of the current feature at ``along`` the path under a footprint, mm."""
    f = s.current
    return s.level + f.rise * (share((along - f.start) / radius) - share((along - f.stop) / radius))


@part
def coverage(f, along, radius):
    """Share of a disc of ``radius`` (mm) around the nozzle that has sheet under it, 0–1.

    A void narrower than the disc, such as a round hole, takes away less, in proportion to its width.
    """
    missing = share((along - f.start) / radius) - share((along - f.stop) / radius)
    return 1.0 - missing * min(1.0, f.across / (2.0 * radius))


@part
def over_void(f, along, reach):
    """Whether a nozzle tip of radius ``reach`` (mm) has nothing but void under it; 0 asks for the beam alone."""
    return f.across > 0.0 and along - f.start > reach and f.stop - along > reach


@part
def is_behind(f, along):
    """Whether a feature is done with at the distance ``along`` the path."""
    return along > (f.start if f.stop >= FAR else f.stop) + LATEST


@part
def leave(s, following):
    """The state after passing the current feature: a step that stays becomes part of the level."""
    f = s.current
    stays = f.rise if f.stop >= FAR and f.across == 0.0 else 0.0
    return s._replace(level=s.level + stays, upcoming=s.upcoming + 1.0, current=following)


@part
def grow(p, s):
    """The bulge one control period later."""
    return s._replace(grown=s.grown + (1.0 - s.grown) * p.bulge_growth)
