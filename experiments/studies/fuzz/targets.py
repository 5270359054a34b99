"""What kerfgym does with a file of each kind: reads it, and goes on with it as far as a command would."""

import contextlib
import functools
import json
import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....envs import scenarios
from ....envs.control import stack as stacks
from ....envs.engine.quantity import InvalidInput
from ....envs.plant import calibration, heads, idle
from ....envs.plant.controller import make_law
from ....envs.plant.fleet import Fleet
from ....envs.scenarios import material
from ....envs.tasks import workshop
from .mutate import mutated
from .seeds import JOURNALED


@dataclass(frozen=True)
class Target:
    """A kind of file.

    Attributes:
        seeds: pattern of its seeds, below the folder that :func:`seeds.make` filled.
        use: of a path; an ``InvalidInput`` is a good end, too.
        place: makes the path under which it is read from the changed bytes, its seed and a folder for it.
    """

    seeds: str
    use: Callable[[Path], object]
    place: Callable[[bytes, Path, Path], Path]


def _beside(data: bytes, seed: Path, folder: Path) -> Path:
    file = folder / seed.name
    file.write_bytes(data)
    return file


def _within(data: bytes, seed: Path, folder: Path) -> Path:
    """In a copy of the folder in which the seed lies."""
    shutil.copytree(seed.parent, folder / seed.parent.name)
    (folder / seed.parent.name / seed.name).write_bytes(data)
    return folder / seed.parent.name


def _policy(data: bytes, seed: Path, folder: Path) -> Path:
    """A policy's folder whose hashes are right, as somebody who means harm would make them."""
    import hashlib

    place = _within(data, seed, folder)
    with contextlib.suppress(ValueError, RecursionError, AttributeError, TypeError):
        document = json.loads((place / "policy.json").read_text(encoding="utf-8"))
        document.pop("sha256", None)
        document["weights"] = hashlib.sha256((place / "weights.safetensors").read_bytes()).hexdigest()
        (place / "policy.json").write_text(json.dumps(document), encoding="utf-8")
    return place


# ------------------------------------------------------------------------------------------------------- what is done


def _drawing(file: Path) -> None:
    from ....envs.paths.read import read

    read(file)
    with contextlib.suppress(InvalidInput):
        scenarios.contour(str(file))


def _scenario(file: Path) -> None:
    scenario = scenarios.read(file)
    scenarios.parse(scenario.to_toml())
    if scenario.job:
        workshop.programme(scenario, stacks.team("wu-tuned"))
        return
    fleet = Fleet(1, make_law(idle, "idle"), heads.POOL)
    scenarios.prepare(fleet, scenario, [0], [1000])
    fleet.begin([0], scenarios.noise_keys([1000]))
    fleet.advance(5)


def _preset(file: Path) -> None:
    from ....agents import settings
    from ....agents.learner import environment

    found = settings.from_file(file, "ppo", None, {"environment.num_envs": 2})
    with contextlib.closing(environment(found)):
        pass


def _study(file: Path) -> None:
    from ...tune import study_file

    for task in study_file.read(str(file)).searches.values():
        _ = task.base, task.space


def _csv(file: Path) -> None:
    from ....envs.safety.files import TABLE, checked

    if file.stem == "calibration":
        calibration.read_csv(checked(file, TABLE))
    elif file.stem == "profile":
        scenarios.profile(scenarios.Profile(file=str(file)))
    elif file.stem == "map":
        scenarios.height_map(scenarios.Map(file=str(file)))
    else:
        scenarios.signal(str(file))


def _artefact(folder: Path) -> None:
    from ....agents.policy import Policy, stack_of

    policy = Policy.load(folder)
    policy.act(np.zeros(policy.network.size, np.float32), start=True)
    stack_of(folder)


def _run(folder: Path) -> None:
    from ...report import summary
    from ...report.page import write_report
    from ...results import archive, merge

    joined = merge.merge([archive.load(folder)], _record())
    further = random.Random(str(sorted((file.name, file.lstat().st_size) for file in folder.rglob("*")))).random()
    if further < TABLES:
        into = folder.parent / "report"
        archive.save_tables(into, joined.grids, joined.meta, joined.texts)
        summary.write(into, joined.grids, joined.meta)
        if further < PAGES:
            write_report(into, joined.grids, joined.meta)


TABLES, PAGES = 0.4, 0.1
"""Shares of the runs of which the tables are made too, half a second each, and the page, another second."""


@functools.cache
def _record() -> dict[str, Any]:
    from ...store import runs

    return runs.record(["kerfgym", "report"])


def _journal(file: Path) -> None:
    from ...tune import outcome
    from ...tune.study import Task
    from ...tune.work import claim, done

    task = Task(**{**JOURNALED, "url": str(file), "trials": 5})
    study = task.open()
    outcome.frame(done(study), task)
    trial = claim(study, task.trials)
    if trial is not None:
        task.space.suggest(trial)


def _begun(file: Path) -> None:
    from ...store import runs

    runs.begun(file.parent)


TARGETS: dict[str, Target] = {
    "dxf": Target("drawings/*.dxf", _drawing, _beside),
    "svg": Target("drawings/*.svg", _drawing, _beside),
    "gcode": Target("drawings/*.ngc", _drawing, _beside),
    "table": Target("tables/*.csv", _csv, _beside),
    "scenario": Target("settings/scenario/*.toml", _scenario, _beside),
    "suite": Target("settings/suite/*.toml", scenarios.checked_rules, _beside),
    "material": Target("settings/material/*.toml", material.of_file, _beside),
    "tuned": Target("settings/tuned/*.toml", lambda file: stacks.team(str(file)), _beside),
    "preset": Target("settings/preset/*.toml", _preset, _beside),
    "study": Target("settings/study/*.toml", _study, _beside),
    "policy": Target("policies/*/policy.json", _artefact, _policy),
    "weights": Target("policies/*/weights.safetensors", _artefact, _policy),
    "record": Target("runs/run/run.json", _run, _within),
    "results": Target("runs/run/*/*.[pc]*[tv]", _run, lambda data, seed, folder: _in_run(data, seed, folder)),
    "journal": Target("runs/study.journal", _journal, _beside),
    "mark": Target("runs/words.json", _begun, lambda data, seed, folder: _renamed(data, folder, ".begun")),
}
"""By the name that the fuzzer takes."""


def _renamed(data: bytes, folder: Path, name: str) -> Path:
    (folder / name).write_bytes(data)
    return folder / name


def _in_run(data: bytes, seed: Path, folder: Path) -> Path:
    run = seed.parents[1]
    shutil.copytree(run, folder / run.name)
    changed = folder / seed.relative_to(run.parent)
    other = changed.with_suffix(".csv" if changed.suffix == ".parquet" else ".parquet")
    other.unlink(missing_ok=True)  # else it is read
    changed.write_bytes(data)
    return folder / run.name


ODD = 0.03
"""Share of the files that are no files."""


def _odd(draw: random.Random, path: Path) -> None:
    """Puts something else in the place of a file: a pipe, a device, a folder, a link, one that may not be read."""
    found = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    file = draw.choice(found)
    file.rename(aside := file.with_name("aside"))
    ends = ("/dev/zero", "/dev/stdin", "/proc/self/mem", file.name, "none", aside)
    links = (functools.partial(file.symlink_to, end) for end in ends)
    plain: list[Callable[[], Any]] = [functools.partial(os.mkfifo, file), *links, file.mkdir]
    draw.choice([*plain, lambda: None, file.touch])()


def case(name: str, number: int, seed: int, seeds: Path, folder: Path) -> Path:
    """Writes one changed file, the same for the same numbers, where it can be read; returns the path."""
    target = TARGETS[name]
    own = sorted(seeds.glob(target.seeds))
    draw = random.Random(f"{seed}/{name}/{number}")
    first, other = draw.choice(own), draw.choice(own)
    path = target.place(mutated(draw, first.read_bytes(), other.read_bytes()), first, folder)
    os.mkfifo(folder / "pipe")  # which a changed file may name
    if draw.random() < ODD:
        _odd(draw, path)
    return path
