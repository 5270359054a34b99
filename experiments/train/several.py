"""``kerfgym train --seeds N``: independent trainings of one method, each in a folder of its own.

::

    runs/<name>/seed-0/ …         as after a training with one seed; each has its ledger
                trainings.csv     a row a training, then base and best classical controller, on the same test seeds
                run.json          settings, sum of the ledgers, and what the trainings came to

A training that was interrupted goes on from its checkpoint, one that is finished is kept. One that came to no finite
numbers has a row without a score, and is no reason to lose the others.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from ...agents.settings import Settings
from ...agents.train import Diverged
from ...envs.engine.quantity import InvalidInput
from ...envs.safety import files
from ..results.conclusions import Results
from ..store import pool, runs
from ..store.plain import plain
from ..store.progress import Bars
from . import folder as single
from . import held_out

TABLE = "trainings.csv"


class Task(NamedTuple):
    """One training; ``words`` are the command that makes it, without its seed."""

    folder: Path
    settings: Settings
    seed: int
    device: str
    threads: int
    ms: bool
    words: tuple[str, ...]

    @property
    def place(self) -> Path:
        """Its folder."""
        return self.folder / f"seed-{self.seed}"


def command(
    algorithm: str,
    env: str,
    steps: int | None,
    preset: Path | None,
    assignments: Sequence[str],
    device: str,
    threads: int,
    where: Sequence[str] = (),
) -> tuple[str, ...]:
    """The words that make any one of the trainings; ``where`` are those for suites, scenarios and machine. Trainings
    differ in the seed alone, which is how reports know that these are runs of one method."""
    words = ["kerfgym", "train", algorithm, "--env", env]
    words += ["--steps", str(steps)] if steps is not None else []
    words += ["--preset", str(preset)] if preset is not None else []
    words += [word for each in assignments for word in ("--set", each)] + list(where)
    words += ["--device", device] if device != "cpu" else []
    return (*words, *(["--threads", str(threads)] if threads != 1 else []))


def into(folder: Path, tasks: Sequence[Task], test_seeds: int, workers: int) -> Path:
    """Trains what is not trained yet, compares, and writes table and record.

    Raises:
        InvalidInput: a finished training had other settings, or all trainings diverged.
    """
    left = [task for task in tasks if not _kept(task)]
    with Bars() as bars:
        done = pool.spread(_trained, left, workers, few=1)
        diverged = {seed: why for seed, why in bars.each("trainings", done, len(left)) if why}
        good = [task for task in tasks if task.seed not in diverged]
        if not good:
            raise InvalidInput(f"all {len(tasks)} trainings diverged: {next(iter(diverged.values()))}")
        policies, names = [str(task.place / single.POLICY) for task in good], [f"seed {task.seed}" for task in good]
        beside = None
        if test_seeds:
            with bars.busy("policies, base and best classical controller on test seeds"):
                beside = held_out.compared(tasks[0].settings, policies, test_seeds, workers)
    table = _table(tasks, diverged, beside)
    with runs.atomic(folder / TABLE) as part:
        table.to_csv(part, index=False, float_format="%.6g")
    record = _record(tasks, good, diverged, beside)
    runs.write_json(folder / "run.json", {**runs.record(), **record})
    print("\n".join(_told(tasks, good, diverged, beside, policies, names)))
    return folder


def _kept(task: Task) -> bool:
    """Whether a training is finished.

    Raises:
        InvalidInput: it was one with other settings.
    """
    if not (task.place / "run.json").is_file():
        return False
    before = files.json_(task.place / "run.json").get("settings")
    if before != recorded_settings(task.settings):
        raise InvalidInput(f"'{task.place}' was trained with other settings; use the same command, or another --name")
    return True


def recorded_settings(settings: Settings) -> dict[str, Any]:
    """Settings as JSON gives them back."""

    found: dict[str, Any] = json.loads(json.dumps(settings.flat()))
    return found


def _trained(task: Task) -> tuple[int, str]:
    """The seed of a training that is over, and why it came to nothing, if it did."""
    task.place.mkdir(parents=True, exist_ok=True)
    words = [*task.words, "--seed", str(task.seed)]
    try:
        single.into(task.place, task.settings, task.seed, task.device, task.threads, task.ms, words, quiet=True)
    except Diverged as error:
        return task.seed, str(error)
    return task.seed, ""


def _table(tasks: Sequence[Task], diverged: dict[int, str], beside: Results | None) -> pd.DataFrame:
    """A row a training; below, base and best classical controller, if they were run."""
    figures = held_out.rows(beside) if beside is not None else pd.DataFrame()
    rows, mine = [], set()
    for task in tasks:
        row: dict[str, Any] = {"training": f"seed {task.seed}", "diverged": task.seed in diverged}
        if task.seed not in diverged:
            record, name = files.json_(task.place / "run.json"), str(task.place / single.POLICY)
            ledger = record["ledger"]
            row |= {"simulated_steps": ledger["simulated_steps"], "cpu_seconds": ledger["cpu_seconds"]}
            row |= {"score_tune": record["best"]["score_tune"]}
            row |= figures.loc[name].to_dict() if beside is not None else {}
            mine.add(name)
        rows.append(row)
    rows += [{"training": name, **row} for name, row in figures.to_dict("index").items() if name not in mine]
    return pd.DataFrame(rows)


def _record(
    tasks: Sequence[Task], good: Sequence[Task], diverged: dict[int, str], beside: Results | None
) -> dict[str, Any]:
    first, ledgers = tasks[0], [files.json_(task.place / "run.json")["ledger"] for task in good]
    out: dict[str, Any] = {"kind": "trainings", "env": first.settings.env, "algorithm": first.settings.name}
    out |= {"seeds": [task.seed for task in tasks], "settings": first.settings.flat()}
    out["ledger"] = {key: round(sum(each[key] for each in ledgers), 1) for key in ("simulated_steps", "cpu_seconds")}
    out |= {"cut_by": on.record} if (on := held_out.cut_by(first.settings)) else {}
    out["ledgers"] = {f"seed {task.seed}": ledger for task, ledger in zip(good, ledgers, strict=True)}
    if diverged:
        out["diverged"] = {f"seed {seed}": why for seed, why in diverged.items()}
    if beside is not None:
        policies, names = [str(task.place / single.POLICY) for task in good], [f"seed {task.seed}" for task in good]
        out["test"] = held_out.record(beside, policies, names)
        out["method"] = plain(held_out.method(beside, policies))
    return out


def _told(
    tasks: Sequence[Task],
    good: Sequence[Task],
    diverged: dict[int, str],
    beside: Results | None,
    policies: Sequence[str],
    names: Sequence[str],
) -> list[str]:
    lines = [f"{len(good)} of {len(tasks)} trainings came to a policy"] if diverged else []
    if beside is None:
        return lines
    lines += held_out.told(beside, policies, names)
    found, base = held_out.method(beside, policies), beside.reference
    lines.append(
        f"{len(good)} trainings: median {found['median']:.3f}, best {found['best']:.3f}, worst {found['worst']:.3f}"
    )
    if "ratio" in found:
        lines.append(
            f"over trainings and seeds: {found['score']:.3f} ({found['score_low']:.3f} … {found['score_high']:.3f}), "
            f"{base} ÷ it {found['ratio']:.3f} ({found['ratio_low']:.3f} … {found['ratio_high']:.3f})"
        )
        lines.append(f"the method is {held_out.verdict(found['ratio_low'], found['ratio_high'], base)}")
    return lines
