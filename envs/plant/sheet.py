"""The sheet under the nozzle: height of its surface, and where it has none.

Surface height at time t and at the point (x, y) that lies the distance s along the path::

    z = tilt·(x, y) + Σ waves + Σ vibrations(t) + bulge(x, y, t) + features(s) + profile(s)

Everything is the mean over the *nozzle's footprint*: a disc of radius ``footprint`` with the weight of a hemisphere,
whose projection on any direction is ¾(1 − u²). So a wave of wavenumber k loses the factor 3(sin κ − κ cos κ)/κ³,
κ = k·footprint (:func:`attenuation`), and a step becomes a smooth ramp (:func:`share`).

Holes and edges are *voids*: the surface goes on as a plane for the gap, but the sensor loses part of its plate there
(:func:`coverage`), and the beam has nothing to cut.
"""

from typing import NamedTuple

import numpy as np

from .lanes import clip, part, sine

WAVES, VIBRATIONS, FEATURES = 8, 3, 16
"""Most waves, vibrations and features that one sheet can have."""

FAR = 1e9
"""mm, further than any path goes: the far end of a step or an edge."""

FOOTPRINT = 2.0
"""mm, radius of the nozzle's footprint [A] (PHYSICS §6 used ±2 mm)."""

LATEST = 14.0
"""mm behind its far end at which a feature is done with; features therefore lie at least ``SPACING`` apart."""

SPACING = 27.0
"""mm, least distance between the end of a feature that holds a void and the start of the next."""


class Wave(NamedTuple):
    """One sine of the sheet's shape."""

    amplitude: float = 0.0  # mm, already attenuated by the footprint
    kx: float = 0.0  # rad/mm
    ky: float = 0.0  # rad/mm
    phase: float = 0.0  # rad


class Vibration(NamedTuple):
    """One sine in time that moves the whole sheet."""

    amplitude: float = 0.0  # mm
    omega: float = 0.0  # rad/s
    phase: float = 0.0  # rad


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


def attenuation(k):
    """Factor by which the footprint reduces a wave of wavenumber ``k`` (rad/mm, array): 3(sin κ − κ cos κ)/κ³."""
    kappa = np.maximum(np.abs(np.asarray(k, float)) * FOOTPRINT, 1e-4)
    exact = 3.0 * (np.sin(kappa) - kappa * np.cos(kappa)) / kappa**3
    return np.where(kappa < 0.02, 1.0 - kappa**2 / 10.0, exact)


@part
def wave(w, x, y):
    """Height of one wave at (x, y), mm."""
    return w.amplitude * sine(w.kx * x + w.ky * y + w.phase)


@part
def vibration(v, t):
    """Height of one vibration at time t, mm."""
    return v.amplitude * sine(v.omega * t + v.phase)


@part
def bulge(p, s, x, y):
    """Height of the thermal bulge at (x, y), mm: a raised cosine of full width 2·``bulge_width``."""
    dx, dy = x - p.bulge_x, y - p.bulge_y
    u = clip(np.sqrt(dx * dx + dy * dy) / p.bulge_width, 0.0, 1.0)
    return p.bulge * s.grown * (0.5 + 0.5 * sine(1.5707963267948966 - 3.141592653589793 * u))


@part
def features(s, along):
    """Height of the steps behind and of the current feature at the distance ``along`` the path, mm."""
    f = s.current
    return s.level + f.rise * (share((along - f.start) / FOOTPRINT) - share((along - f.stop) / FOOTPRINT))


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
    return State(grown=s.grown, level=s.level + stays, upcoming=s.upcoming + 1.0, current=following)


@part
def grow(p, s):
    """The bulge one control period later."""
    return State(s.grown + (1.0 - s.grown) * p.bulge_growth, s.level, s.upcoming, s.current)
