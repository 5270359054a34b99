"""``kerfgym tune --study``: carries a study file out, search by search, and writes the presets that come out of it.

Every search has a run folder of its own within the study's, so what is finished stays finished. Presets are written
when all are over: a search starts from the preset that is there, and may not find another one half-way.
"""

import functools
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomli_w
from joblib import Parallel, delayed
from rich.console import Console
from rich.table import Table

from ... import baselines
from ...envs.engine.quantity import InvalidInput
from ...envs.figures import job_metrics, metrics
from ...envs.safety import files
from ..statistics.pooling import declared
from ..store import runs, typed
from . import controllers, crew, goals, outcome, staged
from .study import Task
from .study_file import Study

PLAN = "study.json"
"""What a folder's study asks for; another one cannot go on in it."""

COUNTED = ("trials", "simulated_steps", "ms_steps", "cpu_seconds", "git", "start")
"""Of an earlier search's record, what one that goes on from it keeps."""


def carry_out(
    study: Study,
    folder: Path,
    workers: int = 1,
    threads: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    told: crew.Told = lambda finished, total, last: None,
) -> pd.DataFrame:
    """Makes every search of a study, or what is left of them; one row for each, those that found nothing without.

    Args:
        study: what is searched.
        folder: of the run.
        workers: searches at a time, each in a process of its own; they change no figure.
        threads: of each; the cores shared out unless told otherwise.
        overwrite, resume: as for :func:`runs.open_folder`.
        told: is told how many trials of a search, or of several at a time how many searches, are over.

    Raises:
        InvalidInput: bad input, or a folder that cannot be used.
    """
    if workers < 1:
        raise InvalidInput(f"--workers {workers} is out of range; at least 1")
    for name, task in study.searches.items():
        try:
            task.check()
        except InvalidInput as error:
            raise InvalidInput(f"study {study.name}: search.{name}: {error}") from None
    threads = threads or max(1, (os.cpu_count() or 1) // workers)
    with runs.at_work(folder, overwrite, resume):
        _planned(study, folder)
        command = list(typed.TYPED.get()) or ["kerfgym", "tune", "--study", study.name]
        one = delayed(functools.partial(_search, folder=folder, threads=threads, command=command))
        tell = told if workers == 1 else None
        todo = (one(name, task, told=tell) for name, task in study.searches.items())
        each = Parallel(n_jobs=workers, return_as="generator")(todo)
        records: dict[str, dict[str, Any]] = {}
        for name, record in zip(study.searches, each, strict=True):
            records[name] = record
            if workers > 1:
                told(len(records), len(study.searches), name)
        found = {name: record for name, record in records.items() if "tuned" in record}
        frame = pd.DataFrame([_row(name, study.searches[name], record) for name, record in found.items()])
        runs.write_table(folder, "searches", frame)
        if study.presets:
            before = {name: study.searches[name].base.provenance for name in found}
            for name in found:
                write(baselines.PRESETS / f"{name}.toml", study, name, found[name]["tuned"], before[name])
        failed = {name: record["error"] for name, record in records.items() if "error" in record}
        runs.write_json(folder / "run.json", runs.record(command) | {"study": study.name, "failed": failed})
        for name, why in failed.items():
            typed.say(f"{name}: {why}; its preset stays as it is")
    return frame


def _planned(study: Study, folder: Path) -> None:
    """Notes what the study is, in its own words.

    Raises:
        InvalidInput: the folder holds another one.
    """
    plan = {name: [*task.words[:-1], f"trials {task.trials}"] for name, task in study.searches.items()}
    if (folder / PLAN).is_file() and (there := files.json_(folder / PLAN)) != json.loads(json.dumps(plan)):
        differ = [name for name in plan if not isinstance(there, dict) or there.get(name) != plan[name]]
        raise InvalidInput(
            f"'{folder}' holds another study (search {', '.join(differ or ['left out'])} differs); use another --name"
        )
    runs.write_json(folder / PLAN, plan)


def _search(
    name: str, task: Task, folder: Path, threads: int, command: list[str], told: crew.Told | None
) -> dict[str, Any]:
    """The record of one search, made unless it is there; an ``error`` if nothing keeps the limits."""
    own = folder / name

    def tell(finished: int, total: int, last: str) -> None:
        if told:
            told(finished, total, f"{name}: {last}" if last else name)

    if not (own / "run.json").is_file():
        try:
            controllers.tune(task, own, 1, threads, resume=True, told=tell, command=command)
        except outcome.NothingFound as error:
            return {"error": str(error)}
    (own / runs.BEGUN).unlink(missing_ok=True)
    record: dict[str, Any] = files.json_(own / "run.json")
    return record


def _row(name: str, task: Task, record: dict[str, Any]) -> dict[str, Any]:
    """What a search came to: on test seeds, and at which cost."""
    tuned = record["tuned"]
    row: dict[str, Any] = {"search": name, "controller": task.controller, "cap": task.limits.ms}
    row |= {f"{key}_test": value for key, value in tuned["test"].items()}
    row |= {key: tuned.get(key) for key in ("ms", "trials", "sampler", "tune_seeds", "simulated_steps", "cpu_seconds")}
    return row | {"parameters": json.dumps(tuned["parameters"])}


def write(path: Path, study: Study, name: str, tuned: dict[str, Any], before: dict[str, Any]) -> None:
    """Writes a preset with the record of its search.

    Args:
        path: of the preset.
        study, name: that searched it.
        tuned: what the run's record says of the result.
        before: the record of the controller as it stood.
    """
    task = study.searches[name]
    found = dict(task.set) | tuned["parameters"]
    parameters = {key: value if isinstance(value, str) else float(value) for key, value in found.items()}
    body = {"parameters": parameters, "provenance": preset_record(task, tuned, before)}
    head = f"# Found by: kerfgym tune {name} --study {study.name}\n"
    runs.write_text(path, head + tomli_w.dumps(body))


def preset_record(task: Task, tuned: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """What a preset says of its search; what an earlier one on the same suite cost counts (``start``)."""
    metric = task.metrics[0]
    unit = {"µm": "_um"}.get(goals.metric(metric, task.jobs).unit, "")
    record: dict[str, Any] = {"suite": tuned["suite"], f"score_tune{unit}": round(tuned["tune"][metric], 4)}
    if task.criterion or task.relative:
        record["criterion"] = task.criterion or ", ".join([metric, *map(task.told, task.limits.limits)])
    if "ms" in tuned:
        record |= {"ms": tuned["ms"], "collisions_tune": 0, "cap": task.limits.ms}
    if "score_checked" in tuned:
        record |= {"checked_on": tuned["checked_on"], f"score_checked{unit}": round(tuned["score_checked"], 4)}
    sampler = staged.told(task.stages, task.trials) if task.stages else task.sampler
    record |= {"trials": tuned["trials"], "searched": len(task.space.axes), "sampler": sampler}
    cost = ("tune_seeds", "simulated_steps", "ms_steps", "cpu_seconds")
    for key in ("sampler_seed", *cost, "kerfgym", "git", "python", "relative"):
        if key in tuned:
            record[key] = tuned[key]
    if task.relative:
        record["evidence"] = tuned["test"]["evidence"]
    if before.get("suite") == tuned["suite"]:
        record["start"] = {key: before[key] for key in COUNTED if key in before}
    return record


def show(found: pd.DataFrame) -> None:
    """Prints what the searches came to on test seeds; ``searches.csv`` holds more."""
    if not len(found):
        return
    limited, scores = np.isfinite(found["cap"]).any(), [c for c in found if str(c).removesuffix("_test") in SHOWN]
    out = Table(title="what the searches found, on test seeds")
    out.add_column("search")
    for title in (
        *(["Ms at most"] if limited else []),
        *(declared(c.removesuffix("_test")).title for c in scores),
        "Ms",
        "trials",
        "steps",
        "CPU-s",
    ):
        out.add_column(title, justify="right")
    for _, row in found.iterrows():
        figures = [*([row["cap"]] if limited else []), *(row[c] for c in scores), row["ms"]]
        counts = (f"{row[c]:,.0f}" for c in ("trials", "simulated_steps", "cpu_seconds"))
        out.add_row(row["search"], *("–" if not _known(x) else f"{x:.4g}" for x in figures), *counts)
    Console(width=max(Console().width, 100)).print(out)
    print(f"{found['simulated_steps'].sum():,} simulated steps, {found['cpu_seconds'].sum():,.0f} CPU-s")


SHOWN = {*metrics.METRICS, *job_metrics.METRICS}
"""Metrics of which a table shows what a search came to."""


def _known(x: Any) -> bool:
    return x is not None and bool(np.isfinite(x))
