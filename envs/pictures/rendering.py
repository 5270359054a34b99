"""Pictures of the height-following machine: one frame from one :class:`Scene`.

Above, the sheet's cross-section around the nozzle, x to scale and z exaggerated, which the picture states; below, the
last second of the error. Blue is what is true, orange is what the controller is told. Curves and edges are
anti-aliased column by column in numpy, which costs a tenth of drawing the frame at twice its size; Pillow gives the
letters, and is imported by the :class:`Renderer` only.
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..engine.quantity import InvalidInput
from ..plant import sensor
from .letters import font

Floats = npt.NDArray[np.floating]

Pixels = npt.NDArray[np.uint32]
"""Red, green, blue and an idle byte in one number: several times faster to paint than three bytes."""

# Okabe and Ito's palette, which the colour-blind can tell apart, and greys.
TRUE, REPORTED, SET, OVERRIDE, BEAM = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7"
WHITE, INK, QUIET, GRID, STRIP = "#FFFFFF", "#202428", "#5F666D", "#DDE1E5", "#EFF1F3"
STEEL, UNKNOWN, EDGE, NOZZLE = "#C3CFDB", "#E7ECF1", "#55687A", "#56606A"

WIDTH, HEIGHT = 960, 540
"""px, the size for which lengths below are given; others are scaled."""

SMALLEST = (480, 270)
"""px, width and height below which nothing could be read."""

HALF = 14.0
"""mm of path shown on each side of the nozzle."""

FACE, BORE = (getattr(sensor.Params(), name) for name in ("radius", "bore"))
"""mm, radii of the nozzle's face and bore."""

BODY, SLOPE = FACE + 2.5, 1.2
"""mm, radius of the nozzle's body, and rise of its cone over its run."""

EXAGGERATIONS = (16.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
"""z scale over x scale."""

TALLEST, DEEPEST, RECENT = 0.48, 0.28, 0.4
"""Shares of the panel's height that the gap, and that of the last so many s, may take above and below the surface."""

GROUND = 2 / 3
"""Share of the panel's height above the surface under the nozzle."""

DRIFT, DRIFT_S = 0.1, 0.3
"""Share of the panel by which the surface may leave its place, and time constant (s) with which it comes back."""

RELEASE = 0.8
"""A finer scale is taken once it would be filled to this share, so that a value at a limit does not flicker."""

RANGES = tuple(digit * 10.0**power for power in range(1, 6) for digit in (1, 2, 5))[1:]
"""µm, half ranges of the error's axis."""

WINDOW = 1.0
"""s of error shown."""

MODES = {
    "stop": "stopped",
    "home": "homing",
    "move": "moving",
    "calibrate": "calibrating",
    "follow": "following",
    "hold": "holding",
    "alarm": "alarm",
    "protect": "protecting",
}
"""Modes of the supervisor in words; any other stands for itself."""


@dataclass(frozen=True)
class Scene:
    """What a frame shows; lengths in mm, times in s."""

    time: float  # s since the start of the episode
    distance: float  # mm along the path, of the nozzle
    ahead: np.ndarray  # (k, 2): distance along the path, ascending, and surface height, around the nozzle, mm
    void: np.ndarray  # (k,) bool: no sheet there (hole, edge)
    head: float  # mm, true height of the nozzle tip
    gap: float  # mm, true gap
    set_height: float  # mm
    reported: float  # mm, measured filtered height
    mode: str  # one of supervisor.MODES
    override: bool  # the supervisor's command, not the law's, went to the drive
    trace: np.ndarray  # (n, 3), the last second: time, s, true and reported error, mm; NaN where there is none
    title: str  # scenario · controller


class Renderer:
    """Draws frames. It remembers the scales of the last frame, so that they change seldom.

    Args:
        width: of the frames, px.
        height: of the frames, px.

    Raises:
        InvalidInput: the frame is smaller than 480×270 px.
    """

    def __init__(self, width: int = WIDTH, height: int = HEIGHT) -> None:
        if width < SMALLEST[0] or height < SMALLEST[1]:
            least = f"{SMALLEST[0]}×{SMALLEST[1]}"
            raise InvalidInput(f"a frame of {width}×{height} px is too small; allowed: {least} and up")
        self._k = k = min(width / WIDTH, height / HEIGHT)
        self._title, self._text, self._small = (_Letters(max(8, round(size * k))) for size in (17, 14, 12))
        self._left, self._right = round(66 * k), width - round(146 * k)
        self._top, self._bottom = round(54 * k), round(0.61 * height)
        self._low, self._lowest = self._bottom + round(44 * k), height - round(54 * k)
        self._strip = height - round(30 * k)
        self._x_scale = (self._right - self._left) / (2 * HALF)  # px/mm
        spans = [(self._bottom - self._top) / (self._x_scale * e) for e in EXAGGERATIONS]
        self._spans = dict(zip(spans, EXAGGERATIONS, strict=True))  # mm of height that the panel shows
        self._page = np.full((height, width), _code(WHITE)[0])
        self._furnish(self._page)
        self._canvas = self._page.copy()  # painted anew for each frame; fresh memory would cost 1 ms
        self._time = -math.inf
        self._forget()

    def frame(self, scene: Scene) -> npt.NDArray[np.uint8]:
        """The picture of ``scene``, uint8 of shape (height, width, 3)."""
        if scene.time < self._time:
            self._forget()
        page = self._canvas
        page[:] = self._page
        title = self._title.fit(scene.title, page.shape[1] - 2 * self._x(14))
        self._title.write(page, title, self._x(14), 18 * self._k, INK)
        trace = _trace(scene)
        self._paint_machine(page, scene, trace)
        rms = self._paint_errors(page, scene.time, trace)
        self._paint_status(page, scene, rms)
        self._time = scene.time
        picture = np.empty((*page.shape, 3), np.uint8)
        for i in range(3):
            picture[:, :, i] = _channels(page)[:, :, i]
        return picture

    def _forget(self) -> None:
        self._ground = math.nan  # mm, height that stands at GROUND
        self._span = self._range = 0.0  # mm of height and µm of error shown

    def _furnish(self, page: Pixels) -> None:
        """What all frames share."""
        k, left, right = self._k, self._left, self._right
        page[self._strip :] = _code(STRIP)[0]
        for top, bottom in ((self._top, self._bottom), (self._low, self._lowest)):
            page[top : bottom + 1, left - 1] = page[bottom, left - 1 : right] = _code(QUIET)[0]
        self._small.write(page, "error, µm", left, self._low - 14 * k, QUIET)
        self._small.write(page, "distance, mm", right + 24 * k, self._bottom + 13 * k, QUIET)
        self._small.write(page, "time, s", right + 24 * k, self._lowest + 12 * k, QUIET)
        x, swatch = right + round(16 * k), round(22 * k)
        for y, name, colour, thickness, dash in (
            (self._top + 14 * k, "set height", SET, 2.0, True),
            (self._top + 62 * k, "reported height", REPORTED, 2.0, False),
            (self._low + 6 * k, "true", TRUE, 2.6, False),
            (self._low + 50 * k, "reported", REPORTED, 1.6, False),
        ):
            marks = np.ones(swatch) if not dash else np.where(np.arange(swatch) % (9 * k) < 5 * k, 1.0, np.nan)
            _stroke(page[:, x : x + swatch], y * marks, y * marks, max(1.0, thickness * k), colour)
            self._small.write(page, name, x + swatch + 6 * k, y, QUIET)
        self._small.write(page, "nozzle at", x + swatch + 6 * k, self._top + 110 * k, QUIET)

    def _x(self, at: float) -> int:
        return round(at * self._k)

    def _paint_machine(self, page: Pixels, scene: Scene, trace: Floats) -> None:
        """The upper panel."""
        k, x_scale = self._k, self._x_scale
        panel = page[self._top : self._bottom, self._left : self._right]
        rows, columns = panel.shape[:2]
        gap, set_height = _finite(scene.gap, 0.0), _finite(scene.set_height, 0.0)
        head = _finite(scene.head, gap)
        recent = trace[trace[:, 0] > scene.time - RECENT, 1]
        least, most = (f.reduce(recent, initial=0.0) for f in (np.fmin, np.fmax))
        gaps = gap, set_height, set_height + least, set_height + most
        self._span = _step(tuple(self._spans), self._span, max(max(gaps) / TALLEST, -min(gaps) / DEEPEST))
        z_scale = rows / self._span

        edges = scene.distance + (np.arange(columns + 1) - columns / 2) / x_scale
        surface, solid, known = _profile(scene, edges)
        under = surface[columns // 2] if solid.any() else head - gap
        self._follow(under, scene.time)

        def y(z: Any) -> Any:  # px from the panel's top
            return GROUND * rows - (z - self._ground) * z_scale

        self._paint_sheet(panel, y(surface), solid, known)
        self._paint_heights(page, y, z_scale)
        self._paint_distances(page, scene.distance)
        dashed = np.where(solid & known & (edges[:-1] % 0.7 < 0.42), 0.0, np.nan)
        wanted = y(surface + set_height)
        _stroke(panel, wanted[:-1] + dashed, wanted[1:] + dashed, max(1.0, 2 * k), SET)

        tip = float(np.clip(y(head), 12 * k, rows))
        self._paint_nozzle(panel, tip, cutting=scene.mode in ("follow", "hold"))
        face, axis = round(FACE * x_scale), columns // 2
        if math.isfinite(scene.reported):
            told = np.full(2 * face, y(head - scene.reported))
            _stroke(panel[:, axis - face : axis + face], told, told, max(1.0, 2 * k), REPORTED)
        if math.isfinite(scene.gap):
            bottom = float(np.clip(y(head - gap), 0, rows))
            self._paint_gap(page, tip, bottom, axis - face, f"gap {_number(gap, 3, 'mm')}")
        x = self._right + self._x(44)
        for at, value in ((34, scene.set_height), (82, scene.reported), (130, scene.head)):
            self._text.write(page, _number(value, 3, "mm"), x, self._top + at * k, INK)
        exaggeration = f"{self._spans[self._span]:.4f}".rstrip("0").rstrip(".")
        self._small.write(page, f"height z, mm (drawn z × {exaggeration})", self._left, self._top - 12 * k, QUIET)

    def _follow(self, under: float, time: float) -> None:
        """Lets the view follow the surface under the nozzle as a camera would: late, but never far off."""
        if math.isnan(self._ground):
            self._ground = under
        passed = max(0.0, time - self._time)
        self._ground += (under - self._ground) * (1 - math.exp(-passed / DRIFT_S))
        far = DRIFT * self._span
        self._ground = min(max(self._ground, under - far), under + far)

    def _paint_sheet(self, panel: Pixels, y: Floats, solid: np.ndarray, known: np.ndarray) -> None:
        """Sheet from its surface to the panel's bottom; paler where nothing is known of it.

        ``y``: surface at the columns' edges, px; ``solid`` and ``known``: bool, one for each column.
        """
        middle = np.clip((y[1:] + y[:-1]) / 2, 0, len(panel))
        if solid.any():
            deep = math.ceil(middle[solid].max())
            for here, colour in ((solid & known, STEEL), (solid & ~known, UNKNOWN)):
                _fill(panel[:deep], np.where(here, middle, np.nan), np.full(len(middle), deep), colour)
                panel[deep:, here] = _code(colour)[0]
        for wall in np.flatnonzero(solid[1:] != solid[:-1]):
            panel[int(middle[wall]) :, wall + 1] = _code(EDGE)[0]
        line = np.where(solid & known, 0.0, np.nan)
        _stroke(panel, y[:-1] + line, y[1:] + line, max(1.0, 1.6 * self._k), EDGE)

    def _paint_heights(self, page: Pixels, y: Callable[[float], float], z_scale: float) -> None:
        """Ticks of z."""
        k, rows = self._k, self._bottom - self._top
        step = _nice(38 * k / z_scale)
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        first, last = self._ground - (1 - GROUND) * self._span, self._ground + GROUND * self._span
        for i in range(math.ceil(first / step), math.floor(last / step) + 1):
            at = y(i * step)
            if 7 * k < at < rows - 4 * k:
                row = self._top + int(at)
                page[row, self._left - self._x(6) : self._left] = _code(QUIET)[0]
                line = page[row, self._left : self._right]
                line[:] = _mix(line, np.float32(0.13), QUIET)
                label = f"{i * step:.{decimals}f}".replace("-", "−")
                self._small.write(page, label, self._left - 10 * k, self._top + at, INK, 1.0)

    def _paint_distances(self, page: Pixels, distance: float) -> None:
        """Ticks of the distance along the path, which move with the sheet."""
        k, bottom = self._k, self._bottom
        for i in range(math.ceil((distance - HALF) / 5), math.floor((distance + HALF) / 5) + 1):
            at = min(self._left + int((5 * i - distance + HALF) * self._x_scale), self._right - 1)
            page[bottom : bottom + self._x(5), at] = _code(QUIET)[0]
            self._small.write(page, f"{5 * i}".replace("-", "−"), at, bottom + 13 * k, INK, 0.5)

    def _paint_nozzle(self, panel: Pixels, tip: float, cutting: bool) -> None:
        """Cone with its bore, as wide as it is, tip at ``tip`` px; its slope is that of z × 1."""
        axis = panel.shape[1] // 2
        bore, face, body = (round(r * self._x_scale) for r in (BORE, FACE, BODY))
        if cutting:
            # The beam narrows to its focus at the tip; the sheet below is the front of the cut.
            across = np.abs(np.arange(-bore, bore) + 0.5) / bore
            reach = np.where(across < 0.2, len(panel), tip * (1 - across) / 0.8)
            _fill(panel[:, axis - bore : axis + bore], np.zeros(2 * bore), reach, BEAM, 0.45)
        radius = np.abs(np.arange(-body, body) + 0.5)
        lowest = np.where(radius > bore, tip - np.maximum(radius - face, 0.0) * SLOPE, np.nan)
        _fill(panel[:, axis - body : axis + body], np.zeros(2 * body), lowest, NOZZLE)

    def _paint_gap(self, page: Pixels, tip: float, surface: float, face: int, text: str) -> None:
        """Dimension between the panel's rows ``tip`` and ``surface``; the nozzle's face begins at column ``face``."""
        panel = page[self._top : self._bottom, self._left : self._right]
        k, rows = self._k, len(panel)
        above, below = sorted((tip, surface))
        at, wing, length = face - self._x(26), max(2, self._x(4)), 10 * k
        if tip > surface:  # in a hole: the arrow stands beside the body
            at -= round((BODY - FACE) * self._x_scale)
        for row in (tip, surface):
            line = panel[:, max(0, at - self._x(8)) : face]
            level = np.full(line.shape[1], row)
            _stroke(line, level, level, max(1.0, k), TRUE, 0.8)
        inside = below - above > 3 * length
        across = np.abs(np.arange(-wing, wing + 1)) / wing * length
        narrow, none = panel[:, at - wing : at + wing + 1], np.zeros(2 * wing + 1)
        for row, down in ((above, not inside), (below, inside)):  # a small gap is pointed at from outside
            _fill(narrow, *((none + row - length, row - across) if down else (row + across, none + row + length)), TRUE)
        outside = (above - 2 * length, above), (below, below + 2 * length)
        for a, b in ((above, below),) if inside else outside:
            panel[max(0, round(a)) : max(0, round(b)), at : at + max(1, self._x(1))] = _code(TRUE)[0]
        width, half = self._text.width(text), 11 * k
        x, middle = max(at - 18 * k - width, 5 * k), float(np.clip((tip + surface) / 2, 12 * k, rows - 12 * k))
        label = panel[round(middle - half) : round(middle + half), round(x - 5 * k) : round(x + width + 5 * k)]
        label[:] = _code(WHITE)[0]  # legible over lines that pass
        self._text.write(page, text, self._left + x, self._top + middle, TRUE)

    def _paint_errors(self, page: Pixels, time: float, trace: Floats) -> float:
        """The lower panel.

        Returns:
            RMS of the true error over the window, µm; NaN without data.
        """
        k = self._k
        panel = page[self._low : self._lowest, self._left : self._right]
        rows, columns = panel.shape[:2]
        end = max(time, WINDOW)
        trace = trace[(trace[:, 0] >= end - WINDOW) & (trace[:, 0] <= end)]
        errors = trace[:, 1:] * 1e3  # µm
        self._range = _step(RANGES, self._range, np.fmax.reduce(np.abs(errors), axis=None, initial=0.0))

        for i in range(math.ceil(5 * (end - WINDOW) - 1e-9), math.floor(5 * end + 1e-9) + 1):
            at = min(self._left + int((i / 5 - end + WINDOW) / WINDOW * columns), self._right - 1)
            page[self._low : self._lowest, at] = _code(GRID)[0]
            page[self._lowest : self._lowest + self._x(5), at] = _code(QUIET)[0]
            self._small.write(page, f"{i / 5:.1f}", at, self._lowest + 12 * k, INK, 0.5)
        for share in (1.0, 0.5, 0.0, -0.5, -1.0):
            row = self._low + int(rows * (1 - share) / 2)
            if share > -1.0:
                page[row, self._left : self._right] = _code(QUIET if share == 0.0 else GRID)[0]
            label = f"{share * self._range:,.0f}".replace(",", " ").replace("-", "−")
            self._small.write(page, label, self._left - 10 * k, row, INK, 1.0)

        x = (trace[:, 0] - end + WINDOW) / WINDOW * columns
        for column, colour, thickness, at in ((0, TRUE, 2.6, 24), (1, REPORTED, 1.6, 68)):
            y = rows / 2 * (1 - errors[:, column] / self._range)
            thickness = max(1.0, thickness * k)
            _stroke(panel, *_envelope(x, y, columns, thickness), thickness, colour)
            last = errors[-1, column] if len(errors) else math.nan
            self._text.write(page, _number(last, 0, "µm", "+"), self._right + self._x(44), self._low + at * k, INK)
        true = errors[~np.isnan(errors[:, 0]), 0]
        return float(np.sqrt(np.mean(true * true))) if len(true) else math.nan

    def _paint_status(self, page: Pixels, scene: Scene, rms: float) -> None:
        rms_decimals = 1 if rms < 1000 else 0
        for x, name, value in (
            (14, "time ", f"{scene.time:.3f} s"),
            (140, "distance ", f"{scene.distance:.1f} mm"),
            (696, "RMS of true error, 1 s: ", _number(rms, rms_decimals, "µm")),
        ):
            end = self._state(page, name, self._x(x), QUIET)
            self._state(page, value, end, INK)
        mode = MODES.get(scene.mode, scene.mode)
        self._state(page, mode, self._x(318), INK, badge=scene.mode == "alarm")
        if scene.override:
            self._state(page, "! supervisor acts", self._x(424), OVERRIDE, badge=True)

    def _state(self, page: Pixels, text: str, x: float, colour: str, badge: bool = False) -> float:
        """Writes in the status line; a badge is white on ``colour``."""
        y, half, margin = (self._strip + len(page)) / 2, 11 * self._k, 8 * self._k
        if not badge:
            return self._text.write(page, text, x, y, colour, ground=STRIP)
        end = x + self._text.width(text)
        page[round(y - half) : round(y + half), round(x - margin) : round(end + margin)] = _code(colour)[0]
        return self._text.write(page, text, x, y, WHITE, ground=colour)


class _Letters:
    """Writes in one size.

    Letters are drawn enlarged and kept as coverages at quarters of a pixel: Pillow takes 0.5 ms for a line, and places
    small letters at whole pixels.
    """

    FINE = 4
    """Enlargement, and steps of a pixel at which a letter may stand."""

    PAD = 1
    """px left of a letter's origin."""

    KEPT = 500
    """Lines kept: most are the same in the next frame."""

    def __init__(self, size: int) -> None:
        self._font = font(size * self.FINE)
        self._middle = 0.36 * size  # of digits and capitals, above the baseline
        self._above, self._below = size, math.ceil(0.4 * size)
        self._line = functools.lru_cache(self.KEPT)(self._written)
        self._letter = functools.cache(self._painted)
        self._advance = functools.cache(lambda letter: self._font.getlength(letter) / self.FINE)

    def width(self, text: str) -> float:
        """px."""
        return sum(map(self._advance, text))

    def fit(self, text: str, room: float) -> str:
        """``text``, cut where it is wider than ``room`` px."""
        if self.width(text) <= room:
            return text
        room -= self._advance("…")
        ends = itertools.accumulate(self._advance(letter) for letter in text)
        return text[: sum(end <= room for end in ends)] + "…"

    def write(
        self, page: Pixels, text: str, x: float, y: float, colour: str, align: float = 0.0, ground: str = WHITE
    ) -> float:
        """Writes on the middle line ``y``, to the right of ``x`` (align 0), about it (0.5) or to its left (1), px.

        ``ground`` is the colour there already; blending with whatever is there would take ten times longer.

        Returns:
            x of the end, px.
        """
        width = self.width(text)
        left, start = divmod(round((x - align * width) * self.FINE), self.FINE)
        line, right, down = self._line(text, start, colour, ground)
        left, top = left + right, round(y + self._middle) + down
        a, b = max(0, -top), min(len(line), len(page) - top)
        c, d = max(0, -left), min(line.shape[1], page.shape[1] - left)
        if a < b and c < d:
            page[top + a : top + b, left + c : left + d] = line[a:b, c:d]
        return x + (1 - align) * width

    def _written(self, text: str, start: int, colour: str, ground: str) -> tuple[Pixels, int, int]:
        """A line without the blank around it, and where that begins from origin − ``start`` / ``FINE``, px."""
        letters, pen = [], start / self.FINE
        for letter in text:
            left, rest = divmod(round(pen * self.FINE), self.FINE)
            letters.append((left, self._letter(letter, rest)))
            pen += self._advance(letter)
        cover = np.zeros((self._above + self._below, math.ceil(pen) + 2 * self.PAD + 2), np.float32)
        for left, mask in letters:
            cover[:, left : left + mask.shape[1]] += mask
        rows, columns = np.flatnonzero(cover.any(axis=1)), np.flatnonzero(cover.any(axis=0))
        if not len(rows):
            return np.zeros((0, 0), np.uint32), 0, 0
        cover = np.minimum(cover[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], np.float32(1))
        line = _mix(np.full(cover.shape, _code(ground)[0]), cover, colour)
        return line, int(columns[0]) - self.PAD, int(rows[0]) - self._above

    def _painted(self, letter: str, start: int) -> Floats:
        """Coverage of a letter whose origin is ``PAD`` + ``start`` / ``FINE`` px from the left."""
        from PIL import Image, ImageDraw

        width, height = math.ceil(self._advance(letter)) + 2 * self.PAD, self._above + self._below
        image = Image.new("L", (width * self.FINE, height * self.FINE))
        origin = self.PAD * self.FINE + start, self._above * self.FINE
        ImageDraw.Draw(image).text(origin, letter, fill=255, font=self._font, anchor="ls")
        return np.asarray(image.reduce(self.FINE), np.float32) / 255


def _finite(value: float, otherwise: float) -> float:
    return float(value) if math.isfinite(value) else otherwise


def _number(value: float, decimals: int, unit: str, sign: str = "") -> str:
    if not math.isfinite(value):
        return f"no value, {unit}"
    rounded = round(value, decimals) or 0.0  # no −0
    return f"{rounded:{sign if rounded else ''}.{decimals}f} {unit}".replace("-", "−")


def _nice(least: float) -> float:
    """Smallest of 1, 2, 5 · 10ⁿ that is not below ``least``."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(digit * power for digit in (1.0, 2.0, 5.0, 10.0) if digit * power >= least * (1 - 1e-9))


def _step(steps: Sequence[float], now: float, need: float) -> float:
    """The smallest of ascending ``steps`` that holds ``need``; ``now`` stays until the need is well below a smaller."""
    if now and need <= now:
        need = min(need / RELEASE, now)
    return next((step for step in steps if step >= need), steps[-1])


def _trace(scene: Scene) -> Floats:
    """The trace with NaN for all that is not a number, and with values that can be drawn."""
    trace = np.asarray(scene.trace, float).reshape(-1, 3)
    return np.where(np.isfinite(trace), np.clip(trace, -1e6, 1e6), np.nan)


def _profile(scene: Scene, edges: Floats) -> tuple[Floats, np.ndarray, np.ndarray]:
    """The sheet under each column of the picture.

    Args:
        scene: what is known.
        edges: distances along the path at the columns' edges, mm, shape (columns + 1,).

    Returns:
        Surface at the edges, mm; whether there is sheet in each column; whether it is known there.
    """
    ahead, void = np.asarray(scene.ahead, float).reshape(-1, 2), np.asarray(scene.void, bool).reshape(-1)
    fine = np.isfinite(ahead).all(axis=1)
    ahead, void = ahead[fine], void[fine]
    middle = (edges[1:] + edges[:-1]) / 2
    if void.all():
        return np.zeros(len(edges)), np.zeros(len(middle), bool), np.zeros(len(middle), bool)
    x, z = ahead[:, 0], ahead[:, 1]
    nearest = np.searchsorted((x[1:] + x[:-1]) / 2, middle)
    # Heights in a hole mean nothing; without them its rims stay square.
    surface = np.interp(edges, x[~void], z[~void])
    return surface, ~void[nearest], (middle >= x[0]) & (middle <= x[-1])


def _envelope(x: Floats, y: Floats, columns: int, thickness: float) -> tuple[Floats, Floats]:
    """Lowest and highest y that a curve takes in each column, as wide as the pen; NaN where there is none, px."""
    if not len(x):
        return np.full(columns, np.nan), np.full(columns, np.nan)
    wide = (thickness - 1) / 2
    left, right = np.arange(columns) - wide, np.arange(columns) + 1 + wide
    starts, ends = (np.interp(np.clip(edge, x[0], x[-1]), x, y) for edge in (left, right))
    low, high = np.fmin(starts, ends), np.fmax(starts, ends)
    low[(right < x[0]) | (left > x[-1])] = np.nan
    at = np.clip(x.astype(int), 0, columns - 1)
    np.fmin.at(low, at, y)
    np.fmax.at(high, at, y)
    return low, high


def _stroke(area: Pixels, y0: Floats, y1: Floats, thickness: float, colour: str, opacity: float = 1.0) -> None:
    """A curve that runs from ``y0`` to ``y1`` in each column, px; NaN: not there."""
    _fill(area, np.minimum(y0, y1) - thickness / 2, np.maximum(y0, y1) + thickness / 2, colour, opacity)


def _fill(area: Pixels, low: Floats, high: Floats, colour: str, opacity: float = 1.0) -> None:
    """Paints each column from ``low`` to ``high``, px from the top, with the ends' share of a pixel; NaN: nothing."""
    low, high = np.maximum(low, 0.0), np.minimum(high, float(len(area)))
    columns = np.flatnonzero(high > low)
    if not len(columns):
        return
    low, high = low[columns], high[columns]
    first, last = low.astype(int), high.astype(int)
    _blend(area, first, columns, np.minimum(first + 1, high) - low, colour, opacity)
    ends = (last > first) & (last < high)
    _blend(area, last[ends], columns[ends], (high - last)[ends], colour, opacity)
    top, left = first.min(), columns[0]
    inner = area[top : last.max(), left : columns[-1] + 1]
    # Boundaries for all columns between the outermost; where there is nothing to paint the first is below the last.
    above, below = np.full((2, inner.shape[1]), len(area), np.int16)
    above[columns - left], below[columns - left] = first, last
    rows = np.arange(top, top + len(inner), dtype=np.int16)[:, None]
    full = (rows > above) & (rows < below)
    if opacity == 1.0:
        np.copyto(inner, _code(colour)[0], where=full)
    else:
        inner[full] = _mix(inner[full], np.float32(opacity), colour)


def _blend(area: Pixels, row: np.ndarray, column: np.ndarray, cover: Floats, colour: str, opacity: float) -> None:
    area[row, column] = _mix(area[row, column], (opacity * cover).astype(np.float32), colour)


def _mix(under: Pixels, cover: Floats | np.float32, colour: str) -> Pixels:
    """Colours between what is ``under`` and ``colour``; ``cover`` from 0 to 1, of the same shape or a number."""
    channels = _channels(np.ascontiguousarray(under))
    mixed = channels + np.asarray(cover)[..., None] * (_code(colour)[1] - channels) + np.float32(0.5)
    return mixed.astype(np.uint8).view(np.uint32)[..., 0]


def _channels(pixels: Pixels) -> npt.NDArray[np.uint8]:
    return pixels[..., None].view(np.uint8)


@functools.cache
def _code(colour: str) -> tuple[np.uint32, Floats]:
    """A colour as a pixel and as four numbers up to 255."""
    channels = np.frombuffer(bytes.fromhex(colour[1:]) + b"\xff", np.uint8)
    return channels.view(np.uint32)[0], channels.astype(np.float32)
