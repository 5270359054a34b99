"""The plan of a job as a picture, before anything is cut.

It shows what is part and what scrap, where each cut is pierced, how it is entered, in which order, and how the nozzle
travels in between. Its axes are those of the drawing's file and its numbers those of the drawing's contours, as in all
messages, wherever the machine has the sheet.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path as Outline
from matplotlib.patheffects import withStroke

from ...envs.paths.curve import Points
from ...envs.paths.nesting import signed_area
from ...envs.paths.route import Route

INK, QUIET, PART, OUTLINE, HOLE, OPEN = "#1a1d20", "#6b737b", "#dfe7ef", "#1f4e79", "#0f8a80", "#7a4fa3"
LEAD, RAPID, JOINT, WARN = "#d55e00", "#a9b1b9", "#2fa84f", "#c1121f"
COLOURS = {"outline": OUTLINE, "hole": HOLE, "open contour": OPEN, "cut": OUTLINE}
IN_ORDER = LinearSegmentedColormap.from_list("order", ["#3b1f8f", "#b5379a", "#f2a65a"])

WIDTH, WIDEST, TALLEST, FLATTEST = 9.0, 12.0, 9.0, 2.0
"""Inches: width of a picture and of a crowded one, height of the plan in it."""

LEFT, RIGHT = 0.62, 0.23
"""Inches beside the plan."""

MARGIN = 0.035
"""Around the drawing, as a share of its size."""

SMALL = 0.62
"""Share of its size that a small picture has."""

DPI, DPI_SMALL = 200, 150

ROOMY, CROWD = 60, 400
"""Cuts up to which lines are full, and beyond which only some have a number and rapids tell the order by colour."""

NUMBERS = 40
"""Cuts that have a number in a crowd."""

LETTERS_PER_INCH = 135.0
"""Of a font of 1 pt, on average."""

TOLD = 5
"""Warnings below the picture."""

Floats = npt.NDArray[np.float64]


def figure(route: Route, title: str = "", warnings: Sequence[str] | None = None, small: bool = False) -> Figure:
    """The plan of a route.

    Args:
        route: what is drawn.
        title: above it; else the drawing's name.
        warnings: what a user should know; else the route's and the drawing's.
        small: half as large, for a report with several.
    """
    plan = _Plan(route, small)
    told = list(route.drawing.notes + route.warnings if warnings is None else warnings)
    return plan.figure(title or route.drawing.name, told)


class _Plan:
    def __init__(self, route: Route, small: bool) -> None:
        self.nesting = route.nesting
        self.route = route = _in_the_file(route)
        self.small = small
        ways = [p for cut in route.cuts for p in (cut.way, cut.path)]
        every = np.concatenate([*ways, *route.drawing.pieces])
        self.low, self.high = every.min(axis=0), every.max(axis=0)
        self.size = np.maximum(self.high - self.low, 1e-3 * max(float((self.high - self.low).max()), 1e-3))
        share = SMALL if small else 1.0
        count = len(route.cuts)
        self.crowded = count > CROWD
        self.wide = share * (WIDEST if self.crowded else WIDTH)
        room = self.wide - LEFT - RIGHT
        self.tall = float(np.clip(room * self.size[1] / self.size[0], share * FLATTEST, share * TALLEST))
        self.thin = float(np.clip((ROOMY / count) ** 0.4, 0.25, 1.0))
        self.letters = 6.0 if small or count > ROOMY else 7.5

    def figure(self, title: str, told: list[str]) -> Figure:
        lines = [line for text in told[:TOLD] for line in _wrapped(text, int(self.wide * 13.5))]
        lines += [f"and {len(told) - TOLD} more"] if len(told) > TOLD else []
        head, foot, below = 0.62, 0.78, 0.17 * len(lines) + (0.12 if lines else 0.0)
        height = self.tall + head + foot + below
        page = Figure(figsize=(self.wide, height), dpi=DPI_SMALL if self.small else DPI, facecolor="white")
        low, wide = (foot + below) / height, 1.0 - (LEFT + RIGHT) / self.wide
        axes = page.add_axes((LEFT / self.wide, low, wide, self.tall / height))
        self._axes(axes)
        self._paint(axes)
        self._numbers(axes, page)
        left = LEFT / self.wide
        page.text(left, 1.0 - 0.24 / height, title, size=11, weight="bold", color=INK, va="center")
        facts = self._facts()
        letters = min(8.0, LETTERS_PER_INCH * (self.wide - LEFT) / len(facts))
        page.text(left, 1.0 - 0.47 / height, facts, size=letters, color=QUIET, va="center")
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, (below + 0.03) / height), "ncols": 8}
        looks = {"frameon": False, "handlelength": 1.6, "columnspacing": 1.3, "labelcolor": INK}
        page.legend(handles=self._key(), fontsize=7, **place, **looks)
        for k, line in enumerate(lines):
            page.text(left, (below - 0.1 - 0.17 * k) / height, line, size=7, color=WARN, va="center")
        return page

    def _axes(self, axes: Axes) -> None:
        # As many mm an inch in y as in x, with the drawing in the middle.
        inches = np.array([self.wide - LEFT - RIGHT, self.tall])
        scale = float((self.size / inches).max() * (1.0 + 2.0 * MARGIN))
        middle, half = 0.5 * (self.low + self.high), 0.5 * scale * inches
        axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
        axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
        axes.ticklabel_format(style="plain", useOffset=False)  # the file's own numbers, however far from its origin
        axes.tick_params(labelsize=6.5, colors=QUIET, length=2.5, width=0.5)
        axes.set_xlabel("x, mm", size=7, color=QUIET, labelpad=2)
        axes.set_ylabel("y, mm", size=7, color=QUIET, labelpad=2)
        for spine in axes.spines.values():
            spine.set_color("#c8ced4")
            spine.set_linewidth(0.5)

    def _paint(self, axes: Axes) -> None:
        route = self.route
        area, hole = self.nesting.area, self.nesting.hole
        solid = [i for i in np.argsort(-np.abs(area), kind="stable") if area[i]]
        if solid and not route.drawing.programmed:  # what of a programme is a part nobody knows
            # Outlines one way round and holes the other: what is wound around once is part.
            rings = [_ring(p[::-1] if hole[i] else p) for i in solid for p in _lobes(route.drawing.pieces[i])]
            filled = Outline.make_compound_path(*rings)
            patch = PathPatch(filled, facecolor=PART, edgecolor="none", zorder=1, transform=axes.transData)
            axes.add_artist(patch)  # add_patch would look at every point to find the limits, which are known
        if len(route.cuts) > 1:
            moves = [[a.path[-1], b.way[0]] for a, b in zip(route.cuts, route.cuts[1:], strict=False)]
            if self.crowded:
                order = np.linspace(0.0, 1.0, len(moves))
                rapids = LineCollection(moves, array=order, cmap=IN_ORDER, linewidths=0.5, zorder=2)
            else:
                rapids = LineCollection(moves, colors=RAPID, linewidths=0.7, linestyles=(0, (3, 2)), zorder=2)
                self._arrows(axes, np.array(moves))
            axes.add_collection(rapids, autolim=False)
        for kind, colour in COLOURS.items():
            paths = [c.path for c in route.cuts if self._kind(c.contour) == kind]
            self._lines(axes, paths, colour, 1.2, 3)
        leads = [c.way for c in route.cuts if len(c.way) > 1]
        self._lines(axes, leads, LEAD, 1.3, 4)
        dot = 3.4 * self.thin
        pierced = np.array([c.way[0] for c in route.cuts])
        axes.plot(*pierced.T, "o", ms=dot, mfc=LEAD, mec="white", mew=0.3 * self.thin, zorder=5)
        self._lines(axes, route.joints, JOINT, 3.0, 6)
        tight = np.array([c.way[0] for c in route.cuts if c.how == "on the contour"]).reshape(-1, 2)
        axes.plot(*tight.T, "o", ms=max(9.0 * self.thin, 5.0), mfc="none", mec=WARN, mew=1.0, zorder=7)
        crossing = np.array(self.crossing).reshape(-1, 2)
        axes.plot(*crossing.T, "x", ms=max(8.0 * self.thin, 5.0), mec=WARN, mew=1.4, zorder=7)

    def _lines(self, axes: Axes, lines: list[Points], colour: str, width: float, above: int) -> None:
        drawn = LineCollection(lines, colors=colour, linewidths=width * self.thin, zorder=above)
        axes.add_collection(drawn, autolim=False)

    def _arrows(self, axes: Axes, moves: Floats) -> None:
        """Heads in the middle of moves that are long enough."""
        way = moves[:, 1] - moves[:, 0]
        long = np.hypot(*way.T) > 0.04 * self.size.max()
        middle, angle = moves[long].mean(axis=1), np.degrees(np.arctan2(way[long, 1], way[long, 0]))
        for at, turn in zip(middle, angle, strict=True):
            axes.plot(*at, marker=(3, 0, turn - 90.0), ms=4.0 * self.thin, mfc=RAPID, mec="none", zorder=2)

    def _numbers(self, axes: Axes, page: Figure) -> None:
        """The number of each contour, beside its first pierce point, where there is room."""
        scale = page.dpi / 72.0
        pierced = axes.transData.transform(np.array([c.way[0] for c in self.route.cuts]))
        high, wide = 1.15 * self.letters * scale, 0.62 * self.letters * scale
        taken: set[tuple[int, int]] = set()
        cell = 0.6 * high
        for k in self._numbered():
            cut, at = self.route.cuts[k], pierced[k]
            number = self.route.drawing.number(cut.contour)
            width = wide * len(str(number))
            for dx, dy in self._beside(cut.way):
                x = at[0] + dx * (0.5 * width + 4.5 * scale * self.thin)
                y = at[1] + dy * (0.5 * high + 3.0 * scale * self.thin)
                box = {
                    (i, j)
                    for i in range(int((x - 0.5 * width) // cell), int((x + 0.5 * width) // cell) + 1)
                    for j in range(int((y - 0.5 * high) // cell), int((y + 0.5 * high) // cell) + 1)
                }
                if not box & taken:
                    taken |= box
                    place = axes.transData.inverted().transform((x, y))
                    halo = [withStroke(linewidth=1.6, foreground="white", alpha=0.85)]
                    looks = {"size": self.letters, "color": INK, "ha": "center", "va": "center", "zorder": 8}
                    axes.text(*place, str(number), **looks, path_effects=halo)
                    break

    def _numbered(self) -> list[int]:
        """Cuts whose contour's number is told: the first of each; in a crowd the first, the last, and some in between,
        if there are any those that loosen a part."""
        cuts, nesting = self.route.cuts, self.nesting
        if not self.crowded:
            return [k for k, cut in enumerate(cuts) if k == 0 or cuts[k - 1].contour != cut.contour]
        holding = {j for around in nesting.around for j in around}
        parts = [k for k, cut in enumerate(cuts) if cut.contour in holding and not nesting.hole[cut.contour]]
        some = parts if 3 < len(parts) <= NUMBERS else range(len(cuts))
        return [0, *(some[k] for k in np.unique(np.linspace(0, len(some) - 1, NUMBERS).astype(int))), len(cuts) - 1]

    def _beside(self, way: Points) -> list[tuple[float, float]]:
        """Directions of a number from its pierce point, away from the lead-in first."""
        away = way[0] - way[-1]
        angle = np.arctan2(away[1], away[0]) if len(way) > 1 else np.pi / 4
        turns = angle + np.radians([0.0, 50.0, -50.0, 100.0, -100.0])
        return [(float(np.cos(a)), float(np.sin(a))) for a in turns]

    @property
    def crossing(self) -> list[tuple[float, float]]:
        """Where contours cross themselves or others, one place for each."""
        return [(m.x, m.y) for m in self.route.drawing.meetings.found if not m.along]

    def _kind(self, contour: int) -> str:
        nesting = self.nesting
        if self.route.drawing.programmed:
            return "cut"
        return "open contour" if not nesting.area[contour] else "hole" if nesting.hole[contour] else "outline"

    def _facts(self) -> str:
        route = self.route
        low, high = route.drawing.bounds
        size = high - low
        words = [f"{size[0]:.5g} × {size[1]:.5g} mm, drawn in {route.drawing.units}"]
        words += [_count(len(route.drawing.pieces), "contour"), _count(len(route.cuts), "pierce")]
        words += [f"{_length(route.cut_length)} cut", f"{_length(route.move_length)} rapid"]
        words += [_count(len(route.joints), "joint")] if route.joints else []
        words.append("cut as programmed" if route.drawing.programmed else f"kerf {route.cutting.kerf:.2g} mm")
        return " · ".join(words)

    def _key(self) -> list[Patch | Line2D]:
        route = self.route
        kinds = {self._kind(c.contour) for c in route.cuts}
        out: list[Patch | Line2D] = []
        if kinds & {"outline", "hole"}:
            out += [Patch(fc=PART, label="part"), Patch(fc="white", ec="#c8ced4", lw=0.6, label="scrap")]
        out += [Line2D([], [], color=colour, lw=1.4, label=kind) for kind, colour in COLOURS.items() if kind in kinds]
        dot = {"marker": "o", "ms": 4, "mfc": LEAD, "mec": "white", "mew": 0.3}
        has = any(len(c.way) > 1 for c in route.cuts)
        label = "pierce, lead-in" if has else "pierce"
        out.append(Line2D([], [], color=LEAD if has else "none", lw=1.4, label=label, **dot))
        if route.joints:
            out.append(Line2D([], [], color=JOINT, lw=3.0, label="joint"))
        if self.crowded:
            shades = ("first rapids", IN_ORDER(0.0)), ("last rapids", IN_ORDER(1.0))
            out += [Line2D([], [], color=colour, lw=1.2, label=label) for label, colour in shades]
        elif len(route.cuts) > 1:
            out.append(Line2D([], [], color=RAPID, lw=0.9, ls="--", label="rapid"))
        if any(c.how == "on the contour" for c in route.cuts):
            ring = {"marker": "o", "ms": 7, "mfc": "none", "mec": WARN}
            out.append(Line2D([], [], color="none", label="no room for a lead-in", **ring))
        if self.crossing:
            cross = {"marker": "x", "ms": 6, "mec": WARN, "mew": 1.4}
            out.append(Line2D([], [], color="none", label="contours cross", **cross))
        return out


def _in_the_file(route: Route) -> Route:
    """The route where the drawing's file has it."""
    at, drawing = np.array(route.drawing.origin), route.drawing
    return replace(
        route,
        drawing=replace(drawing, pieces=[p + at for p in drawing.pieces], origin=(0.0, 0.0)),
        cuts=[replace(cut, way=cut.way + at, path=cut.path + at) for cut in route.cuts],
        joints=[joint + at for joint in route.joints],
    )


def _lobes(piece: Points) -> list[Points]:
    """What a closed contour encloses, by the even-odd rule: itself, counter-clockwise, or, if it crosses itself, the
    rings of its lobes, outer ones counter-clockwise and those within them clockwise."""
    import shapely  # type: ignore[import-untyped]  # slow, as the readers of files are

    shape = shapely.Polygon(piece)
    if shape.is_valid:
        return [piece if signed_area(piece) > 0 else piece[::-1]]
    parts = [p for p in shapely.get_parts(shapely.make_valid(shape)) if p.area]
    polygons = [shapely.orient_polygons(q) for p in parts for q in shapely.get_parts(p)]
    return [np.array(ring.coords) for q in polygons for ring in (q.exterior, *q.interiors)]


def _ring(points: Points) -> Outline:
    codes = np.full(len(points), Outline.LINETO)
    codes[0], codes[-1] = Outline.MOVETO, Outline.CLOSEPOLY
    return Outline(points, codes)


def _wrapped(text: str, letters: int) -> list[str]:
    return textwrap.wrap(f"• {text}", letters, subsequent_indent="   ")[:3]


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _length(mm: float) -> str:
    return f"{mm / 1000:.1f} m" if mm >= 9999.5 else f"{mm:.4g} mm"
