"""A benchmark's tables in words: what the terminal prints and what ``summary.md`` holds."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from ...envs.figures import evidence
from ...envs.plant.controller import INFORMATION, PERIOD
from ...envs.plant.machine import SUBSTEPS
from ...envs.scenarios.material import material
from ..bounds.stored import LABEL, LINEAR
from ..measure import margins, stability
from ..results.conclusions import REFERENCE, Results
from ..statistics.budgets import MARKS
from ..statistics.comparison import by_scenario, methods, relative
from ..statistics.pooling import declared
from ..statistics.ranks import order
from ..store.markdown import table
from . import headings, learned
from .headings import figure as _figure
from .headings import number as _number
from .numbers import part as of_all
from .suite import Suite

_WIDEST = 1000

RANGED = (
    f"beyond the feeds of its training such a policy is its base; Ms is measured at {stability.FEED:g} mm/s and the "
    f"margins at {margins.FEED:g} mm/s, so these may be the base's"
)
"""What a reader of a policy's stability must know."""


@dataclass
class TextTable:
    """A table in words.

    Attributes:
        title: above it.
        titles: of the columns, the row's name first.
        sections: groups of rows, apart because they are not ranked together.
        notes: sentences that explain it.
        shown: titles of columns that show a column of ``summary.csv``, and its name there.
        words: which columns hold words; the others hold figures and are aligned at the right.
    """

    title: str
    titles: list[str]
    sections: list[list[list[str]]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    shown: dict[str, str] = field(default_factory=dict)
    words: tuple[int, ...] = (0,)

    def show(self) -> None:
        """Prints it: in parts that fit a terminal, as wide as it is into a file or a pipe."""
        console = Console()
        if not console.is_terminal:
            console = Console(width=max(console.width, _WIDEST))
        for part in self.parts(console.width):
            console.print(self._table(part))
        for note in self.notes:
            console.print(note, highlight=False, markup=False)

    def parts(self, width: int) -> list[list[int]]:
        """Columns side by side that are not wider than ``width``, the first in every part."""
        measure = Console(width=_WIDEST)
        sizes = [measure.measure(self._table([0, i] if i else [0])).maximum for i in range(len(self.titles))]
        parts: list[list[int]] = [[0]]
        room = width - sizes[0]
        for i, size in enumerate(sizes[1:], start=1):
            own = size - sizes[0]
            if own > room and len(parts[-1]) > 1:
                parts.append([0])
                room = width - sizes[0]
            parts[-1].append(i)
            room -= own
        return parts

    def _table(self, part: list[int]) -> Table:
        table = Table(title=self.title if 1 in part or len(part) == 1 else None)
        for i in part:
            table.add_column(self.titles[i], justify="left" if i in self.words else "right", no_wrap=True)
        for section in self.sections:
            for row in section:
                table.add_row(*(row[i] for i in part))
            table.add_section()
        return table

    def markdown(self) -> str:
        """The same in Markdown."""
        right = [i for i in range(len(self.titles)) if i not in self.words]
        rows = table(self.titles, (row for section in self.sections for row in section), right)
        return "\n".join([f"### {self.title}", "", rows, *self.notes]).rstrip() + "\n"


def sheets(results: Results) -> list[TextTable]:
    """The tables of a grid: one row a controller, best score first, and what explains it."""
    return (_jobs(results) if results.jobs else _following(results)) + _methods(results) + _learned(results)


def budget_note(summary: Any) -> str:
    """Which ratios are at equal budgets, in a sentence."""
    marked = [f"{mark}: {MARKS[mark]}" for mark in MARKS if (summary["budget"] == mark).any()]
    return f"Ratios not at equal budgets: {'; '.join(marked)}." if marked else "All ratios are at equal budgets."


def _ranking(summary: Any, reference: str) -> list[str]:
    """What ranks, intervals and failures mean, and who is only shown."""
    lines = [
        "rank: 1 + how many of the class are surely better: all these comparisons hold together with 95 %; =: shared; "
        "a controller that fails on significantly more seeds ranks lower;",
        f"(… …): 95 % intervals over seeds. wins: share of runs that are better than {reference}'s on the same seed; a "
        "failed run is never better;",
        "failed: runs that touched the sheet where they should not, hold a number that is not finite, have nothing to "
        "score or are not finished. All other figures are of the runs that did not fail, ratios of those in which "
        "neither did.",
    ]
    lines += [f"not ranked: {name}: {row['reasons']}." for name, row in summary.iterrows() if row["reasons"]]
    return lines + [f"{name}: {row['note']}." for name, row in summary.iterrows() if row["note"]]


def _sheet(results: Results, title: str, summary: Any) -> TextTable:
    """A row a controller under every column that is printed, classes apart, in the order of :func:`ranks.order`."""
    shown, names = [column for column in headings.of(results) if column.title], order(summary)
    groups = [[name for name in names if summary.at[name, "information"] == each] for each in INFORMATION]
    return TextTable(
        f"{title} · {_seeds(results)}",
        ["controller", *(column.title for column in shown)],
        [[[str(n), *(column.text(summary.loc[n]) for column in shown)] for n in group] for group in groups if group],
        shown={column.title: column.shows for column in shown if column.shows},
    )


def _following(results: Results) -> list[TextTable]:
    summary = results.summary().join(results.decisions()[["median_us", "p99_us"]])
    scored, core = results.scored, headings.core(results)
    sheet = _sheet(results, "RMS of the true gap error, µm", summary)
    limits = ((LABEL, results.bound, results.bounds), (LINEAR, results.linear_bound, results.linear))
    if core and results.bounds:
        at = [(label, {"score, µm": score, **bounds}) for label, score, bounds in limits if bounds]
        sheet.sections.append([[label, *(_number(b.get(t)) for t in sheet.titles[1:])] for label, b in at])
    exempt = f" ({', '.join(results.exempt)} left out)" if results.exempt else ""
    explained = [
        *_ranking(summary, REFERENCE),
        f"score: RMS over seeds, geometric mean over {', '.join(core) or f'these {len(scored)}'};",
        "reported: the same of what the machine itself measures; P99: of |true error|; max: the largest of all;",
        f"jitter: RMS change of the command, mm/s per ms; collisions of all scenarios{exempt};",
        f"dross and Rz: extrapolated and not ranked, over the core. {material('thin-sheet').label.capitalize()}.",
        "Ms: peak of the sensitivity |S|, with one sine at a time and with noise; a controller that learns while it "
        "runs learns a sine, but not noise;",
        "gain, delay: factor on the loop's gain, and additional dead time, up to which the loop settles;",
        *_machines(results),
        f"decision: CPU time, median and 99th percentile, in a period of {1e6 * PERIOD:.0f} µs;",
        f"budget: trials and simulated steps of tuning. {budget_note(summary)}",
        *headings.explained(results),
        *(_limits(results) if results.bounds else ()),
    ]
    if core:
        sheet.notes = explained
        return [sheet, *_by_machine(results)]
    there, names = headings.in_scenario(results), [row[0] for section in sheet.sections for row in section]
    known = {label: bounds for label, _, bounds in limits if bounds and results.bounds}
    rows = [
        [
            s,
            *(there(s, summary.loc[n]) for n in names),
            *(_number(bounds.get(s, math.nan)) for bounds in known.values()),
        ]
        for s in scored
    ]
    return [sheet, TextTable("by scenario, µm", ["scenario", *names, *known], [rows], explained), *_by_machine(results)]


def _limits(results: Results) -> list[str]:
    """What the bounds say."""
    said = [f"{LABEL}: no such controller can go below; 0: the whole disturbance can be learned, docs/bounds.md."]
    if results.linear:
        said.append(f"{LINEAR}: no fixed linear controller can go below, even tuned to the scenario.")
    return said


def _machines(results: Results) -> list[str]:
    """On which machines Ms and margins were measured, and why some were not."""
    measured = results.stability
    if not len(measured):
        return []
    labels = list(dict.fromkeys(measured["machine"]))
    count = len(labels)
    which = f"of the machine that was run ({labels[0]})" if count == 1 else f"of any of the {count} machines"
    return [
        f"Ms, gain, delay: on the worst corner plant {which};",
        *(f"not measured: {', '.join(names)} on {at}: {why}." for (at, why), names in results.unmeasured),
        *(f"{', '.join(names)}: {RANGED}." for names in [results.ranged] if names),
    ]


def _by_machine(results: Results) -> list[TextTable]:
    """Ms and margins machine by machine, where there are several."""
    measured = results.apart
    if not len(measured):
        return []
    shown = headings.stable(Suite("", results))
    sections = [
        [[machine, str(row["controller"]), *(column.text(row) for column in shown)] for _, row in rows.iterrows()]
        for machine, rows in measured.groupby("machine", sort=False)
    ]
    notes = [f"{machine}: {', '.join(names)}." for machine, names in results.machines.items()]
    titles = ["machine", "controller", *(column.title for column in shown)]
    return [TextTable("Ms and margins by machine", titles, sections, notes)]


def _jobs(results: Results) -> list[TextTable]:
    summary = results.summary()
    sheet = _sheet(results, "jobs", summary)
    sheet.notes = [
        *_ranking(summary, results.reference),
        f"figures: over seeds the RMS of an RMS, the largest of a maximum, else the mean; then over "
        f"{', '.join(results.scored)} the geometric mean, of a maximum the largest.",
        f"budget: trials and steps of tuning, all slots together. {budget_note(summary)}",
        *(f"quality: {label}." for label in results.labels),
        *_outside(results),
        *headings.explained(results),
    ]
    several = results.reference in results.controllers and len(results.controllers) > 1
    known = {*WEIGHED, "power_max", "dither_max"} <= set(results.runs)  # runs of earlier versions do not have all
    return [sheet, _trades(results)] if several and known else [sheet]


def _outside(results: Results) -> list[str]:
    """Where and by how much settings lie outside of what the cut's figures were calibrated on."""
    if "extrapolated" not in results.runs:  # runs of earlier versions do not know
        return []
    lines = ["evidence: whether dross, Rz, through, kerf and u lie within the settings that they were calibrated on."]
    found: dict[tuple[str, str], list[str]] = {}
    for (scenario, name), runs in results.runs.groupby(["scenario", "controller"], sort=False):
        if text := evidence.pooled(runs):
            found.setdefault((text, str(name)), []).append(str(scenario))
    who: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for (text, name), names in found.items():
        who.setdefault((text, tuple(names)), []).append(name)
    for (text, places), controllers in who.items():
        all_of_them = len(controllers) > 1 and len(controllers) == len(results.controllers)
        where = "" if len(places) == len(results.scenarios) else f" ({', '.join(places)})"
        lines.append(f"extrapolated: {'all' if all_of_them else ', '.join(controllers)}: {text}{where}.")
    return lines


WEIGHED = {
    "cutting_time": "cutting time",
    "contour_rms": "contour rms",
    "dross": "dross",
    "roughness": "Rz",
    "energy": "energy",
}
"""Figures of a job that are traded for each other; of each, less is better."""


def _trades(results: Results) -> TextTable:
    """What each controller gains and gives against the reference."""
    table, summary = relative(results, WEIGHED), results.summary()
    apart = {m: by_scenario(replace(results, metric=m)) for m in WEIGHED}
    sheet = TextTable(
        f"over {results.reference} · {_seeds(results)}",
        ["controller", *WEIGHED.values(), "better in", "worse in", "power, W", "dither, mm", "evidence"],
    )
    most = pd.DataFrame({metric: results.over(metric) for metric in ("power_max", "dither_max")})
    rows = []
    for name, row in table.iterrows():
        cells = [_figure(row, m, "{:.3f}") for m in WEIGHED]
        better = [title for m, title in WEIGHED.items() if row[f"{m}_high"] < 1.0]
        worse = []
        for m, title in WEIGHED.items():
            there = apart[m].query("controller == @name and ratio_high < 1")["scenario"]
            if row[f"{m}_low"] > 1.0:
                worse.append(title)
            elif len(there):
                worse.append(f"{title} ({', '.join(there)})")
        limits = [f"{most.loc[name, 'power_max']:.0f}", f"{most.loc[name, 'dither_max']:.3f}"]
        limits.append(headings.evidence(summary.loc[name]))
        rows.append([str(name), *cells, ", ".join(better) or "–", ", ".join(worse) or "–", *limits])
    base = most.loc[results.reference]
    sheet.sections = [rows]
    sheet.notes = [
        "pooled as above, of the runs in which neither failed, with 95 % intervals from the same seeds; better and "
        "worse: the interval leaves 1 out; worse in brackets: only in these scenarios.",
        f"power and dither: largest of the beam and of the galvo in a cut; {results.reference}: "
        f"{base['power_max']:.0f} W, {base['dither_max']:.3f} mm.",
    ]
    return sheet


def _methods(results: Results) -> list[TextTable]:
    """Of methods that were trained or tuned several times, all their members together."""
    found = methods(results)
    if not len(found):
        return []
    what = declared(results.metric).label if results.jobs else "score"
    titles = ["method", "members", what, f"× {results.reference}", "best", "worst"]
    rows = []
    for _, row in found.iterrows():
        figures = [_figure(row, "score"), _figure(row, "ratio"), _number(row["best"]), _number(row["worst"])]
        rows.append([row["method"], str(len(row["members"])), *figures])
    note = "members: trainings that differ in their seed alone; intervals are over trainings and over seeds."
    return [TextTable("methods that were trained or tuned several times", titles, [rows], [note])]


def _learned(results: Results) -> list[TextTable]:
    """Policies against the best classical controller and against their bases, a row each."""
    found = learned.comparisons(results)
    if not found:
        return []
    unit = results.registered[results.metric].unit
    titles = ["learned", "against", unit, f"its {unit}", "gain, %", "P99 gain, %", "closed, %"]
    titles += ["closer in", "farther in", "collisions", "its collisions"]
    rows, notes = [], []
    for each in found:
        pair, row = each.pair, each.score
        gains = [_figure(row, name, "{:.1f}") for name in ("gain", "p99_gain")]
        sure = [f"{len(names)}/{len(each.apart)}" for names in (each.closer, each.farther)]
        cells = [pair.one, pair.other + " (its base)" * pair.base, _number(row["one"]), _number(row["other"]), *gains]
        cells += [_number(row["closed"], "{:.0f}"), *sure]
        rows.append([*cells, *(of_all(row[f"collisions_{side}"], row[f"runs_{side}"]) for side in ("one", "other"))])
        notes += [words for words in (learned.choice(pair), learned.beside_base(each) if pair.base else "") if words]
        notes.append(learned.spent(pair.one, pair.other, learned.effort(results, pair)))
    notes.insert(0, "over the runs in which neither failed; closed: share of the way to the bound; closer, farther: in")
    notes[0] += " how many scenarios that is sure. Scenario by scenario: report.html and learned.csv."
    return [TextTable("learned against classical", titles, [rows], notes, words=(0, 1))]


def _seeds(results: Results) -> str:
    count = results.runs["seed"].nunique()
    return f"{count} seeds per scenario" if count > 1 else "one seed per scenario, so nothing says how sure this is"


def print_blame(shares: Any, headroom: Any) -> None:
    """Prints what each controller's error is made of, and how references with other information do."""
    several, sections = shares["error"].nunique() > 1, []
    for (scenario, controller, error), part in shares.groupby(["scenario", "controller", "error"], sort=False):
        whole = part["share"].sum(skipna=False)
        rows = []
        for row in part.itertuples():
            share = [_number(row.share), _ends(row.low, row.high), _number(100.0 * row.share / whole, "{:.1f} %")]
            rows.append(["", "", row.stage, *share, _number(row.alone), _ends(row.alone_low, row.alone_high)])
        rows[0][:2] = [f"{scenario}, {error}" if several else scenario, controller]
        sections.append([*rows, ["", "", "all", _number(whole), "", "", "", ""]])
    TextTable(
        f"shares of the mean-square true error, {shares['unit'].iloc[0]}, 95 % intervals over seeds",
        ["scenario", "controller", "stage", "share", "interval", "of all", "idealised alone", "interval"],
        sections,
        words=(0, 1, 2),
    ).show()
    notes = [
        "share: Shapley value of idealising the stage; all of a controller add up to its mean-square error;",
        "law: what the fully idealised machine has left, law, supervisor and sampling, at these gains;",
        "below 0, interval and all: the controller is tuned around this fault, and does worse without it;",
        "references know the sheet ahead or the true gap; they are no bounds (below 1: closer than they are). Bounds:",
        "docs/bounds.md.",
    ]
    if shares["share"].isna().any():
        notes.append("–: a run failed, so there are no shares; which one stands in coalitions.parquet.")
    elif shares["low"].isna().all():
        notes.append("–: intervals are over seeds, and need two of them.")
    rows = []
    for r in headroom.itertuples():
        other = [r.informed, _number(r.informed_rms), _number(r.ratio), _ends(r.low, r.high)]
        rows.append([r.scenario, r.controller, _number(r.rms), *other])
    title = "beside references with other information: RMS of the true error, and the factor between"
    titles = ["scenario", "controller", "RMS, µm", "reference", "its RMS, µm", "factor", "interval"]
    TextTable(title, titles, [rows], notes, words=(0, 1, 3)).show()


def _ends(low: float, high: float) -> str:
    return "–" if math.isnan(low) else f"{low:.2f} … {high:.2f}"


def print_speed(tables: dict[str, Any]) -> None:
    """Prints the tables of a speed run, the promises last."""
    speed, stages, ratios = tables["speed"], tables["stages"], tables["ratios"]
    rows: list[list[list[str]]] = []
    for _, part in speed.groupby("group", sort=False):
        rows.append([])
        for r in part.itertuples():
            times = [f"{r.ns_per_step:,.0f}", f"{r.ns_low:,.0f}–{r.ns_high:,.0f}"]
            speeds = [f"{1e3 / r.ns_per_step:.3f}", f"{r.times_pendulum:.2f}"]
            rows[-1].append([r.name, str(r.machines), str(r.threads), *times, *speeds])
    title = f"CPU time of a machine-step (1 ms of cutting), median of {int(speed.rounds.iloc[0])} interleaved rounds"
    TextTable(title, ["", "machines", "threads", "ns", "range", "million/s", "× Pendulum-v1"], rows).show()
    parts = []
    for r in stages.itertuples():
        each = f"{r.ns / SUBSTEPS:.2f}" if "substeps" in r.stage else ""
        widths = [_number(r.packed, "{:.0f}"), _number(r.scalar, "{:.0f}"), _number(r.bits, "{:.0f} bit")]
        parts.append([r.stage, f"{r.ns:.1f}", f"{r.share:.0%}", each, *widths])
    titles = ["", "ns", "share", "ns per substep", "packed", "scalar", "widest register"]
    TextTable("the kernel by part, per machine and period", titles, [parts]).show()
    start = [[r.program, f"{r.cpu_seconds:.2f}", f"{r.low:.2f}–{r.high:.2f}"] for r in tables["startup"].itertuples()]
    memory = [[f"{r.what}, bytes each", f"{r.bytes:.0f}", ""] for r in tables["memory"].itertuples()]
    TextTable("start-up in fresh processes, and memory", ["", "CPU-s", "range"], [start + memory]).show()
    signs, held = {">=": "≥", "<=": "≤"}, {True: "yes", False: "no"}
    kept = []
    for r in ratios.itertuples():
        word = "not measured" if math.isnan(r.held) else held[bool(r.held)]
        kept.append([r.ratio, _number(r.measured), f"{signs[r.sense]} {r.promised:g}", word])
    TextTable("what is promised", ["", "measured", "promised", "held"], [kept]).show()
