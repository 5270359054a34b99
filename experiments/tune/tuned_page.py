"""The page of a search: on its first screen what to set, what that is worth, and what speaks against it."""

import base64
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pandas as pd
from optuna.trial import FrozenTrial

from ...envs import scenarios
from ...envs.scenarios import Machine
from ..measure import plants
from ..report.frame import framed
from ..report.numbers import known, listed, number, span
from ..statistics.intervals import Interval
from ..store import runs
from . import goals, verdict
from .assessed import Assessed
from .evaluate import chosen
from .outcome import Found
from .study import Task

PAGE = "tuned.html"
"""Its name in a run's folder."""

PICTURES = {
    "margins": "How many of the machines stay below each value.",
    "history": "Each trial; those that were pruned are marked below.",
    "front": "What can be had of one metric for another.",
    "sensitivity": "One parameter 20 % off, on tune seeds.",
    "importances": "How much of what tells good trials from others each parameter explains.",
    "slices": "Each trial against each parameter.",
}
"""Those of a study that are shown, in this order; of several metrics each has its own."""

NOT_VALIDATED = (
    "All figures are simulated, on the machine as its file or the scenarios say it is. Set it on the machine, record a "
    "follow log, and compare, before it is relied upon."
)


def write(
    folder: Path,
    task: Task,
    meta: dict[str, Any],
    found: Found,
    near: pd.DataFrame,
    assessed: Assessed,
    front: list[Found],
    before: dict[str, Any],
    after: dict[str, Any],
) -> Path:
    """Writes the page of a result.

    Args:
        folder: of the run, where its pictures are.
        task: what was searched.
        meta: the run's record.
        found: the result.
        near: what 20 % off costs.
        assessed: what it is worth.
        front: all of a search for several metrics.
        before, after: what the record says of the test seeds.
    """
    warned = verdict.warnings(task, assessed)
    said = verdict.headline(task, assessed)
    words = {
        "warnings": warned,
        "headline": "" if warned else said,
        "cautions": verdict.cautions(task, assessed),
        "found": True,
        "rows": [
            row | {"off": verdict.off_costs(near, task, row["name"])} for row in _searched(task, found.parameters)
        ],
        "figures": [*_figures(task, assessed), *_others(task, assessed, before, after)],
        "margins": _margins(task, assessed),
        "machines": _population(task, assessed),
        "drawn": len(assessed.margins[1].machines) if assessed.margins else 0,
        "limit": f"Ms ≤ {task.limits.ms:g}" if math.isfinite(task.limits.ms) else "",
        "broken": [],
        "notes": _notes(after, found, near),
        "front": _front(task, front),
    }
    return _write(folder, task, meta, words)


def write_nothing(folder: Path, task: Task, meta: dict[str, Any], near: FrozenTrial | None, why: str) -> Path:
    """Writes the page of a search that found nothing which keeps the limits.

    Args:
        folder, task, meta: as for :func:`write`.
        near: the trial that breaks them least.
        why: the error.
    """
    parameters = task.space.values(near.params, task.digits or 5) if near else {}
    over = {name: value for name, value in (near.constraints if near else {}).items() if value > 0}
    broken = [f"{_limit(task, name)}: {_over(value)}" for name, value in over.items()]
    words = {
        "warnings": ["Nothing that was tried keeps all limits, so there is nothing to set."],
        "headline": "",
        "cautions": [],
        "found": False,
        "rows": _searched(task, parameters),
        "figures": [],
        "margins": [],
        "machines": "",
        "drawn": 0,
        "limit": "",
        "broken": broken,
        "notes": [f"{why}."],
        "front": None,
    }
    return _write(folder, task, meta, words)


def _write(folder: Path, task: Task, meta: dict[str, Any], words: dict[str, Any]) -> Path:
    title = f"{task.controller} tuned" + (f" on {task.machine.name}" if task.machine else "")
    searched = {row["name"]: row for row in words["rows"]}
    text = framed(
        "tuned.html",
        (),
        title=title,
        name=folder.name,
        facts=_facts(task),
        every=[searched.get(row["name"], row) for row in _parameters(task)],
        pictures=_pictures(folder, task, meta.get("plots", ())),
        record=_record(meta),
        **words,
    )
    runs.write_text(folder / PAGE, text)
    return folder / PAGE


# -------------------------------------------------------------------------------------------------- what was searched


def _facts(task: Task) -> list[tuple[str, str]]:
    cases, core = chosen(task.suite, task.named, task.machine)
    sheets = "; ".join(f"{s.name} ({s.summary})" if s.summary else s.name for s in cases if s.name in core)
    if not task.named:
        sheets = f"suite {scenarios.called(task.suite)}, {len(core)} scenarios of its core: {listed(core)}"
    limits = [f"Ms ≤ {task.limits.ms:g}"] if math.isfinite(task.limits.ms) else []
    limits += [*map(task.told, task.limits.limits), "no collision"]
    seeds = f"tune seeds 0 to {task.seeds - 1}" if task.seeds > 1 else "tune seed 0"
    return [
        ("Machine", _machine(task.machine, cases)),
        ("Sheets", sheets),
        ("Controller", ": ".join([task.controller, *filter(None, [listed(s.summary for s in task.base.stacks)])])),
        ("Searched for", f"least {_metrics(task)} with {listed(limits)}; {task.sampler}, {seeds}"),
    ]


def _metrics(task: Task) -> str:
    return listed(goals.metric(name, task.jobs).spoken if name in goals.joined(name) else name for name in task.metrics)


def _machine(machine: Machine | None, cases: list[Any]) -> str:
    """Which machine, and whether all of its numbers are known."""
    if machine is None:
        labels = [each.label for each in plants.machines(cases)]
        return "as the scenarios say: " + ("standard" if labels == ["standard"] else "; ".join(labels))
    summary = f", {machine.summary}" if machine.summary else ""
    varies = any(each.varies for each in plants.machines(cases))
    known_ = "each seed draws another one that its file allows" if varies else "all its numbers are fixed"
    return f"{machine.name}{summary} ({machine.digest}); {known_}"


def _parameters(task: Task) -> list[dict[str, str]]:
    return [
        {
            "name": name,
            "before": verdict.setting(p.value, p.quantity),
            "unit": verdict.unit(p.quantity),
            "meaning": p.quantity.doc,
        }
        for name, p in task.base.parameters().items()
    ]


def _searched(task: Task, values: dict[str, Any]) -> list[dict[str, str]]:
    known_ = task.base.parameters()
    rows = {row["name"]: row for row in _parameters(task)}
    return [rows[name] | {"after": verdict.setting(value, known_[name].quantity)} for name, value in values.items()]


# ---------------------------------------------------------------------------------------------------- what it is worth


def _figures(task: Task, assessed: Assessed) -> Iterable[dict[str, str]]:
    for each in assessed.worth.figures:
        about = goals.metric(each.metric, task.jobs)
        row = {"name": about.spoken if about.name == each.metric else each.metric}
        row |= {"unit": each.unit if each.unit != "1" else ""}
        for key, interval in (("before", each.before), ("after", each.after)):
            row |= _told(key, interval)
        yield row | _told("gain", each.gain)


def _told(key: str, interval: Interval) -> dict[str, str]:
    value, low, high = interval
    places = known(low, high, value)
    ends = span(low, high, places)
    return {key: verdict.figure(interval), f"{key}_span": "" if ends == "–" else ends}


def _others(task: Task, assessed: Assessed, before: dict[str, Any], after: dict[str, Any]) -> Iterable[dict[str, str]]:
    """What was not searched for: limits, and runs with a touch."""
    plain = {"before_span": "", "after_span": "", "gain": "", "gain_span": "", "unit": ""}
    for limit in assessed.worth.limits:
        yield plain | {"name": limit.words, "before": number(limit.before), "after": number(limit.after)}
    told = {*task.metrics, *(limit.name for limit in task.limits.limits)}
    if not task.jobs and "jitter" not in told:
        shown = {"name": "jitter", "unit": "mm/s per ms"}
        yield plain | shown | {"before": number(before["jitter"]), "after": number(after["jitter"])}
    was, now = assessed.worth.touched
    shown = {"name": "runs with a touch", "unit": f"of {assessed.worth.tried}"}
    yield plain | shown | {"before": str(was), "after": str(now)}


def _population(task: Task, assessed: Assessed) -> str:
    if assessed.margins is None:
        return ""
    count = len(assessed.margins[1].machines)
    name = task.machine.name if task.machine else "the scenarios' machine"
    return f"{count} machines drawn from {name}" if count > 1 else name


def _margins(task: Task, assessed: Assessed) -> list[dict[str, str]]:
    if assessed.margins is None:
        return []
    before, after = assessed.margins
    rows = []
    for column, title, unit, how in verdict.MARGINS:
        row = {"name": f"{title}, {unit}" if unit else title, "kept": ""}
        for key, machines in (("before", before), ("after", after)):
            row[key] = verdict.margin(machines, column, "median")
            row[f"{key}_worst"] = verdict.margin(machines, column, how)
        if column == "ms" and math.isfinite(task.limits.ms):
            row["kept"] = str(after.within(task.limits.ms)[0])
        rows.append(row)
    return rows


def _notes(after: dict[str, Any], found: Found, near: pd.DataFrame) -> list[str]:
    out = []
    if math.isfinite(found.ms):
        out.append(f"Worst Ms of the corner plants, which the search kept below its limit: {found.ms:.3f}.")
    if len(quick := near["ms_before"].dropna()):
        out.append(
            "20 % off is measured on tune seeds, its Ms at fewer frequencies, as in the search; there the controller "
            f"as set has {number(float(quick.iloc[0]))}."
        )
    if "evidence" in after:
        out.append(f"Figures of the cut: {after['evidence']}.")
    out.append("Small print: 95 % intervals over seeds; the same seeds before and after.")
    return [*out, NOT_VALIDATED]


# ------------------------------------------------------------------------------------------------------------ the rest


def _limit(task: Task, name: str) -> str:
    if name == "ms":
        return f"Ms ≤ {task.limits.ms:g}"
    return next((task.told(limit) for limit in task.limits.limits if limit.name == name), f"no {name}")


def _over(value: float) -> str:
    """A violation, which is a logarithm, in words."""
    return f"{math.exp(value):.2f} times what is allowed" if value < goals.FAR else "far beyond"


def _pictures(folder: Path, task: Task, made: Iterable[str]) -> list[dict[str, str]]:
    out = []
    for name, text in PICTURES.items():
        for own in (one for one in made if one == name or one.removeprefix(f"{name}-") in task.metrics):
            data = (folder / "plots" / f"{own}.png").read_bytes()
            out.append({"data": base64.b64encode(data).decode(), "text": text})
    return out


def _front(task: Task, front: list[Found]) -> dict[str, Any] | None:
    if len(front) < 2:
        return None
    rows = [
        {"file": f"front/{i:02d}.toml", "figures": [number(value) for value in each.values]}
        for i, each in enumerate(front, 1)
    ]
    return {"titles": [goals.metric(name, task.jobs).name for name in task.metrics], "rows": rows}


def _record(meta: dict[str, Any]) -> list[tuple[str, str]]:
    command = meta.get("command", "")
    rows = [("command", command if isinstance(command, str) else " ".join(map(str, command)))]
    rows += [(key, str(meta[key])) for key in ("kerfgym", "python", "started") if key in meta]
    for name, cost in meta.get("ledger", {}).items():
        seeds = ", ".join(f"{split} {which}" for split, which in cost.get("seeds", {}).items())
        spent = f"{cost['simulated_steps']:,} simulated steps, {cost['cpu_seconds']:.1f} CPU-s"
        rows.append((name, spent + (f"; seeds: {seeds}" if seeds else "")))
    return rows
