"""Runs studies in worker processes; each leaves its rows and figures in the run folder, so that a run can go on."""

import math
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files
from ..plots.png import png
from ..store import runs
from . import claims_page
from .claims import Estimate, Evidence, Row, Study, Trial, studies
from .verdicts import VERDICTS

UNFINISHED, FIGURES = "parts", "figures"


def reproduce(
    names: Sequence[str],
    folder: Path,
    seeds: int = 24,
    workers: int = 2,
    overwrite: bool = False,
    resume: bool = False,
    progress: Callable[[int, int, str], None] = lambda done, total, name: None,
) -> list[dict[str, Any]]:
    """The studies' findings, in the order of the documents, written to ``folder`` with their page.

    Args:
        names: of documents or studies; all if empty.
        folder: of the run.
        seeds: independent runs of whatever is random, at least 6 (fewer give no interval).
        workers: processes.
        overwrite, resume: as for :func:`runs.open_folder`.
        progress: told how many studies are done, of how many, and which was the last.

    Raises:
        InvalidInput: unknown name, too few seeds, or a folder that is not to be touched.
    """
    if seeds < 6:
        raise InvalidInput(f"--seeds {seeds}: an interval needs at least 6")
    if workers < 1:
        raise InvalidInput(f"--jobs {workers} is out of range; at least 1")
    chosen, record = studies(names), runs.record()
    with runs.at_work(folder, overwrite, resume):
        stamp = {"seeds": seeds, "git": record["git"], "kerfgym": record["kerfgym"]}
        kept = [_kept(folder, s, stamp) for s in chosen]
        found = {part["study"]: part for part in kept if part}
        todo = [s for s in chosen if s.name not in found]
        jobs = (delayed(_one)(s.name, folder, seeds, stamp) for s in todo)
        done = len(chosen) - len(todo)
        for part in Parallel(n_jobs=workers, return_as="generator_unordered")(jobs):
            done += 1
            found[part["study"]] = part
            progress(done, len(chosen), part["study"])
        parts = [found[s.name] for s in chosen]
        claims_page.write(folder, parts, record, seeds)
        failed = [part["study"] for part in parts if part["error"]]
        of_run = {"seeds": seeds, "studies": [s.name for s in chosen], "failed": failed}
        runs.write_json(folder / "run.json", record | of_run)
    return parts


def _file(folder: Path, name: str) -> Path:
    return folder / UNFINISHED / f"{name.replace('/', '-')}.json"


def _kept(folder: Path, s: Study, stamp: dict[str, Any]) -> dict[str, Any] | None:
    """What an interrupted run of the same version and seeds found; what is not as we wrote it is found anew."""
    try:
        part = files.json_(_file(folder, s.name))
        drawn = [files.within(folder / FIGURES, Path(d["file"]).name, "figure") for d in part["drawings"]]
        whole = all(map(files.is_file, drawn))
        mine = part["study"] == s.name and part["stamp"] == stamp and not part["error"]
        mine &= all(d["file"] == f"{FIGURES}/{s.document}-{d['name']}.png" for d in part["drawings"])
        mine &= all(row["verdict"] in VERDICTS for row in part["rows"])
    except (InvalidInput, KeyError, TypeError):
        return None
    return part if mine and whole else None


def _one(name: str, folder: Path, seeds: int, stamp: dict[str, Any]) -> dict[str, Any]:
    """Runs one study and writes what it found; an error is part of the findings."""
    (s,) = studies([name])
    start, error, rows, drawings = time.process_time(), "", [], []
    try:
        findings = s.run(Trial(seeds))
        rows = [_row(row) for row in findings.rows]
        for d in findings.drawings:
            file = f"{FIGURES}/{s.document}-{d.name}.png"
            with runs.atomic(folder / file) as part:
                part.write_bytes(png(d.figure))
            width, height = (round(float(size) * d.figure.dpi) for size in d.figure.get_size_inches())
            drawn = {"name": d.name, "file": file, "caption": d.caption, "source": d.source}
            drawings.append({**drawn, "width": width, "height": height})
    except Exception as problem:  # one study that fails must not take the others along
        error = f"{type(problem).__name__}: {problem}"
        trace = folder / UNFINISHED / f"{name.replace('/', '-')}.error.txt"
        with runs.atomic(trace) as part:
            part.write_text(traceback.format_exc(), encoding="utf-8")
    found: dict[str, Any] = {"study": s.name, "document": s.document, "title": s.title}
    found |= {"stamp": stamp, "error": error}
    found |= {"rows": rows, "drawings": drawings, "cpu_seconds": round(time.process_time() - start, 2)}
    runs.write_json(_file(folder, name), found)
    return found


def _row(row: Row) -> dict[str, Any]:
    """A row as JSON takes it: texts for readers, numbers beside them."""
    texts = {**asdict(row), "simulation": str(row.simulation)}
    texts |= {"true": str(row.true), "evidence": str(row.evidence or "")}
    numbers = {
        key: {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(value).items()}
        for key, value in (("simulation", row.simulation), ("true", row.true), ("evidence", row.evidence))
        if isinstance(value, (Estimate, Evidence))
    }
    return {**texts, "numbers": numbers}
