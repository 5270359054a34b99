"""Geometry of G-code: arcs in three planes and with several turns, and splines, as what they are in the plane.

Points are complex numbers x + jy in mm. An arc of the planes XZ (G18) and YZ (G19) is seen from above: it goes to and
fro on a line while the third axis moves.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .curve import Complex, Curve, arc, rational, smooth
from .gcode_frames import Point

SLACK = 2 * 0.01 * math.sqrt(2.0)
"""mm by which the two radii of an arc may differ, or its ends be too far apart: numbers rounded to 0.01 mm.
[P] LinuxCNC, CENTER_ARC_RADIUS_TOLERANCE_MM"""

SLACK_INCH = 25.4 * 2 * 0.001 * math.sqrt(2.0)
"""mm, the same for numbers rounded to 0.001 inches. [P] LinuxCNC, CENTER_ARC_RADIUS_TOLERANCE_INCH"""

SLACK_SHARE = 0.001
"""Of the radius, by which they may differ all the same, [P] LinuxCNC, SPIRAL_RELATIVE_TOLERANCE …"""

SLACK_MOST = 100.0
"""… up to so many times what they may anyway. [P] LinuxCNC"""

LEAST = 0.00127
"""mm, the smallest radius. [P] LinuxCNC, RADIUS_TOLERANCE_MM"""

CHORD = 0.0005
"""mm, the largest distance of an arc from its chords: the path is that of the programme to 1 µm."""

PLANES = {"G17": ("X", "Y", "Z", "IJ"), "G18": ("Z", "X", "Y", "KI"), "G19": ("Y", "Z", "X", "JK")}
"""First axis, second axis, third axis, and the letters of the centre, of each plane."""


@dataclass(frozen=True)
class Turn:
    """An arc in a plane: where its centre is, how far it turns, rad, and how far the third axis goes, mm."""

    plane: str
    start: complex  # in the plane's first and second axis
    end: complex
    centre: complex
    angle: float
    low: float  # the third axis at its start
    rise: float

    @property
    def around(self) -> float:
        """mm in its plane."""
        return 0.5 * (abs(self.start - self.centre) + abs(self.end - self.centre)) * abs(self.angle)

    @property
    def length(self) -> float:
        """mm in space."""
        return math.hypot(self.around, self.rise)

    @property
    def points(self) -> float:
        """About how many points it takes."""
        radius = max(abs(self.start - self.centre), abs(self.end - self.centre), LEAST)
        return abs(self.angle) / max(2.0 * math.acos(max(1.0 - CHORD / radius, 0.0)), 1e-4)

    def curve(self) -> Curve:
        """As it is seen from above."""
        if self.plane == "G17":
            return arc(self.centre, self.start, self.end, self.angle, CHORD)
        return smooth(self._above, self._breaks(), CHORD)

    def _above(self, t: npt.NDArray[np.float64]) -> Complex:
        """At the shares ``t`` of the way."""
        r0, r1 = abs(self.start - self.centre), abs(self.end - self.centre)
        spoke = np.exp(1j * (np.angle(self.start - self.centre) + self.angle * t)) * (r0 + (r1 - r0) * t)
        first, second = self.centre.real + spoke.real, self.centre.imag + spoke.imag
        third = self.low + self.rise * t
        return second + 1j * third if self.plane == "G18" else third + 1j * first

    def _breaks(self) -> npt.NDArray[np.float64]:
        """The ends, and where the axis that is seen turns back."""
        begin = float(np.angle(self.start - self.centre))
        quarter = 0.5 * math.pi
        phase = quarter if self.plane == "G18" else 0.0  # where sine or cosine is largest
        ends = sorted((begin - phase, begin + self.angle - phase))
        k = np.arange(math.ceil(ends[0] / math.pi), math.floor(ends[1] / math.pi) + 1)
        inner = (k * math.pi + phase - begin) / self.angle
        return np.unique(np.concatenate([[0.0], inner[(inner > 1e-9) & (inner < 1 - 1e-9)], [1.0]]))


def in_plane(plane: str, point: Point) -> tuple[complex, float]:
    """A point in a plane's own two axes, and the third coordinate."""
    x, y, z = point.xy.real, point.xy.imag, point.z
    return {"G17": (complex(x, y), z), "G18": (complex(z, x), y), "G19": (complex(y, z), x)}[plane]


def swept(a: complex, b: complex, sense: float) -> float:
    """The angle from ``a`` to ``b`` in that sense, rad: more than 0 and at most 2π, with the sign of ``sense``."""
    angle = sense * float(np.angle(b * np.conj(a)))
    return sense * (angle if angle > 0.0 else angle + 2 * math.pi)


def by_radius(start: complex, end: complex, radius: float, sense: float) -> complex:
    """The centre of the arc of that radius; of the two, that of the shorter if it is positive, else of the longer."""
    half = 0.5 * abs(end - start)
    rise = math.sqrt(max(radius * radius - half * half, 0.0)) * math.copysign(sense, sense * radius)
    return 0.5 * (start + end) + 1j * rise * (end - start) / (2 * half)


def slack(outer: float, inches: bool) -> float:
    """mm by which the radii of an arc of that radius may differ."""
    always = SLACK_INCH if inches else SLACK
    return min(max(always, SLACK_SHARE * outer), SLACK_MOST * always)


def bezier(control: list[complex]) -> Curve:
    """The curve of Bézier with these control points: G5 has four, G5.1 three."""
    points = np.array(control)

    def at(t: npt.NDArray[np.float64]) -> Complex:
        left = np.repeat(points[:, None], len(t), axis=1)
        while len(left) > 1:  # de Casteljau
            left = left[:-1] * (1.0 - t) + left[1:] * t
        return left[0]

    return smooth(at, [0.0, 1.0], CHORD)


def nurbs(control: list[complex], weights: list[float], order: int) -> Curve:
    """The rational B-spline of G5.2: uniform, and held at both ends."""
    inner = len(control) - order
    knots = np.concatenate([np.zeros(order), np.arange(1, inner + 1), np.full(order, inner + 1.0)])
    return rational(knots, np.array(control), np.array(weights), order - 1, np.arange(inner + 2.0), CHORD)
