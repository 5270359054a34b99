"""Built-in parts: contours with true dimensions, for benchmarks and first steps."""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from ..engine.quantity import InvalidInput, did_you_mean
from . import bspline
from .curve import Curve, Points
from .drawing import Drawing, drawing
from .order import ordered
from .profile import corners_of

_STEP = np.deg2rad(1.0)


def _arc(x: float, y: float, radius: float, start: float, stop: float) -> Points:
    """Points on an arc from angle to angle, rad; finer than CHORD up to a radius of 250 mm."""
    step = min(_STEP, 2.0 * np.arccos(1.0 - 0.002 / max(radius, 0.01)))
    angle = np.linspace(start, stop, max(2, int(np.ceil(abs(stop - start) / step)) + 1))
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1)


def _ring(x: float, y: float, radius: float) -> Points:
    return _arc(x, y, radius, 0.0, 2 * np.pi)


def _box(x: float, y: float, width: float, height: float) -> Points:
    return np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height], [x, y]])


def square(side: float = 50.0) -> list[Points]:
    """A square with sharp corners, mm."""
    return [_box(0.0, 0.0, side, side)]


def circle(diameter: float = 50.0) -> list[Points]:
    """A circle, mm."""
    return [_ring(diameter / 2, diameter / 2, diameter / 2)]


def slot_plate(width: float = 80.0, height: float = 50.0, slots: int = 3, slot: float = 6.0) -> list[Points]:
    """A plate with round-ended slots and four holes, mm."""
    found, pitch, r = [], width / (slots + 1), slot / 2
    low, high = 0.3 * height, 0.7 * height
    for i in range(slots):
        x = (i + 1) * pitch
        found.append(np.concatenate([_arc(x, high, r, 0.0, np.pi), _arc(x, low, r, np.pi, 2 * np.pi), [[x + r, high]]]))
    for x, y in ((0.06, 0.1), (0.94, 0.1), (0.94, 0.9), (0.06, 0.9)):
        found.append(_ring(x * width, y * height, 2.0))
    return [*found, _box(0.0, 0.0, width, height)]


def gear(module: float = 2.0, teeth: int = 20, pressure_angle: float = 20.0, bore: float = 10.0) -> list[Points]:
    """An involute gear: module in mm, pressure angle in degrees, bore in mm."""
    pitch, alpha = 0.5 * module * teeth, np.deg2rad(pressure_angle)
    base, tip, root = pitch * np.cos(alpha), pitch + module, pitch - 1.25 * module
    if bore / 2 >= root:
        raise InvalidInput(f"part 'gear': bore = {bore:g} mm; it must be smaller than the root circle, {2 * root:g} mm")
    start = max(base, root)
    r = np.linspace(start, tip, 12)
    roll = np.sqrt(np.maximum((r / base) ** 2 - 1.0, 0.0))
    flank = roll - np.arctan(roll)  # polar angle of the involute from where it leaves the base circle
    half = np.pi / (2 * teeth) + (np.tan(alpha) - alpha)  # half the tooth at the base circle
    outline = []
    for i in range(teeth):
        centre = 2 * np.pi * i / teeth
        left, right = centre - half + flank, centre + half - flank[::-1]
        if root < start:
            outline.append([root * np.cos(left[0]), root * np.sin(left[0])])
        outline += np.stack([r * np.cos(left), r * np.sin(left)], axis=1).tolist()
        outline += _arc(0.0, 0.0, tip, left[-1], right[0])[1:-1].tolist()
        outline += np.stack([r[::-1] * np.cos(right), r[::-1] * np.sin(right)], axis=1).tolist()
        if root < start:
            outline.append([root * np.cos(right[-1]), root * np.sin(right[-1])])
        following = 2 * np.pi * (i + 1) / teeth - half + flank[0]
        outline += _arc(0.0, 0.0, root, right[-1], following)[1:-1].tolist()
    return [_ring(tip, tip, bore / 2), np.array([*outline, outline[0]]) + tip]


def corners(size: float = 60.0) -> list[Points]:
    """A test part: corners of 30, 60, 90 and 135 degrees and radii of 0.5 to 5 mm in one outline."""
    s = size / 60.0
    pieces = [
        np.array([[0.0, 0.0], [40.0, 0.0]]),
        _arc(40.0, 5.0, 5.0, -np.pi / 2, 0.0),
        np.array([[45.0, 20.0], [60.0, 24.0], [45.0, 28.0], [45.0, 34.0]]),
        _arc(43.0, 34.0, 2.0, 0.0, np.pi / 2),
        np.array([[36.0, 36.0], [36.0, 45.0]]),
        _arc(35.0, 45.0, 1.0, 0.0, np.pi),
        np.array([[34.0, 36.5]]),
        _arc(33.5, 36.5, 0.5, 0.0, -np.pi / 2),
        np.array([[20.0, 36.0], [12.0, 50.0], [4.0, 36.0], [0.0, 32.0], [0.0, 0.0]]),
    ]
    return [s * np.concatenate(pieces)]


def rosette(diameter: float = 60.0, petals: int = 5) -> list[Points]:
    """A closed cubic B-spline with petals (Huang2024 eqs. 3–8)."""
    count = 4 * petals
    angle = 2 * np.pi * np.arange(count) / count
    radius = 0.5 * diameter * (0.75 + 0.25 * np.cos(petals * angle))
    control = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1) + diameter / 2
    return [bspline.sampled(control, 60, closed=True)]


PARTS: dict[str, Callable[..., list[Points]]] = {
    "square": square,
    "circle": circle,
    "slot-plate": slot_plate,
    "gear": gear,
    "corners": corners,
    "rosette": rosette,
}


def sizes(name: str) -> list[str]:
    """Names of a part's sizes, the most important first."""
    return list(inspect.signature(PARTS[name]).parameters)


def part(name: str, **dimensions: Any) -> Drawing:
    """A built-in part.

    Raises:
        InvalidInput: unknown part or size (the nearest is offered), or a size that is not above 0.
    """
    if name not in PARTS:
        raise InvalidInput(f"unknown part '{name}'; {did_you_mean(name, PARTS)}, or a drawing's file")
    known = sizes(name)
    for size, value in dimensions.items():
        if size not in known:
            raise InvalidInput(f"part '{name}': unknown size '{size}'; {did_you_mean(size, known)}")
        if not value > 0:
            raise InvalidInput(f"part '{name}': {size} = {value}; it must be above 0")
    contours = [_closed(points) for points in PARTS[name](**dimensions)]
    # The suites were frozen with each contour the nearest to the one before; a shorter order would be another job.
    return drawing(f"part '{name}'", name, ordered(contours, shorten=False))


def _closed(points: Points) -> Curve:
    legs = np.diff(points, axis=0)
    first, last = legs[0], legs[-1]
    return Curve(points, corners_of(points), complex(*first), complex(*last), closed=True)
