"""What tuning left behind: how much worse a tuned controller gets when one of its parameters is 20 % off."""

import contextlib

import pandas as pd
import plotly.graph_objects as go

from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files
from ..plots.palette import COLOURS, INK
from ..statistics.pooling import declared
from ..store import runs, tabular
from .figure import Figure
from .numbers import fixed
from .suite import Suite


def studies(controllers: list[str]) -> dict[str, pd.DataFrame]:
    """Sensitivity tables (:func:`tune.outcome.sensitivity`) of those controllers that ``kerfgym tune`` made."""
    out = {}
    for name in controllers:
        path = runs.near(name.rpartition("=")[2] if name.count("=") == 1 and ":" not in name else name.split(":")[0])
        if path is None or path.suffix != ".toml":
            continue
        if not files.is_file(table := path.parent / "sensitivity.parquet"):
            continue
        with contextlib.suppress(InvalidInput):  # a table that cannot be read is not shown
            frame = tabular.read_parquet(table)
            if list(frame.columns[:4]) == ["parameter", "value", "side", "moved"] and len(frame) and frame.shape[1] > 4:
                out[name] = frame
    return out


def presets(suites: list[Suite]) -> dict[str, pd.DataFrame]:
    """The same of shipped presets, which the benchmark asked for (:mod:`detuned`); the reference last."""
    out: dict[str, pd.DataFrame] = {}
    for suite in suites:
        if len(detuned := suite.results.detuned):
            found = {str(name): rows for name, rows in detuned.groupby("controller", sort=False)}
            out |= {name: found[name] for name in sorted(found, key=lambda name: name == suite.reference)}
    return out


def figure(found: dict[str, pd.DataFrame], labels: dict[str, str]) -> Figure | None:
    """A view for each tuned controller; None if there is none."""
    views = {labels[name]: _view(frame) for name, frame in found.items()}
    if not views:
        return None
    caption = (
        "How the tuned metric changes, on tune seeds, when a single parameter is moved by 20 % (a whole one by at "
        "least 1) from where the search ended. Short bars: it need not be known well. A bar to the left would say that "
        "the search stopped early, or at a limit such as Ms."
    )
    return Figure(
        "tuned", _title(found, labels), caption, views, "controller", height=_height(next(iter(found.values())))
    )


def _height(frame: pd.DataFrame) -> int:
    return 110 + 44 * int(frame["parameter"].nunique())


def _metric(frame: pd.DataFrame) -> str:
    """What was tuned stands behind the parameter's columns."""
    return str(frame.columns[list(frame.columns).index("moved") + 1])


def _title(found: dict[str, pd.DataFrame], labels: dict[str, str]) -> str:
    """Which parameter of the first controller must be known best."""
    name, frame = next(iter(found.items()))
    change = frame[_metric(frame)]
    if not change.notna().any():
        return "One parameter 20 % off"
    worst = frame.loc[change.idxmax()]
    cost = fixed(100.0 * (float(change.max()) - 1.0), 0 if change.max() > 1.1 else 1)
    return f"{labels[name]}: {worst['parameter']} 20 % off costs most, {cost} %"


def _view(frame: pd.DataFrame) -> go.Figure:
    metric = _metric(frame)
    plot = go.Figure()
    for side, colour, words in ((-1, COLOURS[0], "20 % less"), (1, COLOURS[1], "20 % more")):
        rows = frame[frame["side"] == side]
        told = "%{customdata[0]:.4g} → %{customdata[1]:.4g}: %{x:+.1f} %"
        drawn = {"orientation": "h", "marker": {"color": colour}, "hovertemplate": told}
        x, data = 100.0 * (rows[metric] - 1.0), rows[["value", "moved"]]
        plot.add_bar(y=rows["parameter"], x=x, name=words, customdata=data, **drawn)
    plot.add_vline(0.0, line={"color": INK, "width": 1})
    plot.update_layout(
        barmode="group",
        bargap=0.35,
        xaxis={"title": f"change of the {declared(metric).exact or metric} (%)"},
        height=_height(frame),
        yaxis={"autorange": "reversed"},
        hovermode="closest",
    )
    return plot
