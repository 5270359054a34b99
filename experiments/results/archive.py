"""A benchmark's run folder, written and read back.

::

    runs/<name>/run.json            the record: format, command, versions, machine; and of each grid its seeds, cost …
                report.html
                runs.parquet …      the tables, if there is one grid
                following/runs.parquet …, cutting/runs.parquet …      if there are several
                scenarios/*.toml    what was run, beside the tables
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ... import __version__
from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.safety import files
from ...envs.tasks import workshop
from ..statistics import rivals
from ..store import kinds, runs, tabular
from .conclusions import Results

FORMAT = 2
"""Of the run folder; 1 had one grid and its record among the run's."""

UNFINISHED = "parts"
"""Where a run that is not finished keeps what is done."""

_TRACES = ("controller", "scenario", "seed", "time")

TABLES = {
    "following": {
        "traces": (*_TRACES, "gap", "height", "mode", "scored", "set_height"),
        "sensitivity": ("controller", "frequency", "magnitude"),
        "margins": ("controller",),
        "blame": ("controller", "scenario", "stage", "unit", "share", "low", "high", "alone"),
        "headroom": ("controller", "scenario", "informed", "rms", "informed_rms", "ratio", "low", "high"),
        "detuned": ("controller", "parameter", "value", "side", "moved", "rms_true"),
    },
    "jobs": {
        "traces": (*_TRACES, "error", "gap_error", "margin", "phase", "roughness", "dross"),
        "plans": ("scenarios", "picture", "cuts", "warnings"),
    },
}
"""Tables of a grid of either kind, beside ``runs``; each may be absent. The columns without which it tells nothing."""

_SIGNALS = ("sine", "noise")
"""With which a sensitivity is measured."""

_RUNS = ("controller", "information", "scenario", "seed", "failed", "collision")

KEPT = {"following": ("exempt", "summaries"), "jobs": ("metric", "reference", "labels", "materials", "summaries")}
"""What is in the results of either kind and in no table."""

_RESTS = ("kind", "folder", *(key for keys in KEPT.values() for key in keys))


@dataclass(frozen=True)
class Archive:
    """A run as it was stored.

    Attributes:
        folder: of the run.
        grids: results of each suite by its name, in the order in which they were asked for.
        meta: what holds for all of them: command, versions, machine; ``notes`` are sentences that a reader must know.
        texts: scenarios as TOML, by suite and name.
    """

    folder: Path
    grids: dict[str, Results]
    meta: dict[str, Any]
    texts: dict[str, dict[str, str]] = field(default_factory=dict)


def place(folder: Path, name: str, several: bool) -> Path:
    """Where the tables of a grid are."""
    return files.within(folder, name, "suite") if several else folder


def save_tables(
    folder: Path, grids: dict[str, Results], meta: dict[str, Any], texts: dict[str, dict[str, str]]
) -> dict[str, Any]:
    """Writes tables and scenarios of every grid; arguments as the attributes of :class:`Archive`.

    Returns:
        what ``run.json`` will hold; it is written last, because a folder that has one is finished.
    """
    entries = {}
    for name, results in grids.items():
        at = place(folder, name, len(grids) > 1)
        runs.write_table(at, "runs", results.runs)
        runs.write_table(at, "summary", named(results))
        if len(beside := rivals.table(results)):
            runs.write_table(at, "learned", beside)
        kind = "jobs" if results.jobs else "following"
        for table in TABLES[kind]:
            frame = getattr(results, table)
            if len(frame):
                runs.write_table(at, table, frame, csv=table not in ("traces", "plans"))
        results.meta["tables"] = {file.stem: _hash(file) for file in sorted(at.glob("*.parquet"))}
        for scenario, text in texts.get(name, {}).items():
            runs.write_text(at / "scenarios" / f"{scenario}.toml", text)
        own = {key: value for key, value in results.meta.items() if key not in meta or meta[key] != value}
        rest = {key: getattr(results, key) for key in KEPT[kind]}
        entries[name] = {"kind": kind, "folder": str(at.relative_to(folder)), **own, **rest}
    return {"format": FORMAT, **meta, "grids": entries}


def named(results: Results) -> pd.DataFrame:
    """The summary as it is written. Followers have a ``score``; what jobs are ranked by has the name of its metric."""
    frame = results.summary().rename_axis("controller").reset_index()
    if results.jobs:
        ends = {f"score{end}": f"{results.metric}{end}" for end in ("_low", "_high")}
        frame = frame.drop(columns="score").rename(columns=ends)
    return frame


def _hash(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


# ---------------------------------------------------------------------------------------------------------- reading


def load(folder: str | Path) -> Archive:
    """Reads a run back. What is damaged is read as far as it can be; ``meta["notes"]`` says what is not there.

    Raises:
        InvalidInput: no such folder, not a benchmark's, not finished, of a later format, or nothing in it can be read.
    """
    folder = Path(folder)
    record = _record(folder)
    entries = record.pop("grids")
    notes, grids, texts = list(record.pop("notes", [])), {}, {}
    if record.get("kerfgym") != __version__:
        notes.append(f"Run {folder.name} was made by kerfgym {record.get('kerfgym')}, this page by {__version__}.")
    meta = {key: value for key, value in record.items() if key != "format"}
    for name, entry in entries.items():
        try:
            found = _grid(folder, name, entry, meta, notes)
            texts[name] = _texts(folder, f"{entry['folder']}/scenarios")
            grids[name] = found
        except InvalidInput as error:
            notes.append(f"Suite {name} of run {folder.name} is left out: {error}.")
    if not grids:
        raise InvalidInput(f"run folder '{folder}' holds nothing to show; {' '.join(notes) or 'it has no grid'}")
    if notes:
        meta["notes"] = notes
        for results in grids.values():
            results.meta["notes"] = notes
    return Archive(folder, grids, meta, texts)


def _record(folder: Path) -> dict[str, Any]:
    """``run.json`` in today's form."""
    if not files.is_folder(folder):
        beside = folder.parent.glob("*/run.json") if files.is_folder(folder.parent) else ()
        there = [file.parent.name for file in sorted(beside)]
        hint = f"; {did_you_mean(folder.name, there)}" if there else f"; there is none in '{folder.parent}'"
        raise InvalidInput(f"no run folder '{folder}'{hint.replace('; (', ' (')}")
    file = folder / "run.json"
    if not files.is_file(file):
        if files.is_folder(folder / UNFINISHED) or files.is_file(folder / runs.BEGUN):
            raise InvalidInput(f"run '{folder}' was interrupted; {resumption(folder)} finishes it")
        raise InvalidInput(f"'{folder}' is not a run folder: it has no run.json")
    record = files.json_(file)
    if not isinstance(record, dict):
        raise InvalidInput(f"'{file}' is not a run's record")
    written = record.get("format", 1)
    if not isinstance(written, int) or not 1 <= written <= FORMAT:
        raise InvalidInput(
            f"run '{folder}' has format {written}, made by kerfgym {record.get('kerfgym')}; "
            f"kerfgym {__version__} reads formats up to {FORMAT}"
        )
    record = kinds.run(record, f"'{file}'")
    if written == 1:
        record = _from_format_1(folder, record)
    if not isinstance(record.get("grids"), dict):
        raise InvalidInput(f"run '{folder}' is not a benchmark's: {record.get('command', 'no command recorded')}")
    return record


def _from_format_1(folder: Path, record: dict[str, Any]) -> dict[str, Any]:
    """A record with the one grid in it; what was not kept of the scenarios is read from their files."""
    own = ("seeds", "seed_count", "scenarios", "controllers", "core", "ledger", "tuning", "parameters", "decisions")
    if not {"scenarios", "controllers", "core"} <= set(record):
        return record
    cases = [scenarios.read(file, stored=True) for file in sorted((folder / "scenarios").glob("*.toml"))]
    names = record["scenarios"]
    suites = [suite for suite in scenarios.suites() if set(names) & set(scenarios.rules(suite)["scenarios"])]
    with_jobs = any(case.job for case in cases)
    suite = suites[0] if suites else "contour" if with_jobs else "following"
    rules, materials = scenarios.rules(suite), [workshop.material_of(case) for case in cases if case.job]
    entry = {"kind": "jobs" if with_jobs else "following", "folder": ".", **{k: record[k] for k in own if k in record}}
    entry |= {"summaries": {c.name: c.summary for c in cases}, "exempt": [c.name for c in cases if c.exempt]}
    entry |= {"metric": rules.get("score"), "reference": rules.get("reference")}
    entry["labels"] = list(dict.fromkeys(m.label for m in materials))
    entry["materials"] = list(dict.fromkeys((m.name, m.thickness) for m in materials))
    return {**{key: value for key, value in record.items() if key not in own}, "grids": {suite: entry}}


def _grid(folder: Path, name: str, entry: Any, meta: dict[str, Any], notes: list[str]) -> Results:
    """One grid.

    Raises:
        InvalidInput: its record is incomplete, or its runs cannot be read.
    """
    try:
        entry = kinds.grid(entry, name, f"'{folder / 'run.json'}': grids.{name}")
        kind, at = entry["kind"], files.within(folder, entry["folder"], "folder")
        kept = entry.get("tables", {})
        frames = {table: _table(at, table, kept.get(table), notes) for table in TABLES[kind]}
        if "headroom" in frames:  # what version 0.1 called a bound is a reference
            frames["headroom"] = frames["headroom"].rename(columns={"bound": "informed", "bound_rms": "informed_rms"})
        rows = _table(at, "runs", kept.get("runs"), notes, needed=True)
        lacking = _lacking(rows, (*_RUNS, str(entry["metric"]) if kind == "jobs" else Results.metric))
        if lacking or not len(rows):
            raise InvalidInput(f"'{at / 'runs.parquet'}' has {f'no column {lacking}' if lacking else 'no rows'}")
        twice = rows.loc[rows.duplicated(["controller", "scenario", "seed"]), ["controller", "scenario", "seed"]]
        for controller, scenario, seed in twice.head(1).itertuples(index=False):
            raise InvalidInput(f"'{at / 'runs.parquet'}' has {controller} in {scenario} with seed {seed} twice")
        for table, columns in TABLES[kind].items():
            if len(frames[table]) and (wrong := _wrong(frames[table], columns, rows)):
                notes.append(f"'{at / f'{table}.parquet'}' {wrong}; it is left out.")
                frames[table] = pd.DataFrame()
        own = {**meta, **{key: value for key, value in entry.items() if key not in _RESTS}}
        core = tuple(c for c in entry["core"] if c in entry["scenarios"])
        kept = {key: _tuple(entry[key]) for key in KEPT[kind]}
        tables = {"sensitivity": pd.DataFrame(), **frames}
        return Results(runs=rows, meta=own, core=core, jobs=kind == "jobs", **tables, **kept)
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"the record of suite '{name}' in '{folder / 'run.json'}' lacks {error}") from None


def _lacking(table: pd.DataFrame, columns: Iterable[str]) -> str:
    """The first of some columns that a table does not have; empty if it has them all."""
    return next((column for column in columns if column not in table), "")


def _wrong(table: pd.DataFrame, columns: Iterable[str], rows: pd.DataFrame) -> str:
    """Why a table cannot stand beside the runs ``rows``; empty if it can."""
    if lacking := _lacking(table, columns):
        return f"has no column {lacking}"
    for column in ("controller", "scenario"):
        if column in table and (strange := set(table[column]) - set(rows[column])):
            return f"has {column} '{min(map(str, strange))}', of which there is no run"
    if "signal" in table and (strange := set(table["signal"].dropna()) - set(_SIGNALS)):
        return f"has signal '{min(map(str, strange))}'; known: {', '.join(_SIGNALS)}"
    curve = {"frequency", "magnitude"} <= set(table)
    if curve and not ((table["frequency"] > 0) & (table["frequency"] < np.inf) & (table["magnitude"] != np.inf)).all():
        return "has a frequency or a magnitude that is not finite"
    if "gain" in table and table.duplicated([c for c in ("controller", "machine") if c in table]).any():
        return "has a controller twice"
    return ""


def _tuple(value: Any) -> Any:
    """A list out of a record as the results hold it."""
    return tuple(map(_tuple, value)) if isinstance(value, list) else value


def _texts(folder: Path, name: str) -> dict[str, str]:
    """Scenarios by name; no link among them leads out of the run's folder, since a report holds what they say."""
    place = files.within(folder, name, "folder")
    inside = [files.within(folder, f"{name}/{file.name}", "scenario") for file in sorted(place.glob("*.toml"))]
    return {file.stem: scenarios.living(files.text(file, files.SETTINGS)) for file in inside}


def _table(at: Path, name: str, stamp: str | None, notes: list[str], needed: bool = False) -> pd.DataFrame:
    """A table, from its Parquet file or, where that is damaged, from the CSV beside it; empty if it was not kept.

    Args:
        at: where the grid's tables are.
        name: of the table.
        stamp: SHA-256 of the Parquet file as it was written; None if it was not, or is not known.
        notes: to which is added what a reader must know.
        needed: there is no grid without it.

    Raises:
        InvalidInput: it is needed and cannot be read.
    """
    parquet, csv = at / f"{name}.parquet", at / f"{name}.csv"
    if not files.is_file(parquet):
        why = f"'{parquet}' is missing"
        if not stamp and not needed and not files.is_file(csv):
            return pd.DataFrame()
    else:
        try:
            frame = tabular.read_parquet(parquet)
        except InvalidInput as error:
            why = str(error)
        else:
            if not stamp or _hash(parquet) == stamp:
                return frame
            # Of the runs something can still be concluded; what was measured beside them is not what it was.
            notes.append(f"'{parquet}' was changed after the run{'' if needed else '; it is left out'}.")
            return frame if needed else pd.DataFrame()
    try:
        frame = tabular.read_csv(csv)
    except InvalidInput:
        if needed:
            raise InvalidInput(why) from None
        notes.append(f"{why}: what it held is not shown.")
        return pd.DataFrame()
    notes.append(f"{why}: its CSV was read instead.")
    return frame


def resumption(folder: Path) -> str:
    """The command that finishes an interrupted run, in words."""
    commands = runs.begun(folder)
    return f"'{commands[0]}'" if commands else "the same command with --resume"
