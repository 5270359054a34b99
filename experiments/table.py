"""The benchmark's table in the terminal."""

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console
from rich.table import Table

from ..envs.job_metrics import METRICS
from ..envs.material import material
from ..envs.plant.controller import PERIOD
from ..envs.plant.machine import SUBSTEPS
from .budgets import MARKS, in_words
from .jobs import JobResults
from .margins import DELAYS, GAINS
from .margins import in_words as margin
from .results import REFERENCE, Results

BESIDE = 8
"""Scenarios that have a column beside the score; more of them get a table of their own."""


def _number(value: float, form: str = "{:.2f}") -> str:
    return "–" if value is None or math.isnan(value) else form.format(value)


def _cell(table: Any, row: Any, column: str) -> float:
    return float(table.at[row, column])


def _print_scenarios(console: Console, pooled: Any, names: list[str]) -> None:
    table = Table(title="by scenario, µm")
    table.add_column("scenario", no_wrap=True)
    for name in names:
        table.add_column(name, justify="right")
    for scenario in pooled.columns:
        table.add_row(scenario, *(_number(_cell(pooled, name, scenario), "{:.1f}") for name in names))
    console.print(table)


def budget_note(summary: Any) -> str:
    """Which ratios are at equal budgets, in a sentence."""
    marked = [f"{mark}: {MARKS[mark]}" for mark in MARKS if (summary["budget"] == mark).any()]
    return f"Ratios not at equal budgets: {'; '.join(marked)}." if marked else "All ratios are at equal budgets."


def print_summary(results: Results) -> None:
    """Prints one row per controller, best score first, information classes apart."""
    summary, pooled = results.summary(), results.pooled()
    scored = [s for s in results.core if s in pooled.columns] or list(pooled.columns)
    core = scored if len(scored) <= BESIDE else []
    table = Table(title=f"RMS of the true gap error, µm · {results.meta['seed_count']} seeds per scenario")
    table.add_column("controller", no_wrap=True)
    for title in (
        "score",
        f"× {REFERENCE}",
        "reported",
        "Ms",
        "gain",
        "delay, ms",
        *core,
        "jitter",
        "dross, mm",
        "Rz, µm",
        "collisions",
        "failed",
        "µs",
        "p99, µs",
        "budget",
        "class",
    ):
        table.add_column(title, justify="right", no_wrap=True)
    order = {"sensor": 0, "preview": 1, "privileged": 2}
    rows = sorted(summary.iterrows(), key=lambda r: (order[r[1]["information"]], r[1]["score"]))
    costs = results.decisions()
    last = None
    for name, row in rows:
        if last not in (None, row["information"]):
            table.add_section()
        last = row["information"]
        table.add_row(
            str(name), _number(row["score"]), _number(row["ratio"]), _number(row["reported"]), _number(row["ms"]),
            margin(row["gain_margin"], GAINS[-1]), margin(row["delay_margin"], DELAYS[-1]),
            *(_number(_cell(pooled, name, s), "{:.1f}") for s in core), _number(row["jitter"]),
            _number(row["dross"], "{:.4f}"), _number(row["roughness"]),
            f"{row['collisions']}/{row['collision_runs']}", str(row["failed"]),
            _number(_cell(costs, name, "median_us")), _number(_cell(costs, name, "p99_us")), in_words(row),
            str(row["information"]),
        )  # fmt: skip
    console = Console(width=max(Console().width, Console(width=1000).measure(table).maximum))
    console.print(table)
    if not core:
        _print_scenarios(console, pooled[scored], [str(name) for name, _ in rows])
    exempt = f" ({', '.join(results.exempt)} left out)" if results.exempt else ""
    console.print(
        f"score: geometric mean over {', '.join(core) or f'these {len(scored)}'};\n"
        f"reported: the same of what the machine itself measures;\n"
        f"jitter: RMS change of the command, mm/s per ms; collisions of all scenarios{exempt};\n"
        f"dross and Rz: proxies, means over the core. {material('thin-sheet').label.capitalize()}.\n"
        f"gain, delay: factor on the loop's gain and additional dead time up to which it settles, worst corner plant;\n"
        f"µs: a decision, median and 99th percentile, in a period of {1e6 * PERIOD:.0f} µs;\n"
        f"budget: trials and simulated steps of tuning. {budget_note(summary)}"
    )


def print_jobs(results: JobResults) -> None:
    """Prints one row per team, best score first, and how far the quality figures can be trusted."""
    summary = results.summary().sort_values("score")
    unit = METRICS[results.metric].unit
    table = Table(title=f"jobs · {results.meta['seed_count']} seeds per scenario")
    table.add_column("controller", no_wrap=True)
    titles = (
        f"{results.metric}, {unit}", f"× {results.reference}", "contour rms, µm", "max, µm", "gap rms, µm", "dross, mm",
        "Rz, µm", "ISO 9013", "through", "kerf, mm", "u, mm", "time, s", "feed, mm/s", "collisions", "failed",
        "budget",
    )  # fmt: skip
    for title in titles:
        table.add_column(title, justify="right")
    for name, row in summary.iterrows():
        forms = {
            "score": "{:.2f}", "ratio": "{:.2f}", "contour_rms": "{:.1f}", "contour_max": "{:.0f}", "gap_rms": "{:.1f}",
            "dross": "{:.3f}", "roughness": "{:.1f}", "iso_roughness": "", "through": "{:.2f}", "kerf": "{:.3f}",
            "taper": "{:.3f}", "time": "{:.2f}", "mean_feed": "{:.1f}",
        }  # fmt: skip
        cells = [_number(row[m], form) if form else str(row[m]) for m, form in forms.items()]
        table.add_row(str(name), *cells, f"{row['collisions']}/{row['count']}", str(row["failed"]), in_words(row))
    console = Console(width=max(Console().width, 210))
    console.print(table)
    console.print(f"score: geometric mean over {', '.join(results.core)} of the RMS over seeds.")
    console.print(f"budget: trials and steps of tuning, all slots together. {budget_note(summary)}")
    for label in results.labels:
        console.print(f"quality: {label}.")


def print_blame(shares: Any, headroom: Any) -> None:
    """Prints what each controller's error is made of, and what could be gained."""
    table = Table(title=f"shares of the mean-square true error, {shares['unit'].iloc[0]}, 95 % intervals over seeds")
    for title in ("scenario", "controller", "stage", "share", "interval", "of all", "idealised alone", "interval"):
        table.add_column(title, justify="left" if title in ("scenario", "controller", "stage") else "right")
    for (scenario, controller), part in shares.groupby(["scenario", "controller"], sort=False):
        table.add_section()
        whole = part["share"].sum(skipna=False)
        for i, row in enumerate(part.itertuples()):
            table.add_row(
                *((scenario, controller) if i == 0 else ("", "")), row.stage, _number(row.share),
                _between(row.low, row.high), _number(100.0 * row.share / whole, "{:.1f} %"), _number(row.alone),
                _between(row.alone_low, row.alone_high),
            )  # fmt: skip
        table.add_row("", "", "all", _number(whole))
    console = Console(width=max(Console().width, Console(width=1000).measure(table).maximum))
    console.print(table)
    table = Table(title="headroom: the RMS of the true error could fall at most by this factor")
    for title in ("scenario", "controller", "RMS, µm", "known more", "its RMS, µm", "factor", "interval"):
        table.add_column(title, justify="left" if title in ("scenario", "controller", "known more") else "right")
    for row in headroom.itertuples():
        table.add_row(
            row.scenario, row.controller, _number(row.rms), row.bound, _number(row.bound_rms), _number(row.ratio),
            _between(row.low, row.high),
        )  # fmt: skip
    console.print(table)
    console.print(
        "share: Shapley value of idealising the stage; all of a controller add up to its mean-square error;\n"
        "law: what the fully idealised machine has left, law, supervisor and sampling, at these gains;\n"
        "below 0, interval and all: the controller is tuned around this fault, and does worse without it;\n"
        "headroom: no controller that has only the sensor reaches these, they know the sheet ahead or the true gap."
    )
    if shares["share"].isna().any():
        console.print("–: a run failed, so there are no shares; which one stands in coalitions.parquet.")
    elif shares["low"].isna().all():
        console.print("–: intervals are over seeds, and need two of them.")


def _between(low: float, high: float) -> str:
    return "–" if math.isnan(low) else f"{low:.2f} … {high:.2f}"


@contextlib.contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """A line in the terminal that tells what goes on; gives the function that changes it."""
    with Console(stderr=True).status("") as line:
        yield line.update


@contextlib.contextmanager
def progress(what: str, quiet: bool = False) -> Iterator[Callable[[int, int, str], None]]:
    """A progress bar, unless ``quiet``; gives the function that is told how many are done, of how many, and where."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), disable=quiet) as bar:
        task = bar.add_task(what, total=None)

        def told(done: int, total: int, last: str) -> None:
            bar.update(task, completed=done, total=total, description=f"{what} · {last}")

        yield told


def print_speed(tables: dict[str, Any]) -> None:
    """Prints the tables of a speed run, the promises last."""
    console = Console(width=max(Console().width, 120))
    rounds = int(tables["speed"].rounds.iloc[0])
    table = Table(title=f"CPU time of a machine-step (1 ms of cutting), median of {rounds} interleaved rounds")
    for title in ("", "machines", "threads", "ns", "range", "million/s", "× Pendulum-v1"):
        table.add_column(title, justify="right" if title else "left", no_wrap=True)
    group = None
    for row in tables["speed"].itertuples():
        if group not in (None, row.group):
            table.add_section()
        group = row.group
        span = f"{row.ns_low:,.0f}–{row.ns_high:,.0f}"
        table.add_row(
            row.name, str(row.machines), str(row.threads), f"{row.ns_per_step:,.0f}", span,
            f"{1e3 / row.ns_per_step:.3f}", f"{row.times_pendulum:.2f}",
        )  # fmt: skip
    console.print(table)

    table = Table(title="the kernel by part, per machine and period")
    for title in ("", "ns", "share", "ns per substep", "packed", "scalar", "widest register"):
        table.add_column(title, justify="right" if title else "left")
    for row in tables["stages"].itertuples():
        substep = f"{row.ns / SUBSTEPS:.2f}" if "substeps" in row.stage else ""
        counts = (
            ["–"] * 3 if math.isnan(row.packed) else [f"{row.packed:.0f}", f"{row.scalar:.0f}", f"{row.bits:.0f} bit"]
        )
        table.add_row(row.stage, f"{row.ns:.1f}", f"{row.share:.0%}", substep, *counts)
    console.print(table)

    table = Table(title="start-up in fresh processes, and memory")
    for title in ("", "CPU-s", "range"):
        table.add_column(title, justify="right" if title else "left")
    for row in tables["startup"].itertuples():
        table.add_row(row.program, f"{row.cpu_seconds:.2f}", f"{row.low:.2f}–{row.high:.2f}")
    for row in tables["memory"].itertuples():
        table.add_row(f"{row.what}, bytes each", f"{row.bytes:.0f}", "")
    console.print(table)

    table = Table(title="what is promised")
    for title in ("", "measured", "promised", "held"):
        table.add_column(title, justify="right" if title else "left")
    signs = {">=": "≥", "<=": "≤"}
    for row in tables["ratios"].itertuples():
        held = "not measured" if math.isnan(row.held) else ("yes" if row.held else "no")
        table.add_row(row.ratio, _number(row.measured), f"{signs[row.sense]} {row.promised:g}", held)
    console.print(table)
