"""A figure of the page: plotly's data with what it shows, how it is read, and what made it."""

import json
from dataclasses import dataclass, field
from typing import Any

import plotly.graph_objects as go
from plotly.io._json import to_json_plotly

from ..plots.palette import Look


@dataclass(frozen=True)
class Figure:
    """One figure, or several between which the reader chooses.

    Attributes:
        name: its id in the page.
        title: what it shows, as a statement where there is one.
        text: how it is read.
        views: plots by the words that choose them; a single one has no menu.
        choice: what the menu chooses.
        height: px.
        least: px of width below which it scrolls instead of shrinking.
    """

    name: str
    title: str
    text: str
    views: dict[str, go.Figure]
    choice: str = "show"
    height: int = 420
    least: int = 0
    folded: bool = False
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def data(self) -> str:
        """The plots as JSON, arrays as base64; it may stand in a page."""
        return as_json({"views": [_bare(plot) for plot in self.views.values()], **self.options})


def as_json(data: Any) -> str:
    """JSON that may stand between the tags of a script."""
    text = data if isinstance(data, str) else to_json_plotly(data)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _bare(plot: go.Figure) -> dict[str, Any]:
    """Without plotly's template; the page has one for all."""
    plain = json.loads(plot.to_json())
    plain["layout"].pop("template", None)
    return plain


def line(look: Look, width: float = 2.0) -> dict[str, Any]:
    """Of a controller."""
    return {"color": look.colour, "dash": look.dash, "width": width}


def logarithmic(low: float, high: float) -> dict[str, Any]:
    """A logarithmic axis from ``low`` to ``high`` with ticks in plain numbers, as many as are legible."""
    import math

    decades = math.log10(high / low)
    steps: tuple[float, ...] = (1,)
    for least, choice in ((4.0, (1, 3)), (2.5, (1, 2, 5)), (1.5, (1, 2, 3, 5)), (0.7, (1, 1.5, 2, 3, 4, 5, 6, 8))):
        if decades < least:
            steps = choice
    ticks = [
        s * 10.0**k
        for k in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        for s in steps
        if low <= s * 10.0**k * (1 + 1e-9) and s * 10.0**k <= high * (1 + 1e-9)
    ]
    ends, names = [math.log10(low), math.log10(high)], [f"{tick:g}" for tick in ticks]
    return {"type": "log", "range": ends, "tickvals": ticks, "ticktext": names}
