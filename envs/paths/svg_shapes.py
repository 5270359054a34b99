"""The outlines of SVG's shapes, as curves.

Path data are read by svgpathtools, of which only the segments are used: its transforms of arcs come out wrong where
they mirror and turn, so points are transformed here and not arcs.
"""

import functools
import re
import warnings
from collections.abc import Iterator
from itertools import groupby
from typing import Any

import numpy as np
import numpy.typing as npt

from .curve import Complex, Curve, beziers, linked, polyline, quadratic, smooth
from .svg_tree import NUMBER, Node, short

CUT = ("path", "rect", "circle", "ellipse", "line", "polyline", "polygon")
"""Elements that have an outline."""

PATH_DATA = re.compile(rf"\s*[Mm](?:[MmZzLlHhVvCcSsQqTtAa\s,]|{NUMBER})*")
"""svgpathtools passes over characters that mean nothing; nothing is passed over here."""

Matrix = npt.NDArray[np.float64]
"""An affine map, shape (3, 3)."""

LONG = 10_000
"""Characters of path data beyond which outlines are not kept for the next element."""


class Unreadable(Exception):
    """Path data that cannot be read; the message says why, its user knows which element's they are."""


def curves(node: Node, matrix: Matrix, width: float, height: float) -> Iterator[Curve]:
    """Every stretch of an element that is drawn without lifting the pen, mm.

    Args:
        matrix: from the element's units to mm.
        width, height: of the viewport, in the element's units.

    Raises:
        InvalidInput: an attribute that cannot be read, or a coordinate that is not a number.
    """
    data = _path_data(node, width, height)
    outline = _outline if len(data) > LONG else _remembered
    try:
        found = outline(data, matrix.tobytes())
    except Unreadable as error:
        raise node.wrong(str(error)) from None
    for curve in found:
        if not np.isfinite(curve.points).all():
            raise node.wrong("coordinates that are not numbers")
        yield curve


def _outline(data: str, matrix: bytes) -> list[Curve]:
    """The strokes of path data under an affine map, given by its bytes.

    Raises:
        Unreadable: the data cannot be read.
    """
    with np.errstate(invalid="ignore"):
        return [_flat(run, np.frombuffer(matrix).reshape(3, 3)) for run in _strokes(_segments(data))]


_remembered = functools.lru_cache(maxsize=256)(_outline)
"""Drawings name the same shape again and again, at the same place too."""


# Basic shapes


def _path_data(node: Node, width: float, height: float) -> str:
    """The outline in the language of ``d``; empty where there is none."""

    def x(name: str) -> float:
        return node.length(name, width)

    def y(name: str) -> float:
        return node.length(name, height)

    match node.tag:
        case "path":
            return node.attributes.get("d", "")
        case "line":
            return f"M{x('x1')!r} {y('y1')!r} L{x('x2')!r} {y('y2')!r}"
        case "polyline" | "polygon":
            points = node.numbers("points")
            if len(points) % 2:
                raise node.wrong(f"points has {len(points)} numbers; they must come in pairs")
            return f"M{' '.join(map(repr, points))}" + "z" * (node.tag == "polygon") if points else ""
        case "circle":
            radius = node.length("r", float(np.hypot(width, height) / np.sqrt(2.0)))
            return _ellipse(node, x("cx"), y("cy"), radius, radius)
        case "ellipse":
            return _ellipse(node, x("cx"), y("cy"), *_radii(node, width, height))
        case _:
            return _rectangle(node, x("x"), y("y"), x("width"), y("height"), *_radii(node, width, height))


def _radii(node: Node, width: float, height: float) -> tuple[float, float]:
    """rx and ry; the one that is not given is the other."""
    rx = node.length("rx", width) if node.get("rx", "auto") != "auto" else None
    ry = node.length("ry", height) if node.get("ry", "auto") != "auto" else None
    return rx if rx is not None else ry or 0.0, ry if ry is not None else rx or 0.0


def _ellipse(node: Node, x: float, y: float, rx: float, ry: float) -> str:
    _check_size(node, rx, ry)
    half = f"A{rx!r} {ry!r} 0 0 1"
    return f"M{x + rx!r} {y!r} {half} {x - rx!r} {y!r} {half} {x + rx!r} {y!r}z" if rx and ry else ""


def _rectangle(node: Node, x: float, y: float, w: float, h: float, rx: float, ry: float) -> str:
    _check_size(node, w, h, rx, ry)
    if not (w and h):
        return ""
    rx, ry = min(rx, w / 2), min(ry, h / 2)
    if not (rx and ry):
        return f"M{x!r} {y!r} h{w!r} v{h!r} h{-w!r}z"
    turn = f"a{rx!r} {ry!r} 0 0 1"
    return (
        f"M{x + rx!r} {y!r} H{x + w - rx!r} {turn} {rx!r} {ry!r} V{y + h - ry!r} {turn} {-rx!r} {ry!r} "
        f"H{x + rx!r} {turn} {-rx!r} {-ry!r} V{y + ry!r} {turn} {rx!r} {-ry!r}z"
    )


def _check_size(node: Node, *sizes: float) -> None:
    if min(sizes) < 0.0:
        raise node.wrong("its size is negative; allowed: 0 or more")


# Path data


def _segments(data: str) -> list[Any]:
    """svgpathtools' Bézier curves, arcs, and lines that lead somewhere.

    Raises:
        Unreadable: the data cannot be read.
    """
    from svgpathtools import Line, parse_path  # slow

    if data.strip() in ("", "none"):
        return []
    match = PATH_DATA.match(data)
    if not match or match.end() < len(data):
        raise Unreadable(f"path data cannot be read from '{short(data[match.end() :] if match else data)}'")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that an arc without radius is a line is known
            return [s for s in parse_path(data) if not (isinstance(s, Line) and s.start == s.end)]
    except Exception as error:  # it raises whatever the mistake leads to
        problem = str(error) or "an arc that ends where it begins"
        raise Unreadable(f"path data cannot be read: {problem}") from None


def _strokes(segments: list[Any]) -> Iterator[list[Any]]:
    """The segments between two lifts of the pen; one that is back where it began is complete."""
    run: list[Any] = []
    for segment in segments:
        if run and (segment.start != run[-1].end or run[-1].end == run[0].start):
            yield run
            run = []
        run.append(segment)
    if run:
        yield run


def _flat(segments: list[Any], matrix: Matrix) -> Curve:
    """Connected segments as one curve in mm."""

    def image(z: npt.ArrayLike) -> Complex:
        z = np.asarray(z, complex)
        ahead, up, origin = (complex(*column) for column in matrix[:2].T)
        return np.asarray(z.real * ahead + z.imag * up + origin)

    curves = []
    for kind, run in groupby(segments, _kind):
        if kind == "line":
            lines = list(run)
            curves.append(polyline(image([lines[0].start, *(line.end for line in lines)])))
        elif kind == "arc":
            curves += [smooth(lambda t, s=s: image(_at(s, t)), [0.0, 1.0]) for s in run]  # type: ignore[misc]
        else:
            points = (segment.bpoints() for segment in run)
            curves.append(beziers(image([p if len(p) == 4 else quadratic(*p) for p in points])))
    return linked(curves)


def _kind(segment: Any) -> str:
    from svgpathtools import Arc, Line

    return "line" if isinstance(segment, Line) else "arc" if isinstance(segment, Arc) else "bezier"


def _at(arc: Any, t: npt.NDArray[np.float64]) -> Complex:
    """Points of an elliptic arc."""
    angle = np.radians(arc.theta + arc.delta * t)
    rx, ry = arc.radius.real, arc.radius.imag
    z = arc.center + (rx * np.cos(angle) + 1j * ry * np.sin(angle)) * np.exp(1j * arc.phi)
    return np.where(t == 0.0, arc.start, np.where(t == 1.0, arc.end, z))
