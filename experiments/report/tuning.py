"""What tuning left behind: how much worse a tuned controller gets when one of its parameters is 20 % off."""

from pathlib import Path

import pandas as pd
import plotly.graph_objects as go

from .figure import Figure
from .palette import COLOURS, INK
from .suite import Suite


def studies(controllers: list[str]) -> dict[str, pd.DataFrame]:
    """Sensitivity tables (:func:`tune.outcome.sensitivity`) of those controllers that ``kerfgym tune`` made."""
    out = {}
    for name in controllers:
        path = Path(name.rpartition("=")[2] if name.count("=") == 1 and ":" not in name else name.split(":")[0])
        table = path.parent / "sensitivity.parquet"
        if path.suffix == ".toml" and table.is_file():
            frame = pd.read_parquet(table)
            if {"parameter", "side", "moved"} <= set(frame) and len(frame):
                out[name] = frame
    return out


def presets(suites: list[Suite]) -> dict[str, pd.DataFrame]:
    """The same of shipped presets, which the benchmark asked for (:mod:`detuned`)."""
    tables = [s.following.detuned for s in suites if s.following is not None and len(s.following.detuned)]
    return {str(name): rows for table in tables for name, rows in table.groupby("controller", sort=False)}


def figure(found: dict[str, pd.DataFrame], labels: dict[str, str]) -> Figure | None:
    """A view for each tuned controller; None if there is none."""
    views = {labels[name]: _view(frame) for name, frame in found.items()}
    if not views:
        return None
    rows = max(frame["parameter"].nunique() for frame in found.values())
    return Figure(
        "tuned", "One parameter 20 % off",
        "How the tuned metric changes, on tune seeds, when a single parameter is moved by 20 % (a whole one by at "
        "least 1) from where the search ended. Short bars: it need not be known well. A bar to the left would say that "
        "the search stopped early, or at a limit such as Ms.",
        views, "controller", height=110 + 44 * rows,
    )  # fmt: skip


def _view(frame: pd.DataFrame) -> go.Figure:
    columns = list(frame.columns)
    metric = columns[columns.index("moved") + 1]
    plot = go.Figure()
    for side, colour, words in ((-1, COLOURS[0], "20 % less"), (1, COLOURS[1], "20 % more")):
        rows = frame[frame["side"] == side]
        plot.add_bar(
            y=rows["parameter"], x=100.0 * (rows[metric] - 1.0), name=words, orientation="h", marker={"color": colour},
            customdata=rows[["value", "moved"]],
            hovertemplate="%{customdata[0]:.4g} → %{customdata[1]:.4g}: %{x:+.1f} %",
        )  # fmt: skip
    plot.add_vline(0.0, line={"color": INK, "width": 1})
    plot.update_layout(
        barmode="group",
        bargap=0.35,
        xaxis={"title": f"change of {metric} (%)"},
        yaxis={"autorange": "reversed"},
        hovermode="closest",
    )
    return plot
