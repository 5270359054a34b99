"""The headline table: controllers × everything that is asked about them, in groups of columns."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from ...envs.material import material
from ...envs.quality import iso_range
from .. import comparison
from ..budgets import MARKS
from ..inference import wilson
from ..margins import DELAYS, GAINS
from ..margins import in_words as margin
from .numbers import fixed, known, million, number, part, percent, share_of_period, span
from .sensitivity import LIMIT_MS
from .standing import Standing
from .suite import Suite

SHORT = {"contour_rms": "contour", "roughness": "Rz,", "gap_rms": "gap"}
"""Names of scored metrics for a heading."""


@dataclass(frozen=True)
class Cell:
    """What stands in a cell: text, what it is sorted by, small print under it, a mark (``best``, ``tied``, ``bad``)."""

    text: str
    value: float = math.nan
    small: str = ""
    mark: str = ""
    title: str = ""


@dataclass(frozen=True)
class Column:
    """A column: title, unit or direction under it, its cells by controller; ``meaning`` stands below the table."""

    title: str
    under: str
    cells: dict[str, Cell]
    meaning: str = ""


@dataclass(frozen=True)
class Group:
    """Columns under one heading, shown and hidden together; ``first``: also on a narrow screen."""

    title: str
    columns: list[Column] = field(default_factory=list)
    first: bool = False


def groups(suite: Suite, standings: dict[str, Standing]) -> list[Group]:
    """The columns of a suite, without those that hold nothing."""
    made = [_score(suite, standings), *(_jobs if suite.jobs else _followers)(suite, standings), _budget(suite)]
    kept = []
    for group in made:
        columns = [c for c in group.columns if any(cell.text != "–" for cell in c.cells.values())]
        if columns:
            kept.append(Group(group.title, columns, group.first))
    return kept


def methods(suite: Suite) -> list[dict[str, str]]:
    """Rows of the methods that were trained or tuned several times, with all their trainings together."""
    rows = []
    for row in comparison.methods(suite.results).to_dict("records"):
        ends = {}
        for name in ("score", "ratio"):
            low, value, high = (float(row[f"{name}{end}"]) for end in ("_low", "", "_high"))
            places = known(low, high, value)
            ends[name], ends[f"{name}_span"] = fixed(value, places), span(low, high, places)
        rows.append({
            "method": str(row["method"]), "members": str(len(row["members"])), **ends, "best": number(row["best"]),
            "worst": number(row["worst"]),
        })  # fmt: skip
    return rows


def _score(suite: Suite, standings: dict[str, Standing]) -> Group:
    own = standings[suite.metric]
    metric, frame, reference = suite.metrics[suite.metric], own.frame, suite.reference
    rank, score, ratio, wins = {}, {}, {}, {}
    for key, row in frame.iterrows():
        name = str(key)
        place = float(row["rank"]) if name in own.ranked else math.nan
        rank[name] = Cell(f"{place:.0f}" if place == place else "–", place, title="; ".join(row["reasons"]))
        low, value, high = (own.scale(name, column) for column in ("ratio_low", "ratio", "ratio_high"))
        score[name] = Cell(fixed(value, 2), value, span(low, high, 2) if name != reference else "")
        low, value, high = (float(row[column]) for column in ("ratio_low", "ratio", "ratio_high"))
        places = 2 if value < 10 else 1
        ratio[name] = Cell(fixed(value, places), value, span(low, high, places) if name != reference else "")
        low, value, high = (float(row[column]) for column in ("wins_low", "wins", "wins_high"))
        won = Cell(percent(value), value, span(100 * low, 100 * high, 0))
        wins[name] = won if name != reference else Cell("–")
    kind = "true" if suite.following else SHORT.get(metric.name, metric.name)
    return Group("score", [
        Column("rank", "1 is best", rank, "among those of its information class that may be ranked; who cannot be told "
               "apart at 95 %, all comparisons together, shares it"),
        Column("score", "0 to 1", score, f"0 is {reference}, 1 is {suite.ceiling}, logarithmic between them"),
        Column(f"{kind} RMS", metric.unit, _estimates(own), f"{metric.summary}: RMS over seeds, "
               f"{suite.scored_in_words}; what is ranked"),
        Column("better", "× refer\u00adence", ratio, f"the error of {reference} over this one, same seeds; above "
               "1 is better than the reference"),
        Column("wins", "of runs", wins, f"how often a single run is better than that of {reference} on the same seed "
               "(probability of improvement)"),
    ], first=True)  # fmt: skip


def _estimates(standing: Standing, small: dict[str, str] | None = None) -> dict[str, Cell]:
    """A figure with its interval; the best of those that may be ranked and who is tied with it are marked.

    With ``small`` the interval is only seen when the cell is pointed at, and these words stand below the figure.
    """
    cells = {}
    for name, row in standing.frame.iterrows():
        low, value, high = (float(row[f"score{end}"]) for end in ("_low", "", "_high"))
        if not math.isfinite(value):
            cells[name] = Cell("failed" if row["note"] else number(value), value, mark="bad")
            continue
        places = known(low, high, value)
        several = len(standing.ranked) > 1 and standing.varies
        mark = "best" if several and name == standing.best else "tied" if several and name in standing.tied else ""
        interval = span(low, high, places)
        below = interval if small is None else small.get(str(name), "")
        cells[str(name)] = Cell(fixed(value, places), value, below, mark, f"95 %: {interval} {standing.unit}")
    return cells


def _from(
    suite: Suite, column: str, form: Callable[[float], str] = number, bad: Callable[[float], bool] = lambda _: False
) -> dict[str, Cell]:
    """Cells of a column of the summary."""
    out = {}
    for name in suite.ranked:
        value = float(suite.summary.at[name, column])
        out[name] = Cell(form(value), value, mark="bad" if bad(value) else "")
    return out


def _worst(suite: Suite, metric: str) -> dict[str, Cell]:
    """The largest of all scored runs."""
    if metric not in suite.metrics:
        return {}
    frame = suite.results.runs[suite.results.runs["scenario"].isin(suite.scored)]
    most = frame.groupby("controller", sort=False)[metric].apply(lambda v: float(v.max(skipna=False)))
    return {name: Cell(number(most[name]), most[name]) for name in suite.ranked}


def _collisions(suite: Suite) -> Column:
    total = "collision_runs" if suite.following else "count"
    cells = {}
    for name, row in suite.summary.iterrows():
        rate = wilson(int(row["collisions"]), int(row[total])) if row[total] else None
        small = f"{100 * rate.low:.2g}–{100 * rate.high:.2g} %" if rate else ""
        cells[str(name)] = Cell(
            part(row["collisions"], row[total]), float(row["collisions"]), small, "bad" if row["collisions"] else ""
        )
    left = f"; {', '.join(suite.exempt)} are built to defeat followers and left out" if suite.exempt else ""
    return Column("touched", "runs", cells, f"runs in which the nozzle touched the sheet, with Wilson's interval{left}")


def _failed(suite: Suite) -> Column:
    return Column(
        "failed", "runs", _from(suite, "failed", lambda v: f"{v:.0f}", lambda v: v > 0),
        "runs with a number that is not finite, with nothing to score, or not finished; they leave no score",
    )  # fmt: skip


def _followers(suite: Suite, standings: dict[str, Standing]) -> list[Group]:
    results = suite.following
    assert results is not None

    def stood(metric: str, small: dict[str, str] | None = None) -> dict[str, Cell]:
        return _estimates(standings[metric], small or {}) if metric in standings else {}

    thin, costs = material("thin-sheet"), results.decisions()
    rough = {name: float(suite.summary.at[name, "roughness"]) for name in suite.ranked}
    iso = {n: _range(iso_range(1e-3 * r, thin.thickness)) for n, r in rough.items() if math.isfinite(r)}
    decided = {
        n: Cell(_microseconds(float(costs.at[n, "median_us"])), float(costs.at[n, "median_us"]),
                share_of_period(float(costs.at[n, "ratio"])))
        for n in suite.ranked
    }  # fmt: skip
    return [
        Group("true gap error", [
            Column("P99", "µm", _from(suite, "p99"), "99th percentile of the true error's magnitude, mean of the "
                   "scored runs"),
            Column("max", "µm", _worst(suite, "max_true"), "largest true error of all scored runs"),
        ], first=True),
        Group("reported", [Column("RMS", "µm", stood("rms_reported"), "the same RMS, had one believed the measured and "
                                  "filtered height")]),
        Group("cut of thin sheet", [
            Column("dross", "mm", stood("dross"), "height of the dross (proxy)"),
            Column("Rz", "µm, ISO 9013", stood("roughness", iso), "roughness (proxy), and the range of its mean after "
                   "ISO 9013; 1 is the finest"),
        ]),
        Group("command", [Column("jitter", "mm/s per ms", stood("jitter"), "RMS change of the command from period to "
                                 "period")]),
        Group("stability", [
            Column("Ms", f"≤ {LIMIT_MS:g}", _from(suite, "ms", bad=lambda v: v > LIMIT_MS), "largest share of a small "
                   "motion of the sheet that shows in the gap, over frequencies and corner plants"),
            Column("gain", "× margin", _from(suite, "gain_margin", lambda v: margin(v, GAINS[-1])), "factor on the "
                   "loop's gain up to which a step still settles on every corner plant"),
            Column("delay", "ms margin", _from(suite, "delay_margin", lambda v: margin(v, DELAYS[-1])), "additional "
                   "dead time up to which it does; both found by simulation, so friction and limits count"),
        ]),
        Group("safety", [_collisions(suite), _failed(suite)]),
        Group("decision", [
            Column("time", "µs, P99 of period", decided, "median time that the law takes for a command, on one core; "
                   "below it the 99th percentile as a share of the control period"),
        ]),
    ]  # fmt: skip


def _microseconds(value: float) -> str:
    return "< 0.01" if value < 0.01 else number(value)


def _jobs(suite: Suite, standings: dict[str, Standing]) -> list[Group]:
    def column(title: str, metric: str, small: dict[str, str] | None = None) -> Column:
        if metric not in suite.metrics:  # runs of earlier versions
            return Column(title, "", {})
        m = suite.metrics[metric]
        if metric in standings:
            unit = f"{m.unit}, ISO 9013" if small else m.unit
            return Column(title, unit, _estimates(standings[metric], small or {}), m.summary)
        worst = metric.endswith("_max")
        cells = _worst(suite, metric) if worst else _from(suite, metric)
        return Column(title, m.unit if m.unit != "1" else "share", cells, m.summary)

    def ranges(source: str) -> dict[str, str]:
        return {name: _range(str(suite.summary.at[name, source])) for name in suite.ranked}

    def first(title: str, metric: str) -> list[Column]:
        """None of what is scored, which stands in front."""
        return [] if metric == suite.metric else [column(title, metric)]

    through = [column("through", "through")] if "through" in suite.metrics else []
    if through and all(cell.text == "1.00" for cell in through[0].cells.values()):
        through = []  # everybody cuts through, so the room is better used
    rough = column("Rz", "roughness", ranges("iso_roughness"))
    if suite.metric == "roughness":
        iso = {name: Cell(str(suite.summary.at[name, "iso_roughness"])) for name in suite.ranked}
        rough = Column("Rz", "range, ISO 9013", iso, "ranges of its roughness after ISO 9013; 1 is the finest")
    contour = Group("contour error", [*first("RMS", "contour_rms"), column("max", "contour_max")], first=True)
    gap = Group("true gap error", [*first("RMS", "gap_rms"), column("max", "gap_max")])
    cut = Group("cut", [
        _evidence(suite), column("dross", "dross"), rough, column("u", "taper", ranges("iso_taper")), *through,
        column("kerf", "kerf"),
    ], first=True)  # fmt: skip
    time = Group("time", [column("job", "time"), column("feed", "mean_feed"), column("energy", "energy")], first=True)
    return [contour, gap, cut, time, Group("safety", [_collisions(suite), _failed(suite)])]


def _evidence(suite: Suite) -> Column:
    """Whether the figures of the cut stand on what was calibrated."""
    cells = {}
    for name, row in suite.summary.iterrows():
        share = float(row.get("extrapolated", math.nan))
        if share > 0:
            cells[str(name)] = Cell("extrapolated", share, percent(share), "bad", str(row["beyond"]))
        else:
            cells[str(name)] = Cell("inside" if share == 0 else "–", share)
    meaning = (
        "whether dross, Rz, u, through and kerf lie within the settings that they were calibrated on; else the share "
        "of the cut that does not, and, when pointed at, in what"
    )
    return Column("evidence", "of the cut", cells, meaning)


def _range(text: str) -> str:
    return text if text in ("–", "outside") else f"range {text}"


def _budget(suite: Suite) -> Group:
    summary = suite.summary

    def cells(column: str, form: Callable[[float], str]) -> dict[str, Cell]:
        out = {}
        for name, cell in _from(suite, column, form).items():
            mark, cpu = str(summary.at[name, "budget"]), float(summary.at[name, "tuning_cpu"])
            small = f"{fixed(cpu, 0)} CPU-s" if column == "tuning_steps" and cpu > 0 else ""
            out[name] = Cell(cell.text, cell.value, small, "bad" if mark else "", MARKS.get(mark, ""))
        return out

    return Group("budget", [
        Column("trials", "of tuning", cells("trials", lambda v: fixed(v, 0)), "candidates of a search"),
        Column("steps", "million", cells("tuning_steps", lambda v: million(v) if v == v else "–"), "simulated steps of "
               "tuning or training, and below them its CPU-seconds"),
    ])  # fmt: skip
