"""Figures of the studies: a function draws into axes that are made for it, and its text is the caption."""

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure


@dataclass(frozen=True)
class Drawing:
    """A figure, its caption (with units and what to see) and what it corresponds to ("Xi2023 Fig. 7")."""

    name: str
    figure: Figure
    caption: str
    source: str


def illustrated(
    source: str,
    columns: int = 1,
    rows: int = 1,
    height: float = 3.6,
    grid: dict[str, Any] | None = None,
    spines: bool = True,
    layout: Any = "constrained",
    words: dict[str, Any] | None = None,
    **shared: Any,
) -> Callable[[Callable[..., None]], Callable[..., Drawing]]:
    """Makes a drawing of a function that draws, called as the function is; it gets the axes before its own arguments.

    Args:
        source: what it corresponds to.
        columns, rows: of axes; without columns the function gets the empty figure.
        height: inches, of 8 in width.
        grid: of every axes, as :meth:`Axes.grid` takes it; None: none.
        spines: whether axes have a line above and on the right.
        layout: of the figure.
        words: what stands for names in braces in the caption.
        shared: what axes share, as :meth:`Figure.subplots` takes it.
    """

    def register(function: Callable[..., None]) -> Callable[..., Drawing]:
        name = function.__name__.strip("_").replace("_", "-")

        @functools.wraps(function)
        def made(*data: Any, **named: Any) -> Drawing:
            figure = Figure(figsize=(8.0, height), dpi=110, layout=layout)
            axes = figure.subplots(rows, columns, squeeze=False, **shared).ravel() if columns else ()
            for ax in axes:
                ax.spines[["top", "right"]].set_visible(spines)
                if grid:
                    ax.grid(**grid)
            function(*(axes if columns else (figure,)), *data, **named)
            caption = " ".join((inspect.getdoc(function) or "").split())
            return Drawing(name, figure, caption.format(**words) if words else caption, source)

        return made

    return register
