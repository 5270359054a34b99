"""Study files: searches of several controllers by one protocol, as TOML, for ``kerfgym tune --study FILE``.

docs/tuning.md has the keys. Shipped ones lie in ``tune/studies/`` and go by their names; they made the presets.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from typing_extensions import TypedDict

from ... import baselines
from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput, did_you_mean
from ...envs.safety import consent, files, names
from ..store import runs
from .evaluate import with_jobs
from .goals import Limit, Limits
from .space import space
from .staged import Stage
from .study import Task, controller

SHIPPED = Path(__file__).parent / "studies"
"""Studies that go by their names."""

OWN = "shipped"
"""Folder of presets that stands for the package's own; only a shipped study may say so."""


class _Stage(TypedDict, total=False):
    sampler: str
    share: float
    weight: float
    spread: float
    anew: bool


class _Final(TypedDict, total=False):
    best: int
    seeds: int


class _Search(TypedDict, total=False):
    controller: str
    what: list[str]
    ranges: dict[str, list[float]]
    metric: str
    limits: dict[str, float]
    trials: int
    also: list[dict[str, float]]


class _Study(_Search, total=False):
    summary: str
    suite: str
    ms: float | list[float]
    sampler: str
    digits: int
    seed: int
    seeds: int
    presets: str
    stage: list[_Stage]
    final: _Final
    search: dict[str, _Search]


@dataclass(frozen=True)
class Study:
    """What a study file asks for.

    Attributes:
        name: of a shipped study, or its file.
        summary: in a line.
        searches: by name, each with its run folder's; a name is that of the preset, behind it the cap on Ms where the
            file asks for several.
        presets: folder in which presets are written; nothing is where there is none.
    """

    name: str
    summary: str
    searches: dict[str, Task]
    presets: Path | None = None
    targets: dict[str, str] = field(default_factory=dict)


def shipped() -> tuple[str, ...]:
    """Names of the studies that are shipped."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))


def read(word: str, only: tuple[str, ...] = (), trials: int | None = None) -> Study:
    """A study, by the name of a shipped one or by its file.

    Args:
        word: name or file.
        only: the searches wanted; all unless told otherwise.
        trials: of each search, in place of the file's.

    Raises:
        InvalidInput: no such study, or its file does not say what can be carried out; with the nearest valid name.
    """
    path = SHIPPED / f"{word}.toml" if word in shipped() else Path(word)
    if path.suffix != ".toml":
        raise InvalidInput(f"unknown study '{word}'; {did_you_mean(word, shipped())}, or a path to a TOML file")
    data = files.toml(path)
    _known(_Study, data, str(path))
    files.fitting(_Study, data, path)
    for i, stage in enumerate(data.get("stage", [])):
        _known(_Stage, stage, f"{path}: stage[{i}]")
        if not stage.get("share", 1.0) > 0 or not stage.get("spread", 1.0) > 0:
            raise InvalidInput(f"{path}: stage[{i}]: share and spread are above 0")
    _known(_Final, data.get("final", {}), f"{path}: final")
    each = data.get("search", {})
    if not each:
        raise InvalidInput(f"{path}: no search; it needs a table such as [search.pid]")
    for name in only:
        if name not in each:
            raise InvalidInput(f"{path}: unknown search '{name}'; {did_you_mean(name, each)}")
    found: dict[str, Task] = {}
    targets: dict[str, str] = {}
    for name in only or each:
        names.checked(name, f"{path}: search")
        _known(_Search, each[name], f"{path}: search.{name}")
        consent.required(each[name].get("controller", name), f"{path}: search.{name}")
        for ms, key in _caps(data, name):
            found[key], targets[key] = _task(path, name, {**data, **each[name]}, ms, trials), name
    return Study(word, data.get("summary", ""), found, _folder(path, data.get("presets")), targets)


def _known(kind: Any, found: dict[str, Any], where: str) -> None:
    for key in found:
        if key not in kind.__annotations__:
            raise InvalidInput(f"{where}: unknown key '{key}'; {did_you_mean(key, kind.__annotations__)}")


def _caps(data: dict[str, Any], name: str) -> Iterator[tuple[float, str]]:
    """Caps on Ms and what the search under each is called."""
    given = data.get("ms", math.inf)
    if not isinstance(given, list):
        yield float(given), name
        return
    for ms in given:
        yield float(ms), f"{name}-ms-{ms:g}"


def _task(path: Path, name: str, body: dict[str, Any], ms: float, trials: int | None) -> Task:
    """One search; what its own table says stands before what the file says of all.

    Raises:
        InvalidInput: it cannot be made; with file and search.
    """
    try:
        suite, final = body.get("suite", "following"), body.get("final", {})
        scenarios.suite(suite)
        words = tuple(body.get("what", ["law"]))
        base = controller(body.get("controller", name))
        searched = {axis.name for axis in space(base, words).axes}
        for key, ends in body.get("ranges", {}).items():
            if key not in base.parameters():
                raise InvalidInput(f"ranges: unknown parameter '{key}'; {did_you_mean(key, base.parameters())}")
            if len(ends) != 2:
                raise InvalidInput(f"ranges: {key} = {ends}; a range has two ends, [low, high]")
            if key in searched:
                words = (*words, f"{key}={ends[0]!r}..{ends[1]!r}")
        return Task(
            body.get("controller", name), words, suite,
            (body.get("metric") or str(scenarios.rules(suite).get("score", "rms_true")),),
            Limits(ms, tuple(Limit(key, most) for key, most in body.get("limits", {}).items())),
            body.get("sampler", "tpe+cmaes"), trials if trials is not None else body.get("trials", 300),
            body.get("seed", 0), body.get("seeds", 8 if with_jobs(suite) else 32),
            stages=tuple(Stage(**stage) for stage in body.get("stage", [])),
            also=tuple(tuple(changes.items()) for changes in body.get("also", [])), digits=body.get("digits", 5),
            finalists=final.get("best", 0), final_seeds=final.get("seeds", 200),
        )  # fmt: skip
    except (InvalidInput, TypeError) as error:
        raise InvalidInput(f"{path}: search.{name}: {error}") from None


def _folder(path: Path, word: str | None) -> Path | None:
    """Where presets are written.

    Raises:
        InvalidInput: a file from elsewhere would write beyond the folder in which the user works.
    """
    if word is None:
        return None
    if word == OWN and path.parent == SHIPPED:
        return baselines.PRESETS
    inside = runs.near(word) if word != OWN else None
    if inside is None:
        raise InvalidInput(f"{path}: presets = '{word}'; allowed: a folder within the one in which you work")
    return inside
