"""A benchmark's run folder, written and read back.

::

    runs/<name>/run.json            the record: format, command, versions, machine; and of each grid its seeds, cost …
                report.html
                runs.parquet …      the tables, if there is one grid
                following/runs.parquet …, cutting/runs.parquet …      if there are several
                scenarios/*.toml    what was run, beside the tables
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from ..envs.plant.quantity import InvalidInput
from ..envs.scenarios import Scenario
from . import runs
from .jobs import JobResults
from .results import Results

FORMAT = 2
"""Of the run folder; 1 had one grid and its record among the run's."""

TABLES = {"following": ("traces", "sensitivity", "margins", "blame", "headroom"), "jobs": ("traces",)}
"""Tables of a grid of either kind, beside ``runs``; each may be absent."""


@dataclass(frozen=True)
class Archive:
    """A run as it was stored.

    Attributes:
        folder: of the run.
        grids: results of each suite by its name, in the order in which they were asked for.
        meta: what holds for all of them: command, versions, machine.
    """

    folder: Path
    grids: dict[str, Results | JobResults]
    meta: dict[str, Any] = field(default_factory=dict)


def place(folder: Path, name: str, several: bool) -> Path:
    """Where the tables of a grid are."""
    return folder / name if several else folder


def save_tables(
    folder: Path, grids: dict[str, Results | JobResults], meta: dict[str, Any], chosen: dict[str, Iterable[Scenario]]
) -> dict[str, Any]:
    """Writes tables and scenarios of every grid.

    Returns:
        what ``run.json`` will hold; it is written last, because a folder that has one is finished.
    """
    entries = {}
    for name, results in grids.items():
        at = place(folder, name, len(grids) > 1)
        runs.write_table(at, "runs", results.runs)
        runs.write_table(at, "summary", results.summary().reset_index())
        kind = "jobs" if isinstance(results, JobResults) else "following"
        for table in TABLES[kind]:
            frame = getattr(results, table)
            if len(frame):
                runs.write_table(at, table, frame, csv=table != "traces")
        for scenario in chosen.get(name, []):
            with runs.atomic(at / "scenarios" / f"{scenario.name}.toml") as part:
                part.write_text(scenario.to_toml(), encoding="utf-8")
        own = {key: value for key, value in results.meta.items() if key not in meta}
        entries[name] = {"kind": kind, "folder": str(at.relative_to(folder)), **own, **_rest(results)}
    return {"format": FORMAT, **meta, "grids": entries}


def _rest(results: Results | JobResults) -> dict[str, Any]:
    """What is in the results and in no table."""
    if isinstance(results, Results):
        return {"exempt": results.exempt, "summaries": results.summaries}
    return {
        "metric": results.metric, "reference": results.reference, "labels": results.labels,
        "materials": results.materials, "summaries": results.summaries,
    }  # fmt: skip


_RESTS = ("kind", "folder", "exempt", "summaries", "metric", "reference", "labels", "materials")


def load(folder: str | Path) -> Archive:
    """Reads a run back.

    Raises:
        InvalidInput: no such folder, not a benchmark's, not finished, or of another format.
    """
    folder = Path(folder)
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    entries = record.pop("grids")
    record.pop("format")
    if not entries:
        raise InvalidInput(f"run folder '{folder}' holds no grid")
    return Archive(folder, {name: _grid(folder / e["folder"], e, record) for name, e in entries.items()}, record)


def _grid(at: Path, entry: dict[str, Any], record: dict[str, Any]) -> Results | JobResults:
    tables = {
        name: pd.read_parquet(at / f"{name}.parquet") if (at / f"{name}.parquet").is_file() else pd.DataFrame()
        for name in ("runs", *TABLES[entry["kind"]])
    }
    meta = {**record, **{key: value for key, value in entry.items() if key not in _RESTS}}
    core, summaries = tuple(entry["core"]), entry["summaries"]
    shown = tuple(name for name in core if name in entry["scenarios"])
    if entry["kind"] == "jobs":
        return JobResults(
            tables["runs"], tables["traces"], meta, entry["metric"], entry["reference"], shown, tuple(entry["labels"]),
            tuple((name, thickness) for name, thickness in entry["materials"]), summaries,
        )  # fmt: skip
    return Results(
        tables["runs"], tables["traces"], tables["sensitivity"], meta, shown, tuple(entry["exempt"]), summaries,
        tables["margins"], tables["blame"], tables["headroom"],
    )  # fmt: skip
