"""The part with its kerf, coloured by what the cut was like, and the spot where it is now."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from ..engine.quantity import check_choice
from .letters import font

Floats = npt.NDArray[np.float64]

WIDTH, HEIGHT = 720, 560
_MARGIN, _BAR = 18, 74
_SCALE = 2
"""Drawn this much larger and then reduced, which smooths the lines."""

_GROUND, _INK, _QUIET, _OUTLINE, _RAPID, _SPOT = "#ffffff", "#1a1d20", "#555c63", "#d5d9dd", "#a5abb1", "#d55e00"
_EDGE = "#8b9198"


def _anchors(colours: str) -> Floats:
    return np.array([list(bytes.fromhex(each)) for each in colours.split()], float)


# Anchors of a colour scale whose lightness rises evenly (viridis, Smith and van der Walt 2015).
EVEN = _anchors("440154 482878 3e4a89 31688e 26828e 1f9e89 35b779 6dcd59 b4de2c fde725")
DIVERGING = _anchors("b35806 f1a340 ebebeb 998ec3 542788")


@dataclass(frozen=True)
class Quantity:
    """What the kerf can be coloured by: unit, factor from mm, least range of the scale, whether it has a sign."""

    title: str
    unit: str
    factor: float
    least: float
    signed: bool = False


QUANTITIES = {
    "standoff": Quantity("standoff error", "µm", 1e3, 10.0, True),
    "contour": Quantity("contour error", "µm", 1e3, 10.0, True),
    "dross": Quantity("dross", "mm", 1.0, 0.02),
    "roughness": Quantity("roughness Rz", "µm", 1e3, 2.0),
}


@dataclass(frozen=True)
class Kerf:
    """A trace of the spot: mm, one entry a period; ``cutting``: lead-in or cut; ``values``: mm, by name."""

    outlines: list[Floats]
    x: Floats
    y: Floats
    cutting: npt.NDArray[np.bool_]
    values: dict[str, Floats]
    through: npt.NDArray[np.bool_]
    title: str = ""


def picture(kerf: Kerf, colour: str = "standoff", limits: tuple[float, float] | None = None) -> npt.NDArray[np.uint8]:
    """The picture, uint8 of shape (HEIGHT, WIDTH, 3).

    Rapids are thin and grey; where the beam does not cut through, the kerf has a black edge; the dot is the spot.

    Args:
        kerf: what is drawn.
        colour: a name of :data:`QUANTITIES`.
        limits: ends of the scale in the quantity's unit; None: the 1st and 99th percentile.

    Raises:
        InvalidInput: unknown quantity.
    """
    check_choice(colour, QUANTITIES, "quantity")
    quantity = QUANTITIES[colour]
    values = quantity.factor * kerf.values[colour]
    low, high = limits or limits_of(values[kerf.cutting], quantity)
    image = Image.new("RGB", (_SCALE * WIDTH, _SCALE * HEIGHT), _GROUND)
    draw = ImageDraw.Draw(image)
    everything = np.concatenate([*kerf.outlines, np.stack([kerf.x, kerf.y], axis=1)])
    place = _placing(everything)
    for outline in kerf.outlines:
        draw.line([tuple(p) for p in place(outline).tolist()], fill=_OUTLINE, width=_SCALE * 6, joint="curve")
    way = place(np.stack([kerf.x, kerf.y], axis=1))
    # As many pieces as can be seen, each of one colour.
    steps = np.append(0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T)))
    marks = np.unique(np.searchsorted(steps, np.arange(0.0, steps[-1] + 4.0, 4.0)).clip(0, len(way) - 1))
    shades = _shades(values, low, high, quantity.signed)
    lines = [(b, [tuple(way[a].tolist()), tuple(way[b].tolist())]) for a, b in pairwise(marks.tolist())]
    for b, line in lines:
        if not kerf.cutting[b]:
            draw.line(line, fill=_RAPID, width=_SCALE)
    for b, line in lines:
        if kerf.cutting[b]:
            draw.line(line, fill=_EDGE if kerf.through[b] else _INK, width=_SCALE * (6 if kerf.through[b] else 8))
            draw.line(line, fill=tuple(shades[b].tolist()), width=_SCALE * 4)
    if len(way):
        x, y = way[-1]
        r = 5.0 * _SCALE
        draw.ellipse((x - r, y - r, x + r, y + r), fill=_SPOT, outline=_GROUND, width=_SCALE)
    _legend(draw, kerf.title, quantity, low, high)
    return np.asarray(image.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS))


def limits_of(values: Floats, quantity: Quantity) -> tuple[float, float]:
    """Ends of a scale that shows ``values``: the 1st and 99th percentile, no nearer to each other than makes sense."""
    good = values[np.isfinite(values)]
    if len(good) == 0:
        return (-quantity.least, quantity.least) if quantity.signed else (0.0, quantity.least)
    if quantity.signed:
        most = max(float(np.quantile(np.abs(good), 0.99)), quantity.least)
        return -most, most
    low, high = (float(q) for q in np.quantile(good, (0.01, 0.99)))
    missing = max(quantity.least - (high - low), 0.0)
    return max(low - 0.5 * missing, 0.0), high + 0.5 * missing


def _placing(points: Floats):
    low, high = points.min(axis=0), points.max(axis=0)
    room = np.array([WIDTH - 2 * _MARGIN, HEIGHT - 2 * _MARGIN - _BAR], float)
    scale = float((room / np.maximum(high - low, 1e-6)).min())
    offset = np.array([_MARGIN, _MARGIN + 22]) + 0.5 * (room - scale * (high - low))

    def place(p: Floats) -> Floats:
        moved = (p - low) * scale
        moved[:, 1] = (high[1] - low[1]) * scale - moved[:, 1]
        return (moved + offset) * _SCALE

    return place


def _shades(values: Floats, low: float, high: float, signed: bool) -> npt.NDArray[np.int64]:
    anchors = DIVERGING if signed else EVEN
    share = np.nan_to_num(np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0)) * (len(anchors) - 1)
    i = np.minimum(share.astype(int), len(anchors) - 2)
    u = (share - i)[:, None]
    return np.rint((1 - u) * anchors[i] + u * anchors[i + 1]).astype(int)


def _legend(draw: ImageDraw.ImageDraw, title: str, quantity: Quantity, low: float, high: float) -> None:
    large, small = font(15 * _SCALE), font(12 * _SCALE)
    draw.text((_MARGIN * _SCALE, 10 * _SCALE), title, fill=_INK, font=large)
    y, x0, x1 = (HEIGHT - 34) * _SCALE, _MARGIN * _SCALE, (_MARGIN + 220) * _SCALE
    ramp = _shades(np.linspace(low, high, x1 - x0), low, high, quantity.signed)
    for i, shade in enumerate(ramp.tolist()):
        draw.line((x0 + i, y, x0 + i, y + 10 * _SCALE), fill=tuple(shade))
    draw.text((x0, y + 12 * _SCALE), f"{low:.3g}", fill=_QUIET, font=small)
    draw.text((x1, y + 12 * _SCALE), f"{high:.3g} {quantity.unit}", fill=_QUIET, font=small, anchor="ra")
    draw.text((x0, y - 18 * _SCALE), quantity.title, fill=_INK, font=small)
    draw.text((x1 + 16 * _SCALE, y - 2 * _SCALE), "black edge: not cut through · grey: rapids", fill=_QUIET, font=small)
