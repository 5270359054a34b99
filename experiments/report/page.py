"""The report: one HTML file that holds everything it shows and opens offline, and its pictures as PNG files."""

import base64
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ...envs.metrics import METRICS
from ...envs.scenarios import SPLITS
from ..budgets import MARKS, in_words
from ..jobs import JobResults
from ..margins import DELAYS, GAINS, STEP
from ..margins import in_words as margin
from ..results import CEILING, REFERENCE, Results
from ..runs import atomic
from . import plots, quality_plot
from .jobs_page import write_jobs
from .pictures import png
from .plots import LIMIT_MS, number

TEMPLATE = "report.html"


@dataclass(frozen=True)
class Picture:
    """A figure of the report: its file's stem, how it is made and read, its section, whether it is folded away."""

    name: str
    make: Callable[[Results], Figure]
    text: str
    section: str
    folded: bool = False
    few_colours: bool = True


# -------------------------------------------------------------------------------------------------- what is concluded


def headline(results: Results, summary: pd.DataFrame | None = None) -> str:
    """The main finding in a sentence: the best of the sensor class against the reference, or else against the next."""
    summary = results.summary() if summary is None else summary
    sensor = _with_score(results, summary)
    if not sensor:
        return "No controller that uses the sensor only has a score, so there is nothing to compare."
    best, score = sensor[0], {name: number(float(summary.loc[name, "score"])) for name in sensor}
    if len(sensor) == 1:
        return f"{best} follows with an RMS error of {score[best]} µm."
    if best == REFERENCE or REFERENCE not in sensor:
        role = ", the reference," if best == REFERENCE else ""
        return f"{best}{role} follows closest: {score[best]} µm against {score[sensor[1]]} µm of {sensor[1]}, the next."
    ratio = float(summary.loc[REFERENCE, "score"] / summary.loc[best, "score"])
    if ratio < 1.005:
        return f"{best} follows as closely as {REFERENCE} ({score[best]} and {score[REFERENCE]} µm)."
    return f"{best} follows {times(ratio)} times closer than {REFERENCE} ({score[best]} against {score[REFERENCE]} µm)."


def remarks(results: Results, summary: pd.DataFrame | None = None) -> list[str]:
    """Sentences that belong to the headline: what it rests on, what speaks against it, what is missing."""
    summary = results.summary() if summary is None else summary
    out, sensor = [], _with_score(results, summary)
    if sensor:
        out.append(f"The error is that of the true gap, RMS while cutting, {plots.scored_in_words(results)}.")
        best = sensor[0]
        row = summary.loc[best]
        scored = plots.scored_scenarios(results)
        if REFERENCE in sensor and best != REFERENCE and len(scored) > 1:
            pooled = results.pooled()
            wins = int((pooled.loc[best, scored] < pooled.loc[REFERENCE, scored]).sum())
            out.append(f"{best} is closer than {REFERENCE} in {wins} of these {len(scored)}.")
        touched, runs = row["collisions"], row["collision_runs"]
        if pd.notna(runs) and runs > 0:
            often = "in none" if not touched else f"in {int(touched)}"
            out.append(f"{best} touched the sheet {often} of the {int(runs)} runs in which it should not.")
        peak = float(row["ms"])
        if math.isnan(peak):
            out.append("Its sensitivity peak Ms was not measured.")
        else:
            limit = f"{'over' if peak > LIMIT_MS else 'within'} the limit of {LIMIT_MS:g}"
            out.append(f"Its sensitivity peak Ms is {number(peak)}, {limit}.")
    if REFERENCE not in summary.index:
        out.append(f"The reference {REFERENCE} was not run, so there are no ratios.")
    elif REFERENCE not in sensor:
        out.append(f"The reference {REFERENCE} has no score because runs failed, so there are no ratios.")
    for name in summary.index[summary["information"] != "sensor"]:
        if np.isfinite(summary.loc[name, "score"]):
            knows = plots.KNOWS.get(str(summary.loc[name, "information"]), "not ranked")
            out.append(f"{name} ({knows}) reaches {number(float(summary.loc[name, 'score']))} µm.")
    missing = [str(name) for name in summary.index if not np.isfinite(summary.loc[name, "score"])]
    if missing:
        out.append(f"Without a score, because runs failed: {', '.join(missing)}.")
    return out


def times(ratio: float) -> str:
    """A ratio for a sentence: one decimal, two if it is near 1."""
    return f"{ratio:.2f}" if ratio < 1.15 else f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}"


def warnings(results: Results) -> list[str]:
    """What makes the comparison unfair: seeds that tuning or training has seen."""
    seeds = {int(seed) for seed in results.runs["seed"]}
    out = []
    for split in ("tune", "train"):
        seen = sum(seed in SPLITS[split] for seed in seeds)
        if seen:
            where = f"{seen} of {len(seeds)} seeds belong to the {split} split"
            out.append(f"{where}: a controller that was fitted to them is flattered.")
    for name, record in (results.meta.get("tuning") or {}).items():
        used = _seeds(record.get("tune_seeds")) if isinstance(record, dict) else None
        if used is not None and any(seed in used for seed in seeds):
            out.append(f"{name} was tuned on seeds of this run: its figures are flattered.")
    return out


def _seeds(text: Any) -> range | None:
    """``"0-39"`` as a range."""
    found = re.fullmatch(r"\s*(\d+)\s*-\s*(\d+)\s*", str(text))
    return range(int(found[1]), int(found[2]) + 1) if found else None


def _with_score(results: Results, summary: pd.DataFrame) -> list[str]:
    """Sensor controllers that have a score, best first."""
    names = plots.ranked(results, summary).get("sensor", [])
    return [name for name in names if np.isfinite(summary.loc[name, "score"])]


# ------------------------------------------------------------------------------------------------------------ tables


def _what_ran(results: Results) -> str:
    seeds = sorted({int(seed) for seed in results.runs["seed"]})
    apart = len(seeds) != seeds[-1] - seeds[0] + 1
    span = f"{seeds[0]}" if len(seeds) == 1 else f"{'among ' * apart}{seeds[0]} to {seeds[-1]}"
    splits = [name for name, split in SPLITS.items() if any(seed in split for seed in seeds)]
    words = [
        _count(len(results.controllers), "controller"), _count(len(results.scenarios), "scenario"),
        f"{_count(len(seeds), 'seed')} ({span}, {' and '.join(splits) or 'no'} split)",
    ]  # fmt: skip
    return f"{' × '.join(words)}: {_count(len(results.runs), 'simulated run')}."


def _count(count: int, word: str) -> str:
    return f"{count:,}".replace(",", "\u202f") + f" {word}{'s' * (count != 1)}"


def _classes(results: Results, summary: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of the headline table, information classes apart."""
    out, costs = [], results.decisions()
    for information, names in plots.ranked(results, summary).items():
        rows = []
        for name in names:
            row = summary.loc[name]
            peak = float(row["ms"])
            rows.append({
                "gain": margin(row["gain_margin"], GAINS[-1]), "delay": margin(row["delay_margin"], DELAYS[-1]),
                "median_us": number(costs.at[name, "median_us"]), "p99_us": number(costs.at[name, "p99_us"]),
                "share": share_of_period(float(costs.at[name, "ratio"])),
                "budget": in_words({**row, "budget": ""}) or "–", "mark": row["budget"],
                "name": name, "reference": name == REFERENCE, "ceiling": name == CEILING, "score": number(row["score"]),
                "ratio": number(row["ratio"]), "scale": _scale(float(row["scale"])), "ms": number(peak),
                "over": peak > LIMIT_MS, "p99": number(row["p99"]), "reported": number(row["reported"]),
                "jitter": number(row["jitter"]), "collisions": _share(row["collisions"], row["collision_runs"]),
                "touched": bool(row["collisions"] > 0), "failed": int(row["failed"]), "information": information,
            })  # fmt: skip
        out.append({"information": information, "knows": plots.KNOWS.get(information, "not ranked"), "rows": rows})
    return out


def share_of_period(ratio: float) -> str:
    """Of the control period, in per cent."""
    return f"{100 * ratio:.2g} %" if math.isfinite(ratio) else "–"


def _scale(value: float) -> str:
    """Two decimals; the reference is 0 and not −0."""
    return f"{value + 0.0:.2f}".replace("-0.00", "0.00").replace("-", "−") if math.isfinite(value) else "–"


def _share(part: float, whole: float) -> str:
    return "–" if pd.isna(whole) or not whole else f"{int(part)}/{int(whole)}"


def _scenario_rows(results: Results, names: list[str], sensor: list[str]) -> list[dict[str, Any]]:
    """Rows of the scenarios' table: one cell per controller in ``names``; the best of ``sensor`` is marked."""
    pooled, out = results.pooled(), []
    for scenario in [*results.core, *(s for s in results.scenarios if s not in results.core)]:
        if scenario not in pooled:
            continue
        column = pooled[scenario]
        best = column[sensor].min() if len(sensor) > 1 and scenario not in results.exempt else math.nan
        cells = [
            {"text": number(column[name]) if np.isfinite(column[name]) else "failed",
             "best": name in sensor and column[name] == best}
            for name in names
        ]  # fmt: skip
        kind = "core" if scenario in results.core else "exempt" if scenario in results.exempt else ""
        out.append({"name": scenario, "summary": results.summaries.get(scenario, ""), "kind": kind, "cells": cells})
    return out


# ---------------------------------------------------------------------------------------------------------- pictures


def pictures(results: Results) -> list[Picture]:
    """The figures for which the results hold something, in reading order."""
    out = [
        Picture(
            "scores", plots.scores,
            f"Each bar is the RMS error of the true gap, {plots.scored_in_words(results)}; shorter is better. The "
            "scale is logarithmic: equal distances are equal ratios. Hatched bars know more than a real machine and "
            "take no part in the ranking.",
            "Who follows closest",
        ),
        Picture(
            "true_and_reported", plots.true_and_reported,
            "The full dot is what the workpiece sees. The hollow dot is what the machine reports after its filter, all "
            "that an operator can see. Where it lies left of the full one, the report looks better than the cut; a "
            "slow filter can do that.",
            "True and reported error",
        ),
    ]  # fmt: skip
    if len(results.scenarios) > 1:
        out.insert(1, Picture(
            "heat", plots.heat,
            "Each cell is the RMS of the true gap error over all seeds of a scenario, in µm; dark is worse. A row "
            "shows where a controller is weak, a column what a scenario demands. Colours are scaled to the scenarios "
            "without an asterisk.",
            "Where the error comes from", few_colours=False,
        ))  # fmt: skip
    out.append(Picture(
        "quality", lambda _: quality_plot.drawn("thin-sheet")[0],
        quality_plot.drawn("thin-sheet")[1] + " Dross and roughness are proxies. Left of the dashed line "
        "the cut does not tell a follower from a perfect one.",
        "What shows in the cut",
    ))  # fmt: skip
    if plots.contour_controllers(results):
        out.append(Picture(
            "contour", plots.contour,
            "The drawing's contour, coloured by the true gap error of one run; orange is too low, purple too high. "
            "Colour limits are the 99th percentile over all panels. Thin grey lines are rapid moves. At most "
            f"{plots.PANELS} controllers are shown: the best of the sensor class, the reference, then by score.",
            "Along the drawing", few_colours=False,
        ))  # fmt: skip
    if len(results.sensitivity):
        out.append(Picture(
            "sensitivity", plots.sensitivity,
            "How much of a small motion of the sheet at one frequency is left in the gap, for the worst of the corner "
            f"plants. The marked peak is Ms; above {LIMIT_MS:g} a loop has little margin for a machine that differs "
            "from its model.",
            "Stability",
        ))  # fmt: skip
    if (results.runs["collision"] > 0).any():
        out.append(Picture(
            "collisions", plots.collisions,
            "Share of runs in which the nozzle touched the sheet, with counts. Scenarios without any touch are left "
            "out. Those with an asterisk (hatched) are built to defeat followers and do not count in the table above.",
            "Touching the sheet",
        ))  # fmt: skip
    stems: set[str] = set()
    for scenario in plots.shown_scenarios(results):
        summary = results.summaries.get(scenario, "")
        out.append(Picture(
            _stem(f"oscilloscope-{scenario}", stems), _scope(scenario),
            f"{scenario}{': ' + summary if summary else ''}. Every controller over the same sheet, in the time in "
            "which their errors differ most, or around the first alarm. Errors are drawn where they are scored. A "
            "cross marks the time of an alarm, such as a touch; the error after it is not drawn.",
            "Over time", folded=bool(results.core) and scenario not in results.core,
        ))  # fmt: skip
    return out


def _scope(scenario: str) -> Callable[[Results], Figure]:
    return lambda results: plots.oscilloscope(results, scenario)


def _stem(name: str, taken: set[str]) -> str:
    """A file's stem that no other picture has."""
    stem = base = re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:80]
    count = 2
    while stem.lower() in taken:
        stem, count = f"{base}-{count}", count + 1
    taken.add(stem.lower())
    return stem


# -------------------------------------------------------------------------------------------------------------- page


def write_report(folder: Path, grids: dict[str, Results | JobResults], meta: dict[str, Any]) -> Path:
    """Writes ``report.html`` and its pictures into ``folder``; returns the page's path.

    Args:
        folder: of the run.
        grids: results by suite, as :class:`..archive.Archive` has them.
        meta: what holds for all of them: command, versions, machine; ``notes``, if there, are sentences that a reader
            must know.
    """
    folder = Path(folder)
    if len(grids) == 1:
        return _write_grid(folder, next(iter(grids.values())))
    for name, results in grids.items():
        _write_grid(folder / name, results)
    template = '<!DOCTYPE html><meta charset="utf-8"><title>Benchmark report</title>{% for name in names %}'
    template += '<p><a href="{{ name }}/report.html">{{ name }}</a></p>{% endfor %}<pre>{{ command }}</pre>'
    page = jinja2.Environment(autoescape=True).from_string(template)
    with atomic(folder / "report.html") as part:
        part.write_text(page.render(names=list(grids), command=meta.get("command", "")), encoding="utf-8")
    return folder / "report.html"


def _write_grid(folder: Path, results: Results | JobResults) -> Path:
    return write_jobs(folder, results) if isinstance(results, JobResults) else write_following(folder, results)


def write_following(folder: Path, results: Results) -> Path:
    """Writes the page of height followers and ``plots/*.png`` into ``folder``; returns the page's path."""
    folder = Path(folder)
    summary = results.summary()
    sections: dict[str, list[dict[str, Any]]] = {}
    for picture in pictures(results):
        figure = picture.make(results)
        image = png(figure, picture.few_colours)
        with atomic(folder / "plots" / f"{picture.name}.png") as part:
            part.write_bytes(image)
        width, height = figure.get_size_inches() * figure.dpi
        title = " ".join(figure.get_suptitle().replace(r"\$", "$").split())
        sections.setdefault(picture.section, []).append({
            "name": picture.name, "title": title, "text": picture.text, "folded": picture.folded,
            "data": base64.b64encode(image).decode("ascii"), "width": round(width), "height": round(height),
        })  # fmt: skip
    path = folder / "report.html"
    with atomic(path) as part:
        part.write_text(_page(results, summary, sections), encoding="utf-8")
    return path


def _page(results: Results, summary: pd.DataFrame, sections: dict[str, list[dict[str, Any]]]) -> str:
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    groups = plots.ranked(results, summary)
    names = [name for group in groups.values() for name in group]
    command = results.meta.get("command", "")
    return environment.get_template(TEMPLATE).render(
        what=_what_ran(results),
        headline=headline(results, summary),
        remarks=remarks(results, summary),
        warnings=warnings(results),
        command=" ".join(map(str, command)) if isinstance(command, list | tuple) else str(command),
        classes=_classes(results, summary),
        several=len(results.controllers) > 1,
        scored=plots.scored_in_words(results),
        core=plots.scored_scenarios(results),
        exempt=list(results.exempt),
        reference=REFERENCE,
        ceiling=CEILING,
        limit_ms=LIMIT_MS,
        step=STEP,
        timed=bool(results.meta.get("decisions")),
        marks={mark: text for mark, text in MARKS.items() if (summary["budget"] == mark).any()},
        units={name: metric.unit for name, metric in METRICS.items()},
        sections=sections,
        touched=bool((results.runs["collision"] > 0).any()),
        measured=len(results.sensitivity) > 0,
        names=names,
        scenarios=_scenario_rows(results, names, groups.get("sensor", [])),
        splits={name: f"{split[0]} to {split[-1]}" for name, split in SPLITS.items()},
        meta=results.meta,
    )
