"""Training curves of the policies that took part."""

import contextlib
from typing import Any

import pandas as pd
import plotly.graph_objects as go

from ...envs.control.stack import shelved
from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files
from ..plots.palette import Look
from ..store import runs, tabular
from .figure import Figure, line

CHOSEN_BY = {"HeightFollowing-v0": "RMS of the true gap error on tune seeds (µm)"}
"""By what the best policy of an environment is chosen, where that is not its return (``score`` in its table)."""


def curves(controllers: list[str]) -> dict[str, tuple[pd.DataFrame, dict[str, Any]]]:
    """Evaluations and record of the training of those controllers that are policies' folders and have them.

    ``runs/x/policy`` has them one folder up, a shipped policy beside itself.
    """
    out, shipped = {}, shelved()
    for name in controllers:
        own = name.rpartition("=")[2] if name.startswith(("z=", "xy=", "process=")) else name
        folder = shipped.get(own) or runs.near(own)
        if folder is None:
            continue
        for place in (folder, folder.parent):
            table, record = place / "evaluations.csv", place / "run.json"
            if not files.is_file(folder / "policy.json") or not files.is_file(table):
                continue
            with contextlib.suppress(InvalidInput):  # a curve that cannot be read is not shown
                frame = tabular.read_csv(table)
                about = files.json_(record) if record.is_file() else {}
                if {"steps", "score"} <= set(frame) and frame["score"].notna().any() and isinstance(about, dict):
                    out[name] = (frame, about)
            break
    return out


def figure(
    found: dict[str, tuple[pd.DataFrame, dict[str, Any]]], look: dict[str, Look], labels: dict[str, str]
) -> Figure | None:
    """What the best policy was chosen by, on tune seeds, against simulated steps, a view for each environment, because
    it differs; None if no policy left its evaluations."""
    views: dict[str, go.Figure] = {}
    words = []
    for name, (frame, record) in found.items():
        env = str(record.get("env", "")).removeprefix("kerfgym/") or "environment not recorded"
        if env not in views:
            views[env] = go.Figure().update_layout(
                xaxis={"title": "simulated steps of training", "tickformat": "~s", "rangemode": "tozero"},
                yaxis={"title": CHOSEN_BY.get(env, "minus the mean return on tune seeds")},
                showlegend=True,
            )
        best = int(frame["score"].idxmin())
        seconds = ", %{customdata:.0f} CPU-s" if "cpu_seconds" in frame else ""
        marker = {"symbol": look[name].symbol, "size": [14 if i == best else 8 for i in frame.index]}
        drawn = {"mode": "lines+markers", "name": labels[name], "line": line(look[name]), "marker": marker}
        told = {"customdata": frame.get("cpu_seconds"), "hovertemplate": "%{y:.3g} after %{x:.3s} steps" + seconds}
        views[env].add_scatter(x=frame["steps"], y=frame["score"], **drawn, **told)
        algorithm = f" ({record['algorithm']}, seed {record['seed']})" if {"algorithm", "seed"} <= set(record) else ""
        words.append(f"{labels[name]}{algorithm}: {frame['score'][best]:.3g} after {frame['steps'][best] / 1e6:.3g} M")
    if not views:
        return None
    caption = (
        f"Evaluations without exploration, on tune seeds; the large point is the policy that was kept. "
        f"{'; '.join(words)} steps. One training is one draw: another seed of training would end elsewhere, and "
        "nothing here says how far."
    )
    return Figure("training", "Training curves", caption, views, "environment", height=380)
