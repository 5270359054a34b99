"""Runs joined into one: other controllers, or another version of the same ones, on common random numbers.

Only what the runs have in common is compared: scenarios that are the same word by word, and of each the seeds that
every run has. What could not be joined stands beside it, and notes say what was left out and what differs.
"""

from dataclasses import fields, replace
from typing import Any

import pandas as pd

from ...envs.engine.quantity import InvalidInput
from ..store.ledger import ranges
from .archive import Archive
from .conclusions import INFORMED, REFERENCE, Results, in_order

Grids = dict[str, Results]

NAMED = ("ledger", "tuning", "parameters", "programs", "settings", "decisions")
"""What a record holds by controller."""


def merge(archives: list[Archive], record: dict[str, Any]) -> Archive:
    """One archive of several.

    Args:
        archives: at least one; their order is that of the controllers.
        record: of the command that joins them.

    Raises:
        InvalidInput: a run is given twice.
    """
    names, notes = labels(archives), [note for a in archives for note in a.meta.get("notes", [])]
    notes += _versions(dict(zip(names, archives, strict=True)))
    grids: Grids = {}
    texts: dict[str, dict[str, str]] = {}
    for suite in dict.fromkeys(suite for a in archives for suite in a.grids):
        having = {name: a for name, a in zip(names, archives, strict=True) if suite in a.grids}
        if len(having) == 1:
            ((name, only),) = having.items()
            grids[suite], texts[suite] = only.grids[suite], only.texts.get(suite, {})
            if len(archives) > 1:
                notes.append(f"Suite {suite} is in run {name} only.")
            continue
        try:
            grids[suite], texts[suite] = _joined(suite, having, record, notes)
        except InvalidInput as error:
            notes.append(f"Suite {suite}: {error}, so the runs stand beside each other and are not compared.")
            for name, each in having.items():
                grids[f"{suite}@{name}"], texts[f"{suite}@{name}"] = each.grids[suite], each.texts.get(suite, {})
    meta = record | {
        "notes": notes,
        "runs": {
            name: {key: a.meta.get(key) for key in ("command", "kerfgym", "git", "machine", "wall_seconds")}
            for name, a in zip(names, archives, strict=True)
        },
    }
    for results in grids.values():
        results.meta = {**results.meta, "notes": notes}
    return Archive(archives[0].folder, grids, meta, texts)


def labels(archives: list[Archive]) -> list[str]:
    """A short name for each run: its folder's, with those above it where two are alike.

    Raises:
        InvalidInput: a run is given twice.
    """
    folders = [a.folder.resolve() for a in archives]
    for folder in folders:
        if folders.count(folder) > 1:
            raise InvalidInput(f"run '{folder}' is given twice")
    names, depth = [f.name for f in folders], 1
    while len(set(names)) < len(names):
        depth += 1
        names = ["/".join(f.parts[-depth:]) for f in folders]
    return names


def _versions(archives: dict[str, Archive]) -> list[str]:
    """What the runs do not share of program and machine."""
    out = []
    of = {}
    for name, a in archives.items():
        git = a.meta.get("git") or {}
        version = [f"kerfgym {a.meta.get('kerfgym')}", str(git.get("commit") or "")[:12]]
        of[name] = " ".join(filter(None, [*version, "with changes" if git.get("changed") else ""]))
    if len(set(of.values())) > 1:
        said = "; ".join(f"{name}: {version}" for name, version in of.items())
        kernels = {a.meta.get("kernel") for a in archives.values()}
        same = "the simulated machine is the same"
        if len(kernels) != 1 or None in kernels:
            same = "the simulated machine may differ, so a difference between controllers of two runs may be due to it"
        out.append(f"The runs were made by different versions ({said}); {same}.")
    processors = {(a.meta.get("machine") or {}).get("processor") for a in archives.values()}
    if len(processors) > 1:
        out.append("The runs were made on different machines: times per decision are not comparable between them.")
    return out


def _joined(
    suite: str, having: dict[str, Archive], record: dict[str, Any], notes: list[str]
) -> tuple[Results, dict[str, str]]:
    """One grid of several, and its scenarios.

    Raises:
        InvalidInput: they are of different kinds or scores, or have no scenario and seed in common.
    """
    grids = {name: a.grids[suite] for name, a in having.items()}
    first = next(iter(grids.values()))
    if len({(g.jobs, g.metric) for g in grids.values()}) > 1:
        raise InvalidInput("the scores are of different metrics")
    texts = {name: a.texts.get(suite, {}) for name, a in having.items()}
    shared = _shared(suite, grids, texts, notes)
    pairs = _pairs(suite, grids, shared, notes)
    renamed = _renamed(suite, grids, pairs, notes)
    tables = {
        table: _together([_part(getattr(g, table), renamed[name], pairs, shared) for name, g in grids.items()])
        for table in (each.name for each in fields(first))
        if isinstance(getattr(first, table), pd.DataFrame)
    }
    if len(tables.get("plans", ())):  # the same parts, cut in the same way: the scenarios are the same
        tables["plans"] = tables["plans"].drop_duplicates("scenarios", ignore_index=True)
    lacking = sorted({c for g in grids.values() for c in tables["runs"].columns if c not in g.runs})
    if lacking:
        notes.append(f"Suite {suite}: not every run has {', '.join(lacking)}; it is missing where it was not measured.")
    # By controller and scenario as they first come, seeds rising, as in a run.
    order = {name: list(tables["runs"][name].unique()) for name in ("controller", "scenario")}
    tables["runs"] = in_order(tables["runs"], order["controller"], order["scenario"])
    core = tuple(c for c in first.core if c in shared)
    seeds = sorted({seed for _, seed in pairs})
    meta = {**record, "seeds": ranges(seeds), "seed_count": len(seeds), "scenarios": order["scenario"]}
    meta |= {"controllers": order["controller"], "core": list(core)}
    for key in NAMED:
        values = ((name, *item) for name, g in grids.items() for item in (g.meta.get(key) or {}).items())
        meta[key] = {renamed[name][who]: value for name, who, value in values if who in renamed[name]}
    found = {label: names for g in grids.values() for label, names in (g.meta.get("machines") or {}).items()}
    if machines := {label: [s for s in names if s in shared] for label, names in found.items()}:
        meta["machines"] = {label: names for label, names in machines.items() if names}
    summaries = {s: text for s, text in first.summaries.items() if s in shared}
    exempt = tuple(s for s in first.exempt if s in shared)
    joined = replace(first, **tables, meta=meta, core=core, summaries=summaries, exempt=exempt)
    return joined, {s: text for s, text in texts[next(iter(grids))].items() if s in shared}


def _shared(suite: str, grids: Grids, texts: dict[str, dict[str, str]], notes: list[str]) -> list[str]:
    """Scenarios that every run has, and that are the same in all."""
    every = list(dict.fromkeys(s for g in grids.values() for s in g.scenarios))
    common = [s for s in every if all(s in g.scenarios for g in grids.values())]
    if absent := [s for s in every if s not in common]:
        notes.append(f"Suite {suite}: {', '.join(absent)} left out, because not every run has it.")
    if other := [s for s in common if len({of[s] for of in texts.values() if s in of}) > 1]:
        notes.append(f"Suite {suite}: {', '.join(other)} left out, because the scenario is not the same in every run.")
    shared = [s for s in common if s not in other]
    if not shared:
        raise InvalidInput("the runs have no scenario in common")
    return shared


def _pairs(suite: str, grids: Grids, shared: list[str], notes: list[str]) -> set[tuple[str, int]]:
    """Scenarios with seeds that every run has."""
    each = {
        name: {(s, int(n)) for s, n in zip(g.runs["scenario"], g.runs["seed"], strict=True) if s in shared}
        for name, g in grids.items()
    }
    pairs = set.intersection(*each.values())
    if {s for s, _ in pairs} != set(shared):
        raise InvalidInput("the runs have no seed in common")
    if any(found != pairs for found in each.values()):
        had = "; ".join(f"{name}: {ranges(n for _, n in found)}" for name, found in each.items())
        notes.append(
            f"Suite {suite}: the runs have different seeds ({had}); compared are those that all have, "
            f"{ranges(n for _, n in pairs)}."
        )
    return pairs


def _renamed(suite: str, grids: Grids, pairs: set[tuple[str, int]], notes: list[str]) -> dict[str, dict[str, str]]:
    """The controllers that each run brings, with the names that they get.

    One that is in several runs is there once if all its figures are the same, else once for each run, as ``name@run``.
    Only reference and bound keep their name in the first run, since ratios and scale are taken from there.
    """
    fixed = {*(g.reference for g in grids.values()), REFERENCE, INFORMED}
    out: dict[str, dict[str, str]] = {name: {} for name in grids}
    for who in dict.fromkeys(who for g in grids.values() for who in g.controllers):
        where = [name for name, g in grids.items() if who in g.controllers]
        rows = [_rows(grids[name].runs, who, pairs) for name in where]
        values = [_settings(grids[name], who) for name in where]
        if len(where) == 1 or (all(r.equals(rows[0]) for r in rows[1:]) and all(v == values[0] for v in values[1:])):
            out[where[0]][who] = who
            if len(where) > 1:
                notes.append(f"Suite {suite}: {who} is the same, to the last digit, in {' and '.join(where)}.")
            continue
        for i, name in enumerate(where):
            out[name][who] = who if who in fixed and i == 0 else f"{who}@{name}"
        changed = sorted({k for v in values for k in {**values[0], **v} if v.get(k) != values[0].get(k)})
        why = f"in {', '.join(changed)}" if changed else "in its figures, with the same program and parameters"
        shown = " and ".join(out[name][who] for name in where)
        notes.append(f"Suite {suite}: {who} differs between the runs {why}; shown as {shown}.")
    return out


def _settings(grid: Results, who: str) -> dict[str, Any]:
    """A controller's parameters and what identifies its program."""
    known = {key: (grid.meta.get(key) or {}).get(who) for key in ("parameters", "programs")}
    return {**(known["parameters"] or {}), "its program": known["programs"]}


def _together(frames: list[pd.DataFrame]) -> pd.DataFrame:
    filled = [frame for frame in frames if len(frame)]
    return pd.concat(filled, ignore_index=True) if filled else frames[0]


def _rows(runs: pd.DataFrame, who: str, pairs: set[tuple[str, int]]) -> pd.DataFrame:
    mine = _within(runs[runs["controller"] == who], pairs)
    return mine.sort_values(["scenario", "seed"]).reset_index(drop=True)


def _within(frame: pd.DataFrame, pairs: set[tuple[str, int]]) -> pd.DataFrame:
    return frame[pd.MultiIndex.from_frame(frame[["scenario", "seed"]]).isin(pairs)]


def _part(frame: pd.DataFrame, names: dict[str, str], pairs: set[tuple[str, int]], shared: list[str]) -> pd.DataFrame:
    """What a table holds of the controllers that a run brings, in what is compared."""
    if not len(frame) or "controller" not in frame:
        return frame
    frame = frame[frame["controller"].isin(list(names))]
    if "seed" in frame:
        frame = _within(frame, pairs)
    elif "scenario" in frame:
        frame = frame[frame["scenario"].isin(shared)]
    return frame.assign(controller=frame["controller"].map(names))
