"""The report: one HTML file that holds everything it shows and opens offline.

Every section has a module of its own, which gives nothing where the run holds nothing for it; here they are put in
order. ``report.html`` is its template, ``report.css`` its looks, the scripts sort the tables and draw the figures.
"""

import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any

from markupsafe import Markup

from ...envs.scenarios import SPLITS
from ..measure.stability import LIMIT_MS
from ..plots.palette import Look, looks
from ..results.conclusions import Results
from ..statistics.rivals import is_learned
from ..store.runs import write_text
from . import (
    answer,
    blame,
    cut_quality,
    fronts,
    headings,
    heat,
    kerfs,
    learned,
    limits,
    out_of_distribution,
    performance,
    plan,
    scope,
    scores,
    sensitivity,
    spectra,
    table,
    to_set,
    tuning,
)
from . import curves as training
from .figure import Figure, as_json
from .frame import framed
from .numbers import count
from .record import record
from .standing import Standing, all_of
from .suite import Suite

SCRIPTS = ("tables.js", "figures.js", "pack.js", "chooser.js", "scope.js", "kerfs.js")


def write_report(folder: Path, grids: dict[str, Results], meta: dict[str, Any]) -> Path:
    """Writes ``report.html`` into ``folder``; returns its path.

    Args:
        folder: of the run.
        grids: results by suite, as :class:`..archive.Archive` has them.
        meta: what holds for all of them: command, versions, machine; ``notes``, if there, are sentences that a reader
            must know.
    """
    folder = Path(folder)
    path = folder / "report.html"
    write_text(path, page(folder, grids, meta))
    return path


def page(folder: Path, grids: dict[str, Results], meta: dict[str, Any]) -> str:
    """The page's text; arguments as of :func:`write_report`."""
    suites = [Suite(name, results) for name, results in grids.items()]
    controllers = list(dict.fromkeys(name for suite in suites for name in suite.results.controllers))
    labels, look = labelled(controllers), looks(controllers)
    standings = {suite.name: all_of(suite) for suite in suites}
    chapters = [_chapter(suite, standings[suite.name], look, labels) for suite in suites]
    curves = training.curves(controllers)
    policies = [labels[n] for n in controllers if any(is_learned(s.results, n) for s in suites)]
    widgets = {"oscilloscope": scope.widget(suites, labels), "kerfs": kerfs.widget(suites, labels)}
    for data in widgets.values():
        if data:
            data["looks"] = {name: [look[name].colour, look[name].dash] for name in controllers}
    command = meta.get("command", "")
    return framed(
        "report.html",
        SCRIPTS,
        chapters=chapters,
        matrix=answer.matrix({c["suite"].name: c["cards"] for c in chapters}),
        labels=labels,
        look=look,
        several=len(suites) > 1,
        what=what_ran(suites),
        cut_by=list(dict.fromkeys(cut_by(suite.results) for suite in suites)),
        sheets=[to_set.sheets(suite) for suite in suites],
        plans=plan.shown(suites),
        warnings=[*map(str, meta.get("notes") or ()), *warnings(suites)],
        command=" ".join(map(str, command)) if isinstance(command, list | tuple) else str(command),
        spectra=_there([spectra.figure(suites, look, labels)]),
        sensitivities=_there(sensitivity.figure(s, look, labels) for s in suites),
        quality=[cut_quality.figure(*steel) for steel in materials(suites)],
        tuned=_there([tuning.figure({**tuning.presets(suites), **tuning.studies(controllers)}, labels)]),
        trained=_there([training.figure(curves, look, labels)]),
        beyond=out_of_distribution.table(suites, labels),
        beyond_name=out_of_distribution.NAME,
        blamed=_there(blame.figure(s, look, labels) for s in suites),
        headroom=[row for s in suites for row in blame.headroom(s, labels)],
        widgets={name: Markup(as_json(data)) if data else None for name, data in widgets.items()},
        limits=limits.sentences(suites, policies),
        record=record(suites, meta),
        is_figure=_is_figure,
    )


def _there(figures: Iterable[Figure | None]) -> list[Figure]:
    return [figure for figure in figures if figure is not None]


def _is_figure(thing: Any) -> bool:
    return isinstance(thing, Figure)


def _chapter(
    suite: Suite, standings: dict[str, Standing], look: dict[str, Look], labels: dict[str, str]
) -> dict[str, Any]:
    """What is told of one suite."""
    own = standings[suite.metric]
    figures = [
        scores.figure(own, look, labels),
        heat.figure(suite, labels),
        performance.figure(suite, look, labels),
        fronts.figure(suite, standings, look, labels),
    ]
    return {
        "suite": suite,
        "headline": answer.headline(own, labels),
        "to_set": to_set.to_set(suite, own, labels),
        "figures": _there(figures),
        "remarks": answer.remarks(suite, own, labels, LIMIT_MS),
        "caveats": answer.caveats(suite, own, labels, LIMIT_MS),
        "cards": answer.cards(suite, standings, look, labels),
        "groups": table.groups(suite, standings),
        "unranked": {name: list(why) for name, why in own.frame["reasons"].items() if why},
        "methods": table.methods(suite),
        "learned": learned.chapter(suite, labels),
        "ranked_by": headings.ranked_by(suite),
        "machines": table.by_machine(suite),
        "unmeasured": table.unmeasured(suite),
        "ranged": table.ranged(suite),
    }


def materials(suites: list[Suite]) -> list[tuple[str, float | None]]:
    """Materials that were cut, with their thickness; followers are taken to cut thin sheet."""
    found: dict[tuple[str, float | None], None] = {}
    for suite in suites:
        if suite.jobs:
            found |= dict.fromkeys((name, float(thickness)) for name, thickness in suite.results.materials)
        elif suite.name != out_of_distribution.NAME:
            found[("thin-sheet", None)] = None
    return list(found)


def labelled(names: list[str]) -> dict[str, str]:
    """What a figure calls each controller: of a path its last telling part, if that is unique; else what was typed."""
    short = {name: _short(name) for name in names}
    twice = {label for label in short.values() if list(short.values()).count(label) > 1}
    return {name: name if label in twice else label for name, label in short.items()}


def _short(name: str) -> str:
    head, colon, rest = name.partition(":")
    if not re.fullmatch(r"[\w.\- ]*(/[\w.\- ]*)+", head):
        return name
    parts = [p for p in PurePosixPath(head).parts if p not in ("/", ".")]
    if parts and parts[-1] in ("policy", "tuned.toml") and len(parts) > 1:
        parts = parts[:-1]
    return parts[-1] + colon + rest if parts else name


def what_ran(suites: list[Suite]) -> list[str]:
    """Sizes of the grids, in words."""
    out = []
    for suite in suites:
        seeds = suite.seeds
        apart = len(seeds) != seeds[-1] - seeds[0] + 1
        span = f"{seeds[0]}" if len(seeds) == 1 else f"{'among ' * apart}{seeds[0]} to {seeds[-1]}"
        splits = [name for name, split in SPLITS.items() if any(seed in split for seed in seeds)]
        sizes = [
            count(len(suite.results.controllers), "controller"),
            count(len(suite.results.scenarios), "scenario"),
            f"{count(len(seeds), 'seed')} ({span}, {' and '.join(splits) or 'no'} split)",
        ]
        out.append(f"{suite.title}: {' × '.join(sizes)}, {count(len(suite.results.runs), 'run')}.")
    return out


def cut_by(results: Results) -> str:
    """On which machine it was run, in words."""
    cuts = results.meta.get("cut_by")
    if not cuts:
        return "Machine: as the scenarios say."
    summary = f", {cuts['summary']}" if cuts.get("summary") else ""
    return f"Machine: {cuts.get('name')}{summary} (machine.toml, {cuts.get('digest')})."


def warnings(suites: list[Suite]) -> list[str]:
    """What makes the comparison unfair as a whole: seeds that tuning or training may have seen."""
    records = [suite.results.meta.get("cut_by") or {} for suite in suites]
    out = list(dict.fromkeys(f"{each}." for record in records for each in record.get("replaces", ())))
    for suite in suites:
        for split in ("tune", "train"):
            seen = sum(seed in SPLITS[split] for seed in suite.seeds)
            if seen:
                where = f"{suite.title}: {seen} of {len(suite.seeds)} seeds belong to the {split} split"
                out.append(f"{where}; a controller that was fitted to them is flattered.")
    return out
