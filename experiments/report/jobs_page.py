"""The report of a benchmark of jobs: table, pictures of the kerf, quality against following error; one HTML file."""

import base64
import io
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from PIL import Image

from ...envs.job_metrics import METRICS
from ...envs.kerf_picture import Kerf, picture
from ...envs.paths.job import CUT, LEAD_IN
from ...envs.scenarios import SPLITS
from ..budgets import MARKS, in_words
from ..jobs import JobResults
from ..runs import atomic

TEMPLATE = "jobs.html"
COLUMNS = (
    "contour_rms", "contour_max", "gap_rms", "dross", "roughness", "iso_roughness", "through", "kerf", "taper",
    "iso_taper", "time", "mean_feed", "energy",
)  # fmt: skip
PICTURES = 2
"""Scenarios whose kerfs are drawn."""


def write_jobs(folder: Path, results: JobResults) -> Path:
    """Writes ``report.html`` and ``plots/*.png`` into ``folder``; returns the page's path."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    summary = results.summary().sort_values("score")
    figures = [_saved(folder, *made) for made in (*_kerfs(results), *_sensitivity(results))]
    pooled = results.pooled(results.metric)
    page = environment.get_template(TEMPLATE).render(
        headline=headline(results, summary), rows=[_row(name, summary.loc[name], results) for name in summary.index],
        columns=[(name, METRICS[name].unit if name in METRICS else "range") for name in COLUMNS], metric=results.metric,
        unit=METRICS[results.metric].unit, reference=results.reference, labels=results.labels, figures=figures,
        scenarios=[
            {"name": s, "summary": results.summaries.get(s, ""), "core": s in results.core,
             "cells": [_text(pooled.at[name, s]) for name in summary.index]}
            for s in results.scenarios
        ],
        names=list(summary.index), meta=results.meta, warnings=warnings(results),
        command=results.meta.get("command", ""),
        marks={mark: text for mark, text in MARKS.items() if (summary["budget"] == mark).any()},
    )  # fmt: skip
    path = folder / "report.html"
    with atomic(path) as part:
        part.write_text(page, encoding="utf-8")
    return path


def headline(results: JobResults, summary: pd.DataFrame) -> str:
    """The main finding in a sentence."""
    good = summary[np.isfinite(summary["score"])]
    if not len(good):
        return "No controller finished every job of the core, so there is nothing to compare."
    best, unit = good.index[0], METRICS[results.metric].unit
    words = f"{best} has the smallest {results.metric}: {_text(good['score'].iloc[0])} {unit}"
    if results.reference in good.index and best != results.reference:
        return f"{words}, {good['ratio'].iloc[0]:.2f} times better than {results.reference}."
    return f"{words}."


def warnings(results: JobResults) -> list[str]:
    """What makes the comparison unfair: seeds that tuning or training may have seen."""
    seeds = {int(seed) for seed in results.runs["seed"]}
    return [
        f"{sum(seed in SPLITS[split] for seed in seeds)} of {len(seeds)} seeds belong to the {split} split: "
        "a controller that was fitted to them is flattered."
        for split in ("tune", "train")
        if any(seed in SPLITS[split] for seed in seeds)
    ]


def _text(value: Any) -> str:
    if isinstance(value, str):
        return value
    if not np.isfinite(value):
        return "failed"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _row(name: str, row: pd.Series, results: JobResults) -> dict[str, Any]:
    return {
        "name": name, "reference": name == results.reference, "score": _text(row["score"]),
        "ratio": _text(row["ratio"]),
        "cells": [_text(row[column]) for column in COLUMNS], "collisions": f"{row['collisions']}/{row['count']}",
        "failed": int(row["failed"]), "budget": in_words(row),
    }  # fmt: skip


def _kerfs(results: JobResults) -> list[tuple[str, str, np.ndarray]]:
    """``(stem, caption, image)`` of the shown runs."""
    out: list[tuple[str, str, np.ndarray]] = []
    if not len(results.traces):
        return out
    folder_names = list(results.traces["scenario"].unique())[:PICTURES]
    for scenario in folder_names:
        for controller, frame in results.traces[results.traces["scenario"] == scenario].groupby(
            "controller", sort=False
        ):
            for colour in ("contour", "roughness") if results.metric == "contour_rms" else ("standoff", "roughness"):
                title = f"{scenario} · {controller}"
                out.append((f"kerf-{scenario}-{len(out)}-{colour}", f"{title}, coloured by {colour}, seed "
                            f"{int(frame['seed'].iloc[0])}.", picture(kerf_of(frame, title), colour)))  # fmt: skip
    return out


def kerf_of(frame: pd.DataFrame, title: str = "") -> Kerf:
    """The picture's data of a trace."""
    cutting = frame["phase"].isin([LEAD_IN, CUT]).to_numpy()
    x, y = (frame[name].to_numpy(float) for name in ("x", "y"))
    names = {"standoff": "gap_error", "contour": "error", "dross": "dross", "roughness": "roughness"}
    return Kerf(
        [],
        x,
        y,
        cutting,
        {k: frame[v].to_numpy(float) for k, v in names.items()},
        frame["margin"].to_numpy() >= 1.0,
        title,
    )


def _sensitivity(results: JobResults) -> list[tuple[str, str, np.ndarray]]:
    from .quality_plot import quality_against_error

    made = [(name, *quality_against_error(name, thickness)) for name, thickness in results.materials]
    return [(f"quality-{name}", words, image) for name, image, words in made]


def _saved(folder: Path, stem: str, caption: str, image: np.ndarray) -> dict[str, Any]:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG")
    data = buffer.getvalue()
    with atomic(folder / "plots" / f"{stem}.png") as part:
        part.write_bytes(data)
    return {
        "name": stem, "text": caption, "data": base64.b64encode(data).decode("ascii"), "width": image.shape[1],
        "height": image.shape[0],
    }  # fmt: skip
